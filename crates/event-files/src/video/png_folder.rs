//! A folder of PNG files, one per frame.
//!
//! Frames are in the order of their names, in which runs of digits count as numbers: `frame_9.png` is before
//! `frame_10.png`. Files of other endings are left alone. Of colours, the luma of BT.709 is taken: 0.2126 R + 0.7152 G +
//! 0.0722 B of the numbers in the file. Transparent pixels are refused.

use std::cmp::Ordering;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Error, Response, Result};
use event_types::{Sensor, ensure, error};
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};

use super::{Frames, Taken, size_of};

/// Largest number of files, whose names are in memory: 11 hours at 250 per second.
const FILES_MAX: usize = 10_000_000;

/// Memory that a PNG file may ask for beyond its pixels, in bytes.
const DECODER_BYTES: usize = 1 << 26;

/// Weights of red, green and blue in the luma of BT.709.
const LUMA: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// A reader of PNG files.
pub(super) struct PngFolder {
    folder: PathBuf,
    names: Vec<PathBuf>,
    sensor: Sensor,
    white: Option<f64>,
    /// Number of the next frame.
    next: usize,
    pixels: Vec<u8>,
}

impl PngFolder {
    /// Lists a folder, and reads the size of its first frame.
    pub(super) fn open(folder: &Path, white: Option<f64>) -> Result<Self> {
        let name = folder.display();
        let failed = || format!("{name}: cannot be read");
        let mut names = Vec::new();
        for entry in std::fs::read_dir(folder).with_context(failed)? {
            let file = PathBuf::from(entry.with_context(failed)?.file_name());
            let ending = file.extension().and_then(|ending| ending.to_str());
            if ending.is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
                ensure!(
                    names.len() < FILES_MAX,
                    Refused,
                    "{name}: more than {FILES_MAX} PNG files: give them in several folders"
                );
                names.push(file);
            }
        }
        let key = |path: &PathBuf| path.to_string_lossy().into_owned();
        names.sort_by(|a, b| natural(&key(a), &key(b)));
        let Some(first) = names.first() else {
            return Err(error!(
                Refused,
                "{name}: holds no PNG files: give a folder of frames"
            ));
        };
        let path = folder.join(first);
        let reader = begin(&path)?;
        let info = reader.info();
        let sensor = size_of(info.width.into(), info.height.into());
        let sensor = sensor.map_err(|what| damaged(&path, &what))?;
        Ok(Self {
            folder: folder.to_owned(),
            names,
            sensor,
            white,
            next: 0,
            pixels: Vec::new(),
        })
    }

    fn path(&self, number: usize) -> Option<PathBuf> {
        Some(self.folder.join(self.names.get(number)?))
    }
}

/// Compares names, in which runs of digits count as numbers.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a, b);
    loop {
        let digits =
            |text: &str| text.len() - text.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        match (digits(a), digits(b)) {
            (n, m) if n > 0 && m > 0 => {
                let ((x, a_rest), (y, b_rest)) = (a.split_at(n), b.split_at(m));
                let (p, q) = (x.trim_start_matches('0'), y.trim_start_matches('0'));
                let order = p
                    .len()
                    .cmp(&q.len())
                    .then_with(|| p.cmp(q))
                    .then_with(|| x.len().cmp(&y.len()));
                if order != Ordering::Equal {
                    return order;
                }
                (a, b) = (a_rest, b_rest);
            }
            _ => {
                let (mut left, mut right) = (a.chars(), b.chars());
                match (left.next(), right.next()) {
                    (None, None) => return Ordering::Equal,
                    (x, y) if x != y => return x.cmp(&y),
                    _ => (a, b) = (left.as_str(), right.as_str()),
                }
            }
        }
    }
}

fn damaged(path: &Path, what: &str) -> Error {
    error!(Damaged, "{}: {what}", path.display())
}

/// Reads a file up to its pixels, which are no more than a sensor may have.
fn begin(path: &Path) -> Result<png::Reader<BufReader<File>>> {
    let name = path.display();
    let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
    let limits = Limits {
        bytes: DECODER_BYTES,
    };
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), limits);
    decoder.set_transformations(Transformations::EXPAND);
    let info = decoder.read_header_info();
    let info = info.with_context(|| undecoded(path))?;
    size_of(info.width.into(), info.height.into()).map_err(|what| damaged(path, &what))?;
    decoder.read_info().with_context(|| undecoded(path))
}

/// Returns what is said of a file that cannot be decoded; the cause follows.
fn undecoded(path: &Path) -> String {
    format!("{}: the PNG file is damaged or cut", path.display())
}

impl Frames for PngFolder {
    fn format(&self) -> &'static str {
        "png"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn response(&self) -> Response {
        Response::Srgb
    }

    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>> {
        let Some(path) = self.path(self.next) else {
            return Ok(None);
        };
        let mut reader = begin(&path)?;
        let Sensor { width, height } = self.sensor;
        let size = (reader.info().width, reader.info().height);
        if size != (width.into(), height.into()) {
            let what = format!(
                "a frame of {} x {} pixels, the first one has {width} x {height}: give frames of one size",
                size.0, size.1
            );
            return Err(damaged(&path, &what));
        }
        // At most 2,048 x 2,048 pixels of 8 bytes.
        let bytes = reader.output_buffer_size().unwrap_or(usize::MAX);
        if bytes > 8 * self.sensor.pixels() as usize {
            return Err(damaged(
                &path,
                "its pixels take more than 8 bytes each: damaged",
            ));
        }
        self.pixels.resize(bytes, 0);
        let info = reader.next_frame(&mut self.pixels);
        let info = info.with_context(|| undecoded(&path))?;
        reader.finish().with_context(|| undecoded(&path))?;
        let pixels = self.pixels.get(..info.buffer_size()).unwrap_or_default();
        let taken = luma(pixels, info.color_type, info.bit_depth, self.white, values);
        taken.map_err(|what| damaged(&path, what))?;
        self.next += 1;
        Ok(Some(Taken { t_us: None }))
    }

    fn place(&self) -> String {
        let latest = self.path(self.next.saturating_sub(1));
        latest.unwrap_or_default().display().to_string()
    }
}

/// Replaces `values` by the luma of decoded pixels, white being 1.
fn luma(
    pixels: &[u8],
    color: ColorType,
    depth: BitDepth,
    white: Option<f64>,
    values: &mut Vec<f32>,
) -> Result<(), &'static str> {
    let wide = depth == BitDepth::Sixteen;
    let most = if wide { 65_535.0 } else { 255.0 };
    let scale = (1.0 / white.unwrap_or(most)) as f32;
    let bytes = if wide { 2 } else { 1 };
    // 16 bits have the high byte first.
    let number = |sample: &[u8]| match sample {
        [high, low] => f32::from(u16::from_be_bytes([*high, *low])),
        [byte] => f32::from(*byte),
        _ => 0.0,
    };
    let (colors, has_alpha) = match color {
        ColorType::Grayscale => (1, false),
        ColorType::GrayscaleAlpha => (1, true),
        ColorType::Rgb => (3, false),
        ColorType::Rgba => (3, true),
        // Palettes are expanded.
        ColorType::Indexed => return Err("a palette that cannot be expanded: damaged"),
    };
    let samples = colors + usize::from(has_alpha);
    values.clear();
    for pixel in pixels.chunks_exact(samples * bytes) {
        let mut parts = pixel.chunks_exact(bytes).map(number);
        values.push(match colors {
            1 => parts.next().unwrap_or(0.0) * scale,
            _ => {
                LUMA.iter()
                    .zip(parts.by_ref())
                    .map(|(weight, part)| weight * part)
                    .sum::<f32>()
                    * scale
            }
        });
        if has_alpha && parts.next() != Some(most as f32) {
            return Err("has transparent pixels: give opaque frames");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = [
            "f10.png", "f9.png", "f09.png", "f1b.png", "f1a.png", "e99.png", "f.png",
        ];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(
            names,
            [
                "e99.png", "f.png", "f1a.png", "f1b.png", "f9.png", "f09.png", "f10.png"
            ]
        );
    }
}
