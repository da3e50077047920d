//! A reader of the undamaged part of a recording.

use super::{Assumption, Error, EventReader, Pause, Result, Skipped};
use crate::{Event, Sensor};

/// A reader that ends at its source's first error, so that the events before the damage can be used like any
/// others.
///
/// At the end its user has to ask for [`Intact::damage`] and report it.
pub struct Intact {
    reader: Box<dyn EventReader>,
    damage: Option<Error>,
}

impl Intact {
    /// Creates a reader of the events that `reader` returns before its first error.
    #[must_use]
    pub const fn new(reader: Box<dyn EventReader>) -> Self {
        Self {
            reader,
            damage: None,
        }
    }

    /// Returns the error that ended the recording, or `None` if it ended regularly.
    #[must_use]
    pub fn damage(self) -> Option<Error> {
        self.damage
    }
}

impl EventReader for Intact {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.reader.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.reader.assumptions()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        if self.damage.is_some() {
            return Ok(0);
        }
        match self.reader.read(events) {
            Err(error) => {
                self.damage = Some(error);
                Ok(0)
            }
            read => read,
        }
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        self.reader.seek(t_us)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        self.reader.end_at(t_us)
    }

    fn pause(&self) -> Pause {
        if self.damage.is_some() {
            Pause::Ended
        } else {
            self.reader.pause()
        }
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_reader::Batches;
    use super::*;

    #[test]
    fn events_before_the_damage_come_and_the_damage_is_told() {
        let mut intact = Intact::new(Box::new(Batches::damaged()));
        let mut events = Vec::new();
        while intact.read(&mut events).unwrap() > 0 {}
        assert_eq!(events.len(), Batches::EVENTS);
        assert_eq!(intact.pause(), Pause::Ended);
        assert_eq!(intact.damage().unwrap().to_string(), "damage");
    }

    #[test]
    fn a_whole_recording_has_no_damage() {
        let mut intact = Intact::new(Box::new(Batches::whole()));
        while intact.read(&mut Vec::new()).unwrap() > 0 {}
        assert!(intact.damage().is_none());
    }
}
