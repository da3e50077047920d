//! USB/IP inside the guest: this crate serves a device over TCP, and the kernel's vhci-hcd imports it.
//!
//! Unlike QEMU's xHCI, vhci-hcd loses nothing when transfers are cancelled. `capture` cancels transfers here in
//! every pause of a camera.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::fd::AsRawFd as _;
use std::sync::mpsc::{self, Receiver};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use eecvs_nostd::Sensor;
use usb_bridge::device::{Due, Stream, find};
use usb_bridge::peripheral::socket::{self, Change, Report};
use usb_bridge::peripheral::usbip::{self, Operation, UsbIp};
use usb_bridge::peripheral::{Descriptors, Peripheral, Speed};

use super::digest::Digest;
use super::{APPEARS, CASES, capture, open, plan};

/// File through which the kernel takes over a socket.
const ATTACH: &str = "/sys/devices/platform/vhci_hcd.0/attach";

/// A device that the kernel has imported, until the connection ends.
struct Imported {
    // The kernel holds its own reference to the connection.
    _client: TcpStream,
    served: JoinHandle<Result<Report>>,
}

impl Imported {
    fn new(device: Box<dyn Peripheral>, cable: Receiver<Change>) -> Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let client = TcpStream::connect(listener.local_addr()?)?;
        let server = listener.accept()?.0;
        let descriptors = device.descriptors().clone();
        let mut server = thread::scope(|scope| {
            let served = scope.spawn(|| import(server, &descriptors));
            ask(&client)?;
            served.join().expect("the server's thread")
        })?;
        // Ports 0 to 7 are for USB 2, the next eight for USB 3.
        let (port, speed) = match descriptors.speed {
            Speed::Super => (8, 5),
            _ => (0, 3),
        };
        let line = format!("{port} {} {} {speed}", client.as_raw_fd(), 1 << 16 | 2);
        std::fs::write(ATTACH, line).context(ATTACH)?;
        let served = thread::spawn(move || {
            let mut session = UsbIp::new(device);
            socket::serve(&mut server, &mut session, &mut || cable.try_recv().ok())
        });
        Ok(Self {
            _client: client,
            served,
        })
    }

    fn end(self) -> Result<Report> {
        let report = self.served.join().expect("the server's thread")?;
        ensure!(report.packets_odd == 0, "{report:?}");
        Ok(report)
    }
}

/// Runs every case on its own connection, and then a camera.
pub fn run() -> Result<()> {
    for case in CASES {
        let (changes, cable) = mpsc::channel();
        let device = (case.device)().named(case.name).on_note(move |note| {
            // The kernel may have left before.
            if note == b"next" {
                let _ = changes.send(Change::End);
            }
        });
        let imported = Imported::new(Box::new(device), cable).context(case.name)?;
        let device = open(case.name).context(case.name)?;
        (case.run)(&device).context(case.name)?;
        drop(device);
        imported.end().context(case.name)?;
        println!("ok: USB/IP: {}", case.name);
    }
    let told = camera().context("USB/IP: a camera that pauses")?;
    println!("ok: USB/IP: a camera that pauses: {told}");
    Ok(())
}

/// Checks that every event arrives from a camera whose pauses are longer than the timeout of transfers.
fn camera() -> Result<String> {
    let sensor = Sensor::new(346, 260).context("a sensor")?;
    let model = find("davis346").context("a model")?;
    let events = plan::scene(sensor, 50_000);
    let mut bytes = Vec::new();
    let mut writer = model.writer(sensor).context("it fits")?;
    writer.write(&events, &mut bytes)?;
    writer.finish(&mut bytes)?;
    let stream = Bursts {
        bytes,
        at: 0,
        due: Instant::now(),
    };
    let camera = model.camera(sensor, Box::new(stream)).context("it fits")?;
    let mut sent = Digest::default();
    sent.take(&events);
    let (changes, cable) = mpsc::channel();
    let imported = Imported::new(camera, cable)?;
    let id = attached_name()?;
    let told = capture::capture(&id, model.name(), &sent)?;
    // The kernel may have left before.
    let _ = changes.send(Change::End);
    let taken_back = imported.end()?.traffic.cancelled;
    ensure!(
        taken_back > 10,
        "only {taken_back} transfers were cancelled"
    );
    Ok(format!("{told}, {taken_back} transfers cancelled"))
}

/// Waits for the device on vhci-hcd's USB 2 or USB 3 bus and returns its name.
fn attached_name() -> Result<String> {
    let on_vhci = |entry: &std::fs::DirEntry| {
        let target = std::fs::canonicalize(entry.path()).unwrap_or_default();
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_port = name.contains('-') && !name.contains(':');
        (is_port && target.to_string_lossy().contains("vhci_hcd")).then_some(name)
    };
    let until = Instant::now() + APPEARS;
    loop {
        let found = std::fs::read_dir("/sys/bus/usb/devices")?
            .flatten()
            .find_map(|entry| on_vhci(&entry));
        if let Some(name) = found {
            return Ok(format!("usb:{name}"));
        }
        ensure!(Instant::now() < until, "the device does not appear");
        thread::sleep(Duration::from_millis(50));
    }
}

/// A stream that pauses after every burst.
struct Bursts {
    bytes: Vec<u8>,
    at: usize,
    due: Instant,
}

impl Stream for Bursts {
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> Result<Due> {
        const BURST: usize = 50_001;
        if self.at.is_multiple_of(BURST) && Instant::now() < self.due {
            return Ok(Due::More);
        }
        let end = (self.at / BURST + 1) * BURST;
        let end = end.min(self.at + room).min(self.bytes.len());
        bytes.extend_from_slice(&self.bytes[self.at..end]);
        self.at = end;
        self.due = Instant::now() + Duration::from_millis(250);
        let is_over = end == self.bytes.len();
        Ok(if is_over { Due::Ended } else { Due::More })
    }
}

/// Answers an import, as the server.
fn import(mut server: TcpStream, descriptors: &Descriptors) -> Result<TcpStream> {
    let done = usbip::operation(&mut server, descriptors, true)?;
    ensure!(done == Operation::Imported, "{done:?}");
    Ok(server)
}

/// Requests an import, as the client.
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
