//! Vectors of Prophesee's words: events of one time, row and polarity, a bit for each column.

use event_types::{Event, Polarity, Sensor};

use crate::input::Batch;

/// What the events of a vector have in common.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Their time in microseconds.
    pub t_us: u64,
    /// Their row.
    pub y: u16,
    /// Their polarity.
    pub polarity: Polarity,
}

/// An event that lies outside of the sensor.
#[derive(Debug, Clone, Copy)]
pub struct Outside {
    /// Its column.
    pub x: u32,
    /// Its row.
    pub y: u16,
    /// Bits of the vector that come behind it.
    pub left: u32,
}

impl Row {
    /// Gives an event at column `x + i` for every bit i of `bits`, and counts it in `events`.
    ///
    /// # Errors
    /// The first one outside of the sensor; those before it have been given.
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
