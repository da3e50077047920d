//! A recording up to its damage.

use super::{Assumption, Error, EventReader, Pause, Result, Skipped};
use crate::{Event, Sensor};

/// A reader whose first error is its end: what was read before it is worth as much as without it.
///
/// Who reads through it has to ask for [`Intact::damage`] at the end, and say it.
pub struct Intact {
    reader: Box<dyn EventReader>,
    damage: Option<Error>,
}

impl Intact {
    /// Reads what `reader` gives before its first error.
    #[must_use]
    pub const fn new(reader: Box<dyn EventReader>) -> Self {
        Self {
            reader,
            damage: None,
        }
    }

    /// Why the recording ended, if not because there was no more of it.
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
