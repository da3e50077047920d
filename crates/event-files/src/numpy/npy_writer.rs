//! Writes `.npy` files: one structured array with fields t (int64, us), x, y (int16), p (uint8, 0 or 1).
//!
//! Names, order and types are those of expelliarmus; tonic and others find the fields by name, whatever their
//! types. An array has no place for the sensor's size: a reader must know it, or takes it from the largest x and y.

use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor};

use crate::numpy::npy_header::NpyHeader;
use crate::{EventWriter, create_file};

const DESCR: &str = "[('t', '<i8'), ('x', '<i2'), ('y', '<i2'), ('p', '|u1')]";

/// Size in bytes of the header, whatever the number of events.
const HEADER_BYTES: usize = 192;

/// A writer of `.npy` files.
pub struct NpyWriter {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    events: u64,
}

impl NpyWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let (mut file, name) = create_file(path)?;
        file.write_all(&NpyHeader::padded(DESCR, Some(0), HEADER_BYTES))
            .with_context(|| format!("{name}: cannot be written"))?;
        Ok(Self {
            file,
            name,
            sensor,
            events: 0,
        })
    }
}

impl EventWriter for NpyWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(&self.name, self.events, event, self.sensor)?;
            let (name, index, t_us) = (&self.name, self.events, event.t_us);
            let t = crate::signed_us(name, index, t_us)?;
            let mut bytes = [0; 13];
            let (time, rest) = bytes.split_at_mut(8);
            time.copy_from_slice(&t.to_le_bytes());
            let (pixel, polarity) = rest.split_at_mut(4);
            let [x, y] = [event.x, event.y].map(u16::to_le_bytes);
            pixel.copy_from_slice(&[x, y].concat());
            polarity.fill(event.polarity as u8);
            let written = self.file.write_all(&bytes);
            written.with_context(|| format!("{name}: cannot be written"))?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let Self {
            mut file,
            name,
            events,
            ..
        } = *self;
        let header = NpyHeader::padded(DESCR, Some(events), HEADER_BYTES);
        let written = file.rewind().and_then(|()| file.write_all(&header));
        let written = written.and_then(|()| file.flush());
        written.with_context(|| format!("{name}: cannot be written"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_of_one_length() {
        for events in [0, u64::MAX] {
            let header = NpyHeader::padded(DESCR, Some(events), HEADER_BYTES);
            assert_eq!(header.len(), HEADER_BYTES);
        }
    }
}
