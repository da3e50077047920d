//! The command line end to end: names, flags, JSON keys and exit statuses.

use std::num::{NonZeroU32, NonZeroUsize};
use std::process::Stdio;

use eecvs::thresholds_file::ThresholdsFile;
use eecvs_nostd::{Event, Polarity, Sensor};
use eecvs_oracle::percentile;
use eecvs_oracle::window::{HOST_CAPACITY, Window, windows};
use serde_json::Value;

use crate::support::{Folder, count, exists, number, text, total};

const WINDOW_US: NonZeroU32 = NonZeroU32::new(32_768).unwrap();

/// Regime (eq. 2) and transform (eq. 3) of N_w events: N_w / (H W T) against the thresholds, in
/// integers.
fn regime(
    events: usize,
    sensor: Sensor,
    duration_us: u32,
    thresholds: &ThresholdsFile,
) -> [&'static str; 2] {
    let scaled = events as u128 * 1_000_000_000_000_000_000;
    let below = |pico: u64| {
        scaled < u128::from(pico) * u128::from(sensor.pixels()) * u128::from(duration_us)
    };
    if below(thresholds.tau_low_pico) {
        ["sparse", "dwt"]
    } else if below(thresholds.tau_high_pico) {
        ["moderate", "dtft"]
    } else {
        ["dense", "dct"]
    }
}

/// Compares rows of one frame per window with the windows that the definitions give.
fn check_rows(rows: &[Value], expected: &[Window], sensor: Sensor, thresholds: &ThresholdsFile) {
    assert_eq!(rows.len(), expected.len());
    for (index, (row, window)) in rows.iter().zip(expected).enumerate() {
        assert_eq!(count(row, "index"), index as u64);
        assert_eq!(count(row, "seq"), index as u64);
        assert_eq!(count(row, "t0_us"), window.t0_us, "{row}");
        assert_eq!(count(row, "duration_us"), u64::from(window.duration_us));
        assert_eq!(count(row, "events"), window.events.len() as u64, "{row}");
        let [name, transform] = regime(window.events.len(), sensor, window.duration_us, thresholds);
        assert_eq!(text(row, "regime"), name, "{row}");
        assert_eq!(text(row, "transform"), transform, "{row}");
    }
}

#[test]
fn info_describes_the_recording_in_json_and_in_a_table() {
    let folder = Folder::new();
    folder.scene("scene.aedat4");
    let info = folder.eecvs("info scene.aedat4 --json").ok().object();
    let (sensor, events) = folder.events("scene.aedat4");
    let on = events.iter().filter(|e| e.polarity.sign() > 0).count() as u64;
    let (first, last) = (events[0].t_us, events[events.len() - 1].t_us);
    for (key, value) in [
        ("width", u64::from(sensor.width)),
        ("height", u64::from(sensor.height)),
        ("events", events.len() as u64),
        ("on", on),
        ("off", events.len() as u64 - on),
        ("t_first_us", first),
        ("t_last_us", last),
        ("sum_x", events.iter().map(|e| u64::from(e.x)).sum()),
        ("sum_y", events.iter().map(|e| u64::from(e.y)).sum()),
    ] {
        assert_eq!(count(&info, key), value, "{key}");
    }
    let duration_s = (last - first) as f64 * 1e-6;
    assert!((number(&info, "duration_s") - duration_s).abs() < 1e-12);
    let rate = events.len() as f64 / duration_s;
    assert!((number(&info, "rate_eps") - rate).abs() < 1e-6 * rate);
    assert!(info["sensor"].is_string() || info["sensor"].is_null());
    assert_eq!(text(&info, "format"), "aedat4");
    assert_eq!(text(&info, "sha256_events").len(), 64);

    let table = folder.eecvs("info scene.aedat4").ok().stdout;
    for key in info
        .as_object()
        .unwrap()
        .keys()
        .filter(|key| *key != "skipped")
    {
        assert!(table.lines().any(|line| line.starts_with(key)), "{key}");
    }
    assert!(table.contains(text(&info, "sha256_events")), "{table}");
}

#[test]
fn encode_accounts_for_every_event_and_inspect_agrees() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    // A clock that falls back for two events, and a gap of empty windows.
    let (sensor, mut events) = folder.events("scene.raw");
    let mut late = [events[0], events[1]];
    late.iter_mut().for_each(|event| event.t_us = 100);
    let mut last = events[5];
    last.t_us = events[events.len() - 1].t_us + 500_000;
    events.extend(late);
    events.push(last);
    let mut writer = event_files::create(&folder.path("late.csv"), sensor).unwrap();
    writer.write(&events).unwrap();
    writer.finish().unwrap();

    let summary = folder
        .eecvs("encode late.csv -o a.eecvs --json")
        .warns(&["late.csv", "2 runs", "--sort"])
        .object();
    for (key, value) in [
        ("events_in", events.len() as u64),
        ("events_encoded", events.len() as u64),
        ("events_late", 0),
        ("runs", 2),
        ("events_filtered", 0),
        ("events_dropped", 0),
        ("bytes_out", folder.bytes("a.eecvs").len() as u64),
    ] {
        assert_eq!(count(&summary, key), value, "{key}: {summary}");
    }
    let bits = 8.0 * number(&summary, "bytes_out") / events.len() as f64;
    assert!((number(&summary, "bits_per_event") - bits).abs() < 1e-9);
    assert!(number(&summary, "encode_s") > 0.0 && number(&summary, "events_per_s") > 0.0);

    let outcome = folder.eecvs("inspect a.eecvs --json").ok();
    let rows = outcome.array();
    for row in &rows {
        let row = row.as_object().unwrap();
        for key in [
            "index",
            "seq",
            "t0_us",
            "duration_us",
            "events",
            "m",
            "grid",
            "bytes",
            "late",
            "filtered",
            "dropped",
        ] {
            assert!(row[key].is_u64(), "{key}: {row:?}");
        }
        assert!(
            row["step"].is_number() && row["regime"].is_string(),
            "{row:?}"
        );
        assert_eq!((&row["m"], &row["step"]), (&16.into(), &0.015_625.into()));
        let grid = if row["transform"] == "dct" { 16 } else { 32 };
        assert_eq!(row["grid"], grid);
    }
    assert_eq!(total(&rows, "events"), count(&summary, "events_encoded"));
    assert_eq!(total(&rows, "late"), 0);
    let frames = folder.frames("a.eecvs").concat();
    assert_eq!(total(&rows, "frame_bytes"), frames.len() as u64);
    assert!(total(&rows, "bytes") < frames.len() as u64);
    assert_eq!(rows.len() as u64, count(&summary, "windows"));
    for transform in ["dct", "dtft", "dwt"] {
        let sent = rows
            .iter()
            .filter(|row| row["transform"] == transform)
            .count() as u64;
        assert_eq!(count(&summary, &format!("windows_{transform}")), sent);
        assert!(sent > 0, "the scene has every regime: {summary}");
    }
    let expected = windows(&events, WINDOW_US, HOST_CAPACITY);
    check_rows(&rows, &expected, sensor, &ThresholdsFile::scenes().unwrap());

    let table = folder.eecvs("inspect a.eecvs").ok().stdout;
    assert_eq!(table.lines().count(), rows.len() + 1, "{table}");
    assert!(table.trim_start().starts_with("index"), "{table}");
    let table = folder
        .eecvs("encode late.csv -o a.eecvs")
        .warns(&["2 runs"])
        .stdout;
    assert!(
        table.contains("events in") && !table.contains('{'),
        "{table}"
    );
}

#[test]
fn a_small_window_buffer_closes_windows_early_and_loses_nothing() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (sensor, events) = folder.events("scene.raw");
    for capacity in [1, 3, 100] {
        let line = format!("encode scene.raw -o a.eecvs --window-events {capacity} --json");
        let summary = folder.eecvs(&line).ok().object();
        assert_eq!(count(&summary, "events_encoded"), events.len() as u64);
        let rows = folder.eecvs("inspect a.eecvs --json").ok().array();
        let expected = windows(&events, WINDOW_US, NonZeroUsize::new(capacity).unwrap());
        check_rows(&rows, &expected, sensor, &ThresholdsFile::scenes().unwrap());
        let early = expected
            .iter()
            .filter(|w| w.duration_us < WINDOW_US.get())
            .count();
        assert!(early > 0);
        assert_eq!(count(&summary, "windows_truncated"), early as u64);
        folder.eecvs("decode a.eecvs -o b.npz").ok();
        assert_eq!(folder.pixels("b.npz"), folder.pixels("scene.raw"));
    }
}

#[test]
fn any_number_of_threads_writes_the_same_file() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o default.eecvs").ok();
    for threads in [1, 2, 8] {
        let line = format!("encode scene.raw -o n.eecvs --threads {threads} --json");
        let summary = folder.eecvs(&line).ok().object();
        assert_eq!(count(&summary, "threads"), threads);
        assert!(number(&summary, "wall_s") > 0.0);
        assert!(folder.bytes("n.eecvs") == folder.bytes("default.eecvs"));
    }
}

#[test]
fn calibrated_thresholds_are_percentiles_and_steer_the_encoder() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (sensor, events) = folder.events("scene.raw");
    let windows = windows(&events, WINDOW_US, HOST_CAPACITY);
    let densities: Vec<f64> = windows
        .iter()
        .map(|w| eecvs_oracle::density::window_density(w, sensor))
        .collect();
    let (low, high) = percentile::thresholds(&densities).unwrap();
    let result = folder
        .eecvs("calibrate scene.raw -o thresholds.toml --json")
        .ok()
        .object();
    assert!((number(&result, "tau_low") - low).abs() < 1e-9, "{result}");
    assert!(
        (number(&result, "tau_high") - high).abs() < 1e-9,
        "{result}"
    );
    assert_eq!(count(&result, "window_us"), u64::from(WINDOW_US.get()));
    assert_eq!(count(&result, "windows"), windows.len() as u64);
    assert_eq!(count(&result, "windows_empty"), 0);
    assert_eq!(count(&result, "events"), events.len() as u64);
    assert!(low < high);
    let table = folder.eecvs("calibrate scene.raw -o thresholds.toml").ok();
    assert!(table.stdout.contains("tau_high"), "{}", table.stdout);

    let edited = "# by hand\ntau_low = 2\ntau_high = 20.5 # dense\n";
    let all = "tau_low = 0\ntau_high = 0\n";
    for content in [None, Some(edited), Some(all)] {
        if let Some(content) = content {
            folder.write("thresholds.toml", content);
        }
        folder
            .eecvs("encode scene.raw -o a.eecvs --thresholds thresholds.toml")
            .ok();
        let rows = folder.eecvs("inspect a.eecvs --json").ok().array();
        let file = ThresholdsFile::read(&folder.path("thresholds.toml")).unwrap();
        check_rows(&rows, &windows, sensor, &file);
    }
    for (content, parts) in [
        ("tau_low = 1.0\n", ["t.toml", "tau_high"]),
        ("tau_low = 1\ntau_hi = 2\n", ["t.toml: line 2", "tau_hi"]),
        (
            "tau_low = \"a\"\ntau_high = 2\n",
            ["t.toml: line 1", "tau_low"],
        ),
        (
            "tau_low = 3\ntau_high = 2\n",
            ["t.toml: line 2", "tau_high"],
        ),
    ] {
        folder.write("t.toml", content);
        for command in ["encode scene.raw -o bad.eecvs", "monitor scene.raw"] {
            folder
                .eecvs(&format!("{command} --thresholds t.toml"))
                .fails(&parts);
        }
        assert!(!exists(&folder.path("bad.eecvs")));
    }
}

#[test]
fn a_recording_is_like_itself() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let same = folder
        .eecvs("compare scene.raw scene.raw --json")
        .ok()
        .object();
    let n = folder.events("scene.raw").1.len() as u64;
    for (key, value) in [
        ("exact_fraction", 1.0),
        ("mse", 0.0),
        ("ssim", 1.0),
        ("emd_time_ms", 0.0),
        ("emd_pixel_us", 0.0),
    ] {
        assert_eq!(number(&same, key), value, "{key}");
    }
    assert_eq!((count(&same, "events_a"), count(&same, "events_b")), (n, n));
    assert_eq!(
        (
            count(&same, "missing_events"),
            count(&same, "surplus_events")
        ),
        (0, 0)
    );
    assert_eq!(same.as_object().unwrap().len(), 13, "{same}");
    let table = folder.eecvs("compare scene.raw scene.raw").ok().stdout;
    assert_eq!(table.lines().count(), 11, "{table}");
}

#[test]
fn bad_usage_is_status_2() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for line in [
        "",
        "encoode scene.raw",
        "encode scene.raw",
        "encode -o a.eecvs",
        "encode scene.raw -o a.eecvs -m 0",
        "encode scene.raw -o a.eecvs -m 65",
        "encode scene.raw -o a.eecvs -m eight",
        "encode scene.raw -o a.eecvs --transform fft",
        "encode scene.raw -o a.eecvs --mode best",
        "encode scene.raw -o a.eecvs --kernel fft",
        "encode scene.raw -o a.eecvs --kernel haar",
        "encode scene.raw -o a.eecvs --grid 0",
        "encode scene.raw -o a.eecvs --grid 1025",
        "encode scene.raw -o a.eecvs --step-log2 9",
        "encode scene.raw -o a.eecvs --step-log2 -16",
        "encode scene.raw -o a.eecvs --window-us 0",
        "encode scene.raw -o a.eecvs --window-us 4294967296",
        "encode scene.raw -o a.eecvs --window-events 0",
        "encode scene.raw -o a.eecvs --frame-bytes 727",
        "encode scene.raw -o a.eecvs --threads 0",
        "encode scene.raw -o a.eecvs --threads 1025",
        "encode scene.raw -o a.eecvs --threads all",
        "encode scene.raw -o a.eecvs --width 40",
        "encode scene.raw -o a.eecvs --width 0 --height 1",
        "encode scene.raw -o a.eecvs --no-such-flag",
        "decode a.eecvs",
        "decode a.eecvs --volume v.npy --bins 0",
        "decode a.eecvs -o b.csv --window 1",
        "calibrate -o t.toml",
        "calibrate scene.raw",
        "compare scene.raw",
        "compare scene.raw scene.raw --window-us 0",
        "convert scene.raw",
        "convert scene.raw b.csv --crop 1,2,3",
        "emulate mars -o a.raw",
        "emulate motorcycle",
        "info",
        "inspect",
        "monitor",
    ] {
        let outcome = folder.eecvs(line);
        assert_eq!(outcome.status, Some(2), "{outcome}");
        assert!(
            outcome.stdout.is_empty() && !outcome.stderr.is_empty(),
            "{outcome}"
        );
    }
    let names: Vec<_> = std::fs::read_dir(folder.path(".")).unwrap().collect();
    assert_eq!(names.len(), 1, "nothing was written");
    folder.eecvs("--help").ok();
    folder.eecvs("encode --help").ok();
}

#[test]
fn what_cannot_be_read_is_status_1_and_named() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.write("empty", "");
    folder.write("garbage", [0x7f_u8, 0, 1, 2, 0xff, 0xfe, 0xee].repeat(1000));
    std::fs::create_dir(folder.path("dir")).unwrap();
    for input in ["missing", "empty", "garbage", "dir"] {
        for line in [
            format!("info {input}"),
            format!("info {input} --json"),
            format!("convert {input} out.csv"),
            format!("calibrate {input} -o out.toml"),
            format!("monitor {input}"),
            format!("encode {input} -o out.eecvs"),
            format!("inspect {input}"),
            format!("inspect {input} --json"),
            format!("decode {input} -o out.csv"),
            format!("decode {input} --volume out.npy"),
            format!("compare scene.raw {input}"),
            format!("compare {input} scene.raw --json"),
            format!("encode scene.raw -o out.eecvs --thresholds {input}"),
        ] {
            folder.eecvs(&line).fails(&[input]);
        }
    }
    for entry in std::fs::read_dir(folder.path(".")).unwrap() {
        let name = entry.unwrap().file_name();
        assert!(!name.to_string_lossy().starts_with("out."), "{name:?}");
    }
}

#[test]
fn what_cannot_be_written_is_status_1_and_named() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    std::fs::create_dir(folder.path("dir.csv")).unwrap();
    for (line, name) in [
        ("encode scene.raw -o none/a.eecvs", "none/a.eecvs"),
        ("encode scene.raw -o dir.csv", "dir.csv"),
        ("decode a.eecvs -o none/b.csv", "none/b.csv"),
        ("decode a.eecvs -o dir.csv", "dir.csv"),
        ("decode a.eecvs -o b.doc", "b.doc"),
        ("decode a.eecvs -o b", "b: "),
        ("decode a.eecvs -o b.aedat", "b.aedat"),
        ("decode a.eecvs --volume none/v.npy", "none/v.npy"),
        ("convert scene.raw b.doc", "b.doc"),
        ("convert scene.raw none/b.csv", "none/b.csv"),
        ("calibrate scene.raw -o none/t.toml", "none/t.toml"),
        ("monitor scene.raw --chart none/c.svg", "none/c.svg"),
        ("emulate motorcycle -o b.doc", "b.doc"),
        (
            "emulate motorcycle -o b.csv --start-us 18446744073700000000",
            "b.csv: event 0",
        ),
        ("demo -o scene.raw", "scene.raw"),
    ] {
        folder.eecvs(line).fails(&[name]);
    }
    if exists("/dev/full".as_ref()) {
        for line in [
            "encode scene.raw -o /dev/full --threads 1",
            "encode scene.raw -o /dev/full --threads 3",
            "calibrate scene.raw -o /dev/full",
        ] {
            folder.eecvs(line).fails(&["/dev/full", "space"]);
        }
        assert!(exists("/dev/full".as_ref()), "a device is not removed");
    }
}

#[test]
fn an_input_is_never_overwritten() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    // Under an extension that decode writes.
    std::fs::copy(folder.path("a.eecvs"), folder.path("frames.csv")).unwrap();
    for (line, name) in [
        ("encode scene.raw -o scene.raw", "scene.raw"),
        ("encode scene.raw -o ./scene.raw", "scene.raw"),
        ("decode frames.csv -o frames.csv", "frames.csv"),
        ("decode frames.csv --volume frames.csv", "frames.csv"),
        ("decode a.eecvs -o both.csv --volume both.csv", "both.csv"),
        ("convert scene.raw scene.raw", "scene.raw"),
        ("calibrate a.eecvs scene.raw -o scene.raw", "scene.raw"),
        ("monitor scene.raw --chart scene.raw", "scene.raw"),
    ] {
        let before = [folder.bytes("scene.raw"), folder.bytes("frames.csv")];
        folder.eecvs(line).fails(&[name, "same file"]);
        let after = [folder.bytes("scene.raw"), folder.bytes("frames.csv")];
        assert!(before == after, "{line}");
    }
}

#[test]
fn of_a_damaged_recording_everything_before_the_damage_is_kept() {
    let folder = Folder::new();
    folder.scene("scene.evt2");
    let bytes = folder.bytes("scene.evt2");
    // Within a word.
    folder.write("cut.evt2", &bytes[..bytes.len() / 8 * 4 + 1]);
    folder.write("lines.csv", "t,x,y,p\n10,1,1,1\n20,1,one,0\n");
    folder.write("none.csv", "t,x,y,p\n10,1,one,1\n");
    for input in ["cut.evt2", "lines.csv", "none.csv"] {
        let size = "--width 40 --height 30";
        for command in ["encode --threads 1", "encode --threads 3", "convert"] {
            let (flag, out) = match command {
                "convert" => ("", "part.csv"),
                _ => ("-o ", "part.eecvs"),
            };
            let line = format!("{command} {input} {flag}{out} {size}");
            let is_none = input == "none.csv";
            let kept = if is_none { "byte" } else { "everything before" };
            let outcome = folder.eecvs(&line);
            assert_eq!(outcome.status, Some(1), "{outcome}");
            for word in [input, "byte", kept] {
                assert!(outcome.stderr.contains(word), "{word}: {outcome}");
            }
            assert_eq!(exists(&folder.path(out)), !is_none, "{input} {command}");
            if !is_none {
                if command != "convert" {
                    folder.eecvs("decode part.eecvs -o part.csv").ok();
                }
                let events = |file: &str| -> Value {
                    let outcome = folder.eecvs(&format!("info {file} --json {size}"));
                    serde_json::from_str::<Value>(&outcome.stdout).unwrap()["events"].clone()
                };
                assert_eq!(events("part.csv"), events(input), "{line}");
                std::fs::remove_file(folder.path(out)).unwrap();
            }
        }
    }
}

#[test]
fn a_reader_that_has_seen_enough_is_no_error() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o a.eecvs --window-us 100")
        .ok();
    for line in [
        "inspect a.eecvs",
        "inspect a.eecvs --json",
        "monitor scene.raw --window-us 100",
        "info scene.raw",
        "compare scene.raw scene.raw",
        "decode a.eecvs -o b.csv",
        "encode scene.raw -o b.eecvs --json",
        "emulate --list",
    ] {
        // The reading end is closed before the program starts to write.
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let arguments: Vec<&str> = line.split_whitespace().collect();
        let output = folder
            .command(&arguments)
            .stdout(writer)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
            .wait_with_output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{line}: {stderr}");
        assert!(stderr.is_empty(), "{line}: {stderr}");
    }
}

/// Recordings as people have them, whose times run back: all events come back.
#[test]
fn recordings_that_run_back_are_encoded_whole() {
    let folder = Folder::new();
    let sensor = Sensor::new(64, 48).unwrap();
    let at = |t_us: u64, i: u64| Event {
        t_us,
        x: (i % 64) as u16,
        y: (i / 64 % 48) as u16,
        polarity: Polarity::from_bool(i.is_multiple_of(2)),
    };
    let ascending = |from_us: u64, n: u64| (0..n).map(move |i| at(from_us + 200 * i, i));
    let stale_first = std::iter::once(at(4_000_000_000, 0)).chain(ascending(1000, 999));
    let clock_reset = ascending(5_000_000, 1000).chain(ascending(10, 1000));
    // No two events of equal time, so that sorted ones are one order.
    let jitter = (0..2000).map(|i| at(1_000_000 + 200 * i - 137 * (i * 7919 % 6000), i));
    let cases: [(&str, Vec<Event>, u64); 3] = [
        ("stale_first", stale_first.collect(), 2),
        ("clock_reset", clock_reset.collect(), 2),
        ("jitter", jitter.collect(), 3),
    ];
    for (name, events, runs_least) in cases {
        let mut writer = event_files::create(&folder.path(&format!("{name}.csv")), sensor).unwrap();
        writer.write(&events).unwrap();
        writer.finish().unwrap();
        let info = folder
            .eecvs(&format!("info {name}.csv --json"))
            .ok()
            .object();
        let back = events.windows(2).filter(|two| two[1].t_us < two[0].t_us);
        assert_eq!(count(&info, "times_back"), back.count() as u64, "{name}");
        let mut newest_us = 0;
        let behind = events.iter().map(|event| {
            newest_us = newest_us.max(event.t_us);
            newest_us - event.t_us
        });
        let back_max_us = behind.max().unwrap();
        assert_eq!(count(&info, "back_max_us"), back_max_us, "{name}");
        for flags in [
            "",
            "--coder dense --window-us 9000",
            "--keep-order --threads 2",
        ] {
            let encode = format!("encode {name}.csv -o {name}.eecvs --json {flags}");
            let summary = folder.eecvs(&encode).warns(&[name, "runs"]).object();
            assert_eq!(
                count(&summary, "events_encoded"),
                events.len() as u64,
                "{name}"
            );
            assert!(count(&summary, "runs") >= runs_least, "{summary}");
            let inspect = folder.eecvs(&format!("inspect {name}.eecvs --json")).ok();
            let begin = inspect
                .array()
                .iter()
                .filter(|row| row["begins_run"] == true)
                .count();
            assert_eq!(begin as u64 + 1, count(&summary, "runs"));
            let decode = format!("decode {name}.eecvs -o back.csv --json");
            let decoded = folder.eecvs(&decode).ok().object();
            assert_eq!(count(&decoded, "runs"), count(&summary, "runs"));
            let compared = folder
                .eecvs(&format!("compare {name}.csv back.csv --json"))
                .ok()
                .object();
            assert_eq!(number(&compared, "exact_fraction"), 1.0, "{name} {flags}");
            std::fs::remove_file(folder.path("back.csv")).unwrap();
            folder.eecvs(&format!("monitor {name}.eecvs")).ok();
            std::fs::remove_file(folder.path(&format!("{name}.eecvs"))).unwrap();
        }
        let sorting = format!("encode {name}.csv -o sorted.eecvs --json --sort");
        let summary = folder.eecvs(&sorting).ok().object();
        assert_eq!(count(&summary, "runs"), 1, "{name}");
        let longer = format!("encode {name}.csv -o long.eecvs --json --reorder-us {back_max_us}");
        let longer = folder.eecvs(&longer);
        if back_max_us < u64::from(u32::MAX) {
            assert_eq!(count(&longer.ok().object(), "runs"), 1, "{name}");
            let outputs = ["sorted.eecvs", "long.eecvs"].map(|name| folder.bytes(name));
            assert!(outputs[0] == outputs[1], "{name}");
        }
        folder
            .eecvs(&format!("convert {name}.csv sorted.raw --sort"))
            .ok();
        let (_, found) = folder.events("sorted.raw");
        let mut expected = events.clone();
        expected.sort_by_key(|event| event.t_us);
        assert!(found == expected, "{name}");
        for name in ["sorted.eecvs", "long.eecvs", "sorted.raw"] {
            std::fs::remove_file(folder.path(name)).unwrap();
        }
    }
}

/// A recording whose clock is another one's plus a constant: what `--align` is for.
#[test]
fn a_constant_between_clocks_is_found_and_taken_off() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (sensor, mut events) = folder.events("scene.raw");
    for event in &mut events {
        event.t_us += 100;
    }
    let mut writer = event_files::create(&folder.path("later.raw"), sensor).unwrap();
    writer.write(&events).unwrap();
    writer.finish().unwrap();
    for (a, b, offset_us) in [
        ("scene.raw", "later.raw", 100),
        ("later.raw", "scene.raw", -100),
    ] {
        let apart = folder
            .eecvs(&format!("compare {a} {b} --json"))
            .warns(&[&format!("{offset_us} us ahead"), "--align"])
            .object();
        assert_eq!(apart["clock_offset_us"], offset_us);
        assert!(number(&apart, "exact_fraction") < 0.5 && number(&apart, "emd_pixel_us") <= 100.0);
        let aligned = folder
            .eecvs(&format!("compare {a} {b} --align --json"))
            .ok()
            .object();
        assert_eq!(aligned["aligned"], true);
        assert_eq!(number(&aligned, "exact_fraction"), 1.0);
        assert_eq!(number(&aligned, "emd_pixel_us"), 0.0);
    }
}
