//! Event-file formats: one file each, reader and writer together.
//!
//! A reader streams: it holds one batch and its decoder's state, never the file.
//! Detection goes by content; the extension decides only where a recording is written.

mod adjusted;
pub mod aedat1;
pub mod aedat2;
pub mod aedat3;
pub mod aedat4;
mod aedat4_table;
mod aedat4_writer;
mod aedat_chip;
pub mod ahead;
pub mod arrow;
pub mod dat;
mod dat_times;
mod dat_writer;
mod decimal;
pub mod es;
mod event_numbers;
pub mod evt2;
pub mod evt21;
pub mod evt21_word;
pub mod evt3;
pub mod evt4;
pub mod findings;
mod flatbuffer;
mod flatbuffer_writer;
mod following;
mod format;
pub mod frames;
pub mod growing;
pub mod hdf5;
pub mod input;
mod input_buffer;
pub mod intact;
mod lz4_frame;
pub mod mat;
pub mod nmnist;
mod npy_header;
mod npy_writer;
pub mod npz;
mod npz_layout;
mod npz_writer;
mod output;
pub mod parquet;
pub mod piped;
pub mod raw_header;
mod raw_row;
mod raw_writer;
pub mod reading;
pub mod ros;
mod row_events;
mod runs;
mod section;
mod stated_size;
mod table_columns;
pub mod text;
pub mod text_layout;
mod text_writer;
mod time_unit;
mod unpack;
mod utf16;
mod wrapping;
mod zip_entry;
mod zip_recording;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::Context;
use eecvs_nostd::{Event, Sensor};

use crate::output::{create_bytes, final_path};

pub use aedat4_writer::{Aedat4Writer, Compression};
pub use arrow::ArrowWriter;
pub use dat_writer::DatWriter;
pub use format::{
    FORMATS, Format, Limits, Opening, Start, create, create_as, create_in_place, file_of, open,
    open_pipe, open_source, writable,
};
pub use hdf5::Hdf5Writer;
pub use mat::MatWriter;
pub use nmnist::NmnistWriter;
pub use npy_writer::NpyWriter;
pub use npz_writer::NpzWriter;
pub use parquet::ParquetWriter;
pub use reading::{Assumption, BadEvents, Columns, Reading, SIZE_TAKEN, TimeUnit};
pub use text_writer::TextWriter;

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

/// A recording being read, from its first event to its last; on a thread of its own, if need be.
pub trait EventReader: Send {
    /// Format name as `eecvs info` prints it: [`Format::name`].
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
    fn read(&mut self, events: &mut Vec<Event>) -> anyhow::Result<usize>;

    /// Goes on at a place behind which every event of `t_us` and later stands, where the format tells it
    /// without all that is before being read; false where nothing was done. Times are taken to ascend, as
    /// the format's index does: an event that stands before earlier ones may be left out.
    ///
    /// # Errors
    /// A damaged index.
    fn seek(&mut self, t_us: u64) -> anyhow::Result<bool> {
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
    fn write(&mut self, events: &[Event]) -> anyhow::Result<()>;

    /// Writes what closes the file. Must be called last.
    ///
    /// # Errors
    /// I/O.
    fn finish(self: Box<Self>) -> anyhow::Result<()>;

    /// As [`EventWriter::finish`], of everything before a damage: a file that is there already stays, and what was
    /// written gets the name that is returned. `None` where the file has no name but its own.
    ///
    /// # Errors
    /// I/O.
    fn finish_incomplete(self: Box<Self>) -> anyhow::Result<Option<PathBuf>> {
        self.finish().map(|()| None)
    }
}

/// Bytes that a file being written holds back.
const BUFFER_BYTES: usize = 1 << 16;

/// Opens `path` for writing; also returns its name for messages.
fn create_file(path: &Path) -> anyhow::Result<(BufWriter<File>, String)> {
    let name = final_path(path).display().to_string();
    let file = create_bytes(path).with_context(|| format!("{name}: cannot be created"))?;
    Ok((BufWriter::with_capacity(BUFFER_BYTES, file), name))
}

/// Four unnamed temporary files in the folder of `path`, which messages call `name`: columns that wait there
/// until the last event is known.
fn columns_beside(path: &Path, name: &str) -> anyhow::Result<[BufWriter<File>; 4]> {
    let folder = path.parent();
    let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
    let column = || {
        tempfile::tempfile_in(folder.unwrap_or(Path::new(".")))
            .map(BufWriter::new)
            .with_context(|| format!("{name}: no temporary file can be created beside it"))
    };
    Ok([column()?, column()?, column()?, column()?])
}

/// Refuses to write event number `index` where it lies outside of the sensor.
fn check_inside(name: &str, index: u64, event: &Event, sensor: Sensor) -> anyhow::Result<()> {
    anyhow::ensure!(
        sensor.contains(event.x, event.y),
        "{name}: event {index} at x = {}, y = {} is outside of the sensor ({}x{})",
        event.x,
        event.y,
        sensor.width,
        sensor.height
    );
    Ok(())
}

/// Message for a time that a format's wrapping field cannot follow.
fn time_refused(name: &str, index: u64, t_us: u64, format: &str) -> String {
    format!(
        "{name}: event {index}: {format} cannot step to time {t_us} us (too far back, after too \
         long a gap, or above 2^60): write .aedat4"
    )
}
