//! Cuts a recording into slices of equal duration, or of equal number of events.

use std::ops::Range;

use event_types::Event;
use event_types::stream::{Error, Result};
use event_types::{bail, ensure};

use crate::EventReader;

/// A recording's events, taken one after the other. An error of the reader comes after the events before it.
struct Ahead {
    reader: Box<dyn EventReader>,
    events: Vec<Event>,
    used: usize,
    /// Number of events before those of `events`.
    before: u64,
    failure: Option<Error>,
    ended: bool,
}

impl Ahead {
    fn new(reader: Box<dyn EventReader>) -> Self {
        Self {
            reader,
            events: Vec::new(),
            used: 0,
            before: 0,
            failure: None,
            ended: false,
        }
    }

    /// Returns the next events, at least one unless the recording has ended.
    fn rest(&mut self) -> &[Event] {
        if self.used == self.events.len() && !self.ended {
            self.before += self.events.len() as u64;
            self.events.clear();
            self.used = 0;
            match self.reader.read(&mut self.events) {
                Ok(read) => self.ended = read == 0,
                Err(error) => {
                    self.ended = true;
                    self.failure = Some(error);
                }
            }
        }
        self.events.get(self.used..).unwrap_or_default()
    }

    /// Ends the slices, by the reader's error if there is one.
    fn end<T>(&mut self) -> Result<Option<T>> {
        self.failure.take().map_or(Ok(None), Err)
    }
}

/// Slices of equal duration, from the first event on or on a given grid.
///
/// ```
/// use event_files::MemoryReader;
/// use event_files::slices::ByTime;
/// use event_types::{Event, Polarity, Sensor};
///
/// let event = |t_us| Event { t_us, x: 0, y: 0, polarity: Polarity::On };
/// let sensor = Sensor::new(1, 1).expect("sides from 1 to 2048");
/// let reader = MemoryReader::new(sensor, [5, 9, 31].map(event).to_vec());
/// let mut slices = ByTime::new(Box::new(reader), 10, None)?;
/// let mut found = Vec::new();
/// let mut events = Vec::new();
/// while let Some(times) = slices.next_slice(&mut events)? {
///     found.push((times, events.len()));
///     events.clear();
/// }
/// assert_eq!(found, [(5..15, 2), (15..25, 0), (25..35, 1)]);
/// # Ok::<(), event_files::Error>(())
/// ```
pub struct ByTime {
    ahead: Ahead,
    duration_us: u64,
    origin_us: Option<u64>,
    /// End of the next slice; `None` before the first event.
    end_us: Option<u64>,
}

impl ByTime {
    /// Cuts the events of `reader` into slices of `duration_us` microseconds. The first one contains the first event, and
    /// begins with it, or at `origin_us` + i `duration_us`, for an integer i; where that is before 0, the first slice begins
    /// at 0 and is shorter.
    ///
    /// # Errors
    /// A duration of 0.
    pub fn new(
        reader: Box<dyn EventReader>,
        duration_us: u64,
        origin_us: Option<u64>,
    ) -> Result<Self> {
        ensure!(
            duration_us > 0,
            Refused,
            "a slice needs a duration of at least 1 us"
        );
        Ok(Self {
            ahead: Ahead::new(reader),
            duration_us,
            origin_us,
            end_us: None,
        })
    }

    /// Returns the reader, for what it found besides events.
    #[must_use]
    pub fn reader(&self) -> &dyn EventReader {
        self.ahead.reader.as_ref()
    }

    /// Appends the events of the next slice to `events` and returns the slice's times; `None` after the last event. A
    /// slice between two events may have none.
    ///
    /// # Errors
    /// An event before its slice, since times run backwards; an error of the reader, after the slice of the events before
    /// it.
    pub fn next_slice(&mut self, events: &mut Vec<Event>) -> Result<Option<Range<u64>>> {
        let (duration_us, origin_us) = (self.duration_us, self.origin_us);
        let Some(first) = self.ahead.rest().first() else {
            return self.ahead.end();
        };
        let end_us = *self.end_us.get_or_insert_with(|| {
            let into_us = origin_us.map_or(0, |origin_us| {
                // Of 128 bits, since the origin may be on either side.
                let since_us = i128::from(first.t_us) - i128::from(origin_us);
                since_us.rem_euclid(i128::from(duration_us)) as u64
            });
            first.t_us.saturating_add(duration_us - into_us)
        });
        let start_us = end_us.saturating_sub(duration_us);
        loop {
            let rest = self.ahead.rest();
            if rest.is_empty() {
                break;
            }
            let inside = |event: &&Event| (start_us..end_us).contains(&event.t_us);
            let taken = rest.iter().take_while(inside).count();
            events.extend_from_slice(&rest[..taken]);
            let next = rest.get(taken).copied();
            self.ahead.used += taken;
            if let Some(next) = next {
                if next.t_us < start_us {
                    let index = self.ahead.before + self.ahead.used as u64;
                    bail!(
                        Refused,
                        "event {index} at {} us is before its slice, from {start_us} us on: times run backwards: --sort \
                         puts them in order",
                        next.t_us
                    );
                }
                break;
            }
        }
        self.end_us = Some(end_us.saturating_add(duration_us));
        Ok(Some(start_us..end_us))
    }
}

/// Slices of an equal number of events; the last one may have fewer.
pub struct ByCount {
    ahead: Ahead,
    count: usize,
}

impl ByCount {
    /// Cuts the events of `reader` into slices of `count` events.
    ///
    /// # Errors
    /// A count of 0.
    pub fn new(reader: Box<dyn EventReader>, count: usize) -> Result<Self> {
        ensure!(count > 0, Refused, "a slice needs at least 1 event");
        Ok(Self {
            ahead: Ahead::new(reader),
            count,
        })
    }

    /// Returns the reader, for what it found besides events.
    #[must_use]
    pub fn reader(&self) -> &dyn EventReader {
        self.ahead.reader.as_ref()
    }

    /// Appends the events of the next slice to `events` and returns their number; `None` after the last event.
    ///
    /// # Errors
    /// An error of the reader, after the slice of the events before it.
    pub fn next_slice(&mut self, events: &mut Vec<Event>) -> Result<Option<usize>> {
        let mut taken = 0;
        while taken < self.count {
            let rest = self.ahead.rest();
            if rest.is_empty() {
                break;
            }
            let part = rest.get(..self.count - taken).unwrap_or(rest);
            events.extend_from_slice(part);
            taken += part.len();
            self.ahead.used += part.len();
        }
        if taken == 0 {
            return self.ahead.end();
        }
        Ok(Some(taken))
    }
}

#[cfg(test)]
mod tests {
    use event_types::Sensor;
    use event_types::stream::MemoryReader;
    use event_types::test_events::event;
    use proptest::prelude::*;

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 8,
        height: 8,
    };

    fn reader(times: &[u64], batch: usize) -> Box<dyn EventReader> {
        let events = times.iter().map(|t| event(*t, 1, 2, true)).collect();
        Box::new(MemoryReader::new(SENSOR, events).in_batches(batch))
    }

    proptest! {
        #[test]
        fn slices_hold_every_event_once(
            mut times in proptest::collection::vec(0_u64..5_000, 0..300),
            duration_us in 1_u64..700,
            origin_us in proptest::option::of(0_u64..9_000),
            batch in 1_usize..50,
            count in 1_usize..90,
        ) {
            times.sort_unstable();
            let mut slices = ByTime::new(reader(&times, batch), duration_us, origin_us).unwrap();
            let (mut events, mut found) = (Vec::new(), Vec::new());
            let mut end = None;
            while let Some(slice) = slices.next_slice(&mut events).unwrap() {
                prop_assert!(end.is_none_or(|end| end == slice.start));
                let length_us = slice.end - slice.start;
                prop_assert!(length_us == duration_us || slice.start == 0 && length_us < duration_us);
                if let Some(origin_us) = origin_us {
                    prop_assert_eq!(slice.end.abs_diff(origin_us) % duration_us, 0);
                }
                prop_assert!(events.iter().all(|event| slice.contains(&event.t_us)));
                end = Some(slice.end);
                found.extend(events.drain(..).map(|event| event.t_us));
            }
            prop_assert_eq!(&found, &times);
            let mut slices = ByCount::new(reader(&times, batch), count).unwrap();
            found.clear();
            let mut sizes = Vec::new();
            while let Some(taken) = slices.next_slice(&mut events).unwrap() {
                prop_assert_eq!(taken, events.len());
                sizes.push(taken);
                found.extend(events.drain(..).map(|event| event.t_us));
            }
            prop_assert_eq!(&found, &times);
            prop_assert!(sizes.iter().rev().skip(1).all(|size| *size == count));
        }
    }

    #[test]
    fn times_that_run_backwards_are_refused_once_their_slice_is_over() {
        let mut slices = ByTime::new(reader(&[5, 3, 20, 9], 3), 10, Some(0)).unwrap();
        let mut events = Vec::new();
        assert_eq!(slices.next_slice(&mut events).unwrap(), Some(0..10));
        assert_eq!(slices.next_slice(&mut events).unwrap(), Some(10..20));
        let error = slices.next_slice(&mut events).unwrap_err();
        assert!(error.to_string().starts_with("event 3 at 9 us"), "{error}");
        assert!(ByTime::new(reader(&[], 1), 0, None).is_err());
        assert!(ByCount::new(reader(&[], 1), 0).is_err());
    }

    #[test]
    fn events_before_damage_come_before_it() {
        let bytes = b"1 2 3 1\n2 2 3 1\nx\n".to_vec();
        let open = || {
            let source = Box::new(std::io::Cursor::new(bytes.clone()));
            let reading = crate::Reading {
                time_unit: Some(crate::TimeUnit::Us),
                size: Some(SENSOR),
                ..crate::Reading::default()
            };
            crate::open_source(source, "a.txt", reading).unwrap()
        };
        let mut events = Vec::new();
        let mut slices = ByCount::new(open(), 10).unwrap();
        assert_eq!(slices.next_slice(&mut events).unwrap(), Some(2));
        assert!(slices.next_slice(&mut events).is_err());
        let mut slices = ByTime::new(open(), 10, None).unwrap();
        assert_eq!(slices.next_slice(&mut events).unwrap(), Some(1..11));
        assert!(slices.next_slice(&mut events).is_err());
        assert!(slices.next_slice(&mut events).unwrap().is_none());
    }
}
