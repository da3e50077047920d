//! The microcontroller's USB class through the stack's own state machine, on a bus in memory:
//! enumeration byte by byte, frames and packets in any cut, requests that make no sense, hosts that
//! behave badly.

use std::collections::VecDeque;

use eecvs_nostd::event_link::{Kind, Packet};
use eecvs_usb_class::{
    COUNTS, Counts, DESCRIPTOR_SET, DESCRIPTORS, FROM_HOST, Fetcher, Outgoing, PACKET_BYTES,
    RESTART, Sender, TO_HOST, serial_number,
};
use proptest::collection::vec;
use proptest::prelude::*;
use usb_bridge::link::control::Request;
use usb_bridge::peripheral::class_bus::{Application, ClassBus, Handshake, Inbox, Wire};
use usb_bridge::peripheral::{Bulk, Peripheral, Reply, Speed};
use usb_device::bus::UsbBusAllocator;

/// Endpoints of the serial port.
const SERIAL_TO_HOST: u8 = 0x83;
const SERIAL_FROM_HOST: u8 = 0x02;

/// Sends what it is told to, keeps what it receives.
#[derive(Default)]
struct Script {
    messages: VecDeque<Vec<u8>>,
    received: Vec<u8>,
    /// Takes nothing.
    busy: bool,
    /// Sends without asking for room, as a sender that does not wait.
    rude: bool,
    restarts: usize,
    /// Answers of the sender.
    sent: usize,
    refused: usize,
}

impl Application for Script {
    fn work(&mut self, inbox: &mut Inbox, sender: &mut Sender<'_>) {
        if inbox.has_restarted() {
            self.restarts += 1;
            sender.follow();
        }
        while !self.busy
            && let Some(byte) = inbox.take()
        {
            self.received.push(byte);
        }
        while let Some(message) = self.messages.front() {
            if !self.rude && !sender.has_room(message.len()) {
                return;
            }
            match sender.send(message, || false) {
                true => self.sent += 1,
                false => self.refused += 1,
            }
            self.messages.pop_front();
        }
    }
}

/// Runs `test` with a device that has been enumerated.
fn with_device<R>(script: Script, test: impl FnOnce(&mut ClassBus<'_, Script>) -> R) -> R {
    let wire = Wire::default();
    let allocator = UsbBusAllocator::new(wire.clone());
    let mut outgoing = Outgoing::new();
    let ends: (Sender<'_>, Fetcher<'_>) = outgoing.split();
    let serial = serial_number([1, 2, 3]);
    let serial = std::str::from_utf8(&serial).unwrap();
    let mut device = ClassBus::new(&wire, &allocator, ends, serial, script).unwrap();
    test(&mut device)
}

fn word(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

/// The setup packet that gives the encoder to a function.
fn setup_packet() -> Vec<u8> {
    let mut bytes = vec![0; 64];
    let packet = Packet {
        kind: Kind::Setup,
        position: 0,
        body: &[1, 2, 3],
    };
    let len = packet.write(&mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

fn counts(device: &mut ClassBus<'_, Script>) -> Counts {
    let reply = device.control(Request::vendor_in(COUNTS, 0, 0), &[], 255);
    let Reply::Data(data) = reply else {
        panic!("no counts");
    };
    let counts = Counts::parse(&data).unwrap();
    assert_eq!(counts, device.counts());
    counts
}

/// All transfers that an endpoint has.
fn transfers(device: &mut ClassBus<'_, Script>, endpoint: u8, room: usize) -> Vec<Vec<u8>> {
    let mut transfers = Vec::new();
    loop {
        let mut data = Vec::new();
        match device.bulk_in(endpoint, room, &mut data) {
            Bulk::Data => transfers.push(data),
            Bulk::Wait => return transfers,
            Bulk::Stall => panic!("halted"),
        }
    }
}

fn message(len: usize, seed: u8) -> Vec<u8> {
    (0..len).map(|at| at as u8 ^ seed).collect()
}

#[test]
fn the_device_descriptor_is_as_documented() {
    with_device(Script::default(), |device| {
        let descriptors = device.descriptors().clone();
        assert_eq!(descriptors.speed, Speed::Full);
        assert_eq!(
            descriptors.device,
            [
                18, 1, 0x10, 0x02, 0xEF, 0x02, 0x01,
                64, // length, type, USB 2.1, composite, packets
                0x09, 0x12, 0x01, 0x00, 0x10, 0x00, // 1209:0001, release 0.1
                1, 2, 3, 1, // strings, one configuration
            ]
        );
        assert_eq!(
            descriptors.strings,
            [
                "EECVS",
                "EECVS event encoder",
                "000000010000000200000003",
                "EECVS encoder",
                "EECVS encoder, serial",
            ]
        );
        assert_eq!(device.wire().address(), 1);
    });
}

#[test]
fn the_configuration_has_both_functions() {
    with_device(Script::default(), |device| {
        let bytes = device.descriptors().configuration.clone();
        let expected: &[&[u8]] = &[
            &[9, 2, bytes.len() as u8, 0, 3, 1, 0, 0x80, 125],
            // The vendor's interface and its two endpoints of 64 bytes.
            &[9, 4, 0, 0, 2, 0xFF, 0xFF, 0xFF, 4],
            &[7, 5, 0x81, 2, 64, 0, 0],
            &[7, 5, 0x01, 2, 64, 0, 0],
            // Interfaces 1 and 2 belong together: a serial port.
            &[8, 11, 1, 2, 2, 2, 0, 0],
            &[9, 4, 1, 0, 1, 2, 2, 0, 5],
            &[5, 0x24, 0, 0x10, 0x01],
            &[4, 0x24, 2, 0],
            &[5, 0x24, 6, 1, 2],
            &[5, 0x24, 1, 0, 2],
            &[7, 5, 0x82, 3, 8, 0, 255],
            &[9, 4, 2, 0, 2, 10, 0, 0, 0],
            &[7, 5, 0x83, 2, 64, 0, 0],
            &[7, 5, 0x02, 2, 64, 0, 0],
        ];
        let mut at = 0;
        for descriptor in expected {
            assert_eq!(
                &bytes[at..at + usize::from(bytes[at])],
                *descriptor,
                "at {at}"
            );
            at += descriptor.len();
        }
        assert_eq!(at, bytes.len());
        assert_eq!(word(&bytes, 2), bytes.len());
    });
}

#[test]
fn windows_finds_what_it_asks_for() {
    with_device(Script::default(), |device| {
        let bos = device.descriptors().bos.clone();
        let mut expected = vec![5, 15, 40, 0, 2];
        // USB 2.0 extension: no link power management.
        expected.extend([7, 16, 2, 0, 0, 0, 0]);
        expected.extend([28, 16, 5, 0]);
        expected.extend([
            0xDF, 0x60, 0xDD, 0xD8, 0x89, 0x45, 0xC7, 0x4C, 0x9C, 0xD2, 0x65, 0x9D, 0x9E, 0x64,
            0x8A, 0x9F,
        ]);
        expected.extend([0, 0, 3, 6, 178, 0, DESCRIPTORS, 0]);
        assert_eq!(bos, expected);

        let request = Request::vendor_in(DESCRIPTORS, 0, 7);
        let Reply::Data(set) = device.control(request, &[], 178) else {
            panic!("no descriptor set");
        };
        assert_eq!(set, DESCRIPTOR_SET);
        // Any shorter length gives the beginning.
        for length in [0, 1, 10, 63, 64, 65, 128, 177] {
            let reply = device.control(request, &[], length);
            assert_eq!(reply, Reply::Data(set[..length].to_vec()), "{length}");
        }
        well_formed(&set);
    });
}

/// Walks the set as Windows does.
fn well_formed(set: &[u8]) {
    assert_eq!((word(set, 0), word(set, 2)), (10, 0));
    assert_eq!(&set[4..8], [0, 0, 3, 6]);
    assert_eq!(word(set, 8), set.len());
    let configuration = &set[10..];
    assert_eq!((word(configuration, 0), word(configuration, 2)), (8, 1));
    assert_eq!(word(configuration, 6), configuration.len());
    let function = &configuration[8..];
    assert_eq!((word(function, 0), word(function, 2)), (8, 2));
    assert_eq!(function[4], 0, "the first interface");
    assert_eq!(word(function, 6), function.len());
    let identity = &function[8..];
    assert_eq!((word(identity, 0), word(identity, 2)), (20, 3));
    assert_eq!(&identity[4..20], b"WINUSB\0\0\0\0\0\0\0\0\0\0");
    let property = &identity[20..];
    assert_eq!((word(property, 0), word(property, 2)), (property.len(), 4));
    assert_eq!(word(property, 4), 7, "a list of strings");
    let name = word(property, 6);
    let data = word(property, 8 + name);
    assert_eq!(property.len(), 10 + name + data);
    let text = |bytes: &[u8]| {
        let units: Vec<u16> = bytes.chunks(2).map(|unit| word(unit, 0) as u16).collect();
        String::from_utf16(&units).unwrap()
    };
    assert_eq!(text(&property[8..8 + name]), "DeviceInterfaceGUIDs\0");
    let guid = text(&property[10 + name..]);
    assert_eq!(guid.len(), 40);
    assert!(guid.ends_with("}\0\0"));
    let digits: Vec<usize> = guid[1..37].split('-').map(str::len).collect();
    assert_eq!(digits, [8, 4, 4, 4, 12]);
    assert!(
        guid[1..37]
            .chars()
            .all(|c| c == '-' || c.is_ascii_hexdigit())
    );
}

#[test]
fn a_message_is_a_transfer_and_ends_with_a_short_packet() {
    with_device(Script::default(), |device| {
        let lens = [1, 63, 64, 65, 127, 128, 192, 700, 64, 64, 1];
        let messages: Vec<_> = lens.map(|len| message(len, len as u8)).into();
        device.application().messages = messages.clone().into();
        assert_eq!(transfers(device, TO_HOST, 16384), messages);
        let counts = counts(device);
        assert_eq!(counts.messages_sent as usize, lens.len());
        assert_eq!(counts.bytes_sent as usize, lens.iter().sum::<usize>());
        assert_eq!((counts.messages_dropped, counts.bytes_dropped), (0, 0));

        // Packet by packet, as the wire has them.
        device.application().messages = [message(128, 1), message(5, 2)].into();
        device.run();
        let mut packets = Vec::new();
        loop {
            let mut packet = Vec::new();
            if device.wire().ask(TO_HOST, &mut packet) == Handshake::Nak {
                break;
            }
            packets.push(packet.len());
            device.run();
        }
        assert_eq!(packets, [64, 64, 0, 5]);
    });
}

#[test]
fn packets_from_the_host_arrive_in_any_cut() {
    with_device(Script::default(), |device| {
        let sent = message(5000, 9);
        for cut in [1, 63, 64, 65, 512, 5000] {
            for part in sent.chunks(cut) {
                assert!(device.bulk_out(FROM_HOST, part));
            }
            assert_eq!(
                std::mem::take(&mut device.application().received),
                sent,
                "{cut}"
            );
        }
        assert_eq!(counts(device).bytes_received, 6 * 5000);
        assert!(!device.bulk_out(0x03, &[1]) && !device.bulk_out(TO_HOST, &[1]));
    });
}

#[test]
fn a_busy_encoder_holds_the_host_and_loses_nothing() {
    let script = Script {
        busy: true,
        ..Script::default()
    };
    with_device(script, |device| {
        let sent = message(4000, 3);
        assert!(device.bulk_out(FROM_HOST, &sent));
        assert_eq!(device.inbox().len(), 1024);
        // Requests are answered all the same.
        assert_eq!(counts(device).bytes_received, 1024);
        device.application().busy = false;
        device.bulk_in(TO_HOST, 64, &mut Vec::new());
        assert_eq!(device.application().received, sent);
        assert_eq!(device.bytes_refused(), 0);
    });
}

#[test]
fn a_host_that_stops_reading_costs_counted_messages_and_no_time() {
    let script = Script {
        rude: true,
        ..Script::default()
    };
    with_device(script, |device| {
        let messages: Vec<_> = (0..200).map(|seed| message(100, seed)).collect();
        device.application().messages = messages.clone().into();
        device.run();
        let (sent, refused) = (device.application().sent, device.application().refused);
        assert_eq!(sent + refused, 200);
        assert!(refused > 160, "{refused}");
        let before = counts(device);
        assert_eq!(before.messages_dropped as usize, refused);
        // It reads again: what was queued comes, the first messages whole.
        let received = transfers(device, TO_HOST, 16384);
        assert_eq!(received[..30], messages[..30]);
        let after = counts(device);
        let bytes: usize = received.iter().map(Vec::len).sum();
        assert_eq!(after.bytes_sent as usize, bytes);
        assert_eq!(after.bytes_sent + after.bytes_dropped, 200 * 100);
    });
}

#[test]
fn a_reset_in_the_middle_of_a_message_begins_anew() {
    with_device(Script::default(), |device| {
        for way in 0..3 {
            let restarts = device.application().restarts;
            let before = counts(device);
            device.application().messages = [message(600, 1), message(100, 2)].into();
            device.run();
            let mut first = Vec::new();
            assert_eq!(device.wire().ask(TO_HOST, &mut first), Handshake::Ack);
            assert_eq!(first, message(600, 1)[..64]);
            device.run();
            match way {
                0 => device.reset(),
                1 => {
                    let restart = Request::vendor_out(RESTART, 0, 0);
                    assert_eq!(device.control(restart, &[], 0), Reply::Data(Vec::new()));
                }
                _ => {
                    let configure = Request {
                        kind: 0,
                        request: 9,
                        value: 1,
                        index: 0,
                    };
                    assert_eq!(device.control(configure, &[], 0), Reply::Data(Vec::new()));
                    let mut renumbered = std::mem::take(&mut device.inbox().renumbered);
                    renumbered.sort_unstable();
                    assert!(
                        [1, 2, 0x81, 0x82, 0x83]
                            .iter()
                            .all(|at| renumbered.contains(at))
                    );
                }
            }
            assert!(device.application().restarts > restarts);
            device.application().messages.push_back(message(70, 3));
            let received = transfers(device, TO_HOST, 16384);
            // Without a reset the packet that the controller had is still there.
            let last = received.last().unwrap();
            assert!(last.ends_with(&message(70, 3)), "{way}");
            assert_eq!(received.len(), 1);
            assert_eq!(last.len(), if way == 0 { 70 } else { 64 + 70 }, "{way}");
            let after = counts(device);
            let dropped = after.bytes_dropped - before.bytes_dropped;
            let sent = after.bytes_sent - before.bytes_sent;
            assert_eq!(sent + dropped, 600 + 100 + 70, "{way}");
            assert_eq!(after.messages_dropped - before.messages_dropped, 2);
            assert_eq!(after.messages_sent - before.messages_sent, 1);
        }
    });
}

#[test]
fn a_setup_gives_the_encoder_to_the_function_it_comes_on() {
    with_device(Script::default(), |device| {
        assert!(device.bulk_out(FROM_HOST, &[1, 2, 3]));
        // A modem manager knocks.
        assert!(device.bulk_out(SERIAL_FROM_HOST, b"AT\r\n"));
        assert_eq!(device.application().received, [1, 2, 3]);
        let counts_before = counts(device);
        assert_eq!(
            (counts_before.bytes_refused, counts_before.packets_refused),
            (4, 1)
        );
        assert!(!counts_before.serial);

        let setup = setup_packet();
        assert!(device.bulk_out(SERIAL_FROM_HOST, &setup));
        assert!(device.application().received.ends_with(&setup));
        assert!(counts(device).serial);
        device.application().messages = [message(64, 4)].into();
        assert_eq!(transfers(device, TO_HOST, 512), Vec::<Vec<u8>>::new());
        assert_eq!(transfers(device, SERIAL_TO_HOST, 512), [message(64, 4)]);

        // And back.
        assert!(device.bulk_out(FROM_HOST, &[9; 70]));
        assert!(device.bulk_out(FROM_HOST, &setup));
        assert!(!counts(device).serial);
        assert_eq!(counts(device).packets_refused, 3);
        device.application().messages = [message(65, 5)].into();
        assert_eq!(transfers(device, TO_HOST, 512), [message(65, 5)]);
    });
}

#[test]
fn the_serial_port_keeps_its_line_coding() {
    with_device(Script::default(), |device| {
        let class = |kind, request| Request {
            kind,
            request,
            value: 0,
            index: 1,
        };
        let coding = [0x00, 0xC2, 0x01, 0x00, 0, 0, 8];
        let reply = device.control(class(0x21, 0x20), &coding, 0);
        assert_eq!(reply, Reply::Data(Vec::new()));
        let reply = device.control(class(0xA1, 0x21), &[], 7);
        assert_eq!(reply, Reply::Data(coding.to_vec()));
    });
}

#[test]
fn unknown_requests_are_stalled_and_known_ones_go_on() {
    with_device(Script::default(), |device| {
        let unknown = [
            Request::vendor_in(0x55, 0, 0),
            Request::vendor_in(RESTART, 0, 0),
            Request::vendor_in(DESCRIPTORS, 0, 4),
            Request::vendor_in(DESCRIPTORS, 0, 5),
            Request::vendor_out(0x55, 0, 0),
            Request::vendor_out(COUNTS, 0, 0),
            // To an interface of the other function.
            Request {
                kind: 0xC1,
                request: COUNTS,
                value: 0,
                index: 1,
            },
            // A descriptor that is not there.
            Request {
                kind: 0x80,
                request: 6,
                value: 0x0A00,
                index: 0,
            },
            Request {
                kind: 0,
                request: 9,
                value: 2,
                index: 0,
            },
        ];
        for request in unknown {
            assert_eq!(
                device.control(request, &[], 64),
                Reply::Stall,
                "{request:?}"
            );
            counts(device);
        }
        let restart = Request::vendor_out(RESTART, 0, 0);
        assert_eq!(device.control(restart, &[1], 0), Reply::Stall);
        // To the vendor's own interface.
        let request = Request {
            kind: 0xC1,
            request: COUNTS,
            value: 0,
            index: 0,
        };
        assert!(matches!(device.control(request, &[], 64), Reply::Data(data) if data.len() == 40));
    });
}

#[test]
fn transfers_that_send_too_much_end_with_a_stall() {
    with_device(Script::default(), |device| {
        let before = counts(device).controls_refused;
        for len in [257, 300, 4096, 65535, 65536] {
            let request = Request::vendor_out(RESTART, 0, 0);
            assert_eq!(
                device.control(request, &vec![0; len], 0),
                Reply::Stall,
                "{len}"
            );
            // Nothing is stuck.
            counts(device);
            assert!(device.bulk_out(FROM_HOST, &[1, 2, 3]));
        }
        assert_eq!(device.application().received, [1, 2, 3].repeat(5));
        assert_eq!(counts(device).controls_refused - before, 4);
    });
}

#[test]
fn an_answer_that_is_left_in_its_middle_does_not_mix_with_the_next() {
    with_device(Script::default(), |device| {
        let configuration = device.descriptors().configuration.clone();
        for packets in 0..3 {
            let [low, high] = 178_u16.to_le_bytes();
            device
                .wire()
                .setup([0xC0, DESCRIPTORS, 0, 0, 7, 0, low, high]);
            device.run();
            for _ in 0..packets {
                device.wire().ask(0x80, &mut Vec::new());
                device.run();
            }
            let request = Request {
                kind: 0x80,
                request: 6,
                value: 0x0200,
                index: 0,
            };
            let reply = device.control(request, &[], 1024);
            assert_eq!(reply, Reply::Data(configuration.clone()), "{packets}");
        }
    });
}

#[test]
fn a_halt_ends_with_the_hosts_request() {
    with_device(Script::default(), |device| {
        let halt = |request, index| Request {
            kind: 2,
            request,
            value: 0,
            index,
        };
        device.control(halt(3, u16::from(TO_HOST)), &[], 0);
        let mut data = Vec::new();
        assert_eq!(device.bulk_in(TO_HOST, 64, &mut data), Bulk::Stall);
        device.clear_halt(TO_HOST);
        assert_eq!(device.inbox().renumbered.last(), Some(&TO_HOST));
        device.application().messages = [message(3, 0)].into();
        assert_eq!(transfers(device, TO_HOST, 64), [message(3, 0)]);
    });
}

#[test]
fn a_sleeping_bus_keeps_what_waits() {
    with_device(Script::default(), |device| {
        device.wire().suspend_bus();
        device.run();
        device.application().messages = [message(100, 8)].into();
        device.run();
        device.wire().resume_bus();
        assert_eq!(transfers(device, TO_HOST, 512), [message(100, 8)]);
    });
}

/// What a host may do.
#[derive(Debug, Clone)]
enum Act {
    Control(Request, Vec<u8>, usize),
    /// A setup packet, and what comes of it is left.
    Setup([u8; 8]),
    ControlPacket(Vec<u8>),
    ControlAsk,
    Out(u8, Vec<u8>),
    In(u8, usize),
    Packet(u8, Vec<u8>),
    Ask(u8),
    ClearHalt(u8),
    Reset,
    Suspend,
    Resume,
    Message(usize),
    Busy(bool),
    Run,
}

fn requests() -> impl Strategy<Value = Request> {
    // The kinds, requests and values that mean something are as likely as those that do not.
    let kind = prop_oneof![
        any::<u8>(),
        Just(0x80),
        Just(0),
        Just(2),
        Just(1),
        Just(0x81),
        Just(0x82),
        Just(0xC0),
        Just(0x40),
        Just(0xC1),
        Just(0x21),
        Just(0xA1)
    ];
    let request = prop_oneof![any::<u8>(), 0_u8..13, Just(0x20), Just(0x21), Just(0x22)];
    let value = prop_oneof![
        any::<u16>(),
        0_u16..4,
        (1_u16..16).prop_map(|kind| kind << 8)
    ];
    let index = prop_oneof![any::<u16>(), 0_u16..8, 0x80_u16..0x86];
    (kind, request, value, index).prop_map(|(kind, request, value, index)| Request {
        kind,
        request,
        value,
        index,
    })
}

fn acts() -> impl Strategy<Value = Act> {
    let endpoint = || prop_oneof![0_u8..5, 0x80_u8..0x85, any::<u8>()];
    prop_oneof![
        8 => (requests(), vec(any::<u8>(), 0..300), 0_usize..600)
            .prop_map(|(request, data, length)| Act::Control(request, data, length)),
        2 => any::<[u8; 8]>().prop_map(Act::Setup),
        3 => (requests(), 0_u16..300).prop_map(|(request, length)| {
            let [value, index, length] =
                [request.value, request.index, length].map(u16::to_le_bytes);
            Act::Setup([
                request.kind, request.request, value[0], value[1], index[0], index[1], length[0],
                length[1],
            ])
        }),
        2 => vec(any::<u8>(), 0..65).prop_map(Act::ControlPacket),
        2 => Just(Act::ControlAsk),
        3 => (endpoint(), vec(any::<u8>(), 0..300)).prop_map(|(at, data)| Act::Out(at, data)),
        1 => prop_oneof![Just(FROM_HOST), Just(SERIAL_FROM_HOST)]
            .prop_map(|at| Act::Out(at, setup_packet())),
        3 => (endpoint(), 0_usize..2000).prop_map(|(at, room)| Act::In(at, room)),
        2 => (endpoint(), vec(any::<u8>(), 0..70)).prop_map(|(at, data)| Act::Packet(at, data)),
        2 => endpoint().prop_map(Act::Ask),
        1 => endpoint().prop_map(Act::ClearHalt),
        1 => Just(Act::Reset),
        1 => Just(Act::Suspend),
        1 => Just(Act::Resume),
        4 => (0_usize..1500).prop_map(Act::Message),
        1 => any::<bool>().prop_map(Act::Busy),
        2 => Just(Act::Run),
    ]
}

fn act(device: &mut ClassBus<'_, Script>, act: Act) {
    match act {
        Act::Control(request, data, length) => {
            device.control(request, &data, length);
        }
        Act::Setup(setup) => device.wire().setup(setup),
        Act::ControlPacket(packet) => {
            device.wire().give(0, &packet);
        }
        Act::ControlAsk => {
            device.wire().ask(0x80, &mut Vec::new());
        }
        Act::Out(endpoint, data) => {
            device.bulk_out(endpoint, &data);
        }
        Act::In(endpoint, room) => {
            let mut data = Vec::new();
            device.bulk_in(endpoint, room, &mut data);
            assert!(data.len() <= room);
        }
        Act::Packet(endpoint, packet) => {
            device.wire().give(endpoint, &packet);
        }
        Act::Ask(endpoint) => {
            let mut packet = Vec::new();
            device.wire().ask(endpoint, &mut packet);
            assert!(packet.len() <= PACKET_BYTES || endpoint & 0x7F == 0);
        }
        Act::ClearHalt(endpoint) => device.clear_halt(endpoint),
        Act::Reset => device.reset(),
        Act::Suspend => device.wire().suspend_bus(),
        Act::Resume => device.wire().resume_bus(),
        Act::Message(len) => {
            let message = message(len, len as u8);
            device.application().messages.push_back(message);
        }
        Act::Busy(busy) => device.application().busy = busy,
        Act::Run => device.run(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Whatever a host does, the device goes on, its memory is bounded, every byte is accounted for, and
    /// after a reset it is as new.
    #[test]
    fn no_host_disturbs_the_device(host in vec(acts(), 0..60), rude in any::<bool>()) {
        let script = Script { rude, ..Script::default() };
        with_device(script, |device| {
            let mut told = 0;
            for each in host {
                if let Act::Message(len) = each {
                    told += len;
                }
                act(device, each);
                device.run();
                prop_assert!(device.inbox().len() <= 1024);
            }
            device.application().busy = false;
            device.reset();
            transfers(device, TO_HOST, 4096);
            let counts = counts(device);
            prop_assert_eq!(counts.bytes_sent as usize + counts.bytes_dropped as usize, told);
            device.application().received.clear();
            device.application().messages = [message(128, 1)].into();
            prop_assert!(device.bulk_out(FROM_HOST, &[7; 65]));
            prop_assert_eq!(&device.application().received, &vec![7; 65]);
            prop_assert_eq!(transfers(device, TO_HOST, 4096), [message(128, 1)]);
            Ok(())
        })?;
    }

    /// Messages of any length, with a host that reads now and then and in transfers of any size: all
    /// bytes come in order.
    #[test]
    fn messages_arrive_whole(
        lens in vec(1_usize..700, 1..20),
        rooms in vec(1_usize..12, 1..10),
    ) {
        with_device(Script::default(), |device| {
            let messages: Vec<_> = lens.iter().map(|len| message(*len, *len as u8)).collect();
            device.application().messages = messages.clone().into();
            let mut received = Vec::new();
            let mut idle = 0;
            for room in rooms.iter().cycle() {
                let mut data = Vec::new();
                match device.bulk_in(TO_HOST, room * PACKET_BYTES, &mut data) {
                    Bulk::Data => received.extend(data),
                    _ => idle += 1,
                }
                if idle > 3 {
                    break;
                }
            }
            prop_assert_eq!(received, messages.concat());
            Ok(())
        })?;
    }
}
