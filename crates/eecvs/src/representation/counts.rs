//! Numbers of events of time bins: stacked histograms.

use event_types::Polarity;
use event_types::stream::{EventReader, Result};

use super::{Divider, Span, each_block, planes};

/// A number of events in an array.
pub trait Cell: Copy {
    /// No event.
    const NONE: Self;

    /// Counts one event more, up to `most`.
    fn count(&mut self, most: u8);
}

impl Cell for u8 {
    const NONE: Self = 0;

    #[inline]
    fn count(&mut self, most: u8) {
        *self += Self::from(*self < most);
    }
}

impl Cell for f32 {
    const NONE: Self = 0.0;

    #[inline]
    fn count(&mut self, most: u8) {
        *self += if *self < Self::from(most) { 1.0 } else { 0.0 };
    }
}

/// A stacked histogram: numbers of ON and of OFF events of every pixel and time bin, up to a largest number.
///
/// ```text
/// N[p B + b, y, x] = min(most, events of polarity p with floor(B (t - t0) / T) = b), p = 0 for ON, 1 for OFF
/// ```
///
/// The histogram of Gehrig and Scaramuzza, *Recurrent Vision Transformers* (2023), is that of a closed span, with OFF
/// before ON.
#[derive(Debug, Clone, Copy)]
pub struct Counts {
    /// Times t0 to t0 + T.
    pub span: Span,
    /// Number of bins B; 0 is taken as 1.
    pub bins: u16,
    /// Largest number.
    pub most: u8,
}

impl Counts {
    /// Returns the number of channels, 2 B.
    #[must_use]
    pub fn channels(&self) -> usize {
        2 * usize::from(self.bins.max(1))
    }

    /// Writes the histogram of all events of `reader` to `cells`, C x H x W.
    ///
    /// # Errors
    /// Those of the reader; an event outside of the sensor or of the times; `cells` of another length.
    pub fn fill<T: Cell>(&self, reader: &mut dyn EventReader, cells: &mut [T]) -> Result<()> {
        let sensor = reader.sensor();
        let pixels = planes(sensor, self.channels(), cells.len())?;
        cells.fill(T::NONE);
        let (width, span, most) = (usize::from(sensor.width), self.span, self.most);
        let bins = u64::from(self.bins.max(1));
        let divider = Divider::new(span);
        let off = bins as usize * pixels;
        each_block(
            reader,
            |events, index| span.check(sensor, events, index),
            |events| {
                for event in events {
                    let pixel = usize::from(event.y) * width + usize::from(event.x);
                    let (bin, _) = divider.divide((event.t_us - span.start_us) * bins);
                    let bin = bin.min(bins - 1) as usize;
                    let first = if event.polarity == Polarity::On {
                        0
                    } else {
                        off
                    };
                    if let Some(cell) = cells.get_mut(first + bin * pixels + pixel) {
                        cell.count(most);
                    }
                }
            },
        )
    }
}
