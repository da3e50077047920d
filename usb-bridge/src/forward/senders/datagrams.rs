//! Senders over UDP: a stream of datagrams from one address each.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::AsRawFd;
use std::os::unix::fs::MetadataExt;
use std::time::{Duration, Instant};

use socket2::SockRef;

use super::{
    CANDIDATE_BYTES_MAX, Deadlines, Found, Judge, Tally, drop_largest, is_of_use, is_pause,
};
use crate::forward::datagram::{self, DATAGRAM_BYTES_MAX, Joiner, Messages, Part};
use crate::forward::demux::Demux;
use crate::resolve::addresses;
use crate::stop::Stop;

/// Size requested for the system's receive buffer of datagrams, in bytes.
pub const DATAGRAMS_BYTES: usize = 8 << 20;
/// Most candidates. Beyond it, the one that was silent for longest goes, those of a single datagram first.
pub const CANDIDATES_MAX: usize = 1024;
/// Most candidates of one address, which may be a second program's where the first has ended, or forged.
const OF_ADDRESS_MAX: usize = 2;

/// Counts of datagrams received and lost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DatagramAccount {
    /// Datagrams of senders that did not arrive, or arrived too late, according to the sequence numbers of the others.
    /// This includes those sent before the first one that arrived.
    pub lost: u64,
    /// Messages lost before the first and after the last one that arrived whole.
    pub lost_messages: u64,
    /// Datagrams of senders that were dropped because they were duplicates or late.
    pub late: u64,
    /// Bytes dropped because other parts of their message are missing.
    pub cut_bytes: u64,
    /// Size of the system's receive buffer, in bytes.
    pub granted_bytes: usize,
    /// Datagrams for which the receive buffer had no room, if the system reports it.
    pub overflown: Option<u64>,
}

/// What one address sends: a stream and, if it begins anew, the next ones.
struct Stream {
    from: SocketAddr,
    joiner: Joiner,
    messages: Messages,
    demux: Demux,
    lost: u64,
    late: u64,
    cut_bytes: u64,
    /// Whether parts are dropped until the next message begins.
    is_cut: bool,
    has_ended: bool,
    /// Bytes that come after a gap, until what is before it is used up.
    after_gap: Option<Vec<u8>>,
    datagrams: u64,
    bytes: u64,
    /// Streams that it began after its first one.
    begun_anew: u64,
    began: Instant,
    /// When its latest datagram arrived.
    heard: Instant,
    /// When its latest message was taken.
    messaged: Instant,
}

impl Stream {
    fn new(from: SocketAddr) -> Self {
        let now = Instant::now();
        Self {
            from,
            joiner: Joiner::default(),
            messages: Messages::default(),
            demux: Demux::default(),
            lost: 0,
            late: 0,
            cut_bytes: 0,
            is_cut: false,
            has_ended: false,
            after_gap: None,
            datagrams: 0,
            bytes: 0,
            begun_anew: 0,
            began: now,
            heard: now,
            messaged: now,
        }
    }

    /// Takes a datagram of this stream.
    fn join(&mut self, datagram: &[u8]) {
        self.heard = Instant::now();
        self.datagrams += 1;
        self.bytes += datagram.len() as u64;
        let is_first = self.datagrams == 1;
        match self.joiner.join(datagram) {
            Part::Of {
                message,
                begins,
                bytes,
                before,
            } => {
                self.lost += u64::from(before.missing);
                self.begin(before.is_new, is_first);
                self.messages.see(message);
                self.has_ended = false;
                let is_gap = (before.is_new && !is_first) || before.missing > 0;
                self.is_cut = (self.is_cut || is_gap) && !begins;
                let kept = if self.is_cut { &[] } else { bytes };
                self.cut_bytes += (bytes.len() - kept.len()) as u64;
                if is_gap {
                    self.after_gap = Some(kept.to_vec());
                } else {
                    self.demux.push(kept);
                }
            }
            Part::End { messages, before } => {
                self.lost += u64::from(before.missing);
                self.begin(before.is_new, is_first);
                self.messages.end(messages);
                self.has_ended = true;
                // Nothing will complete what has begun.
                self.after_gap = Some(Vec::new());
            }
            Part::Late | Part::Strange => self.late += 1,
        }
    }

    fn begin(&mut self, is_new: bool, is_first: bool) {
        if is_new && !is_first {
            self.begun_anew += 1;
            self.messages.begin();
        }
    }

    fn has_message(&mut self) -> bool {
        loop {
            if self.demux.has_message() {
                return true;
            }
            let Some(next) = self.after_gap.take() else {
                return false;
            };
            self.demux.interrupt();
            if self.demux.has_message() {
                self.after_gap = Some(next);
                return true;
            }
            self.demux.push(&next);
        }
    }

    /// Returns whether a message of use is next.
    fn is_proven(&mut self, judge: &mut dyn Judge) -> bool {
        while self.has_message() {
            if is_of_use(&mut self.demux, judge) {
                return true;
            }
            // None of those that were there was of use: a gap may follow.
            self.messages.complete();
        }
        false
    }

    fn account(&self, account: &mut DatagramAccount) {
        account.lost += self.lost;
        account.lost_messages += self.messages.lost();
        account.late += self.late;
        account.cut_bytes += self.cut_bytes;
    }
}

/// The socket, the sender and the candidates.
pub struct Datagrams {
    socket: UdpSocket,
    deadlines: Deadlines,
    candidates: Vec<Stream>,
    sender: Option<Stream>,
    /// Counts of senders that have left.
    account: DatagramAccount,
    buffer: Vec<u8>,
    tally: Tally,
}

impl Datagrams {
    pub(super) fn open(at: &str, deadlines: Deadlines, stop: &Stop) -> io::Result<Self> {
        let at = addresses(at, &|| !stop.is_asked())?;
        let socket = UdpSocket::bind(at.as_slice())?;
        let asked = SockRef::from(&socket).set_recv_buffer_size(DATAGRAMS_BYTES);
        let granted = SockRef::from(&socket).recv_buffer_size();
        // Linux caps the size at its limit, and reports twice the usable size to cover its own bookkeeping.
        let doubled = if cfg!(target_os = "linux") { 2 } else { 1 };
        Ok(Self {
            socket,
            deadlines,
            candidates: Vec::new(),
            sender: None,
            account: DatagramAccount {
                granted_bytes: asked.and(granted).unwrap_or(0) / doubled,
                ..DatagramAccount::default()
            },
            buffer: vec![0; DATAGRAM_BYTES_MAX + 1],
            tally: Tally::default(),
        })
    }

    pub(super) fn local_port(&self) -> Option<u16> {
        Some(self.socket.local_addr().ok()?.port())
    }

    pub(super) const fn has_sender(&self) -> bool {
        match &self.sender {
            Some(sender) => !sender.has_ended,
            None => false,
        }
    }

    pub(super) fn forgive(&mut self) -> u64 {
        let Some(sender) = &mut self.sender else {
            return 0;
        };
        sender.messages.forgive(sender.is_cut);
        sender.demux.rest_bytes() as u64
    }

    pub(super) fn tally(&self) -> Tally {
        let mut tally = self.tally;
        if let Some(sender) = &self.sender {
            tally.senders += sender.begun_anew;
            tally.damaged_bytes += sender.demux.damaged_bytes();
        }
        for candidate in &self.candidates {
            tally.alien_datagrams += candidate.datagrams;
            tally.alien_bytes += candidate.bytes;
        }
        tally
    }

    pub(super) fn account(&self) -> DatagramAccount {
        let mut account = self.account;
        if let Some(sender) = &self.sender {
            sender.account(&mut account);
        }
        account.overflown = self.overflown();
        account
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

    #[cfg(test)]
    pub(super) const fn candidates(&self) -> usize {
        self.candidates.len()
    }

    /// Returns whether there is a sender whose place nobody may take now.
    fn is_taken(&self) -> bool {
        let idle = self.deadlines.idle.unwrap_or(Deadlines::IDLE_DATAGRAMS);
        let sender = self.sender.as_ref();
        sender.is_some_and(|sender| !sender.has_ended && sender.messaged.elapsed() <= idle)
    }

    pub(super) fn next(
        &mut self,
        timeout: Duration,
        judge: &mut dyn Judge,
    ) -> io::Result<Option<Found<'_>>> {
        let until = Instant::now() + timeout;
        let mut is_first = true;
        loop {
            if self.sender.as_mut().is_some_and(Stream::has_message) {
                return Ok(self.take());
            }
            // Datagrams that are dropped must not keep the loop going past its time.
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() && !is_first {
                return Ok(None);
            }
            is_first = false;
            self.socket
                .set_read_timeout(Some(left.max(Duration::from_millis(1))))?;
            match self.socket.recv_from(&mut self.buffer) {
                Ok((length, from)) => self.sort(length, from, judge),
                Err(error) if is_pause(&error) => return Ok(None),
                Err(error) => return Err(error),
            }
        }
    }

    fn take(&mut self) -> Option<Found<'_>> {
        let sender = self.sender.as_mut()?;
        sender.messaged = Instant::now();
        sender.messages.complete();
        let (message, bytes) = sender.demux.next_with_bytes()?;
        Some(Found {
            message,
            bytes,
            sender: self.tally.senders + sender.begun_anew,
        })
    }

    /// Gives a datagram to the sender or to a candidate, or counts it as alien.
    fn sort(&mut self, length: usize, from: SocketAddr, judge: &mut dyn Judge) {
        let datagram = &self.buffer[..length];
        let Some(number) = datagram::stream_of(datagram) else {
            self.count_alien(1, length as u64);
            return;
        };
        if let Some(sender) = &mut self.sender
            && sender.from == from
            && sender.joiner.continues(number)
        {
            sender.join(datagram);
            return;
        }
        if self.is_taken() {
            self.count_alien(1, length as u64);
            return;
        }
        self.expire();
        let mut candidates = self.candidates.iter();
        let known = candidates.position(|one| one.from == from && one.joiner.continues(number));
        let at = known.unwrap_or_else(|| {
            self.make_room(from);
            self.candidates.push(Stream::new(from));
            self.candidates.len() - 1
        });
        let candidate = &mut self.candidates[at];
        candidate.join(&self.buffer[..length]);
        if candidate.is_proven(judge) {
            let next = self.candidates.remove(at);
            self.enter(next);
            return;
        }
        if candidate.bytes > CANDIDATE_BYTES_MAX {
            let gone = self.candidates.remove(at);
            self.count_alien(gone.datagrams, gone.bytes);
        }
        let held = |one: &Stream| one.demux.rest_bytes();
        if let Some(gone) = drop_largest(&mut self.candidates, held) {
            self.count_alien(gone.datagrams, gone.bytes);
        }
    }

    /// Removes the candidate that can be missed most, where there is no room for another one of an address.
    fn make_room(&mut self, from: SocketAddr) {
        let is_of_address = |one: &Stream| one.from == from;
        let candidates = self.candidates.iter();
        let of_address = candidates.filter(|one| is_of_address(one)).count();
        let is_many = of_address >= OF_ADDRESS_MAX;
        if !is_many && self.candidates.len() < CANDIDATES_MAX {
            return;
        }
        let candidates = self.candidates.iter().enumerate();
        let missed = candidates
            .filter(|(_, one)| !is_many || is_of_address(one))
            .min_by_key(|(_, one)| (one.datagrams > 1, one.heard));
        if let Some((at, _)) = missed {
            let gone = self.candidates.remove(at);
            self.count_alien(gone.datagrams, gone.bytes);
        }
    }

    /// Removes the candidates that are out of time; the first is the oldest.
    fn expire(&mut self) {
        let first_message = self.deadlines.first_message;
        let is_late = |one: &Stream| one.began.elapsed() > first_message;
        while self.candidates.first().is_some_and(is_late) {
            let gone = self.candidates.remove(0);
            self.count_alien(gone.datagrams, gone.bytes);
        }
    }

    fn enter(&mut self, next: Stream) {
        if let Some(left) = self.sender.replace(next) {
            left.account(&mut self.account);
            self.tally.senders += left.begun_anew;
            self.tally.damaged_bytes += left.demux.damaged_bytes() + left.demux.rest_bytes() as u64;
        }
        self.tally.senders += 1;
        for gone in std::mem::take(&mut self.candidates) {
            self.count_alien(gone.datagrams, gone.bytes);
        }
    }

    const fn count_alien(&mut self, datagrams: u64, bytes: u64) {
        self.tally.alien_datagrams += datagrams;
        self.tally.alien_bytes += bytes;
    }
}
