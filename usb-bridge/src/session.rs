//! Runs a device: starts it, pumps its stream, watches its limits and stops it in order.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Builder, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use event_files::Skipped;
use serde::Serialize;

use crate::device::mcu::ANY_SENSOR;
use crate::device::{Info, Model};
use crate::link::Link;
use crate::link::control::Control;
use crate::live::{Follower, LiveReader, Progress};
use crate::pump::{self, Pumped};
use crate::stop::Stop;
use crate::usage::Usage;

/// Period at which the stop conditions are checked.
const LOOK: Duration = Duration::from_millis(20);

/// A device that has been opened and identified.
pub struct Source {
    /// Model of the device.
    pub model: &'static dyn Model,
    /// Identity that the device reports.
    pub info: Info,
    /// Its stream, with transfers in flight.
    pub link: Box<dyn Link>,
    /// Its control side; `None` for a serial port or a file.
    pub control: Option<Box<dyn Control + Send>>,
}

/// Conditions under which a stream is stopped.
#[derive(Debug, Clone, Copy, Default)]
pub struct Limits {
    /// Host time after the start.
    pub duration: Option<Duration>,
    /// Number of events. Those that arrive with the last one, or before the device has stopped, are kept too.
    pub events: Option<u64>,
}

/// A device whose stream is running.
pub struct Session {
    /// Name of its link, for messages.
    pub name: String,
    /// Identity that the device reports.
    pub info: Info,
    /// Model of the device.
    pub model: &'static dyn Model,
    /// Chunks that arrive, and their account.
    pub pumped: Arc<Pumped>,
    progress: Arc<Mutex<Progress>>,
    pump: pump::Thread,
    watch: JoinHandle<Option<anyhow::Error>>,
    stop: Stop,
    started: Instant,
    usage: Usage,
}

impl Session {
    /// Starts a device, with a queue of at most `queue_bytes` bytes. `stop`, a limit or the end of the link stops
    /// the device; what it sent before it was stopped is still delivered.
    ///
    /// # Errors
    /// The thread cannot be started, or the device refuses to start.
    pub fn start(source: Source, queue_bytes: usize, stop: &Stop, limits: Limits) -> Result<Self> {
        let Source {
            model,
            info,
            link,
            mut control,
        } = source;
        let name = link.name().to_owned();
        let usage = Usage::now();
        let (pumped, pump) = pump::start(link, queue_bytes)?;
        if let Some(control) = &mut control {
            let started = model.start(&info, control.as_mut());
            started.with_context(|| format!("{name}: starting the stream"))?;
        }
        let progress = Arc::<Mutex<Progress>>::default();
        let watch = Watch {
            model,
            info: info.clone(),
            control,
            pumped: Arc::clone(&pumped),
            progress: Arc::clone(&progress),
            stop: stop.clone(),
            limits,
        };
        let watch = Builder::new()
            .name("watch".to_owned())
            .spawn(move || watch.run())
            .context("starting the thread that stops the device")?;
        Ok(Self {
            name,
            info,
            model,
            pumped,
            progress,
            pump,
            watch,
            stop: stop.clone(),
            started: Instant::now(),
            usage,
        })
    }

    /// Returns the reader of the device's events. Each chunk goes to the reader that takes it first: use only one.
    #[must_use]
    pub fn reader(&self) -> LiveReader {
        LiveReader::new(
            self.info.stream,
            self.info.name.clone(),
            Arc::clone(&self.pumped),
            self.follower(),
        )
    }

    /// Returns the reader of the device's events once the sensor is known: the MCU reports its sensor with its
    /// first frame, so this may wait for that frame.
    ///
    /// # Errors
    /// The link failed before the sensor was known.
    pub fn reader_of_sensor(&self) -> Result<LiveReader> {
        let mut reader = self.reader();
        if self.info.sensor == ANY_SENSOR {
            reader.wait_for_sensor(ANY_SENSOR)?;
        }
        Ok(reader)
    }

    /// Returns a follower that parses the stream from its beginning, for callers that take the chunks themselves
    /// instead of using [`Session::reader`].
    #[must_use]
    pub fn follower(&self) -> Follower {
        let parser = self.model.parser(&self.info);
        Follower::new(parser, Arc::clone(&self.progress))
    }

    /// Returns what is known of the stream so far; a reader or follower keeps it up to date.
    #[must_use]
    pub fn progress(&self) -> Arc<Mutex<Progress>> {
        Arc::clone(&self.progress)
    }

    /// Returns how the link ended. A failure is returned once only.
    ///
    /// # Errors
    /// The link failed.
    pub fn outcome(&self) -> Result<()> {
        self.pumped
            .failure()
            .map_or(Ok(()), |failure| Err(failure.into()))
    }

    /// Stops the device and returns a report, and the error if the device could not be stopped: what was received
    /// stays valid in that case. Bytes that are still queued are not parsed.
    #[must_use]
    pub fn finish(self) -> (Report, Option<anyhow::Error>) {
        self.stop.ask();
        let seconds = self.started.elapsed().as_secs_f64();
        let failure = self.watch.join().unwrap_or_default();
        // The pump closes its queue when it ends and waits for no consumer.
        let _ = self.pump.join();
        let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        let account = &self.pumped.account;
        let mut losses = progress.losses.clone();
        for (cause, n) in account.losses() {
            losses.add(cause, n);
        }
        let (bytes, transfers) = account.arrived();
        let sensor = progress.sensor.unwrap_or(self.info.sensor);
        let report = Report {
            device: self.name,
            model: self.model.name(),
            firmware: self.info.firmware.clone(),
            width: sensor.width,
            height: sensor.height,
            seconds,
            bytes,
            transfers,
            events: progress.events,
            events_per_s: progress.events as f64 / seconds.max(1e-9),
            words: named(&progress.words),
            losses: named(&losses),
            overrun_bytes: account.overrun_bytes(),
            queue_peak_bytes: self.pumped.queue.fill().peak_bytes,
            drift_ppm: progress.relation.map(|relation| relation.drift_ppm),
            clock_residual_us: progress.relation.map(|relation| relation.residual_us),
            cpu_s: self.usage.cpu_s(),
            memory_peak_bytes: Usage::now().memory_peak_bytes,
        };
        (report, failure)
    }
}

/// Summary of a session.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Name of the link.
    pub device: String,
    /// Name of the model.
    pub model: &'static str,
    /// Firmware version as the device reports it.
    pub firmware: String,
    /// Width of the sensor, in pixels.
    pub width: u16,
    /// Height of the sensor, in pixels.
    pub height: u16,
    /// Host time from the start to the stop, in seconds.
    pub seconds: f64,
    /// Bytes that arrived.
    pub bytes: u64,
    /// Transfers that arrived.
    pub transfers: u64,
    /// Events decoded from them.
    pub events: u64,
    /// Events per second of host time.
    pub events_per_s: f64,
    /// Words that are not events, by name.
    pub words: std::collections::BTreeMap<&'static str, u64>,
    /// Losses, by cause.
    pub losses: std::collections::BTreeMap<&'static str, u64>,
    /// Bytes that arrived but were dropped because the queue was full.
    pub overrun_bytes: u64,
    /// Most bytes that the queue after the link ever held.
    pub queue_peak_bytes: usize,
    /// How much faster the device's clock runs than the host's, in ppm; `None` if the clocks are not related.
    pub drift_ppm: Option<f64>,
    /// Root mean square of the least delays around the fitted line, in microseconds.
    pub clock_residual_us: Option<f64>,
    /// Processor time of all threads of this process since the start, in seconds.
    pub cpu_s: f64,
    /// Peak resident memory of this process, in bytes.
    pub memory_peak_bytes: Option<u64>,
}

fn named(counts: &Skipped) -> std::collections::BTreeMap<&'static str, u64> {
    counts.iter().collect()
}

/// The thread that stops the device when a limit is reached.
struct Watch {
    model: &'static dyn Model,
    info: Info,
    control: Option<Box<dyn Control + Send>>,
    pumped: Arc<Pumped>,
    progress: Arc<Mutex<Progress>>,
    stop: Stop,
    limits: Limits,
}

impl Watch {
    fn is_over(&self, started: Instant) -> bool {
        let Limits { duration, events } = self.limits;
        let met = || {
            let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
            progress.events
        };
        self.stop.is_asked()
            || duration.is_some_and(|duration| started.elapsed() >= duration)
            || events.is_some_and(|events| met() >= events)
            || self.pumped.is_ended()
    }

    /// Waits for a stop condition and stops the device. Returns why the device could not be stopped, if that
    /// failed.
    fn run(mut self) -> Option<anyhow::Error> {
        let started = Instant::now();
        while !self.is_over(started) {
            thread::sleep(LOOK);
        }
        let had_ended = self.pumped.is_ended();
        let stopped = match &mut self.control {
            Some(control) => self.model.stop(&self.info, control.as_mut()),
            None => Ok(()),
        };
        self.pumped.stop();
        // An unplugged device cannot be stopped and need not be.
        stopped.err().filter(|_| !had_ended)
    }
}
