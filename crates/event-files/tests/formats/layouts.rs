//! Tests the layouts that other tools write: the same events in every one of them.
//!
//! Arrays and zip files are built here; files that no Rust writer can produce are in `layouts/`, with the script
//! that wrote them.

use std::io::{Cursor, Write};
use std::path::Path;

use event_files::findings::Findings;
use event_files::{self, BadEvents, Columns, EventReader, Reading, TimeUnit};
use event_types::{Event, Polarity, Sensor};

use crate::support::{drain, regular};

const SENSOR: Sensor = Sensor {
    width: 64,
    height: 48,
};

/// Returns 1,000 events with steps back, equal times and both polarities, from a fixed random series.
fn random() -> Vec<Event> {
    let mut state = 1_u64;
    let mut next = |below: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let mut t_us = 5_000;
    let events = (0..1000).map(|_| {
        t_us = t_us + next(400) - next(80).min(70);
        Event {
            t_us,
            x: next(64) as u16,
            y: next(48) as u16,
            polarity: Polarity::from_bool(next(2) == 1),
        }
    });
    events.collect()
}

fn npy(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let dict = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let length = (dict.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\0", length.as_slice(), dict.as_bytes(), data].concat()
}

fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (index, (name, bytes)) in files.iter().enumerate() {
        let method = [
            zip::CompressionMethod::Deflated,
            zip::CompressionMethod::Stored,
        ][index % 2];
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        zip.start_file(*name, options).expect("an entry");
        zip.write_all(bytes).expect("its bytes");
    }
    zip.finish().expect("a zip file").into_inner()
}

fn open(bytes: Vec<u8>, reading: &Reading) -> event_files::Result<Box<dyn EventReader>> {
    event_files::open_source(Box::new(Cursor::new(bytes)), "test", reading)
}

fn check(what: &str, bytes: Vec<u8>, reading: &Reading, want: &[Event]) {
    let mut reader = open(bytes, reading).unwrap_or_else(|error| panic!("{what}: {error:#}"));
    let (got, error) = drain(reader.as_mut());
    assert!(error.is_none(), "{what}: {error:?}");
    assert!(got == want, "{what}: other events");
}

fn error(bytes: Vec<u8>, reading: &Reading) -> String {
    match open(bytes, reading) {
        Ok(mut reader) => format!("{:#}", drain(reader.as_mut()).1.expect("an error")),
        Err(error) => format!("{error:#}"),
    }
}

fn whole(events: &[Event], of: impl Fn(&Event) -> i64) -> Vec<u8> {
    events
        .iter()
        .flat_map(|event| of(event).to_le_bytes())
        .collect()
}

/// Returns t, x, y and p as i64, the times in another unit.
fn parts(events: &[Event], per_us: i64) -> [Vec<u8>; 4] {
    [
        whole(events, |event| event.t_us as i64 * per_us),
        whole(events, |event| event.x.into()),
        whole(events, |event| event.y.into()),
        whole(events, |event| (event.polarity as u8).into()),
    ]
}

fn with_columns(columns: &str) -> Reading {
    Reading {
        columns: Some(Columns::parse(columns).expect("columns")),
        ..Reading::default()
    }
}

#[test]
fn arrays_of_every_layout() {
    let events = random();
    let count = events.len();
    let none = Reading::default();
    let ns = Reading {
        time_unit: Some(TimeUnit::Ns),
        ..Reading::default()
    };
    let shapes = [
        format!("({count},)"),
        format!("({count}, 1)"),
        format!("(1, {count})"),
    ];
    // Names, type of the times, their unit, what the caller states.
    let files = [
        (["t", "x", "y", "p"], "<i8", 1, &none),
        (["ts", "xs", "ys", "pol"], "<i8", 1, &none),
        (["timestamps_ns", "x", "y", "on"], "<i8", 1000, &none),
        (["t_ns", "col", "row", "polarity"], "<i8", 1000, &none),
        (["t", "x", "y", "p"], "<m8[ns]", 1000, &none),
        (["t", "x", "y", "p"], "<M8[us]", 1, &none),
        (["t", "x", "y", "p"], "<i8", 1000, &ns),
    ];
    for shape in &shapes {
        for (names, time, per_us, reading) in files {
            let arrays = names.into_iter().zip(parts(&events, per_us));
            let arrays = arrays.enumerate().map(|(which, (name, data))| {
                let of = if which == 0 { time } else { "<i8" };
                (name, npy(&format!("'{of}'"), false, shape, &data))
            });
            let arrays: Vec<(&str, Vec<u8>)> = arrays.collect();
            let named: Vec<(String, Vec<u8>)> = arrays
                .iter()
                .map(|(name, bytes)| (format!("{name}.npy"), bytes.clone()))
                .collect();
            let files: Vec<(&str, Vec<u8>)> = named
                .iter()
                .map(|(name, bytes)| (name.as_str(), bytes.clone()))
                .collect();
            check(
                &format!("{names:?} {time} {shape}"),
                zip(&files),
                reading,
                &events,
            );
            // The same arrays as files of a folder.
            let folder = tempfile::tempdir().expect("a folder");
            for (name, bytes) in &files {
                std::fs::write(folder.path().join(name), bytes).expect("a file");
            }
            let mut reader = event_files::open(folder.path(), reading).expect("a folder of arrays");
            assert!(drain(reader.as_mut()).0 == events, "{names:?} in a folder");
        }
    }
}

#[test]
fn tables_and_structures_of_every_order() {
    let events = random();
    let count = events.len();
    let columns = parts(&events, 1);
    let none = Reading::default();
    for order in [[0, 1, 2, 3], [1, 2, 0, 3], [1, 2, 3, 0]] {
        let letters: String = order
            .iter()
            .map(|which| ["t", "x", "y", "p"][*which])
            .collect();
        let told = with_columns(&letters);
        let together: Vec<u8> = order
            .iter()
            .flat_map(|which| columns[*which].clone())
            .collect();
        let by_rows = (0..count).flat_map(|row| {
            let number = |which: &usize| columns[*which][8 * row..8 * row + 8].to_vec();
            order.iter().flat_map(number).collect::<Vec<u8>>()
        });
        let by_rows: Vec<u8> = by_rows.collect();
        for (fortran, shape, data) in [
            (false, format!("({count}, 4)"), &by_rows),
            (true, format!("({count}, 4)"), &together),
            (false, format!("(4, {count})"), &together),
            (true, format!("(4, {count})"), &by_rows),
        ] {
            let array = npy("'<i8'", fortran, &shape, data);
            check(&format!("{letters} {shape}"), array.clone(), &told, &events);
            check(&letters, zip(&[("events.npy", array)]), &told, &events);
        }
        // Named fields are found in any order.
        let fields: Vec<String> = order
            .iter()
            .map(|which| format!("('{}', '<i8')", ["t", "x", "y", "on"][*which]))
            .collect();
        let array = npy(
            &format!("[{}]", fields.join(", ")),
            false,
            &format!("({count},)"),
            &by_rows,
        );
        check(&letters, array.clone(), &none, &events);
        let names = with_columns("t=t,x=y,y=x,p=on");
        let turned: Vec<Event> = events
            .iter()
            .map(|event| Event {
                x: event.y,
                y: event.x,
                ..*event
            })
            .collect();
        check("named", array, &names, &turned);
    }
    // A fifth column is left out.
    let five: Vec<u8> = (0..count)
        .flat_map(|row| {
            let of = |which: usize| columns[which][8 * row..8 * row + 8].to_vec();
            [of(3), of(1), of(2), of(0), of(3)].concat()
        })
        .collect();
    let array = npy("'<i8'", false, &format!("({count}, 5)"), &five);
    check("five", array.clone(), &with_columns("-xytp"), &events);
    assert!(error(array, &none).contains("--columns"));
}

#[test]
fn flags_that_do_not_fit_are_refused() {
    let events = random();
    let [t, x, y, p] = parts(&events, 1);
    let shape = format!("({},)", events.len());
    let array = |data: &[u8]| npy("'<i8'", false, &shape, data);
    let file = zip(&[
        ("t.npy", array(&t)),
        ("x.npy", array(&x)),
        ("y.npy", array(&y)),
        ("p.npy", array(&p)),
    ]);
    assert!(error(file.clone(), &with_columns("txyp")).contains("have names"));
    assert!(error(file, &with_columns("t=t,x=x,y=y,p=colour")).contains("no arrays"));
    let table = npy("'<i8'", false, "(250, 4)", &t);
    assert!(error(table, &with_columns("t=t,x=x,y=y,p=p")).contains("have no names"));
}

/// Times are kept in microseconds: the reader reports that it has rounded finer ones, and nothing else.
#[test]
fn times_that_are_rounded_are_said() {
    let said = |bytes: Vec<u8>, unit: TimeUnit| {
        let reading = Reading {
            size: Some(SENSOR),
            time_unit: Some(unit),
            ..Reading::default()
        };
        let mut reader = open(bytes, &reading).unwrap();
        let (events, error) = drain(reader.as_mut());
        assert!(error.is_none(), "{error:?}");
        assert_eq!(events.len(), 3);
        let findings = Findings::of(reader.as_ref());
        let mut taken = findings.assumptions.iter();
        taken.any(|taken| taken.starts_with("times whole microseconds"))
    };
    let text = |times: [&str; 3]| -> Vec<u8> {
        let lines = times.map(|time| format!("{time} 1 2 1\n"));
        ["t x y p\n", &lines.concat()].concat().into_bytes()
    };
    let array = |descr: &str, times: Vec<Vec<u8>>| {
        let places = [3_u16, 4, 1].map(u16::to_le_bytes).concat();
        let column = |descr, data: &[u8]| npy(descr, false, "(3,)", data);
        zip(&[
            ("t.npy", column(descr, &times.concat())),
            ("x.npy", column("'<u2'", &places)),
            ("y.npy", column("'<u2'", &places)),
            ("p.npy", column("'|b1'", &[1, 0, 1])),
        ])
    };
    let doubles = |times: [f64; 3]| array("'<f8'", times.map(|t| t.to_le_bytes().to_vec()).into());
    let floats = |times: [f32; 3]| array("'<f4'", times.map(|t| t.to_le_bytes().to_vec()).into());
    let whole = |times: [i64; 3]| array("'<i8'", times.map(|t| t.to_le_bytes().to_vec()).into());
    for (is_said, bytes, unit) in [
        (false, text(["0.1", "0.123456", "1e1"]), TimeUnit::S),
        (false, text(["0.1", "0.123456000", "10.0"]), TimeUnit::S),
        (true, text(["0.1", "0.1234567", "10.0"]), TimeUnit::S),
        (false, text(["1000", "2000", "3000"]), TimeUnit::Ns),
        (true, text(["1000", "2000", "3001"]), TimeUnit::Ns),
        (true, text(["1", "2.5", "3"]), TimeUnit::Us),
        (false, whole([1000, 2000, 3_000_000]), TimeUnit::Ns),
        (true, whole([1000, 2000, 3_000_001]), TimeUnit::Ns),
        (false, whole([1, 2, 3]), TimeUnit::Ms),
        (
            false,
            doubles([0.1, 0.123_456, 4e9 + 0.000_001]),
            TimeUnit::S,
        ),
        (true, doubles([0.1, 0.123_456_7, 0.2]), TimeUnit::S),
        (true, doubles([1.0, 2.5, 3.0]), TimeUnit::Us),
        (false, doubles([1.0, 2.0, 3.0]), TimeUnit::Us),
        (false, floats([0.1, 0.123_456, 1.234_567]), TimeUnit::S),
        (true, floats([1.0, 2.5, 3.0]), TimeUnit::Us),
    ] {
        assert_eq!(said(bytes.clone(), unit), is_said, "{unit:?} of {bytes:?}");
    }
}

#[test]
fn a_written_array_is_read() {
    let events = random();
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = crate::support::written(folder.path(), "npy", SENSOR, &events);
    let text = String::from_utf8_lossy(&bytes[..160]).into_owned();
    assert!(
        text.contains("[('t', '<i8'), ('x', '<i2'), ('y', '<i2'), ('p', '|u1')]"),
        "{text}"
    );
    check("npy", bytes, &Reading::default(), &events);
}

#[test]
fn zip_files_of_one_recording() {
    let events = random();
    let folder = tempfile::tempdir().expect("a folder");
    for ending in [
        "txt", "csv", "raw", "aedat4", "dat", "parquet", "h5", "npz", "es",
    ] {
        let events = crate::support::fitted(ending, events.clone());
        let bytes = crate::support::written(folder.path(), ending, SENSOR, &events);
        let name = format!("set/events.{ending}");
        let picture = ("set/images/1.png", vec![1, 2, 3]);
        let sized = Reading::from(Some(SENSOR));
        check(
            ending,
            zip(&[(&name, bytes.clone()), picture]),
            &sized,
            &events,
        );
        let path = folder.path().join("both.zip");
        let both = zip(&[
            ("a/left.npz", vec![0; 9]),
            (&name, bytes),
            ("a/imu.txt", vec![b'1']),
        ]);
        std::fs::write(&path, both).expect("a file");
        for place in [path.clone(), path.join(&name)] {
            let mut reader = event_files::open(&place, &sized).expect("the one called events");
            assert!(drain(reader.as_mut()).0 == events, "{ending}");
        }
    }
    let none = Reading::default();
    let two = zip(&[("a.raw", vec![0; 9]), ("b.raw", vec![0; 9])]);
    let what = error(two, &none);
    assert!(
        what.contains("a.raw, b.raw") && what.contains("test/a.raw"),
        "{what}"
    );
    // A zip file inside a zip file, which might be itself, is not opened.
    let inner = zip(&[("events.txt", b"0.5 1 2 1\n".to_vec())]);
    let what = error(zip(&[("events.txt", inner)]), &none);
    assert!(what.contains("not an npy array"), "{what}");
}

#[test]
fn what_a_file_does_not_say_is_asked() {
    let events = random();
    let [_, x, y, p] = parts(&events, 1);
    let shape = format!("({},)", events.len());
    let with = |time: &str, t: &[u8], p: &[u8]| {
        let array = |of: &str, data: &[u8]| npy(&format!("'{of}'"), false, &shape, data);
        zip(&[
            ("t.npy", array(time, t)),
            ("x.npy", array("<i8", &x)),
            ("y.npy", array("<i8", &y)),
            ("p.npy", array("<i8", p)),
        ])
    };
    let none = Reading::default();
    // Nanoseconds of a slow camera, and since 1970.
    let slow = whole(&events, |event| event.t_us as i64 * 20_000);
    let what = error(with("<i8", &slow, &p), &none);
    assert!(what.contains("--time-unit ns"), "{what}");
    let dated: Vec<Event> = events
        .iter()
        .map(|event| Event {
            t_us: event.t_us + 1_650_000_000_000_000,
            ..*event
        })
        .collect();
    let [t, ..] = parts(&dated, 1000);
    check("since 1970", with("<i8", &t, &p), &none, &dated);
    // A 32-bit clock.
    let late: Vec<Event> = events
        .iter()
        .map(|event| Event {
            t_us: event.t_us + (1 << 32) - 50_000,
            ..*event
        })
        .collect();
    let t: Vec<u8> = late
        .iter()
        .flat_map(|event| (event.t_us as u32).to_le_bytes())
        .collect();
    check("u32", with("<u4", &t, &p), &none, &late);
    // Three polarities, and two that would both be OFF.
    let [t, ..] = parts(&events, 1);
    let three = whole(&events, |event| event.t_us as i64 % 3 - 1);
    assert!(error(with("<i8", &t, &three), &none).contains("polarities"));
    let leave = Reading {
        bad_events: BadEvents::LeaveOut,
        ..Reading::default()
    };
    let kept = events.iter().filter(|event| event.t_us % 3 != 1);
    let kept: Vec<Event> = kept
        .map(|event| Event {
            polarity: Polarity::from_bool(event.t_us % 3 == 2),
            ..*event
        })
        .collect();
    check("CeleX", with("<i8", &t, &three), &leave, &kept);
    let signed = whole(&events, |event| event.t_us as i64 % 2 - 1);
    assert!(error(with("<i8", &t, &signed), &leave).contains("polarities"));
    // Times before 0.
    let before = whole(&events, |event| event.t_us as i64 - 9_000);
    assert!(error(with("<i8", &before, &p), &none).contains("--time-offset-us"));
    let later = Reading {
        time_offset_us: 9_000,
        ..Reading::default()
    };
    check("offset", with("<i8", &before, &p), &later, &events);
    // A pickled object.
    let objects = npy("'|O'", false, "()", b"pickled");
    assert!(error(objects, &none).contains("pickled Python objects"));
}

/// Reads a file of `layouts/`, whose name a place may follow; returns the size, the events and how many were left
/// out.
fn file(name: &str, reading: &Reading) -> event_files::Result<(Sensor, Vec<Event>, u64)> {
    let path = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/formats/layouts_data"
    ))
    .join(name);
    let mut reader = event_files::open(&path, reading)?;
    let (events, error) = drain(reader.as_mut());
    let left_out = reader
        .skipped()
        .iter()
        .filter(|(kind, _)| kind.starts_with("events"));
    let left_out = left_out.map(|(_, count)| count).sum();
    match error {
        Some(error) => Err(error),
        None => Ok((reader.sensor(), events, left_out)),
    }
}

#[test]
fn files_of_other_tools() {
    let want = regular(1_000_000, 300);
    let leave = Reading {
        bad_events: BadEvents::LeaveOut,
        ..Reading::default()
    };
    for name in [
        "duration_us.parquet",
        "duration_ns.parquet",
        "pandas_timedelta.parquet",
        "polars_duration.parquet",
        "brotli.parquet",
        "dictionary.feather",
        "polars.arrow",
        "column_vectors.h5",
        "rows.h5",
        "units.h5",
        "snntorch.h5/data/0",
        "v73.mat",
        "one_based.mat",
        "aedat_tools.mat/aedat/data/polarity",
    ] {
        let (sensor, events, _) = file(name, &Reading::default()).expect(name);
        assert!(events == want, "{name}");
        assert_eq!((sensor.width, sensor.height), (64, 46), "{name}");
    }
    for name in ["size_beside.h5", "sensor_resolution.h5"] {
        let (sensor, events, _) = file(name, &Reading::default()).expect(name);
        assert!(events == want, "{name}");
        assert_eq!((sensor.width, sensor.height), (1280, 720), "{name}");
    }
    let mut without = want.clone();
    without.remove(7);
    for name in ["outlier.h5", "null.parquet", "null.feather"] {
        let error = file(name, &Reading::default()).expect_err(name);
        assert!(
            format!("{error:#}").contains("--leave-out-bad-events"),
            "{error:#}"
        );
        let (_, events, left_out) = file(name, &leave).expect(name);
        assert!(events == without && left_out == 1, "{name}: {left_out}");
    }
    let error = file("ddd.hdf5", &Reading::default()).expect_err("packets");
    assert!(error.to_string().contains("DDD17"), "{error}");
}
