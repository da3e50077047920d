//! Applies to an opened reader what the caller asked for, whatever the format.
//!
//! Readers of tables (text, arrays, HDF5 and the like) handle times before 0, missing values, units and columns
//! themselves. The other formats' times are unsigned; an offset is added to them here. An option that can have no
//! effect is refused, and a size that the file states differently is reported.

use event_types::stream::Result;
use event_types::{Event, Sensor, ensure, error};

use crate::{Assumption, BadEvents, EventReader, Format, Pause, Reading, Skipped};

/// Kind under which events are counted whose time an offset moves below 0 or above 2^63 us.
const BEFORE_ZERO: &str = "events before time 0";

/// Returns an error if `reading` asks something of a format that can have no effect on it.
pub fn check(format: &Format, name: &str, reading: &Reading) -> Result<()> {
    let is_table = format.is_table;
    ensure!(
        is_table || reading.time_unit.is_none(),
        Undecided,
        "{name}: the times of {} are always in microseconds: omit --time-unit",
        format.title
    );
    ensure!(
        is_table || reading.columns.is_none(),
        Undecided,
        "{name}: {} has no columns to choose: omit --columns",
        format.title
    );
    Ok(())
}

/// Wraps the reader of a file of `format` as `reading` asks, or returns it as it is if nothing is to be done.
pub fn adjusted(
    mut reader: Box<dyn EventReader>,
    format: &Format,
    name: &str,
    reading: &Reading,
) -> Result<Box<dyn EventReader>> {
    let is_table = format.is_table;
    let leaves_out = reading.bad_events == BadEvents::LeaveOut;
    ensure!(
        is_table || !leaves_out || reader.leave_out_bad_events(),
        Refused,
        "{name}: {} cannot hold bad events: omit --leave-out-bad-events",
        format.title
    );
    let offset_us = if is_table { 0 } else { reading.time_offset_us };
    let sensor = reader.sensor();
    let is_other = reading.size.is_some_and(|size| size != sensor);
    let stated_size = is_other.then(|| Assumption {
        what: "stated size",
        taken: format!("{}x{}", sensor.width, sensor.height),
        why: "the file states it; --width and --height apply only if a file states none".to_owned(),
    });
    if stated_size.is_none() && offset_us == 0 {
        return Ok(reader);
    }
    let assumptions = With::new(reader.as_ref(), stated_size);
    Ok(Box::new(Adjusted {
        reader,
        name: name.to_owned(),
        assumptions,
        offset_us,
        leaves_out,
        events: 0,
        before_zero: 0,
        skipped: Skipped::default(),
        failure: None,
    }))
}

/// A reader's assumptions and at most one more.
pub struct With {
    /// The added assumption, followed by those of the reader.
    all: Vec<Assumption>,
    /// Number of added assumptions, 0 or 1.
    added: usize,
}

impl With {
    /// Collects what `reader` has assumed so far, and `added`.
    pub fn new(reader: &dyn EventReader, added: Option<Assumption>) -> Self {
        let mut with = Self {
            added: usize::from(added.is_some()),
            all: added.into_iter().collect(),
        };
        with.update(reader);
        with
    }

    /// Appends what the reader has assumed since.
    pub fn update(&mut self, reader: &dyn EventReader) {
        let known = self.all.len() - self.added;
        let found = reader.assumptions().iter().skip(known);
        self.all.extend(found.cloned());
    }

    /// Returns all assumptions.
    pub fn all(&self) -> &[Assumption] {
        &self.all
    }
}

/// A reader that shifts another reader's times and adds to its assumptions.
struct Adjusted {
    reader: Box<dyn EventReader>,
    name: String,
    assumptions: With,
    offset_us: i64,
    leaves_out: bool,
    /// Number of events read, including those that were left out.
    events: u64,
    before_zero: u64,
    skipped: Skipped,
    /// An error that is held back until the events before it have been returned.
    failure: Option<event_types::stream::Error>,
}

impl Adjusted {
    fn moved(&self, t_us: u64) -> Option<u64> {
        let moved = t_us.checked_add_signed(self.offset_us)?;
        i64::try_from(moved).is_ok().then_some(moved)
    }

    /// Shifts the events from `start` on. Events that cannot be shifted are left out, or else the first of them
    /// ends the batch with an error.
    fn move_events(&mut self, events: &mut Vec<Event>, start: usize) {
        if self.offset_us == 0 {
            return;
        }
        let mut kept = start;
        for index in start..events.len() {
            let Some(event) = events.get(index).copied() else {
                break;
            };
            self.events += 1;
            let Some(t_us) = self.moved(event.t_us) else {
                self.before_zero += 1;
                if self.leaves_out {
                    continue;
                }
                self.failure = Some(error!(
                    Undecided,
                    "{}: event {} at {} us is before 0 with --time-offset-us {}, or beyond 2^63 us",
                    self.name,
                    self.events - 1,
                    event.t_us,
                    self.offset_us
                ));
                break;
            };
            if let Some(slot) = events.get_mut(kept) {
                *slot = Event { t_us, ..event };
            }
            kept += 1;
        }
        events.truncate(kept);
    }
}

impl EventReader for Adjusted {
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
        self.assumptions.all()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let start = events.len();
        loop {
            if let Some(failure) = self.failure.take() {
                return Err(failure);
            }
            let read = self.reader.read(events)?;
            self.move_events(events, start);
            self.skipped = self.reader.skipped().clone();
            self.assumptions.update(self.reader.as_ref());
            if self.leaves_out {
                self.skipped.add(BEFORE_ZERO, self.before_zero);
            }
            let kept = events.len() - start;
            if read == 0 || kept > 0 {
                return Ok(kept);
            }
        }
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let t_us = i128::from(t_us) - i128::from(self.offset_us);
        let t_us = u64::try_from(t_us.max(0)).unwrap_or(u64::MAX);
        Ok(self.failure.is_none() && self.reader.seek(t_us)?)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        let t_us = i128::from(t_us) - i128::from(self.offset_us);
        let t_us = u64::try_from(t_us.max(0)).unwrap_or(u64::MAX);
        self.reader.end_at(t_us)
    }

    fn pause(&self) -> Pause {
        match self.reader.pause() {
            Pause::Until(t_us) => Pause::Until(self.moved(t_us).unwrap_or(0)),
            Pause::Ended => Pause::Ended,
        }
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
