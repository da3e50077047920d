//! u = (t - t0) / T as an exact fraction of a turn.

use crate::fixed_point::Phase;

/// Divides by one window's duration: a multiplication per event instead of a division.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PhaseScale {
    duration_us: u32,
    /// floor((2^64 - 1) / T)
    reciprocal: u64,
}

impl PhaseScale {
    /// Scale of a window of `duration_us`, at least 1 (0 is taken as 1).
    #[must_use]
    pub const fn new(duration_us: u32) -> Self {
        let duration_us = if duration_us == 0 { 1 } else { duration_us };
        Self {
            duration_us,
            reciprocal: u64::MAX / duration_us as u64,
        }
    }

    /// floor(2^32 * `offset_us` / T), exact for every offset below T.
    ///
    /// Exact matters: the top J bits are then the exact index of one of 2^J equal bins, which is
    /// what the Haar atoms' discontinuities ask for. An offset of T or more gives the last phase.
    #[inline]
    #[must_use]
    pub const fn phase(self, offset_us: u32) -> Phase {
        if offset_us >= self.duration_us {
            return Phase::MAX;
        }
        // offset < T, so the product is below 2^64; the estimate is the floor or one below it.
        let estimate = (offset_us as u64 * self.reciprocal) >> 32;
        let remainder = ((offset_us as u64) << 32) - estimate * self.duration_us as u64;
        let phase = estimate + (remainder >= self.duration_us as u64) as u64;
        Phase::from_bits(phase as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn exact(offset_us: u32, duration_us: u32) -> u32 {
        ((u128::from(offset_us) << 32) / u128::from(duration_us)) as u32
    }

    #[test]
    fn edges_are_exact() {
        for duration_us in [1, 2, 3, 7, 1000, 32_768, 33_333, 3_600_000_000, u32::MAX] {
            let scale = PhaseScale::new(duration_us);
            for offset_us in [0, 1, duration_us / 3, duration_us / 2, duration_us - 1] {
                if offset_us < duration_us {
                    assert_eq!(
                        scale.phase(offset_us).to_bits(),
                        exact(offset_us, duration_us),
                        "{offset_us} / {duration_us}"
                    );
                }
            }
        }
    }

    #[test]
    fn offsets_beyond_the_window_give_the_last_phase() {
        for duration_us in [1, 1000, u32::MAX - 1] {
            let scale = PhaseScale::new(duration_us);
            for offset_us in [duration_us, duration_us + 1, u32::MAX] {
                assert_eq!(
                    scale.phase(offset_us),
                    Phase::MAX,
                    "{offset_us} / {duration_us}"
                );
            }
        }
        assert_eq!(PhaseScale::new(0), PhaseScale::new(1));
    }

    proptest! {
        #[test]
        fn every_phase_is_the_exact_floor(duration_us in 1..=u32::MAX, seed: u32) {
            let offset_us = seed % duration_us;
            let scale = PhaseScale::new(duration_us);
            prop_assert_eq!(scale.phase(offset_us).to_bits(), exact(offset_us, duration_us));
        }

        #[test]
        fn multiples_of_a_dyadic_fraction_fall_on_it(unit in 1..1_u32 << 22, m in 0..1024_u32) {
            let scale = PhaseScale::new(unit * 1024);
            prop_assert_eq!(scale.phase(unit * m).to_bits() >> 22, m);
        }
    }
}
