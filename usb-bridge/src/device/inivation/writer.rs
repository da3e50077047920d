//! Checks of events before they are written: time must not run back, and pixels must be inside the sensor.

use anyhow::{Result, ensure};
use eecvs_nostd::{Event, Sensor};

use super::words16;

/// Most time words for one gap; a longer gap is refused. A device counts from 0 at its start, so a recording whose
/// times begin at an epoch has to be shifted.
pub const GAP_WORDS_MAX: u64 = 1 << 20;

/// Most wraps of one gap that are sent one by one: 36 minutes.
const SINGLE_WRAPS_MAX: u64 = 1 << 16;

/// Checks the order and the place of events.
#[derive(Debug)]
pub struct Order {
    model: &'static str,
    sensor: Sensor,
    events: u64,
    time: u64,
}

impl Order {
    pub const fn new(model: &'static str, sensor: Sensor) -> Self {
        Self {
            model,
            sensor,
            events: 0,
            time: 0,
        }
    }

    /// Returns to the state before the first event, with times from 0.
    pub fn restart(&mut self) {
        (self.events, self.time) = (0, 0);
    }

    /// Accepts times from 0 again, after a reset of the device's clock.
    pub fn reset_time(&mut self) {
        self.time = 0;
    }

    /// Checks the next event.
    ///
    /// # Errors
    /// The event is outside the sensor, or earlier than the one before it.
    pub fn check(&mut self, event: &Event) -> Result<()> {
        let Event { t_us, x, y, .. } = *event;
        ensure!(
            self.sensor.contains(x, y),
            "{}: event {} at x = {x}, y = {y} is outside the sensor ({}x{})",
            self.model,
            self.events,
            self.sensor.width,
            self.sensor.height
        );
        ensure!(
            t_us >= self.time,
            "{}: event {}: time runs backwards, from {} us to {t_us} us, which the device's stream \
             cannot represent: sort the recording",
            self.model,
            self.events,
            self.time
        );
        self.time = t_us;
        self.events += 1;
        Ok(())
    }

    /// Checks that the latest event needs at most [`GAP_WORDS_MAX`] time words.
    ///
    /// # Errors
    /// It needs more.
    pub fn check_gap(&self, words: u64) -> Result<()> {
        ensure!(
            words <= GAP_WORDS_MAX,
            "{}: event {}: the gap before {} us is too long; the device counts from 0 at its \
             start: shift the times of the recording",
            self.model,
            self.events.saturating_sub(1),
            self.time
        );
        Ok(())
    }
}

/// Writes time in 16-bit words, and keeps the time written so far.
#[derive(Debug)]
pub struct Time16 {
    time: Option<u64>,
    periods: u64,
}

impl Time16 {
    pub const fn new() -> Self {
        Self {
            time: None,
            periods: 0,
        }
    }

    /// Writes wraps and a time word if `t_us` differs from the previous time; returns whether it did.
    ///
    /// # Errors
    /// The gap is too long.
    pub fn write(&mut self, t_us: u64, order: &Order, bytes: &mut Vec<u8>) -> Result<bool> {
        if self.time == Some(t_us) {
            return Ok(false);
        }
        let wraps = (t_us >> words16::TIME_BITS).saturating_sub(self.periods);
        order.check_gap(wraps.div_ceil(words16::WRAPS_MAX))?;
        self.advance(t_us, bytes);
        self.time = Some(t_us);
        // The logic sends no time of 0: a start, a reset or a wrap is that time.
        let low = (t_us & 0x7FFF) as u16;
        if low != 0 {
            bytes.extend((words16::TIME | low).to_le_bytes());
        }
        Ok(true)
    }

    /// Writes the wraps up to `t_us`.
    pub fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        let periods = t_us >> words16::TIME_BITS;
        let mut wraps = periods.saturating_sub(self.periods);
        if wraps == 0 {
            return;
        }
        // A device sends each wrap as it comes, and some hosts count every word as one. A clock that starts late, as
        // none does, would take too many.
        let most = if wraps > SINGLE_WRAPS_MAX || self.time.is_none() && wraps > words16::WRAPS_MAX
        {
            words16::WRAPS_MAX
        } else {
            1
        };
        while wraps > 0 {
            let some = wraps.min(most);
            bytes.extend((words16::WRAP | some as u16).to_le_bytes());
            wraps -= some;
        }
        self.periods = periods;
        self.time = Some(periods << words16::TIME_BITS);
    }

    /// Writes a reset of the clock, after which times count from 0.
    pub fn reset(&mut self, bytes: &mut Vec<u8>) {
        bytes.extend(words16::RESET.to_le_bytes());
        *self = Self::new();
    }
}
