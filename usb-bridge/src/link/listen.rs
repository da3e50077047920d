//! A link that waits for a sender: `tcp://`, `unix:` and `udp://` from the receiving side.
//!
//! Of connections, one at a time is the sender: the first whose bytes begin as a message does, or, where there is
//! none, the first that sends anything. It stays the sender until it goes. As long as no message came from it,
//! another one that begins as a message does takes its place, if it began otherwise or has been silent for a
//! second. All others wait, at most [`WAITING_MAX`]; beyond, the oldest that has sent nothing is closed.
//!
//! Of datagrams, a stream is the sender's until its end has come, or nothing has for a second. Those of others are
//! left out until then, and counted.

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

/// Bytes read at a time.
const READ_BYTES: usize = 1 << 16;
/// Wait between two looks for a sender.
const LOOK: Duration = Duration::from_millis(10);
/// How long a sender from which no message came may be silent while another one has begun.
const SILENCE: Duration = Duration::from_secs(1);
/// Connections that wait behind the sender.
pub const WAITING_MAX: usize = 16;
/// Bytes that tell whether a message begins.
const BEGIN_BYTES: usize = FRAME_SYNC.len();
/// After how long a silence a TCP sender's host is asked whether it is still there, and how often.
const KEEPALIVE: Duration = Duration::from_secs(10);
/// Bytes that the system is asked to keep of datagrams while nobody takes them.
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

    /// Waits for bytes from now on, for a while.
    fn block(&self) -> io::Result<()> {
        let socket = self.as_fd();
        let socket = SockRef::from(&socket);
        socket.set_nonblocking(false)?;
        socket.set_read_timeout(Some(2 * LOOK))
    }
}

/// A connection, and what was read of it before it became the sender.
struct Connection {
    stream: Stream,
    begin: [u8; BEGIN_BYTES],
    read: usize,
    /// Of the sender: whether it began as a message does.
    is_of_messages: bool,
    heard: Instant,
}

impl Connection {
    /// Reads its first bytes, where they are there; whether it is still there itself.
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

/// Datagrams, and what is known of those that did not come.
struct Datagrams {
    socket: UdpSocket,
    joiner: Joiner,
    messages: Messages,
    /// Bytes that the system keeps.
    granted_bytes: usize,
    lost: u64,
    late: u64,
    /// Bytes of messages of which others are missing.
    cut_bytes: u64,
    /// Parts are left out until a message begins.
    is_cut: bool,
    has_ended: bool,
    heard: Instant,
    /// Bytes that came, until the loss before them has been told.
    held: Option<usize>,
}

/// What is known of datagrams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatagramAccount {
    /// Datagrams that never came, or too late, as the numbers of the others tell; also those that the sender had
    /// sent before the first that came.
    pub lost: u64,
    /// Messages before the first and after the last that came whole.
    pub lost_messages: u64,
    /// Datagrams that came twice, late, or from elsewhere, and were left out.
    pub late: u64,
    /// Bytes that were left out: of messages of which others are missing.
    pub cut_bytes: u64,
    /// Bytes of datagrams that the system keeps while nobody takes them.
    pub granted_bytes: usize,
    /// Datagrams that the system had no room for, where it tells.
    pub overflown: Option<u64>,
}

/// A stream, whoever sends it; one sender at a time.
pub struct Listening {
    name: String,
    listener: Listener,
    sender: Option<Connection>,
    /// Whether a message came from the sender.
    is_proven: bool,
    waiting: VecDeque<Connection>,
    looked: Instant,
    senders: u64,
    /// Senders from which a message came.
    proven: u64,
    buffer: Vec<u8>,
}

impl Datagrams {
    fn open(at: SocketAddr) -> io::Result<Self> {
        let socket = UdpSocket::bind(at)?;
        let asked = SockRef::from(&socket).set_recv_buffer_size(DATAGRAMS_BYTES);
        let granted = SockRef::from(&socket).recv_buffer_size();
        // Linux gives what its limit allows, and doubles it for what it keeps beside the bytes.
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

    /// Datagrams that the system had no room for.
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

    /// The next bytes in `buffer`, and whether something before them did not come; `None` in time.
    fn next(
        &mut self,
        buffer: &mut [u8],
        senders: &mut u64,
        until: Instant,
    ) -> io::Result<Option<(usize, bool)>> {
        let mut is_first = true;
        loop {
            // Datagrams of which nothing comes through are no reason to stay.
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

    /// Another stream begins; whether one was before it.
    fn begin(&mut self, is_new: bool, senders: &mut u64) -> bool {
        if is_new {
            *senders += 1;
            self.messages.begin();
        }
        is_new && *senders > 1
    }
}

impl Listening {
    /// Waits at an address.
    ///
    /// # Errors
    /// The address is taken, is not one of this host, or cannot be waited at.
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
                let listener = UnixListener::bind(path).map_err(io)?;
                listener.set_nonblocking(true).map_err(io)?;
                Listener::Unix(listener, path.clone())
            }
            Address::Udp(at) => {
                let at = at
                    .to_socket_addrs()
                    .map_err(io)?
                    .next()
                    .ok_or_else(|| unreachable("the name has no address".to_owned()))?;
                Listener::Udp(Box::new(Datagrams::open(at).map_err(io)?))
            }
            Address::File(_) | Address::Stdout => {
                return Err(unreachable(
                    "nobody sends there: use tcp://, udp:// or unix:".to_owned(),
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

    /// Where it waits: the port that the system chose, where 0 was asked for.
    #[must_use]
    pub fn local_port(&self) -> Option<u16> {
        match &self.listener {
            Listener::Tcp(listener) => listener.local_addr().ok(),
            Listener::Udp(datagrams) => datagrams.socket.local_addr().ok(),
            Listener::Unix(..) => None,
        }
        .map(|address| address.port())
    }

    /// What is known of datagrams, where they are what comes.
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

    /// Says that a whole message was in what came last: the sender is one.
    pub fn prove(&mut self) {
        if let Listener::Udp(datagrams) = &mut self.listener {
            datagrams.messages.complete();
        }
        if !self.is_proven {
            self.is_proven = true;
            self.proven += 1;
        }
    }

    /// Says that the end is wished for: the message that is coming is not lost.
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

    /// Takes the connections that have come, and their first bytes.
    fn look(&mut self) -> io::Result<()> {
        self.looked = Instant::now();
        // At most so many at a time: whoever connects without end is not to hold up what comes.
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
                // It had gone before it was taken.
                Err(error) if error.kind() == ErrorKind::ConnectionAborted => continue,
                Err(error) => return Err(error),
            };
            let socket = stream.as_fd();
            let socket = SockRef::from(&socket);
            socket.set_nonblocking(true)?;
            if matches!(stream, Stream::Tcp(_)) {
                // A host that was switched off never says that it has gone.
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

    /// Makes a connection the sender, where one is to be; whether there is another one now.
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

/// Whether nothing came, but might soon.
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

    /// A sender that goes is not the end: the next one is waited for, and a loss told between them.
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
                // As if it had gone.
                Err(_) => self.sender = None,
            }
        }
    }

    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Err(LinkError::Failed {
            link: self.name.clone(),
            cause: "only receives".to_owned(),
        })
    }
}

impl Listening {
    /// Whether somebody is sending now; of datagrams, whether any came and their end did not.
    #[must_use]
    pub fn has_sender(&self) -> bool {
        match &self.listener {
            Listener::Udp(datagrams) => self.senders > 0 && !datagrams.has_ended,
            Listener::Tcp(_) | Listener::Unix(..) => self.sender.is_some(),
        }
    }

    /// Senders so far.
    #[must_use]
    pub const fn senders(&self) -> u64 {
        self.senders
    }

    /// Whether a message came from any sender.
    #[must_use]
    pub const fn had_sender(&self) -> bool {
        self.proven > 0
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        if let Listener::Unix(_, path) = &self.listener {
            // The name would stay and be taken the next time.
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

    /// What comes until nothing does for a while.
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
            // Nobody else sends: what comes is taken for what it is.
            let mut strange = connect(&to);
            strange.write_all(b"GET / HTTP/1.0").unwrap();
            assert_eq!(some(&mut link), b"GET / HTTP/1.0", "{kind}");
            let mut sender = connect(&to);
            sender.write_all(MESSAGE).unwrap();
            assert_eq!(some(&mut link), MESSAGE, "{kind}");
            // A message came: nobody takes its place while it is there, however long it is silent.
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
        // Those that come and go without a byte are none.
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
