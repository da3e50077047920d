//! A trace is what Wireshark takes for transfers on USB, with their bytes.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use pcap_file::DataLink;
use pcap_file::pcapng::{Block, PcapNgReader};
use usb_bridge::link::control::{Control, Request};
use usb_bridge::link::faults::{Fault, Faults, Plan};
use usb_bridge::link::loopback::pair;
use usb_bridge::link::trace::{Place, Tracer};
use usb_bridge::link::{Link, LinkError, Received};

#[path = "../../../tests/peers/script.rs"]
mod peers;

const PLACE: Place = Place {
    bus: 3,
    address: 17,
    endpoint: 0x82,
};

/// Answers every request for bytes with 1, 2, 3, and refuses the request 9.
struct Answers;

impl Control for Answers {
    fn control_out(&mut self, request: Request, _data: &[u8]) -> Result<(), LinkError> {
        match request.request {
            9 => Err(LinkError::Failed {
                link: "answers".to_owned(),
                cause: "refused".to_owned(),
            }),
            _ => Ok(()),
        }
    }

    fn control_in(&mut self, _request: Request, data: &mut [u8]) -> Result<usize, LinkError> {
        data[..3].copy_from_slice(&[1, 2, 3]);
        Ok(3)
    }

    fn bulk_out(&mut self, _endpoint: u8, _data: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }

    fn bulk_in(&mut self, _endpoint: u8, _data: &mut [u8]) -> Result<usize, LinkError> {
        Ok(0)
    }

    fn clear_halt(&mut self, _endpoint: u8) -> Result<(), LinkError> {
        Ok(())
    }

    fn wait(&mut self, _duration: Duration) {}

    fn release(&self) -> u16 {
        0
    }

    fn serial(&mut self) -> Option<String> {
        None
    }

    fn name(&self) -> &str {
        "answers"
    }
}

/// A trace of a request each way, five transfers of the stream, the second of them lost, and one sent.
fn write(path: &Path) {
    let out = Box::new(fs::File::create(path).unwrap());
    let tracer = Tracer::new(out, PLACE, "usb 3-1 test").unwrap();
    let mut control = tracer.control(Answers);
    control
        .control_out(Request::vendor_out(0xBF, 3, 4), &[0, 0, 0, 1])
        .unwrap();
    let mut answer = [0; 64];
    assert_eq!(
        control
            .control_in(Request::vendor_in(0xBF, 6, 0), &mut answer)
            .unwrap(),
        3
    );
    control
        .control_out(Request::vendor_out(9, 0, 0), &[])
        .unwrap_err();

    let (mut near, far) = pair(1 << 20);
    for number in 0..5u8 {
        near.send(&vec![number; 1000 + usize::from(number)])
            .unwrap();
    }
    drop(near);
    let drops = Plan {
        faults_max: 1,
        ..Plan::none(1).with(Fault::Drop, 1.0)
    };
    let mut link = tracer.link(Faults::new(far, drops));
    let (mut pieces, mut losses) = (0, 0);
    loop {
        match link.receive(Duration::from_secs(1)).unwrap() {
            Received::Bytes { at, .. } => {
                assert!(at <= Instant::now());
                pieces += 1;
            }
            Received::Lost { .. } => losses += 1,
            Received::Nothing => panic!("nothing"),
            Received::Ended => break,
        }
    }
    assert_eq!((pieces, losses), (4, 1));
    assert!(link.send(b"E+\n").is_err());
    tracer.finish().unwrap();
}

#[test]
fn the_bytes_are_those_of_usbmon() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trace.pcapng");
    write(&path);
    let mut reader = PcapNgReader::new(fs::File::open(&path).unwrap()).unwrap();
    let mut packets = Vec::new();
    while let Some(block) = reader.next_block() {
        match block.unwrap() {
            Block::InterfaceDescription(interface) => {
                assert_eq!(interface.linktype, DataLink::USB_LINUX_MMAPPED);
            }
            Block::EnhancedPacket(packet) => {
                packets.push((packet.timestamp, packet.data.into_owned()));
            }
            other => panic!("{other:?}"),
        }
    }
    // A submission and a completion each: three requests, five transfers, one sent.
    assert_eq!(packets.len(), 2 * (3 + 5 + 1));
    let word = |data: &[u8], at: usize| u32::from_ne_bytes(data[at..at + 4].try_into().unwrap());
    for pair in packets.as_chunks::<2>().0 {
        let [(asked, submission), (ended, completion)] = pair;
        assert!(asked <= ended);
        assert_eq!((submission[8], completion[8]), (b'S', b'C'));
        assert_eq!(submission[..8], completion[..8], "the same transfer");
        for data in [submission, completion] {
            assert_eq!(
                (data[11], data[12..14].to_vec()),
                (17, 3u16.to_ne_bytes().to_vec())
            );
            assert_eq!(word(data, 36) as usize, data.len() - 64);
        }
    }
    let setup = &packets[0].1;
    assert_eq!(setup[9..11], [2, 0]);
    assert_eq!(setup[40..48], [0x40, 0xBF, 3, 0, 4, 0, 4, 0]);
    assert_eq!(setup[64..], [0, 0, 0, 1]);
    assert_eq!(packets[3].1[64..], [1, 2, 3]);
    let lost = &packets[7].1;
    assert_eq!((lost[9], lost[10], word(lost, 28) as i32), (3, 0x82, -71));
    let transfer = &packets[9].1;
    assert_eq!(
        (transfer[9], transfer[10], transfer.len()),
        (3, 0x82, 64 + 1001)
    );
    assert!(transfer[64..].iter().all(|&byte| byte == 1));
}

#[test]
fn wireshark_decodes_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trace.pcapng");
    write(&path);
    let fields = [
        "usb.urb_type",
        "usb.transfer_type",
        "usb.endpoint_address",
        "usb.bus_id",
        "usb.device_address",
        "usb.data_len",
        "usb.urb_status",
    ];
    let mut command = Command::new("tshark");
    command
        .args(["-T", "fields", "-E", "separator=,", "-r"])
        .arg(&path);
    for field in fields {
        command.args(["-e", field]);
    }
    let Ok(output) = command.output() else {
        eprintln!("skipped: no tshark");
        return;
    };
    assert!(output.status.success(), "{output:?}");
    check(&String::from_utf8(output.stdout).unwrap());
}

/// Checks a reader's lines of the packets: event, kind of transfer, endpoint, bus, device, length and status.
fn check(text: &str) {
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(lines.len(), 18, "{text}");
    assert_eq!(lines[0], "'S',0x02,0x00,3,17,4,-115");
    assert_eq!(lines[3], "'C',0x02,0x80,3,17,3,0");
    assert_eq!(lines[5], "'C',0x02,0x00,3,17,0,-32");
    assert_eq!(lines[7], "'C',0x03,0x82,3,17,0,-71");
    for (number, line) in (1..5).zip(lines[9..].iter().step_by(2)) {
        assert_eq!(*line, format!("'C',0x03,0x82,3,17,{},0", 1000 + number));
    }
    assert_eq!(lines[16], "'S',0x03,0x02,3,17,3,-115");
}

/// Independent readers of pcapng; `./test.sh peers` installs them.
mod formats_peers {
    use super::*;

    #[test]
    fn trace() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trace.pcapng");
        write(&path);
        if let Some(lines) = peers::run("trace.py", &[path.into_os_string()]) {
            check(&lines);
        }
    }
}
