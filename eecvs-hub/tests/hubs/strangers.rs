//! The programs among connections that are silent, slow or strange: nobody is kept out, and every program ends soon after
//! a signal, whatever it waits for.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use crate::fleet::{self, Fleet, until};
use crate::programs::{Program, figures};

const SILENT: usize = 200;

/// Longer than any program takes where others use the machine; each of the waits below would take several seconds more,
/// or not end.
const SOON: Duration = Duration::from_millis(2500);

fn id(program: &Program) -> u32 {
    program.0.as_ref().unwrap().id()
}

/// Number of files that a program has open.
fn open_files(program: &Program) -> usize {
    let files = format!("/proc/{}/fd", id(program));
    std::fs::read_dir(files).unwrap().count()
}

/// Connections that send this and no more.
fn connections(to: &str, count: usize, first: &[u8]) -> Vec<TcpStream> {
    let connect = |_| {
        let mut stream = TcpStream::connect(to).unwrap();
        // Whoever is refused at once is refused.
        let _ = stream.write_all(first);
        stream
    };
    (0..count).map(connect).collect()
}

#[test]
fn a_hub_among_strangers_passes_every_frame_and_shows_its_page() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    for is_encrypted in [true, false] {
        let at = format!("127.0.0.1:{}", fleet::port());
        let page = format!("127.0.0.1:{}", fleet::port());
        let endpoint = format!("{}/{at}", if is_encrypted { "tls" } else { "tcp" });
        let keys = |who: &str| fleet.keys(who).to_str().unwrap().to_owned();
        let start = |who: &str, arguments: &[&str]| {
            let (flag, keys) = ("--keys", keys(who));
            let keys = [flag, &keys];
            let keys = if is_encrypted { &keys[..] } else { &[] };
            Program::start(&[arguments, keys].concat())
        };
        let mut hub = start("hub-h0", &["hub", "--listen", &endpoint, "--page", &page]);
        until("the hub is there", || {
            assert!(hub.is_running());
            !figures(&page).is_empty()
        });
        let before = open_files(&hub);
        let mut strangers = Vec::new();
        for to in [&at, &page] {
            strangers.extend(connections(to, SILENT, b""));
            // The beginning of a handshake and of a request.
            strangers.extend(connections(to, SILENT, b"\x16\x03\x01\x02\x00\x01"));
            strangers.extend(connections(to, SILENT / 2, b"GET / HT"));
            // Heads without end.
            for mut stream in connections(to, 10, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nA: ") {
                stream
                    .set_write_timeout(Some(Duration::from_millis(100)))
                    .unwrap();
                let chunk = [b'a'; 1 << 16];
                let _ = (0..64).try_for_each(|_| stream.write_all(&chunk));
                strangers.push(stream);
            }
        }
        // Those of the link, and as many of the page's as it has at once.
        assert!(open_files(&hub) <= before + 520 + 256 + 20);
        assert!(figures(&page).contains("200 OK"));
        let connect = ["--connect", &endpoint, "--json"];
        let receive = ["receive", "a", "--from-start", "--idle-s", "3"];
        let receiver = start("receiver-desk", &[&receive[..], &connect].concat());
        let scene = [
            "sensor",
            "a",
            "--scene",
            "motorcycle",
            "--width",
            "64",
            "--height",
            "48",
            "--duration-us",
            "1000000",
            "--window-us",
            "10000",
            "--linger-s",
            "30",
        ];
        let sensor = start("sensor-a", &[&scene[..], &connect].concat()).end();
        assert!(sensor.status.success(), "{sensor:?}");
        let output = receiver.end();
        assert!(output.status.success(), "{output:?}");
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let door = &said["sensors"][0];
        assert_eq!(
            (&door["frames"], &door["lost"]),
            (&100.into(), &0.into()),
            "{said}"
        );
        assert!(hub.is_running());
        // Deadlines close the strangers' connections, though their own ends stay open.
        until("they are closed", || open_files(&hub) <= before + 20);
        drop(strangers);
        hub.signal("-TERM");
        assert!(hub.end().status.success());
    }
}

/// Waits until a program has set its handlers for signals, and is where it waits.
fn settled(program: &Program) {
    // SIGINT and SIGTERM.
    const HANDLED: u64 = 1 << 1 | 1 << 14;
    let status = format!("/proc/{}/status", id(program));
    until("signals are handled", || {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let caught = text.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        let caught = caught.and_then(|caught| u64::from_str_radix(caught.trim(), 16).ok());
        caught.is_some_and(|caught| caught & HANDLED == HANDLED)
    });
    std::thread::sleep(Duration::from_millis(700));
}

#[test]
fn every_program_ends_soon_after_a_signal() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    // Accepts connections, and says nothing.
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let silent = silent.local_addr().unwrap();
    let nobody = format!("127.0.0.1:{}", fleet::port());
    let scene = [
        "sensor",
        "a",
        "--scene",
        "motorcycle",
        "--width",
        "64",
        "--height",
        "48",
        "--repeat",
    ];
    let mut lines: Vec<Vec<String>> = Vec::new();
    for to in [nobody, silent.to_string()] {
        for protocol in ["tcp", "tls"] {
            let endpoint = format!("{protocol}/{to}");
            let own = format!("{protocol}/127.0.0.1:{}", fleet::port());
            let hub = ["hub", "--no-page", "--listen", &own];
            for (who, line) in [
                ("receiver-desk", &["receive", "a"][..]),
                ("sensor-a", &scene),
                ("hub-h0", &hub),
            ] {
                let keys = fleet.keys(who).to_str().unwrap().to_owned();
                let mut line = [line, &["--connect", &endpoint]].concat();
                if protocol == "tls" {
                    line.extend(["--keys", &keys]);
                }
                lines.push(line.into_iter().map(str::to_owned).collect());
            }
        }
    }
    for line in lines {
        let line: Vec<&str> = line.iter().map(String::as_str).collect();
        for signal in ["-INT", "-TERM"] {
            let mut program = Program::start(&line);
            settled(&program);
            assert!(program.is_running(), "{line:?}");
            let since = Instant::now();
            program.signal(signal);
            while program.is_running() {
                assert!(since.elapsed() < SOON, "{signal}: {line:?}");
                std::thread::sleep(Duration::from_millis(5));
            }
            assert!(program.end().status.success(), "{line:?}");
        }
    }
}
