//! A device that sends a known sequence, so that a carrier can be tested without any model.
//!
//! | vendor request | effect |
//! |---|---|
//! | [`START`] out | the stream runs from where it stopped |
//! | [`STOP`] out | the stream waits |
//! | [`SENT`] in | bytes sent so far, u64 little-endian |
//! | [`NOTE`] out | keeps the data for [`NOTE`] in, at most 64 bytes |
//!
//! Word i of the stream is i times [`FACTOR`], modulo 2^32, little-endian. No two nearby words are alike, so any
//! word that is lost, repeated, moved or changed is detected. What is written to [`COMMANDS`] comes back from
//! [`ANSWERS`].

use std::collections::VecDeque;

use super::descriptors::{Device, Endpoint, Interface};
use super::{Bulk, Descriptors, Peripheral, Reply, Speed};
use crate::link::control::Request;

/// USB vendor ID: that of test devices (pid.codes).
pub const VENDOR: u16 = 0x1209;
/// USB product ID: for private tests.
pub const PRODUCT: u16 = 0x0001;
/// Endpoint of the stream.
pub const STREAM: u8 = 0x82;
/// Endpoint of the answers to commands.
pub const ANSWERS: u8 = 0x81;
/// Endpoint of commands.
pub const COMMANDS: u8 = 0x01;

/// Request that starts the stream.
pub const START: u8 = 0xB3;
/// Request that stops the stream.
pub const STOP: u8 = 0xB4;
/// Request for the number of bytes sent.
pub const SENT: u8 = 0xB5;
/// Request that writes or reads a note.
pub const NOTE: u8 = 0xB6;

/// Odd, so that all words of a period of 2^32 are different.
pub const FACTOR: u32 = 0x9E37_79B1;

/// Most bytes of a note or an answer.
const NOTE_MAX: usize = 64;
/// Most answers that wait.
const ANSWERS_MAX: usize = 16;

/// Returns byte `place` of the sequence.
fn byte(place: u64) -> u8 {
    let word = (place / 4) as u32;
    word.wrapping_mul(FACTOR).to_le_bytes()[(place % 4) as usize]
}

/// Checks a sequence, in pieces of any size, byte by byte.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Check {
    bytes: u64,
    first_wrong: Option<u64>,
}

impl Check {
    /// Compares the next bytes with the sequence.
    pub fn take(&mut self, bytes: &[u8]) {
        for &found in bytes {
            if found != byte(self.bytes) {
                self.first_wrong.get_or_insert(self.bytes);
            }
            self.bytes += 1;
        }
    }

    /// Returns the number of bytes so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the position of the first byte that differs.
    #[must_use]
    pub fn first_wrong(&self) -> Option<u64> {
        self.first_wrong
    }

    /// Returns whether every byte was correct.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.first_wrong.is_none()
    }
}

/// Action that a note triggers.
type OnNote = Box<dyn FnMut(&[u8]) + Send>;

/// A device that sends the sequence.
pub struct SequenceDevice {
    descriptors: Descriptors,
    runs: bool,
    sent: u64,
    ends_at: u64,
    stall_at: Option<u64>,
    /// Number of transfers that find no data after each transfer with data.
    pauses: u32,
    paused: u32,
    note: Vec<u8>,
    answers: VecDeque<Vec<u8>>,
    on_note: OnNote,
}

impl SequenceDevice {
    /// Creates a device that sends without end.
    #[must_use]
    pub fn new(speed: Speed) -> Self {
        const ENDPOINTS: [Endpoint; 3] = [
            Endpoint::bulk(STREAM),
            Endpoint::bulk(COMMANDS),
            Endpoint::bulk(ANSWERS),
        ];
        let descriptors = Device {
            speed,
            vendor: VENDOR,
            product: PRODUCT,
            names: ["EECVS", "Sequence", "1"],
            interfaces: &[Interface::vendor(0, &ENDPOINTS)],
            ..Device::default()
        }
        .describe();
        Self {
            descriptors,
            runs: false,
            sent: 0,
            ends_at: u64::MAX,
            stall_at: None,
            pauses: 0,
            paused: 0,
            note: Vec::new(),
            answers: VecDeque::new(),
            on_note: Box::new(|_| {}),
        }
    }

    /// Sets the name in the product string.
    #[must_use]
    pub fn named(mut self, name: &str) -> Self {
        self.descriptors.strings[1] = name.to_owned();
        self
    }

    /// Makes the stream wait for ever after `bytes` bytes.
    #[must_use]
    pub fn end_at(mut self, bytes: u64) -> Self {
        self.ends_at = bytes;
        self
    }

    /// Makes the stream's endpoint halt once, after `bytes` bytes.
    #[must_use]
    pub fn stall_at(mut self, bytes: u64) -> Self {
        self.stall_at = Some(bytes);
        self
    }

    /// Makes `turns` transfers find no data after each transfer with data.
    #[must_use]
    pub fn pause(mut self, turns: u32) -> Self {
        self.pauses = turns;
        self
    }

    /// Calls `act` with every note, for instance to let a script unplug the device.
    #[must_use]
    pub fn on_note(mut self, act: impl FnMut(&[u8]) + Send + 'static) -> Self {
        self.on_note = Box::new(act);
        self
    }

    fn stream(&mut self, room: usize, data: &mut Vec<u8>) -> Bulk {
        if !self.runs {
            return Bulk::Wait;
        }
        if self.stall_at == Some(self.sent) {
            return Bulk::Stall;
        }
        if self.paused < self.pauses {
            self.paused += 1;
            return Bulk::Wait;
        }
        let end = self.stall_at.unwrap_or(self.ends_at).min(self.ends_at);
        let end = end.min(self.sent.saturating_add(room as u64));
        if end == self.sent {
            return Bulk::Wait;
        }
        self.paused = 0;
        data.extend((self.sent..end).map(byte));
        self.sent = end;
        Bulk::Data
    }
}

impl Peripheral for SequenceDevice {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, data: &[u8], _length: usize) -> Reply {
        match (request.kind, request.request) {
            (Request::VENDOR_OUT, START) => self.runs = true,
            (Request::VENDOR_OUT, STOP) => self.runs = false,
            (Request::VENDOR_IN, SENT) => return Reply::Data(self.sent.to_le_bytes().to_vec()),
            (Request::VENDOR_OUT, NOTE) if data.len() <= NOTE_MAX => {
                self.note = data.to_vec();
                (self.on_note)(data);
            }
            (Request::VENDOR_IN, NOTE) => return Reply::Data(self.note.clone()),
            _ => return Reply::Stall,
        }
        Reply::Data(Vec::new())
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool {
        if endpoint != COMMANDS || data.len() > NOTE_MAX || self.answers.len() == ANSWERS_MAX {
            return false;
        }
        self.answers.push_back(data.to_vec());
        true
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        match endpoint {
            STREAM => self.stream(room, data),
            ANSWERS => self.answers.pop_front().map_or(Bulk::Wait, |answer| {
                data.extend(answer);
                Bulk::Data
            }),
            _ => Bulk::Stall,
        }
    }

    fn clear_halt(&mut self, endpoint: u8) {
        if endpoint == STREAM && self.stall_at == Some(self.sent) {
            self.stall_at = None;
        }
    }

    fn reset(&mut self) {
        self.runs = false;
        self.answers.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_change_of_a_sequence_shows() {
        let good: Vec<u8> = (0..4096).map(byte).collect();
        let check = |bytes: &[u8]| {
            let mut check = Check::default();
            check.take(bytes);
            check.is_good()
        };
        assert!(check(&good));
        for place in [0, 1, 511, 4095] {
            let mut bad = good.clone();
            bad[place] ^= 1;
            assert!(!check(&bad));
        }
        // A packet of 512 bytes is lost or repeated, or two packets are exchanged.
        assert!(!check(&[&good[..512], &good[1024..]].concat()));
        assert!(!check(&[&good[..512], &good[..]].concat()));
        assert!(!check(&[&good[512..1024], &good[..512]].concat()));
    }
}
