//! Datagrams that carry a stream of messages in numbered parts, so that losses are known by datagram and by
//! message. All numbers are little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 2 | sync EE C9 |
//! | 1 | version, 1 |
//! | 1 | flags: bit 0 the part begins a message, bit 1 the stream ends |
//! | 4 | stream number: chosen anew whenever a sender starts, incremented when it finds that nobody listens |
//! | 4 | sequence number of the datagram in the stream, from 0, wrapping |
//! | 4 | number of its message in the stream, from 0, wrapping; at the end the number of messages |
//! | n | the next bytes of the message, 1 to [`PART_BYTES_MAX`]; none at the end |
//!
//! The end datagram has the sequence number that the next datagram would have, and is sent several times. A
//! datagram that arrives late, after one that overtook it, is dropped: it has already been counted as lost.

use zerocopy::byteorder::little_endian::U32;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// First bytes of a datagram.
const SYNC: [u8; 2] = [0xEE, 0xC9];
const VERSION: u8 = 1;
const BEGINS: u8 = 1;
const ENDS: u8 = 2;
/// Bytes before the part in a datagram.
const HEAD_BYTES: usize = size_of::<Head>();
/// Most bytes of a part, so that a datagram crosses Ethernet without fragmentation.
pub const PART_BYTES_MAX: usize = 1400 - HEAD_BYTES;
/// Length of the longest datagram, in bytes.
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

/// Cuts a stream of messages into datagrams.
#[derive(Debug, Clone, Copy)]
pub struct Cutter {
    stream: u32,
    number: u32,
    message: u32,
}

impl Cutter {
    /// Starts at the first byte of stream number `stream`.
    #[must_use]
    pub const fn new(stream: u32) -> Self {
        Self {
            stream,
            number: 0,
            message: 0,
        }
    }

    /// Begins the sender's next stream, with the next stream number.
    pub const fn begin_anew(&mut self) {
        *self = Self::new(self.stream.wrapping_add(1));
    }

    /// Returns whether nothing has been cut yet.
    #[must_use]
    pub const fn is_at_start(&self) -> bool {
        self.number == 0 && self.message == 0
    }

    /// Passes the datagrams of a message to `send`, one at a time, until that fails; `datagram` is scratch space.
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

    /// Writes the datagram that ends the stream.
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

/// Content of a received datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part<'d> {
    /// Bytes of a message.
    Of {
        /// Number of the message in the stream.
        message: u32,
        /// Whether the message begins with these bytes.
        begins: bool,
        /// The bytes.
        bytes: &'d [u8],
        /// What is known of the datagrams before this one.
        before: Before,
    },
    /// The stream has ended.
    End {
        /// Number of messages in the stream.
        messages: u32,
        /// What is known of the datagrams before this one.
        before: Before,
    },
    /// A duplicate or late datagram, or one of another stream than the current one.
    Late,
    /// Not a datagram of this protocol.
    Strange,
}

/// What is known of the datagrams before a given one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Before {
    /// Number of datagrams of the stream missing since the previous one or, in a new stream, since its beginning.
    pub missing: u32,
    /// Whether the previous datagram belonged to another stream.
    pub is_new: bool,
}

/// Reassembles a stream from datagrams.
#[derive(Debug, Clone, Copy, Default)]
pub struct Joiner {
    stream: Option<u32>,
    next: u32,
}

/// Returns the head and the part of a datagram of this protocol.
fn split(datagram: &[u8]) -> Option<(&Head, &[u8])> {
    let (head, bytes) = Head::ref_from_prefix(datagram).ok()?;
    let ends = head.flags & ENDS != 0;
    let is_whole = bytes.len() <= PART_BYTES_MAX && bytes.is_empty() == ends;
    (head.sync == SYNC && head.version == VERSION && is_whole).then_some((head, bytes))
}

/// Returns the stream number of a datagram; `None` if it is not one of this protocol.
#[must_use]
pub fn stream_of(datagram: &[u8]) -> Option<u32> {
    split(datagram).map(|(head, _)| head.stream.get())
}

impl Joiner {
    /// Returns whether a stream with this number is the current one or the next one of the same sender.
    #[must_use]
    pub fn continues(&self, stream: u32) -> bool {
        let is_own = |current: u32| stream == current || stream == current.wrapping_add(1);
        self.stream.is_none_or(is_own)
    }

    /// Takes a datagram. The next stream of the same sender, which has the next number, replaces the current stream; no
    /// other one does.
    pub fn join<'d>(&mut self, datagram: &'d [u8]) -> Part<'d> {
        let Some((head, bytes)) = split(datagram) else {
            return Part::Strange;
        };
        let (stream, number) = (head.stream.get(), head.number.get());
        if !self.continues(stream) {
            return Part::Late;
        }
        let is_new = self.stream != Some(stream);
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
        if head.flags & ENDS != 0 {
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

/// Counts the lost messages of streams by their numbers.
///
/// Messages lost between two whole ones are not counted here: the messages' own sequence numbers reveal those, and
/// also messages that were never sent.
#[derive(Debug, Clone, Copy, Default)]
pub struct Messages {
    /// Messages lost in streams that are over, and before the first whole one of the current stream.
    lost: u64,
    /// One more than the number of the latest message seen or, after the end, the number of messages.
    seen: u32,
    /// One more than the number of the latest whole message.
    whole: u32,
}

impl Messages {
    /// Begins another stream; nothing more is expected of the previous one.
    pub const fn begin(&mut self) {
        self.lost = self.lost();
        self.seen = 0;
        self.whole = 0;
    }

    /// Records that a part of message number `message` arrived.
    pub const fn see(&mut self, message: u32) {
        self.seen = message.wrapping_add(1);
    }

    /// Records that the stream has ended after `messages` messages.
    pub const fn end(&mut self, messages: u32) {
        self.seen = messages;
    }

    /// Records that the latest message seen is whole.
    pub const fn complete(&mut self) {
        if self.whole == 0 {
            self.lost = self.lost.saturating_add(self.seen.saturating_sub(1) as u64);
        }
        self.whole = self.seen;
    }

    /// Records that receiving stops on request: the latest message seen would have become whole, unless a part of
    /// it `is_lost`, and is then not counted as lost.
    pub const fn forgive(&mut self, is_lost: bool) {
        if !is_lost && self.seen.wrapping_sub(self.whole) > 0 {
            self.seen = self.seen.wrapping_sub(1);
        }
    }

    /// Returns the number of messages lost before the first and after the last whole one, over all streams.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        let after = self.seen.wrapping_sub(self.whole);
        // A number that falls back cannot belong to the stream.
        let after = if after < 1 << 31 { after } else { 0 };
        self.lost.saturating_add(after as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The datagrams of messages with the given numbers of parts, then the end datagram.
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
        assert_eq!(joiner.join(&datagrams[0]), of(0, true, 0, 1));
        assert_eq!(joiner.join(&datagrams[1]), of(1, true, 0, PART_BYTES_MAX));
        assert_eq!(joiner.join(&datagrams[1]), Part::Late);
        assert_eq!(joiner.join(&datagrams[4]), of(3, true, 2, 1));
        assert_eq!(joiner.join(&datagrams[2]), Part::Late);
        let end = |missing| Part::End {
            messages: 5,
            before: Before {
                missing,
                is_new: false,
            },
        };
        assert_eq!(joiner.join(&datagrams[6]), end(1));
        assert_eq!(joiner.join(&datagrams[6]), end(0));
        let mut other = Vec::new();
        Cutter::new(8).end(&mut other);
        let before = Before {
            missing: 0,
            is_new: true,
        };
        assert!(!joiner.continues(8) && joiner.continues(9) && joiner.continues(10));
        assert_eq!(joiner.join(&other), Part::Late);
        joiner = Joiner::default();
        assert!(joiner.continues(8));
        assert_eq!(
            joiner.join(&other),
            Part::End {
                messages: 0,
                before
            }
        );
        // The next stream of the same sender is accepted at once.
        let mut next = Vec::new();
        let mut cutter = Cutter::new(8);
        cutter.begin_anew();
        cutter.end(&mut next);
        assert!(matches!(joiner.join(&next), Part::End { .. }));
        // A datagram without a part, an end datagram with one, a part that is too long, another version.
        let datagram = &datagrams[5];
        assert_eq!(joiner.join(&datagram[..HEAD_BYTES]), Part::Strange);
        assert_eq!(joiner.join(&[&other[..], &[1]].concat()), Part::Strange);
        let long = [&datagram[..], &[0; PART_BYTES_MAX]].concat();
        assert_eq!(joiner.join(&long), Part::Strange);
        let mut version = datagram.clone();
        version[2] = 2;
        assert_eq!(joiner.join(&version), Part::Strange);
        assert_eq!(joiner.join(&[]), Part::Strange);
        assert_eq!((stream_of(&version), stream_of(datagram)), (None, Some(9)));
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
