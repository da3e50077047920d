//! Recordings through an encoder at the other end of a link: one in a thread, and the firmware in
//! QEMU. What needs QEMU or the firmware's compiler is skipped where these are missing.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use eecvs::encode::{Limits, encode as host_encode};
use eecvs_nostd::event_link::{Kind, Setup, Status};
use eecvs_nostd::{
    Axis, Coder, Config, Event, Fidelity, Filter, Frame, Hybrid, Mode, Quantiser, Readout, Region,
    Sensor, Thresholds, Transform, WindowConfig,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use event_types::bail;
use event_types::stream::Result;
use mcu_link::image::{self, ImageSizes};
use mcu_link::link::{EventPackets, Message};
use mcu_link::qemu::{Machine, Qemu};
use mcu_link::{Connection, Job, Outcome};

use crate::mcu_peer::{Behaviour, Fault, Peer};
use crate::support::{Folder, count, number, text};

const SCENE: SceneConfig = SceneConfig {
    sensor: Sensor {
        width: 48,
        height: 36,
    },
    duration_us: 100_000,
    start_us: 1_700_000_000_000_000,
    ..SceneConfig::model_1(Preset::Motorcycle, 3)
};

const QUICK: Mode = Mode::Hybrid(Hybrid {
    coder: Coder::Quick,
    fidelity: Fidelity::Lossless,
});

const FAST: Mode = Mode::Hybrid(Hybrid {
    coder: Coder::Fast,
    fidelity: Fidelity::Lossless,
});

fn config() -> Config {
    Config {
        m: 8,
        ..Config::new(
            WindowConfig::new(SCENE.sensor, 16_384),
            Thresholds::new(2_000_000_000_000, 20_000_000_000_000).expect("in order"),
            Mode::Transform,
        )
    }
}

fn open() -> Result<Box<dyn EventReader>> {
    Ok(Box::new(emulate(SCENE)?))
}

fn events() -> Vec<Event> {
    let mut reader = open().expect("a scene");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("events") > 0 {}
    events
}

/// Events in memory.
struct Recording(Vec<Event>, event_files::Skipped);
impl EventReader for Recording {
    fn format(&self) -> &'static str {
        "memory"
    }
    fn sensor(&self) -> Sensor {
        SCENE.sensor
    }
    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        events.append(&mut self.0);
        Ok(events.len())
    }
    fn skipped(&self) -> &event_files::Skipped {
        &self.1
    }
}

/// The scene as a sensor sees it that reads its columns every 100 us, each half a microsecond after the
/// one before.
fn scanned() -> Vec<Event> {
    let mut events = events();
    for event in &mut events {
        event.t_us = event.t_us / 100 * 100 + u64::from(event.x / 2);
    }
    events.sort_by_key(|event| event.t_us);
    events
}

/// Something to connect to: a peer, or QEMU.
type Connect<'c> = &'c mut dyn FnMut() -> UnixStream;

fn encode(link: &UnixStream, patience: Duration) -> Result<Outcome> {
    let job = Job {
        open: &open,
        config: config(),
        hot: &[],
        drop_when_full: false,
    };
    mcu_link::run(&mut Connection::new(link, patience)?, &job, &|_| ())
}

/// A run in which every frame is the host's.
#[track_caller]
fn identical(link: &UnixStream) -> Outcome {
    let outcome = encode(link, mcu_link::PATIENCE).expect("a run");
    outcome.verdict().expect("identical frames");
    assert_eq!(outcome.events, events().len() as u64);
    assert_eq!(outcome.events_encoded, outcome.events);
    assert!(outcome.windows >= 6, "{outcome:?}");
    assert!(outcome.frames_identical >= outcome.windows, "{outcome:?}");
    assert_eq!(outcome.frames, outcome.frames_identical);
    assert_eq!(u64::from(outcome.status.events), outcome.events);
    assert!(outcome.ns_per_event().iter().sum::<f64>() > 0.0);
    outcome
}

/// Coefficients, but the times of events in pixels of few.
fn few_as_times(link: &UnixStream, transform: Transform) {
    let job = Job {
        open: &open,
        config: Config {
            transform: Some(transform),
            few_as_times: true,
            mode: Mode::Transform,
            ..config()
        },
        hot: &[],
        drop_when_full: false,
    };
    let mut connection = Connection::new(link, mcu_link::PATIENCE).expect("a connection");
    let outcome = mcu_link::run(&mut connection, &job, &|_| ()).expect("a run");
    outcome.verdict().expect("identical frames");
    assert_eq!(outcome.events_encoded, outcome.events);
}

/// Events in their order of arrival, but for those of two pixels and of what lies outside a region.
fn quick(link: &UnixStream) {
    let job = Job {
        open: &open,
        config: Config {
            mode: QUICK,
            filter: Filter {
                region: Some(Region {
                    x: 5,
                    y: 0,
                    width: 40,
                    height: 30,
                }),
                isolated: false,
            },
            ..config()
        },
        hot: &[(10, 10), (20, 20)],
        drop_when_full: false,
    };
    let mut connection = Connection::new(link, mcu_link::PATIENCE).expect("a connection");
    let outcome = mcu_link::run(&mut connection, &job, &|_| ()).expect("a run");
    outcome.verdict().expect("identical frames");
    assert!(outcome.events_filtered > 0, "{outcome:?}");
    assert_eq!(
        outcome.events_encoded + outcome.events_filtered,
        outcome.events
    );
    // Its windows are not the next run's.
    identical(link);
}

/// The dense coder, told the readout, the budget, and three pixels that see the most.
fn dense(link: &UnixStream) {
    let events = scanned();
    let mut counts = BTreeMap::<_, u64>::new();
    for event in &events {
        *counts.entry((event.y, event.x)).or_default() += 1;
    }
    let mut busiest: Vec<_> = counts.into_iter().collect();
    busiest.sort_by_key(|(_, count)| Reverse(*count));
    busiest.truncate(3);
    let filtered = busiest.iter().map(|(_, count)| count).sum::<u64>();
    busiest.sort_unstable();
    let hot: Vec<_> = busiest.iter().map(|((y, x), _)| (*x, *y)).collect();
    let config = Config {
        mode: Mode::Hybrid(Hybrid {
            coder: Coder::Dense,
            fidelity: Fidelity::Lossless,
        }),
        readout: Readout::new(Axis::Columns, 100 << 16, 1 << 15),
        ..config()
    };
    let open = || -> Result<Box<dyn EventReader>> {
        Ok(Box::new(Recording(events.clone(), Default::default())))
    };
    let mut frames = Vec::new();
    let (limits, threads) = (Limits::default(), NonZeroUsize::MIN);
    let mut reader = open().expect("a scene");
    host_encode(
        reader.as_mut(),
        config,
        limits,
        threads,
        &mut frames,
        &mut |_| (),
    )
    .expect("frames");
    let first = Frame::parse(&frames).expect("a frame");
    assert!(first.header.scans.is_some(), "{:?}", first.header);
    let job = Job {
        open: &open,
        config,
        hot: &hot,
        drop_when_full: false,
    };
    let mut connection = Connection::new(link, mcu_link::PATIENCE).expect("a connection");
    let outcome = mcu_link::run(&mut connection, &job, &|_| ()).expect("a run");
    outcome.verdict().expect("identical frames");
    assert_eq!(outcome.events_filtered, filtered, "{outcome:?}");
    assert_eq!(outcome.events_encoded + filtered, events.len() as u64);
    assert_eq!(outcome.status.hot_pixels, 3, "{outcome:?}");
    assert!(outcome.status.dense_words > 0, "{outcome:?}");
    // Nothing of it is left for the next run.
    identical(link);
}

/// The scene's packets and what ends them.
fn packets(events: &[Event], setup: &Setup) -> Vec<Vec<u8>> {
    let mut packets = EventPackets::new(setup.time_base_us);
    let mut all = Vec::new();
    for event in events {
        let mut bytes = Vec::new();
        packets.push(*event, &mut bytes).expect("times that fit");
        all.extend((!bytes.is_empty()).then_some(bytes));
    }
    let mut bytes = Vec::new();
    packets.finish(&mut bytes).expect("short packets");
    all.push(bytes);
    all
}

/// Sends bytes and reads to the answer to the flush; returns it and the events that the frames
/// account for.
fn answer_to(connection: &mut Connection, bytes: &[u8]) -> (Status, u64) {
    let (mut status, mut accounted) = (Status::default(), 0);
    connection
        .exchange(
            |sender| sender.send(bytes),
            |message, _| {
                Ok(match message {
                    Message::Frame(header, _) => {
                        let counts = [header.events, header.late, header.filtered, header.dropped];
                        accounted += counts.map(u64::from).iter().sum::<u64>();
                        ControlFlow::Continue(())
                    }
                    Message::Packet(Kind::Status, body) => {
                        status = Status::parse(&body).expect("a status");
                        match status.answers == Kind::Flush as u8 {
                            true => ControlFlow::Break(()),
                            false => ControlFlow::Continue(()),
                        }
                    }
                    Message::Packet(..) => panic!("{message:?}"),
                })
            },
        )
        .expect("an answer");
    (status, accounted)
}

/// Garbage between packets costs no event, or counts those that it costs.
fn garbage_in_the_middle(connect: Connect<'_>) {
    let events = events();
    let setup = Setup::new(&config(), events[0].t_us & !63);
    let packets = packets(&events, &setup);
    let link = connect();
    let mut connection = Connection::new(&link, mcu_link::PATIENCE).expect("a connection");
    let before = mcu_link::set_up(&mut connection, &setup).expect("a setup");
    let half = packets.len() / 2;
    // No packet, the beginning of a long one, and one whose kind does not exist.
    let garbage = b"\x00\xEE\xEE\xC6\x02\x00\x02\xEE\xC6\x09garbage\xEE\xC6\x02\xFF\xFF".as_slice();
    let mut damaged = packets[half].clone();
    damaged[20] ^= 1;
    let lost = (damaged.len() / 4) as u32;
    let bytes = [
        &packets[..half].concat(),
        garbage,
        &damaged,
        &packets[half + 1..].concat(),
    ]
    .concat();
    let (status, accounted) = answer_to(&mut connection, &bytes);
    let total = status.events.wrapping_sub(before.events) + status.lost.wrapping_sub(before.lost);
    assert_eq!(total as usize, events.len(), "{status:?}");
    assert_eq!(accounted, events.len() as u64, "{status:?}");
    let lost_there = status.lost.wrapping_sub(before.lost);
    assert!((1..lost).contains(&lost_there), "{status:?}");
    let damaged = status.damaged_bytes.wrapping_sub(before.damaged_bytes) as usize;
    assert!(damaged >= garbage.len(), "{status:?}");
    drop((connection, link));
    identical(&connect());
}

/// A connection that ends in the middle of a packet leaves nothing behind.
fn cut_in_a_packet(connect: Connect<'_>) {
    let events = events();
    let setup = Setup::new(&config(), events[0].t_us & !63);
    let packets = packets(&events, &setup);
    let link = connect();
    let mut connection = Connection::new(&link, mcu_link::PATIENCE).expect("a connection");
    mcu_link::set_up(&mut connection, &setup).expect("a setup");
    let (last, whole) = packets[..packets.len() / 2].split_last().expect("packets");
    let bytes = [&whole.concat(), &last[..last.len() / 2]].concat();
    let done = std::sync::atomic::AtomicBool::new(false);
    let cut = connection.exchange(
        |sender| {
            sender.send(&bytes)?;
            done.store(true, std::sync::atomic::Ordering::Relaxed);
            bail!(Damaged, "cut")
        },
        |_, _| Ok(ControlFlow::Continue(())),
    );
    assert_eq!(cut.expect_err("the cut").to_string(), "cut");
    assert!(done.into_inner());
    drop((connection, link));
    identical(&connect());
}

/// An encoder that cannot wait loses events, and says how many.
fn flood(connect: Connect<'_>) {
    // Thrice a window that keeps the encoder busy, and then windows of one event each: more of them than
    // it has room for come in that time, however slow the link.
    let scene = &events()[..5_000];
    let window_us = u64::from(config().window.window_us);
    let mut many = Vec::new();
    let mut start_us = SCENE.start_us - SCENE.start_us % window_us;
    for _ in 0..3 {
        let busy = (0..).zip(scene).map(|(index, event)| Event {
            t_us: start_us + index * 3,
            ..*event
        });
        many.extend(busy);
        let lone = (1..=64).zip(scene).map(|(window, event)| Event {
            t_us: start_us + window * window_us,
            ..*event
        });
        many.extend(lone);
        start_us += 65 * window_us;
    }
    let open = || -> Result<Box<dyn EventReader>> {
        Ok(Box::new(Recording(many.clone(), Default::default())))
    };
    let job = Job {
        open: &open,
        // As slow as it gets, to compute and to send.
        config: Config {
            m: 64,
            transform: Some(Transform::Dtft),
            quantiser: Quantiser::new(Quantiser::STEP_LOG2_MIN).expect("in range"),
            ..config()
        },
        hot: &[],
        drop_when_full: true,
    };
    let link = connect();
    let mut connection = Connection::new(&link, mcu_link::PATIENCE).expect("a connection");
    let flooded = mcu_link::run(&mut connection, &job, &|_| ()).expect("a run");
    drop((connection, link));
    flooded.verdict().expect("whole frames");
    assert_eq!(flooded.events, many.len() as u64);
    assert_eq!(
        flooded.events_encoded + flooded.events_late + flooded.events_lost,
        flooded.events
    );
    assert_eq!(flooded.frames_identical + flooded.frames_different, 0);
    assert_eq!(u64::from(flooded.status.dropped), flooded.events_lost);
    assert!(flooded.events_lost > 0, "{flooded:?}");
    identical(&connect());
}

#[test]
fn frames_of_a_peer_are_the_hosts() {
    let first = identical(&Peer::start(Behaviour::GOOD).connect());
    // Several frames a window, and windows closed early.
    assert!(first.frames > first.windows, "{first:?}");
    let small = Behaviour {
        window_events: 90,
        ..Behaviour::GOOD
    };
    let small = identical(&Peer::start(small).connect());
    dense(&Peer::start(Behaviour::GOOD).connect());
    assert!(small.windows > 2 * first.windows, "{small:?}");
    // Again on the same connection.
    let peer = Peer::start(Behaviour::GOOD);
    let link = peer.connect();
    assert_eq!(identical(&link), first);
    assert_eq!(identical(&link), first);
}

#[test]
fn a_peer_recovers_from_damage() {
    let peer = Peer::start(Behaviour::GOOD);
    garbage_in_the_middle(&mut || peer.connect());
    cut_in_a_packet(&mut || peer.connect());
    flood(&mut || peer.connect());
}

#[test]
fn a_setup_that_is_lost_is_sent_again() {
    let deaf = Behaviour {
        deaf_to: 2,
        ..Behaviour::GOOD
    };
    identical(&Peer::start(deaf).connect());
    let twice = Behaviour {
        fault: Fault::AnswerTwice,
        ..Behaviour::GOOD
    };
    let peer = Peer::start(twice);
    let link = peer.connect();
    let first = identical(&link);
    // Counts that run on are taken as differences.
    assert_eq!(identical(&link).status.events, first.status.events);
}

#[test]
fn what_is_wrong_is_said() {
    let last = events().len() as u32;
    for (fault, frames_different, parts) in [
        (
            Fault::FlipBit(2),
            1..=1,
            vec!["frame 2 is missing", "no frame", "jump 1 times"],
        ),
        (
            // Every frame of a window tells how many events it holds.
            Fault::SkipEvent(last),
            2..=9,
            vec!["differs at byte", "but 6534 are accounted for"],
        ),
        (
            Fault::LoseFrame(0),
            1..=1,
            vec!["frame 0 is missing", "are accounted for"],
        ),
        (
            Fault::LoseFrame(3),
            1..=1,
            vec!["frame 3 is missing", "are accounted for"],
        ),
        (
            Fault::RepeatFrame(1),
            1..=1,
            vec!["frame 1 came twice", "are accounted for"],
        ),
        (
            Fault::Garbage(2),
            0..=0,
            vec!["12 bytes belong to no frame"],
        ),
        (
            Fault::Miscount,
            0..=0,
            vec!["frames arrived but the encoder sent"],
        ),
    ] {
        let behaviour = Behaviour {
            fault,
            ..Behaviour::GOOD
        };
        let peer = Peer::start(behaviour);
        let outcome = encode(&peer.connect(), mcu_link::PATIENCE).expect("a run");
        assert!(
            frames_different.contains(&outcome.frames_different),
            "{fault:?}: {outcome:?}"
        );
        let verdict = outcome.verdict().expect_err("a fault").to_string();
        for part in parts {
            assert!(verdict.contains(part), "{fault:?}: {part}: {verdict}");
        }
    }
}

#[test]
fn an_encoder_that_fails_ends_the_run() {
    for (fault, part) in [
        (Fault::Restart(1), "restarted in the middle"),
        (
            Fault::Stall(1),
            "neither accepted nor sent anything for 0.5 s",
        ),
        (Fault::Close(1), "encoder"),
        (Fault::Status, "another layout"),
        (
            Fault::Refuse,
            "48 x 36 pixels: it has no memory for windows of this sensor",
        ),
        (Fault::NoWindow, "windows of 0 events"),
    ] {
        let behaviour = Behaviour {
            fault,
            ..Behaviour::GOOD
        };
        let peer = Peer::start(behaviour);
        let error = encode(&peer.connect(), Duration::from_millis(500));
        let error = format!("{:#}", error.expect_err("a fault"));
        assert!(error.contains(part), "{fault:?}: {error}");
    }
    let full = Behaviour {
        fault: Fault::RefuseHot,
        ..Behaviour::GOOD
    };
    let peer = Peer::start(full);
    let link = peer.connect();
    let mut connection = Connection::new(&link, mcu_link::PATIENCE).expect("a connection");
    mcu_link::set_up(&mut connection, &Setup::new(&config(), 0)).expect("a setup");
    let error = mcu_link::keep_out(&mut connection, SCENE.sensor, &[(3, 0), (1, 7)]);
    let error = error.expect_err("a pixel too many").to_string();
    assert!(
        error.contains("leaves out 1 of 2 hot pixels: it has no memory for more"),
        "{error}"
    );
    let deaf = Behaviour {
        deaf_to: u32::MAX,
        ..Behaviour::GOOD
    };
    let peer = Peer::start(deaf);
    let error = encode(&peer.connect(), Duration::from_millis(500));
    let error = error.expect_err("no answer").to_string();
    assert!(
        error.contains("no answer to the setup for 0.5 s"),
        "{error}"
    );
}

/// A recording that cannot be sent whole is not sent at all.
#[test]
fn times_that_words_cannot_carry_are_named() {
    let period = 1_u64 << 34;
    let times = [
        period + 5,
        period + 2,
        period - 1,
        7 * period,
        period + 9,
        0,
    ];
    let open = move || -> Result<Box<dyn EventReader>> {
        let event = |t_us| Event {
            t_us,
            ..events()[0]
        };
        Ok(Box::new(Recording(
            times.map(event).to_vec(),
            Default::default(),
        )))
    };
    let peer = Peer::start(Behaviour::GOOD);
    let link = peer.connect();
    let job = Job {
        open: &open,
        config: config(),
        hot: &[],
        drop_when_full: false,
    };
    let mut connection = Connection::new(&link, mcu_link::PATIENCE).expect("a connection");
    let error = mcu_link::run(&mut connection, &job, &|_| ()).expect_err("a gap");
    let error = error.to_string();
    for part in ["event 2: its time 17179869183 us", "2 further events"] {
        assert!(error.contains(part), "{error}");
    }
    // Nothing was sent.
    assert!(!connection.incoming().is_incomplete());
    identical(&link);
}

#[test]
fn usage_and_images_are_checked() {
    let folder = Folder::new();
    folder.write("not.elf", b"no image");
    folder
        .eecvs("mcu --image not.elf --json")
        .fails(&["not.elf", "not a 32-bit ELF"]);
    folder
        .eecvs("mcu --image missing.elf --json")
        .fails(&["missing.elf", "cannot be opened"]);
    folder
        .eecvs("mcu missing.raw --image not.elf")
        .fails(&["missing.raw"]);
    assert_eq!(folder.eecvs("mcu --machine abacus").status, Some(2));
    assert_eq!(folder.eecvs("mcu --window-events 7").status, Some(2));
}

/// The encoder's image, or a note that there is none.
fn image(machine: Machine) -> Option<PathBuf> {
    if Command::new("qemu-system-arm")
        .arg("--version")
        .output()
        .is_err()
    {
        eprintln!("skipped: qemu-system-arm is not installed");
        return None;
    }
    match image::build(machine, "encoder") {
        Ok(image) => Some(image),
        Err(error) => {
            let library = Command::new("rustc")
                .args([
                    "--print",
                    "target-libdir",
                    "--target",
                    "thumbv7em-none-eabihf",
                ])
                .output()
                .expect("rustc");
            let folder = String::from_utf8(library.stdout).expect("UTF-8");
            assert!(!Path::new(folder.trim()).is_dir(), "{error:#}");
            eprintln!("skipped: no core library for the firmware's target");
            None
        }
    }
}

fn on(machine: Machine, act: impl FnOnce(Connect<'_>)) {
    let Some(image) = image(machine) else { return };
    let mut qemu = Qemu::start(machine, &image, false).expect("an emulator");
    act(&mut || qemu.connect().expect("a connection"));
}

#[test]
fn every_machines_frames_are_the_hosts() {
    for machine in [
        Machine::NetduinoPlus2,
        Machine::Mps2An386,
        Machine::Mps2An500,
    ] {
        on(machine, |connect| {
            let link = connect();
            let outcome = identical(&link);
            assert!(outcome.status.stack_bytes > 0, "{outcome:?}");
            dense(&link);
            quick(&link);
            // The others' golden vectors have such pixels too.
            if machine == Machine::NetduinoPlus2 {
                Transform::ALL
                    .into_iter()
                    .for_each(|transform| few_as_times(&link, transform));
            }
        });
    }
}

/// While its one window is encoded, events wait in its ring.
#[test]
fn the_small_image_codes_events_and_names_what_it_lacks() {
    on(Machine::Small, |connect| {
        let fast = Config {
            mode: FAST,
            ..config()
        };
        let identical = |link: &UnixStream, config: Config, drop_when_full: bool| {
            let job = Job {
                open: &open,
                config,
                hot: &[(3, 4)],
                drop_when_full,
            };
            let mut connection = Connection::new(link, mcu_link::PATIENCE)?;
            mcu_link::run(&mut connection, &job, &|_| ())
        };
        let link = connect();
        let outcome = identical(&link, fast, false).expect("a run");
        outcome.verdict().expect("identical frames");
        assert_eq!(outcome.events, events().len() as u64);
        assert_eq!(
            outcome.events_encoded + outcome.events_filtered,
            outcome.events
        );
        assert_eq!(outcome.windows, 7);
        assert!(outcome.frames_identical >= outcome.windows);
        assert_eq!(outcome.status.hot_pixels, 1);
        assert!(outcome.status.stack_bytes > 0);
        // What it drops, if the host is faster than both for long, is counted.
        let dropping = identical(&link, fast, true).expect("a run");
        dropping.verdict().expect("whole frames");
        assert_eq!(
            dropping.events_encoded + dropping.events_filtered + dropping.events_lost,
            dropping.events
        );
        for (config, part) in [
            (config(), "no such mode"),
            (
                Config {
                    mode: QUICK,
                    ..config()
                },
                "no such mode",
            ),
            (
                Config {
                    mode: Mode::Hybrid(Hybrid {
                        coder: Coder::Dense,
                        fidelity: Fidelity::Lossless,
                    }),
                    ..config()
                },
                "no dense coder",
            ),
        ] {
            let error = identical(&link, config, false).expect_err("not in the image");
            assert!(format!("{error:#}").contains(part), "{error:#}");
        }
        let outcome = identical(&link, fast, false).expect("a run");
        outcome.verdict().expect("identical frames");
    });
}

#[test]
fn the_image_recovers_from_garbage() {
    on(Machine::NetduinoPlus2, garbage_in_the_middle);
}

#[test]
fn the_image_recovers_from_a_cut_connection() {
    on(Machine::NetduinoPlus2, |connect| cut_in_a_packet(connect));
}

#[test]
fn the_image_accounts_for_a_flood() {
    on(Machine::NetduinoPlus2, flood);
}

#[test]
fn the_command_reports_the_image() {
    let Some(image) = image(Machine::NetduinoPlus2) else {
        return;
    };
    let sizes = ImageSizes::read(&image).expect("an ELF file");
    // An STM32F405 has 1 MiB and 128 KiB.
    assert!((10_000..1 << 20).contains(&sizes.flash_bytes), "{sizes:?}");
    assert!((50_000..128 << 10).contains(&sizes.ram_bytes), "{sizes:?}");
    let folder = Folder::new();
    let report = folder
        .eecvs("mcu --transform dct -m 4 --json")
        .ok()
        .object();
    let keys: Vec<&str> = report
        .as_object()
        .expect("an object")
        .keys()
        .map(String::as_str)
        .collect();
    let mut wanted = [
        "machine",
        "hot_pixels",
        "events",
        "events_encoded",
        "events_late",
        "events_filtered",
        "events_thinned",
        "events_lost",
        "windows",
        "window_events",
        "frames",
        "frames_identical",
        "frames_different",
        "last_restart",
        "instructions_per_event",
        "receive_instructions_per_event",
        "encode_instructions_per_event",
        "send_instructions_per_event",
        "flash_bytes",
        "ram_bytes",
        "stack_bytes",
    ];
    wanted.sort_unstable();
    assert_eq!(keys, wanted);
    assert_eq!(text(&report, "machine"), "netduinoplus2");
    assert_eq!(count(&report, "frames_different"), 0);
    assert_eq!(count(&report, "events_lost"), 0);
    assert!(count(&report, "frames_identical") >= count(&report, "windows"));
    assert!(count(&report, "events") > 5_000);
    let instructions = number(&report, "instructions_per_event");
    assert!((10.0..100_000.0).contains(&instructions), "{instructions}");
    assert_eq!(count(&report, "flash_bytes"), sizes.flash_bytes);
    assert_eq!(count(&report, "ram_bytes"), sizes.ram_bytes);
    assert!(count(&report, "stack_bytes") > 100);
    let table = folder.eecvs("mcu --transform dwt -m 4 --log");
    assert_eq!(table.status, Some(0), "{table}");
    assert!(table.stdout.contains("instructions/event"), "{table}");
    // Level, message and place of a line that every run has.
    let setup = table.stderr.lines().find(|line| line.contains("Setup {"));
    let setup = setup.unwrap_or_else(|| panic!("{table}"));
    assert!(
        setup.starts_with("mcu: info ") && setup.contains(".rs:"),
        "{setup}"
    );
    let image = image.to_str().expect("UTF-8");
    // The other board's memory begins elsewhere.
    let wrong = folder.eecvs(&format!("mcu --image {image} --machine mps2-an386"));
    wrong.fails(&["qemu-system-arm ended ("]);
    let without = folder
        .command(&["mcu", "--image", image])
        .env("PATH", "")
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&without.stderr);
    assert!(said.contains("qemu-system-arm is not installed"), "{said}");
    assert_eq!(without.status.code(), Some(1));
}

#[test]
fn every_kernel_is_counted_where_the_emulator_is() {
    if image(Machine::NetduinoPlus2).is_none() {
        return;
    }
    let folder = Folder::new();
    let outcome = folder
        .eecvs("bench --quick --mcu run --json -o charts")
        .warns(&["instructions: counted now"]);
    let rows = outcome.array();
    for target in ["cortex-m4", "cortex-m7"] {
        for kernel in [
            "table",
            "recurrence",
            "precise",
            "micromath",
            "libm",
            "haar",
        ] {
            let here = |row: &&serde_json::Value| {
                text(row, "target") == target && text(row, "kernel") == kernel
            };
            let costs: Vec<f64> = rows
                .iter()
                .filter(here)
                .map(|row| number(row, "cost"))
                .collect();
            assert!(costs.len() >= 12, "{target} {kernel}");
            assert!(
                costs.iter().all(|cost| (5.0..1e5).contains(cost)),
                "{costs:?}"
            );
        }
    }
}

/// Returns the processes that `id` has begun.
#[cfg(target_os = "linux")]
fn children(id: u32) -> Vec<u32> {
    let tasks = std::fs::read_to_string(format!("/proc/{id}/task/{id}/children"));
    let tasks = tasks.unwrap_or_default();
    tasks
        .split_whitespace()
        .filter_map(|id| id.parse().ok())
        .collect()
}

/// Returns whether a process runs a program of this name.
#[cfg(target_os = "linux")]
fn runs(id: u32, name: &str) -> bool {
    let line = std::fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
    line.starts_with(name.as_bytes())
}

#[cfg(target_os = "linux")]
#[test]
fn the_emulator_ends_with_a_command_that_is_killed() {
    const PROGRAM: &str = "qemu-system-arm";
    let Some(image) = image(Machine::NetduinoPlus2) else {
        return;
    };
    let folder = Folder::new();
    let mut command = folder
        .command(&["mcu", "--image", image.to_str().expect("UTF-8")])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("a command");
    let patience = std::time::Instant::now() + Duration::from_secs(60);
    let emulator = loop {
        let mut found = children(command.id()).into_iter();
        if let Some(id) = found.find(|id| runs(*id, PROGRAM)) {
            break id;
        }
        assert!(std::time::Instant::now() < patience, "no emulator");
        std::thread::sleep(Duration::from_millis(1));
    };
    command.kill().expect("a kill");
    command.wait().expect("an end");
    while runs(emulator, PROGRAM) {
        assert!(std::time::Instant::now() < patience, "it runs on");
        std::thread::sleep(Duration::from_millis(1));
    }
}
