//! Decodes events from messages that arrive one after another, from a file or over a network.
//!
//! Times are always those of the sensor or its driver, never the computer's clock at the arrival:
//!
//! * `evt3`: the times of the words, in us since the sensor's start; like the package `event_camera_codecs`, this
//!   decoder does not use `time_base`. Except for their place in messages, words are as in EVT 3.0 files: rows,
//!   times and wraps carry over from one message to the next.
//! * `libcaer`: `time_base` + 1000 * the 31 bits of the time word, in ns; a time below the previous one in the same
//!   message has rolled over, which adds 2^31 us. Data word: polarity bit 1, y bits 2 to 16, x bits 17 to 31 (bit
//!   0, libcaer's mark of validity, is ignored).
//! * `libcaer_cmp`: `time_base` + 1000 * 24 bits, which begin at 0 in every message. Words: type in the upper 4
//!   bits (0 time bits 23..12; 1 time bits 11..0; 2 x; 3 y, with polarity in bit 11: one event; 4 first y and
//!   polarity of vectors; 5 bit i: an event at y + i, then y advances by 8). x, first y and polarity carry over.
//! * `mono`: `time_base` + 32 bits of ns; x bits 32 to 47, y bits 48 to 62, polarity bit 63.
//! * `EventArray`: the structure's time.
//!
//! Nanoseconds are rounded down to microseconds.

use event_types::{Event, Polarity, Sensor};

use super::fields::Fields;
use super::message::{Content, Damage, Encoding};
use crate::evt::evt3::{VECTOR_EVENTS, WordDecoder};
use crate::evt::row::Outside;
use crate::input::{Batch, OUTSIDE};
use crate::{Assumption, Skipped};

/// The state of `libcaer_cmp` words.
#[derive(Debug, Default)]
pub(super) struct VectorState {
    high: u16,
    low: u16,
    x: u16,
    y: u32,
    polarity: bool,
}

impl VectorState {
    /// Begins a message.
    pub fn message(&mut self) {
        (self.high, self.low) = (0, 0);
    }

    /// Returns the microseconds since the message's `time_base`.
    pub fn since_us(&self) -> u64 {
        u64::from(self.high) << 12 | u64::from(self.low)
    }

    /// Updates the state with a word; the word's own events need the state before it.
    pub fn take(&mut self, word: u16) {
        let value = word & 0xfff;
        match word >> 12 {
            0 => self.high = value,
            1 => self.low = value,
            VECTOR_X => self.x = word & 0x7ff,
            VECTOR_BASE => (self.y, self.polarity) = (u32::from(word & 0x7ff), word & 0x800 != 0),
            VECTOR => self.y = self.y.saturating_add(8),
            _ => {}
        }
    }
}

// Types of `libcaer_cmp` words.
pub(super) const VECTOR_X: u16 = 2;
const VECTOR_EVENT: u16 = 3;
pub(super) const VECTOR_BASE: u16 = 4;
const VECTOR: u16 = 5;

/// The state carried over from earlier messages, and the message whose events are being read.
pub struct MessageEvents {
    sensor: Sensor,
    /// The latest message.
    pub(super) message: Vec<u8>,
    /// Its part that has not been read.
    pub(super) content: Option<Content>,
    pub(super) evt3: WordDecoder,
    /// For `libcaer`: time added by roll-overs within this message.
    libcaer_high_us: u64,
    libcaer_last_us: u64,
    pub(super) vectors: VectorState,
    /// Whether all messages from the first on have been read, so that event numbers are known.
    pub(super) is_counted: bool,
    /// Whether events outside the sensor are left out and counted instead of ending the recording.
    pub(super) leave_out: bool,
    events: u64,
    /// Contains the assumption that times were rounded, once one was.
    assumptions: Vec<Assumption>,
    pub(super) skipped: Skipped,
}

impl MessageEvents {
    /// Starts before the first message.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        Self {
            sensor,
            message: Vec::new(),
            content: None,
            evt3: WordDecoder::new(sensor, 0),
            libcaer_high_us: 0,
            libcaer_last_us: 0,
            vectors: VectorState::default(),
            is_counted: true,
            leave_out: false,
            events: 0,
            assumptions: Vec::new(),
            skipped: Skipped::default(),
        }
    }

    /// Returns the size of the sensor.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the assumptions made so far.
    #[must_use]
    pub fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    /// Returns what has been left out so far: unknown words and events outside the sensor.
    #[must_use]
    pub const fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    /// Begins a message, whose `content` was returned by [`super::message::Head::read`]. Unread events of the
    /// previous message are dropped; its buffer is returned for reuse.
    pub fn take(&mut self, message: Vec<u8>, content: Content) -> Vec<u8> {
        let before = std::mem::replace(&mut self.message, message);
        self.begin(content);
        before
    }

    /// Begins the content of the latest message.
    pub(super) fn begin(&mut self, content: Content) {
        self.content = Some(content);
        (self.libcaer_high_us, self.libcaer_last_us) = (0, 0);
        self.vectors.message();
    }

    /// Resets the state that messages carry over.
    pub(super) fn forget(&mut self) {
        self.content = None;
        self.is_counted = false;
        self.evt3 = WordDecoder::new(self.sensor, 0);
        self.vectors = VectorState::default();
    }

    /// Appends events of the message while the batch has room; returns whether there is room for another message's.
    ///
    /// # Errors
    /// The message is damaged; the error is the position and a description. Events appended before it are valid.
    pub fn read(&mut self, batch: &mut Batch<'_>) -> Result<bool, Damage> {
        self.evt3.leave_out = self.leave_out;
        while batch.room() >= VECTOR_EVENTS {
            match self.content {
                None => return Ok(true),
                Some(content) if content.is_empty() => self.content = None,
                Some(Content::Packed {
                    encoding,
                    base_ns,
                    at,
                    end,
                }) => {
                    let at = self.packed(encoding, base_ns, at, end, batch)?;
                    self.content = Some(Content::Packed {
                        encoding,
                        base_ns,
                        at,
                        end,
                    });
                }
                Some(mut content) => {
                    self.structure(&mut content, batch)?;
                    self.content = Some(content);
                }
            }
        }
        Ok(false)
    }

    fn outside(&self, at: usize, x: i64, y: i64) -> Damage {
        let Sensor { width, height } = self.sensor;
        let event = match self.is_counted {
            true => format!("event {}", self.events),
            false => "an event".to_owned(),
        };
        let what = format!(
            "{event} at x = {x}, y = {y} is outside the sensor ({width}x{height}): the recording \
             is damaged"
        );
        (at, what)
    }

    /// Appends the event at byte `at` of the message.
    fn push(
        &mut self,
        at: usize,
        (t_ns, x, y, on): (u64, u32, u32, bool),
        batch: &mut Batch<'_>,
    ) -> Result<(), Damage> {
        let inside = u16::try_from(x).ok().zip(u16::try_from(y).ok());
        let inside = inside.filter(|(x, y)| self.sensor.contains(*x, *y));
        let Some((x, y)) = inside else {
            if self.leave_out {
                self.skipped.add(OUTSIDE, 1);
                self.events += 1;
                return Ok(());
            }
            return Err(self.outside(at, x.into(), y.into()));
        };
        if t_ns % 1000 != 0 && self.assumptions.is_empty() {
            self.assumptions.push(Assumption::times_rounded("down"));
        }
        batch.push(Event {
            t_us: t_ns / 1000,
            x,
            y,
            polarity: Polarity::from_bool(on),
        });
        self.events += 1;
        Ok(())
    }

    /// Decodes packed events from position `at` on while the batch has room; returns the position after them.
    fn packed(
        &mut self,
        encoding: Encoding,
        base_ns: u64,
        mut at: usize,
        end: usize,
        batch: &mut Batch<'_>,
    ) -> Result<usize, Damage> {
        while at < end && batch.room() >= VECTOR_EVENTS {
            match encoding {
                Encoding::Evt3 => {
                    let word = u16::from_le_bytes(self.word(at));
                    let before = self.evt3.events;
                    let decoded = self.evt3.decode(word, batch, &mut self.skipped);
                    self.events += self.evt3.events - before;
                    if let Err(Outside { x, y, .. }) = decoded {
                        return Err(self.outside(at, x.into(), y.into()));
                    }
                }
                Encoding::LibcaerCmp => {
                    let word = u16::from_le_bytes(self.word(at));
                    self.vector(at, word, base_ns, batch)?;
                }
                Encoding::Libcaer => {
                    let [data, time] = self.pair(at);
                    if time > i32::MAX as u32 {
                        let what = format!("time {time} has more than 31 bits: it is damaged");
                        return Err((at + 4, what));
                    }
                    let time_us = u64::from(time);
                    if time_us < self.libcaer_last_us {
                        self.libcaer_high_us += 1 << 31;
                    }
                    self.libcaer_last_us = time_us;
                    let t_ns = self.time(at, base_ns, (self.libcaer_high_us + time_us) * 1000)?;
                    let (x, y) = (data >> 17, data >> 2 & 0x7fff);
                    self.push(at, (t_ns, x, y, data & 2 != 0), batch)?;
                }
                Encoding::Mono => {
                    let [time_ns, data] = self.pair(at);
                    let t_ns = self.time(at, base_ns, time_ns.into())?;
                    let (x, y) = (data & 0xffff, data >> 16 & 0x7fff);
                    self.push(at, (t_ns, x, y, data >> 31 != 0), batch)?;
                }
            }
            at += encoding.word_bytes();
        }
        Ok(at)
    }

    /// Decodes a word of `libcaer_cmp`.
    fn vector(
        &mut self,
        at: usize,
        word: u16,
        base_ns: u64,
        batch: &mut Batch<'_>,
    ) -> Result<(), Damage> {
        let VectorState { x, y, polarity, .. } = self.vectors;
        let since_ns = self.vectors.since_us() * 1000;
        self.vectors.take(word);
        match word >> 12 {
            0 | 1 | VECTOR_X | VECTOR_BASE => {}
            VECTOR_EVENT => {
                let (row, on) = (u32::from(word & 0x7ff), word & 0x800 != 0);
                let t_ns = self.time(at, base_ns, since_ns)?;
                self.push(at, (t_ns, x.into(), row, on), batch)?;
            }
            VECTOR => {
                let t_ns = self.time(at, base_ns, since_ns)?;
                for bit in (0..8).filter(|bit| word >> bit & 1 == 1) {
                    let event = (t_ns, x.into(), y.saturating_add(bit), polarity);
                    self.push(at, event, batch)?;
                }
            }
            _ => self.skipped.add("unknown words", 1),
        }
        Ok(())
    }

    fn time(&self, at: usize, base_ns: u64, since_ns: u64) -> Result<u64, Damage> {
        base_ns.checked_add(since_ns).ok_or_else(|| {
            let what =
                format!("time_base {base_ns} ns leads to a time beyond 2^64 ns: it is damaged");
            (at, what)
        })
    }

    /// Returns the word at `at`, which must lie within the message.
    fn word<const N: usize>(&self, at: usize) -> [u8; N] {
        let rest = self.message.get(at..).unwrap_or_default();
        rest.first_chunk().copied().unwrap_or([0; N])
    }

    fn pair(&self, at: usize) -> [u32; 2] {
        let [a, b, c, d, e, f, g, h] = self.word(at);
        [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes)
    }

    /// Decodes the next structure.
    fn structure(&mut self, content: &mut Content, batch: &mut Batch<'_>) -> Result<(), Damage> {
        let Content::Array { cursor, left } = content else {
            return Ok(());
        };
        let at = cursor.at;
        let mut fields = Fields::resume(&self.message, *cursor);
        let mut event = || {
            let (x, y) = (fields.u16()?.into(), fields.u16()?.into());
            Ok((fields.time_ns()?, x, y, fields.u8()? != 0))
        };
        let event = event().map_err(|what: String| (at, what))?;
        (*cursor, *left) = (fields.cursor, *left - 1);
        let behind = fields.left();
        if *left == 0 && behind > 3 {
            // CDR pads a message to 4 bytes.
            let what = format!("{behind} bytes are left after the events: another layout");
            return Err((cursor.at, what));
        }
        self.push(at, event, batch)
    }
}
