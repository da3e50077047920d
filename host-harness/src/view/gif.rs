//! Writes frames as an animated GIF, with the style's colours as palette; each frame stores only what changed.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use event_files::output::OutputFile;
use event_pictures::picture::{Colour, Picture};
use gif::{DisposalMethod, Encoder, EncodingError, Repeat};

use super::frames::Frame;
use super::picture::{Look, picture};
use super::{Screen, Wish};

/// Largest frame rate; browsers show a GIF with shorter delays ten times too slowly.
pub const FPS_MAX: u32 = 50;

/// A GIF file that is being written; it is created with its first frame.
pub struct Gif {
    path: PathBuf,
    look: Look,
    fps: u32,
    colours: Colours,
    frames: u64,
    /// Palette indices of the previous frame's pixels.
    last: Vec<u8>,
    encoder: Option<Encoder<OutputFile>>,
}

/// The palette and the index of each of its colours.
struct Colours {
    palette: Vec<Colour>,
    numbers: HashMap<Colour, u8>,
}

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Part {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl Gif {
    /// Prepares to write `path` at `fps` frames per second, limited to [`FPS_MAX`], repeated endlessly.
    #[must_use]
    pub fn new(path: &Path, fps: u32, look: Look) -> Self {
        Self {
            path: path.to_owned(),
            look,
            fps: fps.clamp(1, FPS_MAX),
            colours: Colours::new(look.style.palette()),
            frames: 0,
            last: Vec::new(),
            encoder: None,
        }
    }

    /// Returns the delay of a frame in hundredths of a second; rounding errors do not accumulate.
    fn delay(&self, frame: u64) -> u16 {
        let end = |frame: u64| frame.saturating_mul(100) / u64::from(self.fps);
        (end(frame.saturating_add(1)) - end(frame)) as u16
    }

    fn open(&self, width: u16, height: u16) -> Result<Encoder<OutputFile>> {
        let file = OutputFile::create(&self.path)?;
        let palette = self.colours.palette.concat();
        let mut encoder =
            Encoder::new(file, width, height, &palette).map_err(|error| self.named(error))?;
        encoder
            .set_repeat(Repeat::Infinite)
            .map_err(|error| self.named(error))?;
        Ok(encoder)
    }

    fn write(&mut self, picture: &Picture) -> Result<()> {
        let too_large = || {
            format!(
                "{}: {}x{} pixels are too many for a GIF: give a smaller --upscale",
                self.path.display(),
                picture.width(),
                picture.height()
            )
        };
        let side = |side: usize| u16::try_from(side).with_context(too_large);
        let (width, height) = (side(picture.width())?, side(picture.height())?);
        let pixels = self.colours.numbers(picture);
        let part = changed(&self.last, &pixels, picture.width()).unwrap_or(Part {
            left: 0,
            top: 0,
            width: 1,
            height: 1,
        });
        let rows = pixels.chunks(picture.width());
        let rows = rows.skip(part.top).take(part.height);
        let inside = rows.flat_map(|row| row.get(part.left..part.left + part.width));
        let frame = gif::Frame {
            delay: self.delay(self.frames),
            dispose: DisposalMethod::Keep,
            // The sides of a part are no larger than the picture's, which fit a u16.
            left: part.left as u16,
            top: part.top as u16,
            width: part.width as u16,
            height: part.height as u16,
            buffer: inside.flatten().copied().collect::<Vec<u8>>().into(),
            ..gif::Frame::default()
        };
        let mut encoder = match self.encoder.take() {
            Some(encoder) => encoder,
            None => self.open(width, height)?,
        };
        encoder
            .write_frame(&frame)
            .map_err(|error| self.named(error))?;
        self.encoder = Some(encoder);
        self.last = pixels;
        self.frames += 1;
        Ok(())
    }

    fn named(&self, error: EncodingError) -> anyhow::Error {
        match error {
            // This error names the file already.
            EncodingError::Io(error) => error.into(),
            error => anyhow::Error::new(error).context(self.path.display().to_string()),
        }
    }
}

impl Screen for Gif {
    fn show(&mut self, frame: &Frame) -> Result<Wish> {
        self.write(&picture(frame, self.look))?;
        Ok(Wish::Next)
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        let Some(encoder) = self.encoder.take() else {
            return Ok(());
        };
        let file = encoder.into_inner().map_err(|error| self.named(error))?;
        Ok(file.finish()?)
    }
}

impl Colours {
    /// Uses the first 256 colours of the palette.
    fn new(mut palette: Vec<Colour>) -> Self {
        palette.truncate(256);
        let numbered = palette.iter().zip(0..=u8::MAX);
        Self {
            numbers: numbered.map(|(colour, number)| (*colour, number)).collect(),
            palette,
        }
    }

    /// Returns the palette index of every pixel: of its own colour, or else of the nearest.
    fn numbers(&self, picture: &Picture) -> Vec<u8> {
        let mut known = (Colour::default(), self.number(Colour::default()));
        let pixels = picture.pixels().map(|colour| {
            // Most pixels have the colour of their left neighbour.
            if colour != known.0 {
                known = (colour, self.number(colour));
            }
            known.1
        });
        pixels.collect()
    }

    fn number(&self, colour: Colour) -> u8 {
        let distance = |other: &Colour| {
            let parts = colour.iter().zip(other);
            parts.map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>()
        };
        let nearest = || {
            let numbered = self.palette.iter().zip(0..=u8::MAX);
            numbered.min_by_key(|(other, _)| distance(other))
        };
        match self.numbers.get(&colour) {
            Some(number) => *number,
            None => nearest().map_or(0, |(_, number)| number),
        }
    }
}

/// Returns the smallest rectangle that holds every difference; the whole picture if there is none before, `None` if
/// both are equal.
fn changed(before: &[u8], now: &[u8], width: usize) -> Option<Part> {
    let width = width.max(1);
    if before.len() != now.len() {
        return Some(Part {
            left: 0,
            top: 0,
            width,
            height: now.len() / width,
        });
    }
    let mut found: Option<(usize, usize, usize, usize)> = None;
    for (y, (old, new)) in before.chunks(width).zip(now.chunks(width)).enumerate() {
        let differs = |(old, new): (&u8, &u8)| old != new;
        let Some(first) = old.iter().zip(new).position(differs) else {
            continue;
        };
        let last = old.iter().zip(new).rposition(differs).unwrap_or(first);
        let (left, right, top, _) = found.unwrap_or((first, last, y, y));
        found = Some((left.min(first), right.max(last), top, y));
    }
    let (left, right, top, bottom) = found?;
    Some(Part {
        left,
        top,
        width: right - left + 1,
        height: bottom - top + 1,
    })
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::*;
    use crate::view::picture::tests::{LOOK, frame};

    /// Decodes every frame as it is displayed, with its delay.
    fn decoded(path: &Path) -> Vec<(Vec<Colour>, u16)> {
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(File::open(path).unwrap()).unwrap();
        let width = usize::from(decoder.width());
        let mut screen = vec![[0; 3]; width * usize::from(decoder.height())];
        let mut frames = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            for (i, rgba) in frame.buffer.chunks(4).enumerate() {
                let x = usize::from(frame.left) + i % usize::from(frame.width);
                let y = usize::from(frame.top) + i / usize::from(frame.width);
                screen[y * width + x] = [rgba[0], rgba[1], rgba[2]];
            }
            frames.push((screen.clone(), frame.delay));
        }
        frames
    }

    #[test]
    fn the_gif_shows_every_frame_with_its_pixels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let mut screen = Box::new(Gif::new(&path, 30, LOOK));
        let frames: Vec<_> = [
            (Some((7, 2)), (3, 2)),
            (Some((7, 2)), (3, 2)),
            (Some((39, 29)), (0, 0)),
            (None, (12, 13)),
        ]
        .map(|(decoded, original)| frame(original, Some(decoded.unwrap_or((1, 1)))))
        .into();
        for frame in &frames {
            screen.show(frame).unwrap();
        }
        screen.finish().unwrap();
        let shown = decoded(&path);
        assert_eq!(shown.len(), frames.len());
        for ((pixels, _), frame) in shown.iter().zip(&frames) {
            let expected: Vec<_> = picture(frame, LOOK).pixels().collect();
            assert!(*pixels == expected);
        }
        // A thirtieth of a second is not a whole number of hundredths.
        let delays: Vec<_> = shown.iter().map(|(_, delay)| *delay).collect();
        assert_eq!(delays, [3, 3, 4, 3]);
    }

    #[test]
    fn without_an_end_there_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let mut screen = Gif::new(&path, 30, LOOK);
        screen.show(&frame((1, 1), None)).unwrap();
        drop(screen);
        assert!(!path.exists());
        let nowhere = folder.path().join("none").join("a.gif");
        let error = Gif::new(&nowhere, 30, LOOK)
            .show(&frame((1, 1), None))
            .unwrap_err();
        assert!(error.to_string().contains("a.gif"), "{error}");
    }

    #[test]
    fn only_what_changed_is_written() {
        let before = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        let mut now = before;
        assert_eq!(changed(&before, &now, 4), None);
        now[2] = 1;
        now[9] = 1;
        let part = Part {
            left: 1,
            top: 0,
            width: 2,
            height: 3,
        };
        assert_eq!(changed(&before, &now, 4), Some(part));
        let whole = changed(&[], &now, 4).unwrap();
        assert_eq!((whole.width, whole.height), (4, 3));
    }

    #[test]
    fn colours_outside_of_the_palette_become_near_ones() {
        let colours = Colours::new(vec![[0, 0, 0], [200, 200, 200]]);
        assert_eq!(colours.number([200, 200, 200]), 1);
        assert_eq!(colours.number([150, 220, 180]), 1);
        assert_eq!(colours.number([10, 0, 90]), 0);
    }
}
