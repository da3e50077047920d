//! The same random events through every variation of its header that a format allows: absent lines, other orders,
//! CRLF, no size, headers and recordings shorter and longer than each buffer. The events must be the same.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use eecvs_nostd::{Event, Polarity, Sensor};
use host_harness::formats::{self, Reading};

const SENSOR: Sensor = Sensor {
    width: 120,
    height: 100,
};

/// Lengths of what is added to a header: below and above what a format is told by (4,096 bytes).
const PADDINGS: [usize; 3] = [0, 3_950, 9_000];

/// Numbers of events: a few blocks of 64 KiB of each format, and less than one.
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

/// Reads `bytes` with and without the size, where the header need not tell it, and wants `want`.
fn wants(folder: &Path, name: &str, bytes: &[u8], needs_size: bool, want: &[Event], what: &str) {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    let given: Reading = Some(SENSOR).into();
    let readings = [given, Reading::default()];
    for reading in &readings[..if needs_size { 1 } else { 2 }] {
        let mut reader = formats::open(&path, reading).expect(what);
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

/// Every order of up to three lines, and one of the lines reversed.
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

/// Headers of `lines` behind `first`: their orders, each line left out that may be, both line ends, paddings of
/// lines that begin with `mark`.
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
    let mut writer = formats::create(&path, SENSOR).unwrap();
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
            // A word that begins with the letters of a header line would be one without `% end`.
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
        // Without the line, the type of the events must be seen at the start.
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
                let mut reader = formats::open(&path, None).expect(&text);
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
                    let mut reader = formats::open(&path, None).expect(&text);
                    let mut got = Vec::new();
                    while reader.read(&mut got).expect(&text) > 0 {}
                    assert!(got == want, "{text}: {} of {count}", got.len());
                }
            }
        }
    }
}
