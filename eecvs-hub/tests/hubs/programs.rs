//! The programs together: a scene through `sensor | hub | receive` into a file, a hub that is killed under way, and what
//! is said of it.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs_nostd::Event;
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;

use crate::fleet::{self, Fleet, until};

/// A program, which ends with the test.
pub struct Program(pub Option<Child>);

impl Program {
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-hub"));
        command
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Self(Some(command.spawn().unwrap()))
    }

    pub fn end(mut self) -> Output {
        self.0.take().unwrap().wait_with_output().unwrap()
    }

    pub fn signal(&self, signal: &str) {
        let id = self.0.as_ref().unwrap().id().to_string();
        assert!(
            Command::new("kill")
                .args([signal, &id])
                .status()
                .unwrap()
                .success()
        );
    }

    pub fn is_running(&mut self) -> bool {
        self.0.as_mut().unwrap().try_wait().unwrap().is_none()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if let Some(mut child) = self.0.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn scene(seed: u64) -> Vec<Event> {
    let mut config = SceneConfig::model_1(Preset::Motorcycle, seed);
    config.sensor = fleet::SENSOR;
    config.duration_us = 8_000_000;
    let mut reader = emulate(config).unwrap();
    let mut events = Vec::new();
    while reader.read(&mut events).unwrap() > 0 {}
    events
}

/// The events of a file of frames, in which nothing is missing.
fn decoded(path: &Path) -> Vec<Event> {
    let mut windows = WindowReader::new(FrameReader::new(std::fs::File::open(path).unwrap()));
    let mut finder = EventDecoder::new(Finder::Exact);
    let mut events = Vec::new();
    while let Some(mut window) = windows.next_window().unwrap() {
        finder.fill(&mut window);
        events.extend_from_slice(&window.events);
    }
    assert!(windows.report().is_clean(), "{:?}", windows.report());
    events
}

fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_by_key(|event| (event.t_us, event.y, event.x, event.polarity.sign()));
    events
}

#[test]
fn every_event_comes_though_the_hub_is_killed() {
    let fleet = Fleet::new(1, &["hall/a", "b"], &[("desk", "**")]);
    let keys = |who: &str| fleet.keys(who).to_str().unwrap().to_owned();
    let endpoint = fleet.endpoint(0);
    let page = fleet::port();
    let page = format!("127.0.0.1:{page}");
    let hub_keys = keys("hub-h0");
    let hub = [
        "hub", "--keys", &hub_keys, "--listen", &endpoint, "--page", &page,
    ];
    let mut running = Program::start(&hub);
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("received");
    let desk_keys = keys("receiver-desk");
    let receive = Program::start(&[
        "receive",
        "--keys",
        &desk_keys,
        "--connect",
        &endpoint,
        "--to",
        to.to_str().unwrap(),
        // Whichever program is ready first.
        "--from-start",
        "--idle-s",
        "8",
        "--json",
    ]);
    let mut sensors = Vec::new();
    for (name, seed, coder) in [("hall/a", "3", "fast"), ("b", "4", "dense")] {
        let keys = keys(&format!("sensor-{}", name.replace('/', ".")));
        let store = folder.path().join(name.replace('/', "."));
        sensors.push(Program::start(&[
            "sensor",
            name,
            "--keys",
            &keys,
            "--connect",
            &endpoint,
            "--scene",
            "motorcycle",
            "--seed",
            seed,
            "--width",
            "64",
            "--height",
            "48",
            "--duration-us",
            "8000000",
            "--coder",
            coder,
            "--window-us",
            "10000",
            "--store",
            store.to_str().unwrap(),
            "--linger-s",
            "60",
            "--json",
        ]));
    }
    let figures = || figures(&page);
    until("the hub knows both", || {
        assert!(running.is_running());
        let figures = figures();
        figures.contains("sensor=\"hall/a\"") && figures.contains("sensor=\"b\"")
    });
    // Zenoh has been told of its threads before it was used.
    let environment = std::fs::read(format!(
        "/proc/{}/environ",
        running.0.as_ref().unwrap().id()
    ));
    let is_told = |text: Vec<u8>| String::from_utf8_lossy(&text).contains("ZENOH_RUNTIME=");
    assert!(environment.is_ok_and(is_told) || !cfg!(target_os = "linux"));
    std::thread::sleep(Duration::from_secs(1));
    running.signal("-KILL");
    drop(running);
    std::thread::sleep(Duration::from_secs(2));
    let running = Program::start(&hub);
    for sensor in sensors {
        let output = sensor.end();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            output.status.success(),
            "{said} {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let said: serde_json::Value = serde_json::from_str(&said).unwrap();
        assert_eq!(said["outages"], 1, "{said}");
        assert_eq!(said["frames_let_go"], 0, "{said}");
        assert!(said["frames_again"].as_u64().unwrap() > 100, "{said}");
    }
    let output = receive.end();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    // Whether frames are missing yet when it is back is up to who is back first: `links` has what is asked for again.
    assert!(told.contains("the hub does not answer"), "{told}");
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for (index, (name, seed)) in [("b", 4), ("hall/a", 3)].into_iter().enumerate() {
        let sensor = &said["sensors"][index];
        assert_eq!(sensor["name"], name);
        for what in ["lost", "missing", "damaged", "malformed"] {
            assert_eq!(sensor[what], 0, "{sensor}");
        }
        let path = to.join(format!("{}.eecvs", name.replace('/', ".")));
        assert_eq!(sorted(decoded(&path)), sorted(scene(seed)), "{name}");
    }
    running.signal("-TERM");
    assert!(running.end().status.success());
}

/// The answer of a hub's page for its figures; nothing while there is no page.
pub fn figures(page: &str) -> String {
    use std::io::{Read as _, Write as _};
    let mut answer = String::new();
    let Ok(mut stream) = std::net::TcpStream::connect(page) else {
        return answer;
    };
    let request = format!("GET /metrics HTTP/1.1\r\nHost: {page}\r\nConnection: close\r\n\r\n");
    let _ = stream.write_all(request.as_bytes());
    let _ = stream.read_to_string(&mut answer);
    answer
}

/// Two sensors are given one name, and the clock of a third is an hour behind: nothing is mixed, lost or measured by the
/// wrong clock, and all programs say so.
#[test]
fn a_name_given_twice_and_a_wrong_clock_are_said() {
    let endpoint = format!("tcp/127.0.0.1:{}", fleet::port());
    let page = format!("127.0.0.1:{}", fleet::port());
    let mut hub = Program::start(&["hub", "--listen", &endpoint, "--page", &page]);
    until("the hub is there", || {
        assert!(hub.is_running());
        !figures(&page).is_empty()
    });
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("received");
    let receive = [
        "receive",
        "--connect",
        &endpoint,
        "--to",
        to.to_str().unwrap(),
        "--idle-s",
        "5",
    ];
    let as_json = Program::start(&[&receive[..], &["--json"]].concat());
    until("the receiver is there", || {
        figures(&page).contains("eecvs_hub_receivers{hub=\"hub\"} 1")
    });
    let sensor = |name: &str, seed: &str, ahead_s: &str| {
        let line = [
            "sensor",
            name,
            "--connect",
            &endpoint,
            "--scene",
            "motorcycle",
            "--seed",
            seed,
            "--width",
            "64",
            "--height",
            "48",
            "--duration-us",
            "8000000",
            "--window-us",
            "10000",
            "--coder",
            "fast",
            "--linger-s",
            "20",
            "--clock-ahead-s",
            ahead_s,
            "--json",
        ];
        Program::start(&line)
    };
    let mut sensors = vec![sensor("door", "3", "0"), sensor("gate", "5", "-3600")];
    until("the hub knows them", || {
        let figures = figures(&page);
        figures.contains("sensor=\"door\"") && figures.contains("sensor=\"gate\"")
    });
    // The second of this name seems to have begun an hour later.
    sensors.push(sensor("door", "4", "3600"));
    until("the hub says that there are two", || {
        figures(&page).contains("eecvs_sensors_at_once{sensor=\"door\"} 2")
    });
    until("the hub has measured the clock", || {
        let figures = figures(&page);
        let mut lines = figures.lines();
        let of = "eecvs_clock_ahead_seconds{sensor=\"gate\"} ";
        let ahead_s = lines.find_map(|line| line.strip_prefix(of)?.parse::<f64>().ok());
        ahead_s.is_some_and(|ahead_s| (ahead_s + 3600.0).abs() < 5.0)
    });
    for sensor in sensors {
        let output = sensor.end();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{told}");
    }
    let output = as_json.end();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{told}");
    let all =
        "door: 2 sensors sent under this name at once; with --allow-loss this is not an error";
    assert!(told.contains(all), "{told}");
    assert!(
        told.contains("door: 2 sensors send under this name at once, and each is kept apart"),
        "{told}"
    );
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let [door, gate] = [0, 1].map(|index| &said["sensors"][index]);
    assert_eq!((&door["at_once"], &gate["at_once"]), (&2.into(), &1.into()));
    for sensor in [door, gate] {
        for what in ["lost", "missing", "before", "malformed"] {
            assert_eq!(sensor[what], 0, "{sensor}");
        }
    }
    assert_eq!(gate["clock"]["is_different"], true, "{gate}");
    let ahead_us = gate["clock"]["ahead_us"].as_i64().unwrap();
    let error_us = gate["clock"]["error_us"].as_u64().unwrap();
    assert!(
        ahead_us.abs_diff(-3_600_000_000) <= error_us + 1000,
        "{gate}"
    );
    let p99_ms = gate["delay_p99_ms"].as_f64().unwrap();
    assert!((0.0..60_000.0).contains(&p99_ms), "{gate}");
    let files = ["door.eecvs", "door~2.eecvs", "gate.eecvs"];
    for (index, (file, seed)) in files.into_iter().zip([3, 4, 5]).enumerate() {
        let path = to.join(file);
        assert_eq!(
            said["files"][index]["file"],
            path.to_str().unwrap(),
            "{said}"
        );
        assert_eq!(sorted(decoded(&path)), sorted(scene(seed)), "{file}");
    }
    hub.signal("-TERM");
    let output = hub.end();
    assert!(output.status.success());
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        told.contains("door: 2 sensors send under this name at once: give each"),
        "{told}"
    );
    assert!(!told.contains("gate: "), "{told}");
}

#[test]
fn what_is_wrong_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().to_str().unwrap();
    for (arguments, status, want) in [
        (
            &["hub", "--no-page", "--listen", "tcp/0.0.0.0:0"][..],
            1,
            "give --keys or --anyone",
        ),
        (
            &[
                "hub",
                "--no-page",
                "--listen",
                "tls/127.0.0.1:0",
                "--anyone",
            ],
            1,
            "which eecvs-hub keys makes",
        ),
        (&["hub", "--page", "nowhere"], 1, "--page nowhere"),
        (&["hub", "--budget", "a=0"], 2, "a budget cannot be 0"),
        (&["hub", "--keys", folder], 1, "access.toml: no such file"),
        (&["sensor", "a b"], 2, "is not a valid name"),
        (&["receive", "a//b"], 2, "is not a valid name"),
        (
            &["sensor", "a", "--recording", "/nowhere.raw"],
            1,
            "/nowhere.raw",
        ),
        (&["keys", folder, "receiver", "desk"], 2, "--hears"),
        (&["simulate", "--seconds", "6"], 1, "give more --seconds"),
        (&[], 2, "Usage"),
    ] {
        let output = Program::start(arguments).end();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {told}");
        assert!(told.contains(want), "{arguments:?}: {told}");
    }
}

/// The folder of a sensor's store is one process's: its bound is one, and nobody deletes another's frames.
#[test]
fn a_second_process_on_a_store_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("kept");
    let hub = format!("tcp/127.0.0.1:{}", fleet::port());
    let line = [
        "sensor",
        "door",
        "--connect",
        &hub,
        "--scene",
        "motorcycle",
        "--width",
        "32",
        "--height",
        "24",
        "--repeat",
        "--linger-s",
        "0",
        "--store",
        store.to_str().unwrap(),
        "--sync-ms",
        "10",
        "--json",
    ];
    let mut first = Program::start(&line);
    until("the first has its folder", || {
        assert!(first.is_running());
        std::fs::read(store.join("sensor")).is_ok_and(|name| name == b"door\n")
    });
    let output = Program::start(&line).end();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("another process uses it"), "{told}");
    first.signal("-TERM");
    let output = first.end();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    // Without a hub, all that was made is there for the next run.
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["frames_on_disk"], said["frames"], "{said}");
    for what in ["disk_failures", "disk_damaged_frames", "disk_damaged_bytes"] {
        assert_eq!(said[what], 0, "{said}");
    }
}

/// A small fleet: every frame is compared with the one that was sent.
#[test]
fn a_simulated_fleet_is_whole() {
    let line = [
        "simulate",
        "--sensors",
        "40",
        "--hubs",
        "3",
        "--seconds",
        "6",
        "--outage-s",
        "2",
        "--json",
    ];
    let output = Program::start(&line).end();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["delivered"], said["expected"]);
    assert_eq!((&said["lost"], &said["wrong"]), (&0.into(), &0.into()));
    // 13 sensors of the last hub have made frames without it.
    assert!(said["again"].as_u64().unwrap() > 13 * 10, "{said}");
    assert!(said["frames"].as_u64().unwrap() > 2000);
}

/// Arguments that are not UTF-8 are values like others, or are refused.
#[cfg(unix)]
#[test]
fn arguments_may_be_of_any_bytes() {
    use std::os::unix::ffi::OsStrExt as _;
    let bad = std::ffi::OsStr::from_bytes(b"/nowhere/a\xff");
    for arguments in [
        &["hub", "--no-page", "--keys"][..],
        &["hub", "--page"],
        &["hub", "--budget"],
        &["hub", "--name"],
        &["sensor", "a", "--recording"],
        &["sensor"],
        &["receive"],
        &["keys"],
        &["simulate", "--seconds"],
        &[],
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-hub"));
        let output = command.args(arguments).arg(bad).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        let status = output.status.code();
        assert!(
            matches!(status, Some(1 | 2)),
            "{arguments:?}: {status:?}: {said}"
        );
        assert!(
            !said.is_empty() && !said.contains("panicked"),
            "{arguments:?}: {said}"
        );
    }
}

/// Each has the same authority's keys, and all are listed.
#[test]
fn many_may_make_keys_in_one_folder_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fleet");
    let fleet = path.to_str().unwrap();
    let names: Vec<String> = (0..12).map(|number| format!("door{number}")).collect();
    let started: Vec<Program> = names
        .iter()
        .map(|name| Program::start(&["keys", fleet, "sensor", name]))
        .collect();
    for program in started {
        let output = program.end();
        assert!(output.status.success(), "{output:?}");
    }
    let authority = std::fs::read(path.join("ca.pem")).unwrap();
    for name in &names {
        let own = path.join(format!("sensor-{name}/ca.pem"));
        assert_eq!(std::fs::read(own).unwrap(), authority, "{name}");
    }
    let listed = std::fs::read_to_string(path.join("access.toml")).unwrap();
    for name in &names {
        assert!(listed.contains(&format!("\"{name}\"")), "{listed}");
    }
}
