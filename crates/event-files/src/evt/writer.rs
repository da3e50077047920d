//! What all writers of Prophesee RAW files share: the header, the upper bits of time, checks.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Sensor, bail, error};

use crate::evt::header::{RawHeader, Words};
use crate::output::sequential::Output;
use crate::wrapping::Wrapping;

/// A writer of RAW files whose words include some that carry the upper bits of time.
///
/// It holds any times up to 2^60 us, in any order as long as a reader can follow the wraps. Up to 4,096 wraps from
/// time 0 are written out for every reader. Beyond that, the header's `% time_base_us` carries what exceeds the
/// words' time bits, and readers that do not know it lose only that.
pub struct RawWriter {
    file: Output,
    sensor: Sensor,
    words: Words,
    high_bits: u32,
    low_bits: u32,
    /// Counter of the upper bits of time; `None` until the first event, whose time the header needs.
    high: Option<Wrapping>,
    /// Largest step forwards of the upper bits that is written value by value.
    walk_max: u64,
    /// Smallest step forwards of the upper bits whose word is written twice.
    jump: u64,
    events: u64,
    /// Bytes to be written together, and how many there are so far: fewer than [`TOGETHER`] between two calls.
    bytes: Box<[u8; TOGETHER + ROOM]>,
    filled: usize,
}

/// Bytes that are written together, or some more.
const TOGETHER: usize = 8192;
/// How many bytes more.
const ROOM: usize = 8;

impl RawWriter {
    /// Creates the file. Of a time, the lowest `low_bits` are in an event's word, the `high_bits` above in another
    /// word.
    ///
    /// # Errors
    /// I/O.
    pub fn create(
        path: &Path,
        sensor: Sensor,
        words: Words,
        (high_bits, low_bits): (u32, u32),
    ) -> Result<Self> {
        let file = Output::create(path)?;
        Ok(Self {
            file,
            sensor,
            words,
            high_bits,
            low_bits,
            high: None,
            walk_max: 0,
            jump: u64::MAX,
            events: 0,
            bytes: Box::new([0; TOGETHER + ROOM]),
            filled: 0,
        })
    }

    /// Writes every value of the upper bits in a step forwards by at most `walk_max`, as sensors do, since decoders
    /// report a value that is left out as lost data.
    pub const fn walking(mut self, walk_max: u64) -> Self {
        self.walk_max = walk_max;
        self
    }

    /// Writes the upper bits of time twice where they step forwards by `jump` or more, for decoders that take a
    /// single such word for damage.
    pub const fn confirming(mut self, jump: u64) -> Self {
        self.jump = jump;
        self
    }

    /// Returns the sensor's size.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Writes the next bytes.
    ///
    /// # Errors
    /// I/O.
    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        for part in bytes.chunks(ROOM) {
            let mut whole = [0; ROOM];
            for (to, from) in whole.iter_mut().zip(part) {
                *to = *from;
            }
            self.put_first(whole, part.len())?;
        }
        Ok(())
    }

    /// Writes the first `count` of these bytes.
    ///
    /// # Errors
    /// I/O.
    #[inline]
    pub fn put_first(&mut self, bytes: [u8; ROOM], count: usize) -> Result<()> {
        let room = self.bytes.get_mut(self.filled..);
        if let Some(room) = room.and_then(<[u8]>::first_chunk_mut) {
            *room = bytes;
        }
        self.filled += count.min(ROOM);
        if self.filled < TOGETHER {
            return Ok(());
        }
        self.put_all()
    }

    /// Writes the bytes so far.
    #[inline(never)]
    fn put_all(&mut self) -> Result<()> {
        let filled = std::mem::take(&mut self.filled);
        let bytes = self.bytes.get(..filled).unwrap_or_default();
        self.file.put(bytes)
    }

    /// Counts an event, and returns true, if it lies on the sensor and the upper bits of its time are the current ones.
    #[inline]
    pub fn goes_on(&mut self, event: &Event) -> bool {
        let last = self.high.as_ref().and_then(Wrapping::last);
        let goes_on =
            last == Some(event.t_us >> self.low_bits) && self.sensor.contains(event.x, event.y);
        self.events += u64::from(goes_on);
        goes_on
    }

    /// Prepares to write the next events, which share one time: checks that they lie on the sensor, and writes the
    /// upper bits of their time, each value encoded by `word`, if they have changed. Returns whether they have.
    ///
    /// # Errors
    /// I/O; an event outside the sensor; a time that a reader could not follow.
    pub fn begin<const N: usize>(
        &mut self,
        events: &[Event],
        word: impl Fn(u64) -> [u8; N],
    ) -> Result<bool> {
        let Some(Event { t_us, .. }) = events.first().copied() else {
            return Ok(false);
        };
        for (event, index) in events.iter().zip(self.events..) {
            crate::check_inside(self.file.name(), index, event, self.sensor)?;
        }
        let mut high = match self.high.take() {
            Some(high) => high,
            None => self.header(t_us)?,
        };
        let target = t_us >> self.low_bits;
        let is_new = high.last() != Some(target);
        let walks = high
            .last()
            .and_then(|last| target.checked_sub(last))
            .is_some_and(|step| step <= self.walk_max);
        while high.last() != Some(target) {
            let last = high.last();
            let next = high
                .step(match last {
                    Some(last) if walks => last + 1,
                    _ => target,
                })
                .ok_or_else(|| error!(CannotHold, "{}", self.refused(t_us)))?;
            let bytes = word(high.low(next));
            self.put(&bytes)?;
            if last.is_some_and(|last| next.saturating_sub(last) >= self.jump) {
                self.put(&bytes)?;
            }
        }
        self.high = Some(high);
        self.events += events.len() as u64;
        Ok(is_new)
    }

    fn header(&mut self, first_us: u64) -> Result<Wrapping> {
        if first_us > Wrapping::START_MAX {
            bail!(CannotHold, "{}", self.refused(first_us));
        }
        let high = Wrapping::from_zero(self.high_bits, first_us >> self.low_bits);
        let base_us = high.base() << self.low_bits;
        let text = RawHeader::text(self.words, self.sensor, base_us);
        self.put(text.as_bytes())?;
        Ok(high)
    }

    fn refused(&self, t_us: u64) -> String {
        crate::time_refused(self.file.name(), self.events, t_us, self.words.title())
    }

    /// Writes the header if there were no events, and flushes everything to the disk.
    ///
    /// # Errors
    /// I/O.
    pub fn finish(mut self) -> Result<()> {
        if self.events == 0 {
            self.header(0)?;
        }
        self.put_all()?;
        self.file.finish()
    }
}
