//! Sensors, hubs and receivers over encrypted links on this computer: all frames come, each once, whatever fails; and
//! nobody gets or sends what it may not.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crate::fleet::{self, Fleet, assert_all, frames, garbage, port, send, until};
use eecvs_hub::clock::Clock;
use eecvs_hub::key::{Kind, Name};
use eecvs_hub::link::{Client, Links};
use eecvs_hub::message::{Message as _, Status};
use eecvs_hub::{downlink, hub};
use eecvs_nostd::Coder;
use zenoh::Wait;

const TICK: Duration = Duration::from_millis(2);

#[test]
fn frames_pass_two_hubs() {
    let fleet = Fleet::new(2, &["a", "hall/b"], &[("desk", "**"), ("hall", "hall/**")]);
    let first = fleet.hub(0, &[]);
    let second = fleet.hub(1, &[0]);
    until("the hubs are connected", || {
        first.routers() == 1 && second.routers() == 1
    });
    let desk = fleet.receiver(1, "receiver-desk", "**");
    let hall = fleet.receiver(0, "receiver-hall", "hall/**");
    desk.connected();
    hall.connected();
    let frames = frames(200_000, Coder::Dense);
    std::thread::scope(|scope| {
        for name in ["a", "hall/b"] {
            let (fleet, frames) = (&fleet, &frames);
            scope.spawn(move || {
                let keys = format!("sensor-{}", name.replace('/', "."));
                let uplink = fleet.sensor(0, name, &keys, None);
                send(&uplink, frames, TICK, 500);
                let summary = uplink.finish(fleet::PATIENCE);
                assert_eq!((summary.status.next, summary.unsent), (500, 0));
                assert_eq!(summary.status.stored.let_go_frames, 0);
            });
        }
    });
    until("all have come", || {
        desk.count("a") == 500 && hall.count("hall/b") == 500
    });
    until("all have come", || desk.count("hall/b") == 500);
    for (receiver, names) in [(&desk, &["a", "hall/b"][..]), (&hall, &["hall/b"])] {
        for name in names {
            assert_all(receiver, name, &frames, 500);
        }
        let report = receiver.downlink.report().unwrap();
        for sensor in &report.sensors {
            assert_eq!(
                (sensor.lost, sensor.damaged, sensor.malformed),
                (0, 0, 0),
                "{report:?}"
            );
        }
    }
    assert_eq!(hall.count("a"), 0);
    // The board of a hub knows both.
    let rows = second.board().rows();
    assert_eq!(rows.len(), 2, "{rows:?}");
}

#[test]
fn a_hub_that_is_gone_for_a_while_loses_nothing() {
    let fleet = Fleet::new(1, &["a", "b", "c"], &[("desk", "**")]);
    let hub = fleet.hub(0, &[]);
    let desk = fleet.receiver(0, "receiver-desk", "**");
    desk.connected();
    let frames = frames(400_000, Coder::Fast);
    let store = tempfile::tempdir().unwrap();
    let stop = AtomicBool::new(false);
    let sent: Vec<(String, u64, u64)> = std::thread::scope(|scope| {
        let mut threads = Vec::new();
        for name in ["a", "b", "c"] {
            let (fleet, frames, store, stop) = (&fleet, &frames, store.path(), &stop);
            threads.push(scope.spawn(move || {
                // A memory of 1 MiB: what an outage makes does not find room in it.
                let uplink =
                    fleet.sensor(0, name, &format!("sensor-{name}"), Some(&store.join(name)));
                let mut count = 0_usize;
                while !stop.load(Ordering::Relaxed) {
                    uplink
                        .send(&frames[count % frames.len()], uplink.clock().now_us())
                        .unwrap();
                    count += 1;
                    std::thread::sleep(TICK);
                }
                let status = uplink.status();
                assert!(
                    status.outages >= 1 && status.outages_us > 1_000_000,
                    "{status:?}"
                );
                let summary = uplink.finish(fleet::PATIENCE);
                assert_eq!(summary.unsent, 0);
                (name.to_owned(), count as u64, summary.status.again)
            }));
        }
        until("frames come", || {
            desk.count("a") > 100 && desk.count("c") > 100
        });
        hub.finish().unwrap();
        std::thread::sleep(Duration::from_secs(3));
        let hub = fleet.hub(0, &[]);
        desk.connected();
        let before = desk.count("a");
        until("frames come again", || desk.count("a") > before + 200);
        stop.store(true, Ordering::Relaxed);
        let sent = threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect();
        drop(hub);
        sent
    });
    for (name, count, again) in sent {
        assert!(again > 300, "{name}: {again} were asked for again");
        assert_all(&desk, &name, &frames, count as usize);
    }
    let report = desk.downlink.finish().unwrap();
    // A loaded machine may miss the link's signs of life for long enough to make it another one.
    assert!(report.outages >= 1, "{report:?}");
    for sensor in &report.sensors {
        assert_eq!(
            (sensor.lost, sensor.missing, sensor.damaged),
            (0, 0, 0),
            "{report:?}"
        );
        assert!(sensor.again > 300);
    }
}

/// A sensor that begins before there is a hub, and one that begins anew.
#[test]
fn what_was_made_without_a_link_comes_when_there_is_one() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    let frames = frames(200_000, Coder::Fast);
    let store = tempfile::tempdir().unwrap();
    let desk = fleet.receiver(0, "receiver-desk", "**");
    let uplink = fleet.sensor(0, "a", "sensor-a", Some(store.path()));
    send(&uplink, &frames, Duration::ZERO, 300);
    assert!(!uplink.is_connected());
    let hub = fleet.hub(0, &[]);
    until("all have come", || desk.count("a") == 300);
    assert_all(&desk, "a", &frames, 300);
    drop(hub);
    until("the link is down", || !uplink.is_connected());
    send(&uplink, &frames[..50], Duration::ZERO, 50);
    // The computer is switched off: what was not sent is on its disk, and comes with the next run, also where the
    // clock was set in between.
    let summary = uplink.finish(Duration::ZERO);
    assert!(summary.status.stored.disk_frames >= 50);
    std::thread::sleep(Duration::from_millis(10));
    let mut want: Vec<u64> = (0..350).collect();
    for ahead_us in [0, -HOUR_US, HOUR_US] {
        let clock = Clock::start_ahead(ahead_us);
        let uplink = fleet.sensor_with(0, "a", "sensor-a", Some(store.path()), clock);
        send(&uplink, &frames, Duration::ZERO, 10);
        let hub = fleet.hub(0, &[]);
        want.extend(0..10);
        until("all have come", || desk.count("a") == want.len());
        drop(hub);
        until("the link is down", || !uplink.is_connected());
        send(&uplink, &frames, Duration::ZERO, 5);
        want.extend(10..15);
        let _ = uplink.finish(Duration::ZERO);
    }
    let uplink = fleet.sensor(0, "a", "sensor-a", Some(store.path()));
    let _hub = fleet.hub(0, &[]);
    until("all have come", || desk.count("a") == want.len());
    drop(uplink);
    let came = desk.came.lock().unwrap();
    let numbers: Vec<u64> = came["a"].iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, want);
    drop(came);
    let report = desk.downlink.finish().unwrap();
    let sensor = &report.sensors[0];
    assert_eq!((sensor.lost, sensor.missing, sensor.before), (0, 0, 0));
    assert_eq!((sensor.at_once, sensor.runs), (1, 5));
}

const HOUR_US: i64 = 3_600_000_000;

/// The clock of a sensor's computer is an hour off, or was never set.
#[test]
fn a_clock_that_is_wrong_loses_nothing_and_delays_are_without_it() {
    let now_us = eecvs_hub::message::now_us() as i64;
    let frames = frames(100_000, Coder::Fast);
    std::thread::scope(|scope| {
        for ahead_us in [-HOUR_US, HOUR_US, -now_us, 0] {
            let frames = &frames;
            scope.spawn(move || {
                let from = |first: usize| {
                    let frames = frames.iter().cycle().skip(first).take(frames.len());
                    frames.cloned().collect()
                };
                let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
                let desk = fleet.receiver(0, "receiver-desk", "**");
                let clock = Clock::start_ahead(ahead_us);
                let uplink = fleet.sensor_with(0, "a", "sensor-a", None, clock);
                let shown_us = uplink.clock().now_us() as i64;
                let real_us = eecvs_hub::message::now_us() as i64;
                assert!((shown_us - real_us - ahead_us).abs() < 10_000_000);
                send(&uplink, frames, Duration::from_millis(1), 112);
                let hub = fleet.hub(0, &[]);
                until("the sensor is connected", || uplink.is_connected());
                let rest: Vec<_> = from(112);
                send(&uplink, &rest, TICK, 133);
                until("all have come", || desk.count("a") == 245);
                until("the clock has answered", || {
                    let row = &hub.board().rows()[0];
                    let report = desk.downlink.report().unwrap();
                    row.clock.is_some() && report.sensors[0].clock.is_some()
                });
                // Some more, so that the hub has latencies too.
                let rest: Vec<_> = from(245);
                send(&uplink, &rest, TICK, 55);
                until("all have come", || desk.count("a") == 300);
                assert_all(&desk, "a", frames, 300);
                let row = hub.board().rows().remove(0);
                let latency = row.latency.unwrap();
                let report = desk.downlink.finish().unwrap();
                let sensor = &report.sensors[0];
                let counts = (sensor.frames, sensor.missing, sensor.lost, sensor.before);
                assert_eq!(counts, (300, 0, 0, 0), "{report:?}");
                for clock in [sensor.clock.unwrap(), row.clock.unwrap()] {
                    let off_us = clock.ahead_us.abs_diff(ahead_us);
                    assert!(off_us <= clock.error_us + 1000, "{ahead_us} {clock:?}");
                    assert_eq!(clock.is_different(), ahead_us != 0);
                }
                // What they would be by the clocks alone is an hour or more.
                let most_ms = sensor.delay_max_ms.unwrap();
                assert!((-1000.0..60_000.0).contains(&most_ms), "{most_ms}");
                let range_us = -1_000_000..60_000_000;
                assert!(range_us.contains(&latency.p50_us) && range_us.contains(&latency.p99_us));
            });
        }
    });
}

/// A sensor's computer began with a clock that was never set, and was set since: the run has a number of long ago, and
/// everything else has today's times. What is wanted of it rests on how long it has been up.
#[test]
fn a_clock_that_was_set_loses_nothing() {
    let plain = Plain::new();
    let started = Instant::now();
    let options = downlink::Options::default();
    let downlink = downlink::Downlink::start(options, &plain.links, Box::new(|_| Ok(()))).unwrap();
    until("a receiver is connected", || downlink.is_connected());
    let say = |name: &str, up_us| {
        let name: Name = name.parse().unwrap();
        let status = Status {
            run: 7,
            next: 112,
            up_us,
            ..Status::default()
        };
        plain.put(&name.key(Kind::Status), status.to_bytes());
    };
    let figures = |name: &str| {
        let report = downlink.report().unwrap();
        let sensor = report.sensors.iter().find(|sensor| sensor.name == name);
        sensor.map(|sensor| (sensor.missing + sensor.lost, sensor.before))
    };
    until("what is missing is counted", || {
        say("after", started.elapsed().as_micros() as u64 / 2);
        figures("after") == Some((112, 0))
    });
    // One that began before the receiver: what it made until now is not asked for, and that is said.
    until("what is not wanted is counted", || {
        say("before", 3_600_000_000);
        figures("before") == Some((0, 112))
    });
}

/// Two sensors have one name, and one certificate: each is delivered by itself, and whole; and all say so.
#[test]
fn two_sensors_of_one_name_are_kept_apart() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    let hub = fleet.hub(0, &[]);
    let desk = fleet.receiver(0, "receiver-desk", "**");
    desk.connected();
    let frames = frames(200_000, Coder::Fast);
    // Their frames differ.
    let other: Vec<_> = frames.iter().rev().cloned().collect();
    let every = Duration::from_millis(10);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| {
            let uplink = fleet.sensor(0, "a", "sensor-a", None);
            send(&uplink, &frames, every, 700);
            uplink.finish(fleet::PATIENCE)
        });
        until("the first is heard", || desk.count("a") > 50);
        let second = scope.spawn(|| {
            // With a clock that is an hour behind, it seems to have begun before.
            let clock = Clock::start_ahead(-HOUR_US);
            let uplink = fleet.sensor_with(0, "a", "sensor-a", None, clock);
            send(&uplink, &other, every, 400);
            uplink.finish(fleet::PATIENCE)
        });
        until("the hub says so", || {
            hub.board().shared_names() == [("a".parse().unwrap(), 2)]
        });
        for summary in [first, second] {
            assert_eq!(summary.join().unwrap().unsent, 0);
        }
    });
    until("all have come", || {
        desk.count("a") == 700 && desk.count("a~2") == 400
    });
    assert_all(&desk, "a", &frames, 700);
    assert_all(&desk, "a~2", &other, 400);
    assert_eq!(hub.board().rows()[0].at_once_most, 2);
    let report = desk.downlink.finish().unwrap();
    let sensor = &report.sensors[0];
    assert_eq!((sensor.at_once, sensor.runs), (2, 2));
    assert_eq!((sensor.frames, sensor.missing, sensor.lost), (1100, 0, 0));
}

/// A sensor without a store that is started again at once is one sensor.
#[test]
fn a_sensor_that_is_started_again_is_one() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    let hub = fleet.hub(0, &[]);
    let desk = fleet.receiver(0, "receiver-desk", "**");
    desk.connected();
    let frames = frames(200_000, Coder::Fast);
    let mut want: Vec<u64> = Vec::new();
    for (start, ahead_us) in [0, -HOUR_US, HOUR_US].into_iter().enumerate() {
        let clock = Clock::start_ahead(ahead_us);
        let uplink = fleet.sensor_with(0, "a", "sensor-a", None, clock);
        until("the sensor is connected", || uplink.is_connected());
        let count = 100 + start;
        send(&uplink, &frames, TICK, count);
        want.extend(0..count as u64);
        assert_eq!(uplink.finish(Duration::from_secs(1)).unsent, 0);
    }
    until("all have come", || desk.count("a") == want.len());
    let came = desk.came.lock().unwrap();
    let numbers: Vec<u64> = came["a"].iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, want);
    assert_eq!(came.len(), 1);
    drop(came);
    let report = desk.downlink.finish().unwrap();
    let sensor = &report.sensors[0];
    assert_eq!((sensor.at_once, sensor.runs, sensor.lost), (1, 3, 0));
    assert_eq!(hub.board().rows()[0].at_once_most, 1);
}

#[test]
fn nobody_gets_or_sends_what_it_may_not() {
    let fleet = Fleet::new(1, &["a", "b"], &[("desk", "a"), ("gone", "**")]);
    // One that was taken out of the list, but has a good certificate.
    let mut access = eecvs_hub::access::Access::read(fleet.folder.path()).unwrap();
    access.receivers.remove("gone");
    access.write(fleet.folder.path()).unwrap();
    // And one of another authority.
    let others = Fleet::new(1, &["a"], &[("spy", "**")]);
    let hub = fleet.hub(0, &[]);
    let desk = fleet.receiver(0, "receiver-desk", "**");
    let own = fleet.receiver(0, "receiver-desk", "a");
    let gone = fleet.receiver(0, "receiver-gone", "**");
    // With a sensor's certificate nothing is heard, either.
    let sensor = fleet.receiver(0, "sensor-b", "**");
    let keys = others.keys("receiver-spy");
    let spy = fleet.receiver_with(0, keys.to_str().unwrap(), downlink::Options::default());
    own.connected();
    gone.connected();
    sensor.connected();
    desk.connected();
    let frames = frames(100_000, Coder::Fast);
    let uplink = fleet.sensor(0, "a", "sensor-a", None);
    // One that calls itself another: of its frames, nothing passes.
    let liar = fleet.sensor(0, "a", "sensor-b", None);
    until("both are connected", || {
        uplink.is_connected() && liar.is_connected()
    });
    for number in 0..200 {
        uplink.send(&frames[number % frames.len()], 1).unwrap();
        liar.send(&frames[(number + 1) % frames.len()], 1).unwrap();
        std::thread::sleep(TICK);
    }
    until("all have come", || own.count("a") == 200);
    drop(liar);
    let _ = uplink.finish(fleet::PATIENCE);
    assert_all(&own, "a", &frames, 200);
    let report = own.downlink.report().unwrap();
    assert_eq!(
        (report.sensors.len(), report.sensors[0].runs),
        (1, 1),
        "the liar's run is not heard"
    );
    // It asked for more than it may, and gets nothing of that.
    for (receiver, who) in [
        (&desk, "desk"),
        (&gone, "gone"),
        (&sensor, "sensor"),
        (&spy, "spy"),
    ] {
        assert_eq!(receiver.came.lock().unwrap().len(), 0, "{who}");
    }
    assert!(!spy.downlink.is_connected());
    assert_eq!(hub.board().rows().len(), 1);
}

#[test]
fn who_shows_nothing_gets_nothing() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    let _hub = fleet.hub(0, &[]);
    let desk = fleet.receiver(0, "receiver-desk", "**");
    desk.connected();
    let uplink = fleet.sensor(0, "a", "sensor-a", None);
    until("the sensor is connected", || uplink.is_connected());
    // Plain TCP, and TLS without a certificate, as Zenoh itself would.
    for (endpoint, mtls) in [
        (format!("tcp/127.0.0.1:{}", fleet.ports[0]), false),
        (fleet.endpoint(0), true),
    ] {
        let mut config = zenoh::Config::default();
        for (name, value) in [
            ("mode", "\"client\"".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
            ("connect/endpoints", format!("[{endpoint:?}]")),
            ("connect/timeout_ms", "2000".to_owned()),
            ("connect/exit_on_failure", "true".to_owned()),
        ] {
            config.insert_json5(name, &value).unwrap();
        }
        if mtls {
            let authority = fleet.keys("ca.pem");
            config
                .insert_json5(
                    "transport/link/tls/root_ca_certificate",
                    &format!("{:?}", authority.to_str().unwrap()),
                )
                .unwrap();
        }
        // It does not get in; where it seemed to, it hears nothing.
        let Ok(session) = zenoh::open(config).wait() else {
            continue;
        };
        let heard = session
            .declare_subscriber(Kind::Frames.of_all("**"))
            .wait()
            .unwrap();
        let frames = frames(50_000, Coder::Fast);
        send(&uplink, &frames, TICK, 100);
        std::thread::sleep(Duration::from_millis(300));
        assert!(heard.try_recv().unwrap().is_none(), "{endpoint}");
    }
    // Keys that are not there are said at once.
    let links = Links {
        keys: Some(fleet.keys("nobody")),
        ..fleet.links(0, "sensor-a")
    };
    let options = downlink::Options::default();
    let failed = downlink::Downlink::start(options, &links, Box::new(|_| Ok(())));
    let said = failed.err().unwrap().to_string();
    assert!(said.contains("ca.pem: no such file"), "{said}");
}

#[test]
fn garbage_changes_nothing() {
    let fleet = Fleet::new(1, &["a"], &[("desk", "**")]);
    let _hub = fleet.hub(0, &[]);
    let desk = fleet.receiver(0, "receiver-desk", "**");
    desk.connected();
    let frames = frames(200_000, Coder::Fast);
    let address = format!("127.0.0.1:{}", fleet.ports[0]);
    let uplink = fleet.sensor(0, "a", "sensor-a", None);
    let is_done = AtomicBool::new(false);
    let thrown = std::thread::scope(|scope| {
        let thrower = scope.spawn(|| {
            let mut thrown = 0;
            while !is_done.load(Ordering::Relaxed) {
                garbage(&address, thrown);
                thrown += 1;
            }
            thrown
        });
        send(&uplink, &frames, TICK, 1000);
        until("all have come", || desk.count("a") == 1000);
        is_done.store(true, Ordering::Relaxed);
        thrower.join().unwrap()
    });
    assert!(thrown > 20, "{thrown}");
    let summary = uplink.finish(fleet::PATIENCE);
    assert_eq!((summary.status.outages, summary.unsent), (0, 0));
    assert_all(&desk, "a", &frames, 1000);
}

/// A hub's budgets reach the encoder of the sensor, and a total is shared.
#[test]
fn sensors_keep_to_what_they_are_allowed() {
    let fleet = Fleet::new(1, &["a", "b"], &[]);
    let options = hub::Options {
        watch: Some("**".to_owned()),
        budgets: vec![("a".to_owned(), 50_000)],
        total: Some(300_000),
        ..hub::Options::default()
    };
    let _hub = fleet.hub_with(0, &[], options);
    let frames = frames(200_000, Coder::Fast);
    let a = fleet.sensor(0, "a", "sensor-a", None);
    let b = fleet.sensor(0, "b", "sensor-b", None);
    assert_eq!(a.budget().get(), None);
    let started = Instant::now();
    let budget = |uplink: &eecvs_hub::uplink::Uplink| uplink.budget().get().map(u32::from);
    while budget(&a) != Some(50_000) || budget(&b).is_none_or(|b| b < 200_000) {
        assert!(
            started.elapsed() < fleet::PATIENCE,
            "{:?} {:?}",
            budget(&a),
            budget(&b)
        );
        for uplink in [&a, &b] {
            send(uplink, &frames, TICK, 1);
        }
    }
    assert!(budget(&b).is_some_and(|b| b <= 300_000));
}

/// Without keys, for a network that others guard.
#[test]
fn without_keys_links_are_plain() {
    let port = port();
    let links = Links {
        connect: Vec::new(),
        listen: vec![format!("tcp/127.0.0.1:{port}")],
        keys: None,
    };
    let _hub = hub::Hub::start(hub::Options::default(), &links, None).unwrap();
    let mixed = Links {
        listen: vec![format!("tls/127.0.0.1:{port}")],
        ..links.clone()
    };
    assert!(hub::Hub::start(hub::Options::default(), &mixed, None).is_err());
    let mixed = Links {
        keys: Some("x".into()),
        ..links
    };
    assert!(hub::Hub::start(hub::Options::default(), &mixed, None).is_err());
}

/// What is missing is waited for as long as its sensor may still have it: while it is not heard, no time runs.
#[test]
fn only_a_sensor_that_is_heard_is_given_up() {
    let plain = Plain::new();
    let options = downlink::Options {
        patience: Duration::from_secs(4),
        ..downlink::Options::default()
    };
    let downlink = downlink::Downlink::start(options, &plain.links, Box::new(|_| Ok(()))).unwrap();
    until("a receiver is connected", || downlink.is_connected());
    // One that says that there are frames, and gives nobody any.
    let status = Status {
        run: eecvs_hub::message::now_us(),
        next: 100,
        ..Status::default()
    };
    let name: Name = "a".parse().unwrap();
    let say = || plain.put(&name.key(Kind::Status), status.to_bytes());
    let figures = || {
        let report = downlink.report().unwrap();
        report
            .sensors
            .first()
            .map_or((0, 0), |sensor| (sensor.missing, sensor.lost))
    };
    until("it is heard", || {
        say();
        figures() == (100, 0)
    });
    // Of the silence, the first 2.5 s count.
    std::thread::sleep(Duration::from_secs(6));
    assert_eq!(figures(), (100, 0));
    until("it is given up", || {
        say();
        figures() == (0, 100)
    });
}

/// A hub without keys, and a client of it that says what it likes.
struct Plain {
    links: Links,
    session: Arc<OnceLock<zenoh::Session>>,
    _client: Client,
    _hub: hub::Hub,
}

impl Plain {
    fn new() -> Self {
        let endpoint = format!("tcp/127.0.0.1:{}", port());
        let links = Links {
            listen: vec![endpoint.clone()],
            ..Links::default()
        };
        let hub = hub::Hub::start(hub::Options::default(), &links, None).unwrap();
        let links = Links {
            connect: vec![endpoint],
            ..Links::default()
        };
        let session: Arc<OnceLock<zenoh::Session>> = Arc::default();
        let own = Arc::clone(&session);
        let client = Client::start(&links, move |session| {
            let _ = own.set(session.clone());
            Ok(())
        })
        .unwrap();
        until("it is connected", || session.get().is_some());
        Self {
            links,
            session,
            _client: client,
            _hub: hub,
        }
    }

    fn put(&self, key: &str, bytes: Vec<u8>) {
        self.session.get().unwrap().put(key, bytes).wait().unwrap();
    }
}
