//! Writes MATLAB files of level 5, compressed like those of `save -v7`: a structure `TD`, as in Prophesee's
//! scripts, with columns x, y (uint16, from 0 on), p (int8, 1 or -1) and ts (int64, us), and the scalars `width`
//! and `height`.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Polarity, Sensor, ensure};
use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::file::{COMPRESSED, HEADER_BYTES, MATRIX, STRUCTURE};
use crate::{EventWriter, check_inside, create_file};

/// Fast, and close to the size of MATLAB's own files.
const DEFLATE_LEVEL: u32 = 3;

/// Size in bytes of an event, and largest size of a variable: level 5 allows at most 2 GiB.
const EVENT_BYTES: u64 = 13;
const VARIABLE_BYTES_MAX: u64 = (1 << 31) - (1 << 12);

/// Number of bytes for a field's name.
const NAME_BYTES: usize = 32;

/// A class of arrays: its number, and the type and size in bytes of its numbers in the file.
#[derive(Clone, Copy)]
struct Class {
    class: u32,
    stored: u32,
    bytes: u64,
}

const DOUBLE: Class = Class {
    class: 6,
    stored: 9,
    bytes: 8,
};
const INT8: Class = Class {
    class: 8,
    stored: 1,
    bytes: 1,
};
const UINT16: Class = Class {
    class: 11,
    stored: 4,
    bytes: 2,
};
const INT64: Class = Class {
    class: 14,
    stored: 12,
    bytes: 8,
};

/// The fields of the structure.
const FIELDS: [(&str, Class); 4] = [("x", UINT16), ("y", UINT16), ("p", INT8), ("ts", INT64)];

/// A writer of MAT-files.
///
/// A structure holds one column after another. To bound the memory, the columns wait in unnamed temporary files
/// beside the output until the last event is known.
pub struct MatWriter {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    columns: [BufWriter<File>; 4],
    events: u64,
}

impl MatWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file, or a temporary file beside it, cannot be created.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let (file, name) = create_file(path)?;
        let columns = crate::files_beside(path, &name)?.map(BufWriter::new);
        Ok(Self {
            file,
            name,
            sensor,
            columns,
            events: 0,
        })
    }

    fn close(self) -> io::Result<()> {
        let mut file = self.file;
        let mut header = [b' '; HEADER_BYTES];
        let text = b"MATLAB 5.0 MAT-file, events of a camera: TD.x, TD.y, TD.p, TD.ts (us)";
        header[..text.len()].copy_from_slice(text);
        header[HEADER_BYTES - 12..].copy_from_slice(b"\0\0\0\0\0\0\0\0\0\x01IM");
        file.write_all(&header)?;
        for (name, side) in [("width", self.sensor.width), ("height", self.sensor.height)] {
            variable(&mut file, |to| {
                let inside = array_bytes(name, DOUBLE, 1) - 8;
                array(
                    to,
                    name,
                    DOUBLE,
                    1,
                    inside,
                    &mut f64::from(side).to_le_bytes().as_slice(),
                )
            })?;
        }
        let events = self.events;
        let mut columns = Vec::new();
        for column in self.columns {
            let mut column = column
                .into_inner()
                .map_err(io::IntoInnerError::into_error)?;
            column.rewind()?;
            columns.push(column);
        }
        variable(&mut file, |to| {
            let fields = FIELDS.map(|(_, class)| array_bytes("", class, events));
            let names = NAME_BYTES * FIELDS.len();
            let head = 16 + 16 + text_bytes("TD") + 8 + 8 + names as u64;
            tag(to, MATRIX, head + fields.iter().sum::<u64>())?;
            head_of(to, "TD", STRUCTURE.into(), 1)?;
            // A small element has its size in the upper half of the type.
            put(to, &[4 << 16 | 5, NAME_BYTES as u32])?;
            tag(to, 1, names as u64)?;
            for (name, _) in FIELDS {
                let mut bytes = [0; NAME_BYTES];
                bytes[..name.len()].copy_from_slice(name.as_bytes());
                to.write_all(&bytes)?;
            }
            for (((_, class), bytes), column) in FIELDS.iter().zip(fields).zip(&mut columns) {
                array(to, "", *class, events, bytes - 8, column)?;
            }
            Ok(())
        })?;
        file.flush()
    }
}

impl EventWriter for MatWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            let (name, index, t_us) = (&self.name, self.events, event.t_us);
            check_inside(name, index, event, self.sensor)?;
            let t = crate::signed_us(name, index, t_us)?;
            ensure!(
                index < VARIABLE_BYTES_MAX / EVENT_BYTES,
                CannotHold,
                "{name}: event {index}: MATLAB's level 5 limits a variable to 2 GiB: cut the \
                 recording with --to-us, or write .hdf5"
            );
            let p: i8 = if event.polarity == Polarity::On {
                1
            } else {
                -1
            };
            let [x_column, y_column, p_column, t_column] = &mut self.columns;
            x_column
                .write_all(&event.x.to_le_bytes())
                .and_then(|()| y_column.write_all(&event.y.to_le_bytes()))
                .and_then(|()| p_column.write_all(&p.to_le_bytes()))
                .and_then(|()| t_column.write_all(&t.to_le_bytes()))
                .with_context(|| format!("{name}: its temporary files cannot be written"))?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let name = self.name.clone();
        let closed = self.close();
        closed.with_context(|| format!("{name}: cannot be written"))
    }
}

/// Writes a compressed variable.
fn variable(
    file: &mut BufWriter<File>,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let at = file.stream_position()?;
    tag(file, COMPRESSED, 0)?;
    let mut packed = ZlibEncoder::new(&mut *file, Compression::new(DEFLATE_LEVEL));
    fill(&mut packed)?;
    packed.finish()?;
    let end = file.stream_position()?;
    file.seek(SeekFrom::Start(at))?;
    tag(file, COMPRESSED, end - at - 8)?;
    file.seek(SeekFrom::Start(end))?;
    Ok(())
}

fn put(to: &mut dyn Write, words: &[u32]) -> io::Result<()> {
    words
        .iter()
        .try_for_each(|word| to.write_all(&word.to_le_bytes()))
}

fn tag(to: &mut dyn Write, kind: u32, bytes: u64) -> io::Result<()> {
    // `write` ensures that no variable exceeds 2 GiB.
    put(to, &[kind, u32::try_from(bytes).unwrap_or(u32::MAX)])
}

/// Returns the size in bytes of the element of a text.
fn text_bytes(text: &str) -> u64 {
    8 + (text.len() as u64).next_multiple_of(8)
}

/// Returns the size in bytes of the element of an array of `rows` numbers.
fn array_bytes(name: &str, class: Class, rows: u64) -> u64 {
    8 + 16 + 16 + text_bytes(name) + 8 + (rows * class.bytes).next_multiple_of(8)
}

/// Writes the flags, dimensions and name of an array.
fn head_of(to: &mut dyn Write, name: &str, class: u32, rows: u64) -> io::Result<()> {
    put(to, &[6, 8, class, 0])?;
    put(to, &[5, 8, u32::try_from(rows).unwrap_or(u32::MAX), 1])?;
    tag(to, 1, name.len() as u64)?;
    to.write_all(name.as_bytes())?;
    pad(to, name.len() as u64)
}

/// Pads a content of `bytes` bytes with zeros to a multiple of 8.
fn pad(to: &mut dyn Write, bytes: u64) -> io::Result<()> {
    io::copy(
        &mut io::repeat(0).take(bytes.next_multiple_of(8) - bytes),
        to,
    )
    .map(drop)
}

/// Writes an array of `rows` numbers as an element with `inside` bytes of content.
fn array(
    to: &mut dyn Write,
    name: &str,
    class: Class,
    rows: u64,
    inside: u64,
    numbers: &mut dyn Read,
) -> io::Result<()> {
    tag(to, MATRIX, inside)?;
    head_of(to, name, class.class, rows)?;
    let bytes = rows * class.bytes;
    tag(to, class.stored, bytes)?;
    io::copy(&mut numbers.take(bytes), to)?;
    pad(to, bytes)
}
