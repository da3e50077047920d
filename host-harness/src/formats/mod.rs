//! Event-file formats: one file each, reader and writer together.
//!
//! A reader streams: it holds one batch and its decoder's state, never the file.
//! Detection goes by content; the extension decides only where a recording is written.

use std::path::Path;

use eecvs_nostd::{Event, Sensor};

/// Events of one call of [`EventReader::read`], at the most (a reader may return fewer).
pub const BATCH_EVENTS: usize = 1 << 14;

/// What a recording holds besides events; skipped, counted by name, never silent.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Skipped(std::collections::BTreeMap<&'static str, u64>);

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

/// A recording being read, from its first event to its last.
pub trait EventReader {
    /// Format name as `eecvs info` prints it: `aedat4`, `aedat2`, `evt2`, `evt3`, `text`, `npz`.
    fn format(&self) -> &'static str;

    /// Sensor size from the file's header, or from the caller where the format has none.
    fn sensor(&self) -> Sensor;

    /// Appends the next events to `events`, in file order, at most [`BATCH_EVENTS`] of them.
    ///
    /// `Ok(0)` is the end. After an error everything before the damage has been returned.
    ///
    /// # Errors
    /// A damaged or truncated file: the message names the file, the offset and what to do.
    fn read(&mut self, events: &mut Vec<Event>) -> anyhow::Result<usize>;

    /// Non-event items met so far.
    fn skipped(&self) -> &Skipped;
}

/// A recording being written.
pub trait EventWriter {
    /// Appends events.
    ///
    /// # Errors
    /// I/O, or an event that the format cannot hold (the message names event and field).
    fn write(&mut self, events: &[Event]) -> anyhow::Result<()>;

    /// Writes what closes the file. Must be called last.
    ///
    /// # Errors
    /// I/O.
    fn finish(self: Box<Self>) -> anyhow::Result<()>;
}

/// Opens a recording, its format found by content; `size` is used where the file has none.
///
/// # Errors
/// Unknown format, unreadable file, damaged header.
pub fn open(path: &Path, size: Option<Sensor>) -> anyhow::Result<Box<dyn EventReader>> {
    let _ = size;
    anyhow::bail!("{}: not a recording of a known format", path.display())
}

/// Creates a recording; the extension names the format.
///
/// # Errors
/// Unknown extension, unwritable file.
pub fn create(path: &Path, sensor: Sensor) -> anyhow::Result<Box<dyn EventWriter>> {
    let _ = sensor;
    anyhow::bail!("{}: no format has this extension", path.display())
}
