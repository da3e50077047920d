//! Tests recordings of streams as other programs write them: what is read, what the reader reports, and what it
//! asks the user for.

use std::fs;
use std::path::{Path, PathBuf};

use event_files::{self, BadEvents, Columns, Reading, TimeUnit};
use event_types::{Event, Polarity, Sensor};

struct Read {
    sensor: Sensor,
    events: Vec<Event>,
    said: Vec<String>,
    skipped: Vec<(&'static str, u64)>,
}

fn read(path: &Path, reading: impl Into<Reading>) -> Result<Read, String> {
    let told = |error: event_files::Error| format!("{error:#}");
    let mut reader = event_files::open(path, reading).map_err(told)?;
    let mut events = Vec::new();
    while reader.read(&mut events).map_err(told)? > 0 {}
    Ok(Read {
        sensor: reader.sensor(),
        events,
        said: reader
            .assumptions()
            .iter()
            .map(ToString::to_string)
            .collect(),
        skipped: reader.skipped().iter().collect(),
    })
}

fn file(folder: &tempfile::TempDir, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path
}

fn sensor(width: u16, height: u16) -> Sensor {
    Sensor::new(width, height).unwrap()
}

fn sized(width: u16, height: u16) -> Reading {
    Some(sensor(width, height)).into()
}

/// Returns events spread over the pixels of a sensor, at ascending times.
fn events(count: u32, size: Sensor) -> Vec<Event> {
    (0..count)
        .map(|i| Event {
            t_us: u64::from(9 + i * 7),
            x: (i * 31 % u32::from(size.width)) as u16,
            y: (i * 17 % u32::from(size.height)) as u16,
            polarity: Polarity::from_bool(i % 3 == 0),
        })
        .collect()
}

fn is_on(event: &Event) -> u32 {
    u32::from(event.polarity == Polarity::On)
}

fn dvs128(event: &Event) -> u32 {
    u32::from(event.y) << 8 | (127 - u32::from(event.x)) << 1 | (1 - is_on(event))
}

fn davis(event: &Event, width: u16) -> u32 {
    let x = u32::from(width - 1 - event.x);
    u32::from(event.y) << 22 | x << 12 | is_on(event) << 11
}

fn aedat2(header: &str, events: &[Event], address: impl Fn(&Event) -> u32) -> Vec<u8> {
    let mut bytes = format!("#!AER-DAT2.0\r\n{header}").into_bytes();
    for event in events {
        bytes.extend(address(event).to_be_bytes());
        bytes.extend((event.t_us as u32).to_be_bytes());
    }
    bytes
}

#[test]
fn a_dvs128_without_a_chip_line_is_told_by_its_addresses() {
    let folder = tempfile::tempdir().unwrap();
    let want = events(20_000, sensor(128, 128));
    let header =
        "# This is a raw AE data file created by saveaerdat.m\r\n# Timestamps tick is 1 us\r\n";
    let path = file(&folder, "a.aedat", aedat2(header, &want, dvs128));
    let read = read(&path, None).unwrap();
    assert_eq!(read.sensor, sensor(128, 128));
    assert_eq!(read.events, want);
    assert!(
        read.said[0].starts_with("chip DVS128 of 128x128"),
        "{:?}",
        read.said
    );
}

#[test]
fn a_davis_without_a_chip_line_has_the_size_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    for (width, height) in [(346, 260), (640, 480)] {
        let size = sensor(width, height);
        let want = events(9_000, size);
        let bytes = aedat2("# created by v2e\r\n", &want, |event| davis(event, width));
        let path = file(&folder, "a.aedat", bytes);
        assert_eq!(read(&path, sized(width, height)).unwrap().events, want);
        let asked = read(&path, None).err().unwrap();
        assert!(
            asked.contains("--width") && asked.contains("byte"),
            "{asked}"
        );
    }
    let want = events(9_000, sensor(240, 180));
    let path = file(
        &folder,
        "b.aedat",
        aedat2("", &want, |event| davis(event, 240)),
    );
    let taken = read(&path, None).unwrap();
    assert_eq!((taken.sensor, taken.events), (sensor(240, 180), want));
    assert!(
        taken.said[0].contains("DAVIS of 240x180"),
        "{:?}",
        taken.said
    );
}

#[test]
fn chips_are_known_by_every_name_that_jaer_writes() {
    let folder = tempfile::tempdir().unwrap();
    for (class, width, height) in [
        ("eu.seebetter.ini.chips.davis.Davis346red", 346, 260),
        ("eu.seebetter.ini.chips.davis.Davis640", 640, 480),
        ("eu.seebetter.ini.chips.DAViS.SBret10", 240, 180),
        ("DAVI346", 346, 260),
    ] {
        let size = sensor(width, height);
        let want = events(700, size);
        let bytes = aedat2(&format!("# AEChip: {class}\r\n"), &want, |event| {
            davis(event, width)
        });
        let path = file(&folder, "a.aedat", bytes);
        let read = read(&path, None).unwrap();
        assert_eq!((read.sensor, read.events, read.said), (size, want, vec![]));
        let path = file(
            &folder,
            "b.aedat",
            aedat2(&format!("# AEChip: {class}\r\n"), &[], dvs128),
        );
        assert_eq!(self::read(&path, None).unwrap().sensor, size);
    }
    let want = events(700, sensor(300, 200));
    let bytes = aedat2("# AEChip: a.b.Davis300x\r\n", &want, |event| {
        davis(event, 300)
    });
    let path = file(&folder, "c.aedat", bytes);
    let asked = read(&path, None).err().unwrap();
    assert!(
        asked.contains("Davis300x") && asked.contains("--width"),
        "{asked}"
    );
    assert_eq!(read(&path, sized(300, 200)).unwrap().events, want);
}

#[test]
fn addresses_that_fit_both_layouts_or_none_are_asked_about() {
    let folder = tempfile::tempdir().unwrap();
    for address in [0x0000_8000_u32, 0x0001_8001] {
        let bytes = aedat2("", &events(3, sensor(1, 1)), |_| address);
        let path = file(&folder, "a.aedat", bytes);
        let asked = read(&path, None).err().unwrap();
        assert!(asked.contains("--width"), "{asked}");
    }
    let path = file(
        &folder,
        "b.aedat",
        aedat2("", &events(900, sensor(128, 128)), dvs128),
    );
    let refused = read(&path, sized(346, 260)).err().unwrap();
    assert!(
        refused.contains("DVS128") && refused.contains("346x260"),
        "{refused}"
    );
}

#[test]
fn aedat_1_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let want = events(20_000, sensor(128, 128));
    let mut bytes = b"#!AER-DAT1.0\r\n# Timestamps tick is 1 us\r\n".to_vec();
    for event in &want {
        bytes.extend((dvs128(event) as u16).to_be_bytes());
        bytes.extend((event.t_us as u32).to_be_bytes());
    }
    let read = read(&file(&folder, "a.aedat", bytes), None).unwrap();
    assert_eq!((read.sensor, read.events), (sensor(128, 128), want));
}

/// Returns a packet of AEDAT 3.1.
fn packet(kind: u16, source: u16, overflow: u32, content: &[[u32; 2]]) -> Vec<u8> {
    let count = content.len() as u32;
    let mut bytes = [kind.to_le_bytes(), source.to_le_bytes()].concat();
    for number in [8, 4, overflow, count, count, count] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(
        content
            .as_flattened()
            .iter()
            .flat_map(|word| word.to_le_bytes()),
    );
    bytes
}

fn polarity_words(event: &Event) -> [u32; 2] {
    let word = u32::from(event.x) << 17 | u32::from(event.y) << 2 | is_on(event) << 1 | 1;
    [word, (event.t_us & 0x7fff_ffff) as u32]
}

#[test]
fn aedat_3_is_read_with_what_else_its_packets_hold() {
    let folder = tempfile::tempdir().unwrap();
    let mut want = events(3_000, sensor(346, 260));
    for event in &mut want[1_500..] {
        event.t_us += 1 << 31;
    }
    let words: Vec<[u32; 2]> = want.iter().map(polarity_words).collect();
    let mut bytes = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346B\r\n#-Source 0: Old\r\n\
                      #Start-Time: 2016-10-11 10:23:45 (TZ+0200)\r\n#!END-HEADER\r\n"
        .to_vec();
    bytes.extend(packet(0, 1, 0, &[[1, 5]]));
    for (part, words) in words.chunks(500).enumerate() {
        bytes.extend(packet(1, 1, u32::from(part >= 3), words));
        bytes.extend(packet(2, 1, 0, &[[1, 5]; 3]));
        bytes.extend(packet(1, 1, 0, &[[2, 5]]));
        bytes.extend(packet(1, 1, 0, &[]));
        bytes.extend(packet(1, 7, 0, &[[3, 5]]));
    }
    let path = file(&folder, "a.aedat", &bytes);
    let whole = read(&path, None).unwrap();
    assert_eq!((whole.sensor, &whole.events), (sensor(346, 260), &want));
    let skipped = [
        ("events of further sources", 6),
        ("frames", 18),
        ("invalid events", 6),
        ("special events", 1),
    ];
    assert_eq!(whole.skipped, skipped);
    let cut = file(&folder, "b.aedat", &bytes[..bytes.len() - 40]);
    assert!(read(&cut, None).err().unwrap().contains("truncated"));
}

fn dat(header: &str, events: &[Event], version: u32) -> Vec<u8> {
    let mut bytes = header.as_bytes().to_vec();
    bytes.extend([0, 8]);
    for event in events {
        let (x, y) = (u32::from(event.x), u32::from(event.y));
        let address = match version {
            1 => is_on(event) << 17 | y << 9 | x,
            _ => is_on(event) << 28 | y << 14 | x,
        };
        bytes.extend((event.t_us as u32).to_le_bytes());
        bytes.extend(address.to_le_bytes());
    }
    bytes
}

#[test]
fn dat_without_a_version_is_told_by_its_records() {
    let folder = tempfile::tempdir().unwrap();
    let want = events(20_000, sensor(304, 240));
    let header = "% Data file containing TD events.\n% Height 240\n% Width 304\n";
    for version in [1, 2] {
        let path = file(&folder, "a.dat", dat(header, &want, version));
        let read = read(&path, None).unwrap();
        assert_eq!(
            (read.sensor, read.events),
            (sensor(304, 240), want.clone()),
            "{version}"
        );
        assert!(
            read.said[0].starts_with(&format!("version {version}")),
            "{:?}",
            read.said
        );
    }
    // Only OFF events, in the upper rows, so that bits of version 1 are not set.
    let off: Vec<Event> = events(9_000, sensor(304, 100))
        .into_iter()
        .map(|event| Event {
            polarity: Polarity::Off,
            ..event
        })
        .collect();
    let path = file(&folder, "b.dat", dat(header, &off, 2));
    assert_eq!(read(&path, None).unwrap().events, off);
}

#[test]
fn the_system_tells_the_size_of_a_raw_file() {
    let folder = tempfile::tempdir().unwrap();
    let want = events(600, sensor(640, 480));
    let path = folder.path().join("a.evt2");
    let mut writer = event_files::create(&path, sensor(640, 480)).unwrap();
    writer.write(&want).unwrap();
    writer.finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    let end = bytes
        .windows(6)
        .position(|part| part == b"% end\n")
        .unwrap()
        + 6;
    let header = "% date 2021-09-01 10:00:00\n% evt 2.0\n% integrator_name CenturyArks\n\
                  % plugin_name silky_common_plugin\n% system_ID 28\n% subsystem_ID 0\n";
    let path = file(
        &folder,
        "b.raw",
        [header.as_bytes(), &bytes[end..]].concat(),
    );
    let read = read(&path, None).unwrap();
    assert_eq!((read.sensor, read.events), (sensor(640, 480), want));
}

/// Returns the ten events of the texts.
fn ten() -> Vec<Event> {
    let times = [1, 20, 33, 47, 60, 1000, 1500, 2000, 2600, 3333];
    let event = |(i, t_us): (u16, u64)| Event {
        t_us,
        x: 30 * i,
        y: 20 * i,
        polarity: Polarity::from_bool(i % 2 == 1),
    };
    (0..).zip(times).map(event).collect()
}

fn lines(of: impl Fn(&Event) -> String) -> String {
    ten().iter().map(of).collect()
}

fn seconds(event: &Event) -> String {
    format!("{}e-6", event.t_us)
}

#[test]
fn texts_of_other_programs_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let v2e = "#!events.txt\n# This is a text DVS created by v2e (see https://github.com/SensorsINI/v2e)\n\
               # Format is time (float s), x, y, polarity (0=off, 1=on) as specified at http://x/davis_data.html\n\
               # Creation time: 10:01PM January 26 2021\n# User name: x\n";
    let plain = |event: &Event| {
        format!(
            "{} {} {} {}\n",
            seconds(event),
            event.x,
            event.y,
            is_on(event)
        )
    };
    let labelled = |event: &Event| {
        format!(
            "{} {} {} {} 1\n",
            seconds(event),
            event.x,
            event.y,
            is_on(event)
        )
    };
    let comma = |event: &Event| {
        let Event { t_us, x, y, .. } = event;
        format!("{t_us},{x},{y},{}\r\n", is_on(event))
    };
    let quoted = |event: &Event| format!("\"{}\"\n", comma(event).trim_end().replace(',', "\",\""));
    let utf16 = |order: fn(u16) -> [u8; 2]| {
        let text = format!("\u{feff}t,x,y,p\r\n{}", lines(comma));
        text.encode_utf16().flat_map(order).collect::<Vec<u8>>()
    };
    let index = |event: &Event| format!("{},{}", event.x / 30, comma(event));
    let texts = [
        format!("{v2e}{}", lines(plain)).into_bytes(),
        format!("# x\n{}", lines(labelled)).into_bytes(),
        format!(",t,x,y,p\n{}", lines(index)).into_bytes(),
        format!("\"\",\"t\",\"x\",\"y\",\"p\"\n{}", lines(index)).into_bytes(),
        format!("\"t\",\"x\",\"y\",\"p\"\n{}", lines(quoted)).into_bytes(),
        format!("timestamp (us),x [px],y [px],polarity\n{}", lines(comma)).into_bytes(),
        format!("Timestamp [us], X, Y, Polarity\n{}", lines(comma)).into_bytes(),
        utf16(u16::to_le_bytes),
        utf16(u16::to_be_bytes),
    ];
    for bytes in texts {
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let read = read(&file(&folder, "a.txt", &bytes), sized(346, 260)).expect(&text);
        assert_eq!(read.events, ten(), "{text}");
        let is_named = text.contains("us)") || text.contains("[us]");
        let says = read.said.iter().any(|said| said.starts_with("time unit"));
        assert_eq!(says, !is_named, "{text}");
    }
}

#[test]
fn what_a_text_does_not_say_is_told_by_options() {
    let folder = tempfile::tempdir().unwrap();
    let ms = lines(|event| {
        let Event { t_us, x, y, .. } = event;
        format!(
            "{}.{:03} {x} {y} {}\n",
            t_us / 1000,
            t_us % 1000,
            is_on(event)
        )
    });
    let path = file(&folder, "ms.txt", &ms);
    let reading = Reading {
        time_unit: Some(TimeUnit::Ms),
        ..Reading::default()
    };
    assert_eq!(read(&path, reading).unwrap().events, ten());
    let as_seconds = read(&path, None).unwrap();
    assert_eq!(as_seconds.events[9].t_us, 3_333_000);
    assert!(
        as_seconds
            .said
            .iter()
            .any(|said| said.contains("time unit s"))
    );

    let relative = lines(|event| {
        let t_us = event.t_us as i64 - 500;
        format!("{t_us}e-6 {} {} {}\n", event.x, event.y, is_on(event))
    });
    let path = file(&folder, "relative.txt", &relative);
    let refused = read(&path, None).err().unwrap();
    assert!(
        refused.contains("line 1") && refused.contains("--time-offset-us"),
        "{refused}"
    );
    let reading = Reading {
        time_offset_us: 500,
        ..Reading::default()
    };
    assert_eq!(read(&path, reading).unwrap().events, ten());
    let reading = Reading {
        bad_events: BadEvents::LeaveOut,
        ..Reading::default()
    };
    let rest = read(&path, reading).unwrap();
    assert_eq!(
        (rest.events.len(), rest.skipped),
        (5, vec![("events before time 0", 5)])
    );

    // CeleX-5: row, column, brightness, polarity, time.
    let celex = lines(|event| {
        let p = 2 * is_on(event) as i32 - 1;
        format!(
            "{},{},{},{p},{}\n",
            event.y,
            event.x,
            100 + event.x / 30,
            event.t_us
        )
    });
    let path = file(&folder, "celex.csv", &celex);
    assert!(read(&path, None).err().unwrap().contains("--columns"));
    let columns = |text: &str| Reading {
        columns: Some(Columns::parse(text).unwrap()),
        ..Reading::default()
    };
    assert_eq!(read(&path, columns("yx-pt")).unwrap().events, ten());
    let named = format!("row,col,brightness,sign,stamp\n{celex}");
    let path = file(&folder, "named.csv", named);
    assert_eq!(read(&path, columns("yx-pt")).unwrap().events, ten());
    let names = columns("t=stamp,x=col,y=row,p=sign");
    assert_eq!(read(&path, names).unwrap().events, ten());
    let wrong = read(&path, columns("t=stamps,x=col,y=row,p=sign"));
    assert!(wrong.err().unwrap().contains("line 1"));
}

#[test]
fn what_is_unclear_in_a_text_is_asked_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let same = lines(|event| format!("{} {} 0 {}\n", event.x / 3, event.y / 3, is_on(event)));
    let same = format!("{same}{same}");
    let slow: String = (0..600)
        .map(|i| format!("{},{},7,1\n", 240_000 + i * 3_300_000_u64, i % 300))
        .collect();
    for (text, what) in [
        (same.as_str(), ["line 1", "or xytp"]),
        ("# a\n0,001;30;20;1\n", ["line 2", "comma"]),
        ("t;x;y;p\n0,001;30;20;1\n", ["line 2", "comma"]),
        ("0,001 30 20 1\n", ["line 1", "comma"]),
        (
            "t,x,y,p\n2021-09-01 10:00:00.000123,30,20,1\n",
            ["line 2", "date"],
        ),
        ("2021-09-01 10:00:00.000123,30,20,1\n", ["line 1", "date"]),
        (&format!("t,x,y,p\n{slow}"), ["line 2", "--time-unit"]),
        (
            "t,x,y,p\n5,1,1,1\n6,1,1,0\n7,1,1,-1\n",
            ["line 3", "more than two"],
        ),
    ] {
        let asked = read(&file(&folder, "a.csv", text), None).err().expect(text);
        assert!(what.iter().all(|what| asked.contains(what)), "{asked}");
    }
    let path = file(&folder, "b.txt", &same);
    let reading = Reading {
        columns: Some(Columns::parse("xytp").unwrap()),
        ..Reading::default()
    };
    let read = read(&path, reading).unwrap();
    assert_eq!((read.sensor, read.events.len()), (sensor(91, 61), 20));
    assert!(read.events.iter().all(|event| event.t_us == 0));
}

#[test]
fn bad_lines_of_a_text_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let text = "t,x,y,p\n1,2,3,1\n2,nan,3,1\n3,2,,1\n4,2,33014,0\n5,2,3,7\n-6,2,3,1\n7,5,6,0\n";
    let path = file(&folder, "a.csv", text);
    let reading = Reading {
        bad_events: BadEvents::LeaveOut,
        ..Reading::default()
    };
    let read = read(&path, &reading).unwrap();
    let times: Vec<u64> = read.events.iter().map(|event| event.t_us).collect();
    assert_eq!((times, read.sensor), (vec![1, 7], sensor(6, 7)));
    let skipped = [
        ("events before time 0", 1),
        ("events of no polarity", 1),
        ("events outside of the sensor", 1),
        ("events with a value that is no number", 1),
        ("lines of another number of fields", 1),
    ];
    assert_eq!(read.skipped, skipped);
    let zeros = "t,x,y,p\n5,1,1,1\n6,1,1,0\n7,1,1,-1\n";
    let left = self::read(&file(&folder, "b.csv", zeros), &reading).unwrap();
    assert_eq!(left.skipped, [("events of a third polarity", 1)]);
    assert_eq!(left.events.len(), 2);
}

#[test]
fn recordings_without_events_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    for (name, want) in [
        ("a.txt", (30, 20)),
        ("a.csv", (30, 20)),
        ("a.bin", (34, 34)),
    ] {
        let path = folder.path().join(name);
        event_files::create(&path, sensor(30, 20))
            .unwrap()
            .finish()
            .unwrap();
        let told = read(&path, None).unwrap();
        assert_eq!(
            (told.sensor, told.events),
            (sensor(want.0, want.1), vec![]),
            "{name}"
        );
        assert_eq!(read(&path, sized(30, 20)).unwrap().sensor, sensor(30, 20));
    }
    let path = file(&folder, "empty.txt", "");
    assert_eq!(read(&path, sized(3, 4)).unwrap().events, []);
    assert!(read(&path, None).err().unwrap().contains("--width"));
}

#[test]
fn a_text_of_a_few_events_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    for count in [1, 2, 5, 300] {
        for start_us in [0, 2_047, 2_048, 1 << 40] {
            let mut want = events(count, sensor(2, 200));
            for event in &mut want {
                event.t_us += start_us;
            }
            let mut writer = event_files::create(&path, sensor(2, 200)).unwrap();
            writer.write(&want).unwrap();
            writer.finish().unwrap();
            assert_eq!(
                read(&path, None).unwrap().events,
                want,
                "{count} from {start_us}"
            );
        }
    }
}

/// Returns an AEDAT 4 file of two event streams, joined from two files of one stream.
fn two_streams(folder: &tempfile::TempDir, parts: [&[Event]; 2]) -> Vec<u8> {
    const POSITION_AT: usize = 14 + 40;
    let one = |events: &[Event]| {
        let path = folder.path().join("one.aedat4");
        let mut writer = event_files::create(&path, sensor(346, 260)).unwrap();
        writer.write(events).unwrap();
        writer.finish().unwrap();
        let mut bytes = fs::read(path).unwrap();
        let position = bytes[POSITION_AT..POSITION_AT + 8].try_into().unwrap();
        bytes.truncate(usize::try_from(i64::from_le_bytes(position)).unwrap());
        bytes
    };
    let [left, right] = parts.map(one);
    let xml_at = left.windows(3).position(|part| part == b"<dv").unwrap();
    let header_end = 18 + u32::from_le_bytes(left[14..18].try_into().unwrap()) as usize;
    let node = |id: u8, source: &str| {
        format!(
            "<node name=\"{id}\"><attr key=\"originalOutputName\">events</attr>\
             <attr key=\"typeIdentifier\">EVTS</attr><node name=\"info\"><attr key=\"sizeX\">346</attr>\
             <attr key=\"sizeY\">260</attr><attr key=\"source\">{source}</attr></node></node>"
        )
    };
    let xml = format!(
        "<dv version=\"2.0\"><node name=\"outInfo\">{}{}</node></dv>\0",
        node(0, "L_1"),
        node(1, "R_2")
    );
    let mut bytes = left[..xml_at].to_vec();
    bytes[POSITION_AT..POSITION_AT + 8].copy_from_slice(&(-1_i64).to_le_bytes());
    bytes[xml_at - 4..].copy_from_slice(&(xml.len() as u32 - 1).to_le_bytes());
    bytes.extend(xml.as_bytes());
    let size = (bytes.len() - 18) as u32;
    bytes[14..18].copy_from_slice(&size.to_le_bytes());
    bytes.extend(&left[header_end..]);
    let mut rest = &right[header_end..];
    while let [_, _, _, _, s0, s1, s2, s3, ..] = *rest {
        let end = 8 + u32::from_le_bytes([s0, s1, s2, s3]) as usize;
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend(&rest[4..end]);
        rest = &rest[end..];
    }
    bytes
}

#[test]
fn streams_of_an_aedat4_file_have_names() {
    let folder = tempfile::tempdir().unwrap();
    let (left, right) = (
        events(3_000, sensor(346, 260)),
        events(500, sensor(300, 99)),
    );
    let path = file(&folder, "a.aedat4", two_streams(&folder, [&left, &right]));
    let first = read(&path, None).unwrap();
    assert_eq!(first.events, left);
    assert!(
        first.said[0].starts_with("stream 0 (L_1, events)"),
        "{:?}",
        first.said
    );
    assert!(
        first.said[0].contains("1 (R_2, events)"),
        "{:?}",
        first.said
    );
    assert_eq!(first.skipped, [("events of further streams", 500)]);
    for (place, want) in [
        ("0", &left),
        ("L_1", &left),
        ("1", &right),
        ("R_2", &right),
        ("R_2/events", &right),
    ] {
        let read = read(&path.join(place), None).unwrap();
        assert_eq!((&read.events, read.said.len()), (want, 0), "{place}");
    }
    for (place, what) in [
        ("up", "0 (L_1, events), 1 (R_2, events)"),
        ("events", "more than one"),
    ] {
        let refused = read(&path.join(place), None).err().unwrap();
        assert!(refused.contains(what), "{refused}");
    }
}

/// The fields of a message, aligned as in CDR, or packed as in ROS 1.
struct Message {
    bytes: Vec<u8>,
    aligned: bool,
}

impl Message {
    fn put<const N: usize>(&mut self, value: [u8; N]) {
        while self.aligned && !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        self.bytes.extend(value);
    }

    /// Returns a `dvs_msgs/EventArray`.
    fn of(events: &[Event], size: Sensor, aligned: bool) -> Vec<u8> {
        let bytes = if aligned {
            vec![0, 1, 0, 0]
        } else {
            Vec::new()
        };
        let mut message = Self { bytes, aligned };
        if !aligned {
            message.put(7_u32.to_le_bytes());
        }
        message.put(3_u32.to_le_bytes());
        message.put(4_u32.to_le_bytes());
        message.put(u32::from(aligned).to_le_bytes());
        message
            .bytes
            .resize(message.bytes.len() + usize::from(aligned), 0);
        message.put(u32::from(size.height).to_le_bytes());
        message.put(u32::from(size.width).to_le_bytes());
        message.put((events.len() as u32).to_le_bytes());
        for event in events {
            message.put(event.x.to_le_bytes());
            message.put(event.y.to_le_bytes());
            message.put(((event.t_us / 1_000_000) as u32).to_le_bytes());
            message.put(((event.t_us % 1_000_000 * 1000) as u32).to_le_bytes());
            message.put([is_on(event) as u8]);
        }
        message.bytes
    }
}

fn mcap(encoding: &str, kind: &str, messages: &[Vec<u8>]) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x89MCAP0\r\n";
    let text = |text: &str| [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    let record = |kind: u8, content: &[u8]| {
        [
            &[kind],
            (content.len() as u64).to_le_bytes().as_slice(),
            content,
        ]
        .concat()
    };
    let schema = [vec![1, 0], text(kind), text("ros1msg"), text("")].concat();
    let channel = [vec![1, 0, 1, 0], text("/events"), text(encoding), text("")].concat();
    let mut bytes = [MAGIC, &record(1, &[text("ros1"), text("")].concat())].concat();
    bytes.extend(record(3, &schema));
    bytes.extend(record(4, &channel));
    for message in messages {
        bytes.extend(record(5, &[[1, 0].as_slice(), &[0; 20], message].concat()));
    }
    bytes.extend(record(15, &[0; 4]));
    bytes.extend(record(2, &[0; 20]));
    [&bytes, MAGIC].concat()
}

#[test]
fn bags_of_either_ros_compressed_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let size = sensor(346, 260);
    let want = events(5_000, size);
    let messages = |aligned| -> Vec<Vec<u8>> {
        want.chunks(700)
            .map(|part| Message::of(part, size, aligned))
            .collect()
    };
    let pack = |bytes: &[u8]| zstd::encode_all(bytes, 3).unwrap();
    let cdr = "dvs_msgs/msg/EventArray";
    let plain = mcap("cdr", cdr, &messages(true));
    let packed: Vec<Vec<u8>> = messages(true).iter().map(|bytes| pack(bytes)).collect();
    let packed = mcap("cdr", cdr, &packed);
    for (name, bytes) in [
        (
            "ros1.mcap",
            &mcap("ros1", "dvs_msgs/EventArray", &messages(false)),
        ),
        ("cdr.mcap", &plain),
        ("message.mcap", &packed),
    ] {
        let read = read(&file(&folder, name, bytes), None).unwrap();
        assert_eq!((read.sensor, &read.events), (size, &want), "{name}");
    }
    for (name, bytes) in [("b_0.mcap.zstd", pack(&plain)), ("b_0.mcap", packed)] {
        let metadata = format!("bag:\n  relative_file_paths:\n    - {name}\n  version: 9\n");
        file(&folder, "metadata.yaml", metadata);
        file(&folder, name, bytes);
        assert_eq!(read(folder.path(), None).unwrap().events, want, "{name}");
    }
    file(
        &folder,
        "metadata.yaml",
        "relative_file_paths:\n- b_0.mcap.zstd\n",
    );
    file(&folder, "b_0.mcap.zstd", &pack(&plain)[..500]);
    let damaged = read(folder.path(), None).err().unwrap();
    assert!(damaged.contains("b_0.mcap.zstd"), "{damaged}");
}

/// Returns a file of events of a 64x48 sensor in each format, with its name.
fn of_every_format(folder: &tempfile::TempDir, events: &[Event]) -> Vec<(&'static str, Vec<u8>)> {
    let endings = [
        "evt2",
        "evt3",
        "evt21.raw",
        "evt4.raw",
        "dat",
        "es",
        "bin",
        "aedat4",
        "mcap",
        "bag",
        "txt",
    ];
    let write = |ending: &'static str| {
        let path = folder.path().join(format!("a.{ending}"));
        let mut writer = event_files::create(&path, sensor(64, 48)).unwrap();
        writer.write(events).unwrap();
        writer.finish().unwrap();
        (ending, fs::read(path).unwrap())
    };
    endings.into_iter().map(write).collect()
}

#[test]
fn an_offset_is_added_in_every_format_and_no_option_is_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let want = events(2_000, sensor(64, 48));
    for (ending, _) in of_every_format(&folder, &want) {
        let path = folder.path().join(format!("a.{ending}"));
        let reading = Reading {
            size: Some(sensor(64, 48)),
            time_offset_us: -9,
            ..Reading::default()
        };
        let moved = read(&path, &reading).unwrap();
        let is_moved = |(moved, event): (&Event, &Event)| moved.t_us + 9 == event.t_us;
        assert!(moved.events.iter().zip(&want).all(is_moved), "{ending}");
        assert_eq!(moved.events.len(), want.len());
        let too_far = Reading {
            time_offset_us: -10,
            ..reading.clone()
        };
        assert!(read(&path, &too_far).is_err(), "{ending}");
        let left_out = Reading {
            bad_events: BadEvents::LeaveOut,
            ..too_far
        };
        let left = read(&path, &left_out).unwrap();
        assert_eq!(left.events.len(), want.len() - 1, "{ending}");
        assert!(
            left.skipped.contains(&("events before time 0", 1)),
            "{ending}"
        );
        let states_size = !matches!(ending, "bin" | "txt");
        let other = read(&path, sized(70, 50)).unwrap();
        let says = other
            .said
            .iter()
            .any(|said| said.starts_with("stated size 64x48"));
        assert_eq!(says, states_size, "{ending}");
        if ending != "txt" {
            for reading in [
                Reading {
                    time_unit: Some(TimeUnit::Ms),
                    ..reading.clone()
                },
                Reading {
                    columns: Some(Columns::parse("txyp").unwrap()),
                    ..reading
                },
            ] {
                assert!(
                    read(&path, reading).err().unwrap().contains("omit --"),
                    "{ending}"
                );
            }
        }
    }
}

#[test]
fn events_outside_of_the_sensor_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let all = events(9_000, sensor(64, 48));
    let want: Vec<Event> = all.iter().filter(|event| event.x < 32).copied().collect();
    let reading = Reading {
        size: Some(sensor(32, 48)),
        bad_events: BadEvents::LeaveOut,
        ..Reading::default()
    };
    for (ending, mut bytes) in of_every_format(&folder, &all) {
        let narrow = match ending {
            // Their sizes are inside compressed or packed headers.
            "aedat4" | "mcap" | "bag" => continue,
            "es" => {
                bytes[16] = 32;
                vec![]
            }
            "dat" => vec![(b"Width 64".as_slice(), b"Width 32".as_slice())],
            _ => vec![
                (b"width=64".as_slice(), b"width=32".as_slice()),
                (b"64x48", b"32x48"),
            ],
        };
        for (from, to) in narrow {
            if let Some(at) = bytes.windows(from.len()).position(|part| part == from) {
                bytes[at..at + to.len()].copy_from_slice(to);
            }
        }
        let path = file(&folder, &format!("b.{ending}"), bytes);
        let refused = Reading {
            bad_events: BadEvents::Refuse,
            ..reading.clone()
        };
        assert!(
            read(&path, refused).err().unwrap().contains("outside"),
            "{ending}"
        );
        let left = read(&path, &reading).unwrap();
        assert_eq!(left.events, want, "{ending}");
        let count = (all.len() - want.len()) as u64;
        assert!(
            left.skipped
                .contains(&("events outside of the sensor", count)),
            "{ending}"
        );
    }
    let message = Message::of(&all, sensor(32, 48), true);
    let path = file(
        &folder,
        "c.mcap",
        mcap("cdr", "dvs_msgs/msg/EventArray", &[message]),
    );
    assert_eq!(read(&path, &reading).unwrap().events, want);
}
