//! Recovers a pixel's event times from its coefficients; this module runs the stages in order.
//!
//! ```text
//! crowd  <- too many events -- equations -> pairs, pursuit, refined, pencil, Newton -> refine -> lattice
//!                                        -> ensemble (many events) ------------------------^
//! ```
//!
//! Starting points ([`super::pursuit`], [`super::prony`]) are tried one after the other until one, refined by
//! least squares ([`super::refine`]), explains the coefficients to within the quantisation error. Its times move to the
//! microsecond grid ([`super::lattice`]), where they are verified by encoding them again; unless no others encode to the
//! same, they first move to the centre of the possible times. With many events the coefficients have many solutions, and
//! their median is taken ([`super::ensemble`]). Pixels with too many events for that get the flattest densities
//! ([`super::crowd`]).

use eecvs_nostd::{Header, Polarity};
use serde::Serialize;

use super::Pixel;
use super::crowd::Densities;
use super::equations::Equations;
use super::lattice::{self, Agreed, Lattice};
use super::pursuit::Peaks;
use super::refine::{
    LEAST_SQUARES_ROUNDS, Patience, RMS_QUANTISED, RMS_SOLVED, Work, centre, largest,
    least_squares, rms,
};
use super::{cost, ensemble, prony};

/// Largest number of events whose times are solved for one by one.
pub const EVENTS_MAX: usize = 40;
/// Largest ratio, in fifths, of such events to the numbers sent. With more unknowns than equations there are many
/// solutions, but one from the right starting point is still closer than no solution.
const EVENTS_FIFTHS: u64 = 8;
/// Number of events from which the median of many solutions is taken.
pub(super) const MEDIAN_FROM: usize = 17;
/// Largest number of events for which pairs are tried, and for which least squares go on as long as there is progress.
pub(super) const PAIRED_EVENTS_MAX: usize = 8;
/// Rounds of least squares for a crowded pixel, and the largest number of events of a crowded pixel that is
/// refined.
pub(super) const CROWD_ROUNDS: usize = 4;
pub(super) const CROWD_EVENTS_MAX: usize = 64;

/// Confidence in a pixel's event times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Confidence {
    /// The times encode to exactly what was received, and no neighbouring times that were searched do: with up to 4
    /// events all times within 1 or 2 us, with more all moves of one or two events by 1 us.
    Exact,
    /// The times encode to exactly what was received, but so do other times nearby; with up to 4 events these are
    /// near the mean of the times found.
    Consistent,
    /// The times are the best explanation of the coefficients that was found.
    Approximate,
}

impl Confidence {
    /// Returns the confidence of times that encode to what was received.
    const fn of(is_unique: bool) -> Self {
        if is_unique {
            Self::Exact
        } else {
            Self::Consistent
        }
    }
}

/// Number of pixels by the confidence of their times; the fields are JSON keys.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Confidences {
    /// Pixels with [`Confidence::Exact`].
    pub pixels_exact: u64,
    /// Pixels with [`Confidence::Consistent`].
    pub pixels_consistent: u64,
    /// Pixels with [`Confidence::Approximate`], which includes all pixels whose times are not verified.
    pub pixels_approximate: u64,
    /// Of these, pixels whose times were not sought, because the window's work was at its
    /// [`WorkLimit`](crate::work_limit::WorkLimit); their events are spread by the lowest coefficients.
    pub pixels_over_work_limit: u64,
}

impl Confidences {
    /// Adds one pixel with this confidence.
    pub const fn count(&mut self, confidence: Confidence) {
        match confidence {
            Confidence::Exact => self.pixels_exact += 1,
            Confidence::Consistent => self.pixels_consistent += 1,
            Confidence::Approximate => self.pixels_approximate += 1,
        }
    }

    /// Adds the counts of `others` to these.
    pub const fn add(&mut self, others: Self) {
        self.pixels_exact += others.pixels_exact;
        self.pixels_consistent += others.pixels_consistent;
        self.pixels_approximate += others.pixels_approximate;
        self.pixels_over_work_limit += others.pixels_over_work_limit;
    }

    /// Returns one line about the pixels whose times were not sought, or `None` if there are none.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let pixels = self.pixels_over_work_limit;
        (pixels > 0).then(|| {
            format!(
                "the times of {pixels} pixels are rough: finding them is more work than \
                 --max-work-per-window allows"
            )
        })
    }
}

/// Recovered events of a pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Recovered {
    /// Offsets from the start of the window in microseconds, below T; those of the ON events come first.
    pub offsets_us: Vec<u32>,
    /// Confidence in the offsets.
    pub confidence: Confidence,
    /// Largest deviation from a received coefficient, in quantiser steps; up to 0.5 is explained by rounding.
    /// `None` if it was not computed.
    pub residual_steps: Option<f64>,
}

/// Returns whether a pixel has too many events for its equations: their times are not solved for one by one.
pub(super) const fn is_crowded(events: u64, rows: u64) -> bool {
    events > EVENTS_MAX as u64 || 5 * events > EVENTS_FIFTHS * rows
}

/// Recovers the events of a pixel of the DCT or the DTFT, of which at most a single one's time is sent. The work is
/// bounded, whatever the coefficients are.
#[must_use]
pub fn pixel(header: &Header, peaks: &Peaks, pixel: &Pixel, work: &mut Work) -> Recovered {
    if let [(u, _)] = pixel.times[..] {
        let (offset_us, is_unique) = lattice::single(header, u);
        return Recovered {
            offsets_us: vec![offset_us],
            confidence: Confidence::of(is_unique),
            residual_steps: None,
        };
    }
    work.spend(cost::PIXEL);
    let equations = Equations::new(header, pixel);
    let events = equations.events();
    if is_crowded(events as u64, equations.rows() as u64) {
        return crowded(equations, work);
    }
    let equations = equations.with_signs();
    let times = if events >= MEDIAN_FROM {
        let peaks = Some((peaks, pixel));
        ensemble::times(&equations, peaks, LEAST_SQUARES_ROUNDS, work)
    } else {
        fitted(&equations, peaks, pixel, work)
    };
    if rms(&equations, &times, work) < RMS_SOLVED {
        let mut lattice = Lattice::new(header, &equations);
        // Where no other times agree, it does not matter where the search for them begins.
        let near = offsets_us(&equations, &times);
        let found = |agreed: Agreed, work: &mut Work| Recovered {
            confidence: Confidence::of(agreed.is_unique),
            residual_steps: residual_steps(&equations, &agreed.offsets, work),
            offsets_us: agreed.offsets,
        };
        let any = lattice.any(&near, work);
        if let Some(agreed) = any.clone().filter(|agreed| agreed.is_unique) {
            return found(agreed, work);
        }
        let mut middle = times;
        centre(&equations, &mut middle, work);
        if let Some(agreed) = lattice.agree(&offsets_us(&equations, &middle), work) {
            return found(agreed, work);
        }
        return match any.and_then(|_| lattice.agree(&near, work)) {
            Some(agreed) => found(agreed, work),
            None => approximate(&equations, &middle, work),
        };
    }
    approximate(&equations, &times, work)
}

/// Starting points of least squares, in the order in which they are tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Start {
    Pairs,
    Once,
    Peaks,
    RefinedPeaks,
    Pencil,
    Newton,
    Densities,
}

impl Start {
    /// The order for a number of events: mostly, it does to place each once. Of two, one may hide the other, and all
    /// pairs of points are looked at sooner than one point after the other.
    const fn order(events: usize) -> [Self; 7] {
        let [first, second, third] = match events {
            0..=2 => [Self::Pairs, Self::Once, Self::Peaks],
            _ => [Self::Once, Self::Peaks, Self::Pairs],
        };
        [
            first,
            second,
            third,
            Self::RefinedPeaks,
            Self::Pencil,
            Self::Newton,
            Self::Densities,
        ]
    }
}

/// Returns the first solution whose residual is down to the quantisation error, or the best of all solutions.
fn fitted(equations: &Equations, peaks: &Peaks, pixel: &Pixel, work: &mut Work) -> Vec<f64> {
    let mut best: Option<(f64, Vec<f64>)> = None;
    let events = equations.events();
    let patience = if events > PAIRED_EVENTS_MAX {
        Patience::Medium
    } else {
        Patience::Long
    };
    for start in Start::order(events) {
        let times = match start {
            Start::Pairs if events > PAIRED_EVENTS_MAX => None,
            Start::Pairs => peaks.paired(pixel, work),
            Start::Once => Some(peaks.once(pixel, work)),
            Start::Peaks => Some(peaks.times(pixel, work)),
            Start::RefinedPeaks => Some(peaks.refined(pixel, equations, work)),
            Start::Pencil => prony::pencil(equations, work),
            Start::Newton => prony::newton(equations, work),
            Start::Densities => Some(Densities::flattest(equations, work).times(0.5)),
        };
        let Some(mut times) = times else {
            continue;
        };
        least_squares(
            equations,
            &mut times,
            (LEAST_SQUARES_ROUNDS, patience),
            work,
        );
        let rms = rms(equations, &times, work);
        if rms < RMS_QUANTISED {
            return times;
        }
        if best.as_ref().is_none_or(|(least, _)| rms < *least) {
            best = Some((rms, times));
        }
    }
    best.map(|(_, times)| times).unwrap_or_default()
}

fn crowded(equations: Equations, work: &mut Work) -> Recovered {
    work.spend(equations.size().placed());
    if equations.events() > CROWD_EVENTS_MAX {
        let times = Densities::flattest(&equations, work).times(0.5);
        return Recovered {
            offsets_us: offsets_us(&equations, &times),
            confidence: Confidence::Approximate,
            residual_steps: None,
        };
    }
    let equations = equations.with_signs();
    let times = ensemble::times(&equations, None, CROWD_ROUNDS, work);
    approximate(&equations, &times, work)
}

fn approximate(equations: &Equations, times: &[f64], work: &mut Work) -> Recovered {
    let offsets_us = offsets_us(equations, times);
    Recovered {
        residual_steps: residual_steps(equations, &offsets_us, work),
        offsets_us,
        confidence: Confidence::Approximate,
    }
}

/// Returns the events of a pixel that is sent as times. They are exact if each cell holds only one microsecond.
pub(super) fn few(header: &Header, pixel: &Pixel) -> Recovered {
    let cells = header.packing().timed_cells(pixel.on + pixel.off).count();
    let duration_us = u64::from(header.duration_us);
    // First microsecond of a cell.
    let first_us = |cell: u64| (cell * duration_us).div_ceil(cells.into());
    let cell = |u: f64| (u * f64::from(cells)) as u64;
    let is_unique = cells == header.duration_us
        || pixel.times.iter().all(|(u, _)| {
            let cell = cell(*u);
            first_us(cell + 1) == first_us(cell) + 1
        });
    let of = |polarity: Polarity| pixel.times.iter().filter(move |event| event.1 == polarity);
    let times = of(Polarity::On).chain(of(Polarity::Off));
    let offset_us = |u: f64| (u * f64::from(header.duration_us)).round() as u32;
    Recovered {
        offsets_us: times
            .map(|(u, _)| offset_us(*u).min(header.duration_us - 1))
            .collect(),
        confidence: Confidence::of(is_unique),
        residual_steps: None,
    }
}

fn offsets_us(equations: &Equations, times: &[f64]) -> Vec<u32> {
    times.iter().map(|u| equations.offset_us(*u)).collect()
}

fn residual_steps(equations: &Equations, offsets_us: &[u32], work: &mut Work) -> Option<f64> {
    let duration = f64::from(equations.duration_us);
    let times: Vec<f64> = offsets_us
        .iter()
        .map(|offset| f64::from(*offset) / duration)
        .collect();
    Some(largest(equations, &times, work) / (2.0 * equations.half_step))
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Transform;
    use proptest::prelude::*;

    use super::*;
    use crate::reconstruct::test_pixel;

    type Train = Vec<(u32, bool)>;

    fn recovered(header: &Header, events: &[(u32, bool)]) -> (Train, Recovered) {
        let peaks = Peaks::new(header.transform, header.grid.into(), header.m.into());
        let sent = test_pixel::pixel(header, events);
        let found = pixel(header, &peaks, &sent, &mut Work::default());
        let polarities = (0..).map(|i| i < sent.on);
        let mut train: Train = found.offsets_us.iter().copied().zip(polarities).collect();
        train.sort_unstable();
        (train, found)
    }

    fn sorted(events: &[(u32, bool)]) -> Train {
        let mut train = events.to_vec();
        train.sort_unstable();
        train
    }

    /// Generates events that are a part of the window apart, also across the end of the window.
    fn apart(duration_us: u32, most: usize) -> impl Strategy<Value = Train> {
        let gaps = proptest::collection::vec((8..40_u32, any::<bool>()), 2..=most);
        (gaps, 0..duration_us).prop_map(move |(gaps, start)| {
            let sum: u32 = gaps.iter().map(|(gap, _)| gap).sum();
            let mut at = u64::from(start);
            gaps.iter()
                .map(|(gap, is_on)| {
                    at += u64::from(*gap) * u64::from(duration_us) / u64::from(sum);
                    ((at % u64::from(duration_us)) as u32, *is_on)
                })
                .collect()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Events spaced at least a period of the highest atom apart are recovered exactly and reported as exact.
        #[test]
        fn trains_come_back_exactly_at_fine_steps(
            (duration_us, events) in (1000_u32..40_000).prop_flat_map(|t| (Just(t), apart(t, 6))),
            step_log2 in -15..=-10_i8,
        ) {
            let header = test_pixel::header(Transform::Dtft, 16, step_log2, duration_us);
            let (train, found) = recovered(&header, &events);
            prop_assert_eq!(train, sorted(&events), "{:?}", found);
            prop_assert_eq!(found.confidence, Confidence::Exact);
        }

        /// Times that are not reported as approximate encode to what was received.
        #[test]
        fn what_is_verified_encodes_to_what_was_received(
            events in proptest::collection::vec((0..5000_u32, any::<bool>()), 2..26),
            step_log2 in -15..=8_i8,
            m in 1..=20_u8,
            is_dct: bool,
        ) {
            let transform = if is_dct { Transform::Dct } else { Transform::Dtft };
            let header = test_pixel::header(transform, m, step_log2, 5000);
            let (train, found) = recovered(&header, &events);
            let on = |train: &Train| train.iter().filter(|event| event.1).count();
            prop_assert_eq!(train.len(), events.len());
            prop_assert_eq!(on(&train), on(&events));
            if found.confidence != Confidence::Approximate {
                let levels = |train: &Train| test_pixel::levels(&header, train);
                prop_assert_eq!(levels(&train), levels(&events));
            }
        }

        /// No coefficients cause a panic or times outside the window.
        #[test]
        fn any_coefficients_give_events_in_the_window(
            coefficients in proptest::collection::btree_map(
                1..64_u16, (prop_oneof![-30.0..30.0, -1e12..1e12], -30.0..30.0), 0..40),
            (on, off) in (0..30_u32, 0..30_u32),
            duration_us in prop_oneof![1..8_u32, any::<u32>().prop_map(|t| t.max(1))],
            step_log2 in -15..=8_i8,
            is_dct: bool,
        ) {
            let transform = if is_dct { Transform::Dct } else { Transform::Dtft };
            let header = test_pixel::header(transform, 64, step_log2, duration_us);
            let peaks = Peaks::new(transform, 64, 64);
            let sent = Pixel {
                x: 0,
                y: 0,
                on,
                off,
                coefficients: coefficients.into_iter().map(|(k, (re, im))| (k, re, im)).collect(),
                times: vec![],
            };
            let found = pixel(&header, &peaks, &sent, &mut Work::default());
            prop_assert_eq!(found.offsets_us.len() as u32, on + off);
            prop_assert!(found.offsets_us.iter().all(|offset| *offset < duration_us));
        }
    }

    #[test]
    fn events_a_microsecond_apart_come_back_within_four() {
        let header = test_pixel::header(Transform::Dtft, 16, -15, 32_768);
        for at in [100, 5_000, 16_383, 20_001, 30_000] {
            for is_on in [true, false] {
                let events = [(at, is_on), (at + 1, is_on)];
                let (train, found) = recovered(&header, &events);
                assert_ne!(found.confidence, Confidence::Approximate, "{events:?}");
                for (found, event) in train.iter().zip(&events) {
                    assert!(found.0.abs_diff(event.0) <= 4, "{events:?} {train:?}");
                }
            }
        }
    }

    /// The coefficients of two opposite events are at most 0.003, including the kernel's error.
    #[test]
    fn opposite_events_a_microsecond_apart_come_back_nearby() {
        let header = test_pixel::header(Transform::Dtft, 16, -15, 32_768);
        for at in [100, 5_000, 16_383, 20_001, 30_000] {
            let events = [(at, true), (at + 1, false)];
            let (train, _) = recovered(&header, &events);
            for (found, event) in train.iter().zip(&events) {
                assert!(found.0.abs_diff(event.0) <= 100, "{events:?} {train:?}");
            }
        }
    }

    #[test]
    fn equal_times_of_one_polarity_come_back() {
        let header = test_pixel::header(Transform::Dtft, 16, -12, 32_768);
        for copies in 2..=4 {
            let events = vec![(12_345, false); copies];
            let (train, _) = recovered(&header, &events);
            let worst = train.iter().map(|event| event.0.abs_diff(12_345)).max();
            assert!(worst <= Some(40), "{train:?}");
        }
    }

    /// The coefficients say nothing about the times, except that they are equal.
    #[test]
    fn opposite_signs_that_cancel_are_not_called_exact() {
        let header = test_pixel::header(Transform::Dtft, 16, -12, 32_768);
        let (train, found) = recovered(&header, &[(12_345, true), (12_345, false)]);
        assert_ne!(found.confidence, Confidence::Exact);
        assert!(train[0].0.abs_diff(train[1].0) <= 2, "{train:?}");
        // Next to a third event that can be recovered.
        let (train, _) = recovered(&header, &[(9000, true), (20_000, true), (9000, false)]);
        assert!(train.contains(&(20_000, true)), "{train:?}");
    }

    #[test]
    fn events_at_the_ends_of_the_window_come_back() {
        for transform in [Transform::Dct, Transform::Dtft] {
            let header = test_pixel::header(transform, 16, -12, 30_011);
            for events in [
                vec![(0, true), (15_000, false)],
                vec![(30_010, true), (15_000, false)],
                vec![(30_010, false), (9_000, false), (500, true)],
            ] {
                let (train, found) = recovered(&header, &events);
                // The DCT is flat at both ends: there, moving an event changes nothing.
                let most = if transform == Transform::Dct { 12 } else { 0 };
                for (found, event) in train.iter().zip(&sorted(&events)) {
                    assert!(found.0.abs_diff(event.0) <= most, "{transform:?} {train:?}");
                }
                assert_ne!(
                    found.confidence,
                    Confidence::Approximate,
                    "{transform:?} {events:?}"
                );
            }
        }
    }

    #[test]
    fn single_events_are_in_their_cell() {
        for (transform, step_log2, duration_us) in [
            (Transform::Dtft, -6, 32_768),
            (Transform::Dtft, -8, 32_768),
            (Transform::Dct, -10, 30_011),
            (Transform::Dtft, -15, 7),
        ] {
            let header = test_pixel::header(transform, 16, step_log2, duration_us);
            let peaks = Peaks::new(transform, 16, 16);
            let cells_log2 = header.packing().cells_log2();
            let cells = 1_u32 << cells_log2;
            let most = (duration_us >> cells_log2).div_ceil(2);
            for offset_us in [
                0,
                1,
                2,
                3,
                duration_us / 2,
                duration_us - 2,
                duration_us - 1,
            ] {
                let scale = eecvs_nostd::transform::phase::PhaseScale::new(duration_us);
                let cell = scale.half(offset_us).to_bits() >> (31 - cells_log2);
                let sent = Pixel {
                    times: vec![((f64::from(cell) + 0.5) / f64::from(cells), Polarity::On)],
                    ..test_pixel::pixel(&header, &[(offset_us, true)])
                };
                let found = pixel(&header, &peaks, &sent, &mut Work::default());
                assert!(
                    found.offsets_us[0].abs_diff(offset_us) <= most,
                    "{found:?} {offset_us}"
                );
                let of = |offset_us| scale.half(offset_us).to_bits() >> (31 - cells_log2);
                let alike = (0..duration_us).filter(|offset| of(*offset) == cell);
                let is_told = found.confidence == Confidence::Exact;
                assert_eq!(is_told, alike.count() == 1);
            }
        }
    }
}
