//! Every command of `eecvs-usb` ends soon after Ctrl-C or a termination signal, whatever it waits for.
//!
//! Each of these waits would last until the end of time, or for more seconds than [`SOON`]: a connection to a host that
//! does not answer, for three; a resolver that does not, for ten.

use std::net::TcpListener;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use socket2::{Domain, SockAddr, Socket, Type};

use crate::support::{CAMERA, Folder, free_port};

/// Longer than any command takes where others use the machine.
const SOON: Duration = Duration::from_millis(2500);

/// Waits until a process has set its handlers for signals, and is where it waits.
fn settled(child: &Child) {
    let status = format!("/proc/{}/status", child.id());
    let until = Instant::now() + Duration::from_secs(20);
    // SIGINT and SIGTERM.
    const HANDLED: u64 = 1 << 1 | 1 << 14;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let caught = text.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        let caught = caught.and_then(|caught| u64::from_str_radix(caught.trim(), 16).ok());
        if caught.is_some_and(|caught| caught & HANDLED == HANDLED) {
            break;
        }
        assert!(Instant::now() < until, "{text}");
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_millis(500));
}

fn ends_soon(what: &str, mut command: Command) {
    for signal in ["-INT", "-TERM"] {
        let mut child = command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        settled(&child);
        assert!(child.try_wait().unwrap().is_none(), "{what}: ended before");
        let id = child.id().to_string();
        let sent = Command::new("kill").args([signal, &id]).status().unwrap();
        assert!(sent.success());
        let until = Instant::now() + SOON;
        while child.try_wait().unwrap().is_none() {
            if Instant::now() > until {
                child.kill().unwrap();
                child.wait().unwrap();
                panic!("{what}: does not end after {signal}");
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Sockets that accept nobody, and to which a connection waits.
struct Deaf {
    _sockets: Vec<Socket>,
    port: u16,
}

impl Deaf {
    fn new(folder: &Folder) -> Self {
        let tcp = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
        let local: std::net::SocketAddr = "127.0.0.1:0".parse().unwrap();
        tcp.bind(&local.into()).unwrap();
        let unix = Socket::new(Domain::UNIX, Type::STREAM, None).unwrap();
        unix.bind(&SockAddr::unix(folder.path("deaf")).unwrap())
            .unwrap();
        let address = tcp.local_addr().unwrap();
        let port = address.as_socket().unwrap().port();
        let mut sockets = Vec::new();
        for listener in [tcp, unix] {
            listener.listen(0).unwrap();
            let address = listener.local_addr().unwrap();
            // These fill the queue of connections that nobody has accepted.
            for _ in 0..4 {
                let socket = Socket::new(address.domain(), Type::STREAM, None).unwrap();
                socket.set_nonblocking(true).unwrap();
                let _ = socket.connect(&address);
                sockets.push(socket);
            }
            sockets.push(listener);
        }
        Self {
            _sockets: sockets,
            port,
        }
    }
}

#[test]
fn a_receiver_that_waits_ends() {
    let folder = Folder::new();
    let output = ["-o", "a.eecvs", "--overwrite"];
    for kind in ["tcp", "udp"] {
        let at = format!("{kind}://127.0.0.1:{}", free_port());
        ends_soon(
            &at,
            folder.command(&[&["receive", &at], &output[..]].concat()),
        );
    }
    ends_soon(
        "unix",
        folder.command(&[&["receive", "unix:socket"], &output[..]].concat()),
    );
    assert!(!folder.path("socket").exists());
    // Somebody is connected and says nothing.
    let held = std::sync::Mutex::new(Vec::new());
    let is_over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        let (held, path, over) = (&held, folder.path("socket"), &is_over);
        scope.spawn(move || {
            while !over.load(std::sync::atomic::Ordering::Relaxed) {
                held.lock().unwrap().extend(UnixStream::connect(&path));
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let receive = [&["receive", "unix:socket"], &output[..]].concat();
        ends_soon("silent connections", folder.command(&receive));
        is_over.store(true, std::sync::atomic::Ordering::Relaxed);
    });
    assert!(!held.lock().unwrap().is_empty());
}

#[test]
fn a_sender_that_connects_or_is_not_read_ends() {
    let folder = Folder::new();
    let deaf = Deaf::new(&folder);
    let reads_nothing = TcpListener::bind("127.0.0.1:0").unwrap();
    let reads_nothing = reads_nothing.local_addr().unwrap();
    for to in [
        format!("tcp://127.0.0.1:{}", deaf.port),
        "unix:deaf".to_owned(),
        format!("tcp://{reads_nothing}"),
        format!("tcp://127.0.0.1:{}", free_port()),
    ] {
        let forward = [
            "forward", "--device", CAMERA, "--rate", "0.001x", "--to", &to,
        ];
        ends_soon(&to, folder.command(&forward));
    }
    // The stream is over, and what is queued finds nobody: the rest of the time for that is not waited for either.
    let ended = [
        &["forward", "--device", CAMERA, "--rate", "1x"],
        &["--to", "unix:deaf"][..],
    ]
    .concat();
    ends_soon("at the end", folder.command(&ended));
}

#[test]
fn other_commands_end() {
    let folder = Folder::new();
    for arguments in [
        &[
            "capture",
            "--device",
            CAMERA,
            "--rate",
            "0.001x",
            "-o",
            "a.raw",
            "--overwrite",
        ][..],
        &["simulate", "dvs128", "scene.raw", "--rate", "0.001x"],
        &["simulate", "dvs128", "scene.raw", "--usbredir", "served"],
    ] {
        ends_soon(arguments[0], folder.command(arguments));
    }
}

/// A resolver that does not answer: in a network and with a file system of its own, whose name server is an address to
/// which packets go and from which none come. Skipped where such a place cannot be made.
#[cfg(target_os = "linux")]
#[test]
fn a_look_up_that_is_not_answered_ends() {
    let folder = Folder::new();
    std::fs::write(folder.path("resolv.conf"), "nameserver 192.0.2.1\n").unwrap();
    let place = "ip link set lo up && ip route add 192.0.2.0/24 dev lo \
                 && mount --bind resolv.conf /etc/resolv.conf && exec \"$@\"";
    let inside = |arguments: &[&str]| {
        let mut command = Command::new("unshare");
        command.args([
            "--map-root-user",
            "--mount",
            "--net",
            "sh",
            "-c",
            place,
            "sh",
        ]);
        command.args(arguments).current_dir(&folder.0);
        command
    };
    let made = inside(&["true"]).stderr(Stdio::null()).status();
    if !made.is_ok_and(|made| made.success()) {
        eprintln!("skipped: no network of its own can be made here");
        return;
    }
    let program = env!("CARGO_BIN_EXE_eecvs-usb");
    for kind in ["tcp", "udp"] {
        let name = format!("{kind}://host.example:9000");
        ends_soon(
            "receive",
            inside(&[program, "receive", &name, "-o", "a.eecvs"]),
        );
        ends_soon(
            "forward",
            inside(&[
                program, "forward", "--device", CAMERA, "--rate", "0.001x", "--to", &name,
            ]),
        );
    }
}
