//! A voxel grid with bilinear weights, the usual input of networks.
//!
//! ```text
//! tau = (B - 1) (t - start) / T
//! V[b, y, x] = sum over the pixel's events of p max(0, 1 - |b - tau|)
//! ```
//!
//! for every window that has events: f32, or i16 or i8 times a step of the window, which is its largest
//! |V| over the type's largest number and takes 4 bytes. Weights of an event sum to 1, so the signed
//! count of a pixel is the sum of its bins, rounded; that is what its frame is made of. A grid of 8 bins
//! is held against the box volume as it is. Times of events cannot be had from it.

use std::time::Instant;

use eecvs_nostd::{Event, Polarity};

use super::dense_array::{self, Window, windows};
use super::volume::{BINS, Grid, Volume};
use crate::source::{Source, WINDOW_US};

/// Type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Value {
    /// 4 bytes.
    F32,
    /// 2 bytes.
    I16,
    /// 1 byte.
    I8,
}

impl Value {
    /// All types.
    pub const ALL: [Self; 3] = [Self::F32, Self::I16, Self::I8];

    /// As rows have it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::I16 => "i16",
            Self::I8 => "i8",
        }
    }

    const fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::I16 => 2,
            Self::I8 => 1,
        }
    }

    /// Bytes of a window's step.
    const fn step_bytes(self) -> usize {
        match self {
            Self::F32 => 0,
            Self::I16 | Self::I8 => 4,
        }
    }

    /// What is left of a window's values, the largest of which is `largest`.
    fn stored(self, value: f64, largest: f64) -> f64 {
        let levels = match self {
            Self::F32 => return f64::from(value as f32),
            Self::I16 => f64::from(i16::MAX),
            Self::I8 => f64::from(i8::MAX),
        };
        let step = f64::from((largest / levels) as f32);
        if step > 0.0 {
            (value / step).round() * step
        } else {
            0.0
        }
    }
}

/// What a decoder has of a recording's grids.
pub struct Decoded {
    /// Of all grids.
    pub bytes: usize,
    /// Spent on them, their memory not included.
    pub seconds: f64,
    /// The signed count of every pixel as events in the middle of its window.
    pub frames: Vec<Event>,
    /// Where there are 8 bins.
    pub volume: Option<Volume>,
}

/// Grids of `bins` bins, 2 or more, and back.
#[must_use]
pub fn round_trip(source: &Source, bins: usize, stored: Value) -> Decoded {
    let grid = source.grid();
    let (mut bytes, mut frames, mut cells) = (0, Vec::new(), Vec::new());
    let started = Instant::now();
    for window in windows(source) {
        bytes += dense_array::bytes(source, bins, stored.bytes()) + stored.step_bytes();
        let mut pixels = pixels(&window, bins);
        let values = pixels.iter().flat_map(|(_, values)| values);
        let largest = values.fold(0.0, |largest: f64, value| largest.max(value.abs()));
        for ((y, x), values) in &mut pixels {
            for value in values.iter_mut() {
                *value = stored.stored(*value, largest);
            }
            let count = values.iter().sum::<f64>().round() as i64;
            let event = Event {
                t_us: window.start_us + u64::from(WINDOW_US / 2),
                x: *x,
                y: *y,
                polarity: Polarity::from_bool(count > 0),
            };
            frames.extend((0..count.unsigned_abs()).map(|_| event));
            if bins == BINS {
                cells.extend(boxes(&grid, window.number, (*x, *y), values));
            }
        }
    }
    Decoded {
        bytes,
        seconds: started.elapsed().as_secs_f64(),
        frames,
        volume: (bins == BINS).then(|| Volume::new(cells)),
    }
}

/// The bins of one pixel, by place.
type Pixel = ((u16, u16), Vec<f64>);

/// The pixels of a window that have events.
fn pixels(window: &Window<'_>, bins: usize) -> Vec<Pixel> {
    let mut events: Vec<&Event> = window.events.iter().collect();
    events.sort_by_key(|event| (event.y, event.x));
    events
        .chunk_by(|a, b| (a.y, a.x) == (b.y, b.x))
        .filter_map(|events| {
            let first = events.first()?;
            let mut values = vec![0.0; bins];
            for event in events {
                let since_us = (event.t_us - window.start_us) as f64;
                let tau = (bins - 1) as f64 * since_us / f64::from(WINDOW_US);
                let sign = f64::from(event.polarity.sign());
                for (bin, value) in values.iter_mut().enumerate() {
                    *value += sign * (1.0 - (bin as f64 - tau).abs()).max(0.0);
                }
            }
            Some(((first.y, first.x), values))
        })
        .collect()
}

fn boxes<'v>(
    grid: &Grid,
    number: u64,
    (x, y): (u16, u16),
    values: &'v [f64],
) -> impl Iterator<Item = (u64, f64)> + 'v {
    let first = grid.cell(number, x, y, 0);
    (first..).zip(values.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::memory_reader::{SENSOR, event};

    fn source(events: &[Event]) -> Source {
        Source {
            name: "test".to_owned(),
            sensor: SENSOR,
            events: events.to_vec().into(),
        }
    }

    #[test]
    fn an_event_is_shared_by_the_two_bins_next_to_it() {
        let t_us = u64::from(WINDOW_US);
        // tau = 0, 1, 2.25 of 5 bins.
        let events = [
            event(0, 4, 3, true),
            event(t_us / 4, 4, 3, true),
            event(t_us / 16 * 9, 4, 3, false),
        ];
        let source = source(&events);
        let window = windows(&source).next().unwrap();
        let expected = vec![1.0, 1.0, -0.75, -0.25, 0.0];
        assert_eq!(pixels(&window, 5), [((3, 4), expected)]);
        let decoded = round_trip(&source, 5, Value::F32);
        assert_eq!(decoded.bytes, 128 + 64 * 48 * 5 * 4);
        assert_eq!(decoded.frames, [event(t_us / 2, 4, 3, true)]);
        assert_eq!(decoded.volume, None);
    }

    #[test]
    fn bins_of_a_small_type_are_off_by_half_a_step() {
        let events: Vec<Event> = (0..40)
            .map(|i| event(701 * i, (i % 3) as u16, 0, i % 5 > 0))
            .collect();
        let source = source(&events);
        let exact = round_trip(&source, 8, Value::F32);
        for (stored, most) in [(Value::I16, 1e-8), (Value::I8, 1e-3)] {
            let decoded = round_trip(&source, 8, stored);
            assert_eq!(decoded.bytes, 132 + 64 * 48 * 8 * stored.bytes());
            assert_eq!(decoded.frames, exact.frames);
            let nmse = exact
                .volume
                .as_ref()
                .unwrap()
                .nmse(&decoded.volume.unwrap());
            assert!(nmse.unwrap() > 0.0 && nmse.unwrap() < most, "{nmse:?}");
        }
        assert_eq!(
            Value::I8.stored(-3.0, 3.0),
            f64::from(-(3.0 / 127.0) as f32) * 127.0
        );
        assert_eq!(Value::I8.stored(0.0, 0.0), 0.0);
    }

    #[test]
    fn eight_bins_are_near_to_the_box_volume() {
        // In the first and the last bin the weights are nearly all one bin's.
        let events = [event(0, 4, 3, true), event(32_767, 4, 3, false)];
        let source = source(&events);
        let volume = source.grid().volume(&events);
        let decoded = round_trip(&source, 8, Value::F32);
        assert!(volume.nmse(&decoded.volume.unwrap()).unwrap() < 1e-6);
    }
}
