//! Tests that files from the writers are read back by this crate's readers and by independent ones.

use event_files::convert::{Conversion, Converted, Crop, Filter, convert};
use event_files::{self, Reading};
use event_types::{Event, Polarity, Sensor};
use proptest::prelude::*;

use crate::support::{FORMATS, events, fitted, read, read_as, written};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_format_returns_what_was_written(
        (extension, sensor, events) in prop::sample::select(FORMATS.to_vec())
            .prop_flat_map(|(extension, sensor)| {
                (Just(extension), Just(sensor), events(sensor, 300))
            }),
    ) {
        let folder = tempfile::tempdir().expect("a folder");
        let events = fitted(extension, events);
        let bytes = written(folder.path(), extension, sensor, &events);
        // An empty text file, or one of records alone, has no content by which it could be recognised.
        prop_assume!(!bytes.is_empty());
        let (got, error) = read_as(&format!("test.{extension}"), &bytes, Some(sensor));
        prop_assert!(error.is_none(), "{error:?}");
        prop_assert_eq!(got, events);
    }

    #[test]
    fn the_evt3_crate_reads_our_evt3(events in events(Sensor { width: 640, height: 480 }, 200)) {
        let folder = tempfile::tempdir().expect("a folder");
        let sensor = Sensor { width: 640, height: 480 };
        // The other crate supports no time base: begin where the wraps are written out.
        let base = events.first().map_or(0, |event| event.t_us) & !0xffff_ffff;
        prop_assume!(events.iter().all(|event| event.t_us >= base));
        let shifted: Vec<Event> =
            events.iter().map(|event| Event { t_us: event.t_us - base, ..*event }).collect();
        // It takes a step back over a wrap for a step back of a whole period.
        prop_assume!(shifted.is_sorted_by_key(|event| event.t_us >> 24));
        written(folder.path(), "raw", sensor, &shifted);
        let mut decoder = evt3::Evt3Decoder::new();
        let decoded = decoder.decode_file(folder.path().join("events.raw")).expect("a recording");
        prop_assert_eq!((decoded.metadata.width, decoded.metadata.height), (640, 480));
        let got: Vec<Event> = decoded.cd_events.iter().map(|event| Event {
            t_us: event.timestamp,
            x: event.x,
            y: event.y,
            polarity: Polarity::from_bool(event.polarity == 1),
        }).collect();
        prop_assert_eq!(got, shifted);
    }

    #[test]
    fn the_aedat_crate_reads_our_aedat4(events in events(Sensor { width: 346, height: 260 }, 300)) {
        let folder = tempfile::tempdir().expect("a folder");
        written(folder.path(), "aedat4", Sensor { width: 346, height: 260 }, &events);
        let path = folder.path().join("events.aedat4");
        let decoder = aedat::base::Decoder::new_from_file(path).expect("a recording");
        let stream = &decoder.id_to_stream[&0];
        prop_assert_eq!((stream.width, stream.height), (346, 260));
        let mut got = Vec::new();
        for packet in decoder {
            let packet = packet.expect("a whole packet");
            let root = aedat::events_generated::size_prefixed_root_as_event_packet(&packet.buffer);
            for event in root.expect("an event packet").elements().expect("events") {
                got.push(Event {
                    t_us: event.t() as u64,
                    x: event.x() as u16,
                    y: event.y() as u16,
                    polarity: Polarity::from_bool(event.on()),
                });
            }
        }
        prop_assert_eq!(got, events);
    }
}

fn some_events(sensor: Sensor, count: u32) -> Vec<Event> {
    (0..count)
        .map(|i| Event {
            t_us: 5_000_000_000 + u64::from(i / 3 * 7),
            x: (i * 31 % u32::from(sensor.width)) as u16,
            y: (i * 17 % u32::from(sensor.height)) as u16,
            polarity: Polarity::from_bool(i % 5 < 2),
        })
        .collect()
}

/// Returns this crate's AEDAT4 file with its packets packed by `pack`, and without a packet table.
fn repacked(lz4: &[u8], compression: i32, pack: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    use std::io::Read;
    let number = |at: usize| i32::from_le_bytes(*lz4[at..].first_chunk().expect("4 bytes"));
    let table = number(54) as usize;
    let mut at = 14 + 4 + number(14) as usize;
    let mut out = lz4[..at].to_vec();
    out[46..50].copy_from_slice(&compression.to_le_bytes());
    out[54..62].copy_from_slice(&(-1_i64).to_le_bytes());
    while at < table {
        let size = number(at + 4) as usize;
        let mut content = Vec::new();
        let packed = &lz4[at + 8..at + 8 + size];
        let mut frame = lz4_flex::frame::FrameDecoder::new(packed);
        frame.read_to_end(&mut content).expect("an LZ4 frame");
        let content = pack(&content);
        out.extend_from_slice(&lz4[at..at + 4]);
        out.extend_from_slice(&(content.len() as i32).to_le_bytes());
        out.extend_from_slice(&content);
        at += 8 + size;
    }
    out
}

#[test]
fn aedat4_of_every_compression() {
    let sensor = Sensor {
        width: 346,
        height: 260,
    };
    let events = some_events(sensor, 40_000);
    let folder = tempfile::tempdir().expect("a folder");
    let lz4 = written(folder.path(), "aedat4", sensor, &events);
    let zstd = |level| move |content: &[u8]| zstd::encode_all(content, level).expect("a frame");
    for bytes in [
        repacked(&lz4, 0, <[u8]>::to_vec),
        repacked(&lz4, 3, zstd(1)),
        repacked(&lz4, 4, zstd(19)),
    ] {
        let (got, error) = read(&bytes, None);
        assert!(error.is_none(), "{error:?}");
        assert_eq!(got, events);
    }
}

#[test]
fn aedat2_wraps_after_71_minutes() {
    let sensor = Sensor {
        width: 240,
        height: 180,
    };
    let hours = (0..600).map(|i| Event {
        t_us: i * 60_000_000,
        x: 239,
        y: 179,
        polarity: Polarity::On,
    });
    let events: Vec<Event> = hours.collect();
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = written(folder.path(), "aedat", sensor, &events);
    assert_eq!(read(&bytes, None).0, events);
}

#[test]
fn evt_gaps_of_days() {
    let sensor = Sensor {
        width: 640,
        height: 480,
    };
    let at = |t_us| Event {
        t_us,
        x: 1,
        y: 2,
        polarity: Polarity::Off,
    };
    let events = [
        at(3),
        at(86_400_000_000),
        at(86_400_000_001),
        at(200_000_000_000),
    ];
    let folder = tempfile::tempdir().expect("a folder");
    for extension in ["raw", "evt2", "evt21", "evt4"] {
        let bytes = written(folder.path(), extension, sensor, &events);
        let (got, error) = read(&bytes, None);
        assert!(error.is_none(), "{error:?}");
        assert_eq!(got, events, "{extension}");
    }
}

#[test]
fn what_a_format_cannot_hold_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let create = |name: &str, width, height| {
        let sensor = Sensor { width, height };
        event_files::create(&folder.path().join(name), sensor)
            .map(drop)
            .map_err(|e| e.to_string())
    };
    let error = create("a.aedat", 346, 260).expect_err("no chip of this size");
    assert!(
        error.contains("346x260") && error.contains("DVS128"),
        "{error}"
    );
    let error = create("a.xyz", 346, 260).expect_err("no format of this name");
    assert!(
        error.contains(".aedat4") && error.contains(".npz"),
        "{error}"
    );

    let refused = |name: &str, events: &[Event]| {
        let sensor = Sensor {
            width: 240,
            height: 180,
        };
        let mut writer = event_files::create(&folder.path().join(name), sensor).expect("a file");
        writer
            .write(events)
            .expect_err("an event that does not fit")
            .to_string()
    };
    let at = |t_us, x| Event {
        t_us,
        x,
        y: 0,
        polarity: Polarity::On,
    };
    for (extension, _) in FORMATS {
        let error = refused(&format!("x.{extension}"), &[at(0, 0), at(0, 240)]);
        assert!(
            error.contains("event 1") && error.contains("x = 240"),
            "{error}"
        );
        let error = refused(&format!("t.{extension}"), &[at(0, 0), at(u64::MAX, 0)]);
        assert!(
            error.contains("event 1") && error.contains("time"),
            "{error}"
        );
    }
    for extension in ["raw", "evt2", "evt21", "evt4", "aedat", "dat"] {
        let error = refused(&format!("s.{extension}"), &[at((1 << 62) + 5, 0)]);
        assert!(error.contains("event 0"), "{error}");
        let error = refused(&format!("b.{extension}"), &[at(1 << 40, 0), at(1 << 39, 0)]);
        assert!(error.contains("event 1"), "{error}");
    }
}

fn of(filter: Filter) -> Conversion {
    Conversion {
        filter,
        ..Conversion::default()
    }
}

/// Events that a format cannot hold are refused with a reason, or made to fit and counted.
#[test]
fn convert_loses_nothing_unless_it_may() {
    let folder = tempfile::tempdir().expect("a folder");
    let sensor = Sensor {
        width: 240,
        height: 200,
    };
    let events = some_events(sensor, 1000);
    let input = folder.path().join("in.aedat4");
    let mut writer = event_files::create(&input, sensor).expect("a file");
    writer.write(&events).expect("events");
    writer.finish().expect("a file");
    // The DAVIS240 has 180 rows.
    let output = folder.path().join("out.aedat");
    let mut conversion = Conversion::default();
    let error =
        convert(&input, &output, &Reading::default(), &conversion).expect_err("rows are missing");
    assert!(format!("{error:#}").contains("out.aedat"), "{error:#}");
    assert!(!output.exists());
    conversion.allow_loss = true;
    let converted =
        convert(&input, &output, &Reading::default(), &conversion).expect("a conversion");
    let want: Vec<Event> = events.into_iter().filter(|event| event.y < 180).collect();
    assert_eq!(converted.lost.outside, 1000 - want.len() as u64);
    assert_eq!(converted.events_out, want.len() as u64);
    let mut reader = event_files::open(&output, None).expect("a recording");
    assert_eq!(crate::support::drain(reader.as_mut()).0, want);
}

#[test]
fn convert_filters_and_crops() {
    let folder = tempfile::tempdir().expect("a folder");
    let sensor = Sensor {
        width: 240,
        height: 180,
    };
    let events = some_events(sensor, 50_000);
    written(folder.path(), "aedat", sensor, &events);
    let input = folder.path().join("events.aedat");
    let (from, to) = (5_000_010_000, 5_000_100_003);
    let crop = Crop {
        x: 20,
        y: 10,
        width: 100,
        height: 50,
    };
    let filter = Filter {
        from_us: Some(from),
        to_us: Some(to),
        crop: Some(crop),
    };
    let want: Vec<Event> = events
        .iter()
        .filter(|e| (from..to).contains(&e.t_us))
        .filter(|e| (20..120).contains(&e.x) && (10..60).contains(&e.y))
        .map(|e| Event {
            x: e.x - 20,
            y: e.y - 10,
            ..*e
        })
        .collect();
    assert!(!want.is_empty() && want.len() < events.len());
    for name in [
        "out.aedat4",
        "out.raw",
        "out.evt2",
        "out.evt21",
        "out.evt4",
        "out.dat",
        "out.csv",
        "out.npz",
    ] {
        let output = folder.path().join(name);
        let converted =
            convert(&input, &output, &Reading::default(), &of(filter)).expect("a conversion");
        let events_out = want.len() as u64;
        // The input has no index: events of these times may come at any place.
        let events_in = events.len() as u64;
        assert_eq!(
            converted,
            Converted {
                events_in,
                events_out,
                ..Converted::default()
            }
        );
        let mut reader = event_files::open(&output, None).expect("a recording");
        if name != "out.csv" {
            assert_eq!(
                reader.sensor(),
                Sensor {
                    width: 100,
                    height: 50
                }
            );
        }
        assert_eq!(crate::support::drain(reader.as_mut()).0, want, "{name}");
    }
    let outside = Filter {
        crop: Some(Crop {
            x: 200,
            y: 0,
            width: 41,
            height: 1,
        }),
        ..filter
    };
    let error = convert(
        &input,
        &folder.path().join("a.csv"),
        &Reading::default(),
        &of(outside),
    );
    assert!(format!("{:#}", error.expect_err("a crop outside")).contains("240x180"));
    convert(&input, &input, &Reading::default(), &Conversion::default())
        .expect_err("the same file");
    assert_eq!(
        read(&std::fs::read(&input).expect("unharmed"), None).0,
        events
    );
}
