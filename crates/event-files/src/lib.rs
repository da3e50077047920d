//! Reads and writes the file formats of event cameras' recordings.
//!
//! ```no_run
//! use std::path::Path;
//!
//! use event_files::Reading;
//!
//! fn main() -> Result<(), event_files::Error> {
//!     let mut reader = event_files::open(Path::new("recording.raw"), Reading::default())?;
//!     println!("{:?}, {}", reader.sensor(), reader.format());
//!     let (mut events, mut on) = (Vec::new(), 0);
//!     while reader.read(&mut events)? > 0 {
//!         on += events.drain(..).filter(|event| event.polarity.sign() > 0).count();
//!     }
//!     println!("{on} events made a pixel brighter");
//!     Ok(())
//! }
//! ```
//!
//! [`open`] recognises a file's format by its content. [`Reading`] states what the file itself does not: the
//! sensor's size, the unit of the times, the meaning of the columns. A reader lists what it assumed in
//! [`EventReader::assumptions`]; if two interpretations fit, its error is of the kind [`ErrorKind::Undecided`].
//! Error texts name the flag of the command `eecvs` that decides: `--width` and `--height` are [`Reading::size`],
//! `--time-unit` is [`Reading::time_unit`], and so on. A reader streams: it holds one batch and its decoder's
//! state, never the whole file.
//!
//! [`create`] writes a recording in the format of its file name's ending; the file gets its name only when it is
//! complete. [`convert`](convert::convert) reads one recording and writes another. Each format that needs other
//! crates is a feature, and all features are on by default. EVT 2, 2.1, 3 and 4 (`.raw`), DAT, AEDAT 1 to 3, Event
//! Stream, N-MNIST and text need no feature.
//!
//! | feature | formats |
//! |---|---|
//! | `aedat4` | AEDAT 4 |
//! | `arrow`, `parquet` | Arrow, Feather, Parquet |
//! | `eecvs` | decoded EECVS frames |
//! | `hdf5` | HDF5 with any of the known data sets, including Prophesee's ECF |
//! | `mat` | MATLAB |
//! | `npz` | NumPy, and zip files that hold one recording |
//! | `ros` | ROS 1 and ROS 2 bags, including MCAP |
//! | `serde` | no format: makes findings and results serialisable |
//! | `video` | no events, but the frames of videos and recordings: see [`video`] |
//! | `info` | no format: adds `recording_info`, which counts and hashes events |
// A build without some of the formats does not use all of the code that formats share.
#![cfg_attr(
    not(all(
        feature = "aedat4",
        feature = "arrow",
        feature = "hdf5",
        feature = "npz",
        feature = "parquet",
        feature = "ros"
    )),
    allow(dead_code)
)]

// Detection and opening.
mod format;
pub mod input;
pub mod reading;

// The formats: a folder or a file for each family.
pub mod aedat;
#[cfg(feature = "arrow")]
pub mod arrow;
pub mod dat;
pub mod es;
pub mod evt;
#[cfg(feature = "eecvs")]
pub mod frames;
#[cfg(feature = "hdf5")]
pub mod hdf5;
#[cfg(feature = "mat")]
pub mod mat;
pub mod nmnist;
#[cfg(feature = "tables")]
pub mod numpy;
#[cfg(feature = "parquet")]
pub mod parquet;
#[cfg(feature = "ros")]
pub mod ros;
pub mod text;
#[cfg(feature = "npz")]
mod zipped;

// Frames in place of events.
#[cfg(feature = "video")]
pub mod video;

// Code that several families share.
#[cfg(any(feature = "aedat4", feature = "arrow"))]
mod flatbuffer;
mod table;
#[cfg(any(feature = "hdf5", feature = "parquet"))]
mod unpack;
mod word_runs;
mod wrapping;

// Operations on recordings.
#[cfg(feature = "info")]
pub mod content;
pub mod convert;
pub mod findings;
pub mod fit;
pub mod output;
#[cfg(feature = "info")]
pub mod recording_info;
pub mod slices;
pub mod sort;
pub mod within;

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

pub use event_types::stream::{
    Ahead, Assumption, BATCH_EVENTS, Context, Error, ErrorKind, EventReader, EventWriter, Intact,
    MemoryReader, Pause, Result, SIZE_TAKEN, Skipped,
};
use event_types::{Event, Sensor, ensure, error};

use crate::output::{create_bytes, final_path};
#[cfg(feature = "aedat4")]
pub use aedat::aedat4_writer::{Aedat4Writer, Compression};
#[cfg(feature = "arrow")]
pub use arrow::ArrowWriter;
pub use dat::writer::DatWriter;
pub use format::{
    FORMATS, Format, Limits, Opening, Start, create, create_as, create_in_place, file_of, open,
    open_pipe, open_source, writable,
};
#[cfg(feature = "hdf5")]
pub use hdf5::Hdf5Writer;
#[cfg(feature = "mat")]
pub use mat::MatWriter;
pub use nmnist::NmnistWriter;
#[cfg(feature = "npz")]
pub use numpy::npy_writer::NpyWriter;
#[cfg(feature = "npz")]
pub use numpy::npz_writer::NpzWriter;
#[cfg(feature = "parquet")]
pub use parquet::ParquetWriter;
pub use reading::{BadEvents, Columns, Reading, TimeUnit};
pub use text::writer::TextWriter;

/// Size in bytes of an output file's write buffer.
const BUFFER_BYTES: usize = 1 << 16;

/// Opens `path` for writing; also returns the file's name for messages.
fn create_file(path: &Path) -> Result<(BufWriter<File>, String)> {
    let name = final_path(path).display().to_string();
    let file = create_bytes(path).with_context(|| format!("{name}: cannot be created"))?;
    Ok((BufWriter::with_capacity(BUFFER_BYTES, file), name))
}

/// Creates four unnamed temporary files in the folder of `path`, one per column, which hold the columns until the
/// last event is known. Messages call the output `name`.
fn files_beside(path: &Path, name: &str) -> Result<[File; 4]> {
    let folder = path.parent();
    let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
    let file = || {
        tempfile::tempfile_in(folder.unwrap_or(Path::new(".")))
            .with_context(|| format!("{name}: no temporary file can be created beside it"))
    };
    Ok([file()?, file()?, file()?, file()?])
}

/// Returns an error if `event`, number `index`, lies outside the sensor.
fn check_inside(name: &str, index: u64, event: &Event, sensor: Sensor) -> Result<()> {
    ensure!(
        sensor.contains(event.x, event.y),
        CannotHold,
        "{name}: event {index} at x = {}, y = {} is outside the sensor ({}x{})",
        event.x,
        event.y,
        sensor.width,
        sensor.height
    );
    Ok(())
}

/// Returns an error if one of `events`, the first of which has number `index`, lies outside the sensor.
fn check_all_inside(name: &str, index: u64, events: &[Event], sensor: Sensor) -> Result<()> {
    // Without a branch per event, several are compared at once.
    let outside = |event: &Event| !sensor.contains(event.x, event.y);
    if events.iter().fold(false, |any, event| any | outside(event)) {
        let mut numbered = (index..).zip(events);
        return numbered.try_for_each(|(index, event)| check_inside(name, index, event, sensor));
    }
    Ok(())
}

/// Converts an event's time for a format with signed times; fails above 2^63 - 1 us.
fn signed_us(name: &str, index: u64, t_us: u64) -> Result<i64> {
    i64::try_from(t_us).map_err(|_| {
        error!(
            CannotHold,
            "{name}: event {index}: time {t_us} us is above 2^63 us"
        )
    })
}

/// Puts the times of `events`, the first of which has number `index`, into `times`, as [`signed_us`], up to the first event
/// that lies outside the sensor or has no such time, which is the error.
#[cfg(any(feature = "hdf5", feature = "npz"))]
fn signed_times(
    name: &str,
    index: u64,
    events: &[Event],
    sensor: Sensor,
    times: &mut Vec<i64>,
) -> Result<()> {
    times.clear();
    // Without a branch per event, several are compared at once.
    let is_held = |event: &Event| {
        sensor.contains(event.x, event.y) & (event.t_us <= i64::MAX.cast_unsigned())
    };
    if events.iter().fold(true, |all, event| all & is_held(event)) {
        times.extend(events.iter().map(|event| event.t_us.cast_signed()));
        return Ok(());
    }
    for (event, index) in events.iter().zip(index..) {
        check_inside(name, index, event, sensor)?;
        times.push(signed_us(name, index, event.t_us)?);
    }
    Ok(())
}

/// Returns the message for a time that a format's wrapping counter cannot reach.
fn time_refused(name: &str, index: u64, t_us: u64, format: &str) -> String {
    format!(
        "{name}: event {index}: {format} cannot step to time {t_us} us (too far back, after too \
         long a gap, or above 2^60): write .aedat4"
    )
}
