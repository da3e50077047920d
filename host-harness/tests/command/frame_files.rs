//! `verify`, `index` and the times of `decode`, `convert` and `view`: what the marks of a file are for.

use eecvs_nostd::Event;
use serde_json::Value;

use crate::streams::piped;
use crate::support::{Folder, count};

/// A file with marks, and the same frames without them.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o whole.eecvs").ok();
    folder.write("stream.eecvs", folder.frames("whole.eecvs").concat());
    folder
}

#[test]
fn a_file_that_is_cut_or_has_no_marks_says_so() {
    let folder = folder();
    let whole = folder.bytes("whole.eecvs");
    folder.write("cut.eecvs", &whole[..whole.len() - 100]);
    for line in [
        "verify",
        "info",
        "decode -o out.csv",
        "inspect",
        "monitor",
        "convert out.csv",
        "split -o parts",
    ] {
        let (command, options) = line.split_once(' ').unwrap_or((line, ""));
        for (file, status) in [("whole", 0), ("stream", 0), ("cut", 1)] {
            let outcome = folder.eecvs(&format!("{command} {file}.eecvs {options}"));
            assert_eq!(
                outcome.status,
                Some(status),
                "{}: {}",
                outcome.line,
                outcome.stderr
            );
            let is_told = outcome.stderr.contains("without an end mark");
            assert_eq!(
                is_told,
                file == "cut",
                "{}: {}",
                outcome.line,
                outcome.stderr
            );
        }
    }
    let verified = |file: &str| -> Value {
        let outcome = folder.eecvs(&format!("verify {file}.eecvs --json"));
        serde_json::from_str(&outcome.stdout).expect("JSON")
    };
    for (file, ended, unmarked, cut_short) in
        [("whole", 1, 0, 0), ("stream", 0, 1, 0), ("cut", 0, 0, 1)]
    {
        let report = verified(file);
        assert_eq!(count(&report, "segments_ended"), ended, "{report}");
        assert_eq!(
            count(&report, "frames_unmarked").min(1),
            unmarked,
            "{report}"
        );
        assert_eq!(count(&report, "segments_cut_short"), cut_short, "{report}");
    }
    assert_eq!(verified("whole")["bytes"], whole.len());
    for (command, row) in [
        (
            "decode stream.eecvs -o out.csv",
            "frames without an end mark",
        ),
        ("info stream.eecvs", "frames without an end mark, used"),
        ("verify stream.eecvs", "without an end mark"),
    ] {
        assert!(folder.eecvs(command).ok().stdout.contains(row), "{command}");
    }
}

#[test]
fn an_index_is_added_once() {
    let folder = folder();
    let whole = folder.bytes("whole.eecvs");
    let stream = folder.bytes("stream.eecvs");
    let mark = folder.eecvs("index stream.eecvs --json").ok().object();
    let indexed = folder.bytes("stream.eecvs");
    assert!(indexed.starts_with(&stream));
    let appended = (indexed.len() - stream.len()) as u64;
    assert_eq!(count(&mark, "bytes_appended"), appended);
    let verified = folder.eecvs("verify stream.eecvs --json").ok().object();
    assert_eq!(count(&verified, "segments_ended"), 1);
    let again = folder.eecvs("index stream.eecvs --json").ok().object();
    assert_eq!(
        (count(&again, "bytes_appended"), &again["stretches"]),
        (0, &mark["stretches"])
    );
    let size = u32::from_le_bytes(whole[whole.len() - 8..whole.len() - 4].try_into().unwrap());
    // A mark that is cut off is replaced; everything else stays.
    let end = whole.len() - size as usize;
    for cut in [end, end + 2, end + 9, whole.len() - 1] {
        folder.write("cut.eecvs", &whole[..cut]);
        folder.eecvs("index cut.eecvs").ok();
        assert_eq!(folder.bytes("cut.eecvs"), whole, "{cut}");
    }
    folder.write("damaged.eecvs", [&whole[..end - 3], b"!!!"].concat());
    let outcome = folder.eecvs("index damaged.eecvs");
    assert_eq!(outcome.status, Some(1));
    assert!(folder.bytes("damaged.eecvs").starts_with(&whole[..end - 3]));
    assert!(
        outcome.stderr.contains("damaged bytes"),
        "{}",
        outcome.stderr
    );
    folder.write("text.eecvs", "not a frame");
    assert_eq!(folder.eecvs("index text.eecvs").status, Some(1));
    assert_eq!(folder.bytes("text.eecvs"), b"not a frame");
    assert_eq!(folder.eecvs("index none.eecvs").status, Some(1));
}

#[test]
fn times_are_those_of_the_recording_with_an_index_and_without() {
    let folder = folder();
    let all: Vec<Event> = folder.events("scene.raw").1;
    let (first, last) = (all[0].t_us, all[all.len() - 1].t_us);
    let third = (last - first) / 3;
    for (from, to) in [
        (first, last + 1),
        (first + third, first + 2 * third),
        (first + third, first + third + 1),
        (last + 10, last + 20),
        (0, first),
    ] {
        let wanted: Vec<Event> = all
            .iter()
            .copied()
            .filter(|event| (from..to).contains(&event.t_us))
            .collect();
        for file in ["whole", "stream"] {
            for line in [
                format!("convert {file}.eecvs part.raw --from-us {from} --to-us {to}"),
                format!("decode {file}.eecvs -o part.raw --from-us {from} --to-us {to}"),
            ] {
                folder.eecvs(&line).ok();
                assert_eq!(folder.events("part.raw").1.len(), wanted.len(), "{line}");
            }
        }
    }
    let bad = folder.eecvs("decode whole.eecvs -o part.csv --from-us 2 --to-us 1");
    assert_eq!(bad.status, Some(2));
    for file in ["whole", "stream"] {
        folder
            .eecvs(&format!(
                "view {file}.eecvs -o {file}.png --from-us {} --to-us {}",
                first + third,
                first + 2 * third
            ))
            .ok();
    }
    assert_eq!(folder.bytes("whole.png"), folder.bytes("stream.png"));
}

/// A pipe cannot be searched, and a clock that was set back has wanted times after others.
#[test]
fn times_are_found_in_pipes_and_behind_a_clock_that_falls_back() {
    let folder = folder();
    let whole = folder.bytes("whole.eecvs");
    let (outcome, part) = piped(&folder, "decode - -o - --format csv --to-us 20000", &whole);
    assert_eq!(outcome.status, Some(0), "{outcome}");
    folder
        .eecvs("decode whole.eecvs -o part.csv --to-us 20000")
        .ok();
    assert!(part == folder.bytes("part.csv"));
    folder.write(
        "runs.csv",
        "9000000,1,1,1\n9000001,2,2,0\n100,3,3,1\n200,39,29,1\n",
    );
    folder
        .eecvs("encode runs.csv -o runs.eecvs")
        .warns(&["2 runs"]);
    for file in ["runs.csv", "runs.eecvs"] {
        folder
            .eecvs(&format!("convert {file} part.raw --to-us 150"))
            .ok();
        assert_eq!(folder.events("part.raw").1.len(), 1, "{file}");
    }
    for line in ["index -", "index none/"] {
        assert_eq!(folder.eecvs(line).status, Some(1), "{line}");
    }
}
