//! Makes raw packets from a device's chunks.

use eecvs_nostd::Event;

use super::packet::{Packet, WORDS_BYTES_MAX};
use crate::live::Follower;
use crate::pump::Chunk;

/// Most bytes of words put in a packet: enough for a whole transfer of any camera but Prophesee's, and at most 48
/// datagrams.
const WORDS_BYTES: usize = if WORDS_BYTES_MAX < 1 << 16 {
    WORDS_BYTES_MAX
} else {
    1 << 16
};

/// Makes packets; it parses the stream only for the time bases and the event counts.
pub struct Packetiser {
    encoding: String,
    follower: Follower,
    sequence: u32,
    after_loss: bool,
    packet: Vec<u8>,
}

impl Packetiser {
    /// Starts at the beginning of a stream.
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

    /// Passes the packets of a chunk to `give`, each with its number of events; `events` is scratch space.
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

    /// Updates the shared progress: call it when nothing arrives for a while, and at the end.
    pub fn tell(&mut self) {
        self.follower.tell();
    }
}
