//! Time in cells: how exactly the times of events are told.
//!
//! A window of T microseconds has cells of equal width, and an event's time is the number of its
//! cell. Lossless: cells of 1 us. Within a tolerance D: cells of 2 D + 1 us, told by their middle, so
//! that no time is off by more than D. B bins: cell = floor(t B / T), so that the B-bin volume of box
//! bins is exact and the times inside a bin are free.

/// What fidelity is asked of the times; positions, polarities and counts are always exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fidelity {
    /// Every microsecond.
    #[default]
    Lossless,
    /// No decoded time is off by more than so many microseconds.
    ToleranceUs(u32),
    /// The volume of so many box bins in time.
    Bins(u16),
}

/// The cells of one window.
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
    /// Cells of a window of `duration_us`, at least 1.
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

    /// How many there are, at least 1.
    #[inline]
    #[must_use]
    pub const fn count(self) -> u32 {
        self.count
    }

    /// Whether every cell is a microsecond.
    #[inline]
    #[must_use]
    pub const fn is_lossless(self) -> bool {
        matches!(self.rule, Rule::Width(1))
    }

    /// Cell of an offset below the window's duration, below [`Self::count`].
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

    /// The offset that stands for a cell: its middle, within the window.
    #[inline]
    #[must_use]
    pub const fn offset_us(self, cell: u32) -> u32 {
        let offset_us = match self.rule {
            Rule::Width(width_us) => cell as u64 * width_us as u64 + width_us as u64 / 2,
            Rule::Bins => {
                let twice = (2 * cell as u64 + 1) * self.duration_us as u64;
                // `count` is not 0; where bins are narrower than 1 us the middle may round down out
                // of its bin, whose first microsecond is the ceiling of its start.
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
        /// The module's promise for any window and fidelity.
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

        /// Times keep their order.
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
