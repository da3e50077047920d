//! What the cameras send: an emulated scene for every model, and every recording that fits its sensor.
//!
//! A plan has one line per camera, which `offer.sh` reads:
//!
//! ```text
//! MODEL NAME WIDTH HEIGHT START_US DIGEST FILE
//! ```
//!
//! `START_US` is the time of the first event on the device's clock. It is chosen such that time crosses 2^31 us
//! halfway through the events, after more wraps than one word can count.

use std::path::Path;

use anyhow::Result;
use eecvs_nostd::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use usb_bridge::device::{MODELS, Model};

use super::digest::Digest;
use super::recordings::{self, Recording, cross_2_31_us};

/// Number of events in a scene, before duplicates are removed.
const EVENTS: usize = 100_000;

/// Sensors, of which at least one fits every model.
const SENSORS: [(u16, u16); 6] = [
    (128, 128),
    (240, 180),
    (346, 260),
    (640, 480),
    (320, 240),
    (1280, 720),
];

/// Writes a scene for every model into `folder`, and prints a line for each.
pub fn scenes(folder: &str) -> Result<()> {
    for model in MODELS {
        // These models have the USB IDs of another model, which distinguishes them by their sensor.
        if model.identities().is_empty() {
            continue;
        }
        let sensor = SENSORS
            .iter()
            .filter_map(|&(width, height)| Sensor::new(width, height))
            .find(|sensor| model.writer(*sensor).is_some());
        let Some(sensor) = sensor else {
            eprintln!("{}: no sensor in the list fits this model", model.name());
            continue;
        };
        let path = Path::new(folder).join(format!("{}.npz", model.name()));
        let events = scene(sensor, EVENTS);
        let mut file = event_files::create(&path, sensor)?;
        file.write(&events)?;
        file.finish()?;
        line(*model, "scene", sensor, events, &path);
    }
    Ok(())
}

/// Returns random events in order of time, with bursts, simultaneous events and pauses over several wraps of 2^15
/// us.
pub fn scene(sensor: Sensor, count: usize) -> Vec<Event> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut below = |end: u16| (random.next_u64() % u64::from(end)) as u16;
    let mut t_us = 0;
    let mut events: Vec<Event> = (0..count)
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
    // Some sensors send only one event per pixel and time.
    events.sort_unstable();
    events.dedup_by_key(|event| (event.t_us, event.x, event.y));
    events
}

/// Prints a line for every recording in `data` and every model that it fits. If `chosen` is not empty, only its
/// entries are used, each a `MODEL` or a `MODEL:RECORDING`.
pub fn recordings(data: &str, chosen: &[&str]) -> Result<()> {
    let is_chosen = |model: &str, name: &str| {
        let both = format!("{model}:{name}");
        chosen.is_empty() || chosen.iter().any(|one| *one == model || *one == both)
    };
    let wanted = |name: &str| MODELS.iter().any(|model| is_chosen(model.name(), name));
    for recording in recordings::all(Path::new(data), &wanted)? {
        let Recording { name, sensor, path } = &recording;
        let fits =
            |model: &&&dyn Model| is_chosen(model.name(), name) && model.writer(*sensor).is_some();
        let models: Vec<_> = MODELS.iter().filter(fits).collect();
        if models.is_empty() {
            continue;
        }
        let events = recording.events(usize::MAX)?;
        for model in models {
            line(*model, name, *sensor, events.clone(), path);
        }
    }
    Ok(())
}

fn line(model: &dyn Model, name: &str, sensor: Sensor, mut events: Vec<Event>, path: &Path) {
    let start_us = cross_2_31_us(&mut events);
    let mut digest = Digest::default();
    digest.take(&events);
    let Sensor { width, height } = sensor;
    let (model, digest, path) = (model.name(), digest.words(), path.display());
    println!("{model} {name} {width} {height} {start_us} {digest} {path}");
}
