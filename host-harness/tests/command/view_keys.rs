//! Keys while frames play in a terminal: `script` gives the command one.

use std::io::{Read, Write};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::Folder;

/// A command in a terminal.
struct Terminal {
    child: Child,
    keys: ChildStdin,
    shown: Arc<Mutex<String>>,
}

impl Terminal {
    /// `None` where there is no `script`.
    fn new(folder: &Folder, line: &str) -> Option<Self> {
        let command = format!("{} {line}", env!("CARGO_BIN_EXE_eecvs"));
        let mut script = Command::new("script");
        script.args([
            "--quiet",
            "--flush",
            "--return",
            "--command",
            &command,
            "/dev/null",
        ]);
        script
            .current_dir(folder.path(""))
            .env("TERM", "xterm-256color");
        let mut child = script
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .ok()?;
        let keys = child.stdin.take().expect("a pipe");
        let mut output = child.stdout.take().expect("a pipe");
        let shown = Arc::new(Mutex::new(String::new()));
        let sink = Arc::clone(&shown);
        std::thread::spawn(move || {
            let mut room = [0; 4096];
            while let Ok(count @ 1..) = output.read(&mut room) {
                let text = String::from_utf8_lossy(&room[..count]).into_owned();
                sink.lock().expect("no panic").push_str(&text);
            }
        });
        Some(Self { child, keys, shown })
    }

    fn press(&mut self, keys: &str) {
        self.shown.lock().expect("no panic").clear();
        self.keys.write_all(keys.as_bytes()).expect("a pipe");
        self.keys.flush().expect("a pipe");
    }

    /// Waits until a frame is shown whose time, in ms, and line are as wanted, and returns the time.
    fn until(&self, is_wanted: impl Fn(f64, &str) -> bool) -> f64 {
        let end = Instant::now() + Duration::from_secs(60);
        loop {
            let text = self.shown.lock().expect("no panic").clone();
            let said = text.split(['\x1b', '\r', '\n']).rev().find_map(|line| {
                // Of a line that is cleared first, the rest of that.
                let line = line.rsplit_once('K').map_or(line, |(_, rest)| rest);
                let (time, _) = line.split_once(" ms  events ")?;
                let time = time.rsplit(['m', 'K']).next()?.trim().parse().ok()?;
                is_wanted(time, line).then_some(time)
            });
            if let Some(time) = said {
                return time;
            }
            assert!(Instant::now() < end, "{text:?}");
            sleep(Duration::from_millis(10));
        }
    }

    fn end(mut self) -> ExitStatus {
        self.child.wait().expect("a child")
    }
}

#[test]
fn keys_pause_step_and_go_to_another_time() {
    let folder = Folder::new();
    folder
        .eecvs("emulate motorcycle -o a.raw --width 40 --height 30 --duration-us 3000000")
        .ok();
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    for files in ["a.raw", "a.eecvs", "a.eecvs a.raw"] {
        let line =
            format!("view {files} --slice-us 5000 --fps 10 --colours none --terminal-columns 200");
        let Some(mut terminal) = Terminal::new(&folder, &line) else {
            println!("skipped: there is no `script`");
            return;
        };
        terminal.until(|time, _| time > 5.0);
        terminal.press(" ");
        let paused = |_: f64, line: &str| line.contains("paused: space");
        let at = terminal.until(paused);
        terminal.press(".");
        let stepped = terminal.until(|time, line| time > at && paused(time, line));
        assert!(stepped < at + 51.0, "{files}: from {at} to {stepped}");
        // Ten seconds of playback are 100 slices, half a second.
        terminal.press("\x1b[A");
        let far = terminal.until(|time, line| time >= stepped + 500.0 && paused(time, line));
        assert!(far < stepped + 700.0, "{files}: from {stepped} to {far}");
        terminal.press("\x1b[D");
        let back = terminal.until(|time, line| time < far && paused(time, line));
        assert!(back >= far - 51.0, "{files}: from {far} to {back}");
        terminal.press("\x1b[H");
        let start = terminal.until(|time, _| time < 5.0);
        assert!(start >= 0.0, "{start}");
        // On again, and beyond the end: it ends there.
        terminal.press(" ");
        terminal.until(|time, line| time > start && !paused(time, line));
        terminal.press("\x1b[6~\x1b[5~q");
        let status = terminal.end();
        assert!(status.success(), "{files}: {status}");
    }
}

#[test]
fn the_terminal_is_as_before_at_the_end() {
    let folder = Folder::new();
    folder.scene("a.raw");
    let eecvs = env!("CARGO_BIN_EXE_eecvs");
    // A pipe's end ends nothing: the recording plays to its own.
    let shell =
        format!("stty -a > before; {eecvs} view a.raw --slice-us 50000 --fps 30; stty -a > after");
    let mut script = Command::new("script");
    script.args(["--quiet", "--command", &shell, "/dev/null"]);
    script
        .current_dir(folder.path(""))
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    let Ok(status) = script.env("TERM", "xterm-256color").status() else {
        println!("skipped: there is no `script`");
        return;
    };
    assert!(status.success(), "{status}");
    let before = folder.bytes("before");
    assert!(
        before.starts_with(b"speed"),
        "{}",
        String::from_utf8_lossy(&before)
    );
    assert!(before == folder.bytes("after"));
}
