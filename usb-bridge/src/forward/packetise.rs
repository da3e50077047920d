//! Raw packets of a device's chunks.

use eecvs_nostd::Event;

use super::packet::{Packet, WORDS_BYTES_MAX};
use crate::live::Follower;
use crate::pump::Chunk;

/// Bytes of a packet's words at the most: a chunk of a camera in a packet of its own, and datagrams few.
const WORDS_BYTES: usize = if WORDS_BYTES_MAX < 1 << 16 {
    WORDS_BYTES_MAX
} else {
    1 << 16
};

/// Makes packets; what follows the stream is for the time bases and the counts alone.
pub struct Packetiser {
    encoding: String,
    follower: Follower,
    sequence: u32,
    after_loss: bool,
    packet: Vec<u8>,
}

impl Packetiser {
    /// Of a stream at its beginning.
    #[must_use]
    pub fn new(encoding: String, follower: Follower) -> Self {
        Self {
            encoding,
            follower,
            sequence: 0,
            after_loss: false,
            packet: Vec::new(),
        }
    }

    /// Gives the packets of a chunk to `give`, each with its number of events; `events` is room.
    pub fn chunk(
        &mut self,
        chunk: &Chunk,
        events: &mut Vec<Event>,
        give: &mut dyn FnMut(&[u8], u64),
    ) {
        self.follower.begin(chunk);
        self.after_loss |= chunk.after_loss;
        for words in chunk.bytes.chunks(WORDS_BYTES) {
            let time_base_us = self.follower.parser().time_us();
            events.clear();
            self.follower.parse(words, events);
            let packet = Packet {
                encoding: &self.encoding,
                sensor: self.follower.parser().sensor(),
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
        self.follower.end(chunk.at);
    }

    /// Tells those who watch: where nothing comes for a while, and at the end.
    pub fn tell(&mut self) {
        self.follower.tell();
    }
}
