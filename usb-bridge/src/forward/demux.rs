//! Extracts frames and packets from a stream of bytes that may be damaged.

use eecvs::frame_file::mark::{self, Mark, MarkError};
use eecvs::stream_buffer::StreamBuffer;
use eecvs_nostd::frame::SYNC as FRAME_SYNC;
use eecvs_nostd::{FRAME_BYTES_MAX, Frame, FrameError, Scan, scan};

use super::packet::{self, Look, PACKET_BYTES_MAX, Packet};

/// Length of the longest message, in bytes.
pub const MESSAGE_BYTES_MAX: usize = if FRAME_BYTES_MAX > PACKET_BYTES_MAX {
    FRAME_BYTES_MAX
} else {
    PACKET_BYTES_MAX
};

/// A message of a stream.
#[derive(Debug, Clone, Copy)]
pub enum Message<'b> {
    /// A frame from an encoder.
    Frame(Frame<'b>),
    /// A packet of raw events.
    Packet(Packet<'b>),
}

/// Splits a stream into messages, within the bounds of a [`StreamBuffer`].
#[derive(Debug)]
pub struct Demux {
    buffer: StreamBuffer,
    /// Length of the whole message at the start of the buffer, once it has been found.
    whole: Option<usize>,
}

impl Default for Demux {
    fn default() -> Self {
        Self {
            buffer: StreamBuffer::new(MESSAGE_BYTES_MAX),
            whole: None,
        }
    }
}

impl Demux {
    /// Appends received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.push(bytes);
    }

    /// Returns the number of bytes that belonged to no message.
    #[must_use]
    pub const fn damaged_bytes(&self) -> u64 {
        self.buffer.damaged().0
    }

    /// Returns the bytes of all damaged messages: the work of their checksums.
    #[must_use]
    pub const fn checked_bytes(&self) -> u64 {
        self.buffer.checked_bytes()
    }

    /// Records that the stream was interrupted: the message that has begun will not be completed, but other
    /// messages may lie within its bytes.
    pub fn interrupt(&mut self) {
        while !self.buffer.rest().is_empty() {
            if !self.has_message() {
                self.buffer.damage(next_sync(self.buffer.rest()), 0);
            } else {
                return;
            }
        }
    }

    /// Returns the number of bytes that are not used up.
    #[must_use]
    pub fn rest_bytes(&self) -> usize {
        self.buffer.rest().len()
    }

    /// Returns the length of the next whole message; damage before it is skipped.
    fn next_at(&mut self) -> Option<usize> {
        loop {
            let rest = self.buffer.rest();
            if rest.is_empty() {
                return None;
            }
            // Those of a file that is sent: the stream goes on behind it.
            match Mark::parse(rest) {
                Ok((_, bytes)) => {
                    self.buffer.take(bytes);
                    continue;
                }
                Err(MarkError::Incomplete) if rest.len() > 1 => return None,
                Err(_) => {}
            }
            let of_packet = match Packet::look(rest) {
                Look::Packet(_, bytes) => return Some(bytes),
                Look::Incomplete if rest.len() < PACKET_BYTES_MAX && rest.len() > 1 => return None,
                Look::Incomplete => 0,
                Look::Damage(checked) => checked,
            };
            let of_frame = match scan(rest) {
                Scan::Frame(frame) => return Some(frame.bytes),
                Scan::Incomplete if rest.len() < MESSAGE_BYTES_MAX => return None,
                Scan::Damage {
                    error: FrameError::Damaged(bytes),
                    ..
                } => bytes as usize,
                Scan::Incomplete | Scan::Damage { .. } => 0,
            };
            // A message of one kind is none of the other.
            self.buffer.damage(next_sync(rest), of_packet.max(of_frame));
        }
    }

    /// Returns whether a whole message is next. Damage before it is skipped.
    pub fn has_message(&mut self) -> bool {
        if self.whole.is_none() {
            self.whole = self.next_at();
        }
        self.whole.is_some()
    }

    /// Returns the next whole message, which stays the next one; `None` if more bytes are needed. Damage before it is
    /// skipped.
    pub fn peek(&mut self) -> Option<Message<'_>> {
        self.has_message();
        read(self.buffer.rest().get(..self.whole?)?)
    }

    /// Returns the next whole message; `None` if more bytes are needed. Damage before it is skipped.
    pub fn next_message(&mut self) -> Option<Message<'_>> {
        self.next_with_bytes().map(|(message, _)| message)
    }

    /// Returns the next whole message as [`Demux::next_message`] does, and its bytes.
    pub fn next_with_bytes(&mut self) -> Option<(Message<'_>, &[u8])> {
        self.has_message();
        let length = self.whole.take()?;
        self.buffer.take(length);
        let bytes = self.buffer.last(length);
        Some((read(bytes)?, bytes))
    }
}

/// Returns the message that these bytes are.
fn read(bytes: &[u8]) -> Option<Message<'_>> {
    match Packet::look(bytes) {
        Look::Packet(packet, _) => Some(Message::Packet(packet)),
        _ => match scan(bytes) {
            Scan::Frame(frame) => Some(Message::Frame(frame)),
            _ => None,
        },
    }
}

/// Returns the distance to the next place after the first byte where a message may begin.
fn next_sync(bytes: &[u8]) -> usize {
    let begins = |at: &usize| {
        let [first, second] = FRAME_SYNC;
        bytes.get(*at) == Some(&first)
            && bytes
                .get(*at + 1)
                .is_none_or(|byte| [second, packet::SYNC[1], mark::SYNC[1]].contains(byte))
    };
    (1..bytes.len()).find(begins).unwrap_or(bytes.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use eecvs_nostd::Sensor;
    use proptest::prelude::*;

    fn packet(sequence: u32, words: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        Packet {
            encoding: "evk4/evt3",
            sensor: Sensor::new(4, 4).unwrap(),
            sequence,
            time_base_us: None,
            after_loss: false,
            events: 0,
            words,
        }
        .write(&mut bytes);
        bytes
    }

    fn sequences(demux: &mut Demux) -> Vec<u32> {
        let mut sequences = Vec::new();
        while let Some(message) = demux.next_message() {
            if let Message::Packet(packet) = message {
                sequences.push(packet.sequence);
            }
        }
        sequences
    }

    /// What is found once no more bytes follow.
    fn rest(demux: &mut Demux) -> Vec<u32> {
        let mut met = Vec::new();
        while demux.rest_bytes() > 0 {
            demux.interrupt();
            met.extend(sequences(demux));
        }
        met
    }

    /// A file of frames may be sent as it is.
    #[test]
    fn the_marks_of_a_file_are_no_damage() {
        let (begin, end) = (mark::BEGIN, mark::End::default().to_bytes());
        let stream = [
            &begin[..],
            &packet(1, b"ab"),
            &end,
            &begin,
            &packet(2, b""),
            &end,
        ]
        .concat();
        for piece in [1, 7, stream.len()] {
            let (mut demux, mut found) = (Demux::default(), Vec::new());
            for bytes in stream.chunks(piece) {
                demux.push(bytes);
                found.extend(sequences(&mut demux));
            }
            assert_eq!(
                (found, demux.damaged_bytes(), demux.rest_bytes()),
                (vec![1, 2], 0, 0)
            );
        }
        // One that is cut off hides nothing behind it.
        let mut demux = Demux::default();
        demux.push(&[&end[..10], &packet(3, b"")].concat());
        assert_eq!(rest(&mut demux), [3]);
        assert_eq!(demux.damaged_bytes(), 10);
    }

    proptest! {
        /// However the stream is cut and whatever lies between, whole packets are found and the rest is counted.
        #[test]
        fn whole_messages_come_and_every_other_byte_is_counted(
            parts in proptest::collection::vec(
                (any::<bool>(), proptest::collection::vec(any::<u8>(), 0..40)), 1..12),
            cut in 1..50_usize,
        ) {
            let mut stream = Vec::new();
            let (mut expected, mut noise) = (Vec::new(), 0);
            for (i, (is_packet, bytes)) in parts.iter().enumerate() {
                if *is_packet {
                    stream.extend(packet(i as u32, bytes));
                    expected.push(i as u32);
                } else {
                    // These bytes cannot begin a message.
                    let bytes: Vec<u8> = bytes.iter().map(|byte| byte & 0x7F).collect();
                    noise += bytes.len() as u64;
                    stream.extend(bytes);
                }
            }
            let mut demux = Demux::default();
            let mut met = Vec::new();
            for part in stream.chunks(cut) {
                demux.push(part);
                met.extend(sequences(&mut demux));
            }
            met.extend(rest(&mut demux));
            prop_assert_eq!(met, expected);
            prop_assert_eq!(demux.damaged_bytes(), noise);
        }

        #[test]
        fn any_bytes_are_survived(bytes in proptest::collection::vec(
            prop_oneof![any::<u8>(), Just(0xEE), Just(0xC5), Just(0xC7), Just(1)], 0..400)) {
            let mut demux = Demux::default();
            demux.push(&bytes);
            while demux.next_message().is_some() {}
            rest(&mut demux);
            prop_assert_eq!(demux.rest_bytes(), 0);
            prop_assert!(demux.damaged_bytes() <= bytes.len() as u64);
        }
    }

    #[test]
    fn a_message_inside_of_one_that_was_cut_is_found() {
        let (first, second) = (packet(1, &[0; 100]), packet(2, &[9; 10]));
        let mut demux = Demux::default();
        demux.push(&first[..60]);
        assert!(sequences(&mut demux).is_empty());
        demux.interrupt();
        demux.push(&second);
        assert_eq!(sequences(&mut demux), [2]);
        assert_eq!(demux.damaged_bytes(), 60);
    }
}
