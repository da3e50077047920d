//! A reader that buffers a recording's first events, so that they can be examined before they are read.

use super::{Assumption, BATCH_EVENTS, Error, EventReader, Pause, Result, Skipped};
use crate::{Event, Sensor};

/// A reader that has read ahead; [`EventReader::read`] still returns all events.
pub struct Ahead {
    reader: Box<dyn EventReader>,
    events: Vec<Event>,
    used: usize,
    /// The error met while reading ahead, until `read` returns it.
    failure: Option<Error>,
}

impl Ahead {
    /// Reads ahead until at least `events` events are buffered (at most a batch more), the source ends or pauses,
    /// or an error occurs.
    #[must_use]
    pub fn new(mut reader: Box<dyn EventReader>, events: usize) -> Self {
        let mut ahead = Vec::new();
        let mut failure = None;
        while ahead.len() < events {
            match reader.read(&mut ahead) {
                // Do not wait for a live source that has no events yet.
                Ok(0) => break,
                Ok(_) => {}
                Err(error) => {
                    failure = Some(error);
                    break;
                }
            }
        }
        Self {
            reader,
            events: ahead,
            used: 0,
            failure,
        }
    }

    /// Returns the buffered events, from the recording's first on.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }
}

impl EventReader for Ahead {
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
        let rest = self.events.get(self.used..).unwrap_or_default();
        if !rest.is_empty() {
            let batch = &rest[..rest.len().min(BATCH_EVENTS)];
            events.extend_from_slice(batch);
            self.used += batch.len();
            return Ok(batch.len());
        }
        self.events = Vec::new();
        match self.failure.take() {
            Some(error) => Err(error),
            None => self.reader.read(events),
        }
    }

    fn pause(&self) -> Pause {
        self.reader.pause()
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_reader::Batches;
    use super::*;

    /// The events and the position of the error do not depend on how far was read ahead.
    #[test]
    fn what_was_read_comes_again() {
        for ahead in [0, 1, 7, 20, 28, 100] {
            let mut reader = Ahead::new(Box::new(Batches::damaged()), ahead);
            let mut events = Vec::new();
            let error = loop {
                match reader.read(&mut events) {
                    Ok(count) => assert!(count > 0),
                    Err(error) => break error,
                }
            };
            assert_eq!(error.to_string(), "damage");
            let times: Vec<_> = events.iter().map(|event| event.t_us).collect();
            let all = 7..7 + Batches::EVENTS as u64;
            assert_eq!(times, all.collect::<Vec<_>>());
            assert_eq!(reader.read(&mut events).unwrap(), 0);
        }
    }
}
