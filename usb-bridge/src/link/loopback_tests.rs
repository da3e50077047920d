//! Tests of the in-process links.

use super::*;
use crate::peripheral::{Descriptors, Speed};

#[test]
fn what_is_sent_is_received_and_the_room_is_kept() {
    let (mut near, mut far) = pair(1000);
    let sender = thread::spawn(move || {
        for number in 0..2000u32 {
            near.send(&[number as u8; 777]).unwrap();
        }
        near
    });
    let mut got = 0;
    while got < 2000 * 777 {
        assert!(lock(&far.into.state).bytes <= 1000);
        match far.receive(Duration::from_secs(5)).unwrap() {
            Received::Bytes { bytes, .. } => {
                for (index, &byte) in bytes.iter().enumerate() {
                    assert_eq!(byte, ((got + index) / 777) as u8);
                }
                got += bytes.len();
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(far.receive(Duration::ZERO).unwrap(), Received::Nothing);
    drop(sender.join().unwrap());
    assert_eq!(far.receive(Duration::ZERO).unwrap(), Received::Ended);
    let told = far.send(&[1]).unwrap_err().to_string();
    assert_eq!(told, "far end: the other end is closed");
}

#[test]
fn more_than_the_room_goes_in_parts_and_a_stopped_reader_is_an_error() {
    let (mut near, far) = pair(10);
    near.set_patience(Duration::from_millis(20));
    near.send(&[7; 10]).unwrap();
    let told = near.send(&[7; 11]).unwrap_err().to_string();
    assert_eq!(told, "near end: has accepted no bytes for 0.02 s");
    assert_eq!(lock(&far.into.state).bytes, 10);
}

/// Answers a request with its value, and returns transfers that were prepared.
struct Prepared {
    descriptors: Descriptors,
    bulks: VecDeque<(Bulk, Vec<u8>)>,
}

impl Prepared {
    fn attach(bulks: impl IntoIterator<Item = (Bulk, Vec<u8>)>) -> Attachment {
        let mut device = vec![0; 18];
        (device[12], device[13], device[16]) = (0x34, 0x12, 1);
        Attachment::new(
            "camera",
            Box::new(Self {
                descriptors: Descriptors {
                    device,
                    configuration: Vec::new(),
                    bos: Vec::new(),
                    strings: vec!["S1".to_owned()],
                    speed: Speed::High,
                },
                bulks: bulks.into_iter().collect(),
            }),
        )
    }
}

impl Peripheral for Prepared {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, _data: &[u8], _length: usize) -> Reply {
        match request.request {
            1 => Reply::Data(request.value.to_le_bytes().to_vec()),
            _ => Reply::Stall,
        }
    }

    fn bulk_out(&mut self, endpoint: u8, _data: &[u8]) -> bool {
        endpoint == 1
    }

    fn bulk_in(&mut self, _endpoint: u8, _room: usize, data: &mut Vec<u8>) -> Bulk {
        let Some((bulk, bytes)) = self.bulks.pop_front() else {
            return Bulk::Wait;
        };
        data.extend(bytes);
        bulk
    }

    fn clear_halt(&mut self, _endpoint: u8) {}

    fn reset(&mut self) {}
}

const TRANSFERS: Transfers = Transfers {
    endpoint: 0x81,
    interface: 0,
    count: 4,
    bytes: 64,
    timeout: Duration::ZERO,
};

#[test]
fn a_device_without_a_bus_answers_streams_and_goes() {
    let attachment = Prepared::attach([
        (Bulk::Data, vec![1, 2]),
        (Bulk::Data, vec![]),
        (Bulk::Wait, vec![]),
        (Bulk::Data, vec![3]),
        (Bulk::Data, vec![0; 65]),
        (Bulk::Stall, vec![]),
        (Bulk::Data, vec![4]),
        (Bulk::Stall, vec![]),
        (Bulk::Stall, vec![]),
    ]);
    let mut control = attachment.control();
    assert_eq!(
        (control.release(), control.serial()),
        (0x1234, Some("S1".to_owned()))
    );
    let mut answer = [0; 8];
    let request = Request::vendor_in(1, 0x0201, 0);
    assert_eq!(control.control_in(request, &mut answer).unwrap(), 2);
    assert_eq!(answer[..2], [1, 2]);
    let refused = control.control_out(Request::vendor_out(9, 0, 0), &[]);
    assert!(
        refused
            .unwrap_err()
            .to_string()
            .contains("request 0x09: the device refused it")
    );

    let mut link = attachment.stream(&TRANSFERS);
    link.send(&[1]).unwrap();
    let mut told = Vec::new();
    let error = loop {
        match link.receive(Duration::from_millis(50)) {
            Ok(Received::Bytes { bytes, .. }) => told.push(format!("{bytes:?}")),
            Ok(Received::Lost { bytes, cause }) => told.push(format!("{cause:?} {bytes:?}")),
            Ok(other) => panic!("{other:?}"),
            Err(error) => break error,
        }
    };
    assert_eq!(
        told,
        [
            "[1, 2]",
            "[3]",
            "Overflow Some(65)",
            "Stalled None",
            "[4]",
            "Stalled None"
        ]
    );
    assert!(matches!(error, LinkError::Stalled { endpoint: 0x81, .. }));
    assert_eq!(link.receive(Duration::ZERO).unwrap(), Received::Nothing);
    attachment.unplug();
    let gone = link.receive(Duration::ZERO).unwrap_err();
    assert!(matches!(gone, LinkError::Unplugged { .. }));
    let gone = control.control_in(request, &mut answer).unwrap_err();
    assert!(matches!(gone, LinkError::Unplugged { .. }));
}

#[test]
fn a_drain_ends_when_it_is_quiet_or_takes_too_long() {
    let pieces = |count| (0..count).map(|_| (Bulk::Data, vec![0; 10]));
    let mut link = Prepared::attach(pieces(5)).stream(&TRANSFERS);
    let mut got = 0;
    let mut take = |received: &Received<'_>| {
        if let Received::Bytes { bytes, .. } = received {
            got += bytes.len();
        }
    };
    let (quiet, limit) = (Duration::from_millis(5), Duration::from_secs(5));
    assert!(crate::link::drain(&mut link, quiet, limit, &mut take).unwrap());
    let mut link = Prepared::attach(pieces(5)).stream(&TRANSFERS);
    assert!(!crate::link::drain(&mut link, quiet, Duration::ZERO, &mut take).unwrap());
    assert_eq!(got, 60);
}

/// Run with `cargo test --release -p usb-bridge loopback -- --ignored --nocapture`. For comparison, 50 million
/// events per second are 200 MB/s.
#[test]
#[ignore = "a measurement"]
fn speed_of_the_pair() {
    const BYTES: usize = 4 << 30;
    for piece in [4 << 10, 16 << 10, 128 << 10] {
        let (mut near, mut far) = pair(1 << 20);
        let started = Instant::now();
        let sender = thread::spawn(move || {
            let bytes = vec![1; piece];
            for _ in 0..BYTES / piece {
                near.send(&bytes).unwrap();
            }
        });
        let (mut got, mut sum) = (0, 0);
        while got < BYTES {
            if let Received::Bytes { bytes, .. } = far.receive(Duration::from_secs(5)).unwrap() {
                got += bytes.len();
                sum += u64::from(bytes[0]);
            }
        }
        sender.join().unwrap();
        let rate = BYTES as f64 / started.elapsed().as_secs_f64() / 1e6;
        println!("pieces of {piece} bytes: {rate:.0} MB/s ({sum} pieces)");
    }
}
