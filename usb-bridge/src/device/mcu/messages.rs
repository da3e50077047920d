//! Extracts frames and packets from received bytes, which may be damaged.

use eecvs::stream_buffer::StreamBuffer;
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

/// Received bytes, within the bounds of a [`StreamBuffer`].
#[derive(Debug)]
pub struct Messages {
    buffer: StreamBuffer,
}

impl Default for Messages {
    fn default() -> Self {
        Self {
            buffer: StreamBuffer::new(FRAME_BYTES_MAX),
        }
    }
}

impl Messages {
    /// Appends received bytes; call it after [`Messages::next`] has returned `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.push(bytes);
    }

    /// Returns the number of bytes that belonged to no message, and the number of runs of such bytes.
    #[must_use]
    pub const fn damaged(&self) -> (u64, u64) {
        self.buffer.damaged()
    }

    /// Returns the bytes of all damaged messages: the work of their checksums.
    #[must_use]
    pub const fn checked_bytes(&self) -> u64 {
        self.buffer.checked_bytes()
    }

    /// Returns the next whole message; `None` if more bytes are needed.
    #[expect(clippy::should_implement_trait, reason = "it lends")]
    pub fn next(&mut self) -> Option<Message<'_>> {
        loop {
            match look(self.buffer.rest()) {
                Look::Frame(header, payload, length) => {
                    self.buffer.take(length);
                    let bytes = self.buffer.last(length);
                    let (before, crc) = bytes.split_last_chunk()?;
                    let frame = Frame {
                        header,
                        payload: &before[before.len() - payload..],
                        bytes: length,
                    };
                    let crc = *crc;
                    return Some(Message::Frame { frame, crc, bytes });
                }
                Look::Packet(kind, length) => {
                    self.buffer.take(length);
                    return Some(Message::Packet(kind));
                }
                Look::Damage(skip, checked) => self.buffer.damage(skip, checked),
                Look::More => return None,
            }
        }
    }

    /// Gives up the message that has begun; other messages may lie within its bytes.
    pub fn give_up(&mut self) {
        if self.has_begun() {
            self.buffer.damage(next_sync(self.buffer.rest()), 0);
        }
    }

    /// Returns whether a message has begun.
    #[must_use]
    pub fn has_begun(&self) -> bool {
        !self.buffer.rest().is_empty()
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
