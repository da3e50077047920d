//! An RGB picture with the few things that a report draws: rectangles, other pictures, text.

use std::path::Path;

use event_files::{Error, ErrorKind};
use font8x8::legacy::BASIC_LEGACY;

/// Red, green and blue.
pub type Colour = [u8; 3];

/// Side of a character cell at scale 1, in pixels.
pub const CELL: usize = 8;

/// Pixels from the left to the right, from the top to the bottom. Drawing outside is cut off.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Picture {
    /// A picture of one colour. A side of 0 becomes 1, as PNG has no empty pictures.
    #[must_use]
    pub fn new(width: usize, height: usize, colour: Colour) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self {
            width,
            height,
            rgb: colour.repeat(width * height),
        }
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Colour of pixel (x, y), `None` outside of the picture.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> Option<Colour> {
        if x >= self.width {
            return None;
        }
        let start = (y * self.width + x) * 3;
        self.rgb.get(start..start + 3)?.try_into().ok()
    }

    /// Every pixel's colour, row by row.
    pub fn pixels(&self) -> impl Iterator<Item = Colour> + '_ {
        let (pixels, _) = self.rgb.as_chunks();
        pixels.iter().copied()
    }

    /// Fills the rectangle of `width` x `height` whose upper left corner is (x, y).
    pub fn fill(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Colour) {
        let end = (x + width).min(self.width);
        for row in y..(y + height).min(self.height) {
            let (from, to) = ((row * self.width + x) * 3, (row * self.width + end) * 3);
            for pixel in self
                .rgb
                .get_mut(from..to)
                .unwrap_or_default()
                .chunks_exact_mut(3)
            {
                pixel.copy_from_slice(&colour);
            }
        }
    }

    /// Draws `other` with its upper left corner at (x, y).
    pub fn place(&mut self, x: usize, y: usize, other: &Self) {
        let columns = other.width.min(self.width.saturating_sub(x));
        let rows = other.rgb.chunks_exact(other.width * 3);
        for (row, source) in rows.enumerate().take(self.height.saturating_sub(y)) {
            let start = ((y + row) * self.width + x) * 3;
            let target = self.rgb.get_mut(start..start + columns * 3);
            if let (Some(target), Some(source)) = (target, source.get(..columns * 3)) {
                target.copy_from_slice(source);
            }
        }
    }

    /// Writes `text` in cells of 8 x 8 pixels times `scale`; a character outside of ASCII
    /// becomes a question mark.
    pub fn text(&mut self, x: usize, y: usize, scale: usize, text: &str, colour: Colour) {
        for (i, character) in text.chars().enumerate() {
            let left = x + i * CELL * scale;
            if left >= self.width {
                break;
            }
            let glyph = BASIC_LEGACY
                .get(character as usize)
                .or_else(|| BASIC_LEGACY.get(usize::from(b'?')));
            for (row, bits) in glyph.into_iter().flatten().enumerate() {
                // The lowest bit is the leftmost pixel.
                for column in (0..CELL).filter(|column| bits >> column & 1 == 1) {
                    let (dx, dy) = (column * scale, row * scale);
                    self.fill(left + dx, y + dy, scale, scale, colour);
                }
            }
        }
    }

    /// The picture as a PNG file, 8 bits per channel.
    ///
    /// # Errors
    /// A side above what PNG can hold (2^31 - 1).
    pub fn png(&self) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let side = |pixels: usize| {
            let side = u32::try_from(pixels).ok();
            side.ok_or(png::EncodingError::LimitsExceeded)
        };
        let encode = |bytes: &mut Vec<u8>| {
            let mut encoder = png::Encoder::new(bytes, side(self.width)?, side(self.height)?);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&self.rgb)?;
            writer.finish()
        };
        encode(&mut bytes).map_err(|error| {
            let size = format!("a picture of {} x {} pixels", self.width, self.height);
            Error::other(error)
                .of_kind(ErrorKind::CannotHold)
                .context(size)
        })?;
        Ok(bytes)
    }

    /// Writes [`Picture::png`] to `path`.
    ///
    /// # Errors
    /// I/O; the message names the file.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        event_files::output::write(path, self.png()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Colour = [255; 3];
    const BLACK: Colour = [0; 3];

    #[test]
    fn drawing_outside_is_cut_off() {
        let mut picture = Picture::new(4, 3, WHITE);
        picture.fill(3, 2, 100, 100, BLACK);
        picture.fill(4, 0, 1, 1, BLACK);
        picture.place(2, 0, &Picture::new(9, 1, BLACK));
        picture.place(9, 9, &Picture::new(9, 9, BLACK));
        picture.text(100, 100, 2, "text", BLACK);
        let black: Vec<_> = (0..12)
            .filter(|i| picture.pixel(i % 4, i / 4) == Some(BLACK))
            .collect();
        assert_eq!(black, [2, 3, 11]);
        assert_eq!((picture.pixel(4, 0), picture.pixel(0, 3)), (None, None));
    }

    #[test]
    fn characters_stand_upright_and_are_not_mirrored() {
        let mut picture = Picture::new(16, 16, WHITE);
        picture.text(0, 0, 2, "L", BLACK);
        let ink = |xs: std::ops::Range<usize>, ys: std::ops::Range<usize>| {
            ys.flat_map(|y| xs.clone().map(move |x| (x, y)))
                .filter(|(x, y)| picture.pixel(*x, *y) == Some(BLACK))
                .count()
        };
        assert!(ink(0..8, 0..8) > ink(8..16, 0..8));
        assert!(ink(0..16, 8..16) > ink(0..16, 0..8));
    }

    #[test]
    fn a_png_holds_the_pixels() {
        let mut picture = Picture::new(3, 2, WHITE);
        picture.fill(1, 1, 1, 1, [1, 2, 3]);
        let png = picture.png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(png))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (3, 2));
        assert_eq!(pixels, picture.rgb);
    }
}
