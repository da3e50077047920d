//! Raw packets of a device's chunks.

use eecvs_nostd::Event;

use super::packet::{Packet, WORDS_BYTES_MAX};
use crate::clock::{Clock, Relation};
use crate::device::Parse;
use crate::pump::Chunk;

/// Bytes of a packet's words at the most: a chunk of a camera in a packet of its own, and datagrams few.
const WORDS_BYTES: usize = if WORDS_BYTES_MAX < 1 << 16 {
    WORDS_BYTES_MAX
} else {
    1 << 16
};

/// Makes packets; its parser only follows the stream, for the time bases and the counts.
pub struct Packetiser {
    encoding: String,
    parser: Box<dyn Parse>,
    clock: Clock,
    sequence: u32,
    after_loss: bool,
    packet: Vec<u8>,
}

impl Packetiser {
    /// Of a stream at its beginning.
    #[must_use]
    pub fn new(encoding: String, parser: Box<dyn Parse>) -> Self {
        Self {
            encoding,
            parser,
            clock: Clock::default(),
            sequence: 0,
            after_loss: false,
            packet: Vec::new(),
        }
    }

    /// The parser that follows.
    #[must_use]
    pub fn parser(&self) -> &dyn Parse {
        self.parser.as_ref()
    }

    /// How the clocks are related.
    #[must_use]
    pub fn relation(&self) -> Option<Relation> {
        self.clock.relation()
    }

    /// Gives the packets of a chunk to `give`, each with its number of events; `events` is room.
    pub fn chunk(
        &mut self,
        chunk: &Chunk,
        events: &mut Vec<Event>,
        give: &mut dyn FnMut(&[u8], u64),
    ) {
        if chunk.after_loss {
            self.parser.resume(self.clock.device_us(chunk.at));
            self.after_loss = true;
        }
        for words in chunk.bytes.chunks(WORDS_BYTES) {
            let time_base_us = self.parser.time_us();
            events.clear();
            self.parser.parse(words, events);
            let packet = Packet {
                encoding: &self.encoding,
                sensor: self.parser.sensor(),
                sequence: self.sequence,
                time_base_us,
                after_loss: self.after_loss,
                events: events.len() as u32,
                words,
            };
            self.packet.clear();
            packet.write(&mut self.packet);
            give(&self.packet, events.len() as u64);
            self.sequence = self.sequence.wrapping_add(1);
            self.after_loss = false;
        }
        if let Some(time_us) = self.parser.time_us() {
            self.clock.note(chunk.at, time_us);
        }
    }
}
