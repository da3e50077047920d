//! Regime of a density, eq. (2), and the transform it selects, eq. (3).

use super::transform::Transform;

/// Density class of a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Regime {
    /// rho < `tau_low`.
    Sparse,
    /// `tau_low` <= rho < `tau_high`.
    Moderate,
    /// rho >= `tau_high`.
    Dense,
}

impl Regime {
    /// Returns the regime of density `rho`, eq. (2).
    ///
    /// All three arguments are in events per pixel per second, with `tau_low <= tau_high`.
    #[must_use]
    pub fn of(rho: f64, tau_low: f64, tau_high: f64) -> Self {
        if rho < tau_low {
            Self::Sparse
        } else if rho < tau_high {
            Self::Moderate
        } else {
            Self::Dense
        }
    }

    /// Returns the transform of this regime, eq. (3).
    #[must_use]
    pub fn transform(self) -> Transform {
        match self {
            Self::Sparse => Transform::Dwt,
            Self::Moderate => Transform::Dtft,
            Self::Dense => Transform::Dct,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_belong_to_the_upper_regime() {
        assert_eq!(Regime::of(0.0, 0.4, 2.0), Regime::Sparse);
        assert_eq!(Regime::of(0.4_f64.next_down(), 0.4, 2.0), Regime::Sparse);
        assert_eq!(Regime::of(0.4, 0.4, 2.0), Regime::Moderate);
        assert_eq!(Regime::of(2.0_f64.next_down(), 0.4, 2.0), Regime::Moderate);
        assert_eq!(Regime::of(2.0, 0.4, 2.0), Regime::Dense);
        assert_eq!(Regime::of(1e9, 0.4, 2.0), Regime::Dense);
    }

    #[test]
    fn equal_thresholds_leave_no_moderate_regime() {
        assert_eq!(Regime::of(0.0, 0.0, 0.0), Regime::Dense);
        assert_eq!(Regime::of(1.0_f64.next_down(), 1.0, 1.0), Regime::Sparse);
        assert_eq!(Regime::of(1.0, 1.0, 1.0), Regime::Dense);
    }

    #[test]
    fn each_regime_has_its_transform() {
        assert_eq!(Regime::Sparse.transform(), Transform::Dwt);
        assert_eq!(Regime::Moderate.transform(), Transform::Dtft);
        assert_eq!(Regime::Dense.transform(), Transform::Dct);
    }
}
