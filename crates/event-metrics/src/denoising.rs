//! What a filter of noise keeps of the signal, by the cause of each event.
//!
//! Recording A has the causes of its events, as `eecvs emulate --truth` writes them; B is what a filter made of it. An event
//! of A is kept if B has one with the same t, x, y and p. Events of the signal are what is to be found:
//!
//! ```text
//! precision     = signal events kept / events of B
//! recall        = signal events kept / signal events of A
//! noise_removed = 1 - noise events kept / noise events of A
//! ```
//!
//! Both recordings are read once, in step; memory holds the events of one time.
//!
//! ```
//! use event_metrics::denoising::denoising;
//! use event_types::stream::MemoryReader;
//! use event_types::{Event, Polarity, Sensor};
//!
//! # fn main() -> Result<(), event_types::stream::Error> {
//! let sensor = Sensor { width: 4, height: 1 };
//! let event = |t_us, x| Event { t_us, x, y: 0, polarity: Polarity::On };
//! let events = vec![event(10, 0), event(20, 3), event(30, 1), event(40, 2)];
//! // The second event is shot noise; the filter leaves it out, and the fourth with it.
//! let mut causes = &[0, 2, 0, 0][..];
//! let filtered = vec![events[0], events[2]];
//! let found = denoising(
//!     &mut MemoryReader::new(sensor, events),
//!     &mut causes,
//!     &mut MemoryReader::new(sensor, filtered),
//!     &mut |_| {},
//! )?;
//! assert_eq!((found.precision, found.recall), (Some(1.0), Some(2.0 / 3.0)));
//! # Ok(())
//! # }
//! ```

use std::io::Read;

use event_types::stream::{BATCH_EVENTS, Context, EventReader, Result};
use event_types::{Event, bail, ensure, error};
use serde::Serialize;

/// The cause of an event that is signal; all others are noise.
pub const SIGNAL: u8 = 0;

/// Most events of one time.
pub const EVENTS_MAX: usize = 1 << 24;

/// Events of one cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct OfCause {
    /// Events of A.
    pub events: u64,
    /// Those that B has, too.
    pub kept: u64,
}

/// Result of [`denoising`]; the field names are the keys of the JSON object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Denoising {
    /// Share of B's events that are signal of A, 0 to 1; `None` if B is empty.
    pub precision: Option<f64>,
    /// Share of A's signal events that B has, 0 to 1; `None` if A has none.
    pub recall: Option<f64>,
    /// Share of A's noise events that B does not have, 0 to 1; `None` if A has none.
    pub noise_removed: Option<f64>,
    /// Events by the numbers of their causes, up to the highest one found.
    pub by_cause: Vec<OfCause>,
    /// Events of B that A does not have.
    pub surplus: u64,
}

/// Judges a filter: reads A, the causes of its events in its order, one byte each, and B, what the filter left.
///
/// `progress` is called with the number of A's events read so far. Where A has several equal events, and B fewer of them, the
/// first of A's are taken as kept.
///
/// # Errors
/// An error of a reader; more or fewer causes than events of A; times of A or B that run backwards; more than
/// [`EVENTS_MAX`] events of one time.
pub fn denoising(
    a: &mut dyn EventReader,
    causes: &mut dyn Read,
    b: &mut dyn EventReader,
    progress: &mut dyn FnMut(u64),
) -> Result<Denoising> {
    let (mut a, mut b) = (Groups::new(a, "recording A"), Groups::new(b, "recording B"));
    let (mut of_a, mut of_b): (Vec<(Key, u8)>, Vec<Key>) = (Vec::new(), Vec::new());
    let mut by_cause: Vec<OfCause> = Vec::new();
    let (mut events_b, mut surplus) = (0_u64, 0_u64);
    loop {
        let t_us = match (a.t_us()?, b.t_us()?) {
            (Some(of_a), Some(of_b)) => of_a.min(of_b),
            (Some(t_us), None) | (None, Some(t_us)) => t_us,
            (None, None) => break,
        };
        let taken = a.take(t_us)?;
        of_a.clear();
        for event in taken {
            let mut cause = [0];
            let read = causes.read_exact(&mut cause);
            read.map_err(|error| match error.kind() {
                std::io::ErrorKind::UnexpectedEof => error!(
                    Refused,
                    "the truth has fewer causes than recording A has events: it is that of another recording"
                ),
                _ => error.into(),
            })?;
            of_a.push((key(event), cause[0]));
        }
        of_b.clear();
        of_b.extend(b.take(t_us)?.iter().map(key));
        // The sort is stable: equal events stay in A's order.
        of_a.sort_by_key(|(key, _)| *key);
        of_b.sort_unstable();
        let mut rest = of_b.iter().peekable();
        for (key, cause) in &of_a {
            let cause = usize::from(*cause);
            if by_cause.len() <= cause {
                by_cause.resize(cause + 1, OfCause::default());
            }
            while rest.next_if(|other| *other < key).is_some() {
                surplus += 1;
            }
            let is_kept = rest.next_if(|other| *other == key).is_some();
            if let Some(count) = by_cause.get_mut(cause) {
                count.events += 1;
                count.kept += u64::from(is_kept);
            }
        }
        surplus += rest.count() as u64;
        events_b += of_b.len() as u64;
        progress(a.events);
    }
    let more = causes.read(&mut [0])?;
    ensure!(
        more == 0,
        Refused,
        "the truth has more causes than recording A has events: it is that of another recording"
    );
    let sum = |of: fn(&OfCause) -> u64, all: &[OfCause]| all.iter().map(of).sum::<u64>();
    let (signal, noise) = by_cause.split_at(by_cause.len().min(usize::from(SIGNAL) + 1));
    let kept = |counts: &[OfCause]| sum(|count| count.kept, counts);
    let events = |counts: &[OfCause]| sum(|count| count.events, counts);
    let share = |part: u64, all: u64| (all > 0).then(|| part as f64 / all as f64);
    Ok(Denoising {
        precision: share(kept(signal), events_b),
        recall: share(kept(signal), events(signal)),
        noise_removed: share(events(noise) - kept(noise), events(noise)),
        by_cause,
        surplus,
    })
}

/// Row, column and polarity of an event.
type Key = (u16, u16, bool);

fn key(event: &Event) -> Key {
    (event.y, event.x, event.polarity.sign() > 0)
}

/// A recording that is read time by time.
struct Groups<'r> {
    reader: &'r mut dyn EventReader,
    name: &'static str,
    /// Events that have been read, of which the first `taken` have been taken.
    read: Vec<Event>,
    taken: usize,
    is_over: bool,
    /// Events taken so far.
    events: u64,
}

impl<'r> Groups<'r> {
    fn new(reader: &'r mut dyn EventReader, name: &'static str) -> Self {
        Self {
            reader,
            name,
            read: Vec::new(),
            taken: 0,
            is_over: false,
            events: 0,
        }
    }

    /// Returns the time of the next events; `None` at the end.
    fn t_us(&mut self) -> Result<Option<u64>> {
        while self.taken == self.read.len() && !self.is_over {
            self.read_more()?;
        }
        Ok(self.read.get(self.taken).map(|event| event.t_us))
    }

    /// Takes all events of a time, which no later one is before.
    fn take(&mut self, t_us: u64) -> Result<&[Event]> {
        let mut end = self.taken;
        loop {
            match self.read.get(end) {
                Some(event) if event.t_us == t_us => end += 1,
                Some(event) if event.t_us > t_us => break,
                Some(event) => bail!(
                    Refused,
                    "{}: event {} at {} us is before the one that precedes it: sort it by time first",
                    self.name,
                    self.events + (end - self.taken) as u64,
                    event.t_us
                ),
                None if self.is_over => break,
                None => {
                    let before = end - self.taken;
                    ensure!(
                        before <= EVENTS_MAX,
                        Refused,
                        "{}: more than {EVENTS_MAX} events at {t_us} us",
                        self.name
                    );
                    self.read_more()?;
                    end = self.taken + before;
                }
            }
        }
        let first = self.taken;
        self.taken = end;
        self.events += (end - first) as u64;
        Ok(self.read.get(first..end).unwrap_or_default())
    }

    /// Reads a further batch behind what has not been taken.
    fn read_more(&mut self) -> Result<()> {
        self.read.drain(..self.taken);
        self.taken = 0;
        self.read.reserve(BATCH_EVENTS);
        self.is_over = self.reader.read(&mut self.read).context(self.name)? == 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use event_types::stream::MemoryReader;
    use event_types::{Polarity, Sensor};

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 8,
        height: 4,
    };

    fn events(rows: &[(u64, u16, u16, u8)]) -> Vec<Event> {
        let event = |(t_us, x, y, p): &(u64, u16, u16, u8)| Event {
            t_us: *t_us,
            x: *x,
            y: *y,
            polarity: Polarity::from_bool(*p > 0),
        };
        rows.iter().map(event).collect()
    }

    fn judge(a: &[Event], causes: &[u8], b: &[Event]) -> Result<Denoising> {
        let mut causes = causes;
        denoising(
            &mut MemoryReader::new(SENSOR, a.to_vec()),
            &mut causes,
            &mut MemoryReader::new(SENSOR, b.to_vec()),
            &mut |_| {},
        )
    }

    #[test]
    fn kept_events_are_counted_by_their_causes() {
        let a = events(&[
            (5, 3, 1, 1),
            (5, 1, 1, 0),
            (5, 1, 1, 1),
            (6, 0, 0, 1),
            (9, 2, 2, 1),
            (9, 2, 2, 1),
        ]);
        let causes = [0, 2, 0, 0, 2, 0];
        // Other order within a time; one event that A does not have, before and after its own.
        let b = events(&[
            (1, 0, 0, 0),
            (5, 1, 1, 0),
            (5, 3, 1, 1),
            (9, 2, 2, 1),
            (12, 0, 0, 0),
        ]);
        let found = judge(&a, &causes, &b).unwrap();
        let of = |events, kept| OfCause { events, kept };
        assert_eq!(found.by_cause, [of(4, 1), of(0, 0), of(2, 2)]);
        assert_eq!(found.surplus, 2);
        assert_eq!(found.precision, Some(0.2));
        assert_eq!(found.recall, Some(0.25));
        assert_eq!(found.noise_removed, Some(0.0));
        // A perfect filter.
        let signal: Vec<Event> = a
            .iter()
            .zip(causes)
            .filter(|(_, cause)| *cause == 0)
            .map(|(event, _)| *event)
            .collect();
        // Of the two equal events, the first is taken as kept.
        let perfect = judge(&a[..5], &causes[..5], &signal[..3]).unwrap();
        let shares = (perfect.precision, perfect.recall, perfect.noise_removed);
        assert_eq!(shares, (Some(1.0), Some(1.0), Some(1.0)));
        let none = judge(&a, &causes, &[]).unwrap();
        let shares = (none.precision, none.recall, none.noise_removed);
        assert_eq!(shares, (None, Some(0.0), Some(1.0)));
        let empty = judge(&[], &[], &b).unwrap();
        let shares = (empty.precision, empty.recall, empty.noise_removed);
        assert_eq!((shares, empty.surplus), ((Some(0.0), None, None), 5));
    }

    #[test]
    fn long_recordings_are_read_in_step() {
        let a: Vec<Event> = (0..3 * BATCH_EVENTS as u64)
            .map(|number| Event {
                // Groups lie across the ends of batches.
                t_us: number / 7,
                x: (number % 7) as u16,
                y: 0,
                polarity: Polarity::On,
            })
            .collect();
        let causes: Vec<u8> = a.iter().map(|event| u8::from(event.x > 4)).collect();
        let b: Vec<Event> = a.iter().filter(|event| event.x > 2).copied().collect();
        let found = judge(&a, &causes, &b).unwrap();
        let count = |keep: fn(u16) -> bool| a.iter().filter(|event| keep(event.x)).count() as u64;
        assert_eq!(found.by_cause[0].kept, count(|x| x == 3 || x == 4));
        assert_eq!(found.by_cause[1].kept, count(|x| x > 4));
        assert_eq!((found.surplus, found.noise_removed), (0, Some(0.0)));
    }

    #[test]
    fn another_recording_s_truth_is_refused() {
        let a = events(&[(5, 3, 1, 1), (5, 1, 1, 0), (4, 1, 1, 1)]);
        for (a, causes, b, what) in [
            (&a[..2], &[0][..], &a[..2], "fewer causes"),
            (&a[..2], &[0, 0, 0], &a[..2], "more causes"),
            (&a[..], &[0, 0, 0], &a[..2], "recording A: event 2 at 4 us"),
            (&a[..2], &[0, 0], &a[..], "recording B: event 2 at 4 us"),
        ] {
            let error = judge(a, causes, b).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
