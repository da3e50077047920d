//! USB/IP without a kernel: the host's side of the protocol.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use proptest::prelude::*;
use usb_bridge::peripheral::Speed;
use usb_bridge::peripheral::attached::ROOM_MAX;
use usb_bridge::peripheral::sequence::{self, Check, SequenceDevice};
use usb_bridge::peripheral::server::{Service, serve_usbip};
use usb_bridge::peripheral::socket::{OUTPUT_MAX, Session as _};
use usb_bridge::peripheral::usbip::{BUS_ID, DATA_MAX, UsbIp};
use usb_bridge::stop::Stop;

/// Header of a packet: command, number, direction, endpoint, flags or number, length, request.
fn packet(command: u32, number: u32, is_in: bool, endpoint: u32, more: [u32; 2]) -> Vec<u8> {
    let words = [command, number, 1 << 16 | 2, u32::from(is_in), endpoint];
    let all = words.iter().chain(&more).chain(&[0; 3]);
    let mut bytes: Vec<u8> = all.flat_map(|word| word.to_be_bytes()).collect();
    bytes.extend([0; 8]);
    bytes
}

fn request(number: u32, setup: [u8; 8], data: &[u8]) -> Vec<u8> {
    let is_in = setup[0] & 0x80 != 0;
    let length = u32::from(u16::from_le_bytes([setup[6], setup[7]]));
    let mut bytes = packet(1, number, is_in, 0, [0, length]);
    bytes[40..48].copy_from_slice(&setup);
    bytes.extend(data);
    bytes
}

fn read_from(number: u32, length: u32) -> Vec<u8> {
    packet(
        1,
        number,
        true,
        u32::from(sequence::STREAM & 15),
        [0, length],
    )
}

const CONFIGURE: [u8; 8] = [0, 9, 1, 0, 0, 0, 0, 0];
const START: [u8; 8] = [0x40, sequence::START, 0, 0, 0, 0, 0, 0];

/// Command, number, status, data of every answer; `in_of` tells which numbers have data.
fn answers(bytes: &[u8], in_of: &dyn Fn(u32) -> bool) -> Vec<(u32, u32, i32, Vec<u8>)> {
    let mut all = Vec::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let word = |at: usize| u32::from_be_bytes(rest[4 * at..4 * at + 4].try_into().unwrap());
        let length = if word(0) == 3 && in_of(word(1)) {
            word(6) as usize
        } else {
            0
        };
        let data = rest[48..48 + length].to_vec();
        all.push((word(0), word(1), word(5).cast_signed(), data));
        rest = &rest[48 + length..];
    }
    all
}

fn run(session: &mut UsbIp, bytes: &[u8]) -> Vec<(u32, u32, i32, Vec<u8>)> {
    session.receive(bytes);
    while session.step().expect("a good host") {}
    let output = std::mem::take(session.output());
    answers(&output, &|number| number >= 100)
}

#[test]
fn transfers_wait_are_unlinked_and_end() {
    let mut session = UsbIp::new(Box::new(SequenceDevice::new(Speed::High)));
    assert_eq!(
        run(&mut session, &request(1, CONFIGURE, &[])),
        [(3, 1, 0, vec![])]
    );
    for number in 100..103 {
        assert_eq!(run(&mut session, &read_from(number, 512)), []);
    }
    // One that may not end short is unlinked as well.
    let strict = packet(1, 103, true, 2, [1, 512]);
    assert_eq!(run(&mut session, &strict), []);
    let unlink = |number| packet(2, 50, false, 0, [number, 0]);
    assert_eq!(run(&mut session, &unlink(101)), [(4, 50, -104, vec![])]);
    assert_eq!(run(&mut session, &unlink(103)), [(4, 50, -104, vec![])]);
    assert_eq!(run(&mut session, &unlink(101)), [(4, 50, 0, vec![])]);
    let ended = run(&mut session, &request(2, START, &[]));
    let numbers: Vec<u32> = ended.iter().map(|answer| answer.1).collect();
    assert_eq!(numbers, [2, 100, 102]);
    let mut check = Check::default();
    ended.iter().for_each(|answer| check.take(&answer.3));
    assert_eq!((check.bytes(), check.is_good()), (1024, true));
}

#[test]
fn requests_are_answered_or_refused() {
    let mut session = UsbIp::new(Box::new(SequenceDevice::new(Speed::Super)));
    let device = run(
        &mut session,
        &request(100, [0x80, 6, 0, 1, 0, 0, 64, 0], &[]),
    );
    assert_eq!((device[0].2, device[0].3.len()), (0, 18));
    let note = [0x40, sequence::NOTE, 0, 0, 0, 0, 3, 0];
    assert_eq!(run(&mut session, &request(1, note, &[1, 2, 3]))[0].2, 0);
    let ask = [0xC0, sequence::NOTE, 0, 0, 0, 0, 9, 0];
    assert_eq!(run(&mut session, &request(101, ask, &[]))[0].3, [1, 2, 3]);
    let unknown = [0xC0, 0, 0, 0, 0, 0, 9, 0];
    assert_eq!(run(&mut session, &request(102, unknown, &[]))[0].2, -32);
    // Without a configuration there are no endpoints.
    assert_eq!(run(&mut session, &read_from(103, 512))[0].2, -32);
    run(&mut session, &request(1, CONFIGURE, &[]));
    let mut command = packet(1, 3, false, u32::from(sequence::COMMANDS), [0, 3]);
    command.extend([7, 8, 9]);
    assert_eq!(run(&mut session, &command)[0].2, 0);
    let answer = packet(1, 104, true, u32::from(sequence::ANSWERS & 15), [1, 64]);
    // Short where that is an error, with what came.
    assert_eq!(run(&mut session, &answer), [(3, 104, -121, vec![7, 8, 9])]);
}

#[test]
fn what_cannot_be_meant_ends_the_connection() {
    let refused = |bytes: &[u8]| {
        let mut session = UsbIp::new(Box::new(SequenceDevice::new(Speed::High)));
        session.receive(bytes);
        session.step().is_err()
    };
    assert!(refused(&packet(7, 1, false, 0, [0, 0])));
    assert!(refused(&packet(1, 1, false, 1, [0, DATA_MAX as u32 + 1])));
    let mut isochronous = packet(1, 1, true, 1, [0, 0]);
    isochronous[32..36].copy_from_slice(&5000_u32.to_be_bytes());
    assert!(refused(&isochronous));
}

/// Sends an operation and reads what comes until the end, or `length` bytes.
fn operate(
    address: SocketAddr,
    operation: u16,
    more: &[u8],
    length: usize,
) -> (TcpStream, Vec<u8>) {
    let mut socket = TcpStream::connect(address).expect("a listener");
    let mut bytes = vec![1, 0x11];
    bytes.extend(operation.to_be_bytes());
    bytes.extend([0; 4]);
    bytes.extend(more);
    socket.write_all(&bytes).expect("taken");
    let mut answer = vec![0; length];
    socket.read_exact(&mut answer).expect("an answer");
    (socket, answer)
}

#[test]
fn one_host_has_the_device_and_others_are_told() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let stop = Stop::default();
    let mut reports = Vec::new();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut service = Service {
                device: &mut || Ok(Box::new(SequenceDevice::new(Speed::Super))),
                stop: &stop,
                once: false,
                left: &mut |report| reports.push(report.as_ref().map(|one| one.traffic).ok()),
            };
            serve_usbip(&listener, &mut service).expect("in order");
        });
        let mut bus_id = [0; 32];
        bus_id[..BUS_ID.len()].copy_from_slice(BUS_ID.as_bytes());
        for _ in 0..2 {
            let (_, list) = operate(address, 0x8005, &[], 8 + 4 + 312 + 4);
            assert_eq!(list[8..12], [0, 0, 0, 1]);
            assert_eq!(list[12 + 296..12 + 300], [0, 0, 0, 5]);
            assert_eq!(list[12 + 300..12 + 304], [0x12, 0x09, 0, 1]);
            let (mut socket, import) = operate(address, 0x8003, &bus_id, 8 + 312);
            assert_eq!(import[..8], [1, 0x11, 0, 3, 0, 0, 0, 0]);
            assert_eq!(operate(address, 0x8003, &bus_id, 8).1[7], 2);
            assert_eq!(operate(address, 0x8003, &[0; 32], 8).1[7], 4);
            for bytes in [
                request(1, CONFIGURE, &[]),
                request(2, START, &[]),
                read_from(3, 4096),
            ] {
                socket.write_all(&bytes).expect("taken");
            }
            let mut answers = [0; 3 * 48 + 4096];
            socket.read_exact(&mut answers).expect("answers");
            let mut check = Check::default();
            check.take(&answers[3 * 48..]);
            assert!(check.is_good());
            drop(socket);
            std::thread::sleep(Duration::from_millis(200));
        }
        let mut other = TcpStream::connect(address).expect("a listener");
        other.write_all(b"GET / HTTP/1.1\r\n\r\n").expect("taken");
        assert_eq!(other.read(&mut [0; 8]).unwrap_or(0), 0);
        stop.ask();
    });
    let bytes: Vec<_> = reports
        .iter()
        .map(|one| one.map(|one| one.bytes_in))
        .collect();
    assert_eq!(bytes, [Some(4096), Some(4096), None]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn every_packet_of_a_hostile_host_is_survived(
        packets in prop::collection::vec(
            (1_u32..3, 0_u32..8, any::<bool>(), 0_u32..20, any::<[u32; 2]>(), any::<[u8; 8]>(), 0_u32..40),
            0..60,
        ),
        noise in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let mut session = UsbIp::new(Box::new(SequenceDevice::new(Speed::High).pause(1)));
        let mut bytes = request(1, CONFIGURE, &[]);
        bytes.extend(request(2, START, &[]));
        for (command, number, is_in, endpoint, [more, length], setup, shift) in packets {
            let length = length >> shift.min(31);
            let length = if is_in { length } else { length % 100 };
            let mut one = packet(command, number, is_in, endpoint % 17, [more >> shift.min(31), length]);
            one[40..48].copy_from_slice(&setup);
            let data = if is_in || command == 2 { 0 } else { length as usize };
            one.extend(vec![7; data]);
            bytes.extend(one);
        }
        bytes.extend(noise);
        for now in bytes.chunks(97) {
            session.receive(now);
            while session.output().len() < OUTPUT_MAX {
                match session.step() {
                    Ok(true) => {}
                    Ok(false) => break,
                    Err(_) => return Ok(()),
                }
            }
            prop_assert!(session.output().len() < OUTPUT_MAX + ROOM_MAX + (1 << 17));
            session.output().clear();
        }
    }
}
