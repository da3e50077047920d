//! `eecvs-usb simulate`: a simulated camera that sends a recording.

#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
use std::ffi::{OsStr, OsString};
use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
use std::{os::unix::process::ExitStatusExt, time::Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use eecvs_cli::options::ReadingOptions;
use eecvs_cli::output::{print, print_json, rows};
use eecvs_cli::progress::Progress;
use eecvs_cli::say;
use eecvs_nostd::Sensor;
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
use rustix::process::{Pid, Signal, kill_process};
use serde::Serialize;

use crate::device::{Due, MODELS, Model, Stream, find};
use crate::peripheral::Peripheral;
use crate::peripheral::server::{Service, serve_usbip};
use crate::peripheral::socket::Report;
use crate::peripheral::stream::{Pace, Recording, Sent};
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
use crate::peripheral::usbfs::MockedUsb;
use crate::stop::Stop;

/// Bytes taken from the stream at once when no host is connected.
const ROOM: usize = 1 << 16;
/// Time in which a program ends by itself after Ctrl-C.
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
const GRACE: Duration = Duration::from_secs(2);

/// Simulate a camera that sends a recording
///
/// With --usbredir or --usbip, the camera is offered to a virtual machine or a kernel, until Ctrl-C; with --run, to one
/// program on this machine. Each start of the camera plays the recording from its beginning; after its end the camera
/// stays on and keeps sending its time, like a camera that sees nothing. Without these flags, the command reports what
/// the camera would send.
#[derive(Debug, Args)]
pub struct Simulate {
    /// Model of the camera
    #[arg(value_parser = model)]
    model: &'static str,

    /// Recording to send
    file: PathBuf,

    /// Pace: real (as recorded), max (as fast as the host takes events), N events per second, or Fx (F times as
    /// fast as recorded)
    #[arg(long, value_name = "real|max|N|Fx", default_value = "real")]
    rate: Pace,

    /// Start again at the end of the recording
    #[arg(long = "loop")]
    repeat: bool,

    /// Device time of the first event, in microseconds [default: the recording's, or 0 if that is 2^32 or more]
    #[arg(long, value_name = "T")]
    start_us: Option<u64>,

    /// Offer the camera to QEMU's usb-redir device, at this Unix socket
    #[cfg(unix)]
    #[arg(long, value_name = "SOCK", conflicts_with = "usbip")]
    usbredir: Option<PathBuf>,

    /// Offer the camera over USB/IP, at this address and port (hosts try port 3240)
    #[arg(long, value_name = "ADDR")]
    usbip: Option<String>,

    /// Run this program with the arguments that follow; it sees the camera and no other USB device, and its exit status
    /// is also that of this command. It reaches USB through libusb, and umockdev must be installed
    #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
    #[arg(
        long,
        value_names = ["PROGRAM", "ARGUMENT"],
        num_args = 1..,
        allow_hyphen_values = true,
        conflicts_with_all = ["usbip", "usbredir", "once"]
    )]
    run: Vec<OsString>,

    /// Send the first event this many milliseconds after the host has started the camera: for hosts that start it
    /// before they take its data
    #[arg(long, value_name = "N", default_value_t = 0)]
    delay_ms: u64,

    /// End when the first host has disconnected
    #[arg(long)]
    once: bool,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// Summary of what was sent.
#[derive(Debug, Serialize)]
struct Summary {
    model: &'static str,
    width: u16,
    height: u16,
    events: u64,
    bytes: u64,
    bytes_per_event: f64,
    seconds: f64,
    events_per_s: f64,
    bytes_per_s: f64,
    rounds: u64,
    late_us: u64,
    first_us: Option<u64>,
    first_device_us: Option<u64>,
}

impl Simulate {
    /// Runs the simulation until its end or Ctrl-C.
    ///
    /// # Errors
    /// The recording cannot be read or does not fit the model, or the address cannot be used.
    pub fn run(self) -> Result<()> {
        let model = find(self.model).context("unknown model")?;
        let sensor = event_files::open(&self.file, self.reading.reading())?.sensor();
        let stop = Stop::on_signals()?;
        let source = Source {
            command: &self,
            model,
            sensor,
            sent: Mutex::default(),
        };
        #[cfg(unix)]
        if let Some(path) = &self.usbredir {
            let server = crate::peripheral::unix_server::UnixServer::listen(path)?;
            source.announce(&format!("{}", path.display()));
            return source.serve(&stop, |service| server.serve_usbredir(service));
        }
        if let Some(address) = &self.usbip {
            let listener = TcpListener::bind(address)
                .with_context(|| format!("{address}: cannot listen there"))?;
            let address = listener.local_addr().context("socket")?;
            source.announce(&format!("{address}"));
            return source.serve(&stop, |service| serve_usbip(&listener, service));
        }
        #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
        if let Some((program, arguments)) = self.run.split_first() {
            return source.run(program, arguments, &stop);
        }
        let sent = self.drain(&source, &stop)?;
        source.print(&sent)
    }

    /// Takes the stream without a host, as fast as it becomes due.
    fn drain(&self, source: &Source<'_>, stop: &Stop) -> Result<Arc<Sent>> {
        let mut recording = source.recording()?;
        let sent = recording.sent();
        let progress = Progress::new("events");
        let mut bytes = Vec::with_capacity(ROOM);
        while !stop.is_asked() {
            bytes.clear();
            if recording.take(ROOM, &mut bytes)? == Due::Ended && bytes.len() < ROOM {
                break;
            }
            progress.set(sent.events());
            if bytes.is_empty() {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        Ok(sent)
    }
}

/// The model and the recording that are simulated.
struct Source<'s> {
    command: &'s Simulate,
    model: &'static dyn Model,
    sensor: Sensor,
    /// Counts of the device made last.
    sent: Mutex<Arc<Sent>>,
}

impl Source<'_> {
    fn recording(&self) -> Result<Recording> {
        let writer = self.model.writer(self.sensor).with_context(|| {
            format!(
                "{}: no {} has a sensor of {}x{}: crop the recording with eecvs convert --crop, or \
                 choose another model",
                self.command.file.display(),
                self.model.name(),
                self.sensor.width,
                self.sensor.height
            )
        })?;
        let file = self.command.file.clone();
        let reading = self.command.reading.reading();
        let open = Box::new(move || Ok(event_files::open(&file, &reading)?));
        let command = self.command;
        Ok(Recording::new(open, writer, command.rate, command.start_us)
            .repeat(command.repeat)
            .delay(Duration::from_millis(command.delay_ms)))
    }

    fn device(&self) -> Result<Box<dyn Peripheral>> {
        let recording = self.recording()?.stay(true);
        *self.sent.lock().unwrap_or_else(PoisonError::into_inner) = recording.sent();
        let camera = self.model.camera(self.sensor, Box::new(recording));
        camera.with_context(|| {
            format!(
                "{}: no camera of this model has a sensor of this size",
                self.model.name()
            )
        })
    }

    /// Runs a program that sees the camera, and ends as it does.
    #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
    fn run(&self, program: &OsStr, arguments: &[OsString], stop: &Stop) -> Result<()> {
        let usb = MockedUsb::new(self.device()?)?;
        let name = program.display();
        let mut child = usb
            .command(program)
            .args(arguments)
            .spawn()
            .with_context(|| format!("{name}: cannot run this program"))?;
        let mut ending: Option<Instant> = None;
        let status = loop {
            if let Some(status) = child.try_wait().with_context(|| format!("{name}"))? {
                break status;
            }
            if stop.is_asked() {
                match ending {
                    // A signal from a terminal reaches the program as well; another one does not.
                    None => {
                        // It may have ended meanwhile.
                        let _ = kill_process(Pid::from_child(&child), Signal::TERM);
                        ending = Some(Instant::now());
                    }
                    Some(since) if since.elapsed() > GRACE => {
                        let _ = child.kill();
                    }
                    Some(_) => {}
                }
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        // It has a folder, which an exit would leave.
        drop(usb);
        let sent = Arc::clone(&self.sent.lock().unwrap_or_else(PoisonError::into_inner));
        // The program has stdout.
        say!("{} events, {} bytes sent", sent.events(), sent.bytes());
        if let Some(error) = sent.error() {
            bail!("the stream ended: {error}");
        }
        match status.code() {
            Some(0) => Ok(()),
            Some(code) => std::process::exit(code),
            // As a shell says it.
            None => match status.signal() {
                Some(signal) => std::process::exit(128 + signal),
                None => bail!("{name}: {status}"),
            },
        }
    }

    fn announce(&self, address: &str) {
        let (name, file) = (self.model.name(), self.command.file.display());
        say!("{name} plays {file} at {address}; press Ctrl-C to end");
    }

    fn serve(&self, stop: &Stop, serve: impl FnOnce(&mut Service<'_>) -> Result<()>) -> Result<()> {
        // Reports a recording that does not fit the model before any host connects.
        drop(self.device()?);
        let mut failed = None;
        serve(&mut Service {
            device: &mut || self.device(),
            stop,
            once: self.command.once,
            left: &mut |served| {
                let sent = Arc::clone(&self.sent.lock().unwrap_or_else(PoisonError::into_inner));
                let line = served
                    .as_ref()
                    .map_or_else(|error| format!("{error:#}"), line);
                say!("{line}");
                if let Some(error) = sent.error() {
                    say!("the stream ended: {error}");
                    failed = Some(error.to_owned());
                }
                if let Err(error) = self.print(&sent) {
                    say!("{error:#}");
                }
            },
        })?;
        match failed {
            Some(error) if self.command.once => bail!(error),
            _ => Ok(()),
        }
    }

    fn print(&self, sent: &Sent) -> Result<()> {
        // The rate of a stream that came all at once is unknown.
        let seconds = sent.elapsed().as_secs_f64();
        let per_second = |count: u64| {
            if seconds > 0.0 {
                count as f64 / seconds
            } else {
                0.0
            }
        };
        let first = sent.first_us();
        let summary = Summary {
            model: self.model.name(),
            width: self.sensor.width,
            height: self.sensor.height,
            events: sent.events(),
            bytes: sent.bytes(),
            bytes_per_event: sent.bytes() as f64 / sent.events().max(1) as f64,
            seconds,
            events_per_s: per_second(sent.events()),
            bytes_per_s: per_second(sent.bytes()),
            rounds: sent.rounds(),
            late_us: sent.late_us(),
            first_us: first.map(|(recorded, _)| recorded),
            first_device_us: first.map(|(_, device)| device),
        };
        if self.command.json {
            return print_json(&summary);
        }
        let time = |t: Option<u64>| t.map_or_else(|| "none".to_owned(), |t| t.to_string());
        print(&rows([
            ("model", summary.model.to_owned()),
            ("width", summary.width.to_string()),
            ("height", summary.height.to_string()),
            ("events", summary.events.to_string()),
            ("bytes", summary.bytes.to_string()),
            ("bytes_per_event", format!("{:.3}", summary.bytes_per_event)),
            ("seconds", format!("{:.3}", summary.seconds)),
            ("events_per_s", format!("{:.0}", summary.events_per_s)),
            ("bytes_per_s", format!("{:.0}", summary.bytes_per_s)),
            ("rounds", summary.rounds.to_string()),
            ("late_us", summary.late_us.to_string()),
            ("first_us", time(summary.first_us)),
            ("first_device_us", time(summary.first_device_us)),
        ]))
    }
}

/// Formats the traffic of a host that has disconnected as one line.
fn line(report: &Report) -> String {
    let Report {
        traffic,
        packets_odd,
        is_rejected,
    } = report;
    let mut line = format!(
        "the host disconnected: {} requests ({} refused), {} bytes to it in {} transfers, {} bytes \
         from it, {} halts, {} transfers cancelled",
        traffic.requests,
        traffic.requests_refused,
        traffic.bytes_in,
        traffic.transfers_in,
        traffic.bytes_out,
        traffic.stalled,
        traffic.cancelled,
    );
    for (count, what) in [
        (traffic.refused, "transfers refused"),
        (
            traffic.bytes_overflown,
            "bytes lost because more arrived than the host asked for",
        ),
        (*packets_odd, "packets not understood"),
        (u64::from(*is_rejected), "refusal by the host's filter"),
    ] {
        if count > 0 {
            line += &format!(", {count} {what}");
        }
    }
    line
}

/// Parses the name of a model.
fn model(name: &str) -> Result<&'static str, String> {
    let names = || MODELS.iter().map(|model| model.name());
    names().find(|known| *known == name).ok_or_else(|| {
        let known: Vec<_> = names().collect();
        format!("unknown model; known models: {}", known.join(", "))
    })
}
