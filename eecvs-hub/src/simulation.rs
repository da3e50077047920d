//! Simulates many sensors and hubs in one process with their real code: sessions, encryption, stores, and
//! receivers.
//!
//! Each sensor plays the frames of one of nine emulated scenes, assigned in turn, from a random position in it. It
//! sends one frame per window; the sensors' windows are evenly staggered. Each sensor is a client of one hub. The
//! first hub is connected to all others. A receiver at each hub receives from the sensors of that hub, and one more
//! at the first hub receives from all: every frame is received twice, and all frames but those of the first hub's
//! sensors pass two hubs. The last hub is stopped for a while.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::io;
use std::net::TcpListener;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use eecvs::encode::{Limits, encode};
use eecvs::frame_file::FrameSink;
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_nostd::{Coder, Config, Fidelity, Header, Hybrid, Mode, Sensor, WindowConfig};
use event_emulator::{PRESETS, SceneConfig, emulate};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use serde::Serialize;
use usb_bridge::stop::Stop;
use usb_bridge::usage::Usage;

use crate::access::{Access, Role};
use crate::certificate::Authority;
use crate::clock::Clock;
use crate::downlink::{self, Delivered, Downlink};
use crate::hub::{self, Hub};
use crate::key::Name;
use crate::latency::Latencies;
use crate::link::Links;
use crate::panicked;
use crate::uplink::{self, Uplink};

/// Parameters of a simulation.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Number of sensors, spread evenly over the hubs.
    pub sensors: usize,
    /// Number of hubs.
    pub hubs: usize,
    /// How long the sensors send.
    pub duration: Duration,
    /// How long the last hub is stopped, starting after a third of the duration.
    pub outage: Duration,
    /// Size of each sensor in pixels.
    pub sensor: Sensor,
    /// Duration of a window, which makes one frame, in microseconds.
    pub window_us: u32,
    /// Seed of the scenes and of the positions in them.
    pub seed: u64,
}

/// Results of a simulation; the fields are the JSON keys.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Outcome {
    /// Number of sensors.
    pub sensors: usize,
    /// Number of hubs.
    pub hubs: usize,
    /// Number of receivers.
    pub receivers: usize,
    /// How long the sensors sent.
    pub seconds: f64,
    /// How long it took to connect all of them.
    pub connecting_s: f64,
    /// Frames that the sensors made.
    pub frames: u64,
    /// Events in these frames.
    pub events: u64,
    /// Bytes of these frames.
    pub bytes: u64,
    /// Frames per second that the sensors made.
    pub frames_per_s: f64,
    /// Bytes per second that the sensors made.
    pub bytes_per_s: f64,
    /// Frames that the receivers should have received, in total.
    pub expected: u64,
    /// Frames that the receivers received once, in order, and as they were sent.
    pub delivered: u64,
    /// Frames received that differed from those sent, or were not in order.
    pub wrong: u64,
    /// Of those delivered, frames that were sent again on request.
    pub again: u64,
    /// Frames that the receivers gave up.
    pub lost: u64,
    /// Number of link failures of all clients together: those at the hub that was stopped.
    pub outages: u64,
    /// How long after the end the last frame arrived.
    pub late_s: f64,
    /// Median time from when a frame was due to its arrival, in milliseconds, for frames that were not sent again;
    /// `None` if nothing was measured.
    pub delay_p50_ms: Option<f64>,
    /// 99th percentile of the same.
    pub delay_p99_ms: Option<f64>,
    /// Maximum of the same.
    pub delay_max_ms: Option<f64>,
    /// Processor seconds per second, of all parts together, while the sensors sent.
    pub cores: f64,
    /// Peak of the resident memory.
    pub memory_peak_bytes: u64,
}

/// The frames of a scene, each with its number of events.
type Played = Vec<(Vec<u8>, u32)>;

/// Number of sensors that connect at once.
const CONNECTING: usize = 32;

/// Longest wait for links, and for frames after the end.
const PATIENCE: Duration = Duration::from_secs(120);

struct Fleet {
    options: Options,
    folder: std::path::PathBuf,
    ports: Vec<u16>,
    names: Vec<Name>,
}

/// The frames that a sensor plays, and the index of the first.
#[derive(Clone)]
struct Part {
    frames: Arc<Played>,
    start: usize,
}

/// A receiver's check of the frames that it receives.
struct Checked {
    parts: Arc<HashMap<Name, Part>>,
    next: HashMap<Name, u64>,
    delivered: u64,
    wrong: u64,
    latest: Instant,
}

/// Runs a simulation; `say` receives lines about its progress. Keys are made in `folder`.
///
/// # Errors
/// Something cannot be started, for instance because it needs more sockets than a process may have.
pub fn simulate(
    options: Options,
    folder: &Path,
    stop: &Stop,
    say: &mut (dyn FnMut(&str) + Send),
) -> Result<Outcome> {
    ensure!(
        options.hubs >= 1 && options.sensors >= options.hubs,
        "give at least one hub, and at least one sensor for each hub"
    );
    let played = scenes(options, stop)?;
    let fleet = Fleet::new(options, folder, stop)?;
    let wait = |who: &str, is_so: &dyn Fn() -> bool| wait(who, is_so, stop);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(options.seed);
    let parts: HashMap<Name, Part> = fleet
        .names
        .iter()
        .enumerate()
        .map(|(number, name)| {
            let frames = Arc::clone(&played[number % played.len()]);
            let start = random.next_u64() as usize % frames.len();
            (name.clone(), Part { frames, start })
        })
        .collect();
    let parts = Arc::new(parts);
    let started = Instant::now();
    let mut hubs: Vec<Hub> = Vec::new();
    for number in 0..options.hubs {
        hubs.push(fleet.hub(number)?);
    }
    let mut receivers = Vec::new();
    for number in 0..options.hubs {
        receivers.push(fleet.receiver(number, &format!("{number}/**"), &parts)?);
    }
    receivers.push(fleet.receiver(0, "**", &parts)?);
    wait("receivers", &|| {
        receivers
            .iter()
            .all(|(downlink, _)| downlink.is_connected())
    })?;
    let mut uplinks: Vec<Uplink> = Vec::new();
    for (number, name) in fleet.names.iter().enumerate() {
        uplinks.push(fleet.sensor(number % options.hubs, name)?);
        if uplinks.len().is_multiple_of(CONNECTING) || uplinks.len() == options.sensors {
            wait("sensors", &|| {
                uplinks
                    .iter()
                    .rev()
                    .take(CONNECTING)
                    .all(Uplink::is_connected)
            })?;
        }
    }
    let mut outcome = Outcome {
        sensors: options.sensors,
        hubs: options.hubs,
        receivers: receivers.len(),
        connecting_s: started.elapsed().as_secs_f64(),
        ..Outcome::default()
    };
    say(&format!("{} sensors are connected", options.sensors));
    let last = hubs.pop();
    // Run it beside the sensors, so that it does not delay them.
    let last = thread::scope(|scope| -> Result<Option<Hub>> {
        let interrupted = scope.spawn(|| fleet.interrupt(last, stop, say));
        play(&fleet, &parts, &uplinks, &mut outcome, stop)?;
        interrupted.join().unwrap_or_else(panicked)
    })?;
    let ended = Instant::now();
    outcome.expected = 2 * outcome.frames;
    let delivered = || {
        receivers
            .iter()
            .map(|(_, checked)| lock(checked).delivered)
            .sum::<u64>()
    };
    while delivered() < outcome.expected && ended.elapsed() < PATIENCE && !stop.is_asked() {
        thread::sleep(Duration::from_millis(50));
    }
    outcome.outages = uplinks.iter().map(|uplink| uplink.status().outages).sum();
    let mut delays = Latencies::default();
    // All at once, since closing a session takes a moment.
    let reports = thread::scope(|scope| {
        let finishing: Vec<_> = receivers
            .into_iter()
            .map(|(downlink, checked)| (scope.spawn(|| downlink.finish()), checked))
            .collect();
        let joined = finishing.into_iter().map(|(finishing, checked)| {
            let report = finishing.join().unwrap_or_else(panicked);
            report.map(|report| (report, checked))
        });
        joined.collect::<Result<Vec<_>>>()
    })?;
    for (report, checked) in reports {
        delays.merge(&report.delays);
        outcome.outages += report.outages;
        outcome.again += report
            .sensors
            .iter()
            .map(|sensor| sensor.again)
            .sum::<u64>();
        outcome.lost += report.sensors.iter().map(|sensor| sensor.lost).sum::<u64>();
        let checked = lock(&checked);
        outcome.delivered += checked.delivered;
        outcome.wrong += checked.wrong;
        let late_s = checked
            .latest
            .saturating_duration_since(ended)
            .as_secs_f64();
        outcome.late_s = outcome.late_s.max(late_s);
    }
    let delays = delays.quantiles();
    (
        outcome.delay_p50_ms,
        outcome.delay_p99_ms,
        outcome.delay_max_ms,
    ) = (
        delays.map(|delays| delays.p50_ms),
        delays.map(|delays| delays.p99_ms),
        delays.map(|delays| delays.max_ms),
    );
    outcome.memory_peak_bytes = Usage::now().memory_peak_bytes.unwrap_or(0);
    thread::scope(|scope| {
        for uplink in uplinks {
            scope.spawn(move || uplink.finish(Duration::ZERO));
        }
        for hub in hubs.into_iter().chain(last) {
            scope.spawn(move || hub.finish_soon());
        }
    });
    Ok(outcome)
}

/// Sends each sensor's frames when they are due.
fn play(
    fleet: &Fleet,
    parts: &HashMap<Name, Part>,
    uplinks: &[Uplink],
    outcome: &mut Outcome,
    stop: &Stop,
) -> Result<()> {
    let options = fleet.options;
    let window = Duration::from_micros(options.window_us.into());
    let usage = Usage::now();
    let started = Instant::now();
    // When each sensor's next frame is due, staggered evenly over a window.
    let mut due: BinaryHeap<Reverse<(Duration, usize, u64)>> = (0..uplinks.len())
        .map(|number| Reverse((window * number as u32 / uplinks.len() as u32, number, 0)))
        .collect();
    while let Some(Reverse((at, sensor, number))) = due.pop() {
        if at >= options.duration || stop.is_asked() {
            break;
        }
        let now = started.elapsed();
        if at > now {
            thread::sleep(at - now);
        }
        let part = &parts[&fleet.names[sensor]];
        let (frame, events) = &part.frames[(part.start + number as usize) % part.frames.len()];
        // The frame is due as long ago as the loop is late.
        let late_us = started.elapsed().saturating_sub(at).as_micros() as u64;
        let uplink = &uplinks[sensor];
        uplink.send(frame, uplink.clock().now_us().saturating_sub(late_us))?;
        outcome.frames += 1;
        outcome.events += u64::from(*events);
        outcome.bytes += frame.len() as u64;
        due.push(Reverse((at + window, sensor, number + 1)));
    }
    outcome.seconds = started.elapsed().as_secs_f64();
    outcome.cores = usage.cpu_s() / outcome.seconds;
    outcome.frames_per_s = outcome.frames as f64 / outcome.seconds;
    outcome.bytes_per_s = outcome.bytes as f64 / outcome.seconds;
    Ok(())
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn wait(who: &str, is_so: &dyn Fn() -> bool, stop: &Stop) -> Result<()> {
    let started = Instant::now();
    while !is_so() {
        ensure!(!stop.is_asked(), "stopped before the {who} were connected");
        ensure!(
            started.elapsed() < PATIENCE,
            "{who} get no link: a process may be allowed too few sockets (ulimit -n), or the \
             machine is too slow"
        );
        thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}

/// Returns the frames of the nine scenes: lossless, with the fast coder, one per window.
fn scenes(options: Options, stop: &Stop) -> Result<Vec<Arc<Played>>> {
    let mode = Mode::Hybrid(Hybrid {
        coder: Coder::Fast,
        fidelity: Fidelity::Lossless,
    });
    let window = WindowConfig::new(options.sensor, options.window_us);
    let config = Config::new(window, ThresholdsFile::scenes()?.thresholds()?, mode);
    let mut scenes = Vec::new();
    for preset in PRESETS {
        ensure!(!stop.is_asked(), "stopped before the scenes were made");
        let mut scene = SceneConfig::model_1(preset, options.seed);
        scene.sensor = options.sensor;
        scene.duration_us = SCENE_US;
        let mut frames = Pieces::default();
        let limits = Limits::default();
        encode(
            &mut emulate(scene)?,
            config,
            limits,
            NonZeroUsize::MIN,
            &mut frames,
            &mut |_| {},
        )?;
        let frames = frames.0;
        ensure!(
            !frames.is_empty(),
            "the scene has no events: give a larger sensor"
        );
        scenes.push(Arc::new(frames));
    }
    Ok(scenes)
}

/// Collects frames and their numbers of events.
#[derive(Default)]
struct Pieces(Played);

impl FrameSink for Pieces {
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> io::Result<()> {
        self.0.push((bytes.to_vec(), header.events));
        Ok(())
    }
}

/// Length of a scene, in microseconds.
const SCENE_US: u64 = 2_000_000;

impl Fleet {
    fn new(options: Options, folder: &Path, stop: &Stop) -> Result<Self> {
        let authority = Authority::open(folder, 1)?;
        let host = ["127.0.0.1".to_owned()];
        let mut names = Vec::new();
        for number in 0..options.sensors {
            ensure!(!stop.is_asked(), "stopped before all keys were made");
            let name: Name = format!("{}/{number}", number % options.hubs).parse()?;
            authority.sign(&Role::Sensor(name.clone()), &[], &[], 1)?;
            names.push(name);
        }
        for number in 0..options.hubs {
            authority.sign(&Role::Hub(number.to_string()), &host, &[], 1)?;
        }
        authority.sign(
            &Role::Receiver("all".to_owned()),
            &[],
            &["**".to_owned()],
            1,
        )?;
        let mut ports = Vec::new();
        for _ in 0..options.hubs {
            ports.push(TcpListener::bind("127.0.0.1:0")?.local_addr()?.port());
        }
        Ok(Self {
            options,
            folder: folder.to_owned(),
            ports,
            names,
        })
    }

    fn links(&self, hub: usize, role: &str) -> Links {
        Links {
            connect: vec![format!("tls/127.0.0.1:{}", self.ports[hub])],
            listen: Vec::new(),
            keys: Some(self.folder.join(role)),
        }
    }

    fn hub(&self, number: usize) -> Result<Hub> {
        let mut access = Access::read(&self.folder)?;
        // A hub knows only its own sensors.
        access
            .sensors
            .retain(|name| name.as_str().starts_with(&format!("{number}/")));
        let links = Links {
            connect: match number {
                0 => Vec::new(),
                _ => vec![format!("tls/127.0.0.1:{}", self.ports[0])],
            },
            listen: vec![format!("tls/127.0.0.1:{}", self.ports[number])],
            keys: Some(self.folder.join(format!("hub-{number}"))),
        };
        let options = hub::Options {
            name: number.to_string(),
            watch: Some(format!("{number}/**")),
            access: Some(access),
            ..hub::Options::default()
        };
        Hub::start(options, &links, None)
    }

    /// Stops the last hub for the set time; returns the hub that runs afterwards.
    fn interrupt(
        &self,
        hub: Option<Hub>,
        stop: &Stop,
        say: &mut (dyn FnMut(&str) + Send),
    ) -> Result<Option<Hub>> {
        let wait = |time: Duration| {
            let started = Instant::now();
            while started.elapsed() < time && !stop.is_asked() {
                thread::sleep(Duration::from_millis(10));
            }
        };
        let running = match hub {
            Some(running) if !self.options.outage.is_zero() => running,
            hub => return Ok(hub),
        };
        let number = self.options.hubs - 1;
        wait(self.options.duration / 3);
        running.finish()?;
        say(&format!("hub {number} is stopped"));
        wait(self.options.outage);
        let hub = self.hub(number)?;
        say(&format!("hub {number} is back"));
        Ok(Some(hub))
    }

    fn sensor(&self, hub: usize, name: &Name) -> Result<Uplink> {
        let options = uplink::Options {
            name: name.clone(),
            sensor: self.options.sensor,
            memory_bytes: 4 << 20,
            disk: None,
            bytes_per_second: None,
            clock: Clock::start(),
        };
        let role = format!("sensor-{}", name.as_str().replace('/', "."));
        Uplink::start(&options, &self.links(hub, &role)).context("a sensor")
    }

    fn receiver(
        &self,
        hub: usize,
        names: &str,
        parts: &Arc<HashMap<Name, Part>>,
    ) -> Result<(Downlink, Arc<Mutex<Checked>>)> {
        let checked = Arc::new(Mutex::new(Checked {
            parts: Arc::clone(parts),
            next: HashMap::new(),
            delivered: 0,
            wrong: 0,
            latest: Instant::now(),
        }));
        let own = Arc::clone(&checked);
        let options = downlink::Options {
            names: vec![names.to_owned()],
            ..downlink::Options::default()
        };
        let deliver = move |delivered: Delivered<'_>| {
            lock(&own).take(&delivered);
            Ok(())
        };
        let links = self.links(hub, "receiver-all");
        Ok((
            Downlink::start(options, &links, Box::new(deliver))?,
            checked,
        ))
    }
}

impl Checked {
    fn take(&mut self, delivered: &Delivered<'_>) {
        let number = delivered.stamp.number;
        let want = self.parts.get(delivered.name).and_then(|part| {
            let at = (part.start as u64 + number) % part.frames.len() as u64;
            part.frames.get(at as usize)
        });
        let next = self.next.entry(delivered.name.clone()).or_insert(0);
        let is_right = *next == number && want.is_some_and(|(frame, _)| frame == delivered.frame);
        *next = number + 1;
        if is_right {
            self.delivered += 1;
        } else {
            self.wrong += 1;
        }
        self.latest = Instant::now();
    }
}
