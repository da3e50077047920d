//! Event-file formats: one file each, reader and writer together.
//!
//! A reader streams: it holds one batch and its decoder's state, never the file.
//! Detection goes by content; the extension decides only where a recording is written.

pub mod aedat2;
pub mod aedat4;
mod aedat4_writer;
pub mod ahead;
mod decimal;
mod event_numbers;
pub mod evt2;
pub mod evt3;
mod flatbuffer;
pub mod hdf5;
mod hdf5_file;
mod hdf5_layout;
pub mod input;
mod npy_header;
pub mod npz;
mod npz_layout;
mod npz_writer;
pub mod raw_header;
pub mod text;
pub mod text_layout;
mod text_writer;
mod time_unit;
mod wrapping;
mod zip_entry;

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;
use eecvs_nostd::{Event, Sensor};

use aedat2::{Aedat2Reader, Aedat2Writer};
use aedat4::Aedat4Reader;
pub use aedat4_writer::{Aedat4Writer, Compression};
use evt2::{Evt2Reader, Evt2Writer};
use evt3::{Evt3Reader, Evt3Writer};
use hdf5::Hdf5Reader;
use input::{Input, ReadSeek};
use npz::NpzReader;
pub use npz_writer::NpzWriter;
use raw_header::{RawHeader, Words};
use text::TextReader;
pub use text_writer::TextWriter;

/// Events of one call of [`EventReader::read`], at the most (a reader may return fewer).
pub const BATCH_EVENTS: usize = 1 << 14;

/// Bytes that detection looks at.
const DETECT_BYTES: usize = 4096;

const READABLE: &str = "AEDAT 4 and 2, Prophesee RAW EVT 2 and 3, text t x y p, npz, HDF5";
const WRITABLE: &str = ".aedat4, .aedat (AEDAT 2), .raw (EVT 3), .evt2.raw or .evt2 (EVT 2), .csv, \
                        .txt, .npz";

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
    /// Format name as `eecvs info` prints it: `aedat4`, `aedat2`, `evt2`, `evt3`, `text`, `npz`,
    /// `hdf5`.
    fn format(&self) -> &'static str;

    /// Sensor size from the file's header, or from the caller where the format has none.
    fn sensor(&self) -> Sensor;

    /// Camera or chip as the file names it, where it does.
    fn camera(&self) -> Option<&str> {
        None
    }

    /// Appends the next events to `events`, in file order, at most [`BATCH_EVENTS`] of them.
    ///
    /// `Ok(0)` is the end. After an error everything before the damage has been returned.
    ///
    /// # Errors
    /// A damaged or truncated file: the message names the file, the offset and what to do.
    fn read(&mut self, events: &mut Vec<Event>) -> anyhow::Result<usize>;

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
}

/// Opens a recording, its format found by content; `size` is used where the file has none.
///
/// A dataset or group of an HDF5 file is named behind it: `FILE.hdf5/davis/right/events`.
///
/// # Errors
/// Unknown format, unreadable file, damaged header.
pub fn open(path: &Path, size: Option<Sensor>) -> anyhow::Result<Box<dyn EventReader>> {
    let name = path.display().to_string();
    if let Some((file, place)) = place_inside(path) {
        let name = file.display().to_string();
        let source = File::open(file).with_context(|| format!("{name}: cannot be opened"))?;
        let reader = Hdf5Reader::new(Box::new(source), &name, Some(&place), size)?;
        return Ok(Box::new(reader));
    }
    let metadata = std::fs::metadata(path).with_context(|| format!("{name}: cannot be opened"))?;
    anyhow::ensure!(
        !metadata.is_dir(),
        "{name}: is a directory, not a recording"
    );
    let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
    open_source(Box::new(file), &name, size)
}

/// The file and the rest of a path that leads into a file.
fn place_inside(path: &Path) -> Option<(&Path, String)> {
    let file = path.ancestors().skip(1).find(|file| file.is_file())?;
    let rest = path.strip_prefix(file).ok()?;
    let names: Option<Vec<&str>> = rest.iter().map(|name| name.to_str()).collect();
    Some((file, names?.join("/")))
}

/// As [`open`], for a file or bytes in memory, which messages call `name`.
///
/// # Errors
/// As [`open`].
pub fn open_source(
    source: Box<dyn ReadSeek>,
    name: &str,
    size: Option<Sensor>,
) -> anyhow::Result<Box<dyn EventReader>> {
    let mut input = Input::new(source, name)?;
    let mut start = vec![0; DETECT_BYTES];
    let filled = input.fill(&mut start)?;
    start.truncate(filled);
    if start.is_empty() {
        anyhow::bail!("{name}: byte 0: the file is empty");
    }
    let begins = |magic: &[u8]| start.starts_with(magic);
    if begins(aedat2::MAGIC) {
        return Ok(Box::new(Aedat2Reader::new(input.into_source(), name)?));
    }
    if begins(aedat4::MAGIC) {
        return Ok(Box::new(Aedat4Reader::new(
            input.into_source(),
            name,
            size,
        )?));
    }
    if begins(b"#!AER-DAT") {
        anyhow::bail!("{name}: byte 0: only AEDAT 2.0 and 4.0 are known: convert it with DV");
    }
    // Behind a user block, if there is one.
    if [0, 512, 1024, 2048].iter().any(|at| {
        let rest = start.get(*at..);
        rest.is_some_and(|rest| rest.starts_with(hdf5::MAGIC))
    }) {
        let source = input.into_source();
        return Ok(Box::new(Hdf5Reader::new(source, name, None, size)?));
    }
    if begins(npz::MAGIC) {
        return Ok(Box::new(NpzReader::new(input.into_source(), name, size)?));
    }
    if begins(b"%") {
        input.seek(0)?;
        let words = RawHeader::read(&mut input)?.words;
        let source = input.into_source();
        match words {
            Ok(Words::Evt2) => return Ok(Box::new(Evt2Reader::new(source, name, size)?)),
            Ok(Words::Evt3) => return Ok(Box::new(Evt3Reader::new(source, name, size)?)),
            Err(other) if !other.is_empty() => {
                anyhow::bail!("{name}: byte 0: {other} is not known: record EVT2 or EVT3")
            }
            Err(_) => return Ok(Box::new(TextReader::new(source, name, size)?)),
        }
    }
    if is_text(&start) {
        return Ok(Box::new(TextReader::new(input.into_source(), name, size)?));
    }
    anyhow::bail!("{name}: byte 0: not a recording of a known format ({READABLE})")
}

/// Creates a recording; the extension names the format.
///
/// # Errors
/// Unknown extension, unwritable file, a sensor that the format cannot hold.
pub fn create(path: &Path, sensor: Sensor) -> anyhow::Result<Box<dyn EventWriter>> {
    let name = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .to_ascii_lowercase();
    let is = |extension: &str| name.ends_with(extension);
    if is(".aedat4") {
        return Ok(Box::new(Aedat4Writer::create(path, sensor)?));
    }
    if is(".aedat") {
        return Ok(Box::new(Aedat2Writer::create(path, sensor)?));
    }
    if is(".evt2.raw") || is(".evt2") {
        return Ok(Box::new(Evt2Writer::create(path, sensor)?));
    }
    if is(".raw") {
        return Ok(Box::new(Evt3Writer::create(path, sensor)?));
    }
    if is(".csv") || is(".txt") {
        return Ok(Box::new(TextWriter::create(path, sensor)?));
    }
    if is(".npz") {
        return Ok(Box::new(NpzWriter::create(path, sensor)?));
    }
    anyhow::bail!(
        "{}: no format has this extension: use {WRITABLE}",
        path.display()
    )
}

/// Whether a file may be lines of events: its first line is text without control characters but
/// separators. What follows may be damaged, which the reader reports after the events before it.
fn is_text(start: &[u8]) -> bool {
    let first = start
        .split(|byte| *byte == b'\n')
        .next()
        .unwrap_or_default();
    let control = |byte: &u8| byte.is_ascii_control() && !b"\t\r".contains(byte);
    std::str::from_utf8(first).is_ok() && !first.iter().any(control)
}

/// Opens `path` for writing; also returns its name for messages.
fn create_file(path: &Path) -> anyhow::Result<(BufWriter<File>, String)> {
    let name = path.display().to_string();
    let file = File::create(path).with_context(|| format!("{name}: cannot be created"))?;
    Ok((BufWriter::with_capacity(1 << 16, file), name))
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
