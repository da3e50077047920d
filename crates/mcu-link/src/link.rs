//! The host's side of the event link: sends packets of events, receives frames and packets.

use eecvs::stream_buffer::StreamBuffer;
use eecvs_nostd::event_link::{self, BODY_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, Receiver};
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::{Event, FrameError, Header, Scan, frame, scan};
use event_types::bail;
use event_types::stream::Result;

/// A message received from an encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// A frame: its header and all its bytes, header included.
    Frame(Box<Header>, Vec<u8>),
    /// A packet: its kind and its body.
    Packet(Kind, Vec<u8>),
}

enum Look {
    Message(Message, usize),
    /// Bytes that belong to no message, and bytes that a checksum was computed over to find that.
    Damage(usize, usize),
    Incomplete,
}

/// Splits the received bytes into frames and packets, within the bounds of a [`StreamBuffer`].
#[derive(Debug)]
pub struct Demultiplexer {
    buffer: StreamBuffer,
    frame_bytes: usize,
}

/// Longest frame unless [`Demultiplexer::limit_frames`] sets another limit.
const FRAME_BYTES: usize = 1 << 16;

impl Default for Demultiplexer {
    fn default() -> Self {
        Self {
            buffer: StreamBuffer::new(FRAME_BYTES),
            frame_bytes: FRAME_BYTES,
        }
    }
}

impl Demultiplexer {
    /// Sets the maximum length of a frame; a longer frame counts as damage.
    pub const fn limit_frames(&mut self, frame_bytes: usize) {
        self.frame_bytes = frame_bytes;
        self.buffer.limit(frame_bytes);
    }

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

    /// Returns whether the buffer holds the beginning of a message.
    #[must_use]
    pub fn is_incomplete(&self) -> bool {
        !self.buffer.rest().is_empty()
    }

    /// Takes the bytes that have not been consumed, to pass them to another reader.
    #[must_use]
    pub fn take_rest(&mut self) -> Vec<u8> {
        self.buffer.take_rest()
    }

    /// Gives up the message that has begun: other messages may start within the bytes received for it.
    pub fn give_up(&mut self) {
        if self.is_incomplete() {
            self.buffer.damage(next_sync(self.buffer.rest()), 0);
        }
    }

    /// Returns the next complete message, or `None` if more bytes are needed.
    pub fn next_message(&mut self) -> Option<Message> {
        loop {
            match self.look() {
                Look::Message(message, bytes) => {
                    self.buffer.take(bytes);
                    return Some(message);
                }
                Look::Damage(skip, checked) => self.buffer.damage(skip, checked),
                Look::Incomplete => return None,
            }
        }
    }

    fn look(&self) -> Look {
        let rest = self.buffer.rest();
        let Some(sync) = rest.get(..2) else {
            return match rest {
                [] => Look::Incomplete,
                [first, ..] if *first == frame::SYNC[0] => Look::Incomplete,
                _ => Look::Damage(1, 0),
            };
        };
        if sync == event_link::SYNC {
            return self.look_at_packet();
        }
        let bytes = &rest[..rest.len().min(self.frame_bytes)];
        match scan(bytes) {
            Scan::Frame(frame) => Look::Message(
                Message::Frame(Box::new(frame.header), bytes[..frame.bytes].to_vec()),
                frame.bytes,
            ),
            Scan::Incomplete if bytes.len() < self.frame_bytes => Look::Incomplete,
            Scan::Damage {
                error: FrameError::Damaged(checked),
                ..
            } => Look::Damage(next_sync(rest), checked as usize),
            Scan::Incomplete | Scan::Damage { .. } => Look::Damage(next_sync(rest), 0),
        }
    }

    fn look_at_packet(&self) -> Look {
        // An encoder sends few packets, so parsing from the start each time is cheap enough.
        let mut receiver = Receiver::new();
        for (at, byte) in self.buffer.rest().iter().enumerate() {
            let packet = receiver
                .push(*byte)
                .map(|packet| Message::Packet(packet.kind, packet.body.to_vec()));
            if receiver.damaged_bytes() > 0 {
                return Look::Damage(next_sync(self.buffer.rest()), at + 1);
            }
            if let Some(message) = packet {
                return Look::Message(message, at + 1);
            }
        }
        Look::Incomplete
    }
}

/// Returns the distance to the next position, after the first byte, at which a frame or a packet may begin.
fn next_sync(bytes: &[u8]) -> usize {
    let begins = |at: &usize| match bytes[*at..] {
        [first, second, ..] => [frame::SYNC, event_link::SYNC].contains(&[first, second]),
        [first] => first == frame::SYNC[0],
        [] => false,
    };
    (1..bytes.len()).find(begins).unwrap_or(bytes.len())
}

/// Returns the bytes of a packet.
///
/// `position` is the number of events sent before the packet, modulo 2^32.
///
/// # Errors
/// A body longer than [`BODY_BYTES_MAX`].
pub fn packet(kind: Kind, position: u32, body: &[u8]) -> Result<Vec<u8>> {
    let mut bytes = vec![0; PACKET_BYTES_MAX];
    let packet = Packet {
        kind,
        position,
        body,
    };
    let Ok(length) = packet.write(&mut bytes) else {
        bail!(CannotHold, "a packet of {} bytes is too long", body.len());
    };
    bytes.truncate(length);
    Ok(bytes)
}

/// Encodes events as EVT 2.0 words and puts them into packets.
#[derive(Debug)]
pub struct EventPackets {
    encoder: Evt2Encoder,
    body: Vec<u8>,
    /// Number of events before `body`; wraps around.
    position: u32,
    /// Number of events in `body`.
    events: u32,
}

impl EventPackets {
    /// Creates an encoder for events from `time_base_us` on; the setup sent before must have the same time base.
    #[must_use]
    pub fn new(time_base_us: u64) -> Self {
        Self {
            encoder: Evt2Encoder::new(time_base_us),
            body: Vec::with_capacity(BODY_BYTES_MAX),
            position: 0,
            events: 0,
        }
    }

    /// Adds an event; if the current packet is full, appends it to `out` first.
    ///
    /// # Errors
    /// A time that EVT 2.0 words cannot represent after the previous events.
    pub fn push(&mut self, event: Event, out: &mut Vec<u8>) -> Result<()> {
        if self.body.len() + 8 > BODY_BYTES_MAX {
            // An event may need two words: the time and the event itself.
            self.take(out)?;
        }
        if self.body.is_empty() {
            self.encoder.restate_time();
        }
        let Some((due, word)) = self.encoder.encode(event) else {
            bail!(CannotHold, "the time {} us cannot be sent", event.t_us);
        };
        for word in due.into_iter().chain([word]) {
            self.body.extend(word.to_le_bytes());
        }
        self.events += 1;
        Ok(())
    }

    /// Appends the packet in progress to `out`, if it holds any events.
    ///
    /// # Errors
    /// None in practice: `push` keeps the packet within its limit.
    pub fn take(&mut self, out: &mut Vec<u8>) -> Result<()> {
        if self.events > 0 {
            out.extend(packet(Kind::Words, self.position, &self.body)?);
            self.position = self.position.wrapping_add(self.events);
            self.events = 0;
            self.body.clear();
        }
        Ok(())
    }

    /// Appends the remaining events and the packet that ends the stream.
    ///
    /// # Errors
    /// As for [`EventPackets::take`].
    pub fn finish(mut self, out: &mut Vec<u8>) -> Result<()> {
        self.take(out)?;
        out.extend(packet(Kind::Flush, self.position, &[])?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use eecvs::encode::{Limits, all_cores, encode};
    use eecvs_nostd::evt2::{Evt2Decoder, Word};
    use eecvs_nostd::{Config, Mode, Sensor, Thresholds, WindowConfig};
    use event_emulator::{Preset, SceneConfig, emulate};
    use proptest::prelude::*;

    use super::*;

    const SCENE: SceneConfig = SceneConfig {
        sensor: Sensor {
            width: 30,
            height: 20,
        },
        duration_us: 50_000,
        ..SceneConfig::model_1(Preset::Motorcycle, 1)
    };

    static FRAMES: LazyLock<Vec<Message>> = LazyLock::new(|| {
        let config = Config {
            m: 4,
            ..Config::new(
                WindowConfig::new(SCENE.sensor, 10_000),
                Thresholds::new(0, 0).unwrap(),
                Mode::Transform,
            )
        };
        let mut bytes = Vec::new();
        let mut scene = emulate(SCENE).unwrap();
        encode(
            &mut scene,
            config,
            Limits::default(),
            all_cores(),
            &mut bytes,
            &mut |_| (),
        )
        .unwrap();
        let mut frames = Demultiplexer::default();
        frames.push(&bytes);
        let frames = all(&mut frames);
        assert!(frames.len() > 3);
        frames
    });

    fn all(incoming: &mut Demultiplexer) -> Vec<Message> {
        std::iter::from_fn(|| incoming.next_message()).collect()
    }

    fn bytes(message: &Message) -> Vec<u8> {
        match message {
            Message::Frame(_, bytes) => bytes.clone(),
            Message::Packet(kind, body) => packet(*kind, 7, body).unwrap(),
        }
    }

    fn any_bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
        let byte = prop_oneof![
            2 => any::<u8>(),
            2 => Just(0xEE),
            1 => Just(0xC5),
            1 => Just(0xC6),
            1 => 0..4_u8
        ];
        proptest::collection::vec(byte, 0..most)
    }

    fn message() -> impl Strategy<Value = Message> {
        prop_oneof![
            (0..FRAMES.len()).prop_map(|at| FRAMES[at].clone()),
            any_bytes(BODY_BYTES_MAX).prop_map(|body| Message::Packet(Kind::Status, body)),
        ]
    }

    proptest! {
        #[test]
        fn messages_are_told_apart(
            messages in proptest::collection::vec(message(), 0..12), cut in 1..3000_usize,
        ) {
            let stream: Vec<u8> = messages.iter().flat_map(bytes).collect();
            let mut incoming = Demultiplexer::default();
            let mut found = Vec::new();
            for piece in stream.chunks(cut) {
                incoming.push(piece);
                found.extend(all(&mut incoming));
            }
            prop_assert_eq!(found, messages);
            prop_assert_eq!(incoming.damaged_bytes(), 0);
            prop_assert!(!incoming.is_incomplete());
        }

        #[test]
        fn garbage_between_messages_is_counted(
            parts in proptest::collection::vec((any_bytes(40), message()), 1..8),
        ) {
            let mut incoming = Demultiplexer::default();
            let mut found = Vec::new();
            for (garbage, message) in &parts {
                incoming.push(garbage);
                incoming.push(&bytes(message));
                found.extend(all(&mut incoming));
            }
            // The message that the garbage announced never arrives.
            while incoming.is_incomplete() {
                incoming.give_up();
                found.extend(all(&mut incoming));
            }
            let garbage: usize = parts.iter().map(|(garbage, _)| garbage.len()).sum();
            prop_assert_eq!(found, parts.into_iter().map(|(_, message)| message).collect::<Vec<_>>());
            prop_assert_eq!(incoming.damaged_bytes(), garbage as u64);
        }

        #[test]
        fn long_frames_are_damage(bytes in any_bytes(3000)) {
            let mut incoming = Demultiplexer::default();
            incoming.limit_frames(100);
            let Message::Frame(_, frame) = &FRAMES[0] else {
                return Err(TestCaseError::fail("a frame"));
            };
            incoming.push(frame);
            incoming.push(&bytes);
            prop_assert!(all(&mut incoming).iter().all(|m| matches!(m, Message::Packet(..))));
            prop_assert!(incoming.damaged_bytes() > 0);
            // At most an incomplete packet remains.
            prop_assert!(incoming.buffer.rest().len() <= PACKET_BYTES_MAX);
        }
    }

    /// The loss of a packet must not affect the times of other packets.
    #[test]
    fn every_packet_can_be_decoded_alone() {
        let (mut events, mut bytes) = (Vec::new(), Vec::new());
        let mut scene = emulate(SCENE).unwrap();
        while event_files::EventReader::read(&mut scene, &mut events).unwrap() > 0 {}
        let mut packets = EventPackets::new(0);
        for event in &events {
            packets.push(*event, &mut bytes).unwrap();
        }
        packets.finish(&mut bytes).unwrap();
        let (mut receiver, mut decoded, mut flushes) = (Receiver::new(), Vec::new(), 0);
        for byte in bytes {
            let Some(packet) = receiver.push(byte) else {
                continue;
            };
            assert_eq!(packet.position as usize, decoded.len());
            let mut decoder = Evt2Decoder::new(0);
            for word in packet.body.as_chunks().0 {
                match decoder.decode(u32::from_le_bytes(*word)) {
                    Word::Event(event) => decoded.push(event),
                    word => assert_eq!(word, Word::Time),
                }
            }
            flushes += usize::from(packet.kind == Kind::Flush);
        }
        assert_eq!(decoded, events);
        assert_eq!((flushes, receiver.damaged_bytes()), (1, 0));
    }
}
