//! Readers and writers of every format that event cameras' recordings come in.
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
//! [`open`] finds a file's format by its content; [`Reading`] says what the file itself does not: the sensor's size,
//! the unit of the times, which columns are which. What was taken to be so is in [`EventReader::assumptions`], and where
//! two readings fit the error has [`ErrorKind::Undecided`]. Its text names the flag of the command `eecvs` that decides:
//! `--width` and `--height` are [`Reading::size`], `--time-unit` is [`Reading::time_unit`], and so on. A reader streams:
//! it holds one batch and its decoder's state, never the file.
//!
//! [`create`] writes a recording, whose name's ending is the format; the file has its name when it is complete.
//! [`convert`](convert::convert) does both. A format that needs other crates is a feature, and every one is on by
//! default: EVT 2, 2.1, 3 and 4 (`.raw`), DAT, AEDAT 1 to 3, Event Stream, N-MNIST and text need none.
//!
//! | feature | formats |
//! |---|---|
//! | `aedat4` | AEDAT 4 |
//! | `arrow`, `parquet` | Arrow, Feather, Parquet |
//! | `eecvs` | frames of EECVS, decoded |
//! | `hdf5` | HDF5 of every data set that is known, Prophesee's ECF among them |
//! | `mat` | MATLAB |
//! | `npz` | NumPy, and zip files of one recording |
//! | `ros` | bags of ROS 1 and ROS 2, MCAP among them |
//! | `serde` | no format: what was found can be serialised |
//! | `info` | no format: `recording_info`, with hashes |
// A build without some formats does not use all that they share.
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

// What opens and detects.
mod format;
pub mod input;
pub mod reading;

// A folder or a file for each family of formats.
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

// What families share.
#[cfg(any(feature = "aedat4", feature = "arrow"))]
mod flatbuffer;
mod table;
#[cfg(any(feature = "hdf5", feature = "parquet"))]
mod unpack;
mod word_runs;
mod wrapping;

// What is done with recordings.
#[cfg(feature = "info")]
pub mod content;
pub mod convert;
pub mod findings;
pub mod fit;
pub mod output;
#[cfg(feature = "info")]
pub mod recording_info;
pub mod sort;

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

/// Bytes that a file being written holds back.
const BUFFER_BYTES: usize = 1 << 16;

/// Opens `path` for writing; also returns its name for messages.
fn create_file(path: &Path) -> Result<(BufWriter<File>, String)> {
    let name = final_path(path).display().to_string();
    let file = create_bytes(path).with_context(|| format!("{name}: cannot be created"))?;
    Ok((BufWriter::with_capacity(BUFFER_BYTES, file), name))
}

/// Four unnamed temporary files in the folder of `path`, which messages call `name`: columns that wait there
/// until the last event is known.
fn columns_beside(path: &Path, name: &str) -> Result<[BufWriter<File>; 4]> {
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
fn check_inside(name: &str, index: u64, event: &Event, sensor: Sensor) -> Result<()> {
    ensure!(
        sensor.contains(event.x, event.y),
        CannotHold,
        "{name}: event {index} at x = {}, y = {} is outside of the sensor ({}x{})",
        event.x,
        event.y,
        sensor.width,
        sensor.height
    );
    Ok(())
}

/// An event's time as a format of signed times has it.
fn signed_us(name: &str, index: u64, t_us: u64) -> Result<i64> {
    i64::try_from(t_us).map_err(|_| {
        error!(
            CannotHold,
            "{name}: event {index}: time {t_us} us is above 2^63 us"
        )
    })
}

/// Message for a time that a format's wrapping field cannot follow.
fn time_refused(name: &str, index: u64, t_us: u64, format: &str) -> String {
    format!(
        "{name}: event {index}: {format} cannot step to time {t_us} us (too far back, after too \
         long a gap, or above 2^60): write .aedat4"
    )
}
