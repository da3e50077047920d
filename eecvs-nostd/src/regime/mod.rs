//! Density regime of a window, and the transform that it selects.

pub mod density;

use crate::regime::density::Density;
use crate::transform::Transform;

/// Density regime of a window (eq. 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Regime {
    /// rho < tau_low.
    Sparse = 0,
    /// tau_low <= rho < tau_high.
    Moderate = 1,
    /// tau_high <= rho.
    Dense = 2,
}

impl Regime {
    /// Every regime, in the order of the codes on the link.
    pub const ALL: [Self; 3] = [Self::Sparse, Self::Moderate, Self::Dense];

    /// Returns the regime with this code on the link, or `None` for any other code.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Sparse),
            1 => Some(Self::Moderate),
            2 => Some(Self::Dense),
            _ => None,
        }
    }

    /// Returns the regime's lower-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sparse => "sparse",
            Self::Moderate => "moderate",
            Self::Dense => "dense",
        }
    }

    /// Returns the transform of the regime (eq. 3).
    #[must_use]
    pub const fn transform(self) -> Transform {
        match self {
            Self::Sparse => Transform::Dwt,
            Self::Moderate => Transform::Dtft,
            Self::Dense => Transform::Dct,
        }
    }
}

/// The two densities that separate the regimes, in 10^-12 events per pixel per second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Thresholds {
    tau_low_pico: u64,
    tau_high_pico: u64,
}

impl Thresholds {
    /// Creates thresholds, or returns `None` if tau_low > tau_high.
    #[must_use]
    pub const fn new(tau_low_pico: u64, tau_high_pico: u64) -> Option<Self> {
        if tau_low_pico > tau_high_pico {
            None
        } else {
            Some(Self {
                tau_low_pico,
                tau_high_pico,
            })
        }
    }

    /// Returns tau_low, in 10^-12 events per pixel per second.
    #[must_use]
    pub const fn tau_low_pico(self) -> u64 {
        self.tau_low_pico
    }

    /// Returns tau_high, in 10^-12 events per pixel per second.
    #[must_use]
    pub const fn tau_high_pico(self) -> u64 {
        self.tau_high_pico
    }

    /// Returns the regime of a window of this density (eq. 2).
    #[must_use]
    pub const fn regime(self, density: Density) -> Regime {
        if density.is_below(self.tau_low_pico) {
            Regime::Sparse
        } else if density.is_below(self.tau_high_pico) {
            Regime::Moderate
        } else {
            Regime::Dense
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u32 = 1_000_000;

    #[test]
    fn a_density_on_a_threshold_belongs_above() {
        let thresholds = Thresholds::new(Density::PICO, 2 * Density::PICO).unwrap();
        for (events, regime) in [
            (0, Regime::Sparse),
            (99, Regime::Sparse),
            (100, Regime::Moderate),
            (199, Regime::Moderate),
            (200, Regime::Dense),
        ] {
            let density = Density {
                events,
                pixels: 100,
                duration_us: SECOND,
            };
            assert_eq!(thresholds.regime(density), regime, "{events}");
        }
    }

    #[test]
    fn extremes_do_not_overflow() {
        let densest = Density {
            events: u32::MAX,
            pixels: 1,
            duration_us: 1,
        };
        let sparsest = Density {
            events: 1,
            pixels: 1 << 22,
            duration_us: u32::MAX,
        };
        assert!(!densest.is_below(u64::MAX));
        assert!(sparsest.is_below(u64::MAX));
        assert!(!sparsest.is_below(0));
        // 1e18 / (2^22 (2^32 - 1)) = 55.51 pico-events: between 55 and 56.
        assert!(!sparsest.is_below(55) && sparsest.is_below(56));
        assert!(Thresholds::new(1, 0).is_none());
    }
}
