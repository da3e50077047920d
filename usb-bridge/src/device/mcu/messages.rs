//! Extracts frames and packets from received bytes, which may be damaged.

use eecvs::search_budget::SearchBudget;
use eecvs_nostd::event_link::{self, Kind, Receiver};
use eecvs_nostd::frame::CRC_BYTES;
use eecvs_nostd::{Frame, FrameError, Header, Scan, frame, scan};

/// Largest frame accepted from a microcontroller; a header that claims more is taken as damage.
pub const FRAME_BYTES_MAX: usize = 1 << 16;

/// A message in received bytes.
#[derive(Debug, Clone, Copy)]
pub enum Message<'m> {
    /// A frame.
    Frame {
        /// The parsed frame.
        frame: Frame<'m>,
        /// Its CRC-32.
        crc: [u8; CRC_BYTES],
        /// All of its bytes.
        bytes: &'m [u8],
    },
    /// A packet of the event link.
    Packet(Kind),
}

enum Look {
    /// A header, and the lengths of the payload and of the whole frame.
    Frame(Header, usize, usize),
    Packet(Kind, usize),
    /// Number of bytes to skip, and number of bytes that were checked to find that.
    Damage(usize, usize),
    More,
}

/// A buffer of received bytes; at most one frame's bytes are kept.
#[derive(Debug)]
pub struct Messages {
    buffer: Vec<u8>,
    /// Number of bytes of `buffer` that are used up.
    start: usize,
    used: u64,
    budget: SearchBudget,
    damaged_bytes: u64,
    damaged_runs: u64,
    in_damage: bool,
}

impl Default for Messages {
    fn default() -> Self {
        Self {
            buffer: Vec::new(),
            start: 0,
            used: 0,
            budget: SearchBudget::new(FRAME_BYTES_MAX),
            damaged_bytes: 0,
            damaged_runs: 0,
            in_damage: false,
        }
    }
}

impl Messages {
    /// Appends received bytes; call it after [`Messages::next`] has returned `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        // The rest is moved only when it is no longer than the used part, so that the copies cost linear time.
        if self.start >= self.buffer.len() - self.start {
            self.buffer.drain(..self.start);
            self.start = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Returns the number of bytes that belonged to no message, and the number of runs of such bytes.
    #[must_use]
    pub const fn damaged(&self) -> (u64, u64) {
        (self.damaged_bytes, self.damaged_runs)
    }

    /// Returns the bytes of all damaged messages that were searched for others.
    #[must_use]
    pub const fn searched_bytes(&self) -> u64 {
        self.budget.searched()
    }

    /// Returns the next whole message; `None` if more bytes are needed.
    #[expect(clippy::should_implement_trait, reason = "it lends")]
    pub fn next(&mut self) -> Option<Message<'_>> {
        loop {
            match look(&self.buffer[self.start..]) {
                Look::Frame(header, payload, length) => {
                    self.advance(length);
                    self.in_damage = false;
                    let crc_at = self.start - CRC_BYTES;
                    let mut crc = [0; CRC_BYTES];
                    crc.copy_from_slice(&self.buffer[crc_at..self.start]);
                    let frame = Frame {
                        header,
                        payload: &self.buffer[crc_at - payload..crc_at],
                        bytes: length,
                    };
                    let bytes = &self.buffer[self.start - length..self.start];
                    return Some(Message::Frame { frame, crc, bytes });
                }
                Look::Packet(kind, length) => {
                    self.advance(length);
                    self.in_damage = false;
                    return Some(Message::Packet(kind));
                }
                Look::Damage(skip, checked) => {
                    let is_allowed = self.budget.allows(checked as u64, self.used);
                    self.damage(if is_allowed { skip } else { checked.max(skip) });
                }
                Look::More => return None,
            }
        }
    }

    /// Gives up the message that has begun; other messages may lie within its bytes.
    pub fn give_up(&mut self) {
        let rest = &self.buffer[self.start..];
        if !rest.is_empty() {
            self.damage(next_sync(rest));
        }
    }

    /// Returns whether a message has begun.
    #[must_use]
    pub fn has_begun(&self) -> bool {
        self.start < self.buffer.len()
    }

    fn advance(&mut self, bytes: usize) {
        self.start += bytes;
        self.used += bytes as u64;
    }

    fn damage(&mut self, bytes: usize) {
        self.damaged_runs += u64::from(!self.in_damage);
        self.in_damage = true;
        self.damaged_bytes += bytes as u64;
        self.advance(bytes);
    }
}

fn look(bytes: &[u8]) -> Look {
    if bytes.starts_with(&event_link::SYNC) {
        return look_at_packet(bytes);
    }
    let bytes = &bytes[..bytes.len().min(FRAME_BYTES_MAX)];
    match scan(bytes) {
        Scan::Frame(frame) => Look::Frame(frame.header, frame.payload.len(), frame.bytes),
        Scan::Incomplete if bytes.len() < FRAME_BYTES_MAX => Look::More,
        Scan::Damage {
            error: FrameError::Damaged(length),
            ..
        } => Look::Damage(next_sync(bytes), length as usize),
        Scan::Incomplete | Scan::Damage { .. } => Look::Damage(next_sync(bytes), 0),
    }
}

fn look_at_packet(bytes: &[u8]) -> Look {
    // Packets from an encoder are rare, so each look may start from the beginning.
    let mut receiver = Receiver::new();
    for (at, byte) in bytes.iter().enumerate() {
        let kind = receiver.push(*byte).map(|packet| packet.kind);
        if receiver.damaged_bytes() > 0 {
            return Look::Damage(next_sync(bytes), at + 1);
        }
        if let Some(kind) = kind {
            return Look::Packet(kind, at + 1);
        }
    }
    Look::More
}

/// Returns the distance to the next place after the first byte where a message may begin.
fn next_sync(bytes: &[u8]) -> usize {
    let begins = |rest: &[u8]| match rest {
        [first, second, ..] => [frame::SYNC, event_link::SYNC].contains(&[*first, *second]),
        [first] => *first == frame::SYNC[0],
        [] => false,
    };
    (1..bytes.len())
        .find(|at| begins(&bytes[*at..]))
        .unwrap_or(bytes.len())
}
