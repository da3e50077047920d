//! Tests Arrow and Parquet files: those of pyarrow are read whole, this crate's own are sought in, and errors are
//! explained.

use std::path::Path;

use event_types::{Event, Sensor};

use crate::support::{drain, read, regular, written};

const SENSOR: Sensor = Sensor {
    width: 64,
    height: 48,
};

fn events(count: u32) -> Vec<Event> {
    regular(1_000_000, count)
}

fn seeds(folder: &str) -> Vec<(String, Vec<u8>)> {
    let seeds = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/seeds"));
    let files = std::fs::read_dir(seeds.join(folder)).expect("a folder of seeds");
    let files = files.map(|file| {
        let path = file.expect("a file").path();
        let bytes = std::fs::read(&path).expect("a seed of the fuzz targets");
        (path.display().to_string(), bytes)
    });
    files.collect()
}

/// Reads every type, encoding and compression of `fuzz/seeds/read_tables.py`.
#[test]
fn files_of_the_library() {
    let want = events(300);
    for (folder, files) in [("read_arrow", 6), ("read_parquet", 9)] {
        let seeds = seeds(folder);
        assert_eq!(seeds.len(), files);
        for (name, bytes) in seeds {
            let (got, error) = read(&bytes, None);
            assert!(error.is_none(), "{name}: {error:?}");
            assert_eq!(got, want, "{name}");
        }
    }
}

#[test]
fn the_size_is_the_metadata_s_or_the_callers_or_the_largest() {
    let open = |bytes: &[u8], size| {
        let source = Box::new(std::io::Cursor::new(bytes.to_vec()));
        let reader = event_files::open_source(source, "test", size);
        reader.expect("a recording").sensor()
    };
    let wide = Sensor {
        width: 640,
        height: 480,
    };
    let largest = Sensor {
        width: 64,
        height: 46,
    };
    for (name, bytes) in [seeds("read_arrow"), seeds("read_parquet")].concat() {
        let states = name.contains("plain") || name.contains("stream");
        let want = if states { SENSOR } else { wide };
        assert_eq!(open(&bytes, Some(wide)), want, "{name}");
        let want = if states { SENSOR } else { largest };
        assert_eq!(open(&bytes, None), want, "{name}");
    }
}

#[test]
fn seeking_finds_every_event_from_a_time_on() {
    // Three row groups, five record batches.
    let events = events(300_000);
    let folder = tempfile::tempdir().expect("a folder");
    let last = events[events.len() - 1].t_us;
    for (extension, part) in [
        ("arrow", 1 << 16),
        ("arrows", 1 << 16),
        ("parquet", 1 << 17),
    ] {
        let bytes = written(folder.path(), extension, SENSOR, &events);
        for t_us in [0, 1_000_000, 1_000_001, 4_000_000, last - 1, last, last + 1] {
            let source = Box::new(std::io::Cursor::new(bytes.clone()));
            let mut reader = event_files::open_source(source, "test", None).expect("a recording");
            reader.read(&mut Vec::new()).expect("a batch");
            assert!(reader.seek(t_us).expect("a place"));
            let (got, error) = drain(reader.as_mut());
            assert!(error.is_none(), "{error:?}");
            assert!(events.ends_with(&got), "{extension}: {t_us}");
            let first = events.partition_point(|event| event.t_us < t_us);
            let more = got.len().checked_sub(events.len() - first);
            let more = more.expect("no event of that time and later is left out");
            assert!(more <= part, "{extension}: {t_us}: {more} earlier events");
        }
    }
}

#[test]
fn events_before_a_damage_are_read() {
    let events = events(200_000);
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = written(folder.path(), "arrows", SENSOR, &events);
    // Within the third batch.
    let (got, error) = read(&bytes[..bytes.len() * 3 / 4], None);
    assert_eq!(got, events[..2 << 16]);
    let error = format!("{:#}", error.expect("a truncated file"));
    assert!(
        error.contains("byte ") && error.contains("truncated"),
        "{error}"
    );
    // Damage at nine tenths of the file lies after the first row group.
    let bytes = written(folder.path(), "parquet", SENSOR, &events);
    let mut damaged = bytes.clone();
    let second = bytes.len() * 9 / 10;
    damaged[second..second + 64].fill(0xff);
    let (got, error) = read(&damaged, None);
    assert!(got.len() >= 1 << 17, "{}", got.len());
    assert!(error.is_some() || got != events);
    let (got, error) = read(&bytes[..bytes.len() - 1], None);
    assert!(got.is_empty());
    let error = format!("{:#}", error.expect("no footer"));
    assert!(error.contains("truncated"), "{error}");
}

#[test]
fn what_is_no_such_file_is_named() {
    for (bytes, want) in [
        (&b"FEA1\0\0\0\0"[..], "Feather 1 is not supported"),
        (b"ARROW1\0\0", "no schema at the start"),
        (
            b"ARROW1\0\0\xff\xff\xff\xff\x10\0\0\0",
            "truncated or damaged",
        ),
        (b"PAR1\x15\0PAR1", "damaged"),
        (b"PAR1\0\0\0\0\0\0\0\0PARE", "encrypted"),
        (b"PAR1\x00\x01\0\0\0PAR1", "the footer is damaged"),
    ] {
        let source = Box::new(std::io::Cursor::new(bytes.to_vec()));
        let error = event_files::open_source(source, "test", None).map(drop);
        let error = format!("{:#}", error.expect_err(want));
        assert!(error.contains(want) && error.contains("byte "), "{error}");
    }
}
