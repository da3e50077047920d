//! A recording up to its damage.

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};

use super::{Assumption, EventReader, Pause, Skipped};

/// A reader whose first error is its end: what was read before it is worth as much as without it.
///
/// Who reads through it has to ask for [`Intact::damage`] at the end, and say it.
pub struct Intact {
    reader: Box<dyn EventReader>,
    damage: Option<anyhow::Error>,
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
    pub fn damage(self) -> Option<anyhow::Error> {
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
    use std::io::Cursor;

    use super::*;
    use crate::formats::open_source;

    #[test]
    fn events_before_the_damage_come_and_the_damage_is_told() {
        let text = "t,x,y,p\n0,1,1,1\n5,2,2,0\n7,nonsense,3,1\n9,4,4,1\n";
        let size = Sensor::new(8, 8);
        let reader = open_source(Box::new(Cursor::new(text)), "a.csv", size).unwrap();
        let mut intact = Intact::new(reader);
        let mut events = Vec::new();
        while intact.read(&mut events).unwrap() > 0 {}
        assert_eq!(events.len(), 2);
        assert_eq!(intact.pause(), Pause::Ended);
        let damage = intact.damage().unwrap().to_string();
        assert!(damage.contains("a.csv: byte 24"), "{damage}");
    }

    #[test]
    fn a_whole_recording_has_no_damage() {
        let size = Sensor::new(8, 8);
        let reader =
            open_source(Box::new(Cursor::new("t,x,y,p\n0,1,1,1\n")), "a.csv", size).unwrap();
        let mut intact = Intact::new(reader);
        while intact.read(&mut Vec::new()).unwrap() > 0 {}
        assert!(intact.damage().is_none());
    }
}
