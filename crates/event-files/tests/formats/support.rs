//! Provides events for the format tests, and functions to write and read them.

use std::io::Cursor;
use std::path::Path;

use event_files::{self, EventReader};
use event_types::{Event, Polarity, Sensor};
use proptest::prelude::*;

/// Every extension that can be written, and a sensor that its format can hold.
pub const FORMATS: &[(&str, Sensor)] = &[
    ("aedat4", of(346, 260)),
    ("aedat", of(128, 128)),
    ("aedat", of(240, 180)),
    ("evt2.raw", of(640, 480)),
    ("raw", of(1280, 720)),
    ("evt21.raw", of(346, 260)),
    ("evt4.raw", of(346, 260)),
    ("evt4", of(17, 2048)),
    ("dat", of(1280, 720)),
    ("es", of(304, 240)),
    ("bin", of(34, 34)),
    ("mcap", of(2048, 2048)),
    ("db3", of(640, 480)),
    ("bag", of(640, 480)),
    ("csv", of(2048, 2048)),
    ("txt", of(34, 34)),
    ("h5", of(346, 260)),
    ("arrow", of(1280, 720)),
    ("arrows", of(640, 480)),
    ("parquet", of(2048, 2048)),
    ("npz", of(320, 240)),
    ("mat", of(320, 240)),
];

const fn of(width: u16, height: u16) -> Sensor {
    Sensor { width, height }
}

/// Returns events like those in the seeds of `fuzz/seeds/*.py`: every 17 us from `start_us` on, on 64 x 48 pixels.
pub fn regular(start_us: u64, count: u32) -> Vec<Event> {
    (0..count)
        .map(|i| Event {
            t_us: start_us + u64::from(i) * 17,
            x: (i * 7 % 64) as u16,
            y: (i * 3 % 48) as u16,
            polarity: Polarity::from_bool(i % 3 == 0),
        })
        .collect()
}

/// Generates events that begin at any time, with duplicates, equal times, small steps back, both polarities, rows
/// of neighbours, and gaps that make short time fields wrap.
pub fn events(sensor: Sensor, count: usize) -> impl Strategy<Value = Vec<Event>> {
    let step = prop_oneof![
        4 => Just(0_i64),
        4 => 0..100_i64,
        2 => -2_000..10_000_i64,
        1 => 0..40_000_000_i64,
    ];
    let pixel = (0..sensor.width, 0..sensor.height, any::<bool>(), 1..14_u16);
    let start = prop_oneof![Just(0_u64), 0..1_u64 << 33, Just(1_633_953_690_975_950)];
    (start, prop::collection::vec((step, pixel), 0..count)).prop_map(move |(start, steps)| {
        let mut t_us = start;
        let mut events = Vec::new();
        for (step, (x, y, on, run)) in steps {
            t_us = t_us.saturating_add_signed(step);
            let polarity = Polarity::from_bool(on);
            // A run of 13 is a duplicate; other runs are neighbours in a row.
            for i in 0..run {
                let x = if run == 13 { x } else { (x + i) % sensor.width };
                events.push(Event {
                    t_us,
                    x,
                    y,
                    polarity,
                });
            }
        }
        events
    })
}

/// Adapts the times of events, and their order, to what files with this ending can hold.
pub fn fitted(extension: &str, mut events: Vec<Event>) -> Vec<Event> {
    let path = format!("events.{extension}");
    let (format, _) = event_files::writable(Path::new(&path)).expect("a known extension");
    for event in &mut events {
        event.t_us %= format.limits.t_max_us + 1;
    }
    if !format.limits.steps_back {
        events.sort_by_key(|event| event.t_us);
    }
    events
}

/// Writes events into `folder` and returns the file's bytes.
pub fn written(folder: &Path, extension: &str, sensor: Sensor, events: &[Event]) -> Vec<u8> {
    let path = folder.join(format!("events.{extension}"));
    let mut writer = event_files::create(&path, sensor).expect("a known extension");
    // Uneven parts: a writer must not depend on how the events arrive.
    for piece in events.chunks(777) {
        writer.write(piece).expect("events that the format holds");
    }
    writer.finish().expect("a finished file");
    std::fs::read(&path).expect("the written file")
}

/// Reads until the end or an error.
pub fn drain(reader: &mut dyn EventReader) -> (Vec<Event>, Option<event_files::Error>) {
    let mut events = Vec::new();
    loop {
        let before = events.len();
        match reader.read(&mut events) {
            Ok(0) => return (events, None),
            Ok(read) => {
                assert_eq!(events.len() - before, read);
                assert!(read <= event_files::BATCH_EVENTS);
            }
            Err(error) => {
                assert_eq!(events.len(), before, "an error must not come with events");
                assert!(
                    matches!(reader.read(&mut events), Ok(0)),
                    "an error is the end"
                );
                return (events, Some(error));
            }
        }
    }
}

/// Opens bytes and reads them; an error on opening counts as an error before the first event.
pub fn read(bytes: &[u8], size: Option<Sensor>) -> (Vec<Event>, Option<event_files::Error>) {
    read_as("test", bytes, size)
}

/// Reads like [`read`], from a file of this name, by which some formats are recognised.
pub fn read_as(
    name: &str,
    bytes: &[u8],
    size: Option<Sensor>,
) -> (Vec<Event>, Option<event_files::Error>) {
    match event_files::open_source(Box::new(Cursor::new(bytes.to_vec())), name, size) {
        Ok(mut reader) => drain(reader.as_mut()),
        Err(error) => (Vec::new(), Some(error)),
    }
}
