//! Senders over sockets of this host, among others that are silent, slow, strange or many.

use std::io::Write;
use std::net::{TcpStream, UdpSocket};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Instant;

use eecvs_nostd::Sensor;

use super::connections::CANDIDATES_MAX;
use super::*;
use crate::forward::datagram::Cutter;
use crate::forward::fan_out::FanOut;
use crate::forward::packet::{Packet, SYNC, WORDS_BYTES_MAX};

const GOOD: &str = "good/words";
/// Long enough for any machine; nothing waits for it.
const LONG: Duration = Duration::from_secs(60);
const WAIT: Duration = Duration::from_millis(20);

/// Packets whose sequence numbers begin at `first`.
fn packet(encoding: &str, sequence: u32, words: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let words: Vec<u8> = (0..words as u32)
        .map(|i| (i.wrapping_mul(sequence + 7) >> 3) as u8)
        .collect();
    Packet {
        encoding,
        sensor: Sensor::new(4, 4).unwrap(),
        sequence,
        time_base_us: None,
        after_loss: false,
        events: 0,
        words: &words,
    }
    .write(&mut bytes);
    bytes
}

fn packets(count: u32) -> Vec<Vec<u8>> {
    let words = |sequence: u32| (sequence as usize * 397) % 5000;
    (0..count)
        .map(|sequence| packet(GOOD, sequence, words(sequence)))
        .collect()
}

/// Takes packets of one encoding for those of use.
#[derive(Default)]
struct OfGood {
    refused: u64,
    lines: Vec<String>,
}

impl Judge for OfGood {
    fn is_of_use(&mut self, message: &Message<'_>) -> bool {
        let is_good = matches!(message, Message::Packet(packet) if packet.encoding == GOOD);
        self.refused += u64::from(!is_good);
        is_good
    }

    fn tell(&mut self, line: &str) {
        self.lines.push(line.to_owned());
    }
}

/// Those who listen, and what they have heard.
struct Ear {
    senders: Senders,
    judge: OfGood,
    heard: Vec<Vec<u8>>,
    /// The sender of the latest message.
    sender: u64,
}

impl Ear {
    fn open(kind: &str, folder: &Path, deadlines: Deadlines) -> (Self, Address) {
        let local = "127.0.0.1:0".to_owned();
        let address = match kind {
            "unix" => Address::Unix(folder.join("socket")),
            "tcp" => Address::Tcp(local),
            _ => Address::Udp(local),
        };
        let senders = Senders::open(&address, deadlines, &Stop::default()).unwrap();
        let to = match (kind, senders.local_port()) {
            ("tcp", Some(port)) => Address::Tcp(format!("127.0.0.1:{port}")),
            ("udp", Some(port)) => Address::Udp(format!("127.0.0.1:{port}")),
            _ => address,
        };
        let ear = Self {
            senders,
            judge: OfGood::default(),
            heard: Vec::new(),
            sender: 0,
        };
        (ear, to)
    }

    /// Listens once; returns whether a message came.
    fn listen(&mut self) -> bool {
        let found = self.senders.next(WAIT, &mut self.judge).unwrap();
        let Some(found) = found else {
            return false;
        };
        self.sender = found.sender;
        self.heard.push(found.bytes.to_vec());
        true
    }

    /// Takes everything that the system holds.
    fn drain(&mut self) {
        let soon = Duration::from_millis(1);
        while let Some(found) = self.senders.next(soon, &mut self.judge).unwrap() {
            self.sender = found.sender;
            self.heard.push(found.bytes.to_vec());
        }
    }

    /// Listens until this is so.
    fn until(&mut self, mut is_so: impl FnMut(&Self) -> bool) {
        let limit = Instant::now() + LONG;
        while !is_so(self) {
            self.listen();
            assert!(Instant::now() < limit, "{:?}", self.senders.tally());
        }
    }

    /// Listens until so many messages have come, and returns them.
    fn hear(&mut self, count: usize) -> Vec<Vec<u8>> {
        self.until(|ear| ear.heard.len() >= count);
        std::mem::take(&mut self.heard)
    }

    fn tally(&self) -> Tally {
        self.senders.tally()
    }

    fn has_said(&self, what: &str) -> bool {
        self.judge.lines.iter().any(|line| line.contains(what))
    }
}

fn connect(to: &Address) -> Box<dyn Write + Send> {
    match to {
        Address::Tcp(to) => Box::new(TcpStream::connect(to).unwrap()),
        Address::Unix(path) => Box::new(UnixStream::connect(path).unwrap()),
        _ => unreachable!(),
    }
}

/// Returns whether the other side has closed the connection: writes fail then, at the second one at the latest.
fn is_closed(stream: &mut dyn Write) -> bool {
    stream.write_all(&[0]).is_err()
}

fn patient() -> Deadlines {
    Deadlines {
        first_byte: LONG,
        first_message: LONG,
        idle: Some(LONG),
    }
}

#[test]
fn what_is_sent_arrives_over_every_kind_and_from_one_sender_after_the_other() {
    let folder = tempfile::tempdir().unwrap();
    for kind in ["tcp", "udp", "unix"] {
        let (mut ear, to) = Ear::open(kind, folder.path(), patient());
        let sent = packets(12);
        for round in 1..3 {
            let to = std::slice::from_ref(&to);
            let mut fan_out = FanOut::start(to, 1 << 20, false, &|| true).unwrap();
            for packet in &sent {
                fan_out.give(packet, 0);
            }
            assert!(ear.hear(sent.len()) == sent, "{kind}");
            assert_eq!(ear.sender, round, "{kind}");
            let reports = fan_out.finish(Duration::from_secs(5), &|| true, true);
            assert_eq!(reports[0].lost.messages, 0, "{kind}");
            ear.until(|ear| !ear.senders.has_sender());
        }
        let tally = Tally {
            senders: 2,
            ..Tally::default()
        };
        assert_eq!(ear.tally(), tally, "{kind}");
    }
    assert!(!folder.path().join("socket").exists());
}

#[test]
fn silent_connections_keep_nobody_out_and_are_bounded() {
    let folder = tempfile::tempdir().unwrap();
    for kind in ["tcp", "unix"] {
        let (mut ear, to) = Ear::open(kind, folder.path(), patient());
        let mut silent = Vec::new();
        for _ in 0..200 {
            silent.push(connect(&to));
            ear.listen();
            let Kind::Connections(connections) = &ear.senders.kind else {
                unreachable!();
            };
            assert!(connections.candidates() <= CANDIDATES_MAX);
        }
        // As much as the system holds for a connection that is not read yet.
        let sent = packets(30);
        let mut sender = connect(&to);
        sender.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(sent.len()) == sent, "{kind}");
        let tally = ear.tally();
        assert_eq!((tally.senders, tally.damaged_bytes), (1, 0), "{tally:?}");
        // The genuine one takes a place among the candidates.
        let kept = CANDIDATES_MAX as u64 - 1;
        assert_eq!(tally.alien_connections, 200 - kept);
        assert_eq!(tally.refused_connections, kept);
        // All the others are closed on this side, and those that come now are.
        for _ in 0..200 {
            silent.push(connect(&to));
            ear.listen();
        }
        ear.until(|ear| ear.tally().refused_connections == kept + 200);
        sender.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(sent.len()) == sent, "{kind}");
        // The lines are few.
        assert!(ear.judge.lines.len() < 20, "{:?}", ear.judge.lines);
    }
}

#[test]
fn one_that_sends_a_byte_now_and_then_and_one_that_never_ends_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let deadlines = Deadlines {
        first_message: Duration::from_millis(300),
        ..patient()
    };
    for kind in ["tcp", "unix"] {
        let (mut ear, to) = Ear::open(kind, folder.path(), deadlines);
        // Each byte belongs to a packet, which is never whole.
        let mut slow = connect(&to);
        let mut bytes = packet(GOOD, 0, 1000).into_iter();
        ear.until(|ear| {
            let _ = slow.write_all(&[bytes.next().unwrap()]);
            ear.has_said("sent no message that can be used")
        });
        assert_eq!(ear.tally().alien_connections, 1);
        // A closed socket takes one more write at most.
        while !is_closed(slow.as_mut()) {}
        assert!(ear.heard.is_empty());
        let sent = packets(20);
        let mut sender = connect(&to);
        sender.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(sent.len()) == sent, "{kind}");
    }
}

/// The beginning of the longest packet, again and again: every byte could belong to a message.
#[test]
fn an_endless_prefix_of_a_message_costs_bounded_memory_and_holds_up_nobody() {
    let folder = tempfile::tempdir().unwrap();
    for kind in ["tcp", "unix"] {
        let (mut ear, to) = Ear::open(kind, folder.path(), patient());
        let mut head = packet(GOOD, 0, 0);
        head.truncate(56);
        head[52..56].copy_from_slice(&(WORDS_BYTES_MAX as u32).to_le_bytes());
        assert_eq!(head[..2], SYNC);
        let endless: Vec<_> = (0..3)
            .map(|_| {
                let (mut stream, head) = (connect(&to), head.clone());
                std::thread::spawn(move || {
                    let chunk = head.repeat(1000);
                    let mut sent = 0;
                    while stream.write_all(&chunk).is_ok() {
                        sent += chunk.len();
                    }
                    sent
                })
            })
            .collect();
        ear.until(|ear| ear.has_said("sent too many bytes"));
        let Kind::Connections(connections) = &ear.senders.kind else {
            unreachable!();
        };
        assert!(connections.held_bytes() <= CANDIDATES_BYTES_MAX);
        let sent = packets(50);
        let mut sender = connect(&to);
        sender.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(sent.len()) == sent, "{kind}");
        // Each is closed: before the sender was there, or then.
        ear.until(|ear| {
            let tally = ear.tally();
            tally.alien_connections + tally.refused_connections == 3
        });
        for thread in endless {
            assert!(thread.join().unwrap() > 0);
        }
        assert_eq!(ear.tally().senders, 1);
    }
}

#[test]
fn the_second_sender_is_refused_with_a_word_and_comes_in_when_the_first_has_gone() {
    let folder = tempfile::tempdir().unwrap();
    for kind in ["tcp", "unix"] {
        let (mut ear, to) = Ear::open(kind, folder.path(), patient());
        let sent = packets(30);
        let mut first = connect(&to);
        first.write_all(&sent[..10].concat()).unwrap();
        assert!(ear.hear(10) == sent[..10]);
        let mut second = connect(&to);
        second.write_all(&sent.concat()).unwrap();
        ear.until(|ear| ear.tally().refused_connections == 1);
        let line = &ear.judge.lines[0];
        assert!(
            line.contains("refused") && line.contains("sends already"),
            "{line}"
        );
        while !is_closed(second.as_mut()) {}
        first.write_all(&sent[10..].concat()).unwrap();
        assert!(ear.hear(20) == sent[10..], "{kind}");
        // It ends within a message.
        first.write_all(&sent[29][..40]).unwrap();
        drop(first);
        ear.until(|ear| !ear.senders.has_sender());
        let mut second = connect(&to);
        second.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(30) == sent, "{kind}");
        let tally = ear.tally();
        assert_eq!((tally.senders, tally.damaged_bytes), (2, 40), "{tally:?}");
        assert_eq!((ear.sender, tally.alien_connections), (2, 0), "{tally:?}");
    }
}

/// A host that is switched off never closes its connection.
#[test]
fn a_silent_sender_loses_its_place_to_a_message_and_to_nothing_less() {
    let folder = tempfile::tempdir().unwrap();
    let deadlines = Deadlines {
        idle: Some(Duration::ZERO),
        ..patient()
    };
    for kind in ["tcp", "unix"] {
        let (mut ear, to) = Ear::open(kind, folder.path(), deadlines);
        let sent = packets(5);
        let mut gone = connect(&to);
        gone.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(5) == sent);
        let _silent = connect(&to);
        let mut strange = connect(&to);
        strange.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
        strange.write_all(&packet("other/words", 0, 9)).unwrap();
        ear.until(|ear| ear.judge.refused == 1);
        gone.write_all(&sent[0]).unwrap();
        assert_eq!((ear.hear(1), ear.sender), (vec![sent[0].clone()], 1));
        let mut back = connect(&to);
        back.write_all(&sent.concat()).unwrap();
        assert!(ear.hear(5) == sent, "{kind}");
        assert_eq!((ear.sender, ear.tally().senders), (2, 2));
    }
}

/// A sender of datagrams.
struct Sending {
    socket: UdpSocket,
    cutter: Cutter,
}

impl Sending {
    fn new(to: &Address, stream: u32) -> Self {
        let Address::Udp(to) = to else {
            unreachable!();
        };
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(to.as_str()).unwrap();
        Self {
            socket,
            cutter: Cutter::new(stream),
        }
    }

    /// Sends a message; its first datagrams alone if it is to be cut.
    fn send(&mut self, message: &[u8], datagrams: usize) {
        let (mut room, mut sent) = (Vec::new(), 0);
        let send = |datagram: &[u8]| {
            sent += 1;
            if sent <= datagrams {
                self.socket.send(datagram).unwrap();
            }
            Ok(())
        };
        self.cutter.cut::<()>(message, &mut room, send).unwrap();
    }
}

/// Strange datagrams, streams of others, and beginnings of messages, from many addresses.
#[test]
fn a_hundred_thousand_alien_datagrams_cost_the_sender_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ear, to) = Ear::open("udp", folder.path(), patient());
    let mut aliens: Vec<Sending> = (0..400).map(|i| Sending::new(&to, 1000 + 2 * i)).collect();
    let mut sender = Sending::new(&to, 1);
    let long = packet(GOOD, 0, 40_000);
    let mut sent = 0;
    let mut alien = |ear: &mut Ear, count: u64| {
        for _ in 0..count {
            let by = &mut aliens[(sent % 400) as usize];
            match sent % 3 {
                0 => by.send(&long, 1),
                1 => by.send(&packet("other/words", 0, 10), 1),
                _ => {
                    by.socket.send(b"anything").unwrap();
                }
            }
            sent += 1;
            // The system's buffer holds a few hundred.
            if sent % 50 == 0 {
                ear.drain();
            }
        }
        ear.drain();
    };
    alien(&mut ear, 2000);
    assert!(ear.heard.is_empty());
    let genuine = packets(980);
    for packet in &genuine {
        sender.send(packet, usize::MAX);
        alien(&mut ear, 100);
    }
    assert!(ear.heard == genuine);
    let tally = ear.tally();
    assert_eq!((tally.senders, tally.alien_datagrams), (1, 100_000));
    assert_eq!(tally.damaged_bytes, 0);
    let account = ear.senders.datagrams().unwrap();
    let lost = (
        account.lost,
        account.lost_messages,
        account.late,
        account.cut_bytes,
    );
    assert_eq!((lost, account.overflown), ((0, 0, 0, 0), Some(0)));
}

/// More addresses than there are candidates, and more streams than an address may have: nothing grows, and who sends on
/// is not forgotten.
#[test]
fn candidates_for_datagrams_are_bounded() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ear, to) = Ear::open("udp", folder.path(), patient());
    let long = packet(GOOD, 0, 40_000);
    let mut sender = Sending::new(&to, 1);
    let (mut room, mut parts) = (Vec::new(), Vec::new());
    let keep = |datagram: &[u8]| {
        parts.push(datagram.to_vec());
        Ok(())
    };
    sender.cutter.cut::<()>(&long, &mut room, keep).unwrap();
    let most = datagrams::CANDIDATES_MAX;
    let mut given = 0;
    for (at, part) in parts.iter().enumerate() {
        sender.socket.send(part).unwrap();
        // Two datagrams of its own show that more follow.
        for _ in 0..if at < 2 { 100 } else { most / 8 } {
            Sending::new(&to, 1000).send(&long, 1);
            given += 1;
            ear.drain();
            let Kind::Datagrams(datagrams) = &ear.senders.kind else {
                unreachable!();
            };
            assert!(datagrams.candidates() <= most);
        }
    }
    assert!(given > 2 * most);
    assert!(ear.heard == [long]);
    let tally = ear.tally();
    assert_eq!((tally.senders, tally.alien_datagrams), (1, given as u64));
    let (mut ear, to) = Ear::open("udp", folder.path(), patient());
    let mut one = Sending::new(&to, 1);
    for stream in 0..100 {
        one.cutter = Cutter::new(2 * stream);
        one.send(&packet(GOOD, 0, 40_000), 1);
        ear.drain();
        let Kind::Datagrams(datagrams) = &ear.senders.kind else {
            unreachable!();
        };
        assert!(datagrams.candidates() <= 2);
    }
    assert_eq!(ear.tally().alien_datagrams, 100);
}

#[test]
fn a_sender_of_datagrams_that_dies_comes_back_from_another_port() {
    let folder = tempfile::tempdir().unwrap();
    let deadlines = Deadlines {
        idle: Some(Duration::from_millis(100)),
        ..patient()
    };
    let (mut ear, to) = Ear::open("udp", folder.path(), deadlines);
    let sent = packets(20);
    let mut first = Sending::new(&to, 1);
    for packet in &sent[..10] {
        first.send(packet, usize::MAX);
    }
    assert!(ear.hear(10) == sent[..10]);
    // The last datagram that it sends begins a message.
    first.send(&packet(GOOD, 10, 5000), 1);
    let mut second = Sending::new(&to, 5);
    let (mut given, mut dropped) = (0, 0);
    while ear.sender < 2 {
        second.send(&sent[0], 1);
        given += 1;
        ear.listen();
        dropped = ear.tally().alien_datagrams;
        assert!(given < 100_000);
    }
    // Whatever came before the place was free is counted.
    assert_eq!((dropped + 1, ear.heard.len()), (given, 1));
    for packet in &sent[1..] {
        second.send(packet, usize::MAX);
    }
    assert!(ear.hear(20) == sent);
    let account = ear.senders.datagrams().unwrap();
    // Its messages are numbered from before the place was free; the first one's message that was cut is the other.
    assert_eq!(
        (account.lost, account.lost_messages),
        (dropped, dropped + 1)
    );
    assert_eq!(ear.tally().senders, 2);
}

#[test]
fn two_genuine_senders_of_datagrams_are_kept_apart() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ear, to) = Ear::open("udp", folder.path(), patient());
    let sent: Vec<_> = (0..50)
        .map(|sequence| packet(GOOD, sequence, 9000))
        .collect();
    // Both begin before either has sent a whole message.
    let (mut first, mut second) = (Sending::new(&to, 1), Sending::new(&to, 7));
    second.send(&sent[49], 3);
    for packet in &sent {
        first.send(packet, usize::MAX);
        second.send(&sent[0], usize::MAX);
        ear.drain();
    }
    let datagrams = sent[0].len().div_ceil(1380) as u64;
    // Where the machine is busy, some still wait.
    ear.until(|ear| ear.tally().alien_datagrams >= 3 + 50 * datagrams);
    assert!(ear.heard == sent);
    let (tally, account) = (ear.tally(), ear.senders.datagrams().unwrap());
    assert_eq!(tally.alien_datagrams, 3 + 50 * datagrams);
    assert_eq!((tally.senders, account.lost, account.late), (1, 0, 0));
}

#[test]
fn strange_datagrams_without_end_hold_nobody_up() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ear, to) = Ear::open("udp", folder.path(), patient());
    let sending = Sending::new(&to, 1);
    let is_over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                sending.socket.send(b"anything").unwrap();
            }
        });
        // Each of these returns although datagrams keep coming.
        for _ in 0..5 {
            assert!(!ear.listen());
        }
        is_over.store(true, std::sync::atomic::Ordering::Relaxed);
    });
    assert!(ear.tally().alien_datagrams > 0);
}

#[cfg(target_os = "linux")]
#[test]
fn the_system_tells_what_it_had_no_room_for() {
    let folder = tempfile::tempdir().unwrap();
    let (mut ear, to) = Ear::open("udp", folder.path(), patient());
    let room = ear.senders.datagrams().unwrap().granted_bytes;
    assert!(room > 0);
    assert_eq!(ear.senders.datagrams().unwrap().overflown, Some(0));
    let sending = Sending::new(&to, 1);
    let sent = 3 * room / 1000 + 10;
    for _ in 0..sent {
        sending.socket.send(&[1; 1000]).unwrap();
    }
    let overflown = ear.senders.datagrams().unwrap().overflown.unwrap();
    assert!(overflown > 0);
    ear.until(|ear| ear.tally().alien_datagrams + overflown == sent as u64);
}
