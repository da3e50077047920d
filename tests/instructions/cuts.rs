//! Windows of events as EVT 2.0 words, for an image that has no files.
//!
//! A cut is 32-bit little-endian words: width, height, `window_us`, number of events, then the
//! EVT 2.0 words with the `TIME_HIGH`s that they need. Its windows are those of the encoder:
//! aligned to the first event.

use std::fs;
use std::path::Path;

use anyhow::Context;
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::{Event, Sensor};
use host_harness::formats::{self, EventReader};
use host_harness::scene::{self, Preset, SceneConfig};

/// Most events of a cut: the image's window holds them all.
pub const EVENTS: usize = 8192;
/// Window of the cuts that have several.
const WINDOW_US: u32 = 32_768;

/// Which events a cut takes.
#[derive(Debug, Clone, Copy)]
enum Take {
    /// [`EVENTS`] in one window, after so many others.
    OneWindow { skip: usize },
    /// As many whole windows as hold at most [`EVENTS`].
    Windows,
}

/// Name, file, sensor, what to take.
const RECORDINGS: [(&str, &str, [u16; 2], Take); 3] = [
    (
        "davis346",
        "davis346_building_dense/davis.aedat4",
        [320, 320],
        Take::OneWindow { skip: 50_000 },
    ),
    (
        "sparse",
        "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
        [128, 128],
        Take::Windows,
    ),
    (
        "dense",
        "gen3_vga_dense_evt2/evt2.raw",
        [640, 480],
        Take::OneWindow { skip: 100_000 },
    ),
];

/// Name, scene, sensor, what to take.
const SCENES: [(&str, Preset, [u16; 2], Take); 3] = [
    (
        "moderate",
        Preset::IndoorFlying,
        [320, 320],
        Take::OneWindow { skip: 0 },
    ),
    ("sparse", Preset::IndoorDarkHdr, [128, 128], Take::Windows),
    (
        "dense",
        Preset::Motorcycle,
        [96, 72],
        Take::OneWindow { skip: 20_000 },
    ),
];

/// Writes `folder/recordings/NAME.words` and `folder/emulator/NAME.words`; a cut of a recording
/// that is not there is an empty file.
pub fn write(folder: &Path, recordings: Option<&Path>) -> anyhow::Result<()> {
    for (name, file, [width, height], take) in RECORDINGS {
        let to = folder.join("recordings").join(name);
        let path = recordings.map(|recordings| recordings.join(file));
        match path.filter(|path| path.exists()) {
            Some(path) => {
                let mut reader = formats::open(&path, None)?;
                let sensor = Sensor { width, height };
                write_cut(&to, reader.as_mut(), sensor, take)?;
            }
            None => {
                println!("{file}: not there, no cut");
                write_words(&to, &[])?;
            }
        }
    }
    for (name, preset, [width, height], take) in SCENES {
        let sensor = Sensor { width, height };
        let mut scene = scene::emulate(SceneConfig {
            sensor,
            ..SceneConfig::new(preset, 1)
        })?;
        write_cut(
            &folder.join("emulator").join(name),
            &mut scene,
            sensor,
            take,
        )?;
    }
    Ok(())
}

fn write_cut(
    to: &Path,
    reader: &mut dyn EventReader,
    sensor: Sensor,
    take: Take,
) -> anyhow::Result<()> {
    let skip = match take {
        Take::OneWindow { skip } => skip,
        Take::Windows => 0,
    };
    let mut events: Vec<Event> = Vec::new();
    // One event more than fits shows where the last whole window ends.
    while events.len() <= skip + EVENTS && reader.read(&mut events)? > 0 {
        events.retain(|event| sensor.contains(event.x, event.y));
    }
    events.drain(..skip.min(events.len()));
    let first = events.first().context("a recording without events")?.t_us;
    let window_us = match take {
        Take::OneWindow { .. } => {
            events.truncate(EVENTS);
            let last = events.iter().map(|event| event.t_us).max();
            u32::try_from(last.map_or(0, |last| last - first) + 1)?
        }
        Take::Windows => {
            if let Some(over) = events.get(EVENTS) {
                let end = over.t_us - (over.t_us - first) % u64::from(WINDOW_US);
                events.retain(|event| event.t_us < end);
            }
            WINDOW_US
        }
    };
    anyhow::ensure!(
        !events.is_empty() && events.len() <= EVENTS,
        "{}: no whole window fits",
        to.display()
    );
    let mut words = vec![
        u32::from(sensor.width),
        u32::from(sensor.height),
        window_us,
        u32::try_from(events.len())?,
    ];
    // 64 us is a whole TIME_HIGH, which a base must not cut.
    let mut encoder = Evt2Encoder::new(first & !63);
    for event in &events {
        let (time, word) = encoder
            .encode(*event)
            .context("an event that EVT 2.0 cannot hold")?;
        words.extend(time);
        words.push(word);
    }
    write_words(to, &words)
}

fn write_words(to: &Path, words: &[u32]) -> anyhow::Result<()> {
    let to = to.with_extension("words");
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    let bytes = words
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .collect::<Vec<_>>();
    // An unchanged file keeps its time, so that nothing is built anew for it.
    if fs::read(&to).is_ok_and(|old| old == bytes) {
        return Ok(());
    }
    fs::write(&to, bytes).with_context(|| format!("{}: cannot be written", to.display()))
}
