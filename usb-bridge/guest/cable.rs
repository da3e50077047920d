//! Cases in which a camera's cable changes, or a consumer stops reading, while `eecvs-usb` is running.
//!
//! In every case a director, which is a test device, is plugged in first. On a note it is replaced by the camera of
//! the case, after a delay. The camera is replaced by the next case's director when it is pulled, or on a note.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::sync::mpsc::Sender;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use eecvs_nostd::{Event, Sensor};
use usb_bridge::device::{Due, Model, Stream, find};
use usb_bridge::link::control::Request;
use usb_bridge::link::usb::{Bus, Change as Told, Watch};
use usb_bridge::peripheral::sequence::{self, SequenceDevice};
use usb_bridge::peripheral::socket::Change;
use usb_bridge::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

use super::capture::{program, read, said};
use super::{APPEARS, open, plan, vendor_out};

/// Time after the director's removal at which the camera arrives.
const LATE: Duration = Duration::from_millis(1500);
/// Queue of each consumer, which the stream does not fit into.
const QUEUE_MIB: &str = "4";
/// Most memory of a process with such a queue, including the system's libraries.
const MEMORY_MAX: u64 = 48 << 20;
/// Most events of a frame of the simulated encoder, and the length of its window in microseconds.
const FRAME: (usize, u64) = (4096, 32_768);

/// What happens to a camera at a position of its stream.
#[derive(Clone, Copy)]
enum Fault {
    None,
    /// The camera is pulled.
    Pulled(u64),
    /// Its endpoint halts, once.
    Halts(u64),
}

/// A camera, and what the guest does with it.
pub struct Case {
    name: &'static str,
    model: &'static str,
    events: usize,
    fault: Fault,
    run: fn(&mut Guest<'_>) -> Result<String>,
}

/// All cases, in the order in which they run.
pub const CASES: &[Case] = &[
    Case {
        name: "a camera that comes late and is pulled",
        model: "dvs128",
        events: 100_000,
        fault: Fault::Pulled(200_000),
        run: pulled,
    },
    Case {
        name: "a camera that halts",
        model: "eecvs",
        events: 100_000,
        fault: Fault::Halts(100_003),
        run: halts,
    },
    Case {
        name: "a consumer that stops reading",
        model: "dvs128",
        events: 1_500_000,
        fault: Fault::None,
        run: stuck,
    },
];

impl Case {
    fn model(&self) -> &'static dyn Model {
        find(self.model).expect("a model of the list")
    }

    fn scene(&self) -> Vec<Event> {
        plan::scene(SENSOR, self.events)
    }

    /// Returns the device that is plugged in first; `next` plugs in the director of the next case.
    pub fn director(
        &'static self,
        changes: Sender<Change>,
        next: impl Fn() + Clone + Send + 'static,
    ) -> SequenceDevice {
        let director = SequenceDevice::new(Speed::High).named(self.name);
        director.on_note(move |note| {
            if note != b"camera" {
                return;
            }
            // The channel is closed only if the other thread has ended.
            let _ = changes.send(Change::Unplug);
            let (changes, next) = (changes.clone(), next.clone());
            thread::spawn(move || {
                let started = Instant::now();
                let camera = Camera::new(self, Box::new(next));
                thread::sleep(LATE.saturating_sub(started.elapsed()));
                let _ = changes.send(Change::Plug(Box::new(camera)));
            });
        })
    }
}

const SENSOR: Sensor = Sensor {
    width: 128,
    height: 128,
};

/// A camera with a fault.
struct Camera {
    inner: Box<dyn Peripheral>,
    stream: u8,
    sent: u64,
    fault: Fault,
    next: Box<dyn Fn() + Send>,
}

impl Camera {
    fn new(case: &Case, next: Box<dyn Fn() + Send>) -> Self {
        let model = case.model();
        let mut bytes = Vec::new();
        let mut writer = model.writer(SENSOR).expect("it fits");
        writer.write(&case.scene(), &mut bytes).expect("in order");
        writer.finish(&mut bytes).expect("in order");
        let stream = Box::new(Prepared { bytes, at: 0 });
        Self {
            inner: model.camera(SENSOR, stream).expect("it fits"),
            stream: model.transfers().endpoint,
            sent: 0,
            fault: case.fault,
            next,
        }
    }
}

impl Peripheral for Camera {
    fn descriptors(&self) -> &Descriptors {
        self.inner.descriptors()
    }

    fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply {
        if (request.kind, request.request, data) == (Request::VENDOR_OUT, sequence::NOTE, b"next") {
            (self.next)();
            return Reply::Data(Vec::new());
        }
        self.inner.control(request, data, length)
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool {
        self.inner.bulk_out(endpoint, data)
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != self.stream {
            return self.inner.bulk_in(endpoint, room, data);
        }
        let (Fault::Pulled(at) | Fault::Halts(at)) = self.fault else {
            return self.inner.bulk_in(endpoint, room, data);
        };
        let left = usize::try_from(at - self.sent).unwrap_or(usize::MAX);
        if left > 0 {
            let bulk = self.inner.bulk_in(endpoint, room.min(left), data);
            self.sent += data.len() as u64;
            return bulk;
        }
        match std::mem::replace(&mut self.fault, Fault::None) {
            Fault::Halts(_) => Bulk::Stall,
            _ => {
                (self.next)();
                Bulk::Wait
            }
        }
    }

    fn clear_halt(&mut self, endpoint: u8) {
        self.inner.clear_halt(endpoint);
    }

    fn reset(&mut self) {
        self.inner.reset();
    }
}

/// A stream that is due at once.
struct Prepared {
    bytes: Vec<u8>,
    at: usize,
}

impl Stream for Prepared {
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> Result<Due> {
        let end = self.bytes.len().min(self.at + room);
        bytes.extend_from_slice(&self.bytes[self.at..end]);
        self.at = end;
        let is_over = end == self.bytes.len();
        Ok(if is_over { Due::Ended } else { Due::More })
    }
}

/// The guest's side of a case: its port, and the changes that the kernel reports.
struct Guest<'c> {
    case: &'c Case,
    /// Name of the port, `usb:BUS-PORT`.
    id: String,
    watch: Watch,
}

/// Runs the guest's side of all cases.
pub fn run() -> Result<()> {
    for case in CASES {
        let told = Guest::new(case).and_then(|mut guest| (case.run)(&mut guest));
        println!("ok: {}: {}", case.name, told.context(case.name)?);
    }
    Ok(())
}

impl<'c> Guest<'c> {
    /// Starts a case: the camera is on its way when this returns.
    fn new(case: &'c Case) -> Result<Self> {
        let director = open(case.name)?;
        let all = Bus::new()?.all()?;
        let mut named = all.iter();
        let found = named.find(|one| one.product_name.as_deref() == Some(case.name));
        let id = found.context("the director has gone")?.id();
        let watch = Watch::new()?;
        ensure!(watch.is_told(), "libusb does not report devices here");
        // The device may leave before the request completes.
        let _ = vendor_out(&director, sequence::NOTE, b"camera");
        drop(director);
        let mut guest = Self { case, id, watch };
        // The arrivals of other attached devices are reported first.
        guest.await_removal().context("the director's removal")?;
        Ok(guest)
    }

    fn start(&self, arguments: &[&str]) -> Result<Child> {
        let mut command = program(arguments);
        command.args(["--wait", "--json", "--device", &self.id]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().context("starting eecvs-usb")
    }

    fn await_change(&mut self, wanted: &dyn Fn(&Told) -> bool) -> Result<()> {
        let until = Instant::now() + APPEARS;
        while Instant::now() < until {
            if let Some(told) = self.watch.next(Duration::from_millis(500))?
                && wanted(&told)
            {
                return Ok(());
            }
        }
        bail!("was not reported")
    }

    fn await_removal(&mut self) -> Result<()> {
        let id = self.id.clone();
        self.await_change(&|told| matches!(told, Told::Left { id: left } if *left == id))
    }

    fn await_camera(&mut self) -> Result<()> {
        let (id, name) = (self.id.clone(), self.case.model);
        self.await_change(&|told| match told {
            Told::Arrived(one) => {
                one.id() == id && one.model.is_some_and(|model| model.name() == name)
            }
            Told::Left { .. } => false,
        })
    }

    /// Replaces the camera, which is no longer in use.
    fn next(&self) -> Result<()> {
        let found = Bus::new()?.find(Some(&self.id))?;
        let _ = vendor_out(&found.open(0)?, sequence::NOTE, b"next");
        Ok(())
    }
}

fn one_line(output: &Output, status: i32, what: &str) -> Result<()> {
    let text = String::from_utf8_lossy(&output.stderr);
    ensure!(
        output.status.code() == Some(status) && text.lines().count() == 1 && text.contains(what),
        "{}; expected status {status} and one line with \"{what}\": {text}",
        output.status
    );
    Ok(())
}

fn events_of(path: &str) -> Result<Vec<Event>> {
    let mut events = Vec::new();
    read(Path::new(path), &mut |batch| {
        events.extend_from_slice(batch);
    })?;
    Ok(events)
}

/// Checks that `capture` waits for the camera and, when it is pulled, leaves a file that can be read; and that the
/// kernel reports the arrival and the removal.
fn pulled(guest: &mut Guest<'_>) -> Result<String> {
    let path = "/tmp/pulled.aedat4";
    let capture = guest.start(&["capture", "-o", path])?;
    guest.await_camera().context("the camera's arrival")?;
    guest.await_removal().context("the camera's removal")?;
    let output = capture.wait_with_output()?;
    one_line(&output, 1, "unplugged")?;
    // The file of a failed capture is marked by its name.
    let found = events_of("/tmp/incomplete-pulled.aedat4")?;
    let sent = guest.case.scene();
    ensure!(
        !found.is_empty() && sent.starts_with(&found),
        "the {} events in the file are not the first ones that were sent",
        found.len()
    );
    Ok(format!(
        "{} of {} events before the removal",
        found.len(),
        sent.len()
    ))
}

/// Checks that `capture` continues after a halt: only the frame that the halt cut is missing, and counted.
fn halts(guest: &mut Guest<'_>) -> Result<String> {
    let path = "/tmp/halted.aedat4";
    let (frame, window_us) = FRAME;
    let mut sent = guest.case.scene();
    let enough = (sent.len() - frame).to_string();
    let limits = ["--events", &enough, "--duration-s", "60"];
    let capture = guest.start(&[&["capture", "-o", path], &limits[..]].concat())?;
    let said = said(&capture.wait_with_output()?)?;
    let lost = &said["losses"];
    ensure!(lost["halts of the endpoint"] == 1, "lost: {lost}");
    let mut found = events_of(path)?;
    found.sort_unstable();
    sent.sort_unstable();
    let mut of_found = found.iter().peekable();
    let missing: Vec<_> = sent
        .iter()
        .filter(|event| of_found.next_if_eq(event).is_none())
        .collect();
    ensure!(
        of_found.next().is_none(),
        "the file has events that were never sent"
    );
    let span_us = match missing[..] {
        [first, .., latest] => latest.t_us - first.t_us,
        _ => 0,
    };
    ensure!(
        missing.len() <= frame && span_us <= window_us,
        "{} events over {span_us} us are missing: {lost}",
        missing.len()
    );
    let frames = lost["frames lost"].as_u64().unwrap_or(0);
    ensure!(
        missing.is_empty() || frames == 1,
        "{} events are missing and were not reported: {lost}",
        missing.len()
    );
    guest.next()?;
    Ok(format!("{} events of one frame are missing", missing.len()))
}

/// Checks `forward` to a consumer that reads nothing: the file next to it gets everything, and memory stays small.
fn stuck(guest: &mut Guest<'_>) -> Result<String> {
    for buffer in ["tcp_rmem", "tcp_wmem"] {
        let path = format!("/proc/sys/net/ipv4/{buffer}");
        std::fs::write(&path, "4096 16384 65536").context(path)?;
    }
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let to = format!("tcp://{}", listener.local_addr()?);
    let events = guest.case.scene().len() as u64;
    let count = events.to_string();
    let limits = ["--events", &count, "--duration-s", "60"];
    let queue = ["--consumer-queue-mib", QUEUE_MIB];
    let addresses = ["--to", &to, "--to", "file:/tmp/all"];
    let arguments = [&["forward", "--as", "raw"], &queue[..], &addresses, &limits].concat();
    let forward = guest.start(&arguments)?;
    // The consumer connects and never reads.
    let _consumer = listener.accept()?;
    let output = forward.wait_with_output()?;
    let said = said(&output)?;
    one_line(&output, 0, &to)?;
    let count = |which: usize, what: &str| {
        let count = &said["consumers"][which][what]["events"];
        count.as_u64().context("a count")
    };
    let lost = count(0, "lost")?;
    ensure!(
        count(1, "sent")? == events && count(1, "lost")? == 0,
        "the file does not have all {events} events: {said}"
    );
    ensure!(
        lost > 0 && count(0, "sent")? + lost == events,
        "events are not accounted for: {said}"
    );
    let bytes = said["consumers"][1]["sent"]["bytes"].as_u64();
    ensure!(
        bytes == Some(std::fs::metadata("/tmp/all")?.len()),
        "the file does not have as many bytes as were sent to it: {said}"
    );
    let memory = said["memory_peak_bytes"].as_u64().context("memory")?;
    ensure!(
        memory < MEMORY_MAX,
        "it used {memory} bytes of memory, which is too much"
    );
    std::fs::remove_file("/tmp/all")?;
    guest.next()?;
    let megabytes = memory as f64 / 1e6;
    Ok(format!(
        "only it lost events, {lost} of {events}; {megabytes:.1} MB of memory"
    ))
}
