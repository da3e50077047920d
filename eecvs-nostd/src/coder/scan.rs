//! Times of sensors that scan: what an event's time is beside the grid on which its line is read out.
//!
//! Some sensors read a line (a column or a row) every so many microseconds and stamp what they find
//! with the time of the reading. Line l is then read at
//!
//! ```text
//! s(k, l) = round(phase + slope l + k period), k = 0, 1, ...
//! ```
//!
//! and an event's time is told as its scan k, the nearest, and its distance from it, which is 0 but
//! for jitter. It comes back exactly, whatever the distance. A window where too few times lie on the
//! grid is sent without it.

use core::num::{NonZeroU32, NonZeroU64};

use super::{Coder, Fidelity, Hybrid};
use crate::frame::Mode;
use crate::window::Window;
use event_types::Sensor;

/// Bits of a distance from a scan.
pub const FINE_BITS: u32 = 8;
/// The distance 0.
const FINE_ZERO: u32 = 1 << (FINE_BITS - 1);
/// Periods in microseconds: below there is little to win, above a distance has no room in its bits.
const PERIOD_US: (u32, u32) = (16, 250);
/// Steeper lines would shift a scan by more than a period between neighbours.
const SLOPE_US_MAX: u32 = PERIOD_US.1 / 2;
/// Most scans of a window: those and [`FINE_BITS`] share a word.
const SCANS_MAX: u64 = 1 << (u32::BITS - FINE_BITS);
/// Events looked at for a window's phase.
const SAMPLES: u32 = 1024;
/// A grid takes some 13 bytes of the header: fewer events than this do not earn it.
const HITS_MIN: u32 = 16;
/// Bins of the histogram of phases.
const BINS: usize = 128;

/// Which lines are read out at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Axis {
    /// Columns: a line is an x.
    Columns,
    /// Rows: a line is a y.
    Rows,
}

/// How a sensor scans; of a sensor it hardly changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Readout {
    axis: Axis,
    period_q16: NonZeroU32,
    slope_q16: i32,
}

impl Readout {
    /// Lines of an axis read every `period_q16` / 2^16 us, 16 to 250 us, each `slope_q16` / 2^16 us
    /// after the one before, at most 125 us either way. `None` beyond that.
    #[must_use]
    pub const fn new(axis: Axis, period_q16: u32, slope_q16: i32) -> Option<Self> {
        let (least, most) = PERIOD_US;
        let period_fits = period_q16 >= least << 16 && period_q16 <= most << 16;
        match NonZeroU32::new(period_q16) {
            Some(period_q16) if period_fits && slope_q16.unsigned_abs() <= SLOPE_US_MAX << 16 => {
                Some(Self {
                    axis,
                    period_q16,
                    slope_q16,
                })
            }
            _ => None,
        }
    }

    /// Which lines are read at once.
    #[must_use]
    pub const fn axis(self) -> Axis {
        self.axis
    }

    /// From scan to scan, in 2^-16 us.
    #[must_use]
    pub const fn period_q16(self) -> u32 {
        self.period_q16.get()
    }

    /// The same, to divide by.
    fn period(self) -> NonZeroU64 {
        self.period_q16.into()
    }

    /// From line to line, in 2^-16 us.
    #[must_use]
    pub const fn slope_q16(self) -> i32 {
        self.slope_q16
    }

    /// Whether times are told by scans in a mode: by the dense coder, where all that is told without
    /// is finer than the scans.
    pub(crate) const fn serves(self, mode: Mode) -> bool {
        let Mode::Hybrid(Hybrid {
            coder: Coder::Dense,
            fidelity,
        }) = mode
        else {
            return false;
        };
        match fidelity {
            Fidelity::Lossless => true,
            Fidelity::ToleranceUs(tolerance_us) => tolerance_us < self.period_q16() >> 17,
            Fidelity::Bins(_) => false,
        }
    }

    /// Line of a pixel.
    const fn line(self, (x, y): (u16, u16)) -> u16 {
        match self.axis {
            Axis::Columns => x,
            Axis::Rows => y,
        }
    }

    const fn lines(self, sensor: Sensor) -> u16 {
        self.line((sensor.width, sensor.height))
    }

    const fn lag_q16(self, line: u16) -> i64 {
        self.slope_q16 as i64 * line as i64
    }

    /// A time's distance from the scan before it, in a grid of phase 0.
    fn within_q16(self, at: (u16, u16), offset_us: u32) -> u64 {
        let since_q16 = (i64::from(offset_us) << 16) - self.lag_q16(self.line(at));
        since_q16.wrapping_add(self.ago_q16()) as u64 % self.period()
    }

    /// A multiple of the period, 2^16 of it, that is longer than any lag: what it is added to is
    /// positive.
    fn ago_q16(self) -> i64 {
        i64::from(self.period_q16()) << 16
    }
}

/// The scans of one window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scans {
    readout: Readout,
    phase_q16: i32,
    duration_us: u32,
    count: u32,
}

impl Scans {
    /// The scans of a window of `duration_us` whose first one reads line 0 at `phase_q16` / 2^16 us.
    ///
    /// `None` where a line's first scan would come after the window's start, or there are more scans
    /// than 2^24.
    #[must_use]
    pub fn new(readout: Readout, phase_q16: i32, sensor: Sensor, duration_us: u32) -> Option<Self> {
        let (first, last) = Self::ends_q16(readout, i64::from(phase_q16), sensor);
        if first > 0 || last > 0 || duration_us == 0 {
            return None;
        }
        let least = if first < last { first } else { last };
        let latest = ((i64::from(duration_us) - 1) << 16) - least;
        let count = (latest as u64 + readout.period().get() / 2) / readout.period() + 1;
        if count > SCANS_MAX {
            return None;
        }
        Some(Self {
            readout,
            phase_q16,
            duration_us,
            count: count as u32,
        })
    }

    /// When the first scan reads the first and the last line.
    const fn ends_q16(readout: Readout, phase_q16: i64, sensor: Sensor) -> (i64, i64) {
        let last = readout.lines(sensor).saturating_sub(1);
        (phase_q16, phase_q16 + readout.lag_q16(last))
    }

    /// The scans of a closed window, where most of its events lie on them.
    pub(crate) fn fit(readout: Readout, window: &Window<'_>) -> Option<Self> {
        let closed = window.closed()?;
        let sensor = window.config().sensor;
        let period = readout.period();
        let mut counts = [0_u16; BINS];
        let mut samples = 0;
        window.sample(SAMPLES, |at, offset_us| {
            let bin = readout.within_q16(at, offset_us) * BINS as u64 / period;
            // Below the period: there is such a bin. No bin counts beyond the samples.
            if let Some(count) = counts.get_mut(bin as usize) {
                *count += 1;
            }
            samples += 1;
        });
        let near = |bin: usize| -> u32 {
            let beside = [(bin + BINS - 1) % BINS, bin, (bin + 1) % BINS];
            let count = |at: usize| counts.get(at).copied().unwrap_or(0);
            beside.map(|at| u32::from(count(at))).iter().sum()
        };
        let best = (0..BINS).max_by_key(|bin| near(*bin))?;
        // Its mean, over what lies in the best bin and those beside it.
        let bin = period.get() / BINS as u64;
        let middle = best as u64 * bin + bin / 2;
        let (mut hits, mut sum) = (0, 0);
        // From half a period before the middle on.
        let start = middle + period.get() / 2;
        window.sample(SAMPLES, |at, offset_us| {
            let since = (readout.within_q16(at, offset_us) + 2 * period.get() - start) % period;
            if since.abs_diff(period.get() / 2) <= bin + bin / 2 {
                hits += 1;
                sum += since;
            }
        });
        if hits < HITS_MIN || 2 * hits < samples {
            return None;
        }
        let mean = sum / NonZeroU64::from(NonZeroU32::new(hits)?);
        let phase = (start + mean) as i64;
        // The latest line's first scan is the last one before the window.
        let (first, last) = Self::ends_q16(readout, phase, sensor);
        let latest = (first.max(last) + readout.ago_q16()) as u64;
        let scans = (latest + period.get() - 1) / period;
        let phase = phase + readout.ago_q16() - (scans * period.get()) as i64;
        let phase_q16 = i32::try_from(phase).ok()?;
        Self::new(readout, phase_q16, sensor, closed.duration_us)
    }

    /// How the sensor scans.
    #[must_use]
    pub const fn readout(self) -> Readout {
        self.readout
    }

    /// When the first scan reads line 0, in 2^-16 us from the window's start.
    #[must_use]
    pub const fn phase_q16(self) -> i32 {
        self.phase_q16
    }

    /// Scans of the window, 1 to 2^24.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.count
    }

    const fn start_q16(self, at: (u16, u16)) -> i64 {
        self.phase_q16 as i64 + self.readout.lag_q16(self.readout.line(at))
    }

    /// When a scan reads a pixel; before the window's start it is negative.
    const fn time_us(self, at: (u16, u16), scan: u32) -> i64 {
        let time_q16 = self.start_q16(at) + scan as i64 * self.readout.period_q16() as i64;
        (time_q16 + (1 << 15)) >> 16
    }

    /// Scans and distance of a time below the window's duration: the scan in the upper bits,
    /// [`FINE_BITS`] of distance below. It grows with the time.
    #[must_use]
    pub(crate) fn of(self, at: (u16, u16), offset_us: u32) -> u32 {
        let period = self.readout.period();
        // No line starts after the window does.
        let since_q16 = ((i64::from(offset_us) << 16) - self.start_q16(at)) as u64;
        let scan = ((since_q16 + period.get() / 2) / period) as u32;
        // At most half a period and the rounding.
        let distance = i64::from(offset_us) - self.time_us(at, scan);
        (scan << FINE_BITS) | (distance + i64::from(FINE_ZERO)) as u32
    }

    /// The time that is told so; for what it never does, one within the window.
    #[must_use]
    pub const fn offset_us(self, at: (u16, u16), told: u32) -> u32 {
        let distance = (told % (1 << FINE_BITS)) as i64 - FINE_ZERO as i64;
        let time_us = self.time_us(at, told >> FINE_BITS) + distance;
        if time_us < 0 {
            0
        } else if time_us >= self.duration_us as i64 {
            self.duration_us - 1
        } else {
            time_us as u32
        }
    }
}

/// Whether a distance is 0; its magnitude and its direction.
#[must_use]
pub(crate) const fn fine_parts(fine: u32) -> (u32, bool) {
    (fine.abs_diff(FINE_ZERO), fine < FINE_ZERO)
}

/// The inverse of [`fine_parts`], of the largest distance there is for what is beyond.
#[must_use]
pub(crate) const fn fine_of(magnitude: u32, is_before: bool) -> u32 {
    let magnitude = if magnitude < FINE_ZERO {
        magnitude
    } else {
        FINE_ZERO - 1
    };
    if is_before {
        FINE_ZERO - magnitude
    } else {
        FINE_ZERO + magnitude
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn readouts() -> impl Strategy<Value = Readout> {
        let axis = prop_oneof![Just(Axis::Columns), Just(Axis::Rows)];
        let (least, most) = PERIOD_US;
        let slope = (SLOPE_US_MAX << 16) as i32;
        (axis, least << 16..=most << 16, -slope..=slope)
            .prop_map(|(axis, period, slope)| Readout::new(axis, period, slope).unwrap())
    }

    proptest! {
        /// The module's promise, for any time beside any grid.
        #[test]
        fn times_come_back(
            readout in readouts(), phase in any::<i32>(), width in 1_u16..=2048, height in 1_u16..=2048,
            duration_us in 1_u32..1 << 27, at in (0.0_f64..1.0, 0.0_f64..1.0, 0.0_f64..1.0),
        ) {
            let sensor = Sensor::new(width, height).unwrap();
            let scan = Scans::new(readout, phase, sensor, duration_us);
            prop_assume!(scan.is_some());
            let scan = scan.unwrap();
            let place = ((at.0 * f64::from(width)) as u16, (at.1 * f64::from(height)) as u16);
            let offset_us = (at.2 * f64::from(duration_us)) as u32;
            let told = scan.of(place, offset_us);
            prop_assert!(told >> FINE_BITS < scan.count());
            prop_assert_eq!(scan.offset_us(place, told), offset_us);
            if offset_us + 1 < duration_us {
                prop_assert!(scan.of(place, offset_us + 1) > told);
            }
        }

        /// Whatever a payload says, the time lies in the window.
        #[test]
        fn any_number_is_a_time(readout in readouts(), told: u32, duration_us in 1_u32.., x in 0_u16..64) {
            let sensor = Sensor::new(64, 64).unwrap();
            // A phase of which it is sure that no line comes after the window's start.
            let scan = Scans::new(readout, -((63 * 125) << 16), sensor, duration_us);
            prop_assume!(scan.is_some());
            prop_assert!(scan.unwrap().offset_us((x, 5), told) < duration_us);
        }

        #[test]
        fn a_distance_has_a_magnitude_and_a_direction(fine in 1_u32..1 << FINE_BITS) {
            let (magnitude, is_before) = fine_parts(fine);
            prop_assert_eq!(fine_of(magnitude, is_before), fine);
        }
    }
}
