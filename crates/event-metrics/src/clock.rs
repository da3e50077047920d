//! Finds a constant offset between the clocks of two recordings.
//!
//! It applies to two recordings of (nearly) the same events whose times differ by a constant. For most pairs of pixel
//! and polarity, the first event is then the same in both, and the difference of its two times is the constant.

use std::collections::HashMap;

use event_types::stream::{Assumption, EventReader, Pause, Result, Skipped};
use event_types::{Event, Polarity, Sensor, error};

/// Number of events read from each recording.
const EVENTS: usize = 1 << 20;

/// Fewest pixel and polarity pairs from which an offset is derived.
const PIXELS_MIN: usize = 8;

/// Returns how far B's clock is ahead of A's, in us; 0 if the clocks agree, `None` if no constant offset is found.
///
/// Each pixel and polarity with events in both recordings gives one difference of first times. The offset is the
/// difference shared by at least half of them, or else their median, if it exceeds four times the median absolute
/// deviation from it. Only the first 2^20 events of each recording are read.
///
/// # Errors
/// An error of a reader.
pub fn offset_us(a: &mut dyn EventReader, b: &mut dyn EventReader) -> Result<Option<i64>> {
    let (a, b) = (first_times(a)?, first_times(b)?);
    let mut differences: Vec<i64> = a
        .iter()
        .filter_map(|(pixel, in_a)| {
            let difference = i128::from(*b.get(pixel)?) - i128::from(*in_a);
            i64::try_from(difference).ok()
        })
        .collect();
    Ok(constant(&mut differences))
}

fn constant(differences: &mut [i64]) -> Option<i64> {
    if differences.len() < PIXELS_MIN {
        return None;
    }
    differences.sort_unstable();
    let longest = differences
        .chunk_by(|a, b| a == b)
        .max_by_key(|run| run.len())?;
    if 2 * longest.len() >= differences.len() {
        return longest.first().copied();
    }
    let median = *differences.get(differences.len() / 2)?;
    let mut distances: Vec<u64> = differences
        .iter()
        .map(|other| other.abs_diff(median))
        .collect();
    distances.sort_unstable();
    let spread = *distances.get(distances.len() / 2)?;
    (median.unsigned_abs() > spread.saturating_mul(4)).then_some(median)
}

/// A reader whose times are later than those of another reader by a constant: [`offset_us`], removed.
pub struct Later<R> {
    reader: R,
    later_us: u64,
}

impl<R: EventReader> Later<R> {
    /// Adds `later_us` to the times of a reader.
    #[must_use]
    pub const fn new(reader: R, later_us: u64) -> Self {
        Self { reader, later_us }
    }
}

impl<R: EventReader> EventReader for Later<R> {
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

    /// Reads as [`EventReader::read`] does.
    ///
    /// # Errors
    /// Those of the reader; a time that becomes larger than 2^64 us.
    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let start = events.len();
        let read = self.reader.read(events)?;
        for event in events.iter_mut().skip(start) {
            event.t_us = event.t_us.checked_add(self.later_us).ok_or_else(|| {
                error!(
                    Refused,
                    "an event at {} us cannot be {} us later", event.t_us, self.later_us
                )
            })?;
        }
        Ok(read)
    }

    fn pause(&self) -> Pause {
        self.reader.pause()
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

/// Returns the earliest time of every pixel and polarity among the first [`EVENTS`] events.
fn first_times(reader: &mut dyn EventReader) -> Result<HashMap<(u16, u16, Polarity), u64>> {
    let mut times = HashMap::new();
    let (mut events, mut read) = (Vec::new(), 0);
    while read < EVENTS {
        events.clear();
        if reader.read(&mut events)? == 0 {
            break;
        }
        events.truncate(EVENTS - read);
        read += events.len();
        for event in &events {
            let time = times
                .entry((event.x, event.y, event.polarity))
                .or_insert(event.t_us);
            *time = event.t_us.min(*time);
        }
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use event_types::Event;
    use event_types::test_events::{event, reader};

    use super::*;

    fn recording(shift_us: u64, noise_us: u64) -> Vec<Event> {
        let times = (0..400_u64).map(|i| (i, 1000 + 37 * i + shift_us + i * 7919 % (noise_us + 1)));
        times
            .map(|(i, t_us)| event(t_us, (i % 64) as u16, (i / 64) as u16, i % 3 == 0))
            .collect()
    }

    fn found(a: &[Event], b: &[Event]) -> Option<i64> {
        let reader = |events| reader(events, 50);
        offset_us(&mut reader(a), &mut reader(b)).unwrap()
    }

    #[test]
    fn constants_are_found() {
        let a = recording(0, 0);
        assert_eq!(found(&a, &a), Some(0));
        assert_eq!(found(&a, &recording(100, 0)), Some(100));
        assert_eq!(found(&recording(100, 0), &a), Some(-100));
        // With an error on each time, then with a third of the events missing.
        let near = found(&a, &recording(5_000_000, 80)).unwrap();
        assert!((5_000_000..=5_000_080).contains(&near), "{near}");
        let fewer: Vec<Event> = recording(300, 0)
            .into_iter()
            .filter(|e| e.t_us % 3 > 0)
            .collect();
        assert_eq!(found(&a, &fewer), Some(300));
    }

    #[test]
    fn errors_of_times_are_no_constant() {
        let a = recording(40, 0);
        assert_eq!(found(&a, &recording(0, 80)), None);
        assert_eq!(found(&a, &recording(0, 0)[..5]), None);
        assert_eq!(found(&a, &[]), None);
    }
}
