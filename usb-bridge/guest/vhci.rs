//! USB/IP inside the guest: this crate serves a device over TCP, the kernel's vhci-hcd imports it.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::fd::AsRawFd as _;
use std::sync::mpsc;

use anyhow::{Context as _, Result, ensure};
use usb_bridge::peripheral::sequence::SequenceDevice;
use usb_bridge::peripheral::usbip::{self, Operation, UsbIp};
use usb_bridge::peripheral::{Peripheral as _, socket};

use super::{CASES, open};

/// Where the kernel takes a socket over.
const ATTACH: &str = "/sys/devices/platform/vhci_hcd.0/attach";

/// Runs every case with a connection of its own.
pub fn run() -> Result<()> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    for case in CASES {
        let (changes, cable) = mpsc::channel();
        let device = (case.device)().named(case.name).on_note(move |note| {
            // The kernel may have left before.
            if note == b"next" {
                let _ = changes.send(socket::Change::End);
            }
        });
        let client = TcpStream::connect(address)?;
        let server = listener.accept()?.0;
        let device = std::thread::scope(|scope| {
            let served = scope.spawn(|| import(server, device));
            ask(&client)?;
            served.join().expect("the server's thread")
        });
        let (mut server, device) = device.context(case.name)?;
        // Ports 0 to 7 are those of USB 2, the next eight those of USB 3.
        let (port, speed) = match device.descriptors().speed {
            usb_bridge::peripheral::Speed::Super => (8, 5),
            _ => (0, 3),
        };
        let line = format!("{port} {} {} {speed}", client.as_raw_fd(), 1 << 16 | 2);
        std::fs::write(ATTACH, line).context(ATTACH)?;
        let served = std::thread::spawn(move || {
            let mut session = UsbIp::new(Box::new(device));
            socket::serve(&mut server, &mut session, &mut || cable.try_recv().ok())
        });
        let device = open(case.name).context(case.name)?;
        (case.run)(&device).context(case.name)?;
        let report = served.join().expect("the server's thread")?;
        ensure!(report.packets_odd == 0, "{report:?}");
        println!("ok: USB/IP: {}", case.name);
    }
    Ok(())
}

/// The server's end of an import.
fn import(mut server: TcpStream, device: SequenceDevice) -> Result<(TcpStream, SequenceDevice)> {
    let done = usbip::operation(&mut server, device.descriptors(), true)?;
    ensure!(done == Operation::Imported, "{done:?}");
    Ok((server, device))
}

/// The client's end of an import.
fn ask(mut client: &TcpStream) -> Result<()> {
    let mut bytes = [0; 40];
    bytes[..8].copy_from_slice(&[1, 0x11, 0x80, 3, 0, 0, 0, 0]);
    bytes[8..11].copy_from_slice(usbip::BUS_ID.as_bytes());
    client.write_all(&bytes)?;
    let mut answer = [0; 8 + 312];
    client.read_exact(&mut answer)?;
    ensure!(
        answer[..8] == [1, 0x11, 0, 3, 0, 0, 0, 0],
        "{:?}",
        &answer[..8]
    );
    Ok(())
}
