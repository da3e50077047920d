//! The nodes over Zenoh.

use std::net::TcpListener;
use std::path::Path;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use crate::pipeline::{Network, counted, scene, through_programs};
use crate::program::{PATIENCE, Program, free_port};
use eecvs_ros::message::{Density, EventPacket, Frame, Message};
use eecvs_ros::names::NodeName;
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::graph::{key_of, tokens_of};
use eecvs_ros::transport::zenoh::{Links, Router, Zenoh};
use eecvs_ros::transport::{Qos, Transport};
use zenoh::Wait;

/// An endpoint of this computer at which nobody listens.
fn free() -> String {
    format!("tcp/127.0.0.1:{}", free_port())
}

/// Two routers, the second of which connects to the first.
fn chain() -> ([Router; 2], [String; 2]) {
    let endpoints = [free(), free()];
    let first = Links {
        listen: vec![endpoints[0].clone()],
        ..Links::default()
    };
    let second = Links {
        listen: vec![endpoints[1].clone()],
        connect: vec![endpoints[0].clone()],
        ..Links::default()
    };
    let routers = [first, second].map(|links| Router::start(&links).unwrap());
    (routers, endpoints)
}

#[test]
fn every_event_comes_through_two_routers() {
    let (routers, endpoints) = chain();
    let program = Path::new(env!("CARGO_BIN_EXE_eecvs-ros"));
    let network = Network {
        domain: 0,
        routers: Some(endpoints),
    };
    let want = counted(&scene(400_000));
    let encode = ["--window-us", "10000"];
    let got = through_programs(program, &network, &encode, 400_000);
    assert!(counted(&got) == want, "{} events", got.len());
    drop(routers);
}

/// A router that connects to somebody who accepts it and says nothing ends soon after a signal.
#[test]
fn a_router_ends_whatever_it_connects_to() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = silent.local_addr().unwrap().port();
    let (connect, listen) = (format!("tcp/127.0.0.1:{port}"), free());
    let line = ["router", "--listen", &listen, "--connect", &connect];
    let router = Program::eecvs_ros(0, &line);
    let connected = silent.accept().unwrap();
    router.terminate();
    // It took six seconds; half of that leaves room for a busy computer.
    router.finish(Duration::from_secs(3));
    drop(connected);
}

/// A session of a test at one router.
fn join(domain: u16, endpoint: &str) -> Zenoh {
    let links = Links {
        connect: vec![endpoint.to_owned()],
        ..Links::default()
    };
    Zenoh::join(domain, &links).unwrap()
}

/// Waits until something is so.
fn until(what: &str, is_so: impl Fn() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < Duration::from_secs(20), "{what}");
        thread::sleep(Duration::from_millis(10));
    }
}

const QOS: Qos = Qos {
    depth: 100,
    reliable: true,
};

/// Seen by a session that knows nothing of us.
#[test]
fn messages_and_tokens_are_as_ros_has_them() {
    let (_routers, [_, endpoint]) = chain();
    let config = format!("{{mode: \"client\", connect: {{endpoints: [{endpoint:?}]}}}}");
    let other = zenoh::open(zenoh::Config::from_json5(&config).unwrap())
        .wait()
        .unwrap();
    let tokens = other
        .liveliness()
        .declare_subscriber(tokens_of(7))
        .history(true)
        .wait()
        .unwrap();
    let messages = other
        .declare_subscriber(key_of(7, "/a/frames", Frame::TYPE))
        .wait()
        .unwrap();
    let transport = join(7, &endpoint);
    let name = NodeName::new("/a", "encode").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let mut publisher = node.publisher("/a/frames", Frame::TYPE, QOS).unwrap();
    let next_token = || {
        let sample = tokens.recv_timeout(Duration::from_secs(10)).unwrap();
        sample.expect("a token").key_expr().to_string()
    };
    let (node_token, end_token) = (next_token(), next_token());
    assert!(node_token.ends_with("/0/0/NN/%/%a/encode"), "{node_token}");
    assert!(end_token.contains("/0/1/MP/%/%a/encode/%a%frames/eecvs_msgs::msg::dds_::Frame_/"));
    assert!(end_token.ends_with("/::,100:,:,:,,"), "{end_token}");

    for number in 1..=3_u8 {
        publisher.publish(&[number; 5]).unwrap();
        let sample = messages.recv_timeout(Duration::from_secs(10)).unwrap();
        let sample = sample.expect("a message");
        assert_eq!(sample.payload().to_bytes(), vec![number; 5]);
        let attachment = sample.attachment().unwrap().to_bytes().into_owned();
        assert_eq!(attachment.len(), 33);
        assert_eq!(attachment[..8], i64::from(number).to_le_bytes());
        let publisher = twox_hash::XxHash3_128::oneshot(end_token.as_bytes());
        assert_eq!(attachment[16], 16);
        assert_eq!(attachment[17..], publisher.to_le_bytes());
    }
}

/// Topics of another domain, name or type do not meet; ends are counted where they are, and no longer when gone.
#[test]
fn ends_find_each_other_across_routers() {
    let (_routers, [send, receive]) = chain();
    let [here, there, elsewhere] = [join(3, &send), join(3, &receive), join(4, &send)];
    let name = NodeName::new("/", "a").unwrap();
    let mut nodes =
        [&here, &there, &elsewhere].map(|zenoh| zenoh.node(&name, &Parameters::none()).unwrap());
    let mut publisher = nodes[0].publisher("/x", EventPacket::TYPE, QOS).unwrap();
    let mut subscribe = |at: usize, topic, kind| nodes[at].subscription(topic, kind, QOS).unwrap();
    let mut wanted = subscribe(1, "/x", EventPacket::TYPE);
    let mut own = subscribe(0, "/x", EventPacket::TYPE);
    let mut others = [
        subscribe(1, "/y", EventPacket::TYPE),
        subscribe(2, "/x", EventPacket::TYPE),
        subscribe(1, "/x", Density::TYPE),
    ];
    // The density's is one of the topic, too, by its name.
    until("three subscriptions", || publisher.subscribers() == 3);
    until("a publisher", || wanted.publishers() == 1);
    // Routes are told apart from tokens.
    thread::sleep(Duration::from_millis(500));
    for number in 0..100_u8 {
        publisher.publish(&[number]).unwrap();
    }
    for number in 0..100_u8 {
        for end in [&mut wanted, &mut own] {
            let taken = end.take(Duration::from_secs(10)).unwrap();
            assert_eq!(taken, Some(vec![number]));
        }
    }
    for other in &mut others {
        assert_eq!(other.take(Duration::from_millis(50)).unwrap(), None);
    }
    drop((wanted, own, others));
    until("none any more", || publisher.subscribers() == 0);
}

/// A router that ends takes messages with it; what is published afterwards comes by its successor.
#[test]
fn links_are_made_anew() {
    let endpoint = free();
    let links = Links {
        listen: vec![endpoint.clone()],
        ..Links::default()
    };
    let router = Router::start(&links).unwrap();
    let client = |domain| {
        let links = Links {
            connect: vec![endpoint.clone()],
            ..Links::default()
        };
        Zenoh::join(domain, &links).unwrap()
    };
    let [from, to] = [client(5), client(5)];
    let name = NodeName::new("/", "a").unwrap();
    let mut publisher = from
        .node(&name, &Parameters::none())
        .unwrap()
        .publisher("/x", EventPacket::TYPE, QOS)
        .unwrap();
    let mut subscription = to
        .node(&name, &Parameters::none())
        .unwrap()
        .subscription("/x", EventPacket::TYPE, QOS)
        .unwrap();
    until("a subscription", || publisher.subscribers() == 1);
    drop(router);
    thread::sleep(Duration::from_millis(500));
    let router = Router::start(&links).unwrap();
    let (done, is_done) = mpsc::channel();
    let sends = thread::spawn(move || {
        for number in 0_u32.. {
            publisher.publish(&number.to_le_bytes()).unwrap();
            if is_done.recv_timeout(Duration::from_millis(10)).is_ok() {
                return;
            }
        }
    });
    let taken = subscription.take(Duration::from_secs(20)).unwrap();
    assert!(taken.is_some(), "nothing comes any more");
    done.send(()).unwrap();
    sends.join().unwrap();
    drop(router);
}

/// More subscribers than Zenoh has threads by itself: closing the links to them takes a thread each for ten seconds.
#[test]
fn subscribers_that_hang_cost_no_messages_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("zenoh.json5");
    // Links are given up soon; what is published before has filled them. Bursts find room, as by our own settings.
    let settings = "{scouting: {multicast: {enabled: false}}, listen: {endpoints: [\"tcp/localhost:0\"]}, \
                    transport: {link: {tx: {lease: 3000, queue: {size: {data: 16}}}}}}";
    std::fs::write(&config, settings).unwrap();
    let endpoint = free();
    let links = Links {
        listen: vec![endpoint.clone()],
        ..Links::default()
    };
    let _router = Router::start(&links).unwrap();
    let start = |node: &str| {
        let mut arguments: Vec<&str> = node.split(' ').collect();
        let config = config.to_str().unwrap();
        arguments.extend(["--transport", "zenoh", "--connect", &endpoint]);
        arguments.extend(["--zenoh-config", config]);
        Program::eecvs_ros(8, &arguments)
    };
    let hang: Vec<Program> = (0..4).map(|_| start("decode")).collect();
    let encode = start("encode --window-us 4000");
    thread::sleep(Duration::from_secs(1));
    let emulate = start("emulate --repeat --wait-s 20");
    thread::sleep(Duration::from_secs(3));
    hang.iter().for_each(Program::stop);
    thread::sleep(Duration::from_secs(8));
    emulate.terminate();
    let (_, sent) = emulate.finish(PATIENCE);
    thread::sleep(Duration::from_secs(1));
    encode.terminate();
    let (_, came) = encode.finish(PATIENCE);
    assert!(came.contains(" messages (0 lost, "), "{sent}{came}");
    drop(hang);
}
