//! Tests every writer in the table of formats: random events, and every shared recording that fits, come back
//! unchanged and in order. A recording that a format cannot hold is refused, and the error says why.

use std::path::{Path, PathBuf};

use event_files::fit::{Fit, beyond};
use event_files::{self, FORMATS, Format};
use event_types::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");

const EVENTS: u64 = 100_000;

/// Size for a recording whose file does not state it.
const UNTOLD: Sensor = Sensor {
    width: 304,
    height: 240,
};

/// Returns a sensor that a format can hold; AEDAT 2 has only the sizes of its cameras.
fn sensor(format: &Format) -> Sensor {
    match format.name {
        "aedat2" => Sensor {
            width: 240,
            height: 180,
        },
        _ => Fit::sensor(
            format.limits,
            Sensor {
                width: 1280,
                height: 720,
            },
        ),
    }
}

/// Returns events with equal times, neighbours, duplicates, silences and, if the format holds them, steps back.
fn random(format: &Format) -> Vec<Event> {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(8);
    let sensor = sensor(format);
    let mut below = |n: u64| rng.next_u64() % n;
    let mut events: Vec<Event> = Vec::new();
    // A time since 1970, if the format's times reach that far.
    let start = 1_700_000_000_000_000;
    let mut t_us = if start < format.limits.t_max_us {
        start
    } else {
        0
    };
    while (events.len() as u64) < EVENTS {
        let mut x = below(sensor.width.into()) as u16;
        let mut y = below(sensor.height.into()) as u16;
        let mut polarity = Polarity::from_bool(below(2) == 1);
        match (below(16), events.last()) {
            (0, _) if format.limits.steps_back => t_us -= below(t_us.min(1_000) + 1),
            (1, _) => t_us += below(60),
            (2, _) if below(2_000) == 0 => {
                t_us += below(format.limits.t_max_us / 8).min(20_000_000);
            }
            (3..8, Some(last)) if last.x + 1 < sensor.width => {
                (x, y, polarity) = (last.x + 1, last.y, last.polarity);
            }
            (8, Some(last)) => (x, y, polarity) = (last.x, last.y, last.polarity),
            _ => {}
        }
        t_us = t_us.min(format.limits.t_max_us);
        events.push(Event {
            t_us,
            x,
            y,
            polarity,
        });
    }
    events
}

fn read(path: &Path, size: Option<Sensor>) -> event_files::Result<(Sensor, Vec<Event>)> {
    let mut reader = event_files::open(path, size)?;
    let mut events = Vec::new();
    while reader.read(&mut events)? > 0 {}
    Ok((reader.sensor(), events))
}

fn write(path: &Path, sensor: Sensor, events: &[Event]) -> event_files::Result<()> {
    let mut writer = event_files::create(path, sensor)?;
    // Uneven parts: a writer must not depend on how the events arrive.
    for piece in events.chunks(7_777) {
        writer.write(piece)?;
    }
    writer.finish()
}

/// Reads back what was written; the size is passed to the reader, since not every format stores it.
fn compare(what: &str, path: &Path, sensor: Sensor, events: &[Event]) {
    let (_, got) = read(path, Some(sensor)).expect("what was written is readable");
    let differs = got.iter().zip(events).position(|(got, want)| got != want);
    assert_eq!(
        (got.len(), differs),
        (events.len(), None),
        "{what}: events and the first that differs"
    );
}

/// Returns every format with a writer, with each of its endings.
fn writers() -> impl Iterator<Item = (&'static Format, &'static str)> {
    let written = FORMATS.iter().filter(|format| format.create.is_some());
    written.flat_map(|format| format.endings.iter().map(move |ending| (format, *ending)))
}

#[test]
fn random_events_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    for (format, ending) in writers() {
        let events = random(format);
        let path = folder.path().join(format!("random{ending}"));
        write(&path, sensor(format), &events).expect("events within the format's limits");
        compare(
            &format!("{}, {ending}", format.name),
            &path,
            sensor(format),
            &events,
        );
    }
}

/// Events taken from each end of a recording: a counter's wraps lie between them.
const END_EVENTS: usize = 30_000;

/// Returns the first and last events of the shared recordings that are of a known format.
fn recordings() -> Vec<(PathBuf, Sensor, Vec<Event>)> {
    let Ok(folders) = std::fs::read_dir(SHARED) else {
        eprintln!("skipped: {SHARED} is absent");
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = folders
        .flatten()
        .filter_map(|folder| std::fs::read_dir(folder.path()).ok())
        .flatten()
        .flatten()
        .map(|file| file.path())
        .collect();
    files.sort();
    let known = files.into_iter().filter_map(|path| {
        let read = read(&path, None).or_else(|_| read(&path, Some(UNTOLD)));
        read.ok().map(|(sensor, mut events)| {
            if events.len() > 2 * END_EVENTS {
                events.drain(END_EVENTS..events.len() - END_EVENTS);
            }
            (path, sensor, events)
        })
    });
    known.collect()
}

#[test]
fn recordings_that_fit_come_back_and_others_are_refused() {
    let recordings = recordings();
    let folder = tempfile::tempdir().expect("a folder");
    for (format, ending) in writers() {
        let mut fits = 0;
        for (file, sensor, events) in &recordings {
            let path = folder.path().join(format!("recording{ending}"));
            let what = format!("{} as {}, {ending}", file.display(), format.name);
            let mut last = None;
            let mut numbered = (0..).zip(events);
            let refused = numbered.find_map(|(index, event)| {
                let why = beyond(format.limits, index, *event, last);
                last = Some(event.t_us);
                why
            });
            match write(&path, *sensor, events) {
                Ok(()) => {
                    assert_eq!(refused, None, "{what}");
                    compare(&what, &path, *sensor, events);
                    fits += 1;
                }
                Err(error) => {
                    // AEDAT 2 has only the sizes of its cameras, which the limits of single events do not express.
                    assert!(
                        refused.is_some() || format.name == "aedat2",
                        "{what}: {error:#}"
                    );
                    eprintln!("{what}: {error:#}");
                }
            }
        }
        println!("{}, {ending}: {fits} of {}", format.name, recordings.len());
        assert!(
            recordings.is_empty() || fits > 0,
            "{}: nothing fits",
            format.name
        );
    }
}
