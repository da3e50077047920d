//! Voxel grids with bilinear weights, the usual input of networks.
//!
//! ```text
//! tau = (B - 1) (t - start) / T
//! V[b, y, x] = sum over the pixel's events of p max(0, 1 - |b - tau|)
//! ```
//!
//! (Zhu, Yuan, Chaney, Daniilidis, *Unsupervised Event-based Learning of Optical Flow, Depth, and Egomotion*,
//! 2019), for every window that has events: f32, or i16 or i8 times a step. The step is one f32 per window: the
//! largest |V| over the type's largest number.
//!
//! The decoder works pixel by pixel. A run is a longest stretch of adjacent bins of one sign, its mass the sum of
//! these bins. The masses are rounded to numbers of events by the largest remainder, so that their signed sum is
//! the rounded sum of all bins. The weights of an event sum to 1, so this preserves frames. The i-th of a run's n
//! events takes the i-th of n equal parts of its mass in order of the bins; its time is the mean of these bins,
//! weighted by the mass it takes from each. A single event of a pixel is exact, and so are events two bins or more
//! apart. Of closer events only the mean time is exact, and opposite signs cancel in bins that they share. A grid
//! of one bin carries no times: its events are spread evenly.

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::{Polarity, Sensor};

use super::dense_array::{Active, Array, Window};
use super::representation::{Found, Representation};
use super::stored::Range;

/// Makes voxel grids.
#[derive(Debug, Clone)]
pub struct Voxel {
    active: Active,
    bins: usize,
}

impl Voxel {
    /// Makes grids of `bins` bins; 0 is taken as 1.
    #[must_use]
    pub fn new(sensor: Sensor, bins: usize) -> Self {
        Self {
            active: Active::new(sensor),
            bins: bins.max(1),
        }
    }

    /// Returns the time of position `tau` on the axis of bins, in us since the window's start.
    fn since_us(&self, tau: f64) -> f64 {
        tau * f64::from(WINDOW_US) / (self.bins - 1) as f64
    }
}

/// Adjacent bins of one sign.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// Index of the first bin, and of the one after the last.
    bins: (usize, usize),
    /// Sum of the bins.
    mass: f64,
    /// Number of events, with their sign.
    count: f64,
}

/// Reusable memory of the decoder.
#[derive(Debug, Default)]
pub struct Work {
    runs: Vec<Run>,
    /// Indices of the runs, by descending remainder.
    order: Vec<usize>,
}

impl Work {
    /// Finds the runs of a pixel.
    fn find(&mut self, bins: &[f64]) {
        self.runs.clear();
        let mut end = 0;
        for run in bins.chunk_by(|a, b| a * b > 0.0) {
            let start = end;
            end += run.len();
            // A product that underflows splits a run only at bins of negligible mass.
            let mass: f64 = run.iter().sum();
            if mass != 0.0 {
                self.runs.push(Run {
                    bins: (start, end),
                    mass,
                    count: mass.floor(),
                });
            }
        }
    }

    /// Rounds the masses of the runs to `total` events.
    fn round(&mut self, total: f64) {
        let counted: f64 = self.runs.iter().map(|run| run.count).sum();
        // From 0 to the number of runs, since `total` is the rounded sum of the masses.
        let more = (total - counted).max(0.0) as usize;
        let runs = &mut self.runs;
        self.order.clear();
        self.order.extend(0..runs.len());
        let remainder = |at: &usize| runs.get(*at).map_or(0.0, |run| run.mass - run.count);
        self.order
            .sort_by(|a, b| remainder(b).total_cmp(&remainder(a)));
        for at in self.order.iter().take(more) {
            if let Some(run) = runs.get_mut(*at) {
                run.count += 1.0;
            }
        }
    }
}

impl Representation for Voxel {
    type Work = Work;

    fn channels(&self) -> usize {
        self.bins
    }

    fn range(&self) -> Range {
        Range::Signed
    }

    fn has_times(&self) -> bool {
        self.bins > 1
    }

    fn make(&mut self, window: &Window<'_>) -> Array {
        let last = (self.bins - 1) as f64;
        self.active.sums(window.events, self.bins, |event, bins| {
            let since_us = f64::from(window.since_us(event.t_us));
            let tau = last * since_us / f64::from(WINDOW_US);
            let sign = f64::from(event.polarity.sign());
            let first = tau as usize;
            for (bin, value) in bins.iter_mut().enumerate().skip(first).take(2) {
                *value += sign * (1.0 - (bin as f64 - tau).abs()).max(0.0);
            }
        })
    }

    fn decode(&self, numbers: &[f64], _step: f64, work: &mut Work, found: &mut Vec<Found>) {
        let total = numbers.iter().sum::<f64>().round();
        let polarity = |count: f64| Polarity::from_bool(count > 0.0);
        if self.bins == 1 {
            found.extend(Found::evenly(total.abs() as u64, polarity(total)));
            return;
        }
        work.find(numbers);
        work.round(total);
        for run in &work.runs {
            let (first, end) = run.bins;
            let mut bins = (first..end)
                .map(|bin| bin as f64)
                .zip(numbers.get(first..end).unwrap_or_default())
                .map(|(bin, mass)| (bin, mass.abs()));
            let part = run.mass / run.count;
            let (mut bin, mut rest) = bins.next().unwrap_or_default();
            for _ in 0..run.count.abs() as u64 {
                let (mut taken, mut moment) = (0.0, 0.0);
                loop {
                    let take = rest.min(part - taken);
                    taken += take;
                    rest -= take;
                    moment += take * bin;
                    if taken >= part {
                        break;
                    }
                    // Rounding may leave a little less mass for the last event.
                    let Some(next) = bins.next() else {
                        break;
                    };
                    (bin, rest) = next;
                }
                let tau = if taken > 0.0 { moment / taken } else { bin };
                found.push(Found::at(self.since_us(tau), polarity(run.count)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Event;
    use event_types::test_events::{SENSOR, event};

    use super::*;
    use crate::baseline::dense_array::windows;
    use crate::baseline::stored::Stored;
    use crate::baseline::tests::{decoded, source};

    fn frames(source: &eecvs_bench::source::Source, bins: usize, stored: Stored) -> Vec<Event> {
        decoded(&mut Voxel::new(SENSOR, bins), source, stored)
    }

    #[test]
    fn an_event_is_shared_by_the_two_bins_next_to_it() {
        let t_us = u64::from(WINDOW_US);
        // tau = 0, 1 and 2.25 on 5 bins.
        let events = [
            event(0, 4, 3, true),
            event(t_us / 4, 4, 3, true),
            event(t_us / 16 * 9, 4, 3, false),
        ];
        let source = source(&events);
        let window = windows(&source).next().unwrap();
        let array = Voxel::new(SENSOR, 5).make(&window);
        assert_eq!(array.pixels, [3 * 64 + 4]);
        assert_eq!(array.values, [1.0, 1.0, -0.75, -0.25, 0.0]);
        assert_eq!(frames(&source, 5, Stored::F32), events);
    }

    #[test]
    fn events_two_bins_apart_are_exact() {
        // 8 bins, 4,681 us apart.
        let events = [
            event(0, 4, 3, true),
            event(100, 9, 3, false),
            event(9_500, 4, 3, false),
            event(9_999, 9, 3, false),
            event(21_000, 4, 3, true),
            event(31_000, 4, 3, true),
            event(32_767, 9, 3, true),
        ];
        assert_eq!(frames(&source(&events), 8, Stored::F32), events);
        // In 16 bits, the error of a time is as small as that of the weights of two bins.
        for (found, event) in frames(&source(&events), 8, Stored::Bits16)
            .iter()
            .zip(&events)
        {
            assert_eq!((found.x, found.polarity), (event.x, event.polarity));
            assert!(found.t_us.abs_diff(event.t_us) <= 1, "{found:?}");
        }
    }

    #[test]
    fn times_of_one_event_come_back() {
        for t_us in (0..u64::from(WINDOW_US)).step_by(509) {
            let events = [event(0, 0, 0, true), event(t_us, 4, 3, false)];
            for bins in [2, 5, 16, 64] {
                assert_eq!(frames(&source(&events), bins, Stored::F32), events);
            }
        }
    }

    #[test]
    fn of_events_in_one_bin_the_mean_is_kept_and_opposite_ones_cancel() {
        let near = [event(0, 1, 1, true), event(1000, 1, 1, true)];
        let found = frames(&source(&near), 8, Stored::F32);
        assert_eq!(found.iter().map(|event| event.t_us).sum::<u64>(), 1000);
        let opposite = [event(1000, 1, 1, true), event(1000, 1, 1, false)];
        assert_eq!(frames(&source(&opposite), 8, Stored::F32), []);
    }

    #[test]
    fn one_bin_keeps_the_signed_count() {
        let events = [
            event(0, 1, 1, true),
            event(10, 1, 1, true),
            event(20, 1, 1, false),
            event(30, 2, 1, false),
            event(40, 2, 1, false),
        ];
        let expected = [
            event(8192, 2, 1, false),
            event(16_384, 1, 1, true),
            event(24_576, 2, 1, false),
        ];
        assert_eq!(frames(&source(&events), 1, Stored::F32), expected);
    }

    #[test]
    fn the_signed_sum_of_every_pixel_is_kept() {
        let events: Vec<Event> = (0..400)
            .map(|i| event(81 * i, (i % 7) as u16, 0, i * i % 5 > 1))
            .collect();
        let source = source(&events);
        let sums = |events: &[Event]| {
            let mut sums = [0; 7];
            for event in events {
                sums[usize::from(event.x)] += event.polarity.sign();
            }
            sums
        };
        for bins in [1, 2, 3, 8, 33] {
            for stored in [Stored::F32, Stored::Bits16] {
                assert_eq!(sums(&frames(&source, bins, stored)), sums(&events));
            }
        }
    }

    #[test]
    fn masses_round_to_the_total_by_their_remainders() {
        let mut work = Work::default();
        // Runs of 1.5, -0.4, 0.3 and -1.2, which sum to 0.2.
        work.find(&[0.7, 0.8, -0.4, 0.0, 0.3, -1.2]);
        work.round(0.0);
        let counts: Vec<f64> = work.runs.iter().map(|run| run.count).collect();
        assert_eq!(counts, [1.0, 0.0, 0.0, -1.0]);
        work.find(&[0.0; 4]);
        work.round(0.0);
        assert!(work.runs.is_empty());
    }
}
