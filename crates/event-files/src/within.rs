//! Reads the events between two times, from the place that the format finds for them.

use std::ops::Range;

use event_types::stream::Result;
use event_types::{Event, Sensor};

use crate::{Assumption, EventReader, Skipped};

/// Largest step back of the times of a recording with an index: reading ends once all events of a batch are this far past
/// the last time wanted.
pub(crate) const STEP_BACK_MAX_US: u64 = 1_000_000;

/// Moves a reader to the events between two times, either of which may be open. Returns the time from which on a batch
/// of events ends the reading; `None` if only the end of the recording does.
///
/// # Errors
/// The index is damaged.
pub(crate) fn seek(
    reader: &mut dyn EventReader,
    from_us: Option<u64>,
    to_us: Option<u64>,
) -> Result<Option<u64>> {
    let is_part = from_us.is_some() || to_us.is_some();
    let has_index = is_part && reader.seek(from_us.unwrap_or(0))?;
    let ends = match to_us {
        Some(to_us) => reader.end_at(to_us)?,
        None => false,
    };
    // Without an index, events of these times may come at any place: a clock may have been set back.
    let end_us = to_us.filter(|_| has_index && !ends);
    Ok(end_us.map(|to| to.saturating_add(STEP_BACK_MAX_US)))
}

/// A reader of the events of another one between two times: at or after the first, before the second.
///
/// Where the format has an index of times, reading begins there and ends one second after the last time; otherwise all of
/// the recording is read. Events keep their order.
///
/// ```
/// use event_files::within::Within;
/// use event_files::{EventReader, MemoryReader};
/// use event_types::{Event, Polarity, Sensor};
///
/// let event = |t_us| Event { t_us, x: 0, y: 0, polarity: Polarity::On };
/// let sensor = Sensor::new(1, 1).expect("sides from 1 to 2048");
/// let reader = MemoryReader::new(sensor, (0..100).map(event).collect());
/// let mut events = Vec::new();
/// let mut within = Within::new(Box::new(reader), 10..20)?;
/// while within.read(&mut events)? > 0 {}
/// assert_eq!(events.len(), 10);
/// # Ok::<(), event_files::Error>(())
/// ```
pub struct Within {
    reader: Box<dyn EventReader>,
    times: Range<u64>,
    /// A batch of events from here on ends the reading.
    end_us: Option<u64>,
    ended: bool,
    /// All times are wanted.
    is_whole: bool,
}

impl Within {
    /// Moves `reader` to the events of `times`. A range from 0 or to [`u64::MAX`] is open there.
    ///
    /// # Errors
    /// The index is damaged.
    pub fn new(mut reader: Box<dyn EventReader>, times: Range<u64>) -> Result<Self> {
        let from_us = Some(times.start).filter(|from| *from > 0);
        let to_us = Some(times.end).filter(|to| *to < u64::MAX);
        let end_us = seek(reader.as_mut(), from_us, to_us)?;
        Ok(Self {
            reader,
            ended: times.is_empty(),
            is_whole: from_us.is_none() && to_us.is_none(),
            times,
            end_us,
        })
    }
}

impl EventReader for Within {
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
        let start = events.len();
        if self.is_whole {
            return self.reader.read(events);
        }
        while !self.ended {
            if self.reader.read(events)? == 0 {
                self.ended = true;
                break;
            }
            let batch = events.get(start..).unwrap_or_default();
            let past = |end_us| batch.iter().all(|event| event.t_us >= end_us);
            self.ended = self.end_us.is_some_and(past);
            // Nearly all batches are inside or outside as a whole; without a branch per event, several are compared at once.
            let inside = |event: &Event| self.times.contains(&event.t_us);
            let all = batch.iter().fold(true, |all, event| all & inside(event));
            if all {
                break;
            }
            let mut kept = start;
            for at in start..events.len() {
                if let Some(event) = events.get(at).copied()
                    && self.times.contains(&event.t_us)
                    && let Some(slot) = events.get_mut(kept)
                {
                    *slot = event;
                    kept += 1;
                }
            }
            events.truncate(kept);
            if kept > start {
                break;
            }
        }
        Ok(events.len() - start)
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use event_types::Polarity;
    use event_types::stream::MemoryReader;

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 4,
        height: 4,
    };

    fn events() -> Vec<Event> {
        let event = |i: u64| Event {
            // Times step back now and then.
            t_us: 1_000 + 90 * i - i % 7 * 200 % 1_000,
            x: (i % 4) as u16,
            y: (i / 4 % 4) as u16,
            polarity: Polarity::from_bool(i.is_multiple_of(3)),
        };
        (100..60_000).map(event).collect()
    }

    fn check(open: impl Fn() -> Box<dyn EventReader>) {
        for times in [
            0..u64::MAX,
            0..0,
            0..2_000_000,
            1_234_567..1_234_568,
            3_000_000..4_000_000,
            4_000_000..u64::MAX,
            9_000_000..u64::MAX,
        ] {
            let mut within = Within::new(open(), times.clone()).unwrap();
            let mut found = Vec::new();
            while within.read(&mut found).unwrap() > 0 {}
            assert_eq!(within.read(&mut found).unwrap(), 0);
            let wanted = events().into_iter();
            let wanted: Vec<_> = wanted.filter(|event| times.contains(&event.t_us)).collect();
            assert!(found == wanted, "{times:?}");
        }
    }

    #[test]
    fn without_an_index_all_is_read() {
        check(|| Box::new(MemoryReader::new(SENSOR, events())));
    }

    #[test]
    fn with_an_index_the_same_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dat");
        let mut writer = crate::create(&path, SENSOR).unwrap();
        writer.write(&events()).unwrap();
        writer.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        check(|| crate::open_source(Box::new(Cursor::new(bytes.clone())), "a.dat", None).unwrap());
    }
}
