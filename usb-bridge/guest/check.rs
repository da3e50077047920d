//! The end-to-end test of simulated devices: a guest's kernel and libusb against this crate.
//!
//! - `guest-check serve SOCKET` serves the devices one after the other, on the host.
//! - `guest-check run` is the guest's side, which requests the next device when it is done with one.
//! - `guest-check usbip` runs both sides in the guest, with the kernel's vhci-hcd between them.
//! - `guest-check scenes FOLDER` writes a scene for every model, and a plan (plan.rs).
//! - `guest-check recordings DATA [MODEL|MODEL:RECORDING]...` prints a plan of recordings.
//! - `guest-check captures PORT MODEL NAME DIGEST ...` captures in the guest what was planned.
//! - `guest-check all PORT MODEL NAME DIGEST ...` runs everything that the guest does, in order.

mod cable;
mod capture;
mod digest;
mod plan;
mod recordings;
mod vhci;

use std::os::unix::net::UnixListener;
use std::process::ExitCode;
use std::sync::mpsc::{self, Sender};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use usb_bridge::device::Transfers;
use usb_bridge::link::control::{Control, Request};
use usb_bridge::link::usb::{Bus, Device, UsbLink};
use usb_bridge::link::{Link as _, LinkError, Loss, Received};
use usb_bridge::peripheral::Speed;
use usb_bridge::peripheral::sequence::{self, Check, SequenceDevice};
use usb_bridge::peripheral::socket::{self, Change};
use usb_bridge::peripheral::usbredir::UsbRedir;

/// Bytes of a stream that a case reads.
const BYTES: u64 = 4 << 20;
/// How the stream is read. The device ends its transfers itself when it pauses, so none is cancelled.
const TRANSFERS: Transfers = Transfers {
    endpoint: sequence::STREAM,
    interface: 0,
    count: 8,
    bytes: 64 << 10,
    timeout: Duration::ZERO,
};
/// Time within which a device appears in an emulated machine, and within which bytes of a stream follow each other, on a
/// host that is busy with other things.
const APPEARS: Duration = Duration::from_secs(120);
/// Time after which nothing that was in flight still arrives.
const SETTLED: Duration = Duration::from_secs(1);

/// A device, and what the guest does with it.
struct Case {
    name: &'static str,
    device: fn() -> SequenceDevice,
    run: fn(&Device) -> Result<()>,
}

const CASES: &[Case] = &[
    Case {
        name: "high speed",
        device: || SequenceDevice::new(Speed::High),
        run: |device| stream(device, BYTES, 0, Duration::ZERO),
    },
    Case {
        name: "super speed",
        device: || SequenceDevice::new(Speed::Super),
        run: |device| stream(device, BYTES, 0, Duration::ZERO),
    },
    Case {
        name: "commands",
        device: || SequenceDevice::new(Speed::Super),
        run: commands,
    },
    Case {
        name: "data that is late",
        device: || SequenceDevice::new(Speed::High).pause(3),
        run: |device| stream(device, BYTES / 8, 0, Duration::ZERO),
    },
    Case {
        name: "slow host",
        device: || SequenceDevice::new(Speed::Super),
        run: |device| stream(device, BYTES / 2, 0, Duration::from_millis(20)),
    },
    Case {
        name: "stall",
        device: || SequenceDevice::new(Speed::Super).stall_at(1_000_012),
        run: |device| stream(device, BYTES / 2, 1, Duration::ZERO),
    },
    Case {
        name: "unplugged",
        device: || SequenceDevice::new(Speed::High),
        run: unplugged,
    },
];

fn main() -> ExitCode {
    // An argument that is not UTF-8 is none of those below.
    let arguments = std::env::args_os().skip(1);
    let arguments: Vec<String> = arguments
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match arguments[..] {
        ["serve", path] => serve(path),
        ["run"] => run().and_then(|()| cable::run()),
        ["usbip"] => vhci::run(),
        ["scenes", folder] => plan::scenes(folder),
        ["recordings", data, ref chosen @ ..] => plan::recordings(data, chosen),
        ["captures", ref wanted @ ..] => capture::all(wanted),
        ["all", ref wanted @ ..] => run()
            .and_then(|()| cable::run())
            .and_then(|()| vhci::run())
            .and_then(|()| capture::all(wanted)),
        _ => Err(anyhow::anyhow!(
            "usage: guest-check serve SOCKET | run | usbip | scenes FOLDER | \
             recordings DATA [MODEL|MODEL:RECORDING]... | all|captures PORT MODEL NAME DIGEST ..."
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

/// Serves, on the host, each device until the guest requests the next one with a note.
fn serve(path: &str) -> Result<()> {
    let listener = UnixListener::bind(path).with_context(|| path.to_owned())?;
    let (changes, cable) = mpsc::channel();
    // The receiver still exists here, so this cannot fail.
    let _ = changes.send(plug(0, &changes));
    let (mut socket, _) = listener.accept()?;
    let report = socket::serve(&mut socket, &mut UsbRedir::new(), &mut || {
        cable.try_recv().ok()
    })?;
    println!("{report:?}");
    ensure!(
        report.packets_odd == 0 && !report.is_rejected,
        "the host sent packets that are not understood, or refused the device"
    );
    ensure!(report.traffic.bytes_overflown == 0, "bytes were lost");
    Ok(())
}

/// Plugs in the device of a case; a note from the guest replaces it by the next device.
fn plug(number: usize, changes: &Sender<Change>) -> Change {
    let to = changes.clone();
    let next = move || {
        // The channel is closed only if the other thread has ended.
        let _ = to.send(plug(number + 1, &to));
    };
    if let Some(case) = CASES.get(number) {
        let device = (case.device)().named(case.name).on_note(move |note| {
            if note == b"next" {
                next();
            }
        });
        return Change::Plug(Box::new(device));
    }
    match cable::CASES.get(number - CASES.len()) {
        Some(case) => Change::Plug(Box::new(case.director(changes.clone(), next))),
        None => Change::Unplug,
    }
}

/// Runs the guest's side of every case.
fn run() -> Result<()> {
    for case in CASES {
        let started = Instant::now();
        let device = open(case.name).context(case.name)?;
        let found = started.elapsed();
        (case.run)(&device).context(case.name)?;
        println!(
            "ok: {} (found after {} ms, took {} ms)",
            case.name,
            found.as_millis(),
            (started.elapsed() - found).as_millis()
        );
    }
    Ok(())
}

/// Waits for the device with this product name and opens it.
fn open(name: &str) -> Result<Device> {
    let until = Instant::now() + APPEARS;
    while Instant::now() < until {
        let found = Bus::new()?
            .all()?
            .into_iter()
            .find(|one| one.product_name.as_deref() == Some(name));
        // The kernel may not have created the device's file yet.
        if let Some(device) = found.and_then(|one| one.open(0).ok()) {
            return Ok(device);
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    bail!("the device does not appear")
}

fn vendor_out(device: &Device, request: u8, data: &[u8]) -> Result<(), LinkError> {
    let request = Request::vendor_out(request, 0, 0);
    device.control().control_out(request, data)
}

/// Requests the next device from the host, which unplugs this one.
fn next(device: &Device) {
    // The device may leave before the request completes.
    let _ = vendor_out(device, sequence::NOTE, b"next");
}

/// Reads a stream until `bytes` bytes have arrived, and expects `stalls` stalls on the way.
fn stream(device: &Device, bytes: u64, stalls: u32, pause: Duration) -> Result<()> {
    let mut link: UsbLink = device.stream(&TRANSFERS)?;
    // Nothing arrives before the start.
    ensure!(matches!(
        link.receive(Duration::from_millis(50))?,
        Received::Nothing
    ));
    vendor_out(device, sequence::START, &[])?;
    let mut check = Check::default();
    let mut stalls_found = 0;
    while check.bytes() < bytes {
        match link.receive(APPEARS)? {
            Received::Bytes { bytes, .. } => check.take(bytes),
            Received::Lost {
                cause: Loss::Stalled,
                ..
            } => stalls_found += 1,
            other => bail!("{other:?} after {} bytes", check.bytes()),
        }
        std::thread::sleep(pause);
    }
    ensure!(
        stalls_found == stalls,
        "{stalls_found} stalls, expected {stalls}"
    );
    // What was in flight when the stream was stopped still arrives, to the last byte.
    vendor_out(device, sequence::STOP, &[])?;
    while let Received::Bytes { bytes, .. } = link.receive(SETTLED)? {
        check.take(bytes);
    }
    ensure!(
        check.is_good(),
        "byte {:?} of {} is wrong",
        check.first_wrong(),
        check.bytes()
    );
    let mut sent = [0; 8];
    let asked = Request::vendor_in(sequence::SENT, 0, 0);
    device.control().control_in(asked, &mut sent)?;
    let sent = u64::from_le_bytes(sent);
    ensure!(
        sent == check.bytes(),
        "{} of {sent} bytes arrived",
        check.bytes()
    );
    drop(link);
    next(device);
    Ok(())
}

/// Checks control requests, and bulk endpoints that carry commands.
fn commands(device: &Device) -> Result<()> {
    let mut control = device.control();
    let note: Vec<u8> = (0..64).collect();
    vendor_out(device, sequence::NOTE, &note)?;
    let mut back = [0; 100];
    let length = control.control_in(Request::vendor_in(sequence::NOTE, 0, 0), &mut back)?;
    ensure!(back[..length] == note[..], "the note came back changed");
    ensure!(
        vendor_out(device, 0x01, &[]).is_err(),
        "an unknown request was not refused"
    );
    let mut echo = |control: &mut dyn Control, bytes: &[u8]| -> Result<()> {
        control.bulk_out(sequence::COMMANDS, bytes)?;
        let come = control.bulk_in(sequence::ANSWERS, &mut back)?;
        ensure!(back[..come] == *bytes, "an answer differs from the command");
        Ok(())
    };
    for length in [1, 63, 64] {
        echo(&mut control, &note[..length])?;
    }
    // More than the device accepts: its endpoint halts until the halt is cleared.
    let long = control.bulk_out(sequence::COMMANDS, &[0; 65]);
    ensure!(long.is_err(), "{long:?}");
    let halted = control.bulk_out(sequence::COMMANDS, &[1]);
    ensure!(halted.is_err(), "{halted:?}");
    control.clear_halt(sequence::COMMANDS)?;
    echo(&mut control, &[1])?;
    // A transfer that is cancelled while it waits, and then requested again.
    let late = control.bulk_in(sequence::ANSWERS, &mut [0; 64]);
    ensure!(late.is_err(), "{late:?}");
    echo(&mut control, &[2])?;
    next(device);
    Ok(())
}

/// Checks that unplugging a device in the middle of its stream is reported.
fn unplugged(device: &Device) -> Result<()> {
    let mut link: UsbLink = device.stream(&TRANSFERS)?;
    vendor_out(device, sequence::START, &[])?;
    let mut check = Check::default();
    let mut is_asked = false;
    // Where the transfer began whose bytes came last, and whether it is reported as damaged.
    let (mut last, mut is_cut) = (0, false);
    loop {
        match link.receive(APPEARS) {
            Ok(Received::Bytes { bytes, .. }) => {
                (last, is_cut) = (check.bytes(), false);
                check.take(bytes);
            }
            // The transfer that the pull has cut, where the kernel reports it before the device's end.
            Ok(Received::Lost { .. }) if is_asked => is_cut = true,
            Err(LinkError::Unplugged { .. }) => break,
            other => bail!("{other:?} after {} bytes", check.bytes()),
        }
        if check.bytes() > BYTES / 4 && !is_asked {
            is_asked = true;
            next(device);
        }
    }
    // USB/IP's driver gives a transfer back at its whole length where the connection ended amid its bytes.
    let is_of_cut = |at: u64| is_cut && at >= last;
    ensure!(
        is_asked && check.first_wrong().is_none_or(is_of_cut),
        "the first wrong byte: {:?}",
        check.first_wrong()
    );
    Ok(())
}
