//! Complex exponential sums: Fourier coefficients of each pixel at given frequencies.
//!
//! ```text
//! c_k[y, x] = sum over the pixel's events of p exp(-i 2 pi f_k u)      u = (t - start) / T
//! ```
//!
//! for k = 0 .. M - 1 and every window that has events. A [`Law`] known to sender and receiver gives the
//! frequencies f_k in turns per window. The paper compares itself with a method of this name. The real and the
//! imaginary part of every coefficient are numbers of the array: f32, or i16 or i8 times a step. The step is one
//! f32 per window: the largest of its numbers over the type's largest number. [`super::pursuit`] is the decoder.

use std::f64::consts::TAU;

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::Sensor;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::dense_array::{Active, Array, Window};
use super::pursuit::{Pursuit, Work};
use super::representation::{Found, Representation};
use super::stored::Range;

/// Seed of the generator.
const SEED: u64 = 42;
/// Standard deviation of [`Law::LowFrequency`] over M, in turns per window. The test `ces_spreads` measures the
/// errors of other values: with lower frequencies close events cannot be resolved, with higher ones times become
/// ambiguous.
const DEVIATION: f64 = 0.25;
/// Standard deviation of [`Law::PaperCode`] in Hz.
const DEVIATION_HZ: f64 = 0.5;

/// How the frequencies are drawn; they are then sorted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Law {
    /// f_0 = 0, so that c_0 is the signed sum; the others are |Normal(0, M / 4)| turns per window.
    LowFrequency,
    /// Normal(0, 0.5) Hz, as in the paper's published code. In a window of 33 ms these are hundredths of a turn:
    /// every coefficient is nearly the signed sum and carries hardly any timing, as the test `ces_spreads` shows.
    PaperCode,
}

impl Law {
    /// Returns `m` frequencies in ascending order, in turns per window.
    #[must_use]
    pub fn frequencies(self, m: usize) -> Vec<f64> {
        match self {
            Self::LowFrequency => low_frequencies(m, DEVIATION),
            Self::PaperCode => {
                let deviation = DEVIATION_HZ * f64::from(WINDOW_US) * 1e-6;
                let mut generator = Xoshiro256PlusPlus::seed_from_u64(SEED);
                let normals = (0..m).map(|_| normal(&mut generator));
                sorted(normals.map(|normal| deviation * normal).collect())
            }
        }
    }
}

/// Returns 0 and `m - 1` other frequencies, whose standard deviation is `deviation` times `m` turns per window.
fn low_frequencies(m: usize, deviation: f64) -> Vec<f64> {
    let deviation = deviation * m as f64;
    let mut generator = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let others = (1..m).map(|_| (deviation * normal(&mut generator)).abs());
    sorted((0..m.min(1)).map(|_| 0.0).chain(others).collect())
}

fn sorted(mut frequencies: Vec<f64>) -> Vec<f64> {
    frequencies.sort_by(f64::total_cmp);
    frequencies
}

/// Returns a standard normal number (Box and Muller), the same on every machine.
fn normal(generator: &mut impl Rng) -> f64 {
    // Above 0 and at most 1, so that the logarithm is finite.
    let mut unit = || ((generator.next_u64() >> 11) + 1) as f64 / (1_u64 << 53) as f64;
    let radius = libm::sqrt(-2.0 * libm::log(unit()));
    radius * libm::cos(TAU * unit())
}

/// Computes CES coefficients.
#[derive(Debug, Clone)]
pub struct Ces {
    active: Active,
    /// 2 pi f_k / T, in radians per us.
    turns_per_us: Vec<f64>,
    pursuit: Pursuit,
}

impl Ces {
    /// Computes `m` coefficients per pixel; 0 is taken as 1.
    #[must_use]
    pub fn new(sensor: Sensor, m: usize, law: Law) -> Self {
        Self::of(sensor, &law.frequencies(m.max(1)))
    }

    /// Uses the given frequencies, at least one, in turns per window.
    fn of(sensor: Sensor, frequencies: &[f64]) -> Self {
        let turns = frequencies.iter().map(|f| TAU * f / f64::from(WINDOW_US));
        Self {
            active: Active::new(sensor),
            turns_per_us: turns.collect(),
            pursuit: Pursuit::new(frequencies),
        }
    }
}

impl Representation for Ces {
    type Work = Work;

    fn channels(&self) -> usize {
        2 * self.turns_per_us.len()
    }

    fn range(&self) -> Range {
        Range::Signed
    }

    fn has_times(&self) -> bool {
        self.turns_per_us.iter().any(|turns| *turns != 0.0)
    }

    fn make(&mut self, window: &Window<'_>) -> Array {
        let channels = self.channels();
        self.active.sums(window.events, channels, |event, numbers| {
            let since_us = f64::from(window.since_us(event.t_us));
            let sign = f64::from(event.polarity.sign());
            let coefficients = numbers.chunks_exact_mut(2);
            for (coefficient, turns_per_us) in coefficients.zip(&self.turns_per_us) {
                let (sin, cos) = (turns_per_us * since_us).sin_cos();
                if let [re, im] = coefficient {
                    *re += sign * cos;
                    *im -= sign * sin;
                }
            }
        })
    }

    fn decode(&self, numbers: &[f64], step: f64, work: &mut Work, found: &mut Vec<Found>) {
        self.pursuit.find(numbers, step, work, found);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use eecvs_bench::marks::of_project;
    use eecvs_bench::source::{Memory, Source};
    use eecvs_nostd::Event;
    use event_emulator::Preset;
    use event_metrics::compare;
    use event_types::test_events::{SENSOR, event};

    use super::*;
    use crate::baseline::dense_array::windows;
    use crate::baseline::stored::Stored;
    use crate::baseline::tests::{decoded, source};

    #[test]
    fn coefficients_are_those_of_the_definition() {
        let events = [
            event(0, 3, 2, true),
            event(8192, 3, 2, false),
            event(9000, 5, 2, false),
        ];
        let source = source(&events);
        let window = windows(&source).next().unwrap();
        let mut ces = Ces::new(SENSOR, 4, Law::LowFrequency);
        let array = ces.make(&window);
        assert_eq!(array.pixels, [2 * 64 + 3, 2 * 64 + 5]);
        let frequencies = Law::LowFrequency.frequencies(4);
        for (k, f) in frequencies.iter().enumerate() {
            // 1 - exp(-i 2 pi f / 4).
            let (sin, cos) = (TAU * f / 4.0).sin_cos();
            assert!((array.values[2 * k] - (1.0 - cos)).abs() < 1e-12);
            assert!((array.values[2 * k + 1] - sin).abs() < 1e-12);
        }
        assert_eq!(array.values[8..10], [-1.0, 0.0]);
    }

    #[test]
    fn frequencies_are_drawn_by_their_law() {
        let low = Law::LowFrequency.frequencies(255);
        assert_eq!(low[0], 0.0);
        assert!(low.is_sorted() && low[1] > 0.0 && low.len() == 255);
        let square: f64 = low.iter().map(|f| f * f).sum::<f64>() / 254.0;
        let deviation = square.sqrt() / 255.0;
        assert!(
            (0.85 * DEVIATION..1.15 * DEVIATION).contains(&deviation),
            "{deviation}"
        );
        let paper = Law::PaperCode.frequencies(255);
        let mean = paper.iter().sum::<f64>() / 255.0;
        let hz = 1e6 / f64::from(WINDOW_US);
        assert!((mean * hz).abs() < 0.1, "{mean}");
        assert!(paper.iter().any(|f| *f < 0.0));
        assert!(paper.iter().all(|f| (f * hz).abs() < 2.5));
        for law in [Law::LowFrequency, Law::PaperCode] {
            assert!(law.frequencies(0).is_empty());
            assert_eq!(law.frequencies(16), law.frequencies(16));
        }
    }

    #[test]
    fn events_far_enough_apart_are_exact() {
        let events = [
            event(0, 3, 2, true),
            event(4000, 5, 2, true),
            event(8192, 3, 2, false),
            event(17_001, 3, 2, false),
            event(32_700, 3, 2, true),
        ];
        for m in [16, 24, 32] {
            let mut ces = Ces::new(SENSOR, m, Law::LowFrequency);
            let found = decoded(&mut ces, &source(&events), Stored::F32);
            assert_eq!(found, events, "{m}");
            // In 16 bits, a coefficient of up to 4 has an error of up to 6e-5.
            let found = decoded(&mut ces, &source(&events), Stored::Bits16);
            assert_eq!(found.len(), events.len());
            for (found, event) in found.iter().zip(&events) {
                assert!(found.t_us.abs_diff(event.t_us) <= 2, "{m}: {found:?}");
            }
        }
    }

    #[test]
    fn the_papers_frequencies_hardly_tell_times() {
        // Two pairs with the same sum and the same mean time: 24 ms apart, and 2 ms apart.
        let largest_difference = |law| -> f64 {
            let [far, near] = [[4000, 28_000], [15_000, 17_000]].map(|times| {
                let events = [event(0, 9, 9, true)].into_iter();
                let events = events.chain(times.map(|t_us| event(t_us, 3, 2, true)));
                let source = source(&events.collect::<Vec<_>>());
                let window = windows(&source).next().unwrap();
                Ces::new(SENSOR, 16, law).make(&window).values
            });
            let pairs = far.iter().zip(&near);
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        // The step of two events in 8 bits.
        assert!(largest_difference(Law::PaperCode) < 2.0 / 127.0);
        assert!(largest_difference(Law::LowFrequency) > 1.0);
    }

    /// Computes `emd_pixel_us` for half a second of the scene `indoor-flying` with M = 16, by the spread of the
    /// frequencies: the figures quoted in METHODOLOGY.md.
    #[test]
    #[ignore = "takes a minute; prints the figures of METHODOLOGY.md"]
    fn ces_spreads() {
        let source = Source::scene(Preset::IndoorFlying, 1, 500_000).unwrap();
        let error_us = |frequencies: &[f64], stored| {
            let events: Arc<[Event]> =
                decoded(&mut Ces::of(source.sensor, frequencies), &source, stored).into();
            let found = compare(
                &|| Ok(Box::new(source.reader())),
                &|| Ok(Box::new(Memory::new(source.sensor, Arc::clone(&events)))),
                WINDOW_US.into(),
                &mut |_| (),
            );
            found.unwrap().emd_pixel_us
        };
        let methodology = of_project("METHODOLOGY.md").replace('\n', " ");
        let mut errors = Vec::new();
        for spread in [1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0, 1.0] {
            let found = error_us(&low_frequencies(16, spread), Stored::Bits16);
            println!("|N(0, {spread} M)| turns a window, i16: emd_pixel {found:.0} us");
            errors.push(found);
        }
        let paper = error_us(&Law::PaperCode.frequencies(16), Stored::F32);
        println!("N(0, {DEVIATION_HZ} Hz), f32: emd_pixel {paper:.0} us");
        let [least, chosen, twice, most] = errors[..] else {
            panic!("four spreads");
        };
        assert!(chosen < least.min(twice).min(most).min(paper));
        let quoted = format!(
            "leave {least:.0}, {chosen:.0}, {twice:.0} and {most:.0} us, and the other law, in f32, {paper:.0} us"
        );
        assert!(methodology.contains(&quoted), "METHODOLOGY.md: {quoted}");
    }

    #[test]
    fn one_coefficient_keeps_the_signed_count_alone() {
        let events = [
            event(0, 3, 2, true),
            event(1, 3, 2, true),
            event(2, 3, 2, false),
        ];
        let mut ces = Ces::new(SENSOR, 1, Law::LowFrequency);
        assert!(!ces.has_times());
        let found = decoded(&mut ces, &source(&events), Stored::F32);
        assert_eq!(found, [event(16_384, 3, 2, true)]);
    }
}
