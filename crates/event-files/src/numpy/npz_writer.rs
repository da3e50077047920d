//! Writes npz files: arrays t (int64, us), x, y (uint16), p (uint8, 0 or 1), width and height.

use std::fs::File;
use std::io::{BufWriter, Read, Seek, Write};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor};
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use crate::numpy::npy_header::NpyHeader;
use crate::output::workers::Workers;
use crate::{EventWriter, create_file, files_beside};

/// Fast; event columns become about as small as with numpy's `savez_compressed`.
const DEFLATE_LEVEL: i64 = 3;

/// Size in bytes from which on zip's 64-bit fields are written.
const LARGE_BYTES: u64 = 1 << 31;

/// Names and types of the columns.
const COLUMNS: [(&str, &str); 4] = [
    ("t.npy", "<i8"),
    ("x.npy", "<u2"),
    ("y.npy", "<u2"),
    ("p.npy", "|u1"),
];

/// A writer of npz files.
///
/// A zip file holds one column after another. To bound the memory, the columns wait in unnamed temporary files
/// beside the output until the last event is known; they are then compressed side by side, into others.
pub struct NpzWriter {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    columns: [BufWriter<File>; 4],
    /// Where the columns are compressed.
    compressed: [File; 4],
    times: Vec<i64>,
    /// Numbers of a column, as bytes.
    bytes: Vec<u8>,
    events: u64,
}

impl NpzWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file, or a temporary file beside it, cannot be created.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let (file, name) = create_file(path)?;
        Ok(Self {
            file,
            sensor,
            columns: files_beside(path, &name)?.map(BufWriter::new),
            compressed: files_beside(path, &name)?,
            name,
            times: Vec::new(),
            bytes: Vec::new(),
            events: 0,
        })
    }

    /// Appends numbers to a column's file.
    fn put<const N: usize>(
        file: &mut BufWriter<File>,
        bytes: &mut Vec<u8>,
        numbers: impl ExactSizeIterator<Item = [u8; N]>,
    ) -> std::io::Result<()> {
        bytes.clear();
        bytes.resize(N * numbers.len(), 0);
        for (place, number) in bytes.as_chunks_mut().0.iter_mut().zip(numbers) {
            *place = number;
        }
        file.write_all(bytes)
    }
}

impl EventWriter for NpzWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let Self { name, bytes, .. } = self;
        let [t, x, y, p] = &mut self.columns;
        let index = self.events;
        let checked = crate::signed_times(name, index, events, self.sensor, &mut self.times);
        let events = &events[..self.times.len()];
        Self::put(t, bytes, self.times.iter().map(|t| t.to_le_bytes()))
            .and_then(|()| Self::put(x, bytes, events.iter().map(|event| event.x.to_le_bytes())))
            .and_then(|()| Self::put(y, bytes, events.iter().map(|event| event.y.to_le_bytes())))
            .and_then(|()| Self::put(p, bytes, events.iter().map(|event| [event.polarity as u8])))
            .with_context(|| format!("{name}: its temporary files cannot be written"))?;
        self.events += events.len() as u64;
        checked
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let Self {
            file,
            name,
            sensor,
            columns,
            compressed,
            events,
            ..
        } = *self;
        let failed = || format!("{name}: cannot be written");
        let mut packing = Workers::new();
        let mut packed = Vec::new();
        for ((column, to), (entry, dtype)) in columns.into_iter().zip(compressed).zip(COLUMNS) {
            let column = column
                .into_inner()
                .map_err(std::io::IntoInnerError::into_error);
            let column = column.with_context(failed)?;
            let header = NpyHeader::text(dtype, Some(events));
            packed.extend(packing.give(move || pack(column, to, entry, &header)));
        }
        packed.extend(std::iter::from_fn(|| packing.take()));
        // As a stream: a writer that seeks panics when it is dropped after an error.
        let mut zip = ZipWriter::new_stream(file);
        for column in packed {
            let mut column = column.with_context(failed)?;
            let column = column.by_index_raw(0).with_context(failed)?;
            zip.raw_copy_file(column).with_context(failed)?;
        }
        for (entry, side) in [("width.npy", sensor.width), ("height.npy", sensor.height)] {
            zip.start_file(entry, options(8)).with_context(failed)?;
            zip.write_all(&NpyHeader::text("<i8", None))
                .with_context(failed)?;
            zip.write_all(&i64::from(side).to_le_bytes())
                .with_context(failed)?;
        }
        zip.finish()
            .with_context(failed)?
            .into_inner()
            .flush()
            .with_context(failed)
    }
}

/// Compresses a column into a zip file of this entry alone.
fn pack(mut column: File, to: File, entry: &str, header: &[u8]) -> ZipResult<ZipArchive<File>> {
    let bytes = column.stream_position()?;
    column.rewind()?;
    let mut zip = ZipWriter::new_stream(BufWriter::new(to));
    zip.start_file(entry, options(bytes))?;
    zip.write_all(header)?;
    std::io::copy(&mut column.take(bytes), &mut zip)?;
    let to = zip.finish()?.into_inner().into_inner();
    ZipArchive::new(to.map_err(std::io::IntoInnerError::into_error)?)
}

fn options(bytes: u64) -> SimpleFileOptions {
    SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .compression_level(Some(DEFLATE_LEVEL))
        .large_file(bytes >= LARGE_BYTES)
}
