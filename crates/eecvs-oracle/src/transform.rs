//! Properties common to the three transforms: grid size, number of kept coefficients, coefficients of a pixel.

use num_complex::Complex64;

use super::{dct, dtft, dwt};

/// One event of one pixel, relative to its window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Impulse {
    /// t - t0 in microseconds, less than the window's duration.
    pub offset_us: u32,
    /// Polarity, +1 or -1.
    pub p: f64,
}

impl Impulse {
    /// Returns the normalised time u = (t - t0) / T, in [0, 1).
    #[must_use]
    pub fn u(self, duration_us: u32) -> f64 {
        f64::from(self.offset_us) / f64::from(duration_us)
    }
}

/// A family of atoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Transform {
    /// Cosines, see [`dct`].
    Dct,
    /// Complex exponentials, see [`dtft`].
    Dtft,
    /// Haar wavelets, see [`dwt`].
    Dwt,
}

impl Transform {
    /// All transforms.
    pub const ALL: [Self; 3] = [Self::Dct, Self::Dtft, Self::Dwt];

    /// Returns the default grid size K for M coefficients: M for the DCT, 2M for the DTFT, and 2M rounded up to a
    /// power of two for the DWT.
    #[must_use]
    pub fn default_grid(self, m: usize) -> usize {
        match self {
            Self::Dct => m,
            Self::Dtft => 2 * m,
            Self::Dwt => (2 * m).next_power_of_two(),
        }
    }

    /// Returns the coefficients `c_k` for k = 0..grid, eq. (6); the imaginary part is 0 for the DCT and the DWT.
    ///
    /// Shape: `[Impulse; n] -> [Complex64; grid]`.
    #[must_use]
    pub fn coefficients(
        self,
        impulses: &[Impulse],
        duration_us: u32,
        grid: usize,
    ) -> Vec<Complex64> {
        let complex = |real: Vec<f64>| real.into_iter().map(Complex64::from).collect();
        match self {
            Self::Dct => complex(dct::coefficients(impulses, duration_us, grid)),
            Self::Dtft => dtft::coefficients(impulses, duration_us, grid),
            Self::Dwt => complex(dwt::coefficients(impulses, duration_us, grid)),
        }
    }
}

/// Returns the number of kept coefficients, r = min(M, K).
#[must_use]
pub fn kept_count(m: usize, grid: usize) -> usize {
    m.min(grid)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_events::impulses;

    #[test]
    fn default_grids() {
        for (m, dct, dtft, dwt) in [
            (1, 1, 2, 2),
            (8, 8, 16, 16),
            (16, 16, 32, 32),
            (24, 24, 48, 64),
            (64, 64, 128, 128),
        ] {
            assert_eq!(Transform::Dct.default_grid(m), dct);
            assert_eq!(Transform::Dtft.default_grid(m), dtft);
            assert_eq!(Transform::Dwt.default_grid(m), dwt);
        }
        assert_eq!((kept_count(16, 32), kept_count(16, 8)), (16, 8));
    }

    #[test]
    fn no_impulse_gives_zeros() {
        for transform in Transform::ALL {
            assert_eq!(transform.coefficients(&[], 10, 3), [Complex64::ZERO; 3]);
        }
    }

    proptest! {
        #[test]
        fn linear_in_the_impulses_and_blind_to_their_order(
            (duration_us, a) in impulses(),
            split in 0usize..40,
        ) {
            let (left, right) = a.split_at(split.min(a.len()));
            let mut reversed = a.clone();
            reversed.reverse();
            for transform in Transform::ALL {
                let whole = transform.coefficients(&a, duration_us, 16);
                let left = transform.coefficients(left, duration_us, 16);
                let right = transform.coefficients(right, duration_us, 16);
                let reversed = transform.coefficients(&reversed, duration_us, 16);
                for k in 0..16 {
                    prop_assert!((whole[k] - left[k] - right[k]).norm() < 1e-11);
                    prop_assert!((whole[k] - reversed[k]).norm() < 1e-11);
                }
            }
        }

        #[test]
        fn coefficient_zero_is_the_signed_sum((duration_us, a) in impulses()) {
            let sum: f64 = a.iter().map(|i| i.p).sum();
            for transform in Transform::ALL {
                prop_assert_eq!(
                    transform.coefficients(&a, duration_us, 1), [Complex64::from(sum)]
                );
            }
        }
    }
}
