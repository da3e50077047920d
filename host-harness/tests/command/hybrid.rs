//! The default mode, `hybrid`, from the command line.

use crate::support::{Folder, count, number};
use eecvs_nostd::Frame;
use serde_json::Value;

fn compared(folder: &Folder, a: &str, b: &str) -> Value {
    folder
        .eecvs(&format!("compare {a} {b} --json"))
        .ok()
        .object()
}

#[test]
fn a_recording_comes_back_as_exactly_as_was_asked() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for coder in ["fast", "dense"] {
        let encode = format!("encode scene.raw -o a.eecvs --coder {coder} --json");
        // Lossless where nothing else is said.
        for flags in ["", "--mode hybrid --time-tolerance-us 0"] {
            let summary = folder.eecvs(&format!("{encode} {flags}")).ok().object();
            assert_eq!(
                count(&summary, "events_in"),
                count(&summary, "events_encoded")
            );
            assert!(number(&summary, "bits_per_event") < 32.0);
            folder.eecvs("decode a.eecvs -o b.raw").ok();
            let compared = compared(&folder, "scene.raw", "b.raw");
            assert_eq!(number(&compared, "exact_fraction"), 1.0, "{coder} {flags}");
            assert_eq!(number(&compared, "emd_pixel_us"), 0.0);
        }
        let lossless = folder.bytes("a.eecvs").len();
        for (tolerance_us, most) in [(1, 1.0), (50, 50.0), (5000, 5000.0)] {
            folder
                .eecvs(&format!("{encode} --time-tolerance-us {tolerance_us}"))
                .ok();
            folder.eecvs("decode a.eecvs -o b.raw").ok();
            let compared = compared(&folder, "scene.raw", "b.raw");
            let off_us = number(&compared, "emd_pixel_us");
            assert!(off_us > 0.0 && off_us <= most, "{tolerance_us}: {off_us}");
            assert!(folder.bytes("a.eecvs").len() < lossless);
        }
        // Bins are exact as a volume: as many events of each polarity in every bin.
        folder.eecvs(&format!("{encode} --bins 8")).ok();
        folder.eecvs("decode a.eecvs -o b.raw").ok();
        let rows = folder.eecvs("inspect a.eecvs --json").ok().array();
        let bins = |name: &str| {
            let (_, events) = folder.events(name);
            let mut bins: Vec<_> = events
                .iter()
                .map(|event| {
                    let row = rows.iter().rfind(|row| count(row, "t0_us") <= event.t_us);
                    let row = row.expect("a window");
                    let offset_us = event.t_us - count(row, "t0_us");
                    let bin = offset_us * 8 / count(row, "duration_us");
                    (count(row, "t0_us"), bin, event.y, event.x, event.polarity)
                })
                .collect();
            bins.sort_unstable();
            bins
        };
        assert_eq!(bins("scene.raw"), bins("b.raw"));
        for row in &rows {
            assert_eq!(row["mode"], "hybrid");
            // Whole windows have a coder of their own.
            assert_eq!(row["coder"], if coder == "fast" { "keys" } else { coder });
            assert_eq!(
                (&row["bins"], &row["time_tolerance_us"]),
                (&8.into(), &Value::Null)
            );
            assert!(row["pixels"].is_null());
        }
        let keys = rows.iter().filter(|row| row["key"] == true).count();
        assert_eq!(keys == rows.len(), coder == "fast");
    }
}

#[test]
fn the_volume_is_the_same_in_both_modes() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for flags in [
        "",
        "--transform dtft -m 8",
        "--transform dwt -m 3 --grid 100",
    ] {
        for (mode, name) in [
            ("transform", "a"),
            ("hybrid --coder dense", "b"),
            ("transform --coder fast", "c"),
            ("transform --coder dense", "d"),
        ] {
            let encode = format!("encode scene.raw -o {name}.eecvs --mode {mode} {flags}");
            folder.eecvs(&encode).ok();
            let decode = format!("decode {name}.eecvs --volume {name}.npy --window 2");
            folder.eecvs(&decode).ok();
        }
        for other in ["b", "c", "d"] {
            let other = folder.bytes(&format!("{other}.npy"));
            assert!(folder.bytes("a.npy") == other, "{flags}");
        }
        let [plain, dense] = ["a", "d"].map(|name| folder.bytes(&format!("{name}.eecvs")).len());
        assert!(dense < plain, "{flags}: {dense} of {plain}");
        let rows = folder.eecvs("inspect d.eecvs --json").ok().array();
        for row in rows {
            assert_eq!(
                (&row["mode"], &row["coder"]),
                (&"transform".into(), &"dense".into())
            );
        }
    }
}

#[test]
fn a_chain_that_lost_a_frame_goes_on_at_the_next_key_and_says_so() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let encode = "encode scene.raw -o a.eecvs --coder dense --key-windows 3 --window-us 20000";
    folder.eecvs(encode).ok();
    let frames = folder.frames("a.eecvs");
    assert!(frames.len() > 6);
    let lost = [&frames[..1], &frames[2..]].concat();
    folder.write("lost.eecvs", lost.concat());
    let summary = folder
        .eecvs("decode lost.eecvs -o b.raw --json")
        .loses(&["lost.eecvs", "frames lost: 1", "depend on missing ones: 1"])
        .object();
    assert_eq!(count(&summary, "frames_dependent"), 1);
    assert_eq!(count(&summary, "windows"), frames.len() as u64 - 2);
}

#[test]
fn key_frames_are_spaced_by_time() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let encode = "encode scene.raw -o OUT --coder dense --window-us 20000";
    let encode = |out: &str, flags: &str| {
        folder
            .eecvs(&format!("{} {flags}", encode.replace("OUT", out)))
            .ok();
        folder.frames(out)
    };
    // As many whole windows as fit, one at the least.
    for (key_us, windows) in [(1, 1), (20_000, 1), (59_999, 2), (60_000, 3)] {
        let by_time = encode(&format!("{key_us}.eecvs"), &format!("--key-us {key_us}"));
        let by_count = encode(
            &format!("of-{key_us}.eecvs"),
            &format!("--key-windows {windows}"),
        );
        assert_eq!(by_time, by_count, "{key_us} us");
    }
    let auto = "encode scene.raw -o auto.eecvs --coder dense --auto-window --key-us 1 --json";
    let summary = folder.eecvs(auto).ok().object();
    assert!(count(&summary, "windows") > 1);
    for frame in folder.frames("auto.eecvs") {
        assert!(Frame::parse(&frame).expect("a frame").header.is_key);
    }
    for flags in ["--key-us 0", "--key-us 60000 --key-windows 3"] {
        let outcome = folder.eecvs(&format!("encode scene.raw -o no.eecvs {flags}"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
}

#[test]
fn what_does_not_go_together_is_refused() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for flags in [
        "--bins 8 --time-tolerance-us 5",
        "--bins 0",
        "--bins 65536",
        "--coder best",
        "--max-error 0.1 --step-log2 -6",
        "--key-windows 0",
        "--time-tolerance-us -1",
        "--region 1,2,3",
        "--region 1,2,0,3",
        "--bytes-per-second 0",
    ] {
        let outcome = folder.eecvs(&format!("encode scene.raw -o a.eecvs {flags}"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform --bins 8")
        .misused(&["--bins", "--mode hybrid"]);
    folder
        .eecvs("encode scene.raw -o a.eecvs --coder plain")
        .misused(&["--coder plain", "--mode transform"]);
    for flags in [
        "--bins 8",
        "--time-tolerance-us 5",
        "--isolated",
        "--bytes-per-second 100000",
    ] {
        folder
            .eecvs(&format!(
                "encode scene.raw -o a.eecvs --coder quick {flags}"
            ))
            .misused(&["--coder quick", "lossless"]);
    }
    folder
        .eecvs("encode scene.raw -o a.eecvs --coder quick --mode transform")
        .misused(&["--coder quick", "--mode hybrid"]);
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform --max-error 1e-5")
        .fails(&["--max-error 0.00001", "2^-16"]);
    folder
        .eecvs("encode scene.raw -o a.eecvs --bytes-per-second 100")
        .fails(&["budget", "too small", "headers"]);
    folder.write("hot.txt", "1;2");
    folder
        .eecvs("encode scene.raw -o a.eecvs --hot-pixels hot.txt")
        .fails(&["hot.txt: line 1", "x,y"]);
}

/// The duration that takes the fewest bytes, and everything comes back.
#[test]
fn the_duration_of_windows_is_chosen_where_that_is_asked_for() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let encode = |flags: &str| {
        let line = format!("encode scene.raw -o a.eecvs --json {flags}");
        let summary = folder.eecvs(&line).ok().object();
        (count(&summary, "window_us"), folder.bytes("a.eecvs").len())
    };
    for coder in ["fast", "dense", "dense --effort 1"] {
        let (default_us, default) = encode(&format!("--coder {coder}"));
        assert_eq!(default_us, 32_768);
        let (chosen_us, chosen) = encode(&format!("--coder {coder} --auto-window"));
        folder.eecvs("decode a.eecvs -o b.raw").ok();
        let compared = compared(&folder, "scene.raw", "b.raw");
        assert_eq!(number(&compared, "exact_fraction"), 1.0, "{coder}");
        assert!(chosen <= default, "{coder}: {chosen_us} us");
        assert_eq!(
            encode(&format!("--coder {coder} --window-us {chosen_us}")),
            (chosen_us, chosen)
        );
    }
    for flags in ["--mode transform", "--bins 8", "--bytes-per-second 100000"] {
        folder
            .eecvs(&format!(
                "encode scene.raw -o c.eecvs --auto-window {flags}"
            ))
            .misused(&["--auto-window", "--mode hybrid"]);
    }
    let both = folder.eecvs("encode scene.raw -o c.eecvs --auto-window --window-us 4096");
    assert_eq!(both.status, Some(2), "{both}");
}

/// What is filtered, left out or approximate is told on both sides.
#[test]
fn filters_and_budgets_are_accounted_for() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (_, events) = folder.events("scene.raw");
    let encoded = |flags: &str| {
        let encode = format!("encode scene.raw -o a.eecvs --json {flags}");
        let summary = folder.eecvs(&encode).ok().object();
        let decoded = folder.eecvs("decode a.eecvs -o b.raw --json").ok().object();
        for key in ["events_filtered", "events_thinned", "events_approximate"] {
            assert_eq!(count(&summary, key), count(&decoded, key), "{flags} {key}");
        }
        assert_eq!(count(&summary, "events_encoded"), count(&decoded, "events"));
        let (_, left) = folder.events("b.raw");
        (summary, left)
    };
    let (summary, left) = encoded("--region 3,2,10,9");
    let inside = |x: u16, y: u16| (3..13).contains(&x) && (2..11).contains(&y);
    let kept = events
        .iter()
        .filter(|event| inside(event.x, event.y))
        .count();
    assert_eq!(left.len(), kept);
    assert!(left.iter().all(|event| inside(event.x, event.y)));
    assert_eq!(
        count(&summary, "events_filtered") as usize,
        events.len() - kept
    );

    let hot = events[0];
    folder.write("hot.txt", format!("{},{}\n", hot.x, hot.y));
    let (_, left) = encoded("--hot-pixels hot.txt");
    assert!(
        left.iter()
            .all(|event| (event.x, event.y) != (hot.x, hot.y))
    );
    let at_hot = events
        .iter()
        .filter(|event| (event.x, event.y) == (hot.x, hot.y));
    assert_eq!(left.len(), events.len() - at_hot.count());

    let (summary, left) = encoded("--isolated");
    assert!(count(&summary, "events_filtered") > 0 && left.len() * 2 > events.len());

    let seconds = (events[events.len() - 1].t_us - events[0].t_us) as f64 / 1e6;
    for coder in ["fast", "dense"] {
        let budget = (events.len() as f64 / seconds.max(0.1)) as u64;
        let (summary, _) = encoded(&format!("--coder {coder} --bytes-per-second {budget}"));
        assert!(count(&summary, "events_approximate") > 0);
        assert!(count(&summary, "bytes_out") as f64 <= budget as f64 * (seconds + 1.0));
    }
}

/// The file is the recording, event by event; what keeps it so is told, and what cannot is refused.
#[test]
fn a_recording_comes_back_in_its_order() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (_, events) = folder.events("scene.raw");
    for coder in ["fast", "dense", "quick"] {
        let encode = format!("encode scene.raw -o a.eecvs --coder {coder} --keep-order --json");
        let summary = folder.eecvs(&encode).ok().object();
        assert_eq!(
            count(&summary, "windows_in_order"),
            count(&summary, "windows")
        );
        let decoded = folder.eecvs("decode a.eecvs -o b.csv --json").ok().object();
        assert_eq!(
            count(&decoded, "windows_in_order"),
            count(&summary, "windows")
        );
        assert_eq!(count(&decoded, "windows_order_lost"), 0);
        assert!(folder.events("b.csv").1 == events, "{coder}");
        if coder == "quick" {
            // The order takes no bytes of its own.
            assert_eq!(count(&summary, "bytes_order"), 0);
            continue;
        }
        let rows = folder.eecvs("inspect a.eecvs --json").ok().array();
        let bytes: u64 = rows.iter().map(|row| count(row, "order_bytes")).sum();
        assert_eq!(bytes, count(&summary, "bytes_order"));
    }
    let encode = "encode scene.raw -o a.eecvs --mode transform --keep-order";
    folder.eecvs(encode).misused(&["--keep-order"]);
}
