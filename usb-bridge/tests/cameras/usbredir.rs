//! usbredir without QEMU: the host's side of the protocol, byte by byte.

use std::io::{Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use proptest::prelude::*;
use usb_bridge::peripheral::Speed;
use usb_bridge::peripheral::attached::ROOM_MAX;
use usb_bridge::peripheral::sequence::{self, Check, SequenceDevice};
use usb_bridge::peripheral::socket::{self, Change, OUTPUT_MAX, Session as _};
use usb_bridge::peripheral::usbredir::{BODY_MAX, UsbRedir};

/// What QEMU 7.2 says: device_version, filter, disconnect_ack, packets, long ids, long bulk, bulk
/// receiving.
const QEMU: u32 = 0b1111_1110;

/// A host: it says what it can, and takes packets apart.
struct Host {
    session: UsbRedir,
    capabilities: u32,
}

type Packet = (u32, u64, Vec<u8>);

impl Host {
    fn new(device: SequenceDevice, capabilities: u32) -> Self {
        let session = UsbRedir::with(Box::new(device));
        let mut host = Self {
            session,
            capabilities: 0,
        };
        let ours = host.packets();
        assert_eq!(ours.len(), 1);
        assert_eq!((ours[0].0, ours[0].2.len()), (0, 68));
        host.session.receive(&hello(capabilities));
        // From here on, long ids if both have them.
        host.run();
        host.capabilities = capabilities;
        host
    }

    fn is_long(&self) -> bool {
        self.capabilities & 1 << 5 != 0
    }

    fn packet(&self, kind: u32, id: u64, body: &[u8]) -> Vec<u8> {
        packet(self.is_long(), kind, id, body)
    }

    fn send(&mut self, kind: u32, id: u64, body: &[u8]) -> Vec<Packet> {
        let packet = self.packet(kind, id, body);
        self.session.receive(&packet);
        self.run();
        self.packets()
    }

    fn run(&mut self) {
        while self.session.step().expect("a good host") {}
    }

    fn packets(&mut self) -> Vec<Packet> {
        let bytes = std::mem::take(self.session.output());
        split(self.is_long(), &bytes)
    }

    fn configure(&mut self) {
        let answers = self.send(6, 1, &[1]);
        assert_eq!(answers.last(), Some(&(8, 1, vec![0, 1])));
    }

    fn start(&mut self) {
        let answers = self.send(100, 2, &control(0x40, sequence::START, 0));
        assert_eq!((answers[0].0, answers[0].2[3]), (100, 0));
    }
}

fn hello(capabilities: u32) -> Vec<u8> {
    let mut body = vec![0; 64];
    body.extend(capabilities.to_le_bytes());
    packet(false, 0, 0, &body)
}

fn packet(is_long: bool, kind: u32, id: u64, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    bytes.extend(kind.to_le_bytes());
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(&id.to_le_bytes()[..if is_long { 8 } else { 4 }]);
    bytes.extend(body);
    bytes
}

fn split(is_long: bool, mut bytes: &[u8]) -> Vec<Packet> {
    let header = if is_long { 16 } else { 12 };
    let mut packets = Vec::new();
    while !bytes.is_empty() {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let high = if is_long {
            u64::from(word(12)) << 32
        } else {
            0
        };
        let length = word(4) as usize;
        let body = bytes[header..header + length].to_vec();
        packets.push((word(0), u64::from(word(8)) | high, body));
        bytes = &bytes[header + length..];
    }
    packets
}

fn control(kind: u8, request: u8, length: u16) -> [u8; 10] {
    let [low, high] = length.to_le_bytes();
    [kind & 0x80, request, kind, 0, 0, 0, 0, 0, low, high]
}

fn bulk(endpoint: u8, length: u32) -> [u8; 10] {
    let [a, b, c, d] = length.to_le_bytes();
    [endpoint, 0, a, b, 0, 0, 0, 0, c, d]
}

#[test]
fn a_device_is_announced_with_its_tables() {
    for (capabilities, connect, endpoints) in [(QEMU, 10, 160), (0, 8, 96)] {
        let session = UsbRedir::with(Box::new(SequenceDevice::new(Speed::Super)));
        let mut host = Host {
            session,
            capabilities: 0,
        };
        host.packets();
        host.session.receive(&hello(capabilities));
        host.run();
        host.capabilities = capabilities;
        let packets = host.packets();
        let kinds: Vec<u32> = packets.iter().map(|packet| packet.0).collect();
        assert_eq!(kinds, [4, 5, 1]);
        let [interfaces, table, device] = &packets[..] else {
            panic!("three packets");
        };
        assert_eq!(interfaces.2.len(), 132);
        assert_eq!((interfaces.2[0], interfaces.2[4 + 32]), (1, 0xFF));
        assert_eq!(table.2.len(), endpoints);
        // Control, the commands out; control, answers and stream in.
        assert_eq!((table.2[0], table.2[1], table.2[2]), (0, 2, 255));
        assert_eq!(table.2[16..20], [0, 2, 2, 255]);
        if capabilities != 0 {
            assert_eq!(table.2[96 + 2 * 18..][..2], 1024_u16.to_le_bytes());
        }
        assert_eq!(device.2.len(), connect);
        assert_eq!(device.2[..8], [3, 0, 0, 0, 0x09, 0x12, 1, 0]);
    }
}

#[test]
fn several_transfers_wait_and_are_answered_with_their_ids() {
    let mut host = Host::new(SequenceDevice::new(Speed::High), QEMU);
    host.packets();
    host.configure();
    let ids = [1 << 40, (1 << 40) + 1, 7];
    for id in ids {
        assert_eq!(host.send(101, id, &bulk(sequence::STREAM, 70_000)), []);
    }
    // Taken back while it waits; one that is unknown has ended already.
    let answers = host.send(21, ids[1], &[]);
    assert_eq!(answers.len(), 1);
    assert_eq!((answers[0].1, answers[0].2[1]), (ids[1], 1));
    assert_eq!(host.send(21, 99, &[]), []);
    let answers = host.send(100, 2, &control(0x40, sequence::START, 0));
    let mut check = Check::default();
    for (answer, id) in answers[1..].iter().zip([ids[0], ids[2]]) {
        assert_eq!((answer.0, answer.1), (101, id));
        assert_eq!(answer.2[..10], bulk(sequence::STREAM, 70_000));
        check.take(&answer.2[10..]);
    }
    assert_eq!((check.bytes(), check.is_good()), (140_000, true));
    assert_eq!(host.session.report().packets_odd, 0);
}

#[test]
fn an_old_host_has_short_ids_and_lengths() {
    let mut host = Host::new(SequenceDevice::new(Speed::High), 0);
    host.packets();
    host.configure();
    host.start();
    let answers = host.send(101, 5, &bulk(sequence::STREAM, 513)[..8]);
    assert_eq!((answers[0].1, answers[0].2.len()), (5, 8 + 513));
}

#[test]
fn requests_are_answered_refused_and_checked() {
    let mut host = Host::new(SequenceDevice::new(Speed::Super), QEMU);
    host.packets();
    let mut ask = |body: &[u8]| {
        let answers = host.send(100, 9, body);
        assert_eq!((answers.len(), answers[0].0, answers[0].1), (1, 100, 9));
        answers[0].2.clone()
    };
    // The device descriptor, 18 of 64 bytes; an unknown vendor's request.
    let answer = ask(&[0x80, 6, 0x80, 0, 0, 1, 0, 0, 64, 0]);
    assert_eq!((answer[3], answer[8], answer.len()), (0, 18, 28));
    assert_eq!(ask(&control(0xC0, 1, 5))[3], 4);
    // Data where there is none to be, and too little of it.
    assert_eq!(
        ask(&[&control(0xC0, sequence::NOTE, 5)[..], &[1]].concat())[3],
        2
    );
    assert_eq!(
        ask(&[&control(0x40, sequence::NOTE, 5)[..], &[1]].concat())[3],
        2
    );
    let answer = ask(&[&control(0x40, sequence::NOTE, 3)[..], &[1, 2, 3]].concat());
    assert_eq!((answer[3], answer[8], answer.len()), (0, 3, 10));
    assert_eq!(ask(&control(0xC0, sequence::NOTE, 2))[10..], [1, 2]);
    assert_eq!(host.session.report().packets_odd, 2);
    // Settings, and what this device has none of.
    assert_eq!(host.send(9, 3, &[0, 0]), [(11, 3, vec![4, 0, 0])]);
    host.configure();
    assert_eq!(
        host.send(9, 3, &[0, 0]).last(),
        Some(&(11, 3, vec![0, 0, 0]))
    );
    assert_eq!(host.send(9, 3, &[0, 1]), [(11, 3, vec![4, 0, 0])]);
    assert_eq!(host.send(10, 4, &[3]), [(11, 4, vec![4, 3, 0])]);
    assert_eq!(host.send(12, 4, &[0x81, 1, 1]), [(14, 4, vec![2, 0x81])]);
    assert_eq!(host.send(15, 4, &[0x81]), [(17, 4, vec![2, 0x81])]);
    assert_eq!(host.send(6, 4, &[9]).last(), Some(&(8, 4, vec![4, 1])));
}

#[test]
fn a_halt_ends_what_waits_and_is_ended_by_the_host() {
    let mut host = Host::new(SequenceDevice::new(Speed::High).stall_at(0), QEMU);
    host.packets();
    host.configure();
    host.start();
    assert_eq!(host.send(101, 3, &bulk(sequence::STREAM, 512))[0].2[1], 4);
    assert_eq!(host.send(101, 4, &bulk(sequence::STREAM, 512))[0].2[1], 4);
    let clear = [0, 1, 2, 0, 0, 0, sequence::STREAM, 0, 0, 0];
    assert_eq!(host.send(100, 5, &clear)[0].2[3], 0);
    assert_eq!(host.send(101, 6, &bulk(sequence::STREAM, 512))[0].2[1], 0);
}

#[test]
fn a_device_is_replaced_when_the_host_knows_that_the_first_has_left() {
    let mut host = Host::new(SequenceDevice::new(Speed::High), QEMU);
    host.packets();
    host.configure();
    host.send(101, 3, &bulk(sequence::STREAM, 512));
    let next = SequenceDevice::new(Speed::Super);
    assert!(host.session.change(Change::Plug(Box::new(next))));
    assert_eq!(host.packets(), [(2, 0, vec![])]);
    // What it had sent before it knew is nobody's.
    assert_eq!(host.send(101, 4, &bulk(sequence::STREAM, 512)), []);
    let kinds: Vec<u32> = host.send(24, 0, &[]).iter().map(|one| one.0).collect();
    assert_eq!(kinds, [4, 5, 1]);
    host.configure();
    host.start();
    assert_eq!(host.send(101, 4, &bulk(sequence::STREAM, 512))[0].2[1], 0);
    assert!(!host.session.change(Change::End));
    assert_eq!(host.packets(), [(2, 0, vec![])]);
}

#[test]
fn another_protocol_is_told_from_this_one() {
    let refused = |bytes: &[u8]| {
        let mut session = UsbRedir::new();
        session.receive(bytes);
        session.step().is_err()
    };
    assert!(refused(b"GET / HTTP/1.1\r\n\r\n"));
    assert!(refused(&packet(false, 100, 0, &[0; 10])));
    let mut large = hello(QEMU);
    large[4..8].copy_from_slice(&(BODY_MAX as u32 + 1).to_le_bytes());
    assert!(refused(&large));
}

#[test]
fn a_host_that_reads_late_loses_nothing() {
    let (mut ours, mut theirs) = UnixStream::pair().expect("a pair of sockets");
    let served = std::thread::spawn(move || {
        let device = SequenceDevice::new(Speed::Super).pause(2);
        let mut session = UsbRedir::with(Box::new(device));
        socket::serve(&mut ours, &mut session, &mut || None)
    });
    let mut bytes = hello(QEMU);
    bytes.extend(packet(true, 6, 1, &[1]));
    bytes.extend(packet(true, 100, 2, &control(0x40, sequence::START, 0)));
    for id in 0..100 {
        bytes.extend(packet(true, 101, id, &bulk(sequence::STREAM, 1 << 16)));
    }
    theirs.write_all(&bytes).expect("taken");
    std::thread::sleep(Duration::from_millis(100));
    let mut skip = [0; 12 + 68];
    theirs.read_exact(&mut skip).expect("the hello");
    let mut check = Check::default();
    while check.bytes() < 100 << 16 {
        let mut header = [0; 16];
        theirs.read_exact(&mut header).expect("a packet");
        let length = u32::from_le_bytes(header[4..8].try_into().unwrap());
        let mut body = vec![0; length as usize];
        theirs.read_exact(&mut body).expect("its body");
        if header[0] == 101 {
            check.take(&body[10..]);
        }
    }
    assert!(check.is_good());
    drop(theirs);
    let report = served.join().expect("a thread").expect("in order");
    assert_eq!(report.traffic.bytes_in, 100 << 16);
}

/// Packets as a host might send them, and as none would.
fn any_packet() -> impl Strategy<Value = (u32, u64, Vec<u8>)> {
    let kind = prop_oneof![0_u32..28, 100_u32..105, any::<u32>()];
    let body = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..24),
        (0_u8..4, 0_u8..12, any::<u16>(), 0_u16..600).prop_map(|(kind, request, value, length)| {
            let kind = [0x00, 0x80, 0x40, 0x02][usize::from(kind)];
            let mut body = control(kind, request, length);
            body[4..6].copy_from_slice(&value.to_le_bytes());
            body.to_vec()
        }),
        (any::<u8>(), any::<u32>()).prop_map(|(endpoint, length)| {
            bulk(0x80 | endpoint & 3, length >> (endpoint & 31)).to_vec()
        }),
        Just(vec![1]),
    ];
    (kind, 0_u64..8, body)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn every_packet_of_a_hostile_host_is_survived(
        capabilities in any::<u32>(),
        packets in prop::collection::vec(any_packet(), 0..60),
        cut in prop::collection::vec(1_usize..60, 1..20),
    ) {
        let mut session = UsbRedir::with(Box::new(SequenceDevice::new(Speed::High).pause(1)));
        session.receive(&hello(capabilities));
        let is_long = capabilities & 1 << 5 != 0;
        let mut bytes = packet(is_long, 6, 1, &[1]);
        bytes.extend(packet(is_long, 100, 2, &control(0x40, sequence::START, 0)));
        for (kind, id, body) in packets {
            bytes.extend(packet(is_long, kind, id, &body));
        }
        let mut cut = cut.iter().cycle();
        let mut rest = &bytes[..];
        while !rest.is_empty() {
            let (now, later) = rest.split_at(rest.len().min(*cut.next().unwrap()));
            session.receive(now);
            rest = later;
            // As the socket does: no answers beyond a bound.
            while session.output().len() < OUTPUT_MAX {
                prop_assert!(session.output().len() < OUTPUT_MAX + ROOM_MAX + (1 << 17));
                match session.step() {
                    Ok(true) => {}
                    Ok(false) => break,
                    Err(_) => return Ok(()),
                }
            }
            session.output().clear();
        }
    }

    #[test]
    fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let mut session = UsbRedir::with(Box::new(SequenceDevice::new(Speed::High)));
        session.receive(&hello(QEMU));
        session.receive(&bytes);
        while let Ok(true) = session.step() {}
    }

    #[test]
    fn any_cuts_give_the_same_answers(
        lengths in prop::collection::vec(1_u32..5000, 1..20),
        cut in prop::collection::vec(1_usize..100, 1..20),
    ) {
        let run = |cut: &[usize]| {
            let mut host = Host::new(SequenceDevice::new(Speed::High), QEMU);
            let mut bytes = host.packet(6, 1, &[1]);
            bytes.extend(host.packet(100, 2, &control(0x40, sequence::START, 0)));
            for (id, length) in (10..).zip(&lengths) {
                bytes.extend(host.packet(101, id, &bulk(sequence::STREAM, *length)));
            }
            let mut cut = cut.iter().cycle();
            let mut rest = &bytes[..];
            while !rest.is_empty() {
                let (now, later) = rest.split_at(rest.len().min(*cut.next().unwrap()));
                host.session.receive(now);
                host.run();
                rest = later;
            }
            host.packets()
        };
        prop_assert_eq!(run(&cut), run(&[usize::MAX]));
    }
}
