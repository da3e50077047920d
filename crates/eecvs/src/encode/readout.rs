//! Detects from a recording's first events how its sensor scans.
//!
//! If the sensor scans, the differences between the times of a line's events are multiples of the scan period,
//! whatever the line's phase. The scan frequency is where the spectrum of these differences, |sum exp(2 pi i f
//! difference)|, has its first high peak; the period is then refined over longer and longer differences. The slope
//! is the phase shift from line to line. The encoder decides for each window whether the detected readout makes it
//! shorter, and uses it only then.

use std::f64::consts::TAU;
use std::ops::Range;

use eecvs_nostd::{Axis, Coder, Config, Event, Fidelity, Hybrid, Mode, Readout, Sensor};
use event_types::stream::{Ahead, EventReader};
use num_complex::Complex;
use rustfft::FftPlanner;

/// Largest number of events examined.
pub const EVENTS: usize = 1 << 17;
/// Smallest number of events from which a readout can be detected.
const EVENTS_MIN: usize = 1 << 10;
/// Length of the spectrum in microseconds.
const SPECTRUM_US: usize = 1 << 14;
/// Length of the coarse spectrum in microseconds: half a step between its frequencies takes a tenth of a peak's height.
const COARSE_US: usize = 1 << 12;
/// Longest difference in microseconds used in the spectrum; up to it the error of the period has not accumulated.
const SHORT_US: usize = 1 << 11;
/// Shortest and longest period that is detected, in microseconds.
const PERIOD_US: (f64, f64) = (16.0, 250.0);
/// Smallest fit of the differences of more than half a period.
const COMB_MIN: f64 = PEAK_MIN / 2.0;
/// Correction of the period in microseconds after which it is not corrected again over the same differences: 2^-24,
/// a small part of the resolution of 2^-16 of a [`Readout`].
const SETTLED_US: f64 = 1.0 / 16_777_216.0;
/// Smallest share of the differences that must contribute to a peak.
const PEAK_MIN: f64 = 0.4;
/// Of so many lines, a power of two, one is in the coarse spectrum, where there are events enough: the differences of the others would be
/// of the same lengths.
const COARSE_LINES: u16 = 4;
/// Smallest number of events for that.
const MANY_EVENTS: usize = 1 << 14;
/// Share of the smallest peak and fit that suffices in the coarse spectrum.
const COARSE_SHARE: f64 = 0.8;
/// Periods up to which differences are compared with a peak of the coarse spectrum, before the error of its period shows.
const COARSE_PERIODS: f64 = 3.0;

/// Examines a recording's first events, if the mode can use a readout, and returns the reader with a configuration
/// that has the readout found.
///
/// The reader returned delivers the examined events again. Only the lossless and tolerance modes of the dense and
/// the tree coder can use a readout; other configurations are returned unchanged.
#[must_use]
pub fn look(reader: Box<dyn EventReader>, config: Config) -> (Box<dyn EventReader>, Config) {
    if !may_scan(config.mode) {
        return (reader, config);
    }
    let ahead = Ahead::new(reader, EVENTS);
    let config = look_at(ahead.events(), config);
    (Box::new(ahead), config)
}

/// As [`look`], for events in memory.
#[must_use]
pub fn look_at(events: &[Event], config: Config) -> Config {
    let sensor = config.window.sensor;
    let readout = may_scan(config.mode)
        .then(|| find(events, sensor))
        .flatten();
    Config { readout, ..config }
}

/// Returns whether frames of this mode can use a readout: only then does [`look`] examine events.
#[must_use]
pub const fn may_scan(mode: Mode) -> bool {
    matches!(
        mode,
        Mode::Hybrid(Hybrid {
            coder: Coder::Dense | Coder::Tree(_),
            fidelity: Fidelity::Lossless | Fidelity::ToleranceUs(_),
        })
    )
}

/// Finds the readout of the sensor that recorded these events; `None` if it does not scan or there are too few
/// events.
#[must_use]
pub fn find(events: &[Event], sensor: Sensor) -> Option<Readout> {
    let events = events.get(..EVENTS.min(events.len())).unwrap_or_default();
    if events.len() < EVENTS_MIN {
        return None;
    }
    axes_that_may_scan(events, sensor)
        .filter_map(|axis| find_along(axis, events, sensor))
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, readout)| readout)
}

/// Returns the axes along which the sensor may scan: those for which a coarse spectrum has a high peak that fits.
///
/// It is a fraction of the work of [`find_along`], and most sensors do not scan.
fn axes_that_may_scan(events: &[Event], sensor: Sensor) -> impl Iterator<Item = Axis> {
    // No event is so late.
    const NEVER_US: u64 = u64::MAX / 2;
    const AXES: [Axis; 2] = [Axis::Columns, Axis::Rows];
    let mut latest = AXES.map(|axis| vec![NEVER_US; line_count(axis, sensor)]);
    let mut counts = AXES.map(|_| vec![0_u32; SHORT_US]);
    let mask = if events.len() < MANY_EVENTS {
        0
    } else {
        COARSE_LINES - 1
    };
    for event in events {
        for ((axis, latest), counts) in AXES.into_iter().zip(&mut latest).zip(&mut counts) {
            let line = line_of(axis, event);
            if line & mask != 0 {
                continue;
            }
            if let Some(latest) = latest.get_mut(usize::from(line)) {
                // Of either sign: packets of a recording may have their last event first.
                let difference = event.t_us.abs_diff(*latest);
                *latest = event.t_us;
                if let Ok(difference) = usize::try_from(difference)
                    && let Some(count) = counts.get_mut(difference)
                {
                    *count += 1;
                }
            }
        }
    }
    // One for both axes: what it plans takes longer than a spectrum.
    let mut planner = FftPlanner::new();
    AXES.into_iter()
        .zip(counts)
        .filter_map(move |(axis, counts)| has_peak(counts, &mut planner).then_some(axis))
}

/// Returns whether the coarse spectrum of so many differences of each length has a high peak that fits.
fn has_peak(mut counts: Vec<u32>, planner: &mut FftPlanner<f64>) -> bool {
    // Events at one time are one.
    counts[0] = 0;
    let Some(spectrum) = Spectrum::new::<COARSE_US>(&counts, planner) else {
        return false;
    };
    let height = |at: usize| spectrum.heights[at];
    let Range { start, end } = spectrum.range;
    (start..=end).any(|at| {
        let is_top = height(at) >= height(at - 1) && height(at) >= height(at + 1);
        let period = COARSE_US as f64 / at as f64;
        is_top
            && height(at) >= COARSE_SHARE * PEAK_MIN
            && comb(&counts, period, COARSE_PERIODS) > COARSE_SHARE * COMB_MIN
    })
}

/// Returns the number of lines that a sensor reads out along an axis.
fn line_count(axis: Axis, sensor: Sensor) -> usize {
    usize::from(match axis {
        Axis::Columns => sensor.width,
        Axis::Rows => sensor.height,
    })
}

/// Returns the line of an event.
fn line_of(axis: Axis, event: &Event) -> u16 {
    match axis {
        Axis::Columns => event.x,
        Axis::Rows => event.y,
    }
}

/// Returns the readout along an axis with its score from 0 to 1, which says how well the times fit.
fn find_along(axis: Axis, events: &[Event], sensor: Sensor) -> Option<(f64, Readout)> {
    let lines = times_of_lines(axis, events, sensor);
    let period = refine(first_peak(&lines)?, &lines);
    // A multiple of the frequency also fits as a comb, but the first peak is the longest period.
    let (least, most) = PERIOD_US;
    if !(least..=most).contains(&period) {
        return None;
    }
    let (share, slope) = slope(period, &lines)?;
    let q16 = |us: f64| (us * 65_536.0).round();
    let readout = Readout::new(axis, q16(period) as u32, q16(slope) as i32)?;
    (share > PEAK_MIN).then_some((share, readout))
}

/// Returns the times of each line's events relative to the first event, ascending and without repetitions.
fn times_of_lines(axis: Axis, events: &[Event], sensor: Sensor) -> Vec<Vec<u64>> {
    let mut lines = vec![Vec::new(); line_count(axis, sensor)];
    let start = events.iter().map(|event| event.t_us).min().unwrap_or(0);
    for event in events {
        if let Some(times) = lines.get_mut(usize::from(line_of(axis, event))) {
            times.push(event.t_us - start);
        }
    }
    for times in &mut lines {
        times.sort_unstable();
        times.dedup();
    }
    lines
}

/// Returns the differences between neighbouring times of a line, up to `most_us`.
fn differences(lines: &[Vec<u64>], most_us: u64) -> impl Iterator<Item = u64> {
    lines
        .iter()
        .flat_map(|times| times.windows(2).map(|two| two[1] - two[0]))
        .filter(move |difference| *difference <= most_us)
}

/// Heights of the differences' spectrum at its frequencies, shares of the differences.
struct Spectrum {
    /// Up to one beyond the end of the range.
    heights: Vec<f64>,
    /// The frequencies of the periods that are detected.
    range: Range<usize>,
}

impl Spectrum {
    /// Returns the spectrum of so many differences of each length, padded to `LENGTH_US`; `None` for too few.
    fn new<const LENGTH_US: usize>(counts: &[u32], planner: &mut FftPlanner<f64>) -> Option<Self> {
        let total: f64 = counts.iter().copied().map(f64::from).sum();
        if total < EVENTS_MIN as f64 / 8.0 {
            return None;
        }
        let mut values = vec![Complex::new(0.0, 0.0); LENGTH_US];
        for (value, count) in values.iter_mut().zip(counts) {
            value.re = f64::from(*count);
        }
        planner.plan_fft_forward(LENGTH_US).process(&mut values);
        let range = frequencies(LENGTH_US);
        let heights = values[..range.end + 2].iter();
        Some(Self {
            heights: heights.map(|value| value.norm() / total).collect(),
            range,
        })
    }

    fn highest(&self) -> f64 {
        let heights = self.heights[self.range.clone()].iter();
        heights.copied().fold(0.0, f64::max)
    }
}

/// Returns the frequencies of the periods that are detected, in a spectrum of this length.
fn frequencies(length_us: usize) -> Range<usize> {
    let (least, most) = PERIOD_US;
    let frequency = |period: f64| (length_us as f64 / period) as usize;
    frequency(most)..frequency(least)
}

/// Returns the period in microseconds at the first high peak of the spectrum.
fn first_peak(lines: &[Vec<u64>]) -> Option<f64> {
    let mut counts = vec![0_u32; SHORT_US];
    for difference in differences(lines, SHORT_US as u64 - 1) {
        counts[difference as usize] += 1;
    }
    let spectrum = Spectrum::new::<SPECTRUM_US>(&counts, &mut FftPlanner::new())?;
    let highest = spectrum.highest();
    if highest < PEAK_MIN {
        return None;
    }
    // Takes the first frequency that is nearly as high, and climbs to its top.
    let range = &spectrum.range;
    let height = |at: usize| spectrum.heights[at];
    let mut at = range.clone().find(|at| height(*at) > 0.9 * highest)?;
    while range.contains(&(at + 1)) && height(at + 1) > height(at) {
        at += 1;
    }
    let period = SPECTRUM_US as f64 / at as f64;
    (comb(&counts, period, f64::INFINITY) > COMB_MIN).then_some(period)
}

/// Returns how well the differences of more than half a period, and at most so many periods, fit its multiples: the mean
/// of their cosines, from -1 to 1. Where events follow each other closely, shorter differences fit any long period.
fn comb(counts: &[u32], period: f64, periods: f64) -> f64 {
    let (mut total, mut fit) = (0.0, 0.0);
    let end = (period * (periods + 0.5)) as usize;
    let counts = counts.get(..end).unwrap_or(counts);
    for (difference, count) in counts.iter().enumerate().skip((period / 2.0) as usize + 1) {
        let count = f64::from(*count);
        total += count;
        fit += count * (TAU * difference as f64 / period).cos();
    }
    fit / f64::max(total, 1.0)
}

/// Refines the period over longer and longer differences: the error after each step stays well below a period over
/// differences of four times the length.
fn refine(mut period: f64, lines: &[Vec<u64>]) -> f64 {
    let mut longest_us = SHORT_US as u64;
    for _ in 0..6 {
        for _ in 0..3 {
            let correction = correction(period, longest_us, lines);
            period += correction;
            if correction.abs() < SETTLED_US {
                break;
            }
        }
        longest_us *= 2;
    }
    period
}

/// Returns the least squares fit of difference - n period over n, with the differences of each line's times from the
/// earliest ones at most `longest_us` before them, those left out that are no multiple of the period.
fn correction(period: f64, longest_us: u64, lines: &[Vec<u64>]) -> f64 {
    let per_us = 1.0 / period;
    let (mut dot, mut square) = (0.0, 0.0);
    for times in lines {
        let mut earliest = times.iter();
        let Some(mut from) = earliest.next() else {
            continue;
        };
        for time in times {
            while time - from > longest_us {
                let Some(next) = earliest.next() else {
                    break;
                };
                from = next;
            }
            // At most 2^16: conversions of shorter integers, and without a call that rounds, take the fewest
            // instructions. A difference of 0 adds nothing, and halfway between multiples none is close enough.
            let difference = f64::from((time - from) as i32);
            let n = f64::from((difference * per_us + 0.5) as i32);
            let off = difference - n * period;
            if off.abs() < 4.0 {
                dot += n * off;
                square += n * n;
            }
        }
    }
    if square > 0.0 { dot / square } else { 0.0 }
}

/// Returns the score (how well neighbouring lines agree, 0 to 1) and the shift from line to line in microseconds.
fn slope(period: f64, lines: &[Vec<u64>]) -> Option<(f64, f64)> {
    // Phases of a line are summed over stretches too short for the error of the period to show.
    const STRETCH_US: u64 = 1 << 16;
    let mut turn = Complex::new(0.0, 0.0);
    let stretches = lines.iter().filter_map(|times| times.last()).max()? / STRETCH_US;
    let phases = |times: &[u64], stretch: u64| {
        let start = times.partition_point(|time| *time < stretch * STRETCH_US);
        let end = times.partition_point(|time| *time < (stretch + 1) * STRETCH_US);
        times[start..end]
            .iter()
            .map(|time| Complex::from_polar(1.0, TAU * *time as f64 / period))
            .sum::<Complex<f64>>()
    };
    let all: Vec<Vec<_>> = (0..=stretches)
        .map(|stretch| lines.iter().map(|times| phases(times, stretch)).collect())
        .collect();
    for two in all.iter().flat_map(|line| line.windows(2)) {
        turn += two[0].conj() * two[1] / (two[0].norm() * two[1].norm()).max(1.0).sqrt();
    }
    let events = lines.iter().map(|times| times.len() as f64).sum::<f64>();
    let mut slope = turn.arg() / TAU * period;
    // Repeat over lines further and further apart, where a small error shows.
    let mut apart = 2;
    while apart < lines.len() {
        let mut turn = Complex::new(0.0, 0.0);
        for line in &all {
            for (a, b) in line.iter().zip(line.get(apart..).unwrap_or_default()) {
                turn += a.conj() * b / (a.norm() * b.norm()).max(1.0).sqrt();
            }
        }
        let expected = slope * apart as f64;
        let off = turn * Complex::from_polar(1.0, -TAU * expected / period);
        if off.norm() > 0.0 {
            slope += off.arg() / TAU * period / apart as f64;
        }
        apart *= 2;
    }
    let agreeing: f64 = all
        .iter()
        .map(|line| {
            let turned = |(at, phase): (usize, &Complex<f64>)| {
                phase * Complex::from_polar(1.0, -TAU * slope * at as f64 / period)
            };
            line.iter()
                .enumerate()
                .map(turned)
                .sum::<Complex<f64>>()
                .norm()
        })
        .sum();
    Some((agreeing / events, slope))
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Polarity;
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::{Rng, SeedableRng};

    use super::*;

    /// Returns events of a sensor that scans, with a jitter of 1 us, or of one that does not.
    fn events(axis: Axis, grid: Option<(f64, f64)>) -> (Vec<Event>, Sensor) {
        let sensor = Sensor::new(160, 120).unwrap();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
        let mut events: Vec<_> = (0..40_000)
            .map(|_| {
                let x = (random.next_u32() % 160) as u16;
                let y = (random.next_u32() % 120) as u16;
                let line = f64::from(match axis {
                    Axis::Columns => x,
                    Axis::Rows => y,
                });
                let at = random.next_u32() % 400_000;
                let t_us = match grid {
                    Some((period, slope)) => {
                        let scan = (f64::from(at) / period).floor();
                        let jitter = f64::from(random.next_u32() % 3) - 1.0;
                        1_000_000.0 + scan * period + slope * line + jitter
                    }
                    None => 1_000_000.0 + f64::from(at),
                };
                Event {
                    t_us: t_us.round() as u64,
                    x,
                    y,
                    polarity: Polarity::On,
                }
            })
            .collect();
        events.sort_by_key(|event| event.t_us);
        (events, sensor)
    }

    #[test]
    fn a_grid_is_found_along_its_axis() {
        for axis in [Axis::Columns, Axis::Rows] {
            for (period, slope) in [
                (197.283, -0.6),
                (101.4, 0.85),
                (31.25, 0.0),
                (16.02, 0.02),
                (17.77, 0.05),
                (143.7, 0.3),
                (248.9, 1.1),
            ] {
                let (events, sensor) = events(axis, Some((period, slope)));
                let readout = find(&events, sensor).expect("a grid");
                // With slope 0 all lines are read at once, so columns fit as well as rows.
                assert!(readout.axis() == axis || slope == 0.0, "{period} {slope}");
                let found = f64::from(readout.period_q16()) / 65_536.0;
                assert!((found - period).abs() < 0.002, "{found} {period}");
                let found = f64::from(readout.slope_q16()) / 65_536.0;
                assert!((found - slope).abs() < 0.005, "{found} {slope}");
            }
        }
    }

    /// Events come late in the recording, after noise, and in packets of which the last event is first.
    #[test]
    fn a_grid_is_found_after_noise_and_in_any_order() {
        let (mut scanned, sensor) = events(Axis::Columns, Some((197.283, -0.6)));
        for packet in scanned.chunk_by_mut(|a, b| a.t_us / 10_000 == b.t_us / 10_000) {
            packet.reverse();
        }
        let (noise, _) = events(Axis::Columns, None);
        let noise = noise.iter().cycle().take(40_000).enumerate();
        let mut events: Vec<_> = noise
            .map(|(i, event)| Event {
                t_us: 700 * i as u64 + event.t_us % 700,
                ..*event
            })
            .collect();
        let end_us = 700 * 40_000;
        events.extend(scanned.iter().map(|event| Event {
            t_us: event.t_us + end_us,
            ..*event
        }));
        let readout = find(&events, sensor).expect("a grid");
        assert_eq!(readout.axis(), Axis::Columns);
    }

    /// Differences that are short beside every period fit all of them.
    #[test]
    fn there_is_none_where_events_follow_closely() {
        let (mut events, sensor) = events(Axis::Columns, None);
        for event in &mut events {
            event.t_us = 1_000_000 + (event.t_us - 1_000_000) / 100;
        }
        for axis in [Axis::Columns, Axis::Rows] {
            let lines = times_of_lines(axis, &events, sensor);
            assert!(differences(&lines, 40).count() > EVENTS_MIN);
            assert_eq!(first_peak(&lines), None);
        }
        assert_eq!(find(&events, sensor), None);
    }

    #[test]
    fn there_is_none_where_times_are_any() {
        let (events, sensor) = events(Axis::Columns, None);
        assert_eq!(find(&events, sensor), None);
        assert_eq!(find(&events[..100], sensor), None);
    }
}
