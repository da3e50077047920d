//! Cells of time, which set how exactly the times of events are coded.
//!
//! A window of T microseconds is divided into cells of equal width, and an event's time is coded as the number of
//! its cell. Lossless: cells of 1 us. Tolerance D: cells of 2 D + 1 us, decoded as their middle, so that no time is
//! off by more than D. B bins: cell = floor(t B / T), so that the volume of B box bins is exact, while times inside
//! a bin are not kept. Spread over W: cells of W us, in which the events of a pixel and a polarity are decoded at equal
//! distances, the i-th of n at (2 i + 1) / 2 n of the cell.

use crate::transform::phase::PhaseScale;

/// Fidelity of the decoded times; positions, polarities and counts are always exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fidelity {
    /// Every time is exact to the microsecond.
    #[default]
    Lossless,
    /// No decoded time is off by more than this many microseconds.
    ToleranceUs(u32),
    /// The volume of this many box bins in time is exact.
    Bins(u16),
    /// Every time is decoded in its cell of this many microseconds (0 acts as 1), where the events of a pixel and a
    /// polarity are spread evenly: [`spread_us`].
    SpreadUs(u32),
}

impl Fidelity {
    /// Returns the most microseconds that a decoded time is off; `None` of bins.
    #[must_use]
    pub const fn within_us(self) -> Option<u32> {
        match self {
            Self::Lossless => Some(0),
            Self::ToleranceUs(tolerance_us) => Some(tolerance_us),
            Self::SpreadUs(width_us) => Some(width_us.saturating_sub(1)),
            Self::Bins(_) => None,
        }
    }
}

/// Returns where event `i` of the `count` events of a pixel and a polarity is decoded in a cell of `width_us`, from the
/// cell's start: floor((2 i + 1) W / 2 n).
#[inline]
#[must_use]
pub const fn spread_us(width_us: u32, i: u32, count: u32) -> u32 {
    let halves = (2 * i as u64 + 1) * width_us as u64;
    match halves.checked_div(2 * count as u64) {
        Some(offset_us) => offset_us as u32,
        None => 0,
    }
}

/// The division of one window into cells of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Cells {
    duration_us: u32,
    rule: Rule,
    count: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Rule {
    Width(u32),
    Bins,
}

impl Cells {
    /// Divides a window of `duration_us` (0 acts as 1) into cells.
    #[must_use]
    pub const fn new(fidelity: Fidelity, duration_us: u32) -> Self {
        let duration_us = if duration_us == 0 { 1 } else { duration_us };
        let (rule, count) = match fidelity {
            Fidelity::Lossless => (Rule::Width(1), duration_us),
            Fidelity::ToleranceUs(tolerance_us) => {
                let width_us = tolerance_us.saturating_mul(2).saturating_add(1);
                (Rule::Width(width_us), duration_us.div_ceil(width_us))
            }
            Fidelity::SpreadUs(width_us) => {
                let width_us = if width_us == 0 { 1 } else { width_us };
                (Rule::Width(width_us), duration_us.div_ceil(width_us))
            }
            Fidelity::Bins(bins) => (Rule::Bins, if bins == 0 { 1 } else { bins as u32 }),
        };
        Self {
            duration_us,
            rule,
            count,
        }
    }

    /// Divides a window of `duration_us` (0 acts as 1) into `count` cells (0 acts as 1) of equal width, or into cells
    /// of a microsecond if these are no narrower.
    #[must_use]
    pub const fn equal(count: u32, duration_us: u32) -> Self {
        if count >= duration_us {
            return Self::new(Fidelity::Lossless, duration_us);
        }
        Self {
            duration_us,
            rule: Rule::Bins,
            count: if count == 0 { 1 } else { count },
        }
    }

    /// Returns the number of cells, at least 1.
    #[inline]
    #[must_use]
    pub const fn count(self) -> u32 {
        self.count
    }

    /// Returns whether every cell is one microsecond.
    #[inline]
    #[must_use]
    pub const fn is_lossless(self) -> bool {
        matches!(self.rule, Rule::Width(1))
    }

    /// Returns the width of all cells but the last in microseconds, at least 1; `None` of bins.
    #[inline]
    pub(crate) const fn width_us(self) -> Option<u32> {
        match self.rule {
            Rule::Width(width_us) => Some(width_us),
            Rule::Bins => None,
        }
    }

    /// Returns the cell of an offset below the window's duration; the cell is below [`Self::count`].
    #[inline]
    #[must_use]
    pub const fn of(self, offset_us: u32) -> u32 {
        match self.rule {
            Rule::Width(1) => offset_us,
            Rule::Width(width_us) => match offset_us.checked_div(width_us) {
                Some(cell) => cell,
                None => 0,
            },
            Rule::Bins => {
                let scaled = offset_us as u64 * self.count as u64;
                match scaled.checked_div(self.duration_us as u64) {
                    Some(cell) => cell as u32,
                    None => 0,
                }
            }
        }
    }

    /// Returns [`Self::of`], with multiplications in place of a division where cells are of equal width; `scale` is
    /// the window's. For at most 2^24 cells, and windows below 2^31 us.
    #[inline]
    #[must_use]
    pub const fn of_scaled(self, scale: PhaseScale, offset_us: u32) -> u32 {
        match self.rule {
            Rule::Width(_) => self.of(offset_us),
            Rule::Bins => {
                // At most 2 units of 2^-31 too low, so at most one cell.
                let half = scale.half(offset_us).to_bits() as u64;
                let cell = ((half * self.count as u64) >> 31) as u32;
                // How far beyond the cell's start, times the count: below 2 T, so the low half says all.
                let scaled = offset_us.wrapping_mul(self.count);
                let beyond = scaled.wrapping_sub(cell.wrapping_mul(self.duration_us));
                cell + (beyond >= self.duration_us) as u32
            }
        }
    }

    /// Returns start and width of a cell in microseconds, where the cells are of equal width but for the last one; `None`
    /// of bins, or of a cell beyond the window.
    #[inline]
    #[must_use]
    pub const fn span_us(self, cell: u32) -> Option<(u32, u32)> {
        let Rule::Width(width_us) = self.rule else {
            return None;
        };
        let start_us = cell as u64 * width_us as u64;
        if start_us >= self.duration_us as u64 {
            return None;
        }
        let left_us = self.duration_us - start_us as u32;
        let width_us = if left_us < width_us {
            left_us
        } else {
            width_us
        };
        Some((start_us as u32, width_us))
    }

    /// Returns the time u of a cell, 0 to 1 within the window: its middle, but the very microsecond in cells of one.
    #[must_use]
    pub fn u(self, cell: u32) -> f64 {
        match self.rule {
            Rule::Bins => (f64::from(cell) + 0.5) / f64::from(self.count),
            Rule::Width(_) => f64::from(self.offset_us(cell)) / f64::from(self.duration_us),
        }
    }

    /// Returns the offset that a cell is decoded as: its middle, within the window.
    #[inline]
    #[must_use]
    pub const fn offset_us(self, cell: u32) -> u32 {
        let offset_us = match self.rule {
            Rule::Width(width_us) => cell as u64 * width_us as u64 + width_us as u64 / 2,
            Rule::Bins => {
                let twice = (2 * cell as u64 + 1) * self.duration_us as u64;
                // `count` is not 0. Where bins are narrower than 1 us, the middle may round down out of its bin,
                // whose first microsecond is the ceiling of its start.
                let bins = self.count as u64;
                let (middle, start) = (twice / (2 * bins), cell as u64 * self.duration_us as u64);
                let first = start.div_ceil(bins);
                if middle < first { first } else { middle }
            }
        };
        if offset_us >= self.duration_us as u64 {
            self.duration_us - 1
        } else {
            offset_us as u32
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fidelities() -> impl Strategy<Value = Fidelity> {
        prop_oneof![
            Just(Fidelity::Lossless),
            any::<u32>().prop_map(Fidelity::ToleranceUs),
            (0_u32..2000).prop_map(Fidelity::ToleranceUs),
            (1_u16..).prop_map(Fidelity::Bins),
            any::<u32>().prop_map(Fidelity::SpreadUs),
            (0_u32..2000).prop_map(Fidelity::SpreadUs),
        ]
    }

    proptest! {
        #[test]
        fn cells_are_the_same_without_a_division(
            count in 1_u32..=1 << 24, duration_us in 1_u32..1 << 31, shift in 0..31_u32, at: u32, near in 0..3_u32,
        ) {
            let duration_us = (duration_us >> shift).max(1);
            let cells = Cells::equal(count, duration_us);
            let scale = PhaseScale::new(duration_us);
            // Also at the first microsecond of a cell, and beside it.
            let cell = u64::from(at % cells.count()) * u64::from(duration_us);
            let edge = cell.div_ceil(u64::from(cells.count())) as u32;
            for offset_us in [at % duration_us, (edge + near).saturating_sub(1).min(duration_us - 1)] {
                prop_assert_eq!(cells.of_scaled(scale, offset_us), cells.of(offset_us));
            }
        }

        /// The module's promise, for any window and fidelity.
        #[test]
        fn a_decoded_time_is_as_near_as_was_asked(
            fidelity in fidelities(), duration_us in 1_u32.., at in 0.0_f64..1.0
        ) {
            let offset_us = (f64::from(duration_us) * at) as u32;
            let cells = Cells::new(fidelity, duration_us);
            let cell = cells.of(offset_us);
            prop_assert!(cell < cells.count());
            let decoded_us = cells.offset_us(cell);
            prop_assert!(decoded_us < duration_us);
            prop_assert_eq!(cells.of(decoded_us), cell);
            let off_us = decoded_us.abs_diff(offset_us);
            match fidelity {
                Fidelity::Lossless => prop_assert_eq!(off_us, 0),
                Fidelity::ToleranceUs(tolerance_us) => prop_assert!(off_us <= tolerance_us),
                Fidelity::SpreadUs(_) => {
                    prop_assert!(Some(off_us) <= fidelity.within_us());
                    let span = cells.span_us(cell);
                    let holds = span.is_some_and(|(start_us, width_us)| {
                        (start_us..start_us + width_us).contains(&offset_us)
                            && start_us + width_us <= duration_us
                            && spread_us(width_us, 6, 7) < width_us
                    });
                    prop_assert!(holds);
                    prop_assert_eq!(cells.span_us(cells.count()), None);
                }
                Fidelity::Bins(bins) => {
                    let bin = u64::from(decoded_us) * u64::from(bins) / u64::from(duration_us);
                    prop_assert_eq!(bin, u64::from(cell));
                }
            }
        }

        /// Later times never have lower cells.
        #[test]
        fn cells_ascend_with_time(
            fidelity in fidelities(), duration_us in 2_u32.., at in 0.0_f64..1.0
        ) {
            let offset_us = (f64::from(duration_us - 1) * at) as u32;
            let cells = Cells::new(fidelity, duration_us);
            prop_assert!(cells.of(offset_us) <= cells.of(offset_us + 1));
        }
    }
}
