//! Planes of a window's kept coefficients, in basis order.

use event_types::stream::Result;

use super::super::DecodedWindow;

/// A window whose pixels are coefficients.
#[derive(Debug)]
pub(super) struct Coefficients(DecodedWindow);

impl Coefficients {
    /// Takes the coefficients of `window`'s frames or, if events were sent, those that the encoder would have sent
    /// for them.
    pub fn new(window: &DecodedWindow) -> Result<Self> {
        Ok(Self(window.with_pixels()?))
    }

    /// Writes channel `channel` into a plane of zeros. For a real transform this is coefficient k = `channel`; for
    /// a complex one it is re of c_(channel / 2), or im for odd channels. c_0 is ON minus OFF, whether it was kept
    /// or not.
    pub fn plane(&self, channel: usize, plane: &mut [f32]) {
        let window = &self.0;
        let width = usize::from(window.header.sensor.width);
        let (k, imaginary) = if window.header.transform.is_complex() {
            (channel / 2, channel % 2 == 1)
        } else {
            (channel, false)
        };
        for pixel in &window.pixels {
            let value = if k == 0 {
                if imaginary { 0.0 } else { pixel.net() }
            } else {
                let entries = &pixel.coefficients;
                let found = entries.binary_search_by_key(&k, |entry| usize::from(entry.0));
                let entry = found.ok().and_then(|at| entries.get(at));
                entry.map_or(0.0, |(_, re, im)| if imaginary { *im } else { *re })
            };
            let at = usize::from(pixel.y) * width + usize::from(pixel.x);
            if let Some(slot) = plane.get_mut(at) {
                *slot = value as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{Pixel, test_header};
    use super::*;

    #[test]
    fn planes_hold_re_and_im_in_turn() {
        let window = DecodedWindow {
            header: test_header::header(1000),
            pixels: vec![Pixel {
                x: 2,
                y: 3,
                on: 3,
                off: 1,
                // c_0 was pruned, but the counts give it.
                coefficients: vec![(5, 0.25, -0.75)],
                times: vec![],
            }],
            events: vec![],
        };
        let coefficients = Coefficients::new(&window).unwrap();
        for (channel, expected) in [(0, 2.0), (1, 0.0), (9, 0.0), (10, 0.25), (11, -0.75)] {
            let mut plane = [0.0; 32];
            coefficients.plane(channel, &mut plane);
            let mut only = [0.0; 32];
            only[3 * 8 + 2] = expected;
            assert_eq!(plane, only, "channel {channel}");
        }
    }
}
