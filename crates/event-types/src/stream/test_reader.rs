//! A reader for tests.

use super::{EventReader, Result, Skipped};
use crate::{Event, Polarity, Sensor};

/// A reader of four batches of 7 events, followed by an error if it is damaged, then by the end.
pub struct Batches {
    reads: u64,
    is_damaged: bool,
    skipped: Skipped,
}

impl Batches {
    /// Number of events in all batches; their times are 7, 8, and so on.
    pub const EVENTS: usize = 4 * 7;

    pub fn damaged() -> Self {
        Self {
            reads: 0,
            is_damaged: true,
            skipped: Skipped::default(),
        }
    }

    pub fn whole() -> Self {
        Self {
            is_damaged: false,
            ..Self::damaged()
        }
    }
}

impl EventReader for Batches {
    fn format(&self) -> &'static str {
        "batches"
    }

    fn sensor(&self) -> Sensor {
        Sensor::new(1, 1).unwrap()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        self.reads += 1;
        match self.reads {
            1..=4 => {
                let event = |i| Event {
                    t_us: 7 * self.reads + i,
                    x: 0,
                    y: 0,
                    polarity: Polarity::On,
                };
                events.extend((0..7).map(event));
                Ok(7)
            }
            5 if self.is_damaged => Err(crate::error!(Damaged, "damage")),
            _ => Ok(0),
        }
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
