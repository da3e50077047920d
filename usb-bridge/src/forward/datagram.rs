//! Datagrams: a stream of messages in numbered parts, so that what is lost is known to the datagram and to
//! the message. Little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 2 | sync EE C9 |
//! | 1 | version, 1 |
//! | 1 | flags: bit 0 a message begins with the part, bit 1 the stream ends |
//! | 4 | stream: a number that is chosen anew whenever a sender starts; one more where it found that nobody listened |
//! | 4 | number of the datagram in the stream, from 0, wrapping |
//! | 4 | number of its message in the stream, from 0, wrapping; at the end the number of messages |
//! | n | the next bytes of the message, 1 to [`PART_BYTES_MAX`]; none at the end |
//!
//! The datagram of the end has the number that the next one would have, and comes several times. A datagram
//! that comes late, after one that overtook it, is left out: its place is lost already.

use zerocopy::byteorder::little_endian::U32;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// First bytes of a datagram.
const SYNC: [u8; 2] = [0xEE, 0xC9];
const VERSION: u8 = 1;
const BEGINS: u8 = 1;
const ENDS: u8 = 2;
/// Bytes before a datagram's part.
const HEAD_BYTES: usize = size_of::<Head>();
/// Most bytes of a part: what Ethernet takes without cutting it.
pub const PART_BYTES_MAX: usize = 1400 - HEAD_BYTES;
/// Bytes of the longest datagram.
pub const DATAGRAM_BYTES_MAX: usize = HEAD_BYTES + PART_BYTES_MAX;

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Head {
    sync: [u8; 2],
    version: u8,
    flags: u8,
    stream: U32,
    number: U32,
    message: U32,
}

/// Cuts a stream.
#[derive(Debug, Clone, Copy)]
pub struct Cutter {
    stream: u32,
    number: u32,
    message: u32,
}

impl Cutter {
    /// Before the first byte of stream number `stream`.
    #[must_use]
    pub const fn new(stream: u32) -> Self {
        Self {
            stream,
            number: 0,
            message: 0,
        }
    }

    /// Begins the sender's next stream.
    pub const fn begin_anew(&mut self) {
        *self = Self::new(self.stream.wrapping_add(1));
    }

    /// Whether nothing was cut yet.
    #[must_use]
    pub const fn is_at_start(&self) -> bool {
        self.number == 0 && self.message == 0
    }

    /// Gives the datagrams of a message to `send`, one after the other, until that fails.
    ///
    /// # Errors
    /// Those of `send`.
    pub fn cut<E>(
        &mut self,
        message: &[u8],
        datagram: &mut Vec<u8>,
        mut send: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut flags = BEGINS;
        for part in message.chunks(PART_BYTES_MAX) {
            self.write(flags, part, datagram);
            self.number = self.number.wrapping_add(1);
            flags = 0;
            send(datagram)?;
        }
        self.message = self.message.wrapping_add(1);
        Ok(())
    }

    /// Makes the datagram that ends the stream.
    pub fn end(&self, datagram: &mut Vec<u8>) {
        self.write(ENDS, &[], datagram);
    }

    fn write(&self, flags: u8, part: &[u8], datagram: &mut Vec<u8>) {
        let head = Head {
            sync: SYNC,
            version: VERSION,
            flags,
            stream: self.stream.into(),
            number: self.number.into(),
            message: self.message.into(),
        };
        datagram.clear();
        datagram.extend_from_slice(head.as_bytes());
        datagram.extend_from_slice(part);
    }
}

/// What a datagram brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part<'d> {
    /// Bytes of a message.
    Of {
        /// Number of the message in the stream.
        message: u32,
        /// Whether it begins with them.
        begins: bool,
        /// The bytes.
        bytes: &'d [u8],
        /// What came, or did not, before.
        before: Before,
    },
    /// The stream has ended.
    End {
        /// Messages of the stream.
        messages: u32,
        /// What came, or did not, before.
        before: Before,
    },
    /// A datagram that came twice or late, or of a stream that is not the one that comes.
    Late,
    /// Not a datagram of a stream.
    Strange,
}

/// What is known of the datagrams before one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Before {
    /// Datagrams of the same stream that did not come since the one before; of a new stream, since its
    /// beginning.
    pub missing: u32,
    /// Whether the stream is another than that of the one before.
    pub is_new: bool,
}

/// Puts a stream together again.
#[derive(Debug, Clone, Copy, Default)]
pub struct Joiner {
    stream: Option<u32>,
    next: u32,
}

impl Joiner {
    /// Takes a datagram. The next stream of the same sender goes on from the one that comes; that of another one
    /// only where `may_change`.
    pub fn join<'d>(&mut self, datagram: &'d [u8], may_change: bool) -> Part<'d> {
        let Ok((head, bytes)) = Head::ref_from_prefix(datagram) else {
            return Part::Strange;
        };
        let ends = head.flags & ENDS != 0;
        let is_whole = bytes.len() <= PART_BYTES_MAX && bytes.is_empty() == ends;
        if head.sync != SYNC || head.version != VERSION || !is_whole {
            return Part::Strange;
        }
        let (stream, number) = (head.stream.get(), head.number.get());
        let is_new = self.stream != Some(stream);
        let is_next = |current: u32| stream == current.wrapping_add(1);
        if is_new && !may_change && !self.stream.is_none_or(is_next) {
            return Part::Late;
        }
        let missing = if is_new {
            number
        } else {
            number.wrapping_sub(self.next)
        };
        if !is_new && missing >= 1 << 31 {
            return Part::Late;
        }
        self.stream = Some(stream);
        let before = Before { missing, is_new };
        if ends {
            self.next = number;
            return Part::End {
                messages: head.message.get(),
                before,
            };
        }
        self.next = number.wrapping_add(1);
        Part::Of {
            message: head.message.get(),
            begins: head.flags & BEGINS != 0,
            bytes,
            before,
        }
    }
}

/// What is missing of the messages of a stream, by their numbers.
///
/// Those between two that came whole are not counted here: their own numbers tell them, and also those that
/// were never sent.
#[derive(Debug, Clone, Copy, Default)]
pub struct Messages {
    /// Of streams that are over.
    lost: u64,
    /// One more than the latest of which something came, or the number of all where the end has come.
    seen: u32,
    /// One more than the latest that came whole.
    whole: u32,
}

impl Messages {
    /// Another stream begins: of the one before, nothing comes any more.
    pub const fn begin(&mut self) {
        self.lost = self.lost();
        self.seen = 0;
        self.whole = 0;
    }

    /// Something of message number `message` came.
    pub const fn see(&mut self, message: u32) {
        self.seen = message.wrapping_add(1);
    }

    /// The stream has ended with so many.
    pub const fn end(&mut self, messages: u32) {
        self.seen = messages;
    }

    /// The message that was seen last is whole.
    pub const fn complete(&mut self) {
        if self.whole == 0 {
            self.lost = self.lost.saturating_add(self.seen.saturating_sub(1) as u64);
        }
        self.whole = self.seen;
    }

    /// Nothing more is taken: the message that was seen last would have become whole, unless a part of it
    /// `is_lost`.
    pub const fn forgive(&mut self, is_lost: bool) {
        if !is_lost && self.seen.wrapping_sub(self.whole) > 0 {
            self.seen = self.seen.wrapping_sub(1);
        }
    }

    /// Messages that are missing before the first and after the last that came whole, of every stream.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        let after = self.seen.wrapping_sub(self.whole);
        // A number that falls back is no stream's.
        let after = if after < 1 << 31 { after } else { 0 };
        self.lost.saturating_add(after as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The datagrams of messages of so many parts each, and the one of the end.
    fn datagrams(cutter: &mut Cutter, parts: &[usize]) -> Vec<Vec<u8>> {
        let (mut all, mut room) = (Vec::new(), Vec::new());
        for (i, parts) in parts.iter().enumerate() {
            let message = vec![i as u8; (parts - 1) * PART_BYTES_MAX + 1];
            cutter
                .cut::<()>(&message, &mut room, |datagram| {
                    all.push(datagram.to_vec());
                    Ok(())
                })
                .unwrap();
        }
        cutter.end(&mut room);
        all.push(room);
        all
    }

    #[test]
    fn every_order_is_told() {
        let mut cutter = Cutter::new(9);
        cutter.number = u32::MAX - 1;
        let datagrams = datagrams(&mut cutter, &[1, 2, 1, 1, 1]);
        let mut joiner = Joiner {
            stream: Some(9),
            next: u32::MAX - 1,
        };
        let rooms: Vec<[u8; PART_BYTES_MAX]> = (0..4).map(|i| [i; PART_BYTES_MAX]).collect();
        let of = |message: u32, begins, missing, length: usize| Part::Of {
            message,
            begins,
            bytes: &rooms[message as usize][..length],
            before: Before {
                missing,
                is_new: false,
            },
        };
        assert_eq!(joiner.join(&datagrams[0], false), of(0, true, 0, 1));
        assert_eq!(
            joiner.join(&datagrams[1], false),
            of(1, true, 0, PART_BYTES_MAX)
        );
        assert_eq!(joiner.join(&datagrams[1], false), Part::Late);
        assert_eq!(joiner.join(&datagrams[4], false), of(3, true, 2, 1));
        assert_eq!(joiner.join(&datagrams[2], false), Part::Late);
        let end = |missing| Part::End {
            messages: 5,
            before: Before {
                missing,
                is_new: false,
            },
        };
        assert_eq!(joiner.join(&datagrams[6], false), end(1));
        assert_eq!(joiner.join(&datagrams[6], false), end(0));
        let mut other = Vec::new();
        Cutter::new(8).end(&mut other);
        let before = Before {
            missing: 0,
            is_new: true,
        };
        assert_eq!(joiner.join(&other, false), Part::Late);
        assert_eq!(
            joiner.join(&other, true),
            Part::End {
                messages: 0,
                before
            }
        );
        // The next one of the same sender is taken at once.
        let mut next = Vec::new();
        let mut cutter = Cutter::new(8);
        cutter.begin_anew();
        cutter.end(&mut next);
        assert!(matches!(joiner.join(&next, false), Part::End { .. }));
        // A datagram without a part, the end with one, one that is too long, another version.
        let datagram = &datagrams[5];
        assert_eq!(joiner.join(&datagram[..HEAD_BYTES], true), Part::Strange);
        assert_eq!(
            joiner.join(&[&other[..], &[1]].concat(), true),
            Part::Strange
        );
        let long = [&datagram[..], &[0; PART_BYTES_MAX]].concat();
        assert_eq!(joiner.join(&long, true), Part::Strange);
        let mut version = datagram.clone();
        version[2] = 2;
        assert_eq!(joiner.join(&version, true), Part::Strange);
        assert_eq!(joiner.join(&[], true), Part::Strange);
    }

    #[test]
    fn messages_before_the_first_and_after_the_last_are_counted() {
        let mut messages = Messages::default();
        assert_eq!(messages.lost(), 0);
        messages.see(2);
        assert_eq!(messages.lost(), 3);
        messages.complete();
        assert_eq!(messages.lost(), 2);
        messages.see(3);
        messages.complete();
        assert_eq!(messages.lost(), 2);
        messages.see(4);
        assert_eq!(messages.lost(), 3);
        messages.end(9);
        assert_eq!(messages.lost(), 7);
        messages.begin();
        assert_eq!(messages.lost(), 7);
        messages.see(0);
        messages.complete();
        assert_eq!(messages.lost(), 7);
        messages.begin();
        messages.end(u32::MAX);
        assert_eq!(messages.lost(), 7);
    }
}
