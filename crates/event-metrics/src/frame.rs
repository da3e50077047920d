//! Sparse frames: the signed sum of the polarities per pixel of a window.

use event_types::{Event, Polarity, Sensor};

/// Returns the sort key in which the per-pixel metrics need the events of a window: row, column, polarity, time.
#[must_use]
pub fn pixel_order(event: &Event) -> (u16, u16, Polarity, u64) {
    (event.y, event.x, event.polarity, event.t_us)
}

/// A pixel whose sum is not 0 in A, in B or in both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelPair {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Sum of the polarities of A's events, +1 for ON and -1 for OFF.
    pub a: i64,
    /// Sum of the polarities of B's events.
    pub b: i64,
}

/// Returns the frames of two windows as a list of their non-zero pixels, ordered by row, then column.
///
/// Both windows must be in [`pixel_order`].
#[must_use]
pub fn frame_pair(a: &[Event], b: &[Event]) -> Vec<PixelPair> {
    let position = |events: &[Event]| events.first().map(|e| (e.y, e.x));
    let (mut rest_a, mut rest_b) = (a, b);
    let mut pixels = Vec::new();
    while let Some((y, x)) = position(rest_a).into_iter().chain(position(rest_b)).min() {
        let pixel = PixelPair {
            x,
            y,
            a: take_sum(&mut rest_a, x, y),
            b: take_sum(&mut rest_b, x, y),
        };
        if pixel.a != 0 || pixel.b != 0 {
            pixels.push(pixel);
        }
    }
    pixels
}

/// Removes the events of pixel (x, y) from the front of `rest` and returns the sum of their polarities.
fn take_sum(rest: &mut &[Event], x: u16, y: u16) -> i64 {
    let mut sum = 0;
    while let Some((event, after)) = rest.split_first() {
        if (event.x, event.y) != (x, y) {
            break;
        }
        sum += i64::from(event.polarity.sign());
        *rest = after;
    }
    sum
}

/// Finds the largest |sum| in the frames of a stream; it holds one frame in memory.
#[derive(Debug, Clone)]
pub struct PeakFinder {
    sensor: Sensor,
    sums: Vec<i64>,
    peak: u64,
}

impl PeakFinder {
    /// Creates a finder for frames of the size of `sensor`.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        Self {
            sensor,
            sums: vec![0; sensor.pixels() as usize],
            peak: 0,
        }
    }

    /// Takes the frame of one window into account; its events may be in any order.
    pub fn add_window(&mut self, events: &[Event]) {
        for event in events {
            if let Some(sum) = self.sum_mut(event) {
                *sum += i64::from(event.polarity.sign());
            }
        }
        // Most of a frame is empty: read and clear only the pixels that were touched.
        for event in events {
            let sum = self.sum_mut(event).map_or(0, std::mem::take);
            self.peak = self.peak.max(sum.unsigned_abs());
        }
    }

    /// Returns the largest |sum| of all windows so far; 0 if the sums of all pixels cancel.
    #[must_use]
    pub fn peak(&self) -> u64 {
        self.peak
    }

    fn sum_mut(&mut self, event: &Event) -> Option<&mut i64> {
        let row = usize::from(event.y) * usize::from(self.sensor.width);
        self.sums.get_mut(row + usize::from(event.x))
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;

    #[test]
    fn sums_are_signed_and_zeros_are_left_out() {
        let a = [
            event(1, 2, 0, false),
            event(5, 2, 0, false),
            event(3, 1, 1, false),
            event(4, 1, 1, true),
        ];
        let b = [event(9, 0, 0, true), event(7, 2, 0, true)];
        let pixel = |x, y, a, b| PixelPair { x, y, a, b };
        assert_eq!(frame_pair(&a, &b), [pixel(0, 0, 0, 1), pixel(2, 0, -2, 1)]);
    }

    #[test]
    fn the_peak_is_per_window() {
        let mut peak = PeakFinder::new(SENSOR);
        let off = event(1, 3, 4, false);
        peak.add_window(&[off, event(1, 3, 5, true), off, off]);
        peak.add_window(&[off, off]);
        assert_eq!(peak.peak(), 3);
    }
}
