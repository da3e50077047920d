//! Measures the error of every kernel against f64 as three curves: over k, over n events in a pixel, and over T.
//!
//! ```text
//! places (T, u) -> one event, K = 1,024   -> error by k and by T
//!               -> n events, K for M = 64 -> error by n
//! ```
//!
//! The error of n events is at most n times that of one event, so the error per event is compared with the
//! documented bound.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use eecvs_nostd::transform::{GRID_MAX, M_MAX};
use eecvs_nostd::{Kernel, Transform};
use eecvs_oracle::transform::Impulse;
use num_complex::Complex64;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;

use super::window::{Pixel, Window};
use super::{Contender, kernel, oracle_of};

/// The axes of the curves: the index of the coefficient, the number of events in a pixel, and T in us.
pub const AXES: [&str; 3] = ["k", "n", "T"];

/// Values of T in us: decades up to an hour, powers of two and their neighbours, primes, and the longest T.
const DURATIONS_US: [u32; 45] = [
    1,
    2,
    3,
    5,
    7,
    10,
    16,
    31,
    33,
    63,
    100,
    127,
    257,
    511,
    1000,
    1021,
    1025,
    2048,
    4095,
    10_000,
    16_381,
    32_767,
    32_768,
    32_769,
    33_333,
    65_537,
    100_000,
    262_143,
    262_144,
    999_983,
    1_000_000,
    2_097_143,
    4_194_305,
    10_000_000,
    16_777_213,
    33_554_431,
    60_000_000,
    134_217_729,
    268_435_399,
    536_870_912,
    1_000_000_007,
    1_800_000_000,
    2_147_483_649,
    3_600_000_000,
    u32::MAX,
];

/// Maximum number of events in a pixel.
const EVENTS_MAX: usize = 65_535;
const SEED: u64 = 1;

/// How much is measured.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Number of random places in each window, in addition to the fixed ones.
    pub random: usize,
    /// Largest denominator b of the places u = a / b.
    pub denominators: u32,
    /// Maximum number of events in a pixel.
    pub events: usize,
}

impl Effort {
    /// The effort for published figures.
    pub const FULL: Self = Self {
        random: 700,
        denominators: 12,
        events: EVENTS_MAX,
    };
    /// The effort that suffices to see whether everything works.
    pub const QUICK: Self = Self {
        random: 8,
        denominators: 2,
        events: 4096,
    };
}

/// One point of a curve; the fields are its JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Row {
    /// Name of the kernel.
    pub kernel: &'static str,
    /// `dct`, `dtft` or `dwt`.
    pub transform: &'static str,
    /// One of [`AXES`].
    pub axis: &'static str,
    /// Position on the axis. On the axis k, the row covers the coefficients after those of the row before, up to and
    /// including this one.
    pub value: u32,
    /// Largest |c_k - c_ref| / n over all pixels and all k.
    pub max_error_per_event: f64,
    /// Root mean square of the same. On the axis n it leaves out the pixel whose events are all at one time.
    pub rms_error_per_event: f64,
    /// Documented bound on the error per event.
    pub bound: f64,
}

/// Accumulates the errors of one point of a curve.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    max: f64,
    square_sum: f64,
    count: u64,
}

impl Tally {
    fn add(&mut self, error: f64) {
        self.add_max(error);
        self.square_sum += error * error;
        self.count += 1;
    }

    /// Takes the error into the maximum, but not into the mean square. NaN counts as infinite.
    fn add_max(&mut self, error: f64) {
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.max = self.max.max(error);
    }

    fn merge(&mut self, other: Self) {
        self.max = self.max.max(other.max);
        self.square_sum += other.square_sum;
        self.count += other.count;
    }

    fn row(self, kernel: Kernel, transform: Transform, axis: &'static str, value: u32) -> Row {
        Row {
            kernel: kernel.name(),
            transform: transform.name(),
            axis,
            value,
            max_error_per_event: self.max,
            rms_error_per_event: (self.square_sum / self.count.max(1) as f64).sqrt(),
            bound: bound(kernel),
        }
    }
}

/// Returns the documented bound on the error per event of a coefficient of `kernel`, which [`check`] enforces; 0 for
/// an exact kernel.
#[must_use]
pub fn bound(kernel: Kernel) -> f64 {
    let log2 = kernel.error_log2();
    log2.map_or(0.0, |log2| f64::from(log2).exp2())
}

/// Returns offsets in us, ascending, without duplicates and below `duration_us`, that test a window of that length.
///
/// They are the eight offsets at each end of the window, the fractions a / b of the window with b up to
/// `denominators`, each with its two neighbours, and `random` random offsets, which are the same in every call.
#[must_use]
pub fn offsets(duration_us: u32, denominators: u32, random: usize) -> Vec<u32> {
    let mut generator = Xoshiro256PlusPlus::seed_from_u64(SEED ^ u64::from(duration_us));
    let mut offsets: Vec<u32> = (0..8).collect();
    offsets.extend((1..=8).map(|back| duration_us.saturating_sub(back)));
    for b in 1..=denominators {
        for a in 0..b {
            let at = (u64::from(a) * u64::from(duration_us) / u64::from(b)) as u32;
            offsets.extend([at.saturating_sub(1), at, at.saturating_add(1)]);
        }
    }
    let below = |random: u64| (((random >> 32) * u64::from(duration_us)) >> 32) as u32;
    offsets.extend((0..random).map(|_| below(generator.next_u64())));
    offsets.retain(|offset| *offset < duration_us);
    offsets.sort_unstable();
    offsets.dedup();
    offsets
}

/// Returns how many times [`measure`] calls `progress`.
#[must_use]
pub fn steps() -> usize {
    Transform::ALL.len() * (DURATIONS_US.len() + 1)
}

/// Measures the curves of every kernel of every transform.
///
/// `progress` is called for each transform: after each T, and at the end of the curve over n.
#[must_use]
pub fn measure(effort: Effort, progress: &mut dyn FnMut()) -> Vec<Row> {
    let mut rows = Vec::new();
    for transform in Transform::ALL {
        rows.extend(over_k_and_t(transform, effort, progress));
        rows.extend(over_n(transform, effort));
        progress();
    }
    rows
}

/// Checks that every point is within its documented bound.
///
/// # Errors
/// Fails at the first point that is not; the message names the kernel and the position on the axis.
pub fn check(rows: &[Row]) -> Result<()> {
    for row in rows {
        ensure!(
            row.max_error_per_event <= row.bound,
            "{} {} at {} = {}: off by {:e} per event, more than the documented {:e}; please report \
             this",
            row.kernel,
            row.transform,
            row.axis,
            row.value,
            row.max_error_per_event,
            row.bound
        );
    }
    Ok(())
}

/// Returns the core's kernels of a transform, each with an empty `T` in which its results are gathered.
fn contenders<T: Default>(
    transform: Transform,
    grid: usize,
) -> Vec<(Kernel, Box<dyn Contender>, T)> {
    let kernels = kernel::kernels(transform, grid).into_iter();
    kernels
        .filter_map(|contender| Some((contender.kernel()?, contender, T::default())))
        .collect()
}

/// Returns |c_k - c_ref| of a pixel for k = 1, 2, ...
fn errors<'e>(
    contender: &mut dyn Contender,
    pixel: Pixel<'_>,
    expected: &'e [Complex64],
) -> impl Iterator<Item = f64> + 'e {
    let found = contender.coefficients(pixel).unwrap_or_default();
    let errors = found.into_iter().zip(expected);
    errors
        .skip(1)
        .map(|(found, expected)| (found - expected).norm())
}

/// Measures the curves over k and over T, with a single event at many offsets in windows of every length.
fn over_k_and_t(transform: Transform, effort: Effort, progress: &mut dyn FnMut()) -> Vec<Row> {
    let mut contenders = contenders::<(Vec<Tally>, Vec<Tally>)>(transform, GRID_MAX);
    for (_, _, (by_k, by_t)) in &mut contenders {
        by_k.resize(GRID_MAX, Tally::default());
        by_t.resize(DURATIONS_US.len(), Tally::default());
    }
    for (t, duration_us) in DURATIONS_US.into_iter().enumerate() {
        for offset_us in offsets(duration_us, effort.denominators, effort.random) {
            let impulse = single(offset_us);
            let window = Window::new(duration_us, [vec![impulse]]);
            let expected = oracle_of(transform).coefficients(&[impulse], duration_us, GRID_MAX);
            for pixel in window.pixels() {
                for (_, contender, (by_k, by_t)) in &mut contenders {
                    let errors = errors(contender.as_mut(), pixel, &expected);
                    for (error, by_k) in errors.zip(by_k.iter_mut().skip(1)) {
                        by_k.add(error);
                        by_t[t].add(error);
                    }
                }
            }
        }
        progress();
    }
    let mut rows = Vec::new();
    for (kernel, _, (by_k, by_t)) in contenders {
        let mut next = 1;
        for last in bands() {
            let mut all = Tally::default();
            for tally in by_k.iter().take(last + 1).skip(next) {
                all.merge(*tally);
            }
            rows.push(all.row(kernel, transform, "k", last as u32));
            next = last + 1;
        }
        for (tally, duration_us) in by_t.into_iter().zip(DURATIONS_US) {
            rows.push(tally.row(kernel, transform, "T", duration_us));
        }
    }
    rows
}

/// Returns the last coefficient of each row over k: every coefficient up to 23, then about eight rows per octave.
fn bands() -> impl Iterator<Item = usize> {
    let mut last = 0;
    std::iter::from_fn(move || {
        last = (last + 1).max((last as f64 * 0.125_f64.exp2()) as usize);
        Some(last.min(GRID_MAX - 1))
    })
    .scan(0, |before, last| {
        (last > *before).then(|| {
            *before = last;
            last
        })
    })
}

/// Returns an event whose polarity depends on its offset.
fn single(offset_us: u32) -> Impulse {
    Impulse {
        offset_us,
        p: if offset_us.is_multiple_of(3) {
            -1.0
        } else {
            1.0
        },
    }
}

/// Measures the curve over n for M = 64, with the n events all at the kernel's own worst place, evenly spaced, and
/// at random.
fn over_n(transform: Transform, effort: Effort) -> Vec<Row> {
    let grid = usize::from(transform.grid_size(M_MAX as u8, None));
    let mut rows = Vec::new();
    let mut contenders = contenders::<Worst>(transform, grid);
    for duration_us in DURATIONS_US {
        for offset_us in offsets(duration_us, effort.denominators, effort.random / 4) {
            let impulse = single(offset_us);
            let window = Window::new(duration_us, [vec![impulse]]);
            let expected = oracle_of(transform).coefficients(&[impulse], duration_us, grid);
            for pixel in window.pixels() {
                for (_, contender, worst) in &mut contenders {
                    for error in errors(contender.as_mut(), pixel, &expected) {
                        if error > worst.error {
                            *worst = Worst {
                                error,
                                duration_us,
                                offset_us,
                            };
                        }
                    }
                }
            }
        }
    }
    let mut generator = Xoshiro256PlusPlus::seed_from_u64(SEED);
    for n in counts(effort.events) {
        let apart = apart(n, &mut generator);
        let expected: Vec<_> = apart
            .iter()
            .map(|(duration_us, events)| {
                oracle_of(transform).coefficients(&merged(events), *duration_us, grid)
            })
            .collect();
        for (kernel, contender, worst) in &mut contenders {
            let mut tally = Tally::default();
            for ((duration_us, events), expected) in apart.iter().zip(&expected) {
                let window = Window::new(*duration_us, [events.clone()]);
                for pixel in window.pixels() {
                    for error in errors(contender.as_mut(), pixel, expected) {
                        tally.add(error / n as f64);
                    }
                }
            }
            let together = vec![single(worst.offset_us); n];
            let expected =
                oracle_of(transform).coefficients(&merged(&together), worst.duration_us, grid);
            let window = Window::new(worst.duration_us, [together]);
            for pixel in window.pixels() {
                for error in errors(contender.as_mut(), pixel, &expected) {
                    tally.add_max(error / n as f64);
                }
            }
            rows.push(tally.row(*kernel, transform, "n", n as u32));
        }
    }
    // Sorted by kernel, as the rows of the other axes are.
    let order = |row: &Row| {
        contenders
            .iter()
            .position(|(kernel, ..)| kernel.name() == row.kernel)
    };
    rows.sort_by_key(order);
    rows
}

/// The place at which the error of a single event is largest.
#[derive(Debug, Clone, Copy)]
struct Worst {
    error: f64,
    duration_us: u32,
    offset_us: u32,
}

impl Default for Worst {
    fn default() -> Self {
        Self {
            error: 0.0,
            duration_us: 1,
            offset_us: 0,
        }
    }
}

/// Returns 1, 2, 4, ..., and finally `most`.
fn counts(most: usize) -> impl Iterator<Item = usize> {
    let powers = (0..usize::BITS).map(|log2| 1_usize << log2);
    powers.take_while(move |n| *n < most).chain([most])
}

/// Returns T and events of four pixels with n events at different times: two with ON events evenly spaced over the
/// window, and two with random events.
fn apart(n: usize, generator: &mut Xoshiro256PlusPlus) -> Vec<(u32, Vec<Impulse>)> {
    let even = |duration_us: u32| {
        let at = |i: usize| (i as u64 * u64::from(duration_us) / n as u64) as u32;
        let event = |i| Impulse {
            offset_us: at(i),
            p: 1.0,
        };
        (duration_us, (0..n).map(event).collect())
    };
    let mut random = |duration_us: u32| {
        let events = (0..n).map(|_| {
            let random = generator.next_u64();
            Impulse {
                offset_us: (((random >> 32) * u64::from(duration_us)) >> 32) as u32,
                p: if random & 1 == 0 { 1.0 } else { -1.0 },
            }
        });
        (duration_us, events.collect())
    };
    vec![even(32_768), even(999_983), random(32_768), random(33_333)]
}

/// Merges the events of each time into one impulse whose p is their sum. The coefficients stay the same.
fn merged(events: &[Impulse]) -> Vec<Impulse> {
    let mut by_time = BTreeMap::new();
    for event in events {
        *by_time.entry(event.offset_us).or_insert(0.0) += event.p;
    }
    let impulse = |(offset_us, p)| Impulse { offset_us, p };
    by_time.into_iter().map(impulse).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_end_with_the_last_coefficient() {
        let bands: Vec<usize> = bands().collect();
        assert_eq!(bands[..13], [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13]);
        assert_eq!(bands.last(), Some(&(GRID_MAX - 1)));
        assert!(bands.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(bands.len() < 80, "{}", bands.len());
    }

    #[test]
    fn counts_double_and_end_with_the_most() {
        assert_eq!(counts(5).collect::<Vec<_>>(), [1, 2, 4, 5]);
        assert_eq!(counts(4).collect::<Vec<_>>(), [1, 2, 4]);
        assert_eq!(counts(EVENTS_MAX).count(), 17);
    }

    #[test]
    fn offsets_are_inside_of_the_window_and_the_same_again() {
        assert_eq!(offsets(1, 12, 100), [0]);
        assert_eq!(offsets(2, 12, 100), [0, 1]);
        let last = u32::MAX - 1;
        let found = offsets(u32::MAX, 2, 5);
        for offset in [0, 7, last / 2, last / 2 + 1, last] {
            assert!(found.contains(&offset), "{offset}");
        }
        assert_eq!(found, offsets(u32::MAX, 2, 5));
    }

    #[test]
    fn merged_events_have_the_same_coefficients() {
        let mut generator = Xoshiro256PlusPlus::seed_from_u64(2);
        let (_, events) = apart(100, &mut generator).remove(3);
        let twice = [&events[..], &events[..]].concat();
        for transform in Transform::ALL {
            let oracle = oracle_of(transform);
            let expected = oracle.coefficients(&twice, 33_333, 16);
            let found = oracle.coefficients(&merged(&twice), 33_333, 16);
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).norm() < 1e-10);
            }
        }
    }

    #[test]
    fn every_kernel_is_among_the_contenders() {
        let found = Transform::ALL.into_iter().flat_map(|transform| {
            let kernels = contenders::<()>(transform, 8).into_iter();
            kernels.map(|(kernel, ..)| kernel)
        });
        let found: Vec<_> = found.collect();
        for kernel in Kernel::ALL {
            assert!(found.contains(&kernel), "{kernel:?}");
        }
    }

    #[test]
    fn a_kernel_beyond_its_bound_is_named() {
        let mut tally = Tally::default();
        tally.add(bound(Kernel::Table));
        let mut row = tally.row(Kernel::Table, Transform::Dct, "T", 1000);
        check(&[row]).unwrap();
        row.max_error_per_event *= 1.001;
        let message = check(&[row]).unwrap_err().to_string();
        for part in ["table", "dct", "T = 1000"] {
            assert!(message.contains(part), "{message}");
        }
        // NaN does not pass as a small error.
        tally.add_max(f64::NAN);
        let row = tally.row(Kernel::Table, Transform::Dct, "k", 1);
        assert!(check(&[row]).is_err());
    }
}
