//! Reads the sensor's size that files state beside their events: two sides, or a pair in one value.
//!
//! In a pair the longer side is the width, whichever comes first: `event_utils` writes (height, width), others
//! write (width, height), and no known sensor is higher than wide. In a text with an `x`, such as Prophesee's
//! `1280x720`, the width comes first.

use event_types::Sensor;

const WIDTHS: [&str; 4] = ["width", "sensor_width", "image_width", "img_width"];
const HEIGHTS: [&str; 4] = ["height", "sensor_height", "image_height", "img_height"];
const PAIRS: [&str; 7] = [
    "sensor_resolution",
    "resolution",
    "geometry",
    "sensor_size",
    "image_size",
    "img_size",
    "sensor_shape",
];

/// Returns whether a name is one under which files state a size.
pub fn is_known(name: &str) -> bool {
    let all = WIDTHS.iter().chain(&HEIGHTS).chain(&PAIRS);
    all.into_iter()
        .any(|known| name.eq_ignore_ascii_case(known))
}

/// What has been found of the size so far.
#[derive(Debug, Clone, Copy, Default)]
pub struct StatedSize {
    width: Option<u16>,
    height: Option<u16>,
    pair: Option<Sensor>,
}

impl StatedSize {
    /// Adds the numbers stated under a name: a side, a pair, or three numbers as in tonic, the last of which counts
    /// the polarities. The first value found for each side or pair is kept.
    pub fn numbers(&mut self, name: &str, values: &[f64]) {
        let side = |value: &f64| {
            let is_side =
                value.fract() == 0.0 && (1.0..=f64::from(Sensor::SIDE_MAX)).contains(value);
            is_side.then_some(*value as u16)
        };
        let is = |known: &[&str]| known.iter().any(|known| name.eq_ignore_ascii_case(known));
        match values {
            [value] if is(&WIDTHS) => self.width = self.width.or(side(value)),
            [value] if is(&HEIGHTS) => self.height = self.height.or(side(value)),
            [first, second] | [first, second, _] if is(&PAIRS) => {
                let sides = side(first).zip(side(second));
                let sensor = sides.and_then(|(a, b)| Sensor::new(a.max(b), a.min(b)));
                self.pair = self.pair.or(sensor);
            }
            _ => {}
        }
    }

    /// Adds the text stated under a name.
    pub fn text(&mut self, name: &str, text: &str) {
        let parts = text.split(|letter: char| !letter.is_ascii_digit() && letter != '.');
        let numbers: Vec<f64> = parts.filter_map(|part| part.parse().ok()).collect();
        if let ([width, height], true) = (numbers.as_slice(), text.contains('x')) {
            let sides = [width, height].map(|side| *side as u16);
            self.pair = self.pair.or(Sensor::new(sides[0], sides[1]));
        } else {
            self.numbers(name, &numbers);
        }
    }

    /// Returns the size, if it was stated.
    pub fn sensor(&self) -> Option<Sensor> {
        let sides = self.width.zip(self.height);
        let sides = sides.and_then(|(width, height)| Sensor::new(width, height));
        sides.or(self.pair)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_every_spelling() {
        for (pairs, want) in [
            (&[("width", "346"), ("height", "260")][..], Some((346, 260))),
            (&[("sensor_resolution", "[260 346]")], Some((346, 260))),
            (&[("resolution", "(346, 260)")], Some((346, 260))),
            (&[("geometry", "1280x720")], Some((1280, 720))),
            (&[("geometry", "240x320")], Some((240, 320))),
            (&[("sensor_size", "(34, 34, 2)")], Some((34, 34))),
            (&[("width", "346")], None),
            (&[("width", "0"), ("height", "260")], None),
            (&[("resolution", "99999x5")], None),
            (&[("comment", "346x260")], None),
        ] {
            let mut size = StatedSize::default();
            for (name, text) in pairs {
                if is_known(name) {
                    size.text(name, text);
                }
            }
            let got = size.sensor().map(|sensor| (sensor.width, sensor.height));
            assert_eq!(got, want, "{pairs:?}");
        }
    }
}
