//! Writes npz files: arrays t (int64, us), x, y (uint16), p (uint8, 0 or 1), width and height.

use std::fs::File;
use std::io::{BufWriter, Read, Seek, Write};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor};
use zip::write::SimpleFileOptions;

use crate::numpy::npy_header::NpyHeader;
use crate::{EventWriter, columns_beside, create_file};

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
/// beside the output until the last event is known.
pub struct NpzWriter {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    columns: [BufWriter<File>; 4],
    events: u64,
}

impl NpzWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file, or a temporary file beside it, cannot be created.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let (file, name) = create_file(path)?;
        let columns = columns_beside(path, &name)?;
        Ok(Self {
            file,
            name,
            sensor,
            columns,
            events: 0,
        })
    }
}

impl EventWriter for NpzWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(&self.name, self.events, event, self.sensor)?;
            let (name, index, t_us) = (&self.name, self.events, event.t_us);
            let t = crate::signed_us(name, index, t_us)?;
            let [t_column, x_column, y_column, p_column] = &mut self.columns;
            t_column
                .write_all(&t.to_le_bytes())
                .and_then(|()| x_column.write_all(&event.x.to_le_bytes()))
                .and_then(|()| y_column.write_all(&event.y.to_le_bytes()))
                .and_then(|()| p_column.write_all(&[event.polarity as u8]))
                .with_context(|| format!("{name}: its temporary files cannot be written"))?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let Self {
            file,
            name,
            sensor,
            columns,
            events,
        } = *self;
        let failed = || format!("{name}: cannot be written");
        // As a stream: a writer that seeks panics when it is dropped after an error.
        let mut zip = zip::ZipWriter::new_stream(file);
        for ((entry, dtype), column) in COLUMNS.into_iter().zip(columns) {
            let mut column = column
                .into_inner()
                .map_err(std::io::IntoInnerError::into_error)?;
            let bytes = column.stream_position().with_context(failed)?;
            column.rewind().with_context(failed)?;
            zip.start_file(entry, options(bytes)).with_context(failed)?;
            zip.write_all(&NpyHeader::text(dtype, Some(events)))
                .with_context(failed)?;
            let copied = std::io::copy(&mut column.take(bytes), &mut zip);
            copied.with_context(failed)?;
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

fn options(bytes: u64) -> SimpleFileOptions {
    SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .compression_level(Some(DEFLATE_LEVEL))
        .large_file(bytes >= LARGE_BYTES)
}
