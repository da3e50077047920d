//! Frames and packets in received bytes, which may be damaged.

use eecvs_nostd::event_link::{self, Kind, Receiver};
use eecvs_nostd::frame::CRC_BYTES;
use eecvs_nostd::{Frame, FrameError, Header, Scan, frame, scan};

/// Largest frame of a microcontroller that is believed: one that claims to be longer is damage.
pub const FRAME_BYTES_MAX: usize = 1 << 16;
/// Bytes of damaged frames that are searched for others: so many, and [`RESCANS`] times those received. Only
/// frames made to lie inside of each other reach it, whose checksums would cost the square of their length.
const RESCAN_BYTES: u64 = 4 * FRAME_BYTES_MAX as u64;
const RESCANS: u64 = 4;

/// What stands in received bytes.
#[derive(Debug, Clone, Copy)]
pub enum Message<'m> {
    /// A frame.
    Frame {
        /// What it says.
        frame: Frame<'m>,
        /// Its CRC-32.
        crc: [u8; CRC_BYTES],
        /// All of its bytes.
        bytes: &'m [u8],
    },
    /// A packet.
    Packet(Kind),
}

enum Look {
    /// A header, and the lengths of the payload and of the frame.
    Frame(Header, usize, usize),
    Packet(Kind, usize),
    /// Bytes to leave out, and those that were checked for it.
    Damage(usize, usize),
    More,
}

/// Received bytes: at most a frame's are kept.
#[derive(Debug, Default)]
pub struct Messages {
    buffer: Vec<u8>,
    /// Bytes of `buffer` used up.
    start: usize,
    used: u64,
    rescanned: u64,
    damaged_bytes: u64,
    damaged_runs: u64,
    in_damage: bool,
}

impl Messages {
    /// Takes received bytes, after [`Messages::next`] has returned `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        // Moving what is left only when it is no more than what was used up keeps the copies linear.
        if self.start >= self.buffer.len() - self.start {
            self.buffer.drain(..self.start);
            self.start = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Bytes that belonged to no message, and runs of them.
    #[must_use]
    pub const fn damaged(&self) -> (u64, u64) {
        (self.damaged_bytes, self.damaged_runs)
    }

    /// The next whole message; `None` where more bytes are needed.
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
                    self.rescanned += checked as u64;
                    let is_cheap = self.rescanned <= RESCAN_BYTES + RESCANS * self.used;
                    self.damage(if is_cheap { skip } else { checked.max(skip) });
                }
                Look::More => return None,
            }
        }
    }

    /// Gives up the message that has begun; others may lie inside of what came of it.
    pub fn give_up(&mut self) {
        let rest = &self.buffer[self.start..];
        if !rest.is_empty() {
            self.damage(next_sync(rest));
        }
    }

    /// Whether a message has begun.
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
    // Packets from an encoder are few: each look may begin anew.
    let mut receiver = Receiver::new();
    for (at, byte) in bytes.iter().enumerate() {
        let kind = receiver.push(*byte).map(|packet| packet.kind);
        if receiver.damaged_bytes() > 0 {
            return Look::Damage(next_sync(bytes), 0);
        }
        if let Some(kind) = kind {
            return Look::Packet(kind, at + 1);
        }
    }
    Look::More
}

/// Distance to the next place, not the first, where a message may begin.
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
