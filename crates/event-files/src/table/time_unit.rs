//! Finds the unit of a file's times if the file does not state it.
//!
//! [`unstated`] is the rule for every format whose times may be in any unit:
//!
//! * Integers are microseconds. [`TimeSample`] decides whether floats are seconds or microseconds.
//! * If a time is too large for that unit, since it is beyond what a recording may hold (2^60 us) or, in seconds,
//!   beyond the year 2286, times are taken to count from 1970, in the unit that gives a date from 2008 to 2096. If
//!   no unit does, the user is asked.
//! * If the median gap between the first 4,096 times is longer than any camera would leave, the user is asked: 1 s
//!   or more (from 16 gaps on, or from 8 if floats were taken for seconds), or 0.1 s or more (from 100 gaps on).
//!   Whole floats that would be so far apart in seconds are microseconds. The median, unlike the mean, is not moved
//!   by a stale time stamp or a pause.

use crate::reading::TimeUnit;

/// Number of times from which the unit is found.
pub const SAMPLE_TIMES: usize = 4096;

/// Largest time of a recording, in microseconds.
const LARGEST_US: f64 = (1_u64 << 60) as f64;

/// Plausible dates of recordings, from 2008 to 2096, in seconds since 1970.
const DATES_S: std::ops::Range<f64> = 1.2e9..4e9;

/// Numbers of gaps, each with the median in seconds from which on it is too long for a camera: for times in other
/// units than seconds, and for times in seconds.
const SLOW: [(usize, f64); 2] = [(16, 1.0), (100, 0.1)];
const SLOW_FLOATS: [(usize, f64); 2] = [(8, 1.0), (100, 0.1)];

/// Units, the longest first.
const UNITS: [TimeUnit; 4] = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];

/// Number of distinct whole values from which on times are not taken for seconds.
const WHOLE_VALUES: usize = 16;

/// Largest plausible time in seconds since 1970: the year 2286.
const SECONDS_MAX: f64 = 1e10;

/// Decides from the first times of a file whether decimals or floats are seconds.
///
/// They are, as in the RPG and MVSEC data sets, unless all of the sample are whole numbers and there are at least
/// 16 different ones, or one of 1e10 or more: these are whole microseconds in a float column.
#[derive(Debug, Default)]
pub struct TimeSample {
    fraction: bool,
    large: bool,
    whole: std::collections::BTreeSet<u64>,
}

impl TimeSample {
    /// Adds a time; `whole` states whether it is written as a whole number.
    pub fn add(&mut self, whole: bool, value: f64) {
        self.fraction |= !whole;
        self.large |= value >= SECONDS_MAX;
        if self.whole.len() < WHOLE_VALUES {
            self.whole.insert(value.to_bits());
        }
    }

    /// Returns whether the times are seconds.
    pub fn seconds(&self) -> bool {
        self.fraction || !(self.large || self.whole.len() >= WHOLE_VALUES)
    }
}

/// The unit that was assumed, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Taken {
    /// The unit of the times.
    pub unit: TimeUnit,
    /// The reason, for [`crate::Assumption::why`].
    pub why: String,
}

/// Finds the unit of a file's first times, at most [`SAMPLE_TIMES`], in the file's order, by the rule in the
/// module's description. `whole` states that they are of an integer type.
///
/// # Errors
/// No unit, or more than one, is plausible; the message asks for `--time-unit`.
pub fn unstated(times: &[f64], whole: bool) -> Result<Taken, String> {
    let mut sample = TimeSample::default();
    for time in times {
        sample.add(time.fract() == 0.0, *time);
    }
    let (unit, what) = match (whole, sample.seconds()) {
        (true, _) => (TimeUnit::Us, "whole numbers"),
        (_, true) => (TimeUnit::S, "fractions"),
        (_, false) => (TimeUnit::Us, "whole numbers"),
    };
    let most = times.iter().fold(0.0, |most: f64, time| most.max(*time));
    let beyond = match unit {
        TimeUnit::S => SECONDS_MAX,
        _ => LARGEST_US,
    };
    if most > beyond {
        return since_1970(times, most, unit);
    }
    let is_slow = |unit: TimeUnit, gap: f64| {
        let slow = if unit == TimeUnit::S {
            SLOW_FLOATS
        } else {
            SLOW
        };
        let mut slow = slow.iter();
        slow.any(|(least, gap_s)| times.len() > *least && in_seconds(gap, unit) >= *gap_s)
    };
    let gap = median_gap(times);
    let all_whole = times.iter().all(|time| time.fract() == 0.0);
    if unit == TimeUnit::S && is_slow(unit, gap) && all_whole && !is_slow(TimeUnit::Us, gap) {
        return Ok(Taken {
            unit: TimeUnit::Us,
            why: "whole numbers that are too far apart for seconds; --time-unit s|ms|ns overrides \
                  this"
                .to_owned(),
        });
    }
    if is_slow(unit, gap) {
        let shorter = UNITS.iter().skip_while(|other| **other != unit).skip(1);
        let named: Vec<&str> = shorter.map(|unit| unit.name()).collect();
        return Err(format!(
            "the unit of the times is not stated, and in {} an event would come every {:.1} s, too rarely for a \
             camera: give --time-unit {} (or {})",
            unit.name(),
            in_seconds(gap, unit),
            named.join("|"),
            unit.name()
        ));
    }
    let others = UNITS.iter().filter(|other| **other != unit);
    let others: Vec<&str> = others.map(|unit| unit.name()).collect();
    Ok(Taken {
        unit,
        why: format!(
            "{what} without a stated unit; --time-unit {} overrides this",
            others.join("|")
        ),
    })
}

/// Returns the unit in which most of the times are plausible dates; `most` is the largest time.
fn since_1970(times: &[f64], most: f64, unit: TimeUnit) -> Result<Taken, String> {
    let is_date = |unit: &&TimeUnit| {
        let dates = times
            .iter()
            .filter(|time| DATES_S.contains(&in_seconds(**time, **unit)));
        // Up to half of the times may be stale time stamps.
        2 * dates.count() > times.len()
    };
    let Some(taken) = UNITS.iter().find(is_date) else {
        return Err(format!(
            "a time of about {most:.3e}, whose unit is not stated, is too large for {}: give --time-unit s|ms|us|ns",
            unit.name()
        ));
    };
    Ok(Taken {
        unit: *taken,
        why: format!(
            "times since 1970: {most:.3e} is too large for {}; --time-unit overrides this",
            unit.name()
        ),
    })
}

fn in_seconds(time: f64, unit: TimeUnit) -> f64 {
    time * 10_f64.powi(unit.shift() - 6)
}

/// Returns the median gap between the times, sorted, since steps back in time say nothing about the rate.
fn median_gap(times: &[f64]) -> f64 {
    let mut times = times.to_vec();
    times.sort_by(f64::total_cmp);
    let gaps = times.windows(2).map(|pair| match pair {
        [before, after] => (after - before).abs(),
        _ => 0.0,
    });
    let mut gaps: Vec<f64> = gaps.filter(|gap| gap.is_finite()).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}

/// Returns the unit that a text states, such as an attribute `units` or the brackets in a column's name.
pub fn named(text: &str) -> Option<TimeUnit> {
    let text = text.trim().to_ascii_lowercase();
    Some(match text.as_str() {
        "s" | "sec" | "secs" | "second" | "seconds" => TimeUnit::S,
        "ms" | "msec" | "millisecond" | "milliseconds" => TimeUnit::Ms,
        "us" | "usec" | "\u{b5}s" | "\u{3bc}s" | "microsecond" | "microseconds" => TimeUnit::Us,
        "ns" | "nsec" | "nanosecond" | "nanoseconds" => TimeUnit::Ns,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(times: &[f64]) -> bool {
        let mut sample = TimeSample::default();
        for time in times {
            sample.add(time.fract() == 0.0, *time);
        }
        sample.seconds()
    }

    #[test]
    fn seconds_unless_whole_and_many_or_large() {
        let counted: Vec<f64> = (0..16).map(f64::from).collect();
        assert!(!seconds(&counted));
        assert!(seconds(&counted[..15]));
        assert!(seconds(&[counted, vec![0.5]].concat()));
        assert!(seconds(&[0.0; 100]));
        assert!(!seconds(&[1.6e15]));
        assert!(seconds(&[1.6e9]));
    }

    fn taken(times: impl Iterator<Item = f64>, whole: bool) -> Option<TimeUnit> {
        let times: Vec<f64> = times.collect();
        unstated(&times, whole).ok().map(|taken| taken.unit)
    }

    fn every(gap: f64, count: u32) -> impl Iterator<Item = f64> {
        (0..count).map(move |i| 12.0 + gap * f64::from(i))
    }

    #[test]
    fn what_no_camera_does_is_asked_about() {
        for (gap, count, whole, want) in [
            (166.0, 600, true, Some(TimeUnit::Us)),
            (3.3e6, 600, true, None),
            (3.3e6, 17, true, None),
            (3.3e6, 16, true, Some(TimeUnit::Us)),
            (2e5, 101, true, None),
            (2e5, 100, true, Some(TimeUnit::Us)),
            (9e4, 5000, true, Some(TimeUnit::Us)),
            (16.25, 10, false, None),
            (16.25, 8, false, Some(TimeUnit::S)),
            (500.0, 10, false, Some(TimeUnit::Us)),
            (1e-4, 5000, false, Some(TimeUnit::S)),
            (0.0, 5000, true, Some(TimeUnit::Us)),
        ] {
            assert_eq!(taken(every(gap, count), whole), want, "{gap} {count}");
        }
        // A stale time stamp far ahead, and a pause of a day.
        let stale = [9e12].into_iter().chain(every(17.0, 1000));
        assert_eq!(taken(stale, true), Some(TimeUnit::Us));
        let pause = every(17.0, 500).chain(every(17.0, 500).map(|t| t + 8.64e10));
        assert_eq!(taken(pause, true), Some(TimeUnit::Us));
        assert_eq!(taken([].into_iter(), true), Some(TimeUnit::Us));
    }

    #[test]
    fn times_since_1970() {
        let from = |start: f64, whole| taken(every(1e3, 50).map(|t| start + t), whole);
        assert_eq!(from(1.65e18, true), Some(TimeUnit::Ns));
        assert_eq!(from(1.65e18, false), Some(TimeUnit::Ns));
        assert_eq!(from(1.65e15, true), Some(TimeUnit::Us));
        assert_eq!(from((1_u64 << 59) as f64, true), Some(TimeUnit::Us));
        assert_eq!(from(8e18, true), None);
        let fractions = |start: f64| taken(every(0.5, 50).map(|t| start + t), false);
        assert_eq!(fractions(1.65e9), Some(TimeUnit::S));
        assert_eq!(fractions(1.65e12), Some(TimeUnit::Ms));
        assert_eq!(fractions(1.65e15), Some(TimeUnit::Us));
    }

    #[test]
    fn units_have_names() {
        for (text, want) in [
            ("us", "us"),
            ("Microseconds", "us"),
            (" ns ", "ns"),
            ("s", "s"),
        ] {
            assert_eq!(named(text).map(TimeUnit::name), Some(want), "{text}");
        }
        assert_eq!(named("px"), None);
    }
}
