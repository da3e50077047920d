//! Writes events as a DAVIS sends them; [`super::parse`] describes the format.
//!
//! When the time changes, the writer emits its wraps as one word with their count, a time word and a row; when the
//! row changes, another row; and for each event a column. An event therefore costs at least 2 bytes and usually at
//! most 6, and order and duplicates are kept.

use anyhow::Result;
use eecvs_nostd::{Event, Polarity, Sensor};

use crate::device::WriteStream;
use crate::device::inivation::words16;
use crate::device::inivation::writer::{Order, Time16};

/// Writes the stream of a DAVIS.
#[derive(Debug)]
pub struct DavisWriter {
    order: Order,
    time: Time16,
    row: Option<u16>,
}

impl DavisWriter {
    /// Creates a writer for events of `sensor`, for the model of this name.
    #[must_use]
    pub const fn new(model: &'static str, sensor: Sensor) -> Self {
        Self {
            order: Order::new(model, sensor),
            time: Time16::new(),
            row: None,
        }
    }
}

impl WriteStream for DavisWriter {
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        for event in events {
            self.order.check(event)?;
            if self.time.write(event.t_us, &self.order, bytes)? {
                self.row = None;
            }
            if self.row.replace(event.y) != Some(event.y) {
                bytes.extend((words16::ROW | event.y).to_le_bytes());
            }
            let code = match event.polarity {
                Polarity::Off => words16::OFF,
                Polarity::On => words16::ON,
            };
            bytes.extend((code | event.x).to_le_bytes());
        }
        Ok(())
    }

    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        self.time.advance(t_us, bytes);
    }

    fn reset_time(&mut self, bytes: &mut Vec<u8>) -> bool {
        self.time.reset(bytes);
        self.order.reset_time();
        self.row = None;
        true
    }

    fn restart(&mut self) {
        self.time = Time16::new();
        self.order.restart();
        self.row = None;
    }

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}
