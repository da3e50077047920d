//! How the pixels of frames of coefficients were sent, and what that took.

use eecvs_nostd::coder::range::InputLeft;
use eecvs_nostd::{Coded, Frame, Mode};
use serde::Serialize;

use super::coefficients::CoefficientDecoder;
use super::hybrid::Refused;

/// Pixels that were sent in one way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Way {
    /// Number of pixels.
    pub pixels: u64,
    /// Bits of the payload that they take, positions and counts included.
    pub bits: f64,
}

/// Pixels and bits of frames of coefficients, by the way in which a pixel was sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Ways {
    /// Pixels of one event, sent as the cell of its time.
    pub single: Way,
    /// Pixels of few events, sent as the cells of their times.
    pub times: Way,
    /// Pixels sent as coefficients.
    pub coefficients: Way,
}

impl Way {
    fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.bits += other.bits;
    }
}

impl Ways {
    /// Adds those of another frame.
    pub fn add(&mut self, other: &Self) {
        self.single.add(&other.single);
        self.times.add(&other.times);
        self.coefficients.add(&other.coefficients);
    }

    /// Returns the ways of a frame's pixels; `None` for a frame of events. Frames of a dense coder need those before
    /// them: give `decoder` every frame of a stream, in order.
    ///
    /// # Errors
    /// [`Refused`] if the frame does not decode.
    pub fn of(
        frame: &Frame<'_>,
        decoder: &mut CoefficientDecoder,
    ) -> Result<Option<Self>, Refused> {
        let mut ways = Self::default();
        let mut left = frame.payload.len() as f64 * 8.0;
        let mut count = |coded: &Coded, after: InputLeft| {
            let way = match coded {
                Coded::Cell(_) => &mut ways.single,
                Coded::Times(_) => &mut ways.times,
                Coded::Levels(_) => &mut ways.coefficients,
            };
            way.pixels += 1;
            let bits_left = after.count();
            way.bits += left - bits_left;
            left = bits_left;
        };
        match frame.header.mode {
            Mode::Hybrid(_) => return Ok(None),
            Mode::Coefficients(coder) => {
                decoder.descriptors_and_left(frame, coder, |descriptor, left| {
                    count(&descriptor.coded, left);
                })?;
            }
            Mode::Transform => {
                let mut descriptors = frame.descriptors();
                while let Some(descriptor) = descriptors.next() {
                    let descriptor = descriptor.map_err(|_| Refused::Malformed)?;
                    count(&descriptor.coded, InputLeft::bits(descriptors.bits_left()));
                }
            }
        }
        Ok(Some(ways))
    }
}
