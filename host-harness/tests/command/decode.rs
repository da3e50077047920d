//! Decoding from the command line: every format, files of many frames, damaged files, odd
//! settings, and the demo.

use crate::support::{Folder, count, number, total};
use eecvs::frame_file::mark::BEGIN;
use serde_json::Value;

/// What `inspect` says of every frame.
fn rows(folder: &Folder, name: &str) -> Vec<Value> {
    folder.eecvs(&format!("inspect {name} --json")).ok().array()
}

#[test]
fn every_format_holds_the_right_events_per_pixel_and_polarity() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    for extension in ["csv", "txt", "npz", "aedat4", "raw", "evt2.raw", "evt2"] {
        let summary = folder
            .eecvs(&format!("decode a.eecvs -o b.{extension} --json"))
            .ok()
            .object();
        let name = format!("b.{extension}");
        assert_eq!(folder.pixels(&name), folder.pixels("scene.raw"), "{name}");
        assert_eq!(count(&summary, "events"), folder.pixels(&name).len() as u64);
        assert_eq!(count(&summary, "windows"), count(&summary, "frames"));
        for key in [
            "frames_lost",
            "frames_repeated",
            "damaged_bytes",
            "events_dropped",
        ] {
            assert_eq!(count(&summary, key), 0, "{key}");
        }
    }
    // AEDAT 2.0 holds the sizes of two cameras.
    folder
        .eecvs("emulate motorcycle -o dvs.raw --width 128 --height 128 --duration-us 20000")
        .ok();
    folder.eecvs("encode dvs.raw -o dvs.eecvs").ok();
    let table = folder.eecvs("decode dvs.eecvs -o dvs.aedat").ok().stdout;
    assert!(table.contains("events") && !table.contains('{'), "{table}");
    assert_eq!(folder.pixels("dvs.aedat"), folder.pixels("dvs.raw"));
    // Each window's events lie in the window.
    let (_, decoded) = folder.events("b.raw");
    for row in rows(&folder, "a.eecvs") {
        let from = count(&row, "t0_us");
        let inside = from..from + count(&row, "duration_us");
        let n = decoded.iter().filter(|e| inside.contains(&e.t_us)).count();
        assert_eq!(n as u64, count(&row, "events"), "{row}");
    }
}

#[test]
fn many_small_frames_decode_to_the_same_as_one_per_window() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for transform in ["auto", "dct", "dtft", "dwt"] {
        let encode = format!("encode scene.raw --mode transform --transform {transform} --json");
        let one = folder
            .eecvs(&format!("{encode} -o one.eecvs"))
            .ok()
            .object();
        let many = folder
            .eecvs(&format!("{encode} -o many.eecvs --frame-bytes 1208"))
            .ok()
            .object();
        assert_eq!(count(&one, "windows"), count(&many, "windows"));
        assert_eq!(count(&one, "frames"), count(&one, "windows"));
        assert!(count(&many, "frames") > count(&one, "frames"), "{many}");
        let rows = rows(&folder, "many.eecvs");
        assert!(rows.iter().all(|row| count(row, "bytes") <= 1208));
        let sum: u64 = rows.iter().map(|row| count(row, "events")).sum();
        assert_eq!(sum, count(&one, "events_encoded"));
        for (index, row) in rows.iter().enumerate() {
            assert_eq!(count(row, "seq"), index as u64);
        }
        for name in ["one", "many"] {
            let line = format!("decode {name}.eecvs -o {name}.csv --volume {name}.npy --window 3");
            folder.eecvs(&line).ok();
        }
        assert!(
            folder.bytes("one.csv") == folder.bytes("many.csv"),
            "{transform}"
        );
        assert!(
            folder.bytes("one.npy") == folder.bytes("many.npy"),
            "{transform}"
        );
    }
}

#[test]
fn a_damaged_file_gives_everything_that_is_whole() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    let frames = folder.frames("a.eecvs");
    let rows = rows(&folder, "a.eecvs");
    let (all, third) = (
        folder.pixels("scene.raw").len() as u64,
        count(&rows[2], "events"),
    );
    let n = frames.len() as u64;
    let mut flipped = frames.clone();
    let middle = flipped[2].len() / 2;
    flipped[2][middle] ^= 0x10;
    let mut header = frames.clone();
    header[2][6] ^= 0x80;
    let mut cut = frames.clone();
    cut.remove(2);
    let mut twice = frames.clone();
    twice.insert(3, frames[2].clone());
    let mut swapped = frames.clone();
    swapped.swap(2, 3);
    let mut noise = frames.clone();
    noise[2] = vec![0xEE; 100];
    let len = frames[2].len() as u64;
    // What the summary says of events, frames, damaged bytes and runs, frames lost, repeated and
    // reordered.
    for (name, frames, expected) in [
        ("whole", frames.clone(), [all, n, 0, 0, 0, 0, 0]),
        ("flipped", flipped, [all - third, n - 1, len, 1, 1, 0, 0]),
        ("header", header, [all - third, n - 1, len, 1, 1, 0, 0]),
        ("cut", cut, [all - third, n - 1, 0, 0, 1, 0, 0]),
        ("twice", twice, [all, n, 0, 0, 0, 1, 0]),
        ("swapped", swapped, [all, n, 0, 0, 0, 0, 1]),
        ("noise", noise, [all - third, n - 1, 100, 1, 1, 0, 0]),
    ] {
        folder.write("damaged.eecvs", frames.concat());
        for extension in ["csv", "raw", "aedat4"] {
            let line = format!("decode damaged.eecvs -o b.{extension} --json");
            let outcome = folder.eecvs(&line);
            let outcome = match name {
                "whole" => outcome.ok(),
                "twice" | "swapped" => outcome.warns(&["damaged.eecvs"]),
                _ => outcome.loses(&["damaged.eecvs"]),
            };
            let summary = outcome.object();
            for (key, value) in [
                "events",
                "frames",
                "damaged_bytes",
                "damaged_runs",
                "frames_lost",
                "frames_repeated",
                "frames_reordered",
            ]
            .iter()
            .zip(expected)
            {
                assert_eq!(count(&summary, key), value, "{name} {key}: {summary}");
            }
            let decoded = folder.pixels(&format!("b.{extension}"));
            assert_eq!(decoded.len() as u64, expected[0], "{name}");
        }
        let outcome = folder.eecvs("inspect damaged.eecvs --json");
        let outcome = match name {
            "whole" | "twice" | "swapped" => outcome,
            _ => outcome.loses(&["damaged.eecvs"]),
        };
        assert_eq!(outcome.array().len() as u64, expected[1], "{name}");
    }
}

#[test]
fn windows_are_numbered_as_decode_counts_them_where_their_first_frame_is_lost() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform --frame-bytes 1208")
        .ok();
    let mut frames = folder.frames("a.eecvs");
    let third = rows(&folder, "a.eecvs")
        .iter()
        .position(|row| count(row, "window") == 2)
        .unwrap();
    frames.remove(third);
    folder.write("lost.eecvs", frames.concat());
    let rows = folder.eecvs("inspect lost.eecvs --json");
    let rows = rows.loses(&["frames lost: 1"]).array();
    let orphan = &rows[third];
    assert_eq!((count(orphan, "window"), count(orphan, "part")), (2, 1));
    for window in 0..=count(&rows[rows.len() - 1], "window") {
        let of_window = |row: &&Value| count(row, "window") == window;
        let pixels: u64 = rows
            .iter()
            .filter(of_window)
            .map(|row| count(row, "pixels"))
            .sum();
        let line = format!("decode lost.eecvs --volume v.npy --window {window} --bins 4096");
        folder.eecvs(&line).loses(&["lost.eecvs", "frames lost: 1"]);
        let (shape, values) = folder.npy("v.npy");
        let plane = shape[1] * shape[2];
        let active = (0..plane)
            .filter(|pixel| values.iter().skip(*pixel).step_by(plane).any(|v| *v != 0.0))
            .count();
        assert_eq!(active as u64, pixels, "window {window}");
    }
}

#[test]
fn files_put_together_decode_whole() {
    let folder = Folder::new();
    folder.scene("one.csv");
    folder
        .eecvs("emulate motorcycle -o two.csv --seed 2 --width 40 --height 30 --duration-us 150000")
        .ok();
    // More frames than a reader remembers, then as many or fewer; at the same time and later.
    for (one, two) in [(1000, 32_768), (32_768, 1000), (32_768, 32_768)] {
        for (name, window_us) in [("one", one), ("two", two)] {
            folder
                .eecvs(&format!(
                    "encode {name}.csv -o {name}.eecvs --window-us {window_us}"
                ))
                .ok();
        }
        let (a, b) = (folder.bytes("one.eecvs"), folder.bytes("two.eecvs"));
        folder.write("both.eecvs", [a.clone(), b].concat());
        let outcome = folder.eecvs("decode both.eecvs -o both.csv --json");
        let summary = outcome.object();
        outcome.warns(&["both.eecvs", "numbering: 1"]);
        assert_eq!(count(&summary, "restarts"), 1);
        assert_eq!(count(&summary, "frames_repeated"), 0, "{summary}");
        assert_eq!(count(&summary, "frames_lost"), 0, "{summary}");
        let mut expected = folder.pixels("one.csv");
        expected.extend(folder.pixels("two.csv"));
        expected.sort_unstable();
        assert_eq!(folder.pixels("both.csv"), expected, "{one} {two}");
    }
    // A segment of a file may come twice; the same frames once more in a stream are no new ones.
    let a = folder.bytes("one.eecvs");
    folder.write("copies.eecvs", [a.clone(), a].concat());
    let summary = folder.eecvs("decode copies.eecvs -o b.csv --json").object();
    assert_eq!(count(&summary, "restarts"), 1);
    assert_eq!(count(&summary, "frames_repeated"), 0);
    assert_eq!(
        folder.pixels("b.csv").len(),
        2 * folder.pixels("one.csv").len()
    );
    let a = folder.frames("one.eecvs").concat();
    folder.write("twice.eecvs", [a.clone(), a].concat());
    let summary = folder.eecvs("decode twice.eecvs -o b.csv --json").object();
    assert_eq!(count(&summary, "restarts"), 0);
    assert_eq!(
        count(&summary, "frames_repeated"),
        count(&summary, "frames")
    );
    assert_eq!(folder.pixels("b.csv"), folder.pixels("one.csv"));
}

#[test]
fn a_truncated_file_gives_its_whole_frames() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    let bytes = folder.bytes("a.eecvs");
    let (places, frames) = folder.places("a.eecvs");
    let rows = rows(&folder, "a.eecvs");
    let two = places[2];
    for end in [two + 1, two + 2, two + 5, two + 40, places[3] - 1] {
        folder.write("cut.eecvs", &bytes[..end]);
        let outcome = folder.eecvs("decode cut.eecvs -o b.csv --json");
        let outcome = outcome.loses(&["cut.eecvs", &format!("byte {two}")]);
        let summary = outcome.object();
        assert_eq!(count(&summary, "frames"), 2);
        assert_eq!(count(&summary, "damaged_bytes"), (end - two) as u64);
        let events = count(&rows[0], "events") + count(&rows[1], "events");
        assert_eq!(count(&summary, "events"), events);
        assert_eq!(folder.pixels("b.csv").len() as u64, events);
        folder.eecvs("inspect cut.eecvs").loses(&["cut.eecvs"]);
    }
    folder.write("cut.eecvs", &bytes[..BEGIN.len() + frames[0].len() - 1]);
    folder
        .eecvs("decode cut.eecvs -o none.csv")
        .fails(&["cut.eecvs"]);
    folder
        .eecvs("inspect cut.eecvs --json")
        .fails(&["cut.eecvs"]);
}

#[test]
fn odd_sizes_and_settings_keep_every_event() {
    let folder = Folder::new();
    folder.write("one.txt", "# t x y p\n5 0 0 1\n9 0 0 0\n9 0 0 0\n");
    folder.write("size.csv", "t,x,y,p\n1000000,7,3,1\n1000001,0,0,0\n");
    folder
        .eecvs("emulate motorcycle -o tiny.raw --width 1 --height 1 --duration-us 100000")
        .ok();
    for (input, size) in [
        ("one.txt", (1, 1)),
        ("size.csv", (8, 4)),
        ("tiny.raw", (1, 1)),
    ] {
        let info = folder.eecvs(&format!("info {input} --json")).ok().object();
        assert_eq!((count(&info, "width"), count(&info, "height")), size);
        for flags in [
            "--window-us 4294967295",
            "--window-us 1",
            "-m 64 --grid 1024 --transform dtft",
            "-m 64 --grid 1000 --transform dwt",
            "-m 1 --grid 1",
            "--step-log2 8",
            "--step-log2 -15",
        ] {
            folder
                .eecvs(&format!("encode {input} -o a.eecvs {flags}"))
                .ok();
            folder.eecvs("decode a.eecvs -o b.npz").ok();
            assert_eq!(
                folder.pixels("b.npz"),
                folder.pixels(input),
                "{input} {flags}"
            );
        }
    }
    // A window of 1 us leaves no doubt about the time.
    folder
        .eecvs("encode tiny.raw -o a.eecvs --window-us 1")
        .ok();
    folder.eecvs("decode a.eecvs -o b.raw").ok();
    let same = folder.eecvs("compare tiny.raw b.raw --json").ok().object();
    assert_eq!(same["exact_fraction"], 1.0);
    // A size on the command line is that of the frames.
    folder
        .eecvs("encode size.csv -o a.eecvs --width 20 --height 10")
        .ok();
    folder.eecvs("decode a.eecvs --volume v.npy").ok();
    assert_eq!(folder.npy("v.npy").0[1..], [10, 20]);
}

#[test]
fn a_recording_without_events_is_one_all_the_way() {
    let folder = Folder::new();
    let is_empty = |file: &str| {
        let info = folder.eecvs(&format!("info {file} --json")).ok().object();
        assert_eq!(count(&info, "events"), 0, "{file}");
        let size = (count(&info, "width"), count(&info, "height"));
        assert_eq!(size, (40, 30), "{file}");
    };
    folder
        .eecvs("emulate motorcycle -o none.raw --width 40 --height 30 --duration-us 0")
        .ok();
    for flags in [
        "",
        "--coder dense --threads 2",
        "--coder dense --keep-order",
        "--bytes-per-second 100000",
        "--every-window --origin-us 7",
        "--mode transform",
        "--mode transform --coder dense",
        "--window-us 1",
        "--region 1,1,2,2",
    ] {
        let line = format!("encode none.raw -o none.eecvs {flags} --json");
        let summary = folder.eecvs(&line).ok().object();
        assert_eq!(count(&summary, "frames"), 1, "{flags}");
        assert_eq!(
            count(&summary, "bytes_out"),
            folder.bytes("none.eecvs").len() as u64
        );
        let rows = folder.eecvs("inspect none.eecvs --json").ok().array();
        assert_eq!(total(&rows, "events"), 0);
        is_empty("none.eecvs");
        let decoded = folder.eecvs("decode none.eecvs -o decoded.raw --json").ok();
        assert_eq!(count(&decoded.object(), "events"), 0, "{flags}");
        is_empty("decoded.raw");
        let same = folder
            .eecvs("compare none.raw decoded.raw --json")
            .ok()
            .object();
        assert_eq!(number(&same, "exact_fraction"), 1.0, "{flags}");
        folder.eecvs("compare none.eecvs none.raw").ok();
        folder.eecvs("convert none.eecvs converted.raw").ok();
        is_empty("converted.raw");
        // Frames are taken wherever a recording is.
        folder.eecvs("encode none.eecvs -o again.eecvs").ok();
        is_empty("again.eecvs");
    }
    // In every format that is written, of a sensor that each of them knows.
    folder
        .eecvs("emulate motorcycle -o none.raw --width 128 --height 128 --duration-us 0")
        .ok();
    for format in event_files::FORMATS
        .iter()
        .filter(|format| format.create.is_some())
    {
        let [name, copy] = ["none", "copy"].map(|stem| format!("{stem}{}", format.endings[0]));
        if name != "none.raw" {
            folder.eecvs(&format!("convert none.raw {name}")).ok();
        }
        // Arrays of .npy have no size, and N-MNIST is of one sensor alone.
        let (flags, side) = match format.name {
            "npy" => ("--width 128 --height 128", 128),
            "nmnist" => ("", 34),
            _ => ("", 128),
        };
        let is_empty = |file: &str| {
            let info = folder.eecvs(&format!("info {file} {flags} --json"));
            let info = info.ok().object();
            let found = ["events", "width", "height"].map(|key| count(&info, key));
            assert_eq!(found, [0, side, side], "{file}");
        };
        is_empty(&name);
        folder
            .eecvs(&format!("encode {name} -o made.eecvs {flags}"))
            .ok();
        folder.eecvs(&format!("decode made.eecvs -o {copy}")).ok();
        is_empty(&copy);
        folder.eecvs(&format!("compare {name} {copy} {flags}")).ok();
    }
    // A window of no file is none.
    folder
        .eecvs("decode none.eecvs --volume v.npy")
        .fails(&["none.eecvs", "no window 0"]);
}

#[test]
fn the_demo_writes_pictures_and_a_report() {
    let folder = Folder::new();
    let said = folder
        .eecvs("demo -o results/new --scene indoor-dark-hdr")
        .ok()
        .stdout;
    assert!(said.contains("report.html"), "{said}");
    let mut kinds = [0; 2];
    let report = String::from_utf8(folder.bytes("results/new/report.html")).unwrap();
    for entry in std::fs::read_dir(folder.path("results/new")).unwrap() {
        let path = entry.unwrap().path();
        let bytes = std::fs::read(&path).unwrap();
        let name = path.file_name().unwrap().to_str().unwrap();
        if name.ends_with(".png") {
            kinds[0] += 1;
            let decoder = png::Decoder::new(std::io::Cursor::new(&bytes));
            let mut reader = decoder.read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            let first = pixels[0];
            assert!(
                pixels.iter().any(|value| *value != first),
                "{name} is empty"
            );
        } else if name.ends_with(".svg") {
            kinds[1] += 1;
            let svg = String::from_utf8(bytes).unwrap();
            roxmltree::Document::parse(&svg).unwrap();
        } else {
            assert!(!bytes.is_empty(), "{name}");
            continue;
        }
        assert!(report.contains(name), "{name} is not in the report");
        assert!(said.contains(name), "{name} is not named");
    }
    assert_eq!(kinds, [3, 2], "a picture of each regime, two charts");
    // What it left can be used further.
    for (name, flags) in [
        ("auto", "--mode transform"),
        ("fast", ""),
        ("dense", "--coder dense"),
    ] {
        let made = format!("results/new/{name}.eecvs");
        folder.eecvs(&format!("inspect {made}")).ok();
        let encode = "encode results/new/scene.raw -o b.eecvs --thresholds";
        folder
            .eecvs(&format!("{encode} results/new/thresholds.toml {flags}"))
            .ok();
        assert!(folder.bytes("b.eecvs") == folder.bytes(&made), "{name}");
    }
}

/// Pixels whose times are more work than is allowed have all of their events, and are counted and named.
#[test]
fn work_beyond_the_limit_is_told() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform")
        .ok();
    let key = "pixels_over_work_limit";
    let decode = "decode a.eecvs -o b.raw --json";
    assert_eq!(count(&folder.eecvs(decode).ok().object(), key), 0);
    let told = ["a.eecvs", "rough", "--max-work-per-window"];
    for finder in ["exact", "peaks"] {
        let limited = format!("{decode} --events {finder} --max-work-per-window 1");
        let summary = folder.eecvs(&limited).warns(&told).object();
        assert!(count(&summary, key) > 0, "{finder}");
        assert!(count(&summary, key) <= count(&summary, "pixels_approximate"));
        assert_eq!(folder.pixels("b.raw"), folder.pixels("scene.raw"));
    }
    let volume = "decode a.eecvs --volume v.npy --bins 4 --voxel bilinear --json";
    let limited = format!("{volume} --max-work-per-window 0");
    let summary = folder.eecvs(&limited).warns(&told).object();
    assert!(count(&summary, key) > 0);
    // Readers of recordings count them among what a recording lacks.
    let convert = "convert a.eecvs c.raw --max-work-per-window 0";
    let told = folder.eecvs(convert);
    assert!(
        format!("{told}").contains("--max-work-per-window"),
        "{told}"
    );
    assert_eq!(folder.pixels("c.raw"), folder.pixels("scene.raw"));
}

/// A pixel that sends ten events a microsecond is no sensor's.
#[test]
fn windows_of_more_events_than_a_sensor_sends_are_read_if_asked_for() {
    let folder = Folder::new();
    let events = 70_000;
    let mut text = "t,x,y,p\n".to_owned();
    for number in 0..events {
        text += &format!("{},3,2,1\n", number / 10);
    }
    folder.write("close.csv", text);
    let size = "--width 8 --height 6";
    for mode in ["hybrid", "transform"] {
        let encode = format!("encode close.csv -o a.eecvs --overwrite --mode {mode} {size}");
        folder.eecvs(&encode).ok();
        let decode = "decode a.eecvs -o b.csv --overwrite --events peaks --json";
        let summary = folder
            .eecvs(decode)
            .loses(&["a.eecvs", "--max-events-per-window"])
            .object();
        assert_eq!(count(&summary, "frames_crowded"), 1, "{mode}");
        let allowed = format!("--max-events-per-window {events}");
        let summary = folder.eecvs(&format!("{decode} {allowed}")).ok().object();
        assert_eq!(count(&summary, "events"), events, "{mode}");
    }
    folder
        .eecvs(&format!("encode close.csv -o a.eecvs --overwrite {size}"))
        .ok();
    let convert = "convert a.eecvs c.csv --json";
    folder
        .eecvs(convert)
        .fails(&["a.eecvs", "--max-events-per-window"]);
    let allowed = format!("{convert} --max-events-per-window {events} --overwrite");
    let converted = folder.eecvs(&allowed).ok().object();
    assert_eq!(count(&converted, "events_out"), events);
}
