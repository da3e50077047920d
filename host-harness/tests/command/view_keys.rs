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
    /// Runs `eecvs view` with these arguments.
    fn new(folder: &Folder, line: &str) -> Self {
        Self::of_shell(folder, &view(line))
    }

    /// Runs a line of a shell.
    fn of_shell(folder: &Folder, line: &str) -> Self {
        let mut script = Command::new("script");
        script.args([
            "--quiet",
            "--flush",
            "--return",
            "--command",
            line,
            "/dev/null",
        ]);
        script
            .current_dir(folder.path(""))
            .env("TERM", "xterm-256color")
            .env("SHELL", "/bin/sh");
        script.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = script.spawn().expect("script");
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
        Self { child, keys, shown }
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

impl Drop for Terminal {
    fn drop(&mut self) {
        // Its terminal goes with it, and what runs there.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A line of a shell that runs `eecvs view`, without colours.
fn view(line: &str) -> String {
    let eecvs = env!("CARGO_BIN_EXE_eecvs");
    format!("{eecvs} view {line} --colours none --terminal-columns 200")
}

/// Whether there is the `script` whose options are used here.
fn has_script() -> bool {
    let version = Command::new("script").arg("--version").output();
    let is_known =
        version.is_ok_and(|output| output.stdout.windows(10).any(|part| part == b"util-linux"));
    if !is_known {
        println!("skipped: there is no `script` of util-linux");
    }
    is_known
}

#[test]
fn keys_pause_step_and_go_to_another_time() {
    if !has_script() {
        return;
    }
    let folder = Folder::new();
    folder
        .eecvs("emulate motorcycle -o a.raw --width 40 --height 30 --duration-us 3000000")
        .ok();
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    for files in ["a.raw", "a.eecvs", "a.eecvs a.raw"] {
        let line = format!("{files} --slice-us 5000 --fps 10");
        let mut terminal = Terminal::new(&folder, &line);
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
        terminal.press("\x1b[D");
        let again = terminal.until(|time, line| time < back && paused(time, line));
        assert!(again >= back - 51.0, "{files}: from {back} to {again}");
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
fn a_way_back_crosses_a_stretch_without_events() {
    if !has_script() {
        return;
    }
    let folder = Folder::new();
    // Two short bursts, ten seconds apart.
    let burst =
        |from_us: u64| (0..100).map(move |i| format!("{},{},1,1\n", from_us + i * 1000, i % 20));
    let lines: String = burst(0).chain(burst(10_000_000)).collect();
    folder.write("a.csv", format!("t,x,y,p\n{lines}"));
    folder
        .eecvs("convert a.csv a.raw --width 20 --height 2")
        .ok();
    let line = "a.raw --slice-us 5000 --fps 1";
    let mut terminal = Terminal::new(&folder, line);
    terminal.until(|time, _| time >= 0.0);
    terminal.press(" \x1b[A");
    for _ in 0..2_000 / 10 {
        let at = terminal.until(|_, line| line.contains("paused"));
        if at >= 10_000.0 {
            break;
        }
        terminal.press("\x1b[A");
    }
    terminal.press("\x1b[D");
    let back = terminal.until(|time, line| time < 10_000.0 && line.contains("paused"));
    assert!(back < 100.0, "{back}");
    terminal.press("q");
    assert!(terminal.end().success());
}

#[test]
fn the_terminal_is_as_before_at_the_end() {
    if !has_script() {
        return;
    }
    let folder = Folder::new();
    folder.scene("a.raw");
    let (slow, quick) = (
        view("a.raw --slice-us 1000 --fps 10"),
        view("a.raw --slice-us 50000 --fps 30"),
    );
    // To its own end; by a key; by Ctrl-C, which is a signal.
    for (command, keys) in [(&quick, ""), (&slow, "q"), (&slow, "\x03")] {
        // Ctrl-C reaches the shell too, which goes on: that of some systems would end with the command's signal.
        let shell =
            format!("trap : INT; stty -a > before; {command}; echo $? > status; stty -a > after");
        let mut terminal = Terminal::of_shell(&folder, &shell);
        if !keys.is_empty() {
            terminal.until(|time, _| time >= 0.0);
            terminal.press(keys);
        }
        let status = terminal.end();
        assert!(status.success(), "{status}");
        assert_eq!(folder.bytes("status"), b"0\n", "{keys:?}");
        let before = folder.bytes("before");
        assert!(before.starts_with(b"speed"), "{before:?}");
        assert!(before == folder.bytes("after"), "{keys:?}");
    }
}
