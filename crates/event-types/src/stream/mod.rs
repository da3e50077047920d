//! What gives events and what takes them: recordings, cameras, emulated scenes, decoded frames.
//!
//! Who consumes events takes a `&mut dyn EventReader`, and who makes them implements it.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use crate::{Event, Sensor};

mod ahead;
mod error;
mod intact;
mod memory;
#[cfg(test)]
mod test_reader;

pub use ahead::Ahead;
pub use error::{Context, Error, ErrorKind, Result};
pub use intact::Intact;
pub use memory::MemoryReader;

/// Events of one call of [`EventReader::read`], at the most (a reader may return fewer).
pub const BATCH_EVENTS: usize = 1 << 14;

/// What a recording holds besides events; skipped, counted by name, never silent.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Skipped(BTreeMap<&'static str, u64>);

impl Skipped {
    /// Counts `n` more items of `kind`.
    pub fn add(&mut self, kind: &'static str, n: u64) {
        if n > 0 {
            *self.0.entry(kind).or_default() += n;
        }
    }

    /// Kinds and their counts, in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        self.0.iter().map(|(kind, n)| (*kind, *n))
    }
}

/// A recording being read, from its first event to its last; on a thread of its own, if need be.
pub trait EventReader: Send {
    /// Format name as `eecvs info` prints it: a short word, such as `evt3`.
    fn format(&self) -> &'static str;

    /// Sensor size from the file's header, or from the caller where the format has none.
    fn sensor(&self) -> Sensor;

    /// Camera or chip as the file names it, where it does.
    fn camera(&self) -> Option<&str> {
        None
    }

    /// What the file does not say and was taken to be so, for the caller to be shown.
    fn assumptions(&self) -> &[Assumption] {
        &[]
    }

    /// Appends the next events to `events`, in file order, at most [`BATCH_EVENTS`] of them.
    ///
    /// `Ok(0)` is the end. After an error everything before the damage has been returned.
    ///
    /// # Errors
    /// A damaged or truncated file: the message names the file, the offset and what to do.
    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize>;

    /// Goes on at a place behind which every event of `t_us` and later stands, where the format tells it
    /// without all that is before being read; false where nothing was done. Times are taken to ascend, as
    /// the format's index does: an event that stands before earlier ones may be left out.
    ///
    /// # Errors
    /// A damaged index.
    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let _ = t_us;
        Ok(false)
    }

    /// Leaves out and counts the events that cannot be ones, from here on, instead of ending with an error;
    /// false where the reader knows no such events, or was told when it was opened.
    fn leave_out_bad_events(&mut self) -> bool {
        false
    }

    /// What it means that [`EventReader::read`] gave no events: the end, but for a live source.
    fn pause(&self) -> Pause {
        Pause::Ended
    }

    /// Non-event items met so far.
    fn skipped(&self) -> &Skipped;
}

/// Why a reader gave no events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pause {
    /// There are no more.
    Ended,
    /// A live source has none yet: all those before this time, in microseconds, have been given.
    Until(u64),
}

/// A recording being written.
pub trait EventWriter {
    /// Appends events.
    ///
    /// # Errors
    /// I/O, or an event that the format cannot hold (the message names event and field).
    fn write(&mut self, events: &[Event]) -> Result<()>;

    /// Writes what closes the file. Must be called last.
    ///
    /// # Errors
    /// I/O.
    fn finish(self: Box<Self>) -> Result<()>;

    /// As [`EventWriter::finish`], of everything before a damage: a file that is there already stays, and what was
    /// written gets the name that is returned. `None` where the file has no name but its own.
    ///
    /// # Errors
    /// I/O.
    fn finish_incomplete(self: Box<Self>) -> Result<Option<PathBuf>> {
        self.finish().map(|()| None)
    }
}

/// [`Assumption::what`] of a sensor's size that is the largest x and y of the file's events.
pub const SIZE_TAKEN: &str = "sensor size";

/// Something that a file does not say and its reader took to be so.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assumption {
    /// What: `time unit`, `times`, `columns`, `chip`, `polarity`, `sensor size`, `first pixel`,
    /// `last line`.
    pub what: &'static str,
    /// What it was taken to be.
    pub taken: String,
    /// Why, and which option says otherwise.
    pub why: String,
}

impl Assumption {
    /// The sensor's size is that of the largest x and y.
    #[must_use]
    pub fn size_taken(sensor: Sensor) -> Self {
        Self {
            what: SIZE_TAKEN,
            taken: format!("{}x{}", sensor.width, sensor.height),
            why: "the largest x and y; --width and --height say otherwise".to_owned(),
        }
    }
}

impl Assumption {
    /// Times were rounded to microseconds.
    #[must_use]
    pub fn times_rounded(how: &str) -> Self {
        Self {
            what: "times",
            taken: "whole microseconds".to_owned(),
            why: format!("the file has finer ones, which are rounded {how}"),
        }
    }
}

impl Assumption {
    /// A text file's last line was taken to be whole.
    #[must_use]
    pub fn last_line_whole() -> Self {
        Self {
            what: "last line",
            taken: "whole".to_owned(),
            why: "no line break ends it: the file may have been cut within its last number"
                .to_owned(),
        }
    }
}

impl fmt::Display for Assumption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}: {}", self.what, self.taken, self.why)
    }
}
