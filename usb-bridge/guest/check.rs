//! The end-to-end test of simulated devices: a guest's kernel and libusb against this crate.
//!
//! `guest-check serve SOCKET` has the devices, one after the other, on the host;
//! `guest-check run` is the guest's side, which asks for the next one when it is done with one;
//! `guest-check usbip` has both in the guest, with the kernel's vhci-hcd between them;
//! `guest-check all` is both, in the guest.

#![expect(
    unsafe_code,
    reason = "transfers in flight are libusb's own C interface"
)]

mod queue;
mod vhci;

use std::os::unix::net::UnixListener;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{self, Sender};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use queue::Queue;
use rusb::{Context, DeviceHandle, UsbContext as _};
use usb_bridge::link::{Link, LinkError, Loss, Received};
use usb_bridge::peripheral::Speed;
use usb_bridge::peripheral::sequence::{self, Check, SequenceDevice};
use usb_bridge::peripheral::socket::{self, Change};
use usb_bridge::peripheral::usbredir::UsbRedir;

/// Bytes of a stream that a case reads.
const BYTES: u64 = 4 << 20;
/// Transfers in flight, and their bytes.
const TRANSFERS: (usize, usize) = (8, 64 << 10);
/// A device shows within this time, in an emulated machine.
const APPEARS: Duration = Duration::from_secs(30);
const CONTROL_TIME: Duration = Duration::from_secs(5);

/// A device and what the guest does with it.
struct Case {
    name: &'static str,
    device: fn() -> SequenceDevice,
    run: fn(&Arc<DeviceHandle<Context>>) -> Result<()>,
}

const CASES: &[Case] = &[
    Case {
        name: "high speed",
        device: || SequenceDevice::new(Speed::High),
        run: |handle| stream(handle, BYTES, 0, Duration::ZERO),
    },
    Case {
        name: "super speed",
        device: || SequenceDevice::new(Speed::Super),
        run: |handle| stream(handle, BYTES, 0, Duration::ZERO),
    },
    Case {
        name: "commands",
        device: || SequenceDevice::new(Speed::Super),
        run: commands,
    },
    Case {
        name: "data that is late",
        device: || SequenceDevice::new(Speed::High).pause(3),
        run: |handle| stream(handle, BYTES / 8, 0, Duration::ZERO),
    },
    Case {
        name: "slow host",
        device: || SequenceDevice::new(Speed::Super),
        run: |handle| stream(handle, BYTES / 2, 0, Duration::from_millis(20)),
    },
    Case {
        name: "stall",
        device: || SequenceDevice::new(Speed::Super).stall_at(1_000_012),
        run: |handle| stream(handle, BYTES / 2, 1, Duration::ZERO),
    },
    Case {
        name: "unplugged",
        device: || SequenceDevice::new(Speed::High),
        run: unplugged,
    },
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match arguments[..] {
        ["serve", path] => serve(path),
        ["run"] => run(),
        ["usbip"] => vhci::run(),
        ["all"] => run().and_then(|()| vhci::run()),
        _ => Err(anyhow::anyhow!(
            "usage: guest-check serve SOCKET | run | usbip | all"
        )),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("guest-check: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// The host's side: each device until the guest notes that it wants the next.
fn serve(path: &str) -> Result<()> {
    let listener = UnixListener::bind(path).with_context(|| path.to_owned())?;
    let (changes, cable) = mpsc::channel();
    // The receiver is here.
    let _ = changes.send(plug(0, &changes));
    let (mut socket, _) = listener.accept()?;
    let report = socket::serve(&mut socket, &mut UsbRedir::new(), &mut || {
        cable.try_recv().ok()
    })?;
    println!("{report:?}");
    ensure!(
        report.packets_odd == 0 && !report.is_rejected,
        "odd packets"
    );
    ensure!(report.traffic.bytes_overflown == 0, "bytes were lost");
    Ok(())
}

/// Plugs in the device of a case; a note of the guest replaces it by the next.
fn plug(number: usize, changes: &Sender<Change>) -> Change {
    let Some(case) = CASES.get(number) else {
        return Change::Unplug;
    };
    let changes = changes.clone();
    let device = (case.device)().named(case.name).on_note(move |note| {
        // Whoever has the other end of the channel has ended, otherwise.
        if note == b"next" {
            let _ = changes.send(plug(number + 1, &changes));
        }
    });
    Change::Plug(Box::new(device))
}

/// The guest's side.
fn run() -> Result<()> {
    for case in CASES {
        let started = Instant::now();
        let handle = open(case.name).context(case.name)?;
        let found = started.elapsed();
        (case.run)(&Arc::new(handle)).context(case.name)?;
        println!(
            "ok: {} (found after {} ms, took {} ms)",
            case.name,
            found.as_millis(),
            (started.elapsed() - found).as_millis()
        );
    }
    Ok(())
}

/// Opens the device with this product's name, when it has appeared.
fn open(name: &str) -> Result<DeviceHandle<Context>> {
    let until = Instant::now() + APPEARS;
    while Instant::now() < until {
        // A new one each time: libusb's udev backend sees what appears later only where udevd runs.
        for device in Context::new()?.devices()?.iter() {
            let descriptor = device.device_descriptor()?;
            let ids = (descriptor.vendor_id(), descriptor.product_id());
            if ids != (sequence::VENDOR, sequence::PRODUCT) {
                continue;
            }
            // The one before may still be leaving.
            let Ok(handle) = device.open() else { continue };
            let Ok(product) = handle.read_product_string_ascii(&descriptor) else {
                continue;
            };
            if product == name {
                let expected = if descriptor.usb_version().major() == 3 {
                    rusb::Speed::Super
                } else {
                    rusb::Speed::High
                };
                ensure!(device.speed() == expected, "speed {:?}", device.speed());
                handle.claim_interface(0)?;
                return Ok(handle);
            }
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    bail!("does not appear")
}

fn vendor_out(handle: &DeviceHandle<Context>, request: u8, data: &[u8]) -> Result<()> {
    let sent = handle.write_control(0x40, request, 0, 0, data, CONTROL_TIME)?;
    ensure!(sent == data.len(), "{sent} bytes of a request were sent");
    Ok(())
}

/// Asks the host for the next device, which unplugs this one.
fn next(handle: &DeviceHandle<Context>) {
    // The device may be gone before the request has its status.
    let _ = vendor_out(handle, sequence::NOTE, b"next");
}

/// Reads a stream until `bytes` have come, with `stalls` on the way.
fn stream(
    handle: &Arc<DeviceHandle<Context>>,
    bytes: u64,
    stalls: u32,
    pause: Duration,
) -> Result<()> {
    let mut queue = Queue::new(handle.clone(), sequence::STREAM, TRANSFERS.0, TRANSFERS.1)?;
    // Nothing comes before the start.
    ensure!(matches!(
        queue.receive(Duration::from_millis(50))?,
        Received::Nothing
    ));
    vendor_out(handle, sequence::START, &[])?;
    let mut check = Check::default();
    let mut stalls_found = 0;
    while check.bytes() < bytes {
        match queue.receive(Duration::from_secs(10))? {
            Received::Bytes { bytes, .. } => check.take(bytes),
            Received::Lost {
                cause: Loss::Stalled,
                ..
            } => stalls_found += 1,
            other => bail!("{other:?} after {} bytes", check.bytes()),
        }
        std::thread::sleep(pause);
    }
    ensure!(stalls_found == stalls, "{stalls_found} stalls");
    // What flows when the stream is held still comes, to the last byte.
    vendor_out(handle, sequence::STOP, &[])?;
    while let Received::Bytes { bytes, .. } = queue.receive(Duration::from_millis(200))? {
        check.take(bytes);
    }
    ensure!(
        check.is_good(),
        "byte {:?} of {} is wrong",
        check.first_wrong(),
        check.bytes()
    );
    let mut sent = [0; 8];
    handle.read_control(0xC0, sequence::SENT, 0, 0, &mut sent, CONTROL_TIME)?;
    let sent = u64::from_le_bytes(sent);
    ensure!(
        sent == check.bytes(),
        "{} of {sent} bytes came",
        check.bytes()
    );
    drop(queue);
    next(handle);
    Ok(())
}

/// Requests and bulk endpoints that carry commands.
fn commands(handle: &Arc<DeviceHandle<Context>>) -> Result<()> {
    let note: Vec<u8> = (0..64).collect();
    vendor_out(handle, sequence::NOTE, &note)?;
    let mut back = [0; 100];
    let length = handle.read_control(0xC0, sequence::NOTE, 0, 0, &mut back, CONTROL_TIME)?;
    ensure!(back[..length] == note[..], "the note came back otherwise");
    let refused = handle.write_control(0x40, 0x01, 0, 0, &[], CONTROL_TIME);
    ensure!(refused == Err(rusb::Error::Pipe), "refused: {refused:?}");
    for length in [1, 63, 64] {
        let sent = handle.write_bulk(sequence::COMMANDS, &note[..length], CONTROL_TIME)?;
        let come = handle.read_bulk(sequence::ANSWERS, &mut back, CONTROL_TIME)?;
        ensure!(
            sent == length && back[..come] == note[..length],
            "an answer differs"
        );
    }
    // Longer than the device takes: its endpoint halts until that is ended.
    let long = handle.write_bulk(sequence::COMMANDS, &[0; 65], CONTROL_TIME);
    ensure!(long == Err(rusb::Error::Pipe), "{long:?}");
    let halted = handle.write_bulk(sequence::COMMANDS, &[1], CONTROL_TIME);
    ensure!(halted == Err(rusb::Error::Pipe), "{halted:?}");
    handle.clear_halt(sequence::COMMANDS)?;
    handle.write_bulk(sequence::COMMANDS, &[1], CONTROL_TIME)?;
    let come = handle.read_bulk(sequence::ANSWERS, &mut back, CONTROL_TIME)?;
    ensure!(back[..come] == [1], "an answer differs");
    // Taken back while it waits, and asked for again.
    let late = handle.read_bulk(sequence::ANSWERS, &mut back, Duration::from_millis(50));
    ensure!(late == Err(rusb::Error::Timeout), "{late:?}");
    handle.write_bulk(sequence::COMMANDS, &[2], CONTROL_TIME)?;
    let come = handle.read_bulk(sequence::ANSWERS, &mut back, CONTROL_TIME)?;
    ensure!(back[..come] == [2], "an answer differs");
    next(handle);
    Ok(())
}

/// The device leaves in the middle of its stream.
fn unplugged(handle: &Arc<DeviceHandle<Context>>) -> Result<()> {
    let mut queue = Queue::new(handle.clone(), sequence::STREAM, TRANSFERS.0, TRANSFERS.1)?;
    vendor_out(handle, sequence::START, &[])?;
    let mut check = Check::default();
    let mut is_asked = false;
    loop {
        match queue.receive(Duration::from_secs(10)) {
            Ok(Received::Bytes { bytes, .. }) => check.take(bytes),
            Err(LinkError::Unplugged { .. }) => break,
            other => bail!("{other:?} after {} bytes", check.bytes()),
        }
        if check.bytes() > BYTES / 4 && !is_asked {
            is_asked = true;
            next(handle);
        }
    }
    ensure!(
        is_asked && check.is_good(),
        "wrong: {:?}",
        check.first_wrong()
    );
    Ok(())
}
