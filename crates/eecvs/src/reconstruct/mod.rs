//! Reconstructs coefficients, volumes and events from descriptors.

pub mod arrival;
pub mod bins;
pub mod coefficients;
pub mod cost;
pub mod crowd;
pub mod ensemble;
pub mod equations;
pub mod events;
pub mod guide;
pub mod hybrid;
mod lanes;
pub mod lattice;
mod normal;
pub mod order;
pub mod prony;
pub mod pursuit;
pub mod recover;
pub mod refine;
pub mod spread;
#[cfg(test)]
mod test_header;
#[cfg(test)]
mod test_pixel;
pub mod volume;
pub mod ways;
#[cfg(test)]
mod worst_windows;

use eecvs_nostd::{Descriptor, Event, Frame, Header, Polarity, UnpackError};

/// Dequantised coefficients of one pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Pixel {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Number of ON events.
    pub on: u32,
    /// Number of OFF events.
    pub off: u32,
    /// (k, re, im) of the kept coefficients, in ascending order of k.
    pub coefficients: Vec<(u16, f64, f64)>,
    /// Normalised time u and polarity of each event, where the frame sends times: of a single event, and of the few
    /// events of a pixel that is sent as times. Otherwise empty.
    pub times: Vec<(f64, Polarity)>,
}

impl Pixel {
    /// Returns c_0, the number of ON events minus the number of OFF events.
    #[must_use]
    pub fn net(&self) -> f64 {
        f64::from(self.on) - f64::from(self.off)
    }

    /// Dequantises a descriptor; c_0 = on - off is exact, not rounded to a step.
    #[must_use]
    pub fn dequantise(header: &Header, descriptor: &Descriptor) -> Self {
        let packing = header.packing();
        let mut coefficients = Vec::with_capacity(packing.kept());
        descriptor.dequantise(&packing, |k, re, im| coefficients.push((k, re, im)));
        let mut times = Vec::new();
        descriptor.times(&packing, |u, is_on| {
            times.push((u, Polarity::from_bool(is_on)));
        });
        Self {
            x: descriptor.x,
            y: descriptor.y,
            on: descriptor.on,
            off: descriptor.off,
            coefficients,
            times,
        }
    }
}

/// Decodes all pixels of a frame with plain descriptors.
///
/// # Errors
/// [`UnpackError`] if the payload contradicts its header; no pixel of the frame is returned then.
pub fn pixels(frame: &Frame<'_>) -> Result<Vec<Pixel>, UnpackError> {
    frame
        .descriptors()
        .map(|descriptor| Ok(Pixel::dequantise(&frame.header, &descriptor?)))
        .collect()
}

/// A window assembled from its frames.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedWindow {
    /// Header of the first of its frames that arrived.
    pub header: Header,
    /// Pixels of all its frames that arrived, in raster order within each frame; empty in mode `hybrid`.
    pub pixels: Vec<Pixel>,
    /// Events, in mode `hybrid` only: in raster order within each frame, or in the order of time if the keys coder
    /// coded them, or of time and arrival if the frames send that order.
    pub events: Vec<Event>,
}

impl DecodedWindow {
    /// Returns whether a frame with this header belongs to this window.
    #[must_use]
    pub fn has_part(&self, header: &Header) -> bool {
        same_window(&self.header, header)
    }

    /// Returns the number of channels of the window's coefficient volume: K, or 2K for complex coefficients.
    #[must_use]
    pub fn channels(&self) -> usize {
        let grid = usize::from(self.header.grid);
        if self.header.transform.is_complex() {
            2 * grid
        } else {
            grid
        }
    }
}

/// Returns whether the frame of `header` belongs to the same window as `earlier`, a frame before it.
#[must_use]
pub fn same_window(earlier: &Header, header: &Header) -> bool {
    let window = |h: &Header| (h.t0_us, h.duration_us, h.packing());
    // Parts count up from 0, which separates windows that share a start.
    window(earlier) == window(header) && header.part > 0
}

/// Returns the scale 2^(j/2) of Haar coefficient k = 2^j + m, and its support [start, end) in units of u.
pub(crate) fn haar_support(k: u16) -> (f64, f64, f64) {
    if k == 0 {
        return (1.0, 0.0, 1.0);
    }
    let scale = k.ilog2();
    let width = 0.5_f64.powi(scale as i32);
    let start = f64::from(k - (1 << scale)) * width;
    ((1.0 / width).sqrt(), start, start + width)
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Coded, Level, Transform};

    use super::*;

    #[test]
    fn c_0_is_the_counts_whatever_the_step() {
        for transform in Transform::ALL {
            let header = Header {
                transform,
                ..test_header::header(1000)
            };
            let levels = [(0, 11), (4, 2)].map(|(k, re)| Level { k, re, im: 0 });
            let descriptor = Descriptor {
                on: 13,
                off: 2,
                coded: Coded::Levels(levels.into_iter().collect()),
                ..Descriptor::EMPTY
            };
            // Middles of the step from 16 to 24 and of the step from 0 to 8. For the Haar transform, 2 steps of the
            // scale of k = 4 are 2 * 4 * 2.
            let expected = match transform {
                Transform::Dct => (4, 20.0, 0.0),
                Transform::Dtft => (4, 20.0, 4.0),
                Transform::Dwt => (4, 16.0, 0.0),
            };
            let pixel = Pixel::dequantise(&header, &descriptor);
            assert_eq!(pixel.coefficients, [(0, 11.0, 0.0), expected]);
        }
    }
}
