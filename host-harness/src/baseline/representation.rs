//! The interface of a representation, and the walk over a recording's windows.
//!
//! ```text
//! events -> array -> stored array -> numbers -> events
//!           '---- timed ----'  '-> packed
//! ```

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::{Event, Polarity, Sensor};
use rayon::prelude::*;

use super::dense_array::{self, Array, StoredArray, Window, windows};
use super::stored::{Range, Stored};

/// Number of pixels that one task decodes.
const PIXELS_PER_TASK: usize = 256;

/// An event of a pixel, as decoded from the pixel's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    /// Time since the window's start, in us; below T.
    pub since_us: u32,
    /// Polarity of the event.
    pub polarity: Polarity,
}

impl Found {
    /// Rounds the time to the nearest microsecond within the window.
    #[must_use]
    pub fn at(since_us: f64, polarity: Polarity) -> Self {
        // The cast saturates.
        Self {
            since_us: (since_us.round() as u32).min(WINDOW_US - 1),
            polarity,
        }
    }

    /// Spreads `count` events evenly over the window, the i-th at T (i + 1/2) / count: the guess for unknown times.
    pub fn evenly(count: u64, polarity: Polarity) -> impl Iterator<Item = Self> {
        let step_us = f64::from(WINDOW_US) / count as f64;
        (0..count).map(move |i| Self {
            since_us: ((i as f64 + 0.5) * step_us).min(f64::from(WINDOW_US - 1)) as u32,
            polarity,
        })
    }
}

/// Turns the events of a window into an array, and the array into events.
pub trait Representation: Sync {
    /// Memory of a decoder.
    type Work: Default + Send;

    /// Returns the count of numbers per pixel.
    fn channels(&self) -> usize;

    /// Returns the range of the numbers.
    fn range(&self) -> Range;

    /// Returns whether the numbers carry times.
    fn has_times(&self) -> bool;

    /// Makes the array of the next window.
    fn make(&mut self, window: &Window<'_>) -> Array;

    /// Returns the number that stands for "nothing", if the array also holds events of earlier windows, which need
    /// not be sent again; otherwise `None`.
    fn nothing(&self) -> Option<f64> {
        None
    }

    /// Returns whether a stored number represents an event of the array's own window.
    fn is_news(&self, _number: f64) -> bool {
        true
    }

    /// Appends the events of a pixel to `found`. `numbers` are as stored: multiples of `step`, which is 0 if they
    /// have none.
    fn decode(&self, numbers: &[f64], step: f64, work: &mut Self::Work, found: &mut Vec<Found>);
}

/// Size of a recording's arrays, and the time to make them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Made {
    /// Bytes of all arrays, as one `.npy` file each, and of their steps.
    pub array_bytes: usize,
    /// Time to compute the active pixels on one thread, in seconds.
    pub seconds: f64,
}

/// Makes the array of every window; calls `visit` with the stored numbers of its active pixels.
///
/// # Errors
/// Fails if the recording is out of order or has events outside of its sensor, or with the error of `visit`.
pub fn arrays<R: Representation>(
    representation: &mut R,
    source: &Source,
    stored: Stored,
    visit: &mut dyn FnMut(&R, &Window<'_>, &StoredArray) -> Result<()>,
) -> Result<Made> {
    let sensor = source.sensor;
    let is_inside = |event: &Event| sensor.contains(event.x, event.y);
    ensure!(
        source.events.iter().all(is_inside) && source.events.is_sorted_by_key(|event| event.t_us),
        "{}: events must be in time order and inside the sensor; sort and filter them first",
        source.name
    );
    let (mut array_bytes, mut spent) = (0, Duration::ZERO);
    for window in windows(source) {
        let started = Instant::now();
        let array = representation.make(&window);
        let mut array = array.stored(representation.range(), stored);
        spent += started.elapsed();
        array_bytes += dense_array::bytes(source, representation.channels(), stored.bytes());
        array_bytes += array.quantiser.step().map_or(0, |_| size_of::<f32>());
        if let Some(nothing) = representation.nothing() {
            keep_news(&mut array, representation, nothing);
        }
        visit(representation, &window, &array)?;
    }
    Ok(Made {
        array_bytes,
        seconds: spent.as_secs_f64(),
    })
}

/// Removes the pixels that have no event of this window; in the others, replaces numbers of earlier events by
/// `nothing`.
fn keep_news(array: &mut StoredArray, representation: &impl Representation, nothing: f64) {
    let (quantiser, channels) = (array.quantiser, representation.channels().max(1));
    let nothing = quantiser.code(nothing);
    let mut kept = StoredArray {
        pixels: Vec::with_capacity(array.pixels.len()),
        codes: Vec::with_capacity(array.codes.len()),
        quantiser,
    };
    for (pixel, codes) in array.pixels.iter().zip(array.codes.chunks(channels)) {
        let before = kept.codes.len();
        let mut has_news = false;
        kept.codes.extend(codes.iter().map(|code| {
            let is_news = representation.is_news(quantiser.value(*code));
            has_news |= is_news;
            if is_news { *code } else { nothing }
        }));
        if has_news {
            kept.pixels.push(*pixel);
        } else {
            kept.codes.truncate(before);
        }
    }
    *array = kept;
}

/// Decodes the events of a window's array, in order of time, then of position. Uses all threads.
#[must_use]
pub fn decode<R: Representation>(
    representation: &R,
    sensor: Sensor,
    window: &Window<'_>,
    array: &StoredArray,
) -> Vec<Event> {
    let channels = representation.channels().max(1);
    let step = f64::from(array.quantiser.step().unwrap_or(0.0));
    let pixels = array.pixels.par_chunks(PIXELS_PER_TASK);
    let codes = array.codes.par_chunks(PIXELS_PER_TASK * channels);
    let events = pixels.zip(codes).map(|(pixels, codes)| {
        let (mut work, mut found) = (R::Work::default(), Vec::new());
        let (mut numbers, mut events) = (Vec::new(), Vec::new());
        for (pixel, codes) in pixels.iter().zip(codes.chunks(channels)) {
            numbers.clear();
            numbers.extend(codes.iter().map(|code| array.quantiser.value(*code)));
            representation.decode(&numbers, step, &mut work, &mut found);
            let (x, y) = sensor.pixel(*pixel).unwrap_or_default();
            events.extend(found.drain(..).map(|found| Event {
                t_us: window.time_us(found.since_us),
                x,
                y,
                polarity: found.polarity,
            }));
        }
        events
    });
    let mut events: Vec<Event> = events.flatten_iter().collect();
    events.par_sort_unstable_by_key(|event| (event.t_us, event.y, event.x, event.polarity));
    events
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_without_times_lie_evenly() {
        let at = |count| -> Vec<u32> {
            let found = Found::evenly(count, Polarity::On);
            found.map(|found| found.since_us).collect()
        };
        assert!(at(0).is_empty());
        assert_eq!(at(1), [16_384]);
        assert_eq!(at(4), [4096, 12_288, 20_480, 28_672]);
        assert!(at(100_000).iter().all(|since_us| *since_us < WINDOW_US));
    }

    #[test]
    fn found_events_are_in_the_window() {
        for since_us in [f64::NAN, -5.0, 1e300, f64::INFINITY] {
            assert!(Found::at(since_us, Polarity::On).since_us < WINDOW_US);
        }
        assert_eq!(Found::at(6.5, Polarity::Off).since_us, 7);
    }
}
