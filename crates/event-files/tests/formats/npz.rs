//! Tests layouts and types of npz files that this crate's writer does not produce.

use std::io::{Cursor, Write};

use event_types::{Event, Sensor};
use zip::CompressionMethod::{self, Deflated, Stored};

use crate::support::{read, regular};

/// Returns an array of version `version` with any type, shape and content.
fn npy(version: u8, descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let dict = format!("{{'descr': {descr}, 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let mut bytes = vec![0x93, b'N', b'U', b'M', b'P', b'Y', version, 0];
    match version {
        1 => bytes.extend_from_slice(&(dict.len() as u16).to_le_bytes()),
        _ => bytes.extend_from_slice(&(dict.len() as u32).to_le_bytes()),
    }
    bytes.extend_from_slice(dict.as_bytes());
    bytes.extend_from_slice(data);
    bytes
}

fn npz(method: CompressionMethod, arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    for (name, bytes) in arrays {
        zip.start_file(*name, options).expect("an entry");
        zip.write_all(bytes).expect("its bytes");
    }
    zip.finish().expect("a zip file").into_inner()
}

/// Returns events at whole microseconds.
fn events(count: u32) -> Vec<Event> {
    regular(1_000_000, count)
}

fn column<const N: usize>(events: &[Event], of: impl Fn(&Event) -> [u8; N]) -> Vec<u8> {
    events.iter().flat_map(of).collect()
}

fn check(bytes: &[u8], want: &[Event]) {
    let (got, error) = read(bytes, None);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(got, want);
}

#[test]
fn columns_of_many_types() {
    // More than two batches.
    let events = events(40_000);
    let shape = "(40000,)";
    let array = |version, descr: &str, data: &[u8]| {
        npy(version, &format!("'{descr}'"), "False", shape, data)
    };
    let sign = |e: &Event| e.polarity.sign();
    let big = npz(
        Deflated,
        &[
            (
                "p.npy",
                array(2, "|i1", &column(&events, |e| [sign(e) as u8])),
            ),
            (
                "t.npy",
                array(
                    1,
                    ">i4",
                    &column(&events, |e| (e.t_us as u32).to_be_bytes()),
                ),
            ),
            (
                "x.npy",
                array(3, ">f4", &column(&events, |e| f32::from(e.x).to_be_bytes())),
            ),
            (
                "y.npy",
                array(1, "<u8", &column(&events, |e| u64::from(e.y).to_le_bytes())),
            ),
            ("extra.npy", array(1, "<u8", &[])),
        ],
    );
    check(&big, &events);
    let seconds = |e: &Event| (e.t_us as f64 / 1e6).to_le_bytes();
    let floats = npz(
        Stored,
        &[
            ("timestamps.npy", array(1, "<f8", &column(&events, seconds))),
            ("x.npy", array(1, "|u1", &column(&events, |e| [e.x as u8]))),
            (
                "y.npy",
                array(1, "<i2", &column(&events, |e| e.y.to_le_bytes())),
            ),
            (
                "polarity.npy",
                array(1, "|b1", &column(&events, |e| [e.polarity as u8])),
            ),
        ],
    );
    check(&floats, &events);
}

#[test]
fn the_size_is_found_or_stated() {
    let events = events(100);
    let array =
        |descr: &str, data: Vec<u8>| npy(1, &format!("'{descr}'"), "False", "(100,)", &data);
    let mut arrays = vec![
        (
            "t.npy",
            array("<u8", column(&events, |e| e.t_us.to_le_bytes())),
        ),
        (
            "x.npy",
            array("<u2", column(&events, |e| e.x.to_le_bytes())),
        ),
        (
            "y.npy",
            array("<u2", column(&events, |e| e.y.to_le_bytes())),
        ),
        (
            "p.npy",
            array(
                "<i8",
                column(&events, |e| i64::from(e.polarity.sign()).to_le_bytes()),
            ),
        ),
    ];
    let sensor = |bytes: &[u8], size| {
        let source = Box::new(Cursor::new(bytes.to_vec()));
        event_files::open_source(source, "test", size)
            .expect("a recording")
            .sensor()
    };
    let given = Sensor {
        width: 100,
        height: 90,
    };
    let bytes = npz(Deflated, &arrays);
    assert_eq!(
        sensor(&bytes, None),
        Sensor {
            width: 64,
            height: 46
        }
    );
    assert_eq!(sensor(&bytes, Some(given)), given);
    let scalar = |side: i32| npy(1, "'<i4'", "False", "()", &side.to_le_bytes());
    arrays.push(("width.npy", scalar(320)));
    arrays.push(("height.npy", scalar(240)));
    let bytes = npz(Deflated, &arrays);
    assert_eq!(
        sensor(&bytes, Some(given)),
        Sensor {
            width: 320,
            height: 240
        }
    );
    check(&bytes, &events);
}

#[test]
fn structured_events() {
    let events = events(20_000);
    let descr = "[('x', '<u2'), ('y', '<u2'), ('t', '<i8'), ('', '|V3'), ('p', '|b1')]";
    let record = |e: &Event| {
        let mut bytes = [0; 16];
        bytes[..2].copy_from_slice(&e.x.to_le_bytes());
        bytes[2..4].copy_from_slice(&e.y.to_le_bytes());
        bytes[4..12].copy_from_slice(&e.t_us.to_le_bytes());
        bytes[15] = e.polarity as u8;
        bytes
    };
    let data = column(&events, record);
    let bytes = npz(
        Deflated,
        &[("events.npy", npy(1, descr, "False", "(20000,)", &data))],
    );
    check(&bytes, &events);
}

#[test]
fn tables_in_either_order() {
    let events = events(20_000);
    let columns: [fn(&Event) -> f64; 4] = [
        |e| f64::from(e.x),
        |e| f64::from(e.y),
        |e| e.t_us as f64,
        |e| f64::from(e.polarity.sign()),
    ];
    let rows: Vec<u8> = events
        .iter()
        .flat_map(|e| columns.map(|of| of(e).to_le_bytes()).concat())
        .collect();
    let by_column: Vec<u8> = columns
        .iter()
        .flat_map(|of| column(&events, |e| of(e).to_le_bytes()))
        .collect();
    for (fortran, data) in [("False", &rows), ("True", &by_column)] {
        for method in [Stored, Deflated] {
            let array = npy(1, "'<f8'", fortran, "(20000, 4)", data);
            // Whole microseconds in a float column, the only array of the file.
            check(&npz(method, &[("arr_0.npy", array)]), &events);
        }
    }
}

#[test]
fn what_is_wrong_is_named() {
    let column = |data: &[u8]| npy(1, "'|i1'", "False", &format!("({},)", data.len()), data);
    let good = column(&[0, 1, 1]);
    let file = |t: &Vec<u8>, x: &Vec<u8>, p: &Vec<u8>| {
        let (t, x, p) = (t.clone(), x.clone(), p.clone());
        npz(
            Stored,
            &[
                ("t.npy", t),
                ("x.npy", x),
                ("y.npy", good.clone()),
                ("p.npy", p),
            ],
        )
    };
    let damaged = {
        let mut bytes = file(&good, &good, &good);
        let at = bytes
            .windows(3)
            .position(|bytes| bytes == [0, 1, 1])
            .expect("the data");
        bytes[at + 1] = 9;
        bytes
    };
    let complex = npy(1, "'<c8'", "False", "(3,)", &[0; 24]);
    let objects = npy(1, "'|O'", "False", "(3,)", &[0; 24]);
    let nan = npy(
        1,
        "'<f4'",
        "False",
        "(3,)",
        &f32::NAN.to_le_bytes().repeat(3),
    );
    let short = npy(1, "'|i1'", "False", "(3,)", &[0, 1]);
    let endless = npy(1, "'|i1'", "False", "(18446744073709551615,)", &[0, 1]);
    for (bytes, events, want) in [
        (
            file(&column(&[0, 5, 255]), &good, &good),
            2,
            "t.npy: event 2: the time is negative",
        ),
        (
            file(&good, &column(&[0, 255, 0]), &good),
            1,
            "x.npy: event 1: x = -1",
        ),
        (
            file(&good, &good, &column(&[1, 7, 0])),
            1,
            "p.npy: event 1: the polarity",
        ),
        (
            file(&good, &column(&[1, 2]), &good),
            0,
            "x.npy: 2 values, but 3 times",
        ),
        (file(&complex, &good, &good), 0, "t.npy: the type must be"),
        (file(&objects, &good, &good), 0, "pickled Python objects"),
        (
            file(&nan, &good, &good),
            0,
            "t.npy: event 0: a value is missing",
        ),
        (
            file(&short, &good, &good),
            2,
            "t.npy: event 2: the array is shorter",
        ),
        (file(&endless, &endless, &endless), 0, "y.npy: 3 values"),
        (damaged, 3, "CRC-32 is wrong"),
        (
            npz(Stored, &[("a.npy", good.clone()), ("b.npy", good.clone())]),
            0,
            "no arrays t, x, y",
        ),
    ] {
        let (got, error) = read(
            &bytes,
            Some(Sensor {
                width: 9,
                height: 9,
            }),
        );
        let error = format!("{:#}", error.expect(want));
        assert!(
            error.contains(want) && error.contains("byte "),
            "{error} is not {want}"
        );
        assert_eq!(got.len(), events, "{error}");
    }
}
