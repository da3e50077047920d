//! Calibrates the density thresholds: exact percentiles over the windows of recordings.
//!
//! `tau_low` and `tau_high` are the 25th and the 75th percentile of rho = N / (H W T), with linear interpolation
//! between order statistics. All windows of the set count, including empty ones between the first and the last
//! event of a recording. The arithmetic is exact: densities are reduced fractions of integers, and only the result
//! is rounded, down to a multiple of 1e-12 events per pixel per second. A window whose density equals a threshold
//! therefore still compares as >= to it.
//!
//! Memory holds one window, and one count for each distinct density. Runs of empty windows are counted by a
//! division, so a gap of hours costs nothing.

use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroUsize};

use eecvs_nostd::{Event, Sensor};
use event_types::bail;
use event_types::stream::{BATCH_EVENTS, Context, EventReader, Result};

use crate::exact_density::{Density, interpolated_pico};
use crate::window_counts::{CAPACITY, WindowCount, WindowCounter};

/// Thresholds computed from a calibration set, with the size of the set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CalibratedThresholds {
    /// 25th percentile of the density in 1e-12 events per pixel per second, rounded down.
    pub tau_low_pico: u64,
    /// 75th percentile of the density in 1e-12 events per pixel per second, rounded down.
    pub tau_high_pico: u64,
    /// Configured duration of the windows in microseconds.
    pub window_us: NonZeroU32,
    /// Number of windows, including empty ones; at least 1.
    pub windows: u64,
    /// Number of windows without events.
    pub windows_empty: u64,
    /// Number of events in the windows.
    pub events: u64,
    /// Events older than the start of the open window; always 0, since a new run begins where the clock falls back.
    pub events_late: u64,
}

/// Collects the window densities of recordings, one recording at a time.
#[derive(Debug, Clone)]
pub struct Calibration {
    window_us: NonZeroU32,
    capacity: NonZeroUsize,
    /// Number of windows of each density.
    windows: BTreeMap<Density, u128>,
    events: u64,
    events_late: u64,
}

impl Calibration {
    /// Creates a calibration over windows of `window_us` microseconds and at most [`CAPACITY`] events.
    #[must_use]
    pub fn new(window_us: NonZeroU32) -> Self {
        Self {
            window_us,
            capacity: CAPACITY,
            windows: BTreeMap::new(),
            events: 0,
            events_late: 0,
        }
    }

    /// Adds the windows of a recording, from its first event to its last; `progress` is called with the number of
    /// events of every batch. A recording without events adds nothing.
    ///
    /// # Errors
    /// Returns the reader's error. The windows before the damage have then been added already, so start a new
    /// calibration.
    pub fn add(
        &mut self,
        recording: &mut dyn EventReader,
        progress: &mut dyn FnMut(u64),
    ) -> Result<()> {
        let sensor = recording.sensor();
        let mut counter = WindowCounter::new(self.window_us, self.capacity);
        let mut previous_t0_us = None;
        let mut batch: Vec<Event> = Vec::with_capacity(BATCH_EVENTS);
        loop {
            batch.clear();
            if recording.read(&mut batch)? == 0 {
                break;
            }
            for event in &batch {
                if let Some(window) = counter.push(event) {
                    self.add_window(&window, sensor, &mut previous_t0_us);
                }
            }
            progress(batch.len() as u64);
        }
        if let Some(window) = counter.flush() {
            self.add_window(&window, sensor, &mut previous_t0_us);
        }
        Ok(())
    }

    fn add_window(
        &mut self,
        window: &WindowCount,
        sensor: Sensor,
        previous_t0_us: &mut Option<u64>,
    ) {
        // The time that passed between runs is unknown.
        if let Some(previous_t0_us) = previous_t0_us.filter(|_| !window.begins_run) {
            // A window that closed early is followed within less than T, which counts as no empty window.
            let periods =
                window.t0_us.saturating_sub(previous_t0_us) / u64::from(self.window_us.get());
            let empty = periods.saturating_sub(1);
            if empty > 0 {
                *self.windows.entry(Density::EMPTY).or_default() += u128::from(empty);
            }
        }
        *previous_t0_us = Some(window.t0_us);
        let density = Density::of(window, sensor);
        *self.windows.entry(density).or_default() += 1;
        self.events += u64::from(window.events);
    }

    /// Returns the thresholds of all recordings added so far.
    ///
    /// # Errors
    /// Fails if there are no windows, if there are more than an integer of a TOML file holds (2^63 - 1), or if a
    /// percentile is above the range of a threshold, 1.8e7 events per pixel per second.
    pub fn thresholds(&self) -> Result<CalibratedThresholds> {
        let windows: u128 = self.windows.values().sum();
        if windows == 0 {
            bail!(
                Refused,
                "no events in these recordings, so no densities: calibrate on others"
            );
        }
        if i64::try_from(windows).is_err() {
            bail!(
                Refused,
                "{windows} windows are too many to count: choose a longer --window-us"
            );
        }
        let empty = self.windows.get(&Density::EMPTY).copied().unwrap_or(0);
        Ok(CalibratedThresholds {
            tau_low_pico: self.quartile(1, windows)?,
            tau_high_pico: self.quartile(3, windows)?,
            window_us: self.window_us,
            windows: windows as u64,
            windows_empty: empty as u64,
            events: self.events,
            events_late: self.events_late,
        })
    }

    /// Returns the quartile `q` (1 or 3) of `n >= 1` windows. With h = (n - 1) q / 4, it lies at the fraction h -
    /// floor(h) between the order statistics floor(h) and floor(h) + 1.
    fn quartile(&self, q: u128, n: u128) -> Result<u64> {
        let rank_quarters = (n - 1) * q;
        let (rank, quarters) = (rank_quarters / 4, rank_quarters % 4);
        let below = self.order_statistic(rank);
        let above = self.order_statistic((rank + 1).min(n - 1));
        interpolated_pico(below, above, quarters).with_context(|| {
            format!(
                "a density threshold above {} events per pixel per second cannot be held: \
                 choose a --window-us longer than {}",
                u64::MAX / 1_000_000_000_000,
                self.window_us
            )
        })
    }

    /// Returns the window density of rank `rank`; rank 0 is the lowest.
    fn order_statistic(&self, rank: u128) -> Density {
        let mut below = 0;
        for (density, windows) in &self.windows {
            below += windows;
            if rank < below {
                return *density;
            }
        }
        Density::EMPTY
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Polarity;
    use eecvs_oracle::{density::density, percentile, window::windows};
    use event_types::stream::Skipped;
    use proptest::prelude::*;

    use super::*;

    /// Reads events from memory in small batches; fails at the end if it is `damaged`.
    struct Recording {
        sensor: Sensor,
        times: Vec<u64>,
        next: usize,
        damaged: bool,
        skipped: Skipped,
    }

    impl EventReader for Recording {
        fn format(&self) -> &'static str {
            "memory"
        }

        fn sensor(&self) -> Sensor {
            self.sensor
        }

        fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
            let batch: Vec<Event> = self.times[self.next..]
                .iter()
                .take(3)
                .map(|&t_us| Event {
                    t_us,
                    x: 0,
                    y: 0,
                    polarity: Polarity::On,
                })
                .collect();
            if batch.is_empty() && self.damaged {
                bail!(Damaged, "memory: damaged");
            }
            self.next += batch.len();
            events.extend(&batch);
            Ok(batch.len())
        }

        fn skipped(&self) -> &Skipped {
            &self.skipped
        }
    }

    fn recording(width: u16, height: u16, times: &[u64]) -> Recording {
        Recording {
            sensor: Sensor::new(width, height).unwrap(),
            times: times.to_vec(),
            next: 0,
            damaged: false,
            skipped: Skipped::default(),
        }
    }

    fn us(window_us: u32) -> NonZeroU32 {
        NonZeroU32::new(window_us).unwrap()
    }

    fn calibrated(window_us: u32, recordings: Vec<Recording>) -> CalibratedThresholds {
        let mut calibration = Calibration::new(us(window_us));
        for mut recording in recordings {
            calibration.add(&mut recording, &mut |_| ()).unwrap();
        }
        calibration.thresholds().unwrap()
    }

    /// One event per pixel per second.
    const ONE: u64 = 1_000_000_000_000;

    #[test]
    fn one_window_is_both_thresholds() {
        // 3 events on 2 pixels in 1 s.
        let t = calibrated(1_000_000, vec![recording(2, 1, &[5, 6, 7])]);
        assert_eq!(
            (t.tau_low_pico, t.tau_high_pico),
            (3 * ONE / 2, 3 * ONE / 2)
        );
        assert_eq!(
            (t.windows, t.windows_empty, t.events, t.events_late),
            (1, 0, 3, 0)
        );
    }

    #[test]
    fn two_windows_interpolate() {
        // 1 and 3 events on 1 pixel in 1 s each: the quartiles are 1.5 and 2.5.
        let t = calibrated(
            1_000_000,
            vec![recording(1, 1, &[0, 1_000_000, 1_500_000, 1_999_999])],
        );
        assert_eq!(
            (t.tau_low_pico, t.tau_high_pico),
            (3 * ONE / 2, 5 * ONE / 2)
        );
        assert_eq!(t.windows, 2);
    }

    #[test]
    fn empty_windows_between_events_count_and_a_long_gap_costs_nothing() {
        // Windows with 1, 0, 0, 1 events: numpy.percentile([1, 0, 0, 1], [25, 75]) = [0, 1].
        let t = calibrated(1_000_000, vec![recording(1, 1, &[0, 3_500_000])]);
        assert_eq!((t.tau_low_pico, t.tau_high_pico), (0, ONE));
        assert_eq!((t.windows, t.windows_empty), (4, 2));
        // A recording of 1.7e15 us in windows of 1 us.
        let last = 1_700_000_000_000_000;
        let t = calibrated(1, vec![recording(1, 1, &[0, last])]);
        assert_eq!((t.windows, t.windows_empty), (last + 1, last - 1));
        assert_eq!((t.tau_low_pico, t.tau_high_pico), (0, 0));
    }

    #[test]
    fn no_empty_window_between_recordings() {
        let t = calibrated(
            10,
            vec![recording(1, 1, &[0]), recording(1, 1, &[1_000_000])],
        );
        assert_eq!((t.windows, t.windows_empty), (2, 0));
    }

    #[test]
    fn sensors_of_different_sizes_are_compared_by_density() {
        // 4 events on 4 pixels, 2 on 1, 3 on 2 and 1 on 2: 1, 2, 1.5 and 0.5 events per pixel per second.
        let t = calibrated(
            1_000_000,
            vec![
                recording(2, 2, &[0, 1, 2, 3]),
                recording(1, 1, &[0, 1]),
                recording(2, 1, &[0, 1, 2]),
                recording(1, 2, &[9]),
            ],
        );
        // numpy.percentile([0.5, 1, 1.5, 2], [25, 75]) = [0.875, 1.625].
        assert_eq!(
            (t.tau_low_pico, t.tau_high_pico),
            (7 * ONE / 8, 13 * ONE / 8)
        );
    }

    #[test]
    fn a_window_as_dense_as_the_threshold_compares_as_not_below_it() {
        // 1 event on 3 x 7 pixels in 32,768 us has no finite decimal expansion.
        let t = calibrated(32_768, vec![recording(3, 7, &[0]), recording(3, 7, &[0])]);
        let pixel_us = 21 * 32_768_u128;
        let exact = 1_000_000_000_000_000_000 / pixel_us;
        assert_eq!(u128::from(t.tau_low_pico), exact);
        assert!(u128::from(t.tau_low_pico) * pixel_us < 1_000_000_000_000_000_000);
        assert!(u128::from(t.tau_low_pico + 1) * pixel_us > 1_000_000_000_000_000_000);
    }

    #[test]
    fn a_clock_that_falls_back_begins_a_run() {
        let t = calibrated(10, vec![recording(1, 1, &[100, 99, 105, 111, 3])]);
        assert_eq!(
            (t.events, t.events_late, t.windows, t.windows_empty),
            (5, 0, 4, 0)
        );
    }

    #[test]
    fn windows_that_close_early_count_over_their_own_duration() {
        let mut calibration = Calibration::new(us(1000));
        calibration.capacity = NonZeroUsize::new(2).unwrap();
        // [0, 4) holds two events, 500,000 per s; [4, 1004) holds one, 1000 per s.
        calibration
            .add(&mut recording(1, 1, &[0, 1, 4]), &mut |_| ())
            .unwrap();
        let t = calibration.thresholds().unwrap();
        assert_eq!((t.windows, t.windows_empty), (2, 0));
        assert_eq!(t.tau_low_pico, (1000 * 3 + 500_000) / 4 * ONE);
        assert_eq!(t.tau_high_pico, (1000 + 500_000 * 3) / 4 * ONE);
    }

    #[test]
    fn extremes_stay_exact() {
        // The largest sensor and the longest window: a density of 1 / (2^22 * (2^32 - 1) us).
        let t = calibrated(u32::MAX, vec![recording(2048, 2048, &[0])]);
        assert_eq!(t.tau_low_pico, 55);
        // 18 events in 1 us on one pixel fit, 19 do not.
        let t = calibrated(1, vec![recording(1, 1, &[7; 18])]);
        assert_eq!(t.tau_high_pico, 18_000_000 * ONE);
        let mut calibration = Calibration::new(us(1));
        calibration
            .add(&mut recording(1, 1, &[7; 19]), &mut |_| ())
            .unwrap();
        let error = calibration.thresholds().unwrap_err().to_string();
        assert!(error.contains("--window-us"), "{error}");
        // Two recordings that span all of u64 in windows of 1 us have too many windows to count.
        let mut calibration = Calibration::new(us(1));
        for _ in 0..2 {
            calibration
                .add(&mut recording(1, 1, &[0, u64::MAX]), &mut |_| ())
                .unwrap();
        }
        let error = calibration.thresholds().unwrap_err().to_string();
        assert!(error.contains("too many"), "{error}");
    }

    #[test]
    fn nothing_to_calibrate_on_and_damage_are_errors() {
        let mut calibration = Calibration::new(us(10));
        calibration
            .add(&mut recording(1, 1, &[]), &mut |_| ())
            .unwrap();
        assert!(
            calibration
                .thresholds()
                .unwrap_err()
                .to_string()
                .contains("no events")
        );
        let mut damaged = Recording {
            damaged: true,
            ..recording(1, 1, &[1])
        };
        assert!(calibration.add(&mut damaged, &mut |_| ()).is_err());
    }

    #[test]
    fn progress_is_told_every_event() {
        let mut seen = 0;
        let mut calibration = Calibration::new(us(10));
        calibration
            .add(&mut recording(1, 1, &[1, 2, 3, 4]), &mut |n| seen += n)
            .unwrap();
        assert_eq!(seen, 4);
    }

    fn times() -> impl Strategy<Value = Vec<u64>> {
        prop::collection::vec(0u64..5_000, 1..60)
    }

    proptest! {
        #[test]
        fn equals_the_oracle(
            recordings in prop::collection::vec((1u16..5, 1u16..5, times()), 1..4),
            window_us in 1u32..400,
            capacity in prop_oneof![1usize..5, Just(1 << 20)],
        ) {
            let capacity = NonZeroUsize::new(capacity).unwrap();
            let mut calibration = Calibration::new(us(window_us));
            calibration.capacity = capacity;
            let mut densities = Vec::new();
            for (width, height, times) in &recordings {
                let mut recording = recording(*width, *height, times);
                let events: Vec<Event> = times
                    .iter()
                    .map(|&t_us| Event { t_us, x: 0, y: 0, polarity: Polarity::Off })
                    .collect();
                let closed = windows(&events, us(window_us), capacity);
                for (i, window) in closed.iter().enumerate() {
                    let n = window.events.len() as u64;
                    densities.push(density(n, recording.sensor, window.duration_us));
                    let mut end_us = window.t0_us + u64::from(window_us);
                    while closed.get(i + 1).is_some_and(|next| end_us < next.t0_us) {
                        densities.push(0.0);
                        end_us += u64::from(window_us);
                    }
                }
                calibration.add(&mut recording, &mut |_| ()).unwrap();
            }
            let expected = percentile::thresholds(&densities).unwrap();
            let t = match calibration.thresholds() {
                Ok(t) => t,
                Err(_) => {
                    prop_assert!(expected.1 > 1.8e7);
                    return Ok(());
                }
            };
            prop_assert_eq!(t.windows, densities.len() as u64);
            for (pico, expected) in [(t.tau_low_pico, expected.0), (t.tau_high_pico, expected.1)] {
                let difference = (pico as f64 - expected * 1e12).abs();
                prop_assert!(difference <= 1.0 + expected * 1e12 * 1e-12, "{} {}", pico, expected);
            }
        }

        #[test]
        fn rounds_down_the_exact_quotient(
            mut counts in prop::collection::vec(0usize..6, 1..30),
            window_us in 10u32..100_000,
            (width, height) in (1u16..700, 1u16..700),
        ) {
            // The first and the last window of a recording hold an event.
            *counts.first_mut().unwrap() += 1;
            *counts.last_mut().unwrap() += 1;
            let times: Vec<u64> = counts
                .iter()
                .enumerate()
                .flat_map(|(i, n)| vec![i as u64 * u64::from(window_us); *n])
                .collect();
            let t = calibrated(window_us, vec![recording(width, height, &times)]);
            counts.sort_unstable();
            let pixel_us = u128::from(width) * u128::from(height) * u128::from(window_us);
            for (q, pico) in [(1, t.tau_low_pico), (3, t.tau_high_pico)] {
                let (rank, quarters) = ((counts.len() - 1) * q / 4, (counts.len() - 1) * q % 4);
                let above = counts[(rank + 1).min(counts.len() - 1)];
                let four_times = (counts[rank] * (4 - quarters) + above * quarters) as u128;
                let exact = four_times * 1_000_000_000_000_000_000 / (4 * pixel_us);
                prop_assert_eq!(u128::from(pico), exact);
            }
        }
    }
}
