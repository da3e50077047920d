//! `eecvs-usb receive` and `forward` among connections and datagrams of others: what is genuine arrives byte for byte.

use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::os::unix::net::UnixStream;
use std::process::Child;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::{
    CAMERA, EVENTS, Folder, events, frames, free_port, json, listening, read, shifted, sorted,
};

const SILENT: usize = 200;
const LONG: Duration = Duration::from_secs(60);

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let limit = Instant::now() + LONG;
    while !is_so() {
        assert!(Instant::now() < limit, "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A place for a receiver, of a kind.
struct At {
    to: String,
    kind: &'static str,
    port: u16,
}

impl At {
    fn new(kind: &'static str, folder: &Folder) -> Self {
        let port = free_port();
        let to = match kind {
            "unix" => format!("unix:{}", folder.path("socket").display()),
            _ => format!("{kind}://127.0.0.1:{port}"),
        };
        Self { to, kind, port }
    }

    /// Waits until somebody listens.
    fn ready(&self) {
        match self.kind {
            "unix" => until("nobody listens", || {
                UnixStream::connect(&self.to["unix:".len()..]).is_ok()
            }),
            kind => listening(self.port, kind),
        }
    }

    /// Returns whether somebody else has the place of the sender: then a connection is refused with a word.
    fn is_taken(&self) -> bool {
        let mut word = [0; 100];
        let wait = Some(Duration::from_millis(200));
        let length = match self.kind {
            "unix" => {
                let mut stream = UnixStream::connect(&self.to["unix:".len()..]).unwrap();
                stream.set_read_timeout(wait).unwrap();
                stream.read(&mut word)
            }
            _ => {
                let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
                stream.set_read_timeout(wait).unwrap();
                stream.read(&mut word)
            }
        };
        let word = String::from_utf8_lossy(&word[..length.unwrap_or(0)]).into_owned();
        word.starts_with("refused: ") && word.contains("sends already")
    }

    fn connect(&self) -> Box<dyn Write> {
        match self.kind {
            "unix" => Box::new(UnixStream::connect(&self.to["unix:".len()..]).unwrap()),
            _ => Box::new(TcpStream::connect(("127.0.0.1", self.port)).unwrap()),
        }
    }
}

/// Number of files that a process has open.
#[cfg(target_os = "linux")]
fn open_files(child: &Child) -> usize {
    let files = format!("/proc/{}/fd", child.id());
    std::fs::read_dir(files).unwrap().count()
}

#[cfg(not(target_os = "linux"))]
fn open_files(_: &Child) -> usize {
    0
}

fn ended(child: Child, status: i32) -> (Value, String) {
    let output = child.wait_with_output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{told}");
    (serde_json::from_slice(&output.stdout).unwrap(), told)
}

#[test]
fn silent_and_strange_connections_keep_no_sender_out() {
    let folder = Folder::new();
    for kind in ["tcp", "unix"] {
        let at = At::new(kind, &folder);
        let name = format!("{kind}.eecvs");
        let receiver = folder.start(&["receive", &at.to, "-o", &name, "--once", "--json"]);
        at.ready();
        let before = open_files(&receiver);
        let silent: Vec<_> = (0..SILENT).map(|_| at.connect()).collect();
        let mut strange = at.connect();
        strange.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
        let said = folder.json(&[
            "forward", "--device", CAMERA, "--rate", "max", "--to", &at.to, "--json",
        ]);
        assert_eq!(said["consumers"][0]["lost"]["messages"], 0, "{said}");
        assert!(open_files(&receiver) <= before + 80);
        let (said, told) = ended(receiver, 0);
        for what in ["lost_messages", "damaged_bytes", "skipped_messages"] {
            assert_eq!(said[what], 0, "{said}");
        }
        assert_eq!(
            (&said["senders"], &said["alien_bytes"]),
            (&1.into(), &18.into())
        );
        let count = |what: &str| said[what].as_u64().unwrap() as usize;
        let others = count("alien_connections") + count("refused_connections");
        // That which found out whether somebody listens was one more.
        assert_eq!(others, SILENT + 1 + usize::from(kind == "unix"), "{said}");
        assert!(told.contains("left out a connection"), "{told}");
        assert!(told.lines().count() < 25, "{told}");
        assert_eq!(shifted(read(&folder.path(&name))), sorted(events()));
        drop((silent, strange));
    }
}

/// All datagrams of a stream of frames, with those of its end.
fn datagrams(folder: &Folder) -> Vec<Vec<u8>> {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(LONG)).unwrap();
    let to = format!("udp://{}", socket.local_addr().unwrap());
    let child = folder.start(&["forward", "--device", CAMERA, "--to", &to, "--json"]);
    let (mut all, mut ends) = (Vec::new(), 0);
    while ends < 3 {
        let mut bytes = vec![0; 2000];
        let length = socket.recv(&mut bytes).unwrap();
        bytes.truncate(length);
        ends += usize::from(bytes[3] & 2 != 0);
        all.push(bytes);
    }
    json(&child.wait_with_output().unwrap());
    all
}

/// Bytes that wait in the receive buffer of a port.
fn waiting(port: u16) -> usize {
    let table = std::fs::read_to_string("/proc/net/udp").unwrap();
    let local = format!(": 0100007F:{port:04X} ");
    let line = table.lines().find(|line| line.contains(&local));
    let queues = line.unwrap().split_whitespace().nth(4).unwrap();
    usize::from_str_radix(queues.split_once(':').unwrap().1, 16).unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn a_hundred_thousand_alien_datagrams_change_no_byte() {
    const ALIENS: usize = 100_000;
    let folder = Folder::new();
    let genuine = datagrams(&folder);
    let at = At::new("udp", &folder);
    let receiver = folder.start(&["receive", &at.to, "-o", "a.eecvs", "--once", "--json"]);
    at.ready();
    let bind = |_| UdpSocket::bind("127.0.0.1:0").unwrap();
    let others: Vec<UdpSocket> = (0..100).map(bind).collect();
    let sender = bind(0);
    let mut sent = 0;
    let mut alien = |count: usize| {
        for _ in 0..count {
            // Not of this protocol, or a stream of its own: its beginning, or a message of another program.
            let mut bytes = genuine[0].clone();
            match sent % 4 {
                0 => bytes = b"anything".to_vec(),
                1 => bytes[4..8].copy_from_slice(&(sent as u32).to_le_bytes()),
                2 => bytes.truncate(100),
                _ => bytes[16..].fill(0xEE),
            }
            // None is whole.
            *bytes.last_mut().unwrap() ^= 1;
            let by = &others[sent % others.len()];
            by.send_to(&bytes, ("127.0.0.1", at.port)).unwrap();
            sent += 1;
            if sent % 100 == 0 {
                until("it takes them", || waiting(at.port) < 100_000);
            }
        }
    };
    // A tenth before the sender begins, and the rest among its datagrams; after its end nobody is awaited.
    let parts = genuine.len() - 3;
    let each = (ALIENS - ALIENS / 10) / parts;
    alien(ALIENS - each * parts);
    for (number, datagram) in genuine.iter().enumerate() {
        if number < parts {
            alien(each);
        }
        sender.send_to(datagram, ("127.0.0.1", at.port)).unwrap();
    }
    let (said, _) = ended(receiver, 0);
    assert_eq!(said["alien_datagrams"], ALIENS, "{said}");
    for what in [
        "lost_datagrams",
        "late_datagrams",
        "overflown_datagrams",
        "lost_messages",
        "damaged_bytes",
    ] {
        assert_eq!(said[what], 0, "{what}: {said}");
    }
    assert_eq!(said["senders"], 1, "{said}");
    let bytes: Vec<u8> = genuine
        .iter()
        .flat_map(|part| part[16..].to_vec())
        .collect();
    assert!(frames(&folder.path("a.eecvs")) == bytes);
}

/// The second one is told, and sends nothing in vain: it waits with what it has, and comes in when the first has gone.
#[test]
fn of_two_senders_the_second_is_refused_with_a_word() {
    let folder = Folder::new();
    for kind in ["tcp", "unix"] {
        let at = At::new(kind, &folder);
        let name = format!("{kind}.eecvs");
        let receiver = folder.start(&["receive", &at.to, "-o", &name, "--once", "--json"]);
        at.ready();
        let forward = ["forward", "--device", CAMERA, "--json", "--to", &at.to];
        let first = folder.start(&[&forward[..], &["--rate", "0.1x"]].concat());
        until("it has the first sender", || at.is_taken());
        let second = folder.run(&forward);
        let told = String::from_utf8(second.stderr).unwrap();
        assert!(told.contains("sends already"), "{told}");
        let said: Value = serde_json::from_slice(&second.stdout).unwrap();
        let consumer = &said["consumers"][0];
        assert_eq!(consumer["sent"]["events"], 0, "{said}");
        assert_eq!(consumer["lost"]["events"], EVENTS, "{said}");
        let said = json(&first.wait_with_output().unwrap());
        assert_eq!(said["consumers"][0]["lost"]["messages"], 0, "{said}");
        let (said, told) = ended(receiver, 0);
        assert!(told.contains("refused a connection"), "{told}");
        assert!(said["refused_connections"].as_u64().unwrap() > 0, "{said}");
        assert_eq!(
            (&said["senders"], &said["damaged_bytes"]),
            (&1.into(), &0.into())
        );
        assert_eq!(shifted(read(&folder.path(&name))), sorted(events()));
    }
}

/// A killed sender's connection is closed by the system: the next one, from another port, has the place at once.
#[test]
fn a_killed_sender_is_followed_by_the_next() {
    let folder = Folder::new();
    for kind in ["tcp", "unix"] {
        let at = At::new(kind, &folder);
        let name = format!("{kind}.eecvs");
        let receiver = folder.start(&["receive", &at.to, "-o", &name, "--json"]);
        at.ready();
        let forward = ["forward", "--device", CAMERA, "--json", "--to", &at.to];
        let mut first = folder.start(&[&forward[..], &["--rate", "0.1x"]].concat());
        until("it has the first sender", || at.is_taken());
        first.kill().unwrap();
        first.wait().unwrap();
        let said = folder.json(&forward);
        assert_eq!(said["consumers"][0]["lost"]["messages"], 0, "{said}");
        assert_eq!(said["consumers"][0]["sent"]["events"], EVENTS, "{said}");
        // It has read the end of the second one.
        until("it has no sender", || !at.is_taken());
        let id = receiver.id().to_string();
        let sent = std::process::Command::new("kill")
            .args(["-INT", &id])
            .status();
        assert!(sent.unwrap().success());
        let output = receiver.wait_with_output().unwrap();
        let received: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(received["senders"], 2, "{received}");
        let events = received["events"].as_u64().unwrap();
        assert!(events > EVENTS as u64, "{received}");
    }
}

/// A connection that is given up by the deadlines of the command.
#[test]
fn deadlines_are_those_of_the_command() {
    let folder = Folder::new();
    let at = At::new("tcp", &folder);
    let receive = ["receive", &at.to, "-o", "a.eecvs", "--once", "--json"];
    let deadlines = [
        "--first-byte-s",
        "0.2",
        "--first-message-s",
        "0.2",
        "--idle-s",
        "3",
    ];
    let receiver = folder.start(&[&receive[..], &deadlines].concat());
    at.ready();
    let silent = at.connect();
    let mut slow = at.connect();
    until("it is closed", || slow.write_all(&[0xEE]).is_err());
    folder.json(&["forward", "--device", CAMERA, "--to", &at.to, "--json"]);
    let (said, told) = ended(receiver, 0);
    assert_eq!(said["alien_connections"], 2, "{said}");
    assert!(told.contains("within the time"), "{told}");
    assert_eq!(said["events"], EVENTS, "{said}");
    drop(silent);
}

/// What came may have been meant for the file, if nothing else came.
#[test]
fn a_receiver_of_strangers_alone_fails() {
    let folder = Folder::new();
    let at = At::new("tcp", &folder);
    let receive = [
        "receive",
        &at.to,
        "-o",
        "a.eecvs",
        "--json",
        "--duration-s",
        "1",
    ];
    let receiver = folder.start(&receive);
    at.ready();
    at.connect().write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    let (said, told) = ended(receiver, 1);
    assert_eq!(
        (&said["alien_bytes"], &said["senders"]),
        (&18.into(), &0.into())
    );
    assert!(
        told.contains("nothing that the file can hold arrived"),
        "{told}"
    );
}
