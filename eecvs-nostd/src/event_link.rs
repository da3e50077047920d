//! Events on their way to an encoder: the packets that a host or a camera sends to the MCU, and
//! the status that it answers with.
//!
//! docs/wire-format.md, "Event link", has the layout. Every packet says how many events were sent
//! before it, so the receiver knows exactly how many a lost packet held.

use core::num::NonZeroU32;

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::checksum::CRC_16;
use crate::encoder::Config;
use crate::event::Sensor;
use crate::filter::{Filter, Region};
use crate::frame::Mode;
use crate::link::next_sync;
use crate::quantise::Quantiser;
use crate::regime::Thresholds;
use crate::transform::Transform;
use crate::window::WindowConfig;

/// First two bytes of a packet.
pub const SYNC: [u8; 2] = [0xEE, 0xC6];
/// Largest body.
pub const BODY_BYTES_MAX: usize = 512;
/// Largest packet.
pub const PACKET_BYTES_MAX: usize = HEAD_BYTES + BODY_BYTES_MAX + CRC_BYTES;

/// Sync, kind, body length, position.
const HEAD_BYTES: usize = 9;
const CRC_BYTES: usize = 2;

/// What a packet is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Kind {
    /// A [`Setup`]; the encoder starts anew.
    Setup = 1,
    /// EVT 2.0 words, little-endian.
    Words = 2,
    /// The stream has ended: the open window is to be closed and sent.
    Flush = 3,
    /// A [`Status`], from the encoder: its answer to a setup and to a flush.
    Status = 4,
}

impl Kind {
    const fn from_code(code: u8) -> Option<Self> {
        match code {
            1 => Some(Self::Setup),
            2 => Some(Self::Words),
            3 => Some(Self::Flush),
            4 => Some(Self::Status),
            _ => None,
        }
    }
}

/// One packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Packet<'p> {
    /// What it is.
    pub kind: Kind,
    /// Events sent before it since the setup; wraps.
    pub position: u32,
    /// Its content, at most [`BODY_BYTES_MAX`].
    pub body: &'p [u8],
}

/// The packet does not fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooLong;

impl Packet<'_> {
    /// Writes the packet to the start of `out` and returns its length.
    ///
    /// # Errors
    /// [`TooLong`]: the body is above its maximum, or `out` is too short.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        let crc_at = HEAD_BYTES + self.body.len();
        let end = crc_at + CRC_BYTES;
        if self.body.len() > BODY_BYTES_MAX || out.len() < end {
            return Err(TooLong);
        }
        out[..2].copy_from_slice(&SYNC);
        out[2] = self.kind as u8;
        out[3..5].copy_from_slice(&(self.body.len() as u16).to_le_bytes());
        out[5..9].copy_from_slice(&self.position.to_le_bytes());
        out[HEAD_BYTES..crc_at].copy_from_slice(self.body);
        let crc = CRC_16.checksum(&out[..crc_at]);
        out[crc_at..end].copy_from_slice(&crc.to_le_bytes());
        Ok(end)
    }
}

fn write_body(fields: &impl Serialize, out: &mut [u8]) -> Result<usize, TooLong> {
    postcard::to_slice(fields, out)
        .map(|bytes| bytes.len())
        .map_err(|_| TooLong)
}

/// `None` where bytes are left, too: another layout.
fn parse_body<'b, T: Deserialize<'b>>(body: &'b [u8]) -> Option<T> {
    let (fields, rest) = postcard::take_from_bytes(body).ok()?;
    rest.is_empty().then_some(fields)
}

/// What the encoder is set to by a [`Kind::Setup`] packet; postcard writes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setup {
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// T in microseconds.
    pub window_us: u32,
    /// tau_low in 10^-12 events per pixel per second.
    pub tau_low_pico: u64,
    /// tau_high in the same unit.
    pub tau_high_pico: u64,
    /// Code of the transform, 255 for the regime's.
    pub transform: u8,
    /// M.
    pub m: u8,
    /// K, 0 for the transform's default.
    pub grid: u16,
    /// log2 of the quantiser's step.
    pub step_log2: i8,
    /// What frames hold, as the low four bits of a frame's mode.
    pub mode: u8,
    /// Microseconds of a tolerance, or bins; else 0.
    pub fidelity: u32,
    /// Windows after which a frame of the dense coder begins anew.
    pub key_windows: u16,
    /// First column, first row, columns and rows of the region that is sent; no columns for all.
    pub region: [u16; 4],
    /// 1 where events that are alone are not sent.
    pub isolated: u8,
    /// Bytes that the frames of any second take at the most; 0 for any.
    pub bytes_per_second: u32,
    /// Time that the words' 0 stands for, in microseconds.
    pub time_base_us: u64,
    /// What to do with events while no window is free: 0 wait, so that the link's flow control
    /// holds the sender; 1 drop and count them, as for a sensor that cannot be held.
    pub when_full: u8,
}

impl Setup {
    const AUTO: u8 = 255;
    /// [`Setup::when_full`]: wait.
    pub const WAIT: u8 = 0;
    /// [`Setup::when_full`]: drop and count.
    pub const DROP: u8 = 1;

    /// The setup of a configuration, for words from `time_base_us` on; waits when full.
    #[must_use]
    pub fn new(config: &Config, time_base_us: u64) -> Self {
        let (mode, fidelity) = config.mode.code();
        Self {
            width: config.window.sensor.width,
            height: config.window.sensor.height,
            window_us: config.window.window_us,
            tau_low_pico: config.thresholds.tau_low_pico(),
            tau_high_pico: config.thresholds.tau_high_pico(),
            transform: config
                .transform
                .map_or(Self::AUTO, |transform| transform as u8),
            m: config.m,
            grid: config.grid.unwrap_or(0),
            step_log2: config.quantiser.step_log2(),
            mode,
            fidelity: fidelity.unwrap_or(0),
            key_windows: config.key_windows,
            region: config.filter.region.map_or([0; 4], |region| {
                [region.x, region.y, region.width, region.height]
            }),
            isolated: config.filter.isolated.into(),
            bytes_per_second: config.bytes_per_second.map_or(0, NonZeroU32::get),
            time_base_us,
            when_full: Self::WAIT,
        }
    }

    /// Writes it as a packet's body to the start of `out` and returns its length.
    ///
    /// # Errors
    /// [`TooLong`]: `out` is too short; 96 bytes are enough.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        write_body(self, out)
    }

    /// Reads a packet's body; `None` where it is none.
    #[must_use]
    pub fn parse(body: &[u8]) -> Option<Self> {
        parse_body(body)
    }

    /// The configuration, or `None` where a field is out of its range; M and K are left to the
    /// encoder's own check.
    #[must_use]
    pub fn config(&self) -> Option<Config> {
        if self.when_full > Self::DROP || self.isolated > 1 {
            return None;
        }
        let [x, y, width, height] = self.region;
        let region = Region {
            x,
            y,
            width,
            height,
        };
        Some(Config {
            window: WindowConfig {
                sensor: Sensor::new(self.width, self.height)?,
                window_us: self.window_us,
            },
            thresholds: Thresholds::new(self.tau_low_pico, self.tau_high_pico)?,
            transform: match self.transform {
                Self::AUTO => None,
                code => Some(Transform::from_code(code)?),
            },
            m: self.m,
            grid: (self.grid > 0).then_some(self.grid),
            quantiser: Quantiser::new(self.step_log2)?,
            mode: Mode::from_code(self.mode, self.fidelity)?,
            key_windows: self.key_windows,
            readout: None,
            filter: Filter {
                region: (width > 0).then_some(region),
                isolated: self.isolated == 1,
            },
            bytes_per_second: NonZeroU32::new(self.bytes_per_second),
            keep_order: false,
        })
    }
}

/// What an encoder says of itself, after a setup and after a flush; postcard writes it.
///
/// Counts run since the start of the encoder and wrap; times are of its own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Kind of the packet that this answers: 1 setup, 3 flush; 0 after a restart.
    pub answers: u8,
    /// Whether an encoder is set up; a refused setup leaves none.
    pub running: bool,
    /// Events that a window holds before it closes early.
    pub window_events: u32,
    /// Largest frame in bytes.
    pub frame_bytes: u32,
    /// Events decoded from words.
    pub events: u32,
    /// Events that were lost on the link: in damaged packets, by the packets' positions.
    pub lost: u32,
    /// Events that came while no window was free, or while no encoder was set up.
    pub dropped: u32,
    /// Words that were no events and no times, events without a time, bytes left over.
    pub ignored: u32,
    /// Bytes that belonged to no packet.
    pub damaged_bytes: u32,
    /// Bytes that the UART lost because they were not read in time.
    pub overruns: u32,
    /// Windows encoded.
    pub windows: u32,
    /// Frames sent.
    pub frames: u32,
    /// Time spent on received bytes, in nanoseconds.
    pub receive_ns: u64,
    /// Time spent encoding, in nanoseconds, interrupts excluded.
    pub encode_ns: u64,
    /// Time spent sending frames, in nanoseconds, interrupts excluded.
    pub send_ns: u64,
    /// Bytes of the stack that were ever used.
    pub stack_bytes: u32,
}

impl Status {
    /// Writes it as a packet's body to the start of `out` and returns its length.
    ///
    /// # Errors
    /// [`TooLong`]: `out` is too short; 96 bytes are enough.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        write_body(self, out)
    }

    /// Reads a packet's body; `None` where it is none.
    #[must_use]
    pub fn parse(body: &[u8]) -> Option<Self> {
        parse_body(body)
    }
}

/// Finds packets in received bytes, which may be damaged.
#[derive(Debug, Clone)]
pub struct Receiver {
    buffer: Vec<u8, PACKET_BYTES_MAX>,
    /// Length of the packet that was handed out and is still in the buffer.
    taken: usize,
    /// Bytes in the buffer from which on there is something new to see.
    awaited: usize,
    damaged_bytes: u32,
}

impl Receiver {
    /// A receiver before its first byte.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: Vec::new(),
            taken: 0,
            awaited: 1,
            damaged_bytes: 0,
        }
    }

    /// Bytes that belonged to no packet.
    #[must_use]
    pub const fn damaged_bytes(&self) -> u32 {
        self.damaged_bytes
    }

    /// Takes the next byte; returns the packet that it completes.
    ///
    /// After damage the search goes on at the next sync bytes within what was received. A byte may
    /// so complete several packets: [`Receiver::next_packet`] has the others.
    pub fn push(&mut self, byte: u8) -> Option<Packet<'_>> {
        self.release();
        self.put(byte);
        self.next_packet()
    }

    /// Takes the next byte and looks at nothing. All packets before it must have been taken.
    #[inline]
    pub fn put(&mut self, byte: u8) {
        // Never full: whatever can be a packet is shorter, and all else is discarded.
        let _ = self.buffer.push(byte);
    }

    /// Takes bytes until there is something new to see; `false` where they end before.
    #[inline]
    pub fn fill(&mut self, mut next_byte: impl FnMut() -> Option<u8>) -> bool {
        while self.buffer.len() < self.awaited {
            match next_byte() {
                Some(byte) => self.put(byte),
                None => return false,
            }
        }
        true
    }

    /// The next packet of what was received, if it is whole.
    #[inline]
    pub fn next_packet(&mut self) -> Option<Packet<'_>> {
        self.release();
        if self.buffer.len() < self.awaited {
            return None;
        }
        self.search();
        self.packet()
    }

    /// The packet that was returned last, until the next one is asked for.
    #[inline]
    #[must_use]
    pub fn packet(&self) -> Option<Packet<'_>> {
        let packet = self.buffer.get(..self.taken)?;
        let (head, rest) = packet.split_first_chunk::<HEAD_BYTES>()?;
        let (body, _) = rest.split_last_chunk::<CRC_BYTES>()?;
        Some(Packet {
            kind: Kind::from_code(head[2])?,
            position: u32::from_le_bytes([head[5], head[6], head[7], head[8]]),
            body,
        })
    }

    /// The little-endian words of that packet's body from offset `at` on.
    #[inline]
    #[must_use]
    pub fn words(&self, at: usize) -> &[[u8; 4]] {
        let end = self.taken.saturating_sub(CRC_BYTES);
        let bytes = self.buffer.get(HEAD_BYTES + at..end);
        bytes.map_or(&[], |bytes| bytes.as_chunks().0)
    }

    /// Gives up the packet that was returned last.
    fn release(&mut self) {
        if self.taken > 0 {
            let taken = core::mem::take(&mut self.taken);
            self.discard(taken);
        }
    }

    fn search(&mut self) {
        loop {
            match look(&self.buffer) {
                Look::More(awaited) => {
                    self.awaited = awaited;
                    return;
                }
                Look::Damage => {
                    let skip = next_sync(&self.buffer, SYNC);
                    self.damaged_bytes = self.damaged_bytes.wrapping_add(skip as u32);
                    self.discard(skip);
                }
                Look::Packet(end) => {
                    self.taken = end;
                    return;
                }
            }
        }
    }

    fn discard(&mut self, bytes: usize) {
        let len = self.buffer.len();
        let bytes = bytes.min(len);
        self.buffer.copy_within(bytes.., 0);
        self.buffer.truncate(len - bytes);
        self.awaited = 1;
    }
}

enum Look {
    /// This many bytes are needed to see more.
    More(usize),
    Damage,
    /// A whole packet of this length.
    Packet(usize),
}

fn look(bytes: &[u8]) -> Look {
    if bytes.iter().zip(SYNC).any(|(byte, sync)| *byte != sync) {
        return Look::Damage;
    }
    let Some(head) = bytes.first_chunk::<HEAD_BYTES>() else {
        return match bytes.get(2) {
            Some(kind) if Kind::from_code(*kind).is_none() => Look::Damage,
            _ => Look::More(bytes.len() + 1),
        };
    };
    let body = usize::from(u16::from_le_bytes([head[3], head[4]]));
    if Kind::from_code(head[2]).is_none() || body > BODY_BYTES_MAX {
        return Look::Damage;
    }
    let end = HEAD_BYTES + body + CRC_BYTES;
    let Some((checked, crc)) = bytes
        .get(..end)
        .and_then(<[u8]>::split_last_chunk::<CRC_BYTES>)
    else {
        return Look::More(end);
    };
    if CRC_16.checksum(checked).to_le_bytes() == *crc {
        Look::Packet(end)
    } else {
        Look::Damage
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec as StdVec;

    fn packet() -> impl Strategy<Value = (Kind, u32, StdVec<u8>)> {
        (
            prop_oneof![
                Just(Kind::Setup),
                Just(Kind::Words),
                Just(Kind::Flush),
                Just(Kind::Status)
            ],
            any::<u32>(),
            proptest::collection::vec(
                prop_oneof![any::<u8>(), Just(0xEE), Just(0xC6)],
                0..=BODY_BYTES_MAX,
            ),
        )
    }

    fn bytes((kind, position, body): &(Kind, u32, StdVec<u8>)) -> StdVec<u8> {
        let mut out = [0; PACKET_BYTES_MAX];
        let packet = Packet {
            kind: *kind,
            position: *position,
            body,
        };
        let len = packet.write(&mut out).unwrap();
        out[..len].to_vec()
    }

    fn receive(receiver: &mut Receiver, bytes: &[u8]) -> StdVec<(Kind, u32, StdVec<u8>)> {
        let mut found = StdVec::new();
        for byte in bytes {
            let mut packet = receiver.push(*byte);
            while let Some(Packet {
                kind,
                position,
                body,
            }) = packet
            {
                found.push((kind, position, body.to_vec()));
                packet = receiver.next_packet();
            }
        }
        found
    }

    #[test]
    fn setups_return_or_are_refused() {
        let setup = Setup {
            width: 320,
            height: 320,
            window_us: 32_768,
            tau_low_pico: 1,
            tau_high_pico: u64::MAX,
            transform: 255,
            m: 16,
            grid: 0,
            step_log2: -6,
            mode: 0,
            fidelity: 0,
            key_windows: 64,
            region: [3, 4, 100, 2],
            isolated: 1,
            bytes_per_second: u32::MAX,
            time_base_us: u64::MAX,
            when_full: Setup::WAIT,
        };
        let mut out = [0; 96];
        let len = setup.write(&mut out).unwrap();
        assert_eq!(Setup::parse(&out[..len]), Some(setup));
        assert_eq!(Setup::parse(&out[..=len]), None);
        assert_eq!(Setup::parse(&out[..len - 1]), None);
        assert_eq!(Setup::new(&setup.config().unwrap(), u64::MAX), setup);
        for wrong in [
            Setup { width: 0, ..setup },
            Setup {
                height: 2049,
                ..setup
            },
            Setup {
                tau_low_pico: 2,
                tau_high_pico: 1,
                ..setup
            },
            Setup {
                transform: 3,
                ..setup
            },
            Setup {
                step_log2: 9,
                ..setup
            },
            Setup {
                when_full: 2,
                ..setup
            },
            Setup {
                isolated: 2,
                ..setup
            },
        ] {
            assert_eq!(wrong.config(), None, "{wrong:?}");
        }
    }

    #[test]
    fn the_longest_status_returns() {
        let status = Status {
            answers: u8::MAX,
            running: true,
            window_events: u32::MAX,
            frame_bytes: u32::MAX,
            events: u32::MAX,
            lost: u32::MAX,
            dropped: u32::MAX,
            ignored: u32::MAX,
            damaged_bytes: u32::MAX,
            overruns: u32::MAX,
            windows: u32::MAX,
            frames: u32::MAX,
            receive_ns: u64::MAX,
            encode_ns: u64::MAX,
            send_ns: u64::MAX,
            stack_bytes: u32::MAX,
        };
        let mut out = [0; 96];
        let len = status.write(&mut out).unwrap();
        assert_eq!(Status::parse(&out[..len]), Some(status));
        assert_eq!(Status::parse(&out[..=len]), None);
        assert_eq!(Status::parse(&out[..len - 1]), None);
    }

    #[test]
    fn what_is_too_long_is_refused() {
        let body = [0; BODY_BYTES_MAX + 1];
        let packet = Packet {
            kind: Kind::Words,
            position: 0,
            body: &body,
        };
        assert_eq!(packet.write(&mut [0; 2 * PACKET_BYTES_MAX]), Err(TooLong));
        let packet = Packet {
            body: &[1, 2],
            ..packet
        };
        assert_eq!(packet.write(&mut [0; HEAD_BYTES + 3]), Err(TooLong));
        assert_eq!(packet.write(&mut [0; HEAD_BYTES + 4]), Ok(HEAD_BYTES + 4));
    }

    proptest! {
        #[test]
        fn packets_are_received(packets in proptest::collection::vec(packet(), 0..6)) {
            let stream: StdVec<u8> = packets.iter().flat_map(bytes).collect();
            let mut receiver = Receiver::new();
            prop_assert_eq!(receive(&mut receiver, &stream), packets);
            prop_assert_eq!(receiver.damaged_bytes(), 0);
        }

        #[test]
        fn whole_packets_are_found_behind_damage(
            before in packet(), after in proptest::collection::vec(packet(), 2..5),
            flip in any::<usize>(), bits in 1..=255_u8, garbage in proptest::collection::vec(any::<u8>(), 0..40),
        ) {
            let mut stream = bytes(&before);
            let at = flip % stream.len();
            stream[at] ^= bits;
            stream.extend(garbage);
            for packet in &after {
                stream.extend(bytes(packet));
            }
            // Whatever the damage claims to be ends within the longest packet.
            stream.extend([0; PACKET_BYTES_MAX]);
            let mut receiver = Receiver::new();
            let found = receive(&mut receiver, &stream);
            prop_assert!(found.ends_with(&after), "{:?} {:?}", found.len(), receiver.damaged_bytes());
        }

        #[test]
        fn any_bytes_are_survived(bytes in proptest::collection::vec(
            prop_oneof![any::<u8>(), Just(0xEE), Just(0xC6), Just(2), Just(0)], 0..3000,
        )) {
            receive(&mut Receiver::new(), &bytes);
        }
    }
}
