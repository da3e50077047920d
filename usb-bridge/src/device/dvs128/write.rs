//! Writes events as a DVS128 sends them; [`super::parse`] describes the format.

use anyhow::Result;
use eecvs_nostd::{Event, Polarity, Sensor};

use super::SENSOR;
use super::parse::TIME_BITS;
use crate::device::WriteStream;
use crate::device::inivation::writer::Order;

/// The record of a wrapped counter.
const WRAP: u32 = 1 << 31;

/// The record of a reset of the counter.
const RESET: u32 = 1 << 30;

/// Writes the stream of a DVS128.
#[derive(Debug)]
pub struct Dvs128Writer {
    order: Order,
    /// Number of periods so far.
    periods: u64,
}

impl Dvs128Writer {
    /// Creates a writer for events of `sensor`, which is placed in the upper left of the chip.
    #[must_use]
    pub const fn new(sensor: Sensor) -> Self {
        Self {
            order: Order::new(super::NAME, sensor),
            periods: 0,
        }
    }
}

impl WriteStream for Dvs128Writer {
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        for event in events {
            self.order.check(event)?;
            let periods = event.t_us >> TIME_BITS;
            self.order.check_gap(periods.saturating_sub(self.periods))?;
            self.advance(event.t_us, bytes);
            let time = (event.t_us & ((1 << TIME_BITS) - 1)) as u32;
            let x = u32::from(SENSOR.width - 1 - event.x);
            let y = u32::from(SENSOR.height - 1 - event.y);
            let off = u32::from(event.polarity == Polarity::Off);
            bytes.extend((time << 16 | y << 8 | x << 1 | off).to_le_bytes());
        }
        Ok(())
    }

    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        let periods = t_us >> TIME_BITS;
        for _ in self.periods..periods {
            bytes.extend(WRAP.to_le_bytes());
        }
        self.periods = self.periods.max(periods);
    }

    fn reset_time(&mut self, bytes: &mut Vec<u8>) -> bool {
        bytes.extend(RESET.to_le_bytes());
        self.order.reset_time();
        self.periods = 0;
        true
    }

    fn restart(&mut self) {
        self.order.restart();
        self.periods = 0;
    }

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}
