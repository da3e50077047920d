//! Tests MAT-files written by scipy (fuzz/seeds/read_mat.py), and others of different byte order, size and content.

use std::io::Cursor;
use std::path::Path;

use event_files::{self, MatWriter};
use event_types::{Event, Sensor};

use crate::support::{read, regular};

const SEEDS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/seeds/read_mat");

/// Returns the events of the seeds.
fn events() -> Vec<Event> {
    regular(1_000_000, 300)
}

fn seed(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(SEEDS).join(name)).expect("a committed seed")
}

/// Reads a file; returns the size that it states or that holds its events, and the events.
fn sensor_and_events(bytes: Vec<u8>) -> (Sensor, Vec<Event>) {
    let source = Box::new(Cursor::new(bytes));
    let mut reader = event_files::open_source(source, "test.mat", None).expect("a recording");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("events") > 0 {}
    (reader.sensor(), events)
}

#[test]
fn seeds_of_scipy() {
    let events = events();
    let sensor = Sensor {
        width: 64,
        height: 48,
    };
    for name in [
        "structure.mat",
        "structure_packed.mat",
        "from_one.mat",
        "variables.mat",
        "variables_packed.mat",
        "matrix.mat",
        "matrix_packed.mat",
    ] {
        let (found, got) = sensor_and_events(seed(name));
        assert_eq!(got, events, "{name}");
        // The events need only rows 0 to 45.
        let largest = Sensor {
            height: 46,
            ..sensor
        };
        let want = if name == "structure_packed.mat" {
            sensor
        } else {
            largest
        };
        assert_eq!(found, want, "{name}");
    }
}

#[test]
fn a_variable_is_named_behind_the_file() {
    let open = |place: &str| {
        let path = Path::new(SEEDS).join("structure.mat").join(place);
        event_files::open(&path, None).map(drop)
    };
    open("td_data").expect("events");
    for other in ["info", "nothing"] {
        let error = open(other).expect_err("no events").to_string();
        assert!(
            error.contains(other) && error.contains("td_data (x, y, p, ts)"),
            "{error}"
        );
    }
}

/// Returns a file of either byte order with rows of doubles.
fn doubles(big_endian: bool, variables: &[(&str, &[f64])]) -> Vec<u8> {
    let word = |value: u32| {
        if big_endian {
            value.to_be_bytes()
        } else {
            value.to_le_bytes()
        }
    };
    let words = |values: &[u32]| values.iter().copied().flat_map(word).collect::<Vec<u8>>();
    let mut bytes = vec![b' '; 124];
    bytes.extend(if big_endian {
        *b"\x01\0MI"
    } else {
        *b"\0\x01IM"
    });
    for (name, values) in variables {
        assert!(name.len() <= 4, "a small element");
        let mut letters = name.as_bytes().to_vec();
        letters.resize(4, 0);
        let mut array = words(&[6, 8, 6, 0, 5, 8, 1, values.len() as u32]);
        array.extend(word((name.len() as u32) << 16 | 1));
        array.extend(letters);
        array.extend(words(&[9, 8 * values.len() as u32]));
        array.extend(values.iter().flat_map(|value| {
            if big_endian {
                value.to_be_bytes()
            } else {
                value.to_le_bytes()
            }
        }));
        bytes.extend(words(&[14, array.len() as u32]));
        bytes.extend(array);
    }
    bytes
}

fn columns(events: &[Event]) -> [Vec<f64>; 4] {
    let of = |number: fn(&Event) -> f64| events.iter().map(number).collect();
    [
        of(|event| event.t_us as f64),
        of(|event| event.x.into()),
        of(|event| event.y.into()),
        of(|event| event.polarity.sign().into()),
    ]
}

#[test]
fn both_byte_orders() {
    // More than two batches.
    let events = regular(1_700_000_000_000_000, 40_000);
    let [t, x, y, p] = columns(&events);
    for big_endian in [false, true] {
        let bytes = doubles(big_endian, &[("x", &x), ("y", &y), ("p", &p), ("ts", &t)]);
        assert_eq!(
            sensor_and_events(bytes).1,
            events,
            "big-endian: {big_endian}"
        );
    }
}

#[test]
fn what_is_wrong_is_said() {
    let [t, x, y, p] = columns(&events());
    let file = |variables: &[(&str, &[f64])]| doubles(false, variables);
    let good = file(&[("x", &x), ("y", &y), ("p", &p), ("t", &t)]);
    let short = file(&[("x", &x), ("y", &y[1..]), ("p", &p), ("t", &t)]);
    let missing = file(&[("x", &x), ("y", &y), ("t", &t)]);
    let mut of_seven = p.clone();
    of_seven[17] = 7.0;
    let polarity = file(&[("x", &x), ("y", &y), ("p", &of_seven), ("t", &t)]);
    let mut cut = good.clone();
    cut.truncate(good.len() - 9);
    let empty = file(&[("x", &[]), ("y", &[]), ("p", &[]), ("t", &[])]);
    let twice = {
        let mut bytes = seed("structure.mat");
        bytes.extend_from_slice(&seed("from_one.mat")[128..]);
        bytes
    };
    for (bytes, whole, parts) in [
        (short, 0, &["299 values of y, but 300 times"][..]),
        (
            missing,
            0,
            &["no events", "x (1 x 300), y (1 x 300), t (1 x 300)"],
        ),
        (polarity, 17, &["event 17", "polarity"]),
        (cut, 0, &["truncated"]),
        (empty, 0, &["no event, so no sensor size"]),
        (twice, 0, &["several structures", "td_data", "TD"]),
    ] {
        let (got, error) = read(&bytes, None);
        let error = error.expect("an error").to_string();
        assert_eq!(got.len(), whole, "{error}");
        for part in parts {
            assert!(error.contains(part), "{part}: {error}");
        }
    }
}

#[test]
fn a_written_file_states_its_size() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mat");
    let sensor = Sensor {
        width: 640,
        height: 480,
    };
    let mut writer = Box::new(MatWriter::create(&path, sensor).expect("a file"));
    event_files::EventWriter::write(writer.as_mut(), &events()).expect("events");
    event_files::EventWriter::finish(writer).expect("a whole file");
    let bytes = std::fs::read(&path).expect("a file");
    assert_eq!(sensor_and_events(bytes), (sensor, events()));
}
