//! Cells of time, which set how exactly the times of events are coded.
//!
//! A window of T microseconds is divided into cells of equal width, and an event's time is coded as the number of
//! its cell. Lossless: cells of 1 us. Tolerance D: cells of 2 D + 1 us, decoded as their middle, so that no time is
//! off by more than D. B bins: cell = floor(t B / T), so that the volume of B box bins is exact, while times inside
//! a bin are not kept.

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
            Fidelity::Bins(bins) => (Rule::Bins, if bins == 0 { 1 } else { bins as u32 }),
        };
        Self {
            duration_us,
            rule,
            count,
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
        ]
    }

    proptest! {
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
