//! What every writer does with an event before its words: its time must run on, its pixel be inside.

use anyhow::{Result, ensure};
use eecvs_nostd::{Event, Sensor};

use super::words16;

/// Most words of time for one gap; a longer gap is refused. A device counts from 0 at its start: a
/// recording whose times begin at an epoch has to be shifted.
pub const GAP_WORDS_MAX: u64 = 1 << 20;

/// Looks at events in their order.
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

    /// Takes the next event.
    ///
    /// # Errors
    /// It lies outside, or before the one before it.
    pub fn check(&mut self, event: &Event) -> Result<()> {
        let Event { t_us, x, y, .. } = *event;
        ensure!(
            self.sensor.contains(x, y),
            "{}: event {} at x = {x}, y = {y} is outside of the sensor ({}x{})",
            self.model,
            self.events,
            self.sensor.width,
            self.sensor.height
        );
        ensure!(
            t_us >= self.time,
            "{}: event {}: time runs back from {} us to {t_us} us, which the device's stream cannot \
             hold: sort the recording",
            self.model,
            self.events,
            self.time
        );
        self.time = t_us;
        self.events += 1;
        Ok(())
    }

    /// Refuses the latest event where it asks for more than [`GAP_WORDS_MAX`] words of time.
    ///
    /// # Errors
    /// It does.
    pub fn check_gap(&self, words: u64) -> Result<()> {
        ensure!(
            words <= GAP_WORDS_MAX,
            "{}: event {}: the gap up to {} us is too long: the device counts from 0 at its start, \
             shift the recording",
            self.model,
            self.events.saturating_sub(1),
            self.time
        );
        Ok(())
    }
}

/// Time in words of 16 bits, as it was written so far.
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

    /// Writes wraps and time where `t_us` is another than before; returns whether it was.
    ///
    /// # Errors
    /// The gap is too long.
    pub fn write(&mut self, t_us: u64, order: &Order, bytes: &mut Vec<u8>) -> Result<bool> {
        if self.time == Some(t_us) {
            return Ok(false);
        }
        let periods = t_us >> words16::TIME_BITS;
        let mut wraps = periods - self.periods;
        order.check_gap(wraps.div_ceil(words16::WRAPS_MAX))?;
        while wraps > 0 {
            let some = wraps.min(words16::WRAPS_MAX);
            bytes.extend((words16::WRAP | some as u16).to_le_bytes());
            wraps -= some;
        }
        self.periods = periods;
        self.time = Some(t_us);
        bytes.extend((words16::TIME | (t_us & 0x7FFF) as u16).to_le_bytes());
        Ok(true)
    }
}
