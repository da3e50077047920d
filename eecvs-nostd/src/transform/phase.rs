//! Converts an offset to u = (t - t0) / T, as a fraction of a turn or as one of 2^J bins.

use core::num::NonZeroU32;

use crate::fixed_point::Phase;
use crate::machine::IS_64_BIT;

/// Divides offsets by one window's duration T, with a multiplication per event instead of a division.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PhaseScale {
    duration_us: NonZeroU32,
    /// Number of bits to shift T left so that it has 32 significant bits.
    shift: u32,
    /// floor(2^63 / (T 2^`shift`)), which has 32 significant bits.
    reciprocal: u32,
}

impl PhaseScale {
    /// Returns the scale of a window of `duration_us`; 0 is taken as 1.
    #[must_use]
    pub const fn new(duration_us: u32) -> Self {
        let duration_us = match NonZeroU32::new(duration_us) {
            Some(duration_us) => duration_us,
            None => NonZeroU32::MIN,
        };
        let shift = duration_us.leading_zeros();
        let reciprocal = (1_u64 << 63) / ((duration_us.get() as u64) << shift);
        Self {
            duration_us,
            shift,
            // 2^32 for a power of two: one less stays within the error bound of `half`.
            reciprocal: if reciprocal > u32::MAX as u64 {
                u32::MAX
            } else {
                reciprocal as u32
            },
        }
    }

    /// Returns u / 2 in turns for an offset below T. The result is less than 3 * 2^-32 turns too low.
    ///
    /// Half a turn of the DCT's cosine is one window; the phase of the Fourier atoms is twice the result. k times
    /// the error is below 2^-17 radians for k < 1,024 in the DCT, and twice that in the DTFT.
    #[inline(always)]
    #[must_use]
    pub const fn half(self, offset_us: u32) -> Phase {
        let product = (offset_us << (self.shift & 31)) as u64 * self.reciprocal as u64;
        Phase::from_bits((product >> 32) as u32)
    }

    /// Returns the shift and the factor of [`Self::half`].
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(crate) const fn parts(self) -> (u32, u32) {
        (self.shift, self.reciprocal)
    }

    /// Returns u / 2 in units of 2^-64 turns for an offset below T. The result is less than 13 units too low.
    ///
    /// For kernels whose error must not grow with k.
    #[inline(always)]
    #[must_use]
    pub const fn half_wide(self, offset_us: u32) -> u64 {
        let half = self.half(offset_us).to_bits() as u64;
        // The remainder of the division, below 3 T, divided the same way.
        let rest = ((offset_us as u64) << 31) - half * self.duration_us.get() as u64;
        let below = ((rest << (self.shift & 31)) >> 2) * self.reciprocal as u64;
        (half << 32) + (below >> 29)
    }

    /// Returns T if a 32-bit division is enough for [`Self::bin`].
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(crate) const fn divisor(self, bins_log2: u32) -> Option<u32> {
        if self.shift >= bins_log2 {
            Some(self.duration_us.get())
        } else {
            None
        }
    }

    /// Returns floor(2^`bins_log2` u) for an offset below T, `bins_log2` 0 to 10. The result is exact, as the
    /// discontinuities of the Haar atoms require.
    #[inline(always)]
    #[must_use]
    pub const fn bin(self, offset_us: u32, bins_log2: u32) -> u32 {
        if IS_64_BIT {
            // Multiplies, which takes one instruction here. `half` is at most 2 below floor(2^31 u), which rarely
            // leaves the bin undecided.
            let half = self.half(offset_us).to_bits();
            let below = 31_u32.wrapping_sub(bins_log2) & 31;
            let bin = half >> below;
            if bin == (half + 2) >> below {
                return bin;
            }
        }
        // T is never 0; the checked division leaves no panic in the code.
        let bin = if self.shift >= bins_log2 {
            (offset_us << bins_log2).checked_div(self.duration_us.get())
        } else {
            match ((offset_us as u64) << bins_log2).checked_div(self.duration_us.get() as u64) {
                Some(bin) => Some(bin as u32),
                None => None,
            }
        };
        match bin {
            Some(bin) => bin,
            None => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// `half` and `half_wide` against floor(2^31 offset / T) and floor(2^63 offset / T).
    fn check(offset_us: u32, duration_us: u32) {
        let exact = ((u64::from(offset_us) << 31) / u64::from(duration_us)) as u32;
        let found = PhaseScale::new(duration_us).half(offset_us).to_bits();
        assert!(
            found <= exact && exact - found <= 2,
            "{offset_us} / {duration_us}"
        );
        let exact = ((u128::from(offset_us) << 63) / u128::from(duration_us)) as u64;
        let found = PhaseScale::new(duration_us).half_wide(offset_us);
        assert!(
            found <= exact && exact - found <= 13,
            "{offset_us} / {duration_us}"
        );
    }

    #[test]
    fn edges_are_within_the_bound() {
        for duration_us in [1, 2, 3, 7, 1000, 32_768, 33_333, 3_600_000_000, u32::MAX] {
            for offset_us in [0, 1, duration_us / 3, duration_us / 2, duration_us - 1] {
                if offset_us < duration_us {
                    check(offset_us, duration_us);
                }
            }
        }
        assert_eq!(PhaseScale::new(0), PhaseScale::new(1));
    }

    proptest! {
        #[test]
        fn every_phase_is_within_the_bound(duration_us in 1..=u32::MAX, shift in 0..32_u32, seed: u32) {
            let duration_us = (duration_us >> shift).max(1);
            check(seed % duration_us, duration_us);
        }

        #[test]
        fn every_bin_is_exact(
            duration_us in 1..=u32::MAX, shift in 0..32_u32, seed: u32, bins_log2 in 0..=10_u32,
        ) {
            let duration_us = (duration_us >> shift).max(1);
            let offset_us = seed % duration_us;
            let exact = (u128::from(offset_us) << bins_log2) / u128::from(duration_us);
            let found = PhaseScale::new(duration_us).bin(offset_us, bins_log2);
            prop_assert_eq!(u128::from(found), exact);
        }

        #[test]
        fn multiples_of_a_dyadic_fraction_fall_on_it(unit in 1..1_u32 << 22, m in 0..1024_u32) {
            prop_assert_eq!(PhaseScale::new(unit * 1024).bin(unit * m, 10), m);
        }
    }
}
