//! Reads the pixels that are never sent from a text file.

use std::path::Path;

use eecvs_nostd::Sensor;
use event_types::ensure;
use event_types::stream::small_file::read_text;
use event_types::stream::{Context, Result};

/// Largest file accepted, in bytes.
const BYTES_MAX: u64 = 64 << 20;

/// Reads a file with lines `x,y` (or `x y`), where `#` begins a comment. Returns each pixel once, as (column, row),
/// in raster order.
///
/// # Errors
/// Fails if the file cannot be read or is too large, or if a line is not a pixel of the sensor.
pub fn read(path: &Path, sensor: Sensor) -> Result<Vec<(u16, u16)>> {
    let name = path.display();
    let text = read_text(path, BYTES_MAX).context("cannot read the hot pixels")?;
    let mut pixels = Vec::new();
    // Some editors put a byte-order mark in front.
    let text = text.trim_start_matches('\u{feff}');
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let pixel = pixel(line).with_context(|| {
            format!(
                "{name}: line {}: `{line}` is not a pixel: write x,y",
                number + 1
            )
        })?;
        let (x, y) = pixel;
        ensure!(
            sensor.contains(x, y),
            Damaged,
            "{name}: line {}: {x},{y} is outside the sensor of {} x {}",
            number + 1,
            sensor.width,
            sensor.height
        );
        pixels.push(pixel);
    }
    pixels.sort_unstable_by_key(|(x, y)| (*y, *x));
    pixels.dedup();
    Ok(pixels)
}

fn pixel(line: &str) -> Option<(u16, u16)> {
    let mut numbers = line.split([',', ' ', '\t']).filter(|part| !part.is_empty());
    let pixel = (numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?);
    numbers.next().is_none().then_some(pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Vec<(u16, u16)>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read(file.path(), Sensor::new(40, 3).unwrap())
    }

    #[test]
    fn pixels_come_once_in_raster_order() {
        let pixels = of("# hot\n33, 2 # east\n0,0\n\n31\t1\n33 2\n").unwrap();
        assert_eq!(pixels, [(0, 0), (31, 1), (33, 2)]);
        assert_eq!(of("\u{feff}1,2\r\n3,1\r\n").unwrap(), [(3, 1), (1, 2)]);
    }

    #[test]
    fn what_is_no_pixel_is_refused_with_its_line() {
        for (text, told) in [
            ("1,1\n40,0", "line 2: 40,0 is outside"),
            ("0,3", "line 1: 0,3 is outside"),
            ("1", "line 1: `1` is not"),
            ("1,2,3", "is not a pixel"),
            ("-1,2", "is not a pixel"),
        ] {
            let error = format!("{:#}", of(text).unwrap_err());
            assert!(error.contains(told), "{error}");
        }
    }
}
