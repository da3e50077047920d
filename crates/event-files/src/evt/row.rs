//! The vectors in Prophesee's words: events of one time, row and polarity, with one bit per column.

use event_types::{Event, Polarity, Sensor};

use crate::input::Batch;

/// What all events of a vector have in common.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Time of the events in microseconds.
    pub t_us: u64,
    /// Row of the events.
    pub y: u16,
    /// Polarity of the events.
    pub polarity: Polarity,
}

/// An event that lies outside the sensor.
#[derive(Debug, Clone, Copy)]
pub struct Outside {
    /// Column of the event.
    pub x: u32,
    /// Row of the event.
    pub y: u16,
    /// Bits of the vector that have not been handled yet.
    pub left: u32,
}

impl Row {
    /// Appends an event at column `x + i` to `batch` for every set bit i of `bits`, and counts it in `events`.
    ///
    /// # Errors
    /// The first event outside the sensor; the events before it have been appended.
    #[inline]
    pub fn emit(
        self,
        x: u32,
        bits: u32,
        sensor: Sensor,
        events: &mut u64,
        batch: &mut Batch<'_>,
    ) -> Result<(), Outside> {
        let Self { t_us, y, polarity } = self;
        let mut left = bits;
        while left != 0 {
            let x = x.saturating_add(left.trailing_zeros());
            left &= left - 1;
            match u16::try_from(x) {
                Ok(x) if sensor.contains(x, y) => batch.push(Event {
                    t_us,
                    x,
                    y,
                    polarity,
                }),
                _ => return Err(Outside { x, y, left }),
            }
            *events += 1;
        }
        Ok(())
    }
}
