//! Voxel grids: sums of polarities, or of bilinear weights, of time bins.

use event_types::Polarity;
use event_types::stream::{EventReader, Result};

use super::{Divider, Span, each_block, planes};
use crate::reconstruct::volume::Weights;

/// A voxel grid.
///
/// ```text
/// nearest:  V[b, y, x] = sum of p over the pixel's events with floor(B (t - t0) / T) = b
/// bilinear: V[b, y, x] = sum of p max(0, 1 - |b - tau|), tau = (B - 1) (t - t0) / T
/// ```
///
/// The bilinear weights are those of Zhu et al. (2019). The last time of a closed span is in the last bin.
#[derive(Debug, Clone, Copy)]
pub struct Voxel {
    /// Times t0 to t0 + T.
    pub span: Span,
    /// Number of bins B; 0 is taken as 1.
    pub bins: u16,
    /// How an event is distributed over the bins.
    pub weights: Weights,
    /// Whether polarities are separate: B channels of ON, followed by B of OFF events, both counted as positive.
    pub split: bool,
}

impl Voxel {
    /// Returns the number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        usize::from(self.bins.max(1)) * if self.split { 2 } else { 1 }
    }

    /// Writes the grid of all events of `reader` to `cells`, C x H x W.
    ///
    /// # Errors
    /// Those of the reader; an event outside of the sensor or of the times; `cells` of another length.
    pub fn fill(&self, reader: &mut dyn EventReader, cells: &mut [f32]) -> Result<()> {
        let sensor = reader.sensor();
        let pixels = planes(sensor, self.channels(), cells.len())?;
        cells.fill(0.0);
        let (width, span) = (usize::from(sensor.width), self.span);
        let bins = u64::from(self.bins.max(1));
        let divider = Divider::new(span);
        let scale = 1.0 / span.duration_us as f64;
        // Where the channels of OFF begin, and what an OFF event counts.
        let (off, minus) = if self.split {
            (bins as usize * pixels, 1.0)
        } else {
            (0, -1.0)
        };
        each_block(
            reader,
            |events, index| span.check(sensor, events, index),
            |events| {
                for event in events {
                    let pixel = usize::from(event.y) * width + usize::from(event.x);
                    let since_us = event.t_us - span.start_us;
                    let (first, value) = match event.polarity {
                        Polarity::On => (pixel, 1.0),
                        Polarity::Off => (pixel + off, minus),
                    };
                    match self.weights {
                        Weights::Nearest => {
                            let (bin, _) = divider.divide(since_us * bins);
                            let bin = bin.min(bins - 1) as usize;
                            if let Some(cell) = cells.get_mut(first + bin * pixels) {
                                *cell += value;
                            }
                        }
                        Weights::Bilinear => {
                            let (bin, rest) = divider.divide(since_us * (bins - 1));
                            let share = (rest as f64 * scale) as f32;
                            let at = first + bin as usize * pixels;
                            if let Some(cell) = cells.get_mut(at) {
                                *cell += value * (1.0 - share);
                            }
                            // There is no next bin behind the last one, where nothing is left.
                            if rest > 0
                                && let Some(cell) = cells.get_mut(at + pixels)
                            {
                                *cell += value * share;
                            }
                        }
                    }
                }
            },
        )
    }
}
