//! Event sources and event sinks: recordings, cameras, emulated scenes, decoded frames.
//!
//! A consumer of events takes a `&mut dyn EventReader`; a source of events implements [`EventReader`].

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use crate::{Event, Sensor};

mod ahead;
mod error;
mod intact;
mod memory;
pub mod small_file;
#[cfg(test)]
mod test_reader;
mod video;

pub use ahead::Ahead;
pub use error::{Context, Error, ErrorKind, Result};
pub use intact::Intact;
pub use memory::MemoryReader;
pub use video::{Response, VideoReader};

/// Largest number of events that one call of [`EventReader::read`] returns; a reader may return fewer.
pub const BATCH_EVENTS: usize = 1 << 14;

/// Counts, by kind, of the items of a recording that are not events or were left out: a reader reports them all.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Skipped(BTreeMap<&'static str, u64>);

impl Skipped {
    /// Adds `n` to the count of `kind`; does nothing if `n` is 0.
    pub fn add(&mut self, kind: &'static str, n: u64) {
        if n > 0 {
            *self.0.entry(kind).or_default() += n;
        }
    }

    /// Returns the kinds and their counts, ordered by name.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        self.0.iter().map(|(kind, n)| (*kind, *n))
    }

    /// Returns the kinds of [`Skipped::iter`] that are events of the camera, and their counts: what a reader of events
    /// misses. All their names begin with `events` or are `invalid events`.
    pub fn events(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        let is_event = |kind: &str| kind.starts_with("events ") || kind == "invalid events";
        self.iter().filter(move |(kind, _)| is_event(kind))
    }
}

/// A source of the events of one recording, which are read from first to last; it can be moved to another thread.
pub trait EventReader: Send {
    /// Returns the format's name as `eecvs info` prints it: a short word, such as `evt3`.
    fn format(&self) -> &'static str;

    /// Returns the sensor's size, from the file's header or, if the format has none, from the caller.
    fn sensor(&self) -> Sensor;

    /// Returns the camera or chip, if the file names it.
    fn camera(&self) -> Option<&str> {
        None
    }

    /// Returns what the reader assumed because the file does not state it; meant to be shown to the user.
    fn assumptions(&self) -> &[Assumption] {
        &[]
    }

    /// Appends the next events to `events`, in file order, at most [`BATCH_EVENTS`] of them, and returns their
    /// number.
    ///
    /// `Ok(0)` means the end, or for a live source what [`EventReader::pause`] says. All events before the damage
    /// have been returned before an error is.
    ///
    /// # Errors
    /// The file is damaged or truncated: the message names the file, the offset and the remedy.
    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize>;

    /// Moves to a position that has every event at or after `t_us` still ahead of it, if the format can find one
    /// without reading everything before it. Returns false if nothing was done.
    ///
    /// Times are assumed to ascend, as the format's index assumes: an event at or after `t_us` that is stored
    /// before earlier events may be left out.
    ///
    /// # Errors
    /// The index is damaged.
    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let _ = t_us;
        Ok(false)
    }

    /// Lets the reader end where no event before `t_us` follows, if the format can find that place, whatever the order
    /// of times; a few events after `t_us` may still come. Returns false if nothing was done.
    ///
    /// # Errors
    /// The index is damaged.
    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        let _ = t_us;
        Ok(false)
    }

    /// Leaves out and counts invalid events from here on, instead of ending with an error. Returns false if the
    /// reader knows no invalid events, or takes this choice only when it is opened.
    fn leave_out_bad_events(&mut self) -> bool {
        false
    }

    /// Says why [`EventReader::read`] returned no events: the end of the recording, unless the source is live.
    fn pause(&self) -> Pause {
        Pause::Ended
    }

    /// Returns the counts of the items met so far that are not events or were left out.
    fn skipped(&self) -> &Skipped;
}

/// Why a reader returned no events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pause {
    /// The recording has ended.
    Ended,
    /// A live source has no events yet: it has returned all those before this time, in microseconds.
    Until(u64),
}

/// A sink that writes one recording.
pub trait EventWriter {
    /// Appends events.
    ///
    /// # Errors
    /// I/O, or an event that the format cannot hold (the message names the event and the field).
    fn write(&mut self, events: &[Event]) -> Result<()>;

    /// Completes the file. Must be called last.
    ///
    /// # Errors
    /// I/O.
    fn finish(self: Box<Self>) -> Result<()>;

    /// Completes a file that holds only the events before the damage. An existing file of that name is kept, and
    /// the new one gets another name, which is returned; `None` if the output has no other name.
    ///
    /// # Errors
    /// I/O.
    fn finish_incomplete(self: Box<Self>) -> Result<Option<PathBuf>> {
        self.finish().map(|()| None)
    }
}

/// [`Assumption::what`] for a sensor size that was taken from the largest x and y of the file's events.
pub const SIZE_TAKEN: &str = "sensor size";

/// Something that a file does not state, or states otherwise than it was read, and that its reader assumed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assumption {
    /// What was assumed: `time unit`, `times`, `clock`, `columns`, `chip`, `polarity`, `sensor size`,
    /// `stated size`, `first pixel`, `last line`, `recording`, `stream`, `version`.
    pub what: &'static str,
    /// The value that was assumed.
    pub taken: String,
    /// The reason, and the option that overrides it.
    pub why: String,
}

impl Assumption {
    /// Records that the sensor's size is the largest x and y of the events, plus one.
    #[must_use]
    pub fn size_taken(sensor: Sensor) -> Self {
        Self {
            what: SIZE_TAKEN,
            taken: format!("{}x{}", sensor.width, sensor.height),
            why: "the largest x and y; --width and --height override this".to_owned(),
        }
    }
}

impl Assumption {
    /// Records that times were rounded to microseconds.
    #[must_use]
    pub fn times_rounded(how: &str) -> Self {
        Self {
            what: "times",
            taken: "whole microseconds".to_owned(),
            why: format!("the file has finer times, which are rounded {how}"),
        }
    }
}

impl Assumption {
    /// Records that a text file's last line was assumed to be complete.
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
