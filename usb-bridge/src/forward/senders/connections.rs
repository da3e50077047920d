//! Senders over TCP and Unix sockets: a connection each.

use std::io::{self, ErrorKind, Read};
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use socket2::{SockRef, TcpKeepalive};

use super::{
    CANDIDATE_BYTES_MAX, Deadlines, Found, Judge, Tally, drop_largest, is_of_use, is_pause,
};
use crate::forward::demux::Demux;
use crate::forward::refusal;
use crate::resolve::addresses;
use crate::stop::Stop;
use crate::unix_socket;

/// Bytes per read.
const READ_BYTES: usize = 1 << 16;
/// Most reads from a candidate before the next one has its turn.
const READS: usize = 4;
/// Period at which the listener and the candidates are looked at.
const LOOK: Duration = Duration::from_millis(10);
/// Most candidates. Beyond it, the oldest that has sent nothing is closed, else the one that was silent for longest.
pub const CANDIDATES_MAX: usize = 64;
/// Most connections that are accepted before the sender has its turn.
const ACCEPTED_MAX: usize = 256;
/// Silence after which a TCP sender's host is probed, and the interval between probes.
const KEEPALIVE: Duration = Duration::from_secs(10);

enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, PathBuf),
}

impl Listener {
    fn accept(&self) -> io::Result<(Stream, String)> {
        match self {
            Self::Tcp(listener) => {
                let (stream, from) = listener.accept()?;
                Ok((Stream::Tcp(stream), from.to_string()))
            }
            Self::Unix(listener, _) => {
                let (stream, _) = listener.accept()?;
                Ok((Stream::Unix(stream), "a program of this host".to_owned()))
            }
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            // A stale socket file would stay in the folder.
            let _ = std::fs::remove_file(path);
        }
    }
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

    /// Says why the connection is closed.
    fn refuse(&mut self, why: &str) {
        match self {
            Self::Tcp(stream) => refusal::send(stream, why),
            Self::Unix(stream) => refusal::send(stream, why),
        }
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(stream) => stream.as_fd(),
            Self::Unix(stream) => stream.as_fd(),
        }
    }

    /// Makes reads return at once while nothing has come, as for a candidate.
    fn prepare(&self) -> io::Result<()> {
        let socket = self.as_fd();
        let socket = SockRef::from(&socket);
        if matches!(self, Self::Tcp(_)) {
            // A host that was switched off never closes its connection.
            let probes = TcpKeepalive::new()
                .with_time(KEEPALIVE)
                .with_interval(KEEPALIVE);
            let _ = socket.set_tcp_keepalive(&probes);
        }
        socket.set_nonblocking(true)
    }

    /// Makes reads wait for bytes from now on, with a timeout, as for the sender.
    fn block(&self) -> io::Result<()> {
        let socket = self.as_fd();
        let socket = SockRef::from(&socket);
        socket.set_nonblocking(false)?;
        socket.set_read_timeout(Some(2 * LOOK))
    }
}

struct Connection {
    stream: Stream,
    from: String,
    demux: Demux,
    /// Bytes read from it.
    bytes: u64,
    since: Instant,
    /// When its first byte was read.
    began: Option<Instant>,
    /// When its latest byte was read.
    heard: Instant,
    /// When its latest message was taken.
    messaged: Instant,
    /// Whether nothing more will come.
    is_over: bool,
}

impl Connection {
    fn new(stream: Stream, from: String) -> Self {
        let now = Instant::now();
        Self {
            stream,
            from,
            demux: Demux::default(),
            bytes: 0,
            since: now,
            began: None,
            heard: now,
            messaged: now,
            is_over: false,
        }
    }

    /// Reads once. Returns whether something came or the connection ended.
    fn read(&mut self, buffer: &mut [u8]) -> bool {
        match self.stream.read(buffer) {
            Ok(0) => self.is_over = true,
            Ok(length) => {
                self.demux.push(&buffer[..length]);
                self.bytes += length as u64;
                self.heard = Instant::now();
                self.began.get_or_insert(self.heard);
            }
            Err(error) if is_pause(&error) => return false,
            // A failed connection is treated like a closed one.
            Err(_) => self.is_over = true,
        }
        true
    }

    /// Reads what has come from a candidate; returns whether a message of use is next.
    fn is_proven(&mut self, buffer: &mut [u8], judge: &mut dyn Judge) -> bool {
        for _ in 0..READS {
            if self.is_over || !self.read(buffer) {
                break;
            }
            if is_of_use(&mut self.demux, judge) {
                return true;
            }
        }
        while self.is_over && self.demux.rest_bytes() > 0 {
            self.demux.interrupt();
            if is_of_use(&mut self.demux, judge) {
                return true;
            }
        }
        false
    }

    /// Says why the connection is closed, after reading what has come: unread bytes would cost the other side the word.
    fn refuse(&mut self, why: &str, buffer: &mut [u8]) {
        for _ in 0..READS {
            match self.stream.read(buffer) {
                Ok(length @ 1..) => self.bytes += length as u64,
                Ok(0) | Err(_) => break,
            }
        }
        self.stream.refuse(why);
    }

    /// Returns why a candidate is given up, if it is.
    fn failure(&self, deadlines: &Deadlines) -> Option<&'static str> {
        if self.is_over {
            return Some("closed the connection without a message that can be used");
        }
        if self.bytes > CANDIDATE_BYTES_MAX {
            return Some("sent too many bytes without a message that can be used");
        }
        match self.began {
            None => (self.since.elapsed() > deadlines.first_byte)
                .then_some("sent nothing within the time for the first byte"),
            Some(began) => (began.elapsed() > deadlines.first_message)
                .then_some("sent no message that can be used within the time for the first one"),
        }
    }
}

/// The listener, the sender and the candidates.
pub struct Connections {
    listener: Listener,
    deadlines: Deadlines,
    candidates: Vec<Connection>,
    sender: Option<Connection>,
    looked: Option<Instant>,
    buffer: Vec<u8>,
    tally: Tally,
}

impl Connections {
    pub(super) fn tcp(at: &str, deadlines: Deadlines, stop: &Stop) -> io::Result<Self> {
        let at = addresses(at, &|| !stop.is_asked())?;
        let listener = TcpListener::bind(at.as_slice())?;
        listener.set_nonblocking(true)?;
        Ok(Self::new(Listener::Tcp(listener), deadlines))
    }

    pub(super) fn unix(path: &Path, deadlines: Deadlines) -> io::Result<Self> {
        let listener = unix_socket::listen(path)?;
        listener.set_nonblocking(true)?;
        let listener = Listener::Unix(listener, path.to_owned());
        Ok(Self::new(listener, deadlines))
    }

    fn new(listener: Listener, deadlines: Deadlines) -> Self {
        Self {
            listener,
            deadlines,
            candidates: Vec::new(),
            sender: None,
            looked: None,
            buffer: vec![0; READ_BYTES],
            tally: Tally::default(),
        }
    }

    pub(super) fn local_port(&self) -> Option<u16> {
        match &self.listener {
            Listener::Tcp(listener) => Some(listener.local_addr().ok()?.port()),
            Listener::Unix(..) => None,
        }
    }

    pub(super) const fn has_sender(&self) -> bool {
        self.sender.is_some()
    }

    pub(super) fn unfinished_bytes(&self) -> u64 {
        let sender = self.sender.as_ref();
        sender.map_or(0, |sender| sender.demux.rest_bytes() as u64)
    }

    pub(super) fn tally(&self) -> Tally {
        let mut tally = self.tally;
        if let Some(sender) = &self.sender {
            tally.damaged_bytes += sender.demux.damaged_bytes();
        }
        for candidate in &self.candidates {
            tally.alien_connections += 1;
            tally.alien_bytes += candidate.bytes;
        }
        tally
    }

    #[cfg(test)]
    pub(super) const fn candidates(&self) -> usize {
        self.candidates.len()
    }

    #[cfg(test)]
    pub(super) fn held_bytes(&self) -> usize {
        let candidates = self.candidates.iter();
        candidates.map(|one| one.demux.rest_bytes()).sum()
    }

    /// Returns whether there is a sender whose place nobody may take now.
    fn is_taken(&self) -> bool {
        let idle = self.deadlines.idle.unwrap_or(Deadlines::IDLE_CONNECTION);
        let sender = self.sender.as_ref();
        sender.is_some_and(|sender| sender.messaged.elapsed() <= idle)
    }

    pub(super) fn next(&mut self, timeout: Duration, judge: &mut dyn Judge) -> Option<Found<'_>> {
        let until = Instant::now() + timeout;
        loop {
            let had_sender = self.sender.is_some();
            if self.has_message() {
                return self.take();
            }
            // The caller may want no other one.
            if had_sender && self.sender.is_none() {
                return None;
            }
            let is_time = self.looked.is_none_or(|looked| looked.elapsed() > LOOK);
            if (self.sender.is_none() || is_time) && self.look(judge) {
                continue;
            }
            let now = Instant::now();
            if now >= until {
                return None;
            }
            match &mut self.sender {
                None => thread::sleep(LOOK.min(until - now)),
                Some(sender) => {
                    sender.read(&mut self.buffer);
                }
            }
        }
    }

    /// Returns whether a message of the sender is there. A sender that has ended, and whose bytes are used up, leaves.
    fn has_message(&mut self) -> bool {
        let Some(sender) = &mut self.sender else {
            return false;
        };
        if sender.demux.has_message() {
            return true;
        }
        if sender.is_over {
            sender.demux.interrupt();
            if sender.demux.has_message() {
                return true;
            }
            self.retire();
        }
        false
    }

    fn take(&mut self) -> Option<Found<'_>> {
        let sender = self.sender.as_mut()?;
        sender.messaged = Instant::now();
        let (message, bytes) = sender.demux.next_with_bytes()?;
        Some(Found {
            message,
            bytes,
            sender: self.tally.senders,
        })
    }

    fn retire(&mut self) {
        if let Some(sender) = self.sender.take() {
            self.tally.damaged_bytes +=
                sender.demux.damaged_bytes() + sender.demux.rest_bytes() as u64;
        }
    }

    /// Accepts and refuses connections, and listens to the candidates. Returns whether one is now the sender.
    fn look(&mut self, judge: &mut dyn Judge) -> bool {
        self.looked = Some(Instant::now());
        let is_taken = self.is_taken();
        if is_taken {
            for candidate in std::mem::take(&mut self.candidates) {
                self.refuse(candidate, judge);
            }
        }
        for _ in 0..ACCEPTED_MAX {
            let (stream, from) = match self.listener.accept() {
                Ok(accepted) => accepted,
                Err(error) if is_pause(&error) => break,
                // The connection was closed before it was accepted.
                Err(error) if error.kind() == ErrorKind::ConnectionAborted => continue,
                Err(error) => {
                    // Too many open files, in this process or in the system: whoever waits longest makes room.
                    self.make_room(&error.to_string(), judge);
                    break;
                }
            };
            let connection = Connection::new(stream, from);
            if connection.stream.prepare().is_err() {
                continue;
            }
            if is_taken {
                self.refuse(connection, judge);
            } else {
                self.candidates.push(connection);
                if self.candidates.len() > CANDIDATES_MAX {
                    self.make_room("there are too many connections", judge);
                }
            }
        }
        !is_taken && self.choose(judge)
    }

    /// Closes the candidate that can be missed most.
    fn make_room(&mut self, why: &str, judge: &mut dyn Judge) {
        let candidates = self.candidates.iter().enumerate();
        let missed = candidates.min_by_key(|(_, one)| (one.bytes > 0, one.heard));
        if let Some((at, _)) = missed {
            let gone = self.candidates.remove(at);
            self.give_up(gone, why, judge);
        }
    }

    /// Reads from all candidates, and closes those that are out of time; returns whether one has become the sender.
    fn choose(&mut self, judge: &mut dyn Judge) -> bool {
        let mut at = 0;
        while let Some(candidate) = self.candidates.get_mut(at) {
            if candidate.is_proven(&mut self.buffer, judge) {
                let next = self.candidates.remove(at);
                if next.stream.block().is_ok() {
                    self.enter(next, judge);
                    return true;
                }
                continue;
            }
            match candidate.failure(&self.deadlines) {
                None => at += 1,
                Some(why) => {
                    let gone = self.candidates.remove(at);
                    self.give_up(gone, why, judge);
                }
            }
            let held = |one: &Connection| one.demux.rest_bytes();
            if let Some(gone) = drop_largest(&mut self.candidates, held) {
                self.give_up(gone, "the connections hold too many bytes", judge);
                at = 0;
            }
        }
        false
    }

    fn enter(&mut self, next: Connection, judge: &mut dyn Judge) {
        self.retire();
        self.tally.senders += 1;
        self.sender = Some(next);
        for candidate in std::mem::take(&mut self.candidates) {
            self.refuse(candidate, judge);
        }
    }

    /// Refuses a connection while there is a sender.
    fn refuse(&mut self, connection: Connection, judge: &mut dyn Judge) {
        let sender = self.sender.as_ref().map_or("", |sender| &sender.from);
        let why = format!("{sender} sends already");
        self.close(connection, &why, true, judge);
    }

    /// Gives up a candidate.
    fn give_up(&mut self, connection: Connection, why: &str, judge: &mut dyn Judge) {
        self.close(connection, why, false, judge);
    }

    /// Closes a connection with a word, and counts it.
    fn close(
        &mut self,
        mut connection: Connection,
        why: &str,
        is_refused: bool,
        judge: &mut dyn Judge,
    ) {
        connection.refuse(why, &mut self.buffer);
        self.tally.alien_bytes += connection.bytes;
        let (count, did) = match is_refused {
            true => (&mut self.tally.refused_connections, "refused"),
            false => (&mut self.tally.alien_connections, "left out"),
        };
        *count += 1;
        // Few lines, however many come.
        if count.is_power_of_two() {
            let from = connection.from;
            judge.tell(&format!(
                "{did} a connection of {from}: {why} ({count} {did} so far)"
            ));
        }
    }
}
