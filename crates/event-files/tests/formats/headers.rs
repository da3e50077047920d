//! Tests the same random events with every variation of its header that a format allows: missing lines, other
//! orders, CRLF, no size, headers and recordings shorter and longer than each buffer. The events must be the same.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use event_files::{self, Reading};
use event_types::{Event, Polarity, Sensor};

const SENSOR: Sensor = Sensor {
    width: 120,
    height: 100,
};

/// Lengths added to a header: below and above the number of bytes from which a format is recognised (4,096).
const PADDINGS: [usize; 3] = [0, 3_950, 9_000];

/// Numbers of events: less than one block of 64 KiB of each format, and a few blocks.
const COUNTS: [usize; 2] = [1_000, 20_000];

fn events(count: usize) -> Vec<Event> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = |below: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % below
    };
    let mut t_us = 0;
    (0..count)
        .map(|_| {
            t_us += next(40);
            Event {
                t_us,
                x: next(SENSOR.width.into()) as u16,
                y: next(SENSOR.height.into()) as u16,
                polarity: Polarity::from_bool(next(2) == 1),
            }
        })
        .collect()
}

/// Reads `bytes` with the size and, unless `needs_size`, without it; the events must equal `want`.
fn wants(folder: &Path, name: &str, bytes: &[u8], needs_size: bool, want: &[Event], what: &str) {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    let given: Reading = Some(SENSOR).into();
    let readings = [given, Reading::default()];
    for reading in &readings[..if needs_size { 1 } else { 2 }] {
        let mut reader = event_files::open(&path, reading).expect(what);
        let mut got = Vec::new();
        while reader.read(&mut got).expect(what) > 0 {}
        assert!(
            got == want,
            "{what}: {} of {} events",
            got.len(),
            want.len()
        );
        assert_eq!(reader.skipped().iter().count(), 0, "{what}");
        if needs_size {
            assert_eq!(reader.sensor(), SENSOR, "{what}");
        }
    }
}

/// Returns the lines in the given order, and in every rotation of it, forwards and backwards.
fn orders(lines: &[&str]) -> Vec<Vec<String>> {
    let of = |indices: &[usize]| -> Vec<String> {
        indices
            .iter()
            .map(|index| lines[*index].to_owned())
            .collect()
    };
    let all: Vec<usize> = (0..lines.len()).collect();
    let mut orders = vec![of(&all)];
    for first in 1..lines.len() {
        let mut rotated = all.clone();
        rotated.rotate_left(first);
        orders.push(of(&rotated));
        rotated.reverse();
        orders.push(of(&rotated));
    }
    orders
}

/// Returns headers with `lines` after `first`: in their orders, without each line that may be missing, with both
/// line ends, and with padding lines that begin with `mark`.
fn headers(first: &str, mark: &str, needed: &[&str], optional: &[&str], end: &str) -> Vec<String> {
    let mut sets = vec![[needed, optional].concat(), needed.to_vec()];
    for left_out in 0..optional.len() {
        let mut some = optional.to_vec();
        some.remove(left_out);
        sets.push([needed, &some].concat());
    }
    let mut headers = Vec::new();
    for set in sets {
        for order in orders(&set) {
            for (at, padding) in PADDINGS.into_iter().enumerate() {
                let line_end = if at % 2 == 0 { "\n" } else { "\r\n" };
                for line_end in [line_end, "\r\n"] {
                    let mut text = String::new();
                    let mut line = |line: &str| write!(text, "{line}{line_end}").unwrap();
                    if !first.is_empty() {
                        line(first);
                    }
                    for entry in &order {
                        line(entry);
                    }
                    let mut padded = 0;
                    while padded < padding {
                        let comment = format!("{mark}{}", "x".repeat(60));
                        padded += comment.len();
                        line(&comment);
                    }
                    if !end.is_empty() {
                        line(end);
                    }
                    headers.push(text);
                }
            }
        }
    }
    headers.sort_unstable();
    headers.dedup();
    headers
}

fn written(folder: &Path, name: &str, events: &[Event]) -> Vec<u8> {
    let path = folder.join(name);
    let mut writer = event_files::create(&path, SENSOR).unwrap();
    writer.write(events).unwrap();
    writer.finish().unwrap();
    fs::read(path).unwrap()
}

fn behind<'a>(bytes: &'a [u8], end: &[u8]) -> &'a [u8] {
    let at = bytes.windows(end.len()).position(|part| part == end);
    &bytes[at.expect("an end of the header") + end.len()..]
}

#[test]
fn raw() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (name, kinds, sizes) in [
        (
            "a.evt2",
            ["% evt 2.0", "% format EVT2"],
            "% format EVT2;height=100;width=120",
        ),
        (
            "a.evt3",
            ["% evt 3.0", "% format EVT3"],
            "% format EVT3;width=120;height=100",
        ),
        (
            "a.evt21.raw",
            ["% evt 2.1", "% format EVT21"],
            "% format EVT21;height=100;width=120",
        ),
        (
            "a.evt4.raw",
            ["% evt 4.0", "% format EVT4"],
            "% format EVT4;height=100;width=120",
        ),
    ] {
        for count in COUNTS {
            let want = events(count);
            let file = written(folder, name, &want);
            let words = behind(&file, b"% end\n");
            let others = [
                "% Date 2021-09-01 10:00:00",
                "% serial_number 0000",
                "% geometry 120x100",
            ];
            let mut texts = Vec::new();
            for end in ["", "% end"] {
                texts.extend(headers("", "% ", &[kinds[0]], &others, end));
                texts.extend(headers(
                    "",
                    "% ",
                    &[kinds[1]],
                    &["% Width 120", "% Height 100"],
                    end,
                ));
                texts.extend(headers("", "% ", &[sizes], &[kinds[0]], end));
            }
            // A word that begins with the letters of a header line would be one if there is no `% end`.
            for text in texts {
                let tells_size = ["120x100", "width=120"]
                    .iter()
                    .any(|size| text.contains(size))
                    || (text.contains("Width") && text.contains("Height"));
                let bytes = [text.as_bytes(), words].concat();
                wants(folder, "b.raw", &bytes, !tells_size, &want, &text);
            }
        }
    }
}

#[test]
fn dat() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for count in COUNTS {
        let want = events(count);
        let file = written(folder, "a.dat", &want);
        let records = behind(&file, b"\n\x0c\x08");
        let data = "% Data file containing CD events.";
        let lines = ["% Version 2", "% Width 120", "% Height 100"];
        let mut texts = headers("", "% ", &[data], &lines, "");
        texts.extend(headers("", "% ", &[data, "% T0 0"], &lines, "% end"));
        // Without the line, the type of the events must be visible at the start.
        let short = |text: &String| text.len() < 4_000;
        texts.extend(
            headers("", "% ", &lines[..1], &lines[1..], "")
                .into_iter()
                .filter(short),
        );
        for kind in [0, 12] {
            for text in &texts {
                let tells_size = text.contains("Width") && text.contains("Height");
                let bytes = [text.as_bytes(), &[kind, 8], records].concat();
                wants(folder, "b.dat", &bytes, !tells_size, &want, text);
            }
        }
    }
}

#[test]
fn aedat_1_and_2() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for count in COUNTS {
        let want = events(count);
        let on = |event: &Event| u32::from(event.polarity == Polarity::On);
        let dvs = |event: &Event| {
            u32::from(event.y) << 8 | (127 - u32::from(event.x)) << 1 | (1 - on(event))
        };
        let davis = |last: u32| {
            move |event: &Event| {
                u32::from(event.y) << 22 | (last - u32::from(event.x)) << 12 | on(event) << 11
            }
        };
        let words = |address: &dyn Fn(&Event) -> u32, bytes: usize| -> Vec<u8> {
            let word = |event: &Event| {
                let address = address(event).to_be_bytes();
                [&address[4 - bytes..], &(event.t_us as u32).to_be_bytes()].concat()
            };
            want.iter().flat_map(word).collect()
        };
        let others = [
            "# This is a raw AE data file - do not edit",
            "# Timestamps tick is 1 us",
            "#\tcreated Sat Oct 24",
        ];
        let chip = "# AEChip: ch.unizh.ini.jaer.chip.retina.DVS128";
        let mut cases = Vec::new();
        for end in ["", "#End Of ASCII Header", "# End of ASCII Header"] {
            let second = |needed: &[&str], optional: &[&str]| {
                headers("#!AER-DAT2.0", "# ", needed, optional, end)
            };
            cases.push((second(&[], &[chip, others[0], others[2]]), words(&dvs, 4)));
            let chip = "# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C";
            cases.push((second(&[], &[chip, others[1]]), words(&davis(239), 4)));
            let chip = "# AEChip: eu.seebetter.ini.chips.davis.Davis346blue";
            cases.push((second(&[chip], &others), words(&davis(345), 4)));
        }
        cases.push((
            headers("#!AER-DAT1.0", "# ", &[], &others, ""),
            words(&dvs, 2),
        ));
        for (texts, words) in cases {
            for text in texts {
                let path = folder.join("a.aedat");
                fs::write(&path, [text.as_bytes(), &words].concat()).unwrap();
                let mut reader = event_files::open(&path, None).expect(&text);
                let mut got = Vec::new();
                while reader.read(&mut got).expect(&text) > 0 {}
                assert!(got == want, "{text}: {} of {count}", got.len());
            }
        }
    }
}

#[test]
fn aedat_3() {
    let folder = tempfile::tempdir().unwrap();
    for (count, packet) in [
        (1_000, 1),
        (1_000, 1_000),
        (20_000, 8_192),
        (20_000, 20_000),
    ] {
        let want = events(count);
        let mut packets = Vec::new();
        for part in want.chunks(packet) {
            packets.extend([1, 0, 1, 0]);
            let count = part.len() as u32;
            for number in [8, 4, 0, count, count, count] {
                packets.extend(u32::to_le_bytes(number));
            }
            for event in part {
                let on = u32::from(event.polarity == Polarity::On);
                let word = u32::from(event.x) << 17 | u32::from(event.y) << 2 | on << 1 | 1;
                packets.extend(word.to_le_bytes());
                packets.extend((event.t_us as u32).to_le_bytes());
            }
        }
        let others = [
            "#Source 1: DVS128",
            "#Format: RAW",
            "#Start-Time: 2016-10-11 10:23:45",
        ];
        for first in ["#!AER-DAT3.1", "#!AER-DAT3.0"] {
            for text in headers(first, "#", &[], &others, "#!END-HEADER") {
                let tells_size = text.contains("DVS128");
                let bytes = [text.as_bytes(), &packets].concat();
                wants(folder.path(), "a.aedat", &bytes, !tells_size, &want, &text);
            }
        }
    }
}

#[test]
fn text() {
    let folder = tempfile::tempdir().unwrap();
    for count in COUNTS {
        let want = events(count);
        for (names, separator) in [
            ("t,x,y,p", ","),
            ("\"t\";\"x\";\"y\";\"p\"", ";"),
            ("timestamp [us]\tcol\trow\tpolarity", "\t"),
            ("# t x y p", " "),
            ("120 100", " "),
            ("t x@120 y@100 p", " "),
        ] {
            let data = want.iter().fold(String::new(), |mut text, event| {
                let Event {
                    t_us,
                    x,
                    y,
                    polarity,
                } = event;
                let s = separator;
                writeln!(text, "{t_us}{s}{x}{s}{y}{s}{}", *polarity as u8).unwrap();
                text
            });
            let comments = ["% made by hand", "# of 2021"];
            let mut texts = headers("", "# ", &[], &comments, names);
            texts.push(format!("\u{feff}{names}\n"));
            for text in texts {
                for data in [data.clone(), data.replace('\n', "\r\n")] {
                    let path = folder.path().join("a.csv");
                    fs::write(&path, format!("{text}{data}")).unwrap();
                    let mut reader = event_files::open(&path, None).expect(&text);
                    let mut got = Vec::new();
                    while reader.read(&mut got).expect(&text) > 0 {}
                    assert!(got == want, "{text}: {} of {count}", got.len());
                }
            }
        }
    }
}

#[test]
fn a_byte_order_mark_before_a_header_is_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let want = events(COUNTS[1]);
    // Of a camera that every format knows, and larger than the events need.
    let sensor = Sensor::new(128, 128).unwrap();
    let mut seen = Vec::new();
    for format in event_files::FORMATS {
        let Some(create) = format.create else {
            continue;
        };
        let name = format!("a{}", format.endings[0]);
        let path = folder.path().join(&name);
        let mut writer = create(&path, sensor).unwrap();
        writer.write(&want).unwrap();
        writer.finish().unwrap();
        let bytes = fs::read(&path).unwrap();
        if bytes.starts_with(b"% ") || bytes.starts_with(b"#!AER") {
            let marked = [b"\xef\xbb\xbf".as_slice(), &bytes].concat();
            wants(folder.path(), &name, &marked, false, &want, format.name);
            let reader = event_files::open(&path, None).unwrap();
            assert_eq!((reader.format(), reader.sensor()), (format.name, sensor));
            seen.push(format.name);
        }
    }
    for name in ["evt2", "evt21", "evt3", "evt4", "dat", "aedat2", "aedat4"] {
        assert!(seen.contains(&name), "{name}: {seen:?}");
    }
}

/// Returns an array file of this version whose dictionary has `keys`, followed by `padding` spaces.
fn npy(version: u8, keys: &[String], padding: usize, end: &str, data: &[u8]) -> Vec<u8> {
    let dictionary = format!("{{{}{end}}}{}\n", keys.join(", "), " ".repeat(padding));
    let mut bytes = [b"\x93NUMPY".as_slice(), &[version, 0]].concat();
    match version {
        1 => bytes.extend((dictionary.len() as u16).to_le_bytes()),
        _ => bytes.extend((dictionary.len() as u32).to_le_bytes()),
    }
    bytes.extend(dictionary.as_bytes());
    bytes.extend(data);
    bytes
}

/// Returns the description of a structured array's fields in this order, and the bytes of its rows.
fn structured(order: [usize; 4], padding: usize, events: &[Event]) -> (String, Vec<u8>) {
    let fields = [("t", "<i8"), ("x", "<u2"), ("y", ">u2"), ("p", "|b1")];
    let mut descr: Vec<String> = order
        .iter()
        .map(|field| format!("('{}', '{}')", fields[*field].0, fields[*field].1))
        .collect();
    if padding > 0 {
        descr.insert(2, format!("('', '|V{padding}')"));
    }
    let mut rows = Vec::new();
    for event in events {
        for (place, field) in order.iter().enumerate() {
            if place == 2 {
                rows.extend(vec![0xaa; padding]);
            }
            match field {
                0 => rows.extend(event.t_us.to_le_bytes()),
                1 => rows.extend(event.x.to_le_bytes()),
                2 => rows.extend(event.y.to_be_bytes()),
                _ => rows.push(event.polarity as u8),
            }
        }
    }
    (format!("'descr': [{}]", descr.join(", ")), rows)
}

#[test]
fn npy_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let is_column_major = "'fortran_order': False";
    for count in COUNTS {
        let want = events(count);
        let shape = format!("'shape': ({count},)");
        for (order, inside) in [
            ([0, 1, 2, 3], 0),
            ([1, 2, 3, 0], 0),
            ([3, 2, 1, 0], 3),
            ([2, 0, 3, 1], 1),
        ] {
            let (descr, rows) = structured(order, inside, &want);
            for keys in orders(&[&descr, is_column_major, &shape]) {
                for version in [1, 2, 3] {
                    for (padding, end) in PADDINGS.into_iter().zip([", ", "", ","]) {
                        let bytes = npy(version, &keys, padding, end, &rows);
                        let what = format!("version {version}, {keys:?}, {padding}");
                        wants(folder.path(), "a.npy", &bytes, false, &want, &what);
                    }
                }
            }
        }
        // A table of four columns, stored row by row or column by column.
        let columns: [Vec<f64>; 4] = [
            |event: &Event| event.t_us as f64,
            |event: &Event| f64::from(event.x),
            |event: &Event| f64::from(event.y),
            |event: &Event| f64::from(event.polarity as u8),
        ]
        .map(|of| want.iter().map(of).collect());
        let by_column = columns.concat();
        let by_row = (0..count).flat_map(|row| columns.iter().map(move |column| column[row]));
        let shape = format!("'shape': ({count}, 4)");
        for (values, order) in [
            (by_row.collect::<Vec<f64>>(), "'fortran_order': False"),
            (by_column, "'fortran_order': True"),
        ] {
            let data: Vec<u8> = values
                .iter()
                .flat_map(|value| value.to_be_bytes())
                .collect();
            for keys in orders(&["'descr': '>f8'", order, &shape]) {
                for padding in PADDINGS {
                    let bytes = npy(1, &keys, padding, ", ", &data);
                    let what = format!("{keys:?}, {padding}");
                    wants(folder.path(), "a.npy", &bytes, false, &want, &what);
                }
            }
        }
    }
}

#[test]
fn zips() {
    use std::io::{Cursor, Write as _};

    use zip::write::{FullFileOptions, StreamWriter};
    use zip::{CompressionMethod, ZipWriter};

    let folder = tempfile::tempdir().unwrap();
    for count in COUNTS {
        let want = events(count);
        let inner = written(folder.path(), "events.dat", &want);
        for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
            for (padding, is_large) in PADDINGS.into_iter().zip([false, true, false]) {
                for place in ["events.dat", "a folder/of/events.dat"] {
                    let what = format!("{method:?}, {padding}, {is_large}, {place}");
                    let mut options = FullFileOptions::default()
                        .compression_method(method)
                        .large_file(is_large);
                    if padding > 0 {
                        let extra = vec![b'e'; padding].into_boxed_slice();
                        options.add_extra_field(0x7733, extra, false).unwrap();
                    }
                    let other = vec![b'o'; padding];
                    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
                    for (name, bytes) in [
                        ("README", other.as_slice()),
                        (place, &inner),
                        ("licence", &other),
                    ] {
                        zip.start_file(name, options.clone()).unwrap();
                        zip.write_all(bytes).unwrap();
                    }
                    zip.set_comment("c".repeat(padding)).unwrap();
                    let bytes = zip.finish().unwrap().into_inner();
                    reads(folder.path(), "a.zip", &bytes, &want, &what);

                    // Sizes after the data, as written by a writer that cannot seek.
                    let mut bytes = Vec::new();
                    let mut zip = ZipWriter::new_stream(&mut bytes);
                    zip.start_file(place, options).unwrap();
                    zip.write_all(&inner).unwrap();
                    let _: StreamWriter<_> = zip.finish().unwrap();
                    reads(
                        folder.path(),
                        "a.zip",
                        &bytes,
                        &want,
                        &format!("{what}, streamed"),
                    );
                }
            }
        }
    }
}

/// Reads `bytes`, whatever else they contain; the events must equal `want`.
fn reads(folder: &Path, name: &str, bytes: &[u8], want: &[Event], what: &str) {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    let mut reader = event_files::open(&path, None).expect(what);
    let mut got = Vec::new();
    while reader.read(&mut got).expect(what) > 0 {}
    assert!(got == want, "{what}: {} of {}", got.len(), want.len());
}

/// Returns a MATLAB 5 file of rows of numbers, stored as doubles or, like MATLAB does, as the smallest type that
/// holds them.
fn mat(text: &str, is_big: bool, is_deflated: bool, variables: &[(&str, &[f64])]) -> Vec<u8> {
    use std::io::Write as _;

    let word = |value: u32| {
        if is_big {
            value.to_be_bytes()
        } else {
            value.to_le_bytes()
        }
    };
    let words = |values: &[u32]| values.iter().copied().flat_map(word).collect::<Vec<u8>>();
    let mut bytes = format!("{text:<124}").into_bytes();
    bytes.extend(if is_big { *b"\x01\0MI" } else { *b"\0\x01IM" });
    for (name, values) in variables {
        let mut array = words(&[6, 8, 6, 0, 5, 8, 1, values.len() as u32]);
        array.extend(words(&[1, name.len() as u32]));
        array.extend(name.as_bytes());
        array.resize(array.len().next_multiple_of(8), 0);
        let is_small = values.iter().all(|value| (0.0..256.0).contains(value));
        // Type 9 is doubles, type 2 bytes.
        array.extend(words(&if is_small {
            [2, values.len() as u32]
        } else {
            [9, 8 * values.len() as u32]
        }));
        for value in *values {
            match (is_small, is_big) {
                (true, _) => array.push(*value as u8),
                (_, true) => array.extend(value.to_be_bytes()),
                (_, false) => array.extend(value.to_le_bytes()),
            }
        }
        array.resize(array.len().next_multiple_of(8), 0);
        let mut element = words(&[14, array.len() as u32]);
        element.extend(array);
        if is_deflated {
            let mut deflate =
                flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
            deflate.write_all(&element).unwrap();
            let deflated = deflate.finish().unwrap();
            element = words(&[15, deflated.len() as u32]);
            element.extend(deflated);
        }
        bytes.extend(element);
    }
    bytes
}

#[test]
fn mat_files() {
    let folder = tempfile::tempdir().unwrap();
    for count in COUNTS {
        let want = events(count);
        let columns: [Vec<f64>; 4] = [
            |event: &Event| event.t_us as f64,
            |event: &Event| f64::from(event.x),
            |event: &Event| f64::from(event.y),
            |event: &Event| f64::from(event.polarity as u8),
        ]
        .map(|of| want.iter().map(of).collect());
        let other = vec![0.5; 9_000 / 8];
        for text in [
            "",
            "MATLAB 5.0 MAT-file, Platform: GLNXA64, Created on: Mon Jan 1",
        ] {
            for names in [["ts", "x", "y", "p"], ["t", "x", "y", "polarity"]] {
                let known = names.iter().copied().zip(columns.iter().map(Vec::as_slice));
                let known: Vec<(&str, &[f64])> = known.collect();
                for first in 0..4 {
                    for has_other in [false, true] {
                        let mut variables = known.clone();
                        variables.rotate_left(first);
                        if has_other {
                            variables.insert(first, ("calibration", &other));
                        }
                        for (is_big, is_deflated) in
                            [(false, false), (false, true), (true, false), (true, true)]
                        {
                            let bytes = mat(text, is_big, is_deflated, &variables);
                            let what = format!(
                                "{text}, {names:?} from {first}, other {has_other}, big {is_big}, \
                                 deflated {is_deflated}"
                            );
                            if has_other {
                                reads(folder.path(), "a.mat", &bytes, &want, &what);
                            } else {
                                wants(folder.path(), "a.mat", &bytes, false, &want, &what);
                            }
                        }
                    }
                }
            }
        }
    }
}
