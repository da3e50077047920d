//! Times of sensors that scan, coded relative to the grid on which the sensor reads its lines.
//!
//! Some sensors read a line (a column or a row) every fixed number of microseconds and stamp the events they find
//! with the time of reading. Line l is then read at
//!
//! ```text
//! s(k, l) = round(phase + slope l + k period), k = 0, 1, ...
//! ```
//!
//! An event's time is coded as its nearest scan k and its distance from that scan, which is 0 but for jitter. Times
//! come back exactly, whatever the distance. A window in which too few times lie on the grid is coded without it.

use core::num::{NonZeroU32, NonZeroU64};

use super::{Coder, Fidelity, Hybrid};
use crate::frame::Mode;
use crate::window::Window;
use event_types::Sensor;

/// Bits of the distance from a scan.
pub const FINE_BITS: u32 = 8;
/// Code of the distance 0.
const FINE_ZERO: u32 = 1 << (FINE_BITS - 1);
/// Range of periods in microseconds. Shorter ones gain little; with longer ones a distance does not fit its bits.
const PERIOD_US: (u32, u32) = (16, 250);
/// With steeper slopes, neighbouring lines would be more than half the longest period apart.
const SLOPE_US_MAX: u32 = PERIOD_US.1 / 2;
/// Most scans in a window: the scan's number and [`FINE_BITS`] share a word.
const SCANS_MAX: u64 = 1 << (u32::BITS - FINE_BITS);
/// Events sampled to find a window's phase.
const SAMPLES: u32 = 1024;
/// Fewest events on the grid that are worth the 13 or so bytes it takes in the header.
const HITS_MIN: u32 = 16;
/// Bins of the histogram of phases.
const BINS: usize = 128;

/// Direction of the lines that are read out at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Axis {
    /// Columns: a line is an x.
    Columns,
    /// Rows: a line is a y.
    Rows,
}

/// How a sensor scans. For a given sensor this hardly changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Readout {
    axis: Axis,
    period_q16: NonZeroU32,
    slope_q16: i32,
}

impl Readout {
    /// Describes a sensor that reads each line of an axis every `period_q16` / 2^16 us, each line `slope_q16` /
    /// 2^16 us after the one before it.
    ///
    /// Returns `None` unless the period is 16 to 250 us and the slope at most 125 us either way.
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

    /// Returns the axis of the lines.
    #[must_use]
    pub const fn axis(self) -> Axis {
        self.axis
    }

    /// Returns the time from scan to scan, in 2^-16 us.
    #[must_use]
    pub const fn period_q16(self) -> u32 {
        self.period_q16.get()
    }

    /// Returns the period as a divisor.
    pub(crate) fn period(self) -> NonZeroU64 {
        self.period_q16.into()
    }

    /// Returns the time from line to line, in 2^-16 us.
    #[must_use]
    pub const fn slope_q16(self) -> i32 {
        self.slope_q16
    }

    /// Returns whether a mode may code times by scans: that of the dense or the tree coder, if it is lossless or its
    /// tolerance is finer than half a period.
    pub(crate) const fn serves(self, mode: Mode) -> bool {
        let Mode::Hybrid(Hybrid {
            coder: Coder::Dense | Coder::Tree(_),
            fidelity,
        }) = mode
        else {
            return false;
        };
        match fidelity {
            Fidelity::Lossless => true,
            Fidelity::ToleranceUs(tolerance_us) => tolerance_us < self.period_q16() >> 17,
            Fidelity::Bins(_) | Fidelity::SpreadUs(_) => false,
        }
    }

    /// Returns the line of a pixel.
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

    /// Returns the time since the latest scan of the pixel's line on a grid of phase 0, below the period.
    fn within_q16(self, at: (u16, u16), offset_us: u32) -> u64 {
        let since_q16 = (i64::from(offset_us) << 16) - self.lag_q16(self.line(at));
        since_q16.wrapping_add(self.ago_q16()) as u64 % self.period()
    }

    /// Returns 2^16 periods: longer than any lag, so that adding it makes every time positive.
    fn ago_q16(self) -> i64 {
        i64::from(self.period_q16()) << 16
    }
}

/// The scans of one window: times at which the sensor reads its lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scans {
    readout: Readout,
    phase_q16: i32,
    duration_us: u32,
    count: u32,
}

impl Scans {
    /// Describes the scans of a window of `duration_us`, of which the first reads line 0 at `phase_q16` / 2^16 us.
    ///
    /// Returns `None` if the first scan of any line would come after the window's start, if there are more than
    /// 2^24 scans, or if the duration is 0.
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

    /// Returns when the first scan reads the first and the last line.
    const fn ends_q16(readout: Readout, phase_q16: i64, sensor: Sensor) -> (i64, i64) {
        let last = readout.lines(sensor).saturating_sub(1);
        (phase_q16, phase_q16 + readout.lag_q16(last))
    }

    /// Fits scans to a closed window. Returns `None` unless at least half of the sampled events, and no fewer than
    /// [`HITS_MIN`], lie on them.
    pub(crate) fn fit(readout: Readout, window: &Window<'_>) -> Option<Self> {
        let closed = window.closed()?;
        let sensor = window.config().sensor;
        let period = readout.period();
        let mut counts = [0_u16; BINS];
        let mut samples = 0;
        window.sample(SAMPLES, |at, offset_us| {
            let bin = readout.within_q16(at, offset_us) * BINS as u64 / period;
            // The remainder is below the period, so the bin exists; a bin counts at most `SAMPLES`, so it does not
            // overflow.
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
        // Refine the phase: its mean over the samples in the best bin and its two neighbours.
        let bin = period.get() / BINS as u64;
        let middle = best as u64 * bin + bin / 2;
        let (mut hits, mut sum) = (0, 0);
        // Measured from half a period before the bin's middle, so that the mean does not wrap.
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
        // Shift the phase so that the line that is read last has its first scan just before the window, or at its
        // start.
        let (first, last) = Self::ends_q16(readout, phase, sensor);
        let latest = (first.max(last) + readout.ago_q16()) as u64;
        let scans = (latest + period.get() - 1) / period;
        let phase = phase + readout.ago_q16() - (scans * period.get()) as i64;
        let phase_q16 = i32::try_from(phase).ok()?;
        Self::new(readout, phase_q16, sensor, closed.duration_us)
    }

    /// Returns how the sensor scans, whatever the window.
    #[must_use]
    pub const fn readout(self) -> Readout {
        self.readout
    }

    /// Returns when the first scan reads line 0, in 2^-16 us from the window's start.
    #[must_use]
    pub const fn phase_q16(self) -> i32 {
        self.phase_q16
    }

    /// Returns the number of scans in the window, 1 to 2^24.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.count
    }

    const fn start_q16(self, at: (u16, u16)) -> i64 {
        self.phase_q16 as i64 + self.readout.lag_q16(self.readout.line(at))
    }

    /// Returns when a scan reads a pixel, in microseconds; negative before the window's start.
    const fn time_us(self, at: (u16, u16), scan: u32) -> i64 {
        let time_q16 = self.start_q16(at) + scan as i64 * self.readout.period_q16() as i64;
        (time_q16 + (1 << 15)) >> 16
    }

    /// Returns about when a scan reads line 0, in microseconds from the window's start, modulo 2^32.
    #[inline]
    pub(crate) const fn line0_us(self, scan: u32) -> u32 {
        let period_q16 = self.readout.period_q16() as i64;
        ((self.phase_q16 as i64 + scan as i64 * period_q16) >> 16) as u32
    }

    /// Returns which 32nd of a microsecond a scan of a pixel begins in, counted from where its time is rounded.
    #[inline]
    pub(crate) const fn fraction(self, at: (u16, u16), scan: u32) -> u32 {
        let time_q16 = self.start_q16(at) + scan as i64 * self.readout.period_q16() as i64;
        ((time_q16 + (1 << 15)) as u64 >> 11) as u32 % 32
    }

    /// Codes a time below the window's duration: the scan in the upper bits, [`FINE_BITS`] of distance below. The
    /// code grows with the time.
    #[must_use]
    pub(crate) fn of(self, at: (u16, u16), offset_us: u32) -> u32 {
        let period = self.readout.period();
        // No line's first scan is after the window's start.
        let since_q16 = ((i64::from(offset_us) << 16) - self.start_q16(at)) as u64;
        let scan = ((since_q16 + period.get() / 2) / period) as u32;
        // At most half a period plus the rounding, so it fits its bits.
        let distance = i64::from(offset_us) - self.time_us(at, scan);
        (scan << FINE_BITS) | (distance + i64::from(FINE_ZERO)) as u32
    }

    /// Decodes a time. A code that no encoder writes gives the nearest time within the window.
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

/// Splits a coded distance into its magnitude in microseconds and whether the event is before the scan.
#[must_use]
pub(crate) const fn fine_parts(fine: u32) -> (u32, bool) {
    (fine.abs_diff(FINE_ZERO), fine < FINE_ZERO)
}

/// The inverse of [`fine_parts`]; magnitudes that do not fit become the largest that does.
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
        /// The module's promise, for any time and any grid.
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

        /// Whatever a payload holds, the decoded time lies in the window.
        #[test]
        fn any_number_is_a_time(readout in readouts(), told: u32, duration_us in 1_u32.., x in 0_u16..64) {
            let sensor = Sensor::new(64, 64).unwrap();
            // With this phase no line's first scan comes after the window's start.
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
