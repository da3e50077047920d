//! What all writers of Prophesee RAW files share: the header, the upper bits of time, checks.

use std::hint::select_unpredictable;
use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Sensor, bail, error};

use crate::evt::header::{RawHeader, Words};
use crate::output::collected::{Collected, ROOM};
use crate::output::sequential::Output;
use crate::wrapping::Wrapping;

/// A writer of RAW files whose words include some that carry the upper bits of time.
///
/// It holds any times up to 2^60 us, in any order as long as a reader can follow the wraps. Up to 4,096 wraps from
/// time 0 are written out for every reader. Beyond that, the header's `% time_base_us` carries what exceeds the
/// words' time bits, and readers that do not know it lose only that.
pub struct RawWriter {
    file: Collected,
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
}

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
        Ok(Self {
            file: Collected::new(Output::create(path)?),
            sensor,
            words,
            high_bits,
            low_bits,
            high: None,
            walk_max: 0,
            jump: u64::MAX,
            events: 0,
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
        self.file.put(bytes)
    }

    /// Writes the first `count` of these bytes.
    ///
    /// # Errors
    /// I/O.
    #[inline]
    pub fn put_first(&mut self, bytes: [u8; ROOM], count: usize) -> Result<()> {
        self.file.put_first(bytes, count)
    }

    /// Writes the words of the events at the start of `events` that lie on the sensor and whose upper bits of time are the
    /// current ones: the first bytes of what `words` returns of an event and those after it, with their number, up to the
    /// first `None`. Returns how many events these are.
    ///
    /// # Errors
    /// I/O.
    #[inline]
    pub fn put_run(
        &mut self,
        events: &[Event],
        mut words: impl FnMut(&Event, &[Event]) -> Option<(u64, usize)>,
    ) -> Result<usize> {
        let Some(high) = self.high.as_ref().and_then(Wrapping::last) else {
            return Ok(0);
        };
        let (sensor, low_bits) = (self.sensor, self.low_bits);
        let mut rest = events;
        self.file.fill(|room| {
            let mut at = 0;
            while let Some((event, later)) = rest.split_first()
                && let Some(room) = room.get_mut(at..).and_then(<[u8]>::first_chunk_mut)
                && event.t_us >> low_bits == high
                && sensor.contains(event.x, event.y)
                && let Some((words, count)) = words(event, later)
            {
                *room = words.to_le_bytes();
                at += count.min(ROOM);
                rest = later;
            }
            at
        })?;
        let written = events.len() - rest.len();
        self.events += written as u64;
        Ok(written)
    }

    /// Writes the words of the events at the start of `events` that lie on the sensor and whose times lie in the half
    /// period of the time before, each after the word of its upper bits of time where these have changed. Returns how many
    /// events these are; none of a writer that is [`walking`](Self::walking) or [`confirming`](Self::confirming).
    ///
    /// # Errors
    /// I/O.
    #[inline]
    pub fn put_while(
        &mut self,
        events: &[Event],
        time: impl Fn(u64) -> u32,
        word: impl Fn(&Event) -> u32,
    ) -> Result<usize> {
        let Some((counter, start)) = self
            .high
            .as_mut()
            .and_then(|high| high.last().map(|last| (high, last)))
            .filter(|_| self.walk_max == 0 && self.jump == u64::MAX)
        else {
            return Ok(0);
        };
        let (sensor, low_bits, half_bits) = (self.sensor, self.low_bits, self.high_bits - 1);
        let mask = counter.low(u64::MAX);
        let (mut rest, mut last) = (events, start);
        self.file.fill(|room| {
            let mut at = 0;
            while let Some((event, later)) = rest.split_first()
                && let Some(room) = room.get_mut(at..).and_then(<[u8]>::first_chunk_mut)
                && let high = event.t_us >> low_bits
                && (high ^ start) >> half_bits == 0
                && sensor.contains(event.x, event.y)
            {
                // Where the upper bits change is hard to predict, so nothing here branches on it.
                let (is_new, word) = (high != last, u64::from(word(event)));
                let both = u64::from(time(high & mask)) | word << 32;
                *room = select_unpredictable(is_new, both, word).to_le_bytes();
                at += 4 + 4 * usize::from(is_new);
                (last, rest) = (high, later);
            }
            at
        })?;
        counter.extend(counter.low(last));
        let written = events.len() - rest.len();
        self.events += written as u64;
        Ok(written)
    }

    /// Prepares to write the next events, whose times share the upper bits: checks that they lie on the sensor, and writes
    /// these bits, each value encoded by `word`, if they have changed. Returns whether they have.
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
        crate::check_all_inside(self.file.name(), self.events, events, self.sensor)?;
        let target = t_us >> self.low_bits;
        if self.high.as_ref().and_then(Wrapping::last) == Some(target) {
            self.events += events.len() as u64;
            return Ok(false);
        }
        let mut high = match self.high.take() {
            Some(high) => high,
            None => self.header(t_us)?,
        };
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
        Ok(true)
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
        self.file.finish()
    }
}
