//! Playing from the command line: to GIF, to PNG, as text, and what is refused.

use crate::support::{Folder, count, exists};

/// Width, height and frames of a GIF.
fn gif(folder: &Folder, name: &str) -> (u16, u16, u64) {
    let bytes = folder.bytes(name);
    let mut decoder = gif::DecodeOptions::new()
        .read_info(std::io::Cursor::new(bytes))
        .unwrap();
    let mut frames = 0;
    while decoder.read_next_frame().unwrap().is_some() {
        frames += 1;
    }
    (decoder.width(), decoder.height(), frames)
}

#[test]
fn a_recording_and_its_frames_play_beside_each_other() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder.eecvs("encode a.raw -o b.eecvs").ok();
    let made = folder
        .eecvs("view a.raw b.eecvs -o c.gif --slice-us 5000 --upscale 2 --json")
        .ok()
        .object();
    let events = folder.events("a.raw").1;
    let first = events.first().unwrap().t_us;
    let last = events.last().unwrap().t_us;
    let (width, _, frames) = gif(&folder, "c.gif");
    assert_eq!(frames, (last - first) / 5000 + 1);
    assert_eq!(count(&made, "frames"), frames);
    assert_eq!(count(&made, "from_us"), first);
    assert_eq!(count(&made, "events"), events.len() as u64);
    // Lossless frames hold the same events at the same times.
    assert_eq!(count(&made, "decoded_events"), events.len() as u64);
    assert!(width > 3 * 80);
    // Alone, and a part; what was there is written over.
    folder
        .eecvs("view b.eecvs -o c.gif --slice-us 5000 --frames 7")
        .ok();
    assert_eq!(gif(&folder, "c.gif").2, 7);
    let to = first + 10_000;
    folder
        .eecvs(&format!("view a.raw -o c.gif --slice-us 1000 --to-us {to}"))
        .ok();
    assert_eq!(gif(&folder, "c.gif").2, 10);
}

#[test]
fn pictures_and_text() {
    let folder = Folder::new();
    folder.write("a.csv", "t,x,y,p\n1000,0,0,1\n1001,1,1,0\n9000,0,1,1\n");
    folder.eecvs("view a.csv -o one.png").ok();
    folder.eecvs("view a.csv -o all/ --slice-us 4000").ok();
    assert!(exists(&folder.path("all/frame_000002.png")));
    assert!(!exists(&folder.path("all/frame_000003.png")));
    let first = folder.bytes("all/frame_000000.png");
    assert!(first.starts_with(b"\x89PNG"));
    let text = folder
        .eecvs("view a.csv --colours 24bit --terminal-columns 40 --slice-us 4000")
        .ok()
        .stdout;
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 3 * 2);
    assert_eq!(
        lines[0],
        "\x1b[38;2;86;160;224m\x1b[48;2;255;255;255m\u{2580}\
         \x1b[38;2;255;255;255m\x1b[48;2;245;155;66m\u{2580}\x1b[0m"
    );
    assert_eq!(lines[1], "0.000 ms  events 2");
    assert_eq!(lines[3], "4.000 ms  events 0");
    assert_eq!(lines[5], "8.000 ms  events 1");
}

#[test]
fn colours_are_those_that_the_terminal_has() {
    let folder = Folder::new();
    folder.write("a.csv", "t,x,y,p\n1000,0,0,1\n1001,1,1,0\n");
    let shown = |variables: &[(&str, &str)]| {
        let line = ["view", "a.csv", "--terminal-columns", "40", "--frames", "1"];
        let mut command = folder.command(&line);
        for name in ["NO_COLOR", "COLORTERM", "TERM"] {
            command.env_remove(name);
        }
        let output = command.envs(variables.iter().copied()).output().unwrap();
        assert!(output.status.success());
        String::from_utf8(output.stdout).unwrap()
    };
    let bits = shown(&[("TERM", "xterm-256color"), ("COLORTERM", "truecolor")]);
    assert!(bits.contains("\x1b[38;2;86;160;224m"), "{bits}");
    let few = shown(&[("TERM", "xterm-256color")]);
    assert!(
        few.contains("\x1b[38;5;74m") && !few.contains(";2;"),
        "{few}"
    );
    for variables in [
        &[
            ("TERM", "xterm-256color"),
            ("COLORTERM", "truecolor"),
            ("NO_COLOR", "1"),
        ][..],
        &[("TERM", "dumb"), ("COLORTERM", "truecolor")],
        &[],
    ] {
        let plain = shown(variables);
        assert!(!plain.contains('\x1b'), "{plain}");
        assert!(plain.starts_with("+-\n"), "{plain}");
    }
}

#[test]
fn a_jump_of_hours_makes_no_endless_file() {
    let folder = Folder::new();
    folder.write("a.csv", "t,x,y,p\n0,0,0,1\n36000000000,1,1,0\n");
    let made = folder
        .eecvs("view a.csv -o a.gif --fps 10 --slice-us 1000 --json")
        .ok()
        .object();
    assert_eq!(gif(&folder, "a.gif").2, 12);
    assert_eq!(count(&made, "frames"), 12);
    assert_eq!(count(&made, "skipped_us"), 36_000_000_000 - 11_000);
}

#[test]
fn what_cannot_be_played_is_told_in_a_line() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder.eecvs("encode a.raw -o b.eecvs").ok();
    folder.eecvs("view a.raw").fails(&["a.raw", "-o"]);
    folder.eecvs("view none.raw -o a.gif").fails(&["none.raw"]);
    folder
        .eecvs("view a.raw none.raw -o a.gif")
        .fails(&["none.raw"]);
    folder
        .eecvs("view a.raw -o a.mp4")
        .fails(&["a.mp4", ".gif"]);
    folder
        .eecvs("view a.raw -o a.gif --fps 60")
        .fails(&["a.gif", "50"]);
    folder
        .eecvs("view a.raw -o a.raw")
        .fails(&["a.raw", "same file"]);
    folder.write("junk.eecvs", [7; 5000]);
    folder
        .eecvs("view junk.eecvs -o a.gif")
        .fails(&["junk.eecvs"]);
    folder
        .eecvs("view a.raw -o a.gif --to-us 1")
        .fails(&["a.raw", "no events"]);
    assert!(!exists(&folder.path("a.gif")));
    // Damage: what came before it is shown, and it is told.
    let mut bytes = folder.bytes("b.eecvs");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    folder.write("damaged.eecvs", &bytes);
    folder
        .eecvs("view damaged.eecvs --terminal-columns 20")
        .loses(&["damaged.eecvs", "damaged bytes"]);
    // Other times, as of another clock.
    folder.write("later.csv", "t,x,y,p\n900000000,0,0,1\n");
    folder
        .eecvs("view a.raw later.csv --terminal-columns 20")
        .warns(&["later.csv", "clocks"]);
}
