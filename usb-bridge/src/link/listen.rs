//! A link that waits for a sender: the receiving side of `tcp://`, `unix:` and `udp://`.
//!
//! Over TCP and Unix sockets, one connection at a time is the sender: the first whose bytes begin like a message
//! or, if there is none, the first that sends anything. It stays the sender until it disconnects. Until a whole
//! message has come from it, however, another connection that begins like a message replaces it if the sender did
//! not begin like one or has been silent for a second. All other connections wait, at most [`WAITING_MAX`] of them.
//! Beyond that number, the oldest that has sent nothing is closed, else the oldest that does not begin like a
//! message, else the newest.
//!
//! Over UDP, the stream that is being received stays the current one until its end arrives, or until nothing of it
//! arrives for a second. Datagrams of other streams are dropped until then, and counted.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use eecvs_nostd::frame::SYNC as FRAME_SYNC;
use socket2::{SockRef, TcpKeepalive};

use super::{Link, LinkError, Loss, Received};
use crate::forward::address::Address;
use crate::forward::datagram::{DATAGRAM_BYTES_MAX, Joiner, Messages, Part};
use crate::forward::packet::SYNC as PACKET_SYNC;
use crate::unix_socket;

/// Bytes per read.
const READ_BYTES: usize = 1 << 16;
/// Period at which connections are checked while a sender may be chosen.
const LOOK: Duration = Duration::from_millis(10);
/// Silence after which a sender that has not yet sent a whole message may be replaced.
const SILENCE: Duration = Duration::from_secs(1);
/// Most connections that wait while another one is the sender.
pub const WAITING_MAX: usize = 16;
/// Number of bytes that show whether a message begins.
const BEGIN_BYTES: usize = FRAME_SYNC.len();
/// Silence after which a TCP sender's host is probed, and the interval between probes.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// Size requested for the system's receive buffer of datagrams, in bytes.
pub const DATAGRAMS_BYTES: usize = 8 << 20;

enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, PathBuf),
    Udp(Box<Datagrams>),
}

enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

impl Stream {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.read(bytes),
            Self::Unix(stream) => stream.read(bytes),
        }
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(stream) => stream.as_fd(),
            Self::Unix(stream) => stream.as_fd(),
        }
    }

    /// Makes reads block for bytes from now on, with a timeout.
    fn block(&self) -> io::Result<()> {
        let socket = self.as_fd();
        let socket = SockRef::from(&socket);
        socket.set_nonblocking(false)?;
        socket.set_read_timeout(Some(2 * LOOK))
    }
}

/// A connection, and the bytes read from it before it became the sender.
struct Connection {
    stream: Stream,
    begin: [u8; BEGIN_BYTES],
    read: usize,
    /// Whether it began like a message; set when it becomes the sender.
    is_of_messages: bool,
    heard: Instant,
}

impl Connection {
    /// Reads its first bytes as far as they have arrived. Returns whether the connection is still of use: open, or
    /// with bytes to deliver.
    fn look(&mut self) -> bool {
        while self.read < BEGIN_BYTES {
            match self.stream.read(&mut self.begin[self.read..]) {
                Ok(0) => return self.read > 0,
                Ok(length) => self.read += length,
                Err(error) => return is_pause(&error),
            }
        }
        true
    }

    fn begins_a_message(&self) -> bool {
        self.read == BEGIN_BYTES && (self.begin == FRAME_SYNC || self.begin == PACKET_SYNC)
    }
}

/// The UDP receiver and its counts of what did not arrive.
struct Datagrams {
    socket: UdpSocket,
    joiner: Joiner,
    messages: Messages,
    /// Size of the receive buffer that the system granted, in bytes.
    granted_bytes: usize,
    lost: u64,
    late: u64,
    /// Bytes dropped because other parts of their message are missing.
    cut_bytes: u64,
    /// Whether parts are dropped until the next message begins.
    is_cut: bool,
    has_ended: bool,
    heard: Instant,
    /// Number of bytes in the buffer that are returned after the loss before them was reported.
    held: Option<usize>,
}

/// Counts of datagrams received and lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatagramAccount {
    /// Datagrams that did not arrive, or arrived too late, according to the sequence numbers of the others. This
    /// includes those sent before the first one that arrived.
    pub lost: u64,
    /// Messages lost before the first and after the last one that arrived whole.
    pub lost_messages: u64,
    /// Datagrams dropped because they were duplicates, late, of another stream, or not of this protocol.
    pub late: u64,
    /// Bytes dropped because other parts of their message are missing.
    pub cut_bytes: u64,
    /// Size of the system's receive buffer, in bytes.
    pub granted_bytes: usize,
    /// Datagrams for which the receive buffer had no room, if the system reports it.
    pub overflown: Option<u64>,
}

/// A stream from whoever sends it; one sender at a time.
pub struct Listening {
    name: String,
    listener: Listener,
    sender: Option<Connection>,
    /// Whether a whole message of use came from the current sender.
    is_proven: bool,
    waiting: VecDeque<Connection>,
    looked: Instant,
    senders: u64,
    /// Number of senders from which a whole message came.
    proven: u64,
    buffer: Vec<u8>,
}

impl Datagrams {
    fn open(at: SocketAddr) -> io::Result<Self> {
        let socket = UdpSocket::bind(at)?;
        let asked = SockRef::from(&socket).set_recv_buffer_size(DATAGRAMS_BYTES);
        let granted = SockRef::from(&socket).recv_buffer_size();
        // Linux caps the size at its limit, and reports twice the usable size to cover its own bookkeeping.
        let doubled = if cfg!(target_os = "linux") { 2 } else { 1 };
        Ok(Self {
            socket,
            joiner: Joiner::default(),
            messages: Messages::default(),
            granted_bytes: asked.and(granted).unwrap_or(0) / doubled,
            lost: 0,
            late: 0,
            cut_bytes: 0,
            is_cut: false,
            has_ended: false,
            heard: Instant::now(),
            held: None,
        })
    }

    /// Returns the number of datagrams for which the receive buffer had no room.
    fn overflown(&self) -> Option<u64> {
        let own = format!("/proc/self/fd/{}", self.socket.as_raw_fd());
        let inode = std::fs::metadata(own).ok()?.ino().to_string();
        ["/proc/net/udp", "/proc/net/udp6"].iter().find_map(|path| {
            let table = std::fs::read_to_string(path).ok()?;
            table.lines().find_map(|line| {
                let fields: Vec<&str> = line.split_whitespace().collect();
                let is_own = fields.get(9) == Some(&inode.as_str());
                fields.last().filter(|_| is_own)?.parse().ok()
            })
        })
    }

    /// Receives the next bytes into `buffer`. Returns their number, and whether something before them is missing;
    /// `None` if nothing arrived before `until`, or the stream ended.
    fn next(
        &mut self,
        buffer: &mut [u8],
        senders: &mut u64,
        until: Instant,
    ) -> io::Result<Option<(usize, bool)>> {
        let mut is_first = true;
        loop {
            // Datagrams that are dropped must not keep the loop going past its time.
            if !std::mem::take(&mut is_first) && Instant::now() >= until {
                return Ok(None);
            }
            let left = until.saturating_duration_since(Instant::now());
            self.socket
                .set_read_timeout(Some(left.max(Duration::from_millis(1))))?;
            let room = buffer.len().min(DATAGRAM_BYTES_MAX + 1);
            let length = match self.socket.recv(&mut buffer[..room]) {
                Ok(length) => length,
                Err(error) if is_pause(&error) => return Ok(None),
                Err(error) => return Err(error),
            };
            let may_change = self.has_ended || self.heard.elapsed() > SILENCE;
            let (before, part) = match self.joiner.join(&buffer[..length], may_change) {
                Part::Of {
                    message,
                    begins,
                    bytes,
                    before,
                } => (before, Some((message, begins, bytes.len()))),
                Part::End { messages, before } => {
                    self.begin(before.is_new, senders);
                    self.messages.end(messages);
                    self.has_ended = true;
                    (before, None)
                }
                Part::Late | Part::Strange => {
                    self.late += 1;
                    continue;
                }
            };
            self.heard = Instant::now();
            self.lost += u64::from(before.missing);
            let Some((message, begins, part_bytes)) = part else {
                return Ok(None);
            };
            let was_new = self.begin(before.is_new, senders);
            self.messages.see(message);
            self.has_ended = false;
            let is_gap = was_new || before.missing > 0;
            self.is_cut = (self.is_cut || is_gap) && !begins;
            if self.is_cut {
                self.cut_bytes += part_bytes as u64;
                if is_gap {
                    return Ok(Some((0, true)));
                }
                continue;
            }
            buffer.copy_within(length - part_bytes..length, 0);
            return Ok(Some((part_bytes, is_gap)));
        }
    }

    /// Begins a new stream if `is_new`; returns whether another one preceded it.
    fn begin(&mut self, is_new: bool, senders: &mut u64) -> bool {
        if is_new {
            *senders += 1;
            self.messages.begin();
        }
        is_new && *senders > 1
    }
}

impl Listening {
    /// Listens at an address.
    ///
    /// # Errors
    /// The address is in use, does not belong to this host, or cannot be listened at (a file or stdout).
    pub fn open(address: &Address) -> Result<Self, LinkError> {
        let name = address.to_string();
        let unreachable = |cause: String| LinkError::Unreachable {
            link: name.clone(),
            cause,
        };
        let io = |error: io::Error| unreachable(error.to_string());
        let listener = match address {
            Address::Tcp(at) => {
                let listener = TcpListener::bind(at.as_str()).map_err(io)?;
                listener.set_nonblocking(true).map_err(io)?;
                Listener::Tcp(listener)
            }
            Address::Unix(path) => {
                let listener = unix_socket::listen(path).map_err(io)?;
                listener.set_nonblocking(true).map_err(io)?;
                Listener::Unix(listener, path.clone())
            }
            Address::Udp(at) => {
                let at = at
                    .to_socket_addrs()
                    .map_err(io)?
                    .next()
                    .ok_or_else(|| unreachable("the host name has no address".to_owned()))?;
                Listener::Udp(Box::new(Datagrams::open(at).map_err(io)?))
            }
            Address::File(_) | Address::Stdout => {
                return Err(unreachable(
                    "nothing can be received there: use tcp://, udp:// or unix:".to_owned(),
                ));
            }
        };
        Ok(Self {
            name,
            listener,
            sender: None,
            is_proven: false,
            waiting: VecDeque::new(),
            looked: Instant::now(),
            senders: 0,
            proven: 0,
            buffer: vec![0; READ_BYTES],
        })
    }

    /// Returns the local port, also if the system chose it because port 0 was requested; `None` for a Unix socket.
    #[must_use]
    pub fn local_port(&self) -> Option<u16> {
        match &self.listener {
            Listener::Tcp(listener) => listener.local_addr().ok(),
            Listener::Udp(datagrams) => datagrams.socket.local_addr().ok(),
            Listener::Unix(..) => None,
        }
        .map(|address| address.port())
    }

    /// Returns the counts of datagrams; `None` unless this listens on UDP.
    #[must_use]
    pub fn datagrams(&self) -> Option<DatagramAccount> {
        let Listener::Udp(datagrams) = &self.listener else {
            return None;
        };
        Some(DatagramAccount {
            lost: datagrams.lost,
            lost_messages: datagrams.messages.lost(),
            late: datagrams.late,
            cut_bytes: datagrams.cut_bytes,
            granted_bytes: datagrams.granted_bytes,
            overflown: datagrams.overflown(),
        })
    }

    /// Informs the link that the bytes returned last completed a message.
    pub fn complete(&mut self) {
        if let Listener::Udp(datagrams) = &mut self.listener {
            datagrams.messages.complete();
        }
    }

    /// Informs the link that the bytes returned last completed a message of use: the sender is a genuine one.
    pub fn prove(&mut self) {
        self.complete();
        if !self.is_proven {
            self.is_proven = true;
            self.proven += 1;
        }
    }

    /// Informs the link that receiving ends here on request: a message in transit is then not counted as lost.
    pub fn forgive(&mut self) {
        if let Listener::Udp(datagrams) = &mut self.listener {
            datagrams.messages.forgive(datagrams.is_cut);
        }
    }

    fn failed(&self, error: &io::Error) -> LinkError {
        LinkError::Failed {
            link: self.name.clone(),
            cause: error.to_string(),
        }
    }

    /// Accepts the pending connections and reads their first bytes.
    fn look(&mut self) -> io::Result<()> {
        self.looked = Instant::now();
        // Bounded, so that a flood of connections cannot hold up the stream.
        for _ in 0..WAITING_MAX {
            let accepted = match &self.listener {
                Listener::Tcp(listener) => listener.accept().map(|(stream, _)| Stream::Tcp(stream)),
                Listener::Unix(listener, _) => {
                    listener.accept().map(|(stream, _)| Stream::Unix(stream))
                }
                Listener::Udp(..) => return Ok(()),
            };
            let stream = match accepted {
                Ok(stream) => stream,
                Err(error) if is_pause(&error) => break,
                // The connection was closed before it was accepted.
                Err(error) if error.kind() == ErrorKind::ConnectionAborted => continue,
                Err(error) => return Err(error),
            };
            let socket = stream.as_fd();
            let socket = SockRef::from(&socket);
            socket.set_nonblocking(true)?;
            if matches!(stream, Stream::Tcp(_)) {
                // A host that was switched off never closes its connection.
                let probes = TcpKeepalive::new()
                    .with_time(KEEPALIVE)
                    .with_interval(KEEPALIVE);
                let _ = socket.set_tcp_keepalive(&probes);
            }
            self.waiting.push_back(Connection {
                stream,
                begin: [0; BEGIN_BYTES],
                read: 0,
                is_of_messages: false,
                heard: self.looked,
            });
            self.waiting.retain_mut(Connection::look);
            if self.waiting.len() > WAITING_MAX {
                let silent = self.waiting.iter().position(|one| one.read == 0);
                let strange = || self.waiting.iter().position(|one| !one.begins_a_message());
                let last = self.waiting.len() - 1;
                self.waiting.remove(silent.or_else(strange).unwrap_or(last));
            }
        }
        self.waiting.retain_mut(Connection::look);
        Ok(())
    }

    /// Makes a waiting connection the sender if one should be; returns whether the sender changed.
    fn choose(&mut self) -> io::Result<bool> {
        let may_be_replaced = match &self.sender {
            None => true,
            Some(sender) => {
                let is_silent = sender.heard.elapsed() > SILENCE;
                !self.is_proven && (is_silent || !sender.is_of_messages)
            }
        };
        if !may_be_replaced {
            return Ok(false);
        }
        let of_messages = self.waiting.iter().position(Connection::begins_a_message);
        let of_anything = || self.waiting.iter().position(|one| one.read > 0);
        let chosen = match &self.sender {
            None => of_messages.or_else(of_anything),
            Some(_) => of_messages,
        };
        let Some(mut next) = chosen.and_then(|at| self.waiting.remove(at)) else {
            return Ok(false);
        };
        next.stream.block()?;
        next.is_of_messages = next.begins_a_message();
        next.heard = Instant::now();
        self.sender = Some(next);
        self.senders += 1;
        self.is_proven = false;
        Ok(true)
    }
}

fn bytes(bytes: &[u8]) -> Received<'_> {
    Received::Bytes {
        bytes,
        at: Instant::now(),
    }
}

const LOST: Received<'_> = Received::Lost {
    bytes: None,
    cause: Loss::Damaged,
};

/// Returns whether the error only means that nothing has arrived yet.
fn is_pause(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

impl Link for Listening {
    fn name(&self) -> &str {
        &self.name
    }

    /// Receives from the current sender. When the sender disconnects the stream does not end: the next sender is
    /// awaited, and a loss is reported between the two.
    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let until = Instant::now() + timeout;
        if let Listener::Udp(datagrams) = &mut self.listener {
            if let Some(length) = datagrams.held.take() {
                return Ok(bytes(&self.buffer[..length]));
            }
            return match datagrams.next(&mut self.buffer, &mut self.senders, until) {
                Ok(None) => Ok(Received::Nothing),
                Ok(Some((length, true))) => {
                    datagrams.held = Some(length).filter(|length| *length > 0);
                    Ok(LOST)
                }
                Ok(Some((length, false))) => Ok(bytes(&self.buffer[..length])),
                Err(error) => Err(self.failed(&error)),
            };
        }
        loop {
            let is_time = self.looked.elapsed() > LOOK;
            if self.sender.is_none() || (!self.is_proven && is_time) {
                let chosen = self.look().and_then(|()| self.choose());
                if chosen.map_err(|error| self.failed(&error))? && self.senders > 1 {
                    return Ok(LOST);
                }
            }
            let Some(sender) = &mut self.sender else {
                if Instant::now() >= until {
                    return Ok(Received::Nothing);
                }
                std::thread::sleep(LOOK);
                continue;
            };
            if sender.read > 0 {
                let length = std::mem::take(&mut sender.read);
                self.buffer[..length].copy_from_slice(&sender.begin[..length]);
                return Ok(bytes(&self.buffer[..length]));
            }
            match sender.stream.read(&mut self.buffer) {
                Ok(0) => self.sender = None,
                Ok(length) => {
                    sender.heard = Instant::now();
                    return Ok(bytes(&self.buffer[..length]));
                }
                Err(error) if is_pause(&error) => {
                    if Instant::now() >= until {
                        return Ok(Received::Nothing);
                    }
                }
                // A failed connection is treated like a closed one.
                Err(_) => self.sender = None,
            }
        }
    }

    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Err(LinkError::Failed {
            link: self.name.clone(),
            cause: "this link only receives".to_owned(),
        })
    }
}

impl Listening {
    /// Returns whether there is a sender now; over UDP, whether datagrams arrived and their stream has not ended.
    #[must_use]
    pub fn has_sender(&self) -> bool {
        match &self.listener {
            Listener::Udp(datagrams) => self.senders > 0 && !datagrams.has_ended,
            Listener::Tcp(_) | Listener::Unix(..) => self.sender.is_some(),
        }
    }

    /// Returns the number of senders so far.
    #[must_use]
    pub const fn senders(&self) -> u64 {
        self.senders
    }

    /// Returns whether a whole message of use came from any sender.
    #[must_use]
    pub const fn had_sender(&self) -> bool {
        self.proven > 0
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        if let Listener::Unix(_, path) = &self.listener {
            // A stale socket file would block the next bind to this path.
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use crate::forward::fan_out::FanOut;

    fn all(link: &mut Listening, at_least: usize) -> (Vec<u8>, usize) {
        let (mut met, mut losses) = (Vec::new(), 0);
        let until = Instant::now() + Duration::from_secs(20);
        while met.len() < at_least && Instant::now() < until {
            match link.receive(Duration::from_millis(50)).unwrap() {
                Received::Bytes { bytes, .. } => met.extend_from_slice(bytes),
                Received::Lost { .. } => losses += 1,
                Received::Nothing | Received::Ended => {}
            }
        }
        (met, losses)
    }

    #[test]
    fn what_is_sent_arrives_over_every_kind_and_from_one_sender_after_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        for kind in ["tcp", "udp", "unix"] {
            let address = match kind {
                "unix" => Address::Unix(path.clone()),
                "tcp" => Address::Tcp("127.0.0.1:0".to_owned()),
                _ => Address::Udp("127.0.0.1:0".to_owned()),
            };
            let mut link = Listening::open(&address).unwrap();
            let to = match (kind, link.local_port()) {
                ("tcp", Some(port)) => Address::Tcp(format!("127.0.0.1:{port}")),
                ("udp", Some(port)) => Address::Udp(format!("127.0.0.1:{port}")),
                _ => address,
            };
            for round in 0..2 {
                let mut fan_out = FanOut::start(std::slice::from_ref(&to), 1 << 20, false).unwrap();
                let message: Vec<u8> = (0..30_000_u32).map(|i| ((i * i) >> 3) as u8).collect();
                fan_out.give(&message, 0);
                let (met, losses) = all(&mut link, message.len());
                assert!(met == message, "{kind}, {} bytes", met.len());
                assert_eq!(losses, round, "{kind}");
                let reports = fan_out.finish(Duration::from_secs(5), true);
                assert_eq!(reports[0].lost.messages, 0, "{kind}");
            }
        }
        assert!(!path.exists());
    }

    fn listening(kind: &str, folder: &std::path::Path) -> (Listening, Address) {
        let local = "127.0.0.1:0".to_owned();
        let address = match kind {
            "unix" => Address::Unix(folder.join("socket")),
            "tcp" => Address::Tcp(local),
            _ => Address::Udp(local),
        };
        let link = Listening::open(&address).unwrap();
        let to = match (kind, link.local_port()) {
            ("tcp", Some(port)) => Address::Tcp(format!("127.0.0.1:{port}")),
            ("udp", Some(port)) => Address::Udp(format!("127.0.0.1:{port}")),
            _ => address,
        };
        (link, to)
    }

    fn connect(to: &Address) -> Box<dyn Write> {
        match to {
            Address::Tcp(to) => Box::new(TcpStream::connect(to).unwrap()),
            Address::Unix(path) => Box::new(UnixStream::connect(path).unwrap()),
            _ => unreachable!(),
        }
    }

    /// Receives until nothing arrives for a while.
    fn some(link: &mut Listening) -> Vec<u8> {
        let mut met = Vec::new();
        let until = Instant::now() + Duration::from_secs(20);
        loop {
            match link.receive(Duration::from_millis(80)).unwrap() {
                Received::Bytes { bytes, .. } => met.extend_from_slice(bytes),
                Received::Nothing if !met.is_empty() || Instant::now() > until => return met,
                _ => {}
            }
        }
    }

    fn nothing(link: &mut Listening, ms: u64) {
        let received = link.receive(Duration::from_millis(ms)).unwrap();
        assert_eq!(received, Received::Nothing);
    }

    const MESSAGE: &[u8] = &[FRAME_SYNC[0], FRAME_SYNC[1], 1, 2, 3];

    #[test]
    fn a_connection_that_is_silent_or_sends_garbage_holds_up_nobody() {
        let folder = tempfile::tempdir().unwrap();
        for kind in ["tcp", "unix"] {
            let (mut link, to) = listening(kind, folder.path());
            let silent: Vec<_> = (0..3).map(|_| connect(&to)).collect();
            nothing(&mut link, 50);
            assert!(!link.has_sender(), "{kind}");
            // No other connection sends, so whatever arrives is passed on.
            let mut strange = connect(&to);
            strange.write_all(b"GET / HTTP/1.0").unwrap();
            assert_eq!(some(&mut link), b"GET / HTTP/1.0", "{kind}");
            let mut sender = connect(&to);
            sender.write_all(MESSAGE).unwrap();
            assert_eq!(some(&mut link), MESSAGE, "{kind}");
            // Once a whole message has come, a sender keeps its place however long it is silent.
            link.prove();
            std::thread::sleep(SILENCE + Duration::from_millis(100));
            let mut other = connect(&to);
            other.write_all(MESSAGE).unwrap();
            nothing(&mut link, 80);
            sender.write_all(b"more").unwrap();
            assert_eq!(some(&mut link), b"more", "{kind}");
            drop(sender);
            assert_eq!(some(&mut link), MESSAGE, "{kind}");
            assert_eq!(link.senders(), 3);
            drop(silent);
        }
    }

    #[test]
    fn one_that_begins_and_says_no_more_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (mut link, to) = listening("unix", folder.path());
        let mut stuck = connect(&to);
        stuck.write_all(MESSAGE).unwrap();
        assert_eq!(some(&mut link), MESSAGE);
        let mut sender = connect(&to);
        sender.write_all(&[MESSAGE, b"whole"].concat()).unwrap();
        nothing(&mut link, 80);
        std::thread::sleep(SILENCE);
        assert_eq!(some(&mut link), [MESSAGE, b"whole"].concat());
    }

    #[test]
    fn connections_that_wait_are_bounded_and_the_silent_ones_go_first() {
        let folder = tempfile::tempdir().unwrap();
        let (mut link, to) = listening("tcp", folder.path());
        let _silent: Vec<_> = (0..5 * WAITING_MAX).map(|_| connect(&to)).collect();
        let mut sender = connect(&to);
        sender.write_all(MESSAGE).unwrap();
        assert_eq!(some(&mut link), MESSAGE);
        assert!(link.waiting.len() <= WAITING_MAX);
        link.prove();
        // Connections that close without sending a byte do not count as senders.
        drop(sender);
        drop(_silent);
        nothing(&mut link, 50);
        assert_eq!((link.senders(), link.has_sender()), (1, false));
    }

    #[test]
    fn strange_datagrams_without_end_hold_nobody_up() {
        let folder = tempfile::tempdir().unwrap();
        let (mut link, Address::Udp(to)) = listening("udp", folder.path()) else {
            unreachable!();
        };
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    socket.send_to(b"anything", &to).unwrap();
                }
            });
            let started = Instant::now();
            for _ in 0..3 {
                nothing(&mut link, 50);
            }
            over.store(true, std::sync::atomic::Ordering::Relaxed);
            assert!(started.elapsed() < Duration::from_secs(10));
        });
        assert!(link.datagrams().unwrap().late > 0);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_system_tells_what_it_had_no_room_for() {
        let folder = tempfile::tempdir().unwrap();
        let (mut link, Address::Udp(to)) = listening("udp", folder.path()) else {
            unreachable!();
        };
        let room = link.datagrams().unwrap().granted_bytes;
        assert!(room > 0);
        assert_eq!(link.datagrams().unwrap().overflown, Some(0));
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let sent = 3 * room / 1000 + 10;
        for _ in 0..sent {
            socket.send_to(&[1; 1000], &to).unwrap();
        }
        let overflown = link.datagrams().unwrap().overflown.unwrap();
        assert!(overflown > 0);
        while link.receive(Duration::from_millis(50)).unwrap() != Received::Nothing {}
        let late = link.datagrams().unwrap().late;
        assert_eq!(late + overflown, sent as u64);
    }
}
