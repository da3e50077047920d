//! Packs arrays as a fair link would carry them: only the numbers of active pixels, compressed by xz.
//!
//! ```text
//! window   number u64, step f32 if there is one,
//!          a bit for each pixel, the lowest of a byte first: 1 if the pixel is active,
//!          planes: of each channel the lowest byte of every active pixel, the next byte of each, ...
//! ```
//!
//! Little-endian, one window after the other, through a single `xz -6`. Planes bring bytes together that change
//! little, and the single stream exploits what windows have in common; independent streams would be longer.

use std::io::{self, Write};

use anyhow::{Context, Result};
use eecvs_nostd::Sensor;
use lzma_rust2::{XzOptions, XzWriter};

use super::dense_array::StoredArray;

/// Compression level of xz.
const PRESET: u32 = 6;

/// A writer that only counts bytes.
#[derive(Debug, Default)]
pub struct Count(usize);

impl Write for Count {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Packs one window after the other.
pub struct Packer<W: Write> {
    writer: XzWriter<W>,
    /// One window before xz; kept to reuse its memory.
    bytes: Vec<u8>,
    pixels: usize,
}

impl<W: Write> Packer<W> {
    /// Starts a stream to `output` for arrays of the sensor's size.
    ///
    /// # Errors
    /// Fails if the output cannot be written.
    pub fn new(sensor: Sensor, output: W) -> Result<Self> {
        let options = XzOptions::with_preset(PRESET);
        Ok(Self {
            writer: XzWriter::new(output, options).context("xz")?,
            bytes: Vec::new(),
            pixels: sensor.pixels() as usize,
        })
    }

    /// Appends the array of window `number`.
    ///
    /// # Errors
    /// Fails if the output cannot be written.
    pub fn push(&mut self, number: u64, array: &StoredArray) -> Result<()> {
        let bytes = &mut self.bytes;
        bytes.clear();
        bytes.extend_from_slice(&number.to_le_bytes());
        if let Some(step) = array.quantiser.step() {
            bytes.extend_from_slice(&step.to_le_bytes());
        }
        let bitmap = bytes.len();
        bytes.resize(bitmap + self.pixels.div_ceil(8), 0);
        for pixel in &array.pixels {
            if let Some(byte) = bytes.get_mut(bitmap + *pixel as usize / 8) {
                *byte |= 1 << (pixel % 8);
            }
        }
        let channels = array.codes.len().checked_div(array.pixels.len());
        for channel in 0..channels.unwrap_or(0) {
            for place in 0..array.quantiser.stored().bytes() {
                let codes = array.codes.iter().skip(channel);
                let codes = codes.step_by(channels.unwrap_or(1));
                bytes.extend(codes.map(|code| (code >> (8 * place)) as u8));
            }
        }
        self.writer.write_all(bytes).context("xz")
    }

    /// Ends the stream and returns the output.
    ///
    /// # Errors
    /// Fails if the output cannot be written.
    pub fn finish(self) -> Result<W> {
        self.writer.finish().context("xz")
    }
}

impl Packer<Count> {
    /// Starts a stream that is discarded, to measure its length.
    ///
    /// # Errors
    /// Never fails, since there is always room.
    pub fn counting(sensor: Sensor) -> Result<Self> {
        Self::new(sensor, Count::default())
    }

    /// Ends the stream and returns its length in bytes.
    ///
    /// # Errors
    /// Never fails, since there is always room.
    pub fn packed_bytes(self) -> Result<usize> {
        Ok(self.finish()?.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baseline::dense_array::Array;
    use crate::baseline::stored::{Range, Stored};
    use crate::rate::squeeze::unxz;

    #[test]
    fn numbers_lie_in_planes_behind_a_bitmap() {
        let array = Array {
            pixels: vec![0, 9, 15],
            values: vec![1.0, 2.0, 256.0, 4.0, 5.0, 6.0],
        };
        let sensor = Sensor::new(4, 4).unwrap();
        for (stored, planes) in [
            (Stored::Bits8, &[1, 255, 5, 2, 4, 6][..]),
            (Stored::Bits16, &[1, 0, 5, 0, 1, 0, 2, 4, 6, 0, 0, 0]),
        ] {
            let array = array.clone().stored(Range::Counts, stored);
            let mut packer = Packer::new(sensor, Vec::new()).unwrap();
            packer.push(0x0102, &array).unwrap();
            packer.push(3, &array).unwrap();
            let packed = packer.finish().unwrap();
            let head = |low, next| [low, next, 0, 0, 0, 0, 0, 0, 1, 0b1000_0010];
            let expected = [&head(2, 1)[..], planes, &head(3, 0), planes].concat();
            assert_eq!(unxz(&packed).unwrap(), expected);
            let mut counting = Packer::counting(sensor).unwrap();
            counting.push(0x0102, &array).unwrap();
            counting.push(3, &array).unwrap();
            assert_eq!(counting.packed_bytes().unwrap(), packed.len());
        }
    }

    #[test]
    fn a_step_comes_before_the_bitmap() {
        let array = Array {
            pixels: vec![1],
            values: vec![-254.0],
        };
        let array = array.stored(Range::Signed, Stored::Bits8);
        let mut packer = Packer::new(Sensor::new(2, 1).unwrap(), Vec::new()).unwrap();
        packer.push(0, &array).unwrap();
        let expected = [&[0; 8][..], &2.0_f32.to_le_bytes(), &[0b10, -127_i8 as u8]];
        assert_eq!(unxz(&packer.finish().unwrap()).unwrap(), expected.concat());
    }
}
