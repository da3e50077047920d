//! A device in use: started, pumped, watched, stopped in order.

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

/// How often the wish to stop is looked for.
const LOOK: Duration = Duration::from_millis(20);

/// A device that was opened and asked what it is.
pub struct Source {
    /// Its model.
    pub model: &'static dyn Model,
    /// What it says of itself.
    pub info: Info,
    /// Its stream, with transfers in flight.
    pub link: Box<dyn Link>,
    /// Its control side, where it has one: a serial port or a file has none.
    pub control: Option<Box<dyn Control + Send>>,
}

/// When a stream ends by itself.
#[derive(Debug, Clone, Copy, Default)]
pub struct Limits {
    /// After this time of the host.
    pub duration: Option<Duration>,
    /// After this many events, and those that came with the last of them.
    pub events: Option<u64>,
}

/// A device whose stream is running.
pub struct Session {
    /// Name of its link, for messages.
    pub name: String,
    /// What the device says of itself.
    pub info: Info,
    /// Its model.
    pub model: &'static dyn Model,
    /// What arrives.
    pub pumped: Arc<Pumped>,
    progress: Arc<Mutex<Progress>>,
    pump: pump::Thread,
    watch: JoinHandle<Option<anyhow::Error>>,
    stop: Stop,
    started: Instant,
    usage: Usage,
}

impl Session {
    /// Starts a device; its queue holds at most `queue_bytes`. `stop`, a limit or an end of the link
    /// stops it: what it sent before still comes.
    ///
    /// # Errors
    /// The device refuses to start.
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

    /// Its events. Only one reader can have them.
    #[must_use]
    pub fn reader(&self) -> LiveReader {
        LiveReader::new(
            self.info.stream,
            self.info.name.clone(),
            Arc::clone(&self.pumped),
            self.follower(),
        )
    }

    /// Its events, when the sensor is known: an encoder's first frame tells which it is.
    ///
    /// # Errors
    /// The link failed before.
    pub fn reader_of_sensor(&self) -> Result<LiveReader> {
        let mut reader = self.reader();
        if self.info.sensor == ANY_SENSOR {
            reader.wait_for_sensor(ANY_SENSOR)?;
        }
        Ok(reader)
    }

    /// What follows its stream from the beginning, where [`Session::reader`] does not.
    #[must_use]
    pub fn follower(&self) -> Follower {
        let parser = self.model.parser(&self.info);
        Follower::new(parser, Arc::clone(&self.progress))
    }

    /// What is known of the stream so far.
    #[must_use]
    pub fn progress(&self) -> Arc<Mutex<Progress>> {
        Arc::clone(&self.progress)
    }

    /// How its link has ended.
    ///
    /// # Errors
    /// The link's failure.
    pub fn outcome(&self) -> Result<()> {
        self.pumped
            .failure()
            .map_or(Ok(()), |failure| Err(failure.into()))
    }

    /// Stops the device, whose bytes nobody takes any more where there are some yet, and reports. Also
    /// why the device could not be stopped, where that failed: what was received is as good as it was.
    #[must_use]
    pub fn finish(self) -> (Report, Option<anyhow::Error>) {
        self.stop.ask();
        let seconds = self.started.elapsed().as_secs_f64();
        let failure = self.watch.join().unwrap_or_default();
        // Its queue is closed when it ends, so it waits for nobody.
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

/// What a session was.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Link.
    pub device: String,
    /// Model.
    pub model: &'static str,
    /// As the device gives it.
    pub firmware: String,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// From the start to the stop.
    pub seconds: f64,
    /// Bytes that arrived.
    pub bytes: u64,
    /// Transfers that arrived.
    pub transfers: u64,
    /// Events in them.
    pub events: u64,
    /// Events per second of the host.
    pub events_per_s: f64,
    /// Words that are no events, by name.
    pub words: std::collections::BTreeMap<&'static str, u64>,
    /// Losses, by cause.
    pub losses: std::collections::BTreeMap<&'static str, u64>,
    /// Bytes that arrived and were let go of, as the queue was full.
    pub overrun_bytes: u64,
    /// Most bytes that were in the queue behind the link.
    pub queue_peak_bytes: usize,
    /// How much faster the device's clock is than the host's; nothing where they are not related.
    pub drift_ppm: Option<f64>,
    /// Spread of the least delays around the drift's line.
    pub clock_residual_us: Option<f64>,
    /// Processor time of this process since the start, of all threads.
    pub cpu_s: f64,
    /// Most memory that this process ever had.
    pub memory_peak_bytes: Option<u64>,
}

fn named(counts: &Skipped) -> std::collections::BTreeMap<&'static str, u64> {
    counts.iter().collect()
}

/// The thread that stops the device.
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

    /// Why the device could not be stopped, where that failed.
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
        // A device that is gone cannot be stopped, and need not be.
        stopped.err().filter(|_| !had_ended)
    }
}
