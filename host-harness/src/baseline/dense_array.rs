//! Dense arrays, which all representations produce: one array, stored as one file, per window that has events.
//!
//! In memory an array omits the pixels that hold nothing.

use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::{Event, Sensor};

use super::stored::{Quantiser, Range, Stored};

/// Bytes of the header of an `.npy` file, which every array has.
pub const HEADER_BYTES: usize = 128;

/// A window that has events.
#[derive(Debug, Clone, Copy)]
pub struct Window<'e> {
    /// Index of the window on the recording's grid.
    pub number: u64,
    /// Start of the window, in us.
    pub start_us: u64,
    /// Events of the window, in order of time.
    pub events: &'e [Event],
}

impl Window<'_> {
    /// Returns the time since the window's start, in us, limited to 0 .. T - 1.
    #[must_use]
    pub fn since_us(&self, t_us: u64) -> u32 {
        let since_us = t_us.saturating_sub(self.start_us);
        since_us.min(u64::from(WINDOW_US - 1)) as u32
    }

    /// Returns the age at the window's end of an event in the window or before it, in us; at least 1.
    #[must_use]
    pub fn age_us(&self, t_us: u64) -> u64 {
        match self.start_us.checked_sub(t_us) {
            Some(before_us) => before_us.saturating_add(WINDOW_US.into()),
            None => u64::from(WINDOW_US - self.since_us(t_us)),
        }
    }

    /// Returns the time `since_us` after the window's start; saturates at `u64::MAX`.
    #[must_use]
    pub fn time_us(&self, since_us: u32) -> u64 {
        self.start_us.saturating_add(since_us.into())
    }
}

/// Returns the windows of a recording that have events, on a grid that starts at its first event.
pub fn windows(source: &Source) -> impl Iterator<Item = Window<'_>> {
    let (start_us, window_us) = (source.start_us(), u64::from(WINDOW_US));
    let number = move |event: &Event| event.t_us.saturating_sub(start_us) / window_us;
    let chunks = source.events.chunk_by(move |a, b| number(a) == number(b));
    chunks.map(move |events| {
        let number = events.first().map_or(0, number);
        Window {
            number,
            start_us: start_us + number * window_us,
            events,
        }
    })
}

/// Returns the bytes of a window's `.npy` file with `channels` values of `value_bytes` for every pixel.
#[must_use]
pub fn bytes(source: &Source, channels: usize, value_bytes: usize) -> usize {
    HEADER_BYTES + source.sensor.pixels() as usize * channels * value_bytes
}

/// The numbers of a window's active pixels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Array {
    /// Indices of the pixels in raster order, ascending.
    pub pixels: Vec<u32>,
    /// Numbers pixel by pixel, the same count for each.
    pub values: Vec<f64>,
}

impl Array {
    /// Quantises the numbers to a stored type.
    #[must_use]
    pub fn stored(self, range: Range, stored: Stored) -> StoredArray {
        let values = self.values.iter();
        let largest = values.fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let quantiser = Quantiser::new(range, stored, largest);
        StoredArray {
            pixels: self.pixels,
            codes: self.values.iter().map(|v| quantiser.code(*v)).collect(),
            quantiser,
        }
    }
}

/// The numbers of a window's active pixels as they are stored.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredArray {
    /// Indices of the pixels in raster order, ascending.
    pub pixels: Vec<u32>,
    /// Bits of the numbers pixel by pixel, the same count for each.
    pub codes: Vec<u32>,
    /// Quantiser that made the bits and reads them.
    pub quantiser: Quantiser,
}

/// Finds the pixels that have events, without sorting.
#[derive(Debug, Clone)]
pub struct Active {
    sensor: Sensor,
    /// One bit per pixel.
    bits: Vec<u64>,
    /// Rank of each pixel among the active pixels of the latest window.
    ranks: Vec<u32>,
}

impl Active {
    /// Makes a finder for a sensor.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        let pixels = sensor.pixels() as usize;
        Self {
            sensor,
            bits: vec![0; pixels.div_ceil(64)],
            ranks: vec![0; pixels],
        }
    }

    /// Returns the index of an event's pixel.
    #[must_use]
    pub fn number(&self, event: &Event) -> u32 {
        self.sensor.number((event.x, event.y))
    }

    /// Returns the indices of the pixels that have events, ascending.
    #[must_use]
    pub fn pixels(&mut self, events: &[Event]) -> Vec<u32> {
        for event in events {
            let number = self.sensor.number((event.x, event.y));
            if let Some(word) = self.bits.get_mut(number as usize / 64) {
                *word |= 1 << (number % 64);
            }
        }
        let mut pixels = Vec::new();
        for (first, word) in (0..).step_by(64).zip(&mut self.bits) {
            let mut rest = std::mem::take(word);
            while rest != 0 {
                pixels.push(first + rest.trailing_zeros());
                rest &= rest - 1;
            }
        }
        pixels
    }

    /// Sums `channels` numbers per pixel; `add` adds an event's contribution to the numbers of its pixel.
    #[must_use]
    pub fn sums(
        &mut self,
        events: &[Event],
        channels: usize,
        mut add: impl FnMut(&Event, &mut [f64]),
    ) -> Array {
        let pixels = self.pixels(events);
        for (rank, pixel) in (0..).zip(&pixels) {
            if let Some(place) = self.ranks.get_mut(*pixel as usize) {
                *place = rank;
            }
        }
        let mut values = vec![0.0; pixels.len() * channels];
        for event in events {
            let rank = self.ranks.get(self.number(event) as usize).copied();
            let at = rank.unwrap_or(0) as usize * channels;
            if let Some(numbers) = values.get_mut(at..at + channels) {
                add(event, numbers);
            }
        }
        Array { pixels, values }
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;

    #[test]
    fn windows_lie_on_the_recordings_grid() {
        let t_us = u64::from(WINDOW_US);
        let events = [
            event(7, 0, 0, true),
            event(7 + t_us - 1, 0, 0, true),
            event(7 + 3 * t_us, 0, 0, true),
            event(u64::MAX, 0, 0, true),
        ];
        let source = Source {
            name: "test".to_owned(),
            sensor: SENSOR,
            events: events.to_vec().into(),
        };
        let found: Vec<Window<'_>> = windows(&source).collect();
        assert_eq!(found.len(), 3);
        assert_eq!((found[0].number, found[0].start_us), (0, 7));
        assert_eq!(found[0].events, &events[..2]);
        assert_eq!((found[1].number, found[1].start_us), (3, 7 + 3 * t_us));
        let last = found[2];
        assert_eq!(last.number, (u64::MAX - 7) / t_us);
        assert_eq!(last.age_us(u64::MAX) + (u64::MAX - last.start_us), t_us);
        assert_eq!(last.time_us(WINDOW_US - 1), u64::MAX);
        assert_eq!(last.age_us(0), last.start_us.saturating_add(t_us));
    }

    #[test]
    fn ages_are_those_at_the_windows_end() {
        let window = Window {
            number: 1,
            start_us: 40_000,
            events: &[],
        };
        let t_us = u64::from(WINDOW_US);
        assert_eq!(window.age_us(40_000), t_us);
        assert_eq!(window.age_us(39_999), t_us + 1);
        assert_eq!(window.age_us(40_000 + t_us - 1), 1);
        assert_eq!(window.age_us(u64::MAX), 1);
        assert_eq!(window.since_us(3), 0);
    }

    #[test]
    fn sums_are_per_pixel_and_in_raster_order() {
        let mut active = Active::new(SENSOR);
        let events = [
            event(0, 63, 47, true),
            event(1, 2, 1, true),
            event(2, 63, 47, false),
            event(3, 1, 2, true),
        ];
        for _ in 0..2 {
            let array = active.sums(&events, 2, |event, numbers| {
                numbers[0] += 1.0;
                numbers[1] += event.t_us as f64;
            });
            assert_eq!(array.pixels, [64 + 2, 128 + 1, 64 * 48 - 1]);
            assert_eq!(array.values, [1.0, 1.0, 1.0, 3.0, 2.0, 2.0]);
        }
        assert_eq!(active.sums(&[], 2, |_, _| ()), Array::default());
    }
}
