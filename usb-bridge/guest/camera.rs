//! Cameras of every model: what `eecvs-usb simulate` sends on the host is captured in the guest.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use eecvs_nostd::{Event, Polarity, Sensor};
use host_harness::formats;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use usb_bridge::device::{MODELS, Model, find};
use usb_bridge::link::usb::{Bus, Device};
use usb_bridge::link::{Link as _, Received};

use super::APPEARS;

/// Events of a scene.
const EVENTS: usize = 100_000;
/// A scene's first event: it crosses 2^31 us.
const FIRST_US: u64 = (1 << 31) - 400_000;
/// Nothing more comes after this time.
const QUIET: Duration = Duration::from_secs(20);

/// Sensors, one of which fits every model.
const SENSORS: [(u16, u16); 6] = [
    (128, 128),
    (240, 180),
    (346, 260),
    (640, 480),
    (320, 240),
    (1280, 720),
];

/// Number of events and a sum that depends on each of them, but not on the order of those that are
/// simultaneous.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Digest {
    events: u64,
    sum: u64,
}

impl Digest {
    fn take(&mut self, events: &[Event]) {
        for event in events {
            let place = u64::from(event.x) << 33 | u64::from(event.y) << 1 | event.polarity as u64;
            let mixed = (event.t_us ^ place.wrapping_mul(0x9E37_79B9_7F4A_7C15))
                .wrapping_mul(0xD6E8_FEB8_6659_FD93);
            self.sum = self.sum.wrapping_add(mixed ^ mixed >> 32);
        }
        self.events += events.len() as u64;
    }
}

/// Writes a recording for every model, and a line `MODEL FILE EVENTS DIGEST` for each.
pub fn scenes(folder: &str) -> Result<()> {
    for model in MODELS {
        // On the bus these are another model, which the sensor tells apart.
        if model.identities().is_empty() {
            continue;
        }
        let sensor = SENSORS
            .iter()
            .filter_map(|&(width, height)| Sensor::new(width, height))
            .find(|sensor| model.writer(*sensor).is_some());
        let Some(sensor) = sensor else {
            eprintln!("{}: no sensor of the list fits", model.name());
            continue;
        };
        let path = Path::new(folder).join(format!("{}.npz", model.name()));
        let events = scene(sensor);
        let mut digest = Digest::default();
        digest.take(&events);
        let mut file = formats::create(&path, sensor)?;
        file.write(&events)?;
        file.finish()?;
        let (name, path) = (model.name(), path.display());
        println!("{name} {path} {} {}", digest.events, digest.sum);
    }
    Ok(())
}

/// Random events in the order of time, with bursts, simultaneous ones and pauses over several wraps
/// of 2^15 us.
fn scene(sensor: Sensor) -> Vec<Event> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut below = |end: u16| (random.next_u64() % u64::from(end)) as u16;
    let mut t_us = FIRST_US;
    let mut events: Vec<Event> = (0..EVENTS)
        .map(|_| {
            t_us += match below(10_000) {
                0 => 100_000 + u64::from(below(50_000)),
                1..5000 => 0,
                _ => u64::from(below(12)),
            };
            Event {
                t_us,
                x: below(sensor.width),
                y: below(sensor.height),
                polarity: Polarity::from_bool(below(2) == 1),
            }
        })
        .collect();
    // Some sensors send an event of a pixel and a time once.
    events.sort_unstable();
    events.dedup_by_key(|event| (event.t_us, event.x, event.y));
    events
}

/// Captures from each camera of `MODEL EVENTS DIGEST` what was announced.
pub fn capture(wanted: &[&str]) -> Result<()> {
    for one in wanted.chunks(3) {
        let [name, events, sum] = *one else {
            bail!("{one:?}: not MODEL EVENTS DIGEST");
        };
        let model = find(name).context("no such model")?;
        let expected = Digest {
            events: events.parse().context("EVENTS")?,
            sum: sum.parse().context("DIGEST")?,
        };
        let started = Instant::now();
        let device = open(model).context(model.name())?;
        let (found, bytes) = capture_one(model, &device, expected.events).context(model.name())?;
        ensure!(
            found == expected,
            "{name}: {found:?} came, {expected:?} was sent"
        );
        println!(
            "ok: {name}: {events} events in {bytes} bytes ({} ms)",
            started.elapsed().as_millis()
        );
    }
    Ok(())
}

fn open(model: &'static dyn Model) -> Result<Device> {
    let until = Instant::now() + APPEARS;
    loop {
        match Bus::new()?.find(Some(model.name())) {
            Ok(found) => return Ok(found.open(model.transfers().interface)?),
            Err(error) if Instant::now() > until => return Err(error.into()),
            Err(_) => std::thread::sleep(Duration::from_millis(100)),
        }
    }
}

/// What came from a camera, up to this number of events, and the bytes that held it.
fn capture_one(model: &dyn Model, device: &Device, events: u64) -> Result<(Digest, u64)> {
    let mut control = device.control();
    let info = model.identify(&mut control)?;
    let mut parser = model.parser(&info);
    let mut link = device.stream(&model.transfers())?;
    model.start(&info, &mut control)?;
    let mut digest = Digest::default();
    let mut batch = Vec::new();
    let mut all = 0;
    while digest.events < events {
        match link.receive(QUIET)? {
            Received::Bytes { bytes, .. } => {
                all += bytes.len() as u64;
                batch.clear();
                parser.parse(bytes, &mut batch);
                digest.take(&batch);
            }
            other => bail!("{other:?} after {} events of {events}", digest.events),
        }
    }
    model.stop(&info, &mut control)?;
    let losses: Vec<_> = parser.losses().iter().collect();
    ensure!(losses.is_empty(), "lost: {losses:?}");
    Ok((digest, all))
}
