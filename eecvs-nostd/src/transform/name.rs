//! The transforms by name, and their largest sizes.

/// Largest M, the number of coefficients kept per pixel.
pub const M_MAX: usize = 64;
/// Largest K, the grid size of any transform.
pub const GRID_MAX: usize = 1024;

/// The transform of a window, as named on the link and on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Transform {
    /// Cosine atoms cos(pi k u), low frequencies kept.
    Dct = 0,
    /// Complex exponentials exp(-i 2 pi k u), the largest kept.
    Dtft = 1,
    /// Haar wavelets, the largest kept.
    Dwt = 2,
}

impl Transform {
    /// Every transform, in the order of the codes on the link.
    pub const ALL: [Self; 3] = [Self::Dct, Self::Dtft, Self::Dwt];

    /// Returns the transform with this code on the link, or `None` for any other code.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Dct),
            1 => Some(Self::Dtft),
            2 => Some(Self::Dwt),
            _ => None,
        }
    }

    /// Returns the lower-case name, as on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dct => "dct",
            Self::Dtft => "dtft",
            Self::Dwt => "dwt",
        }
    }

    /// Returns K, the grid size for `m` kept coefficients: `grid`, or else the default.
    ///
    /// The default K is M for the DCT and 2M for the DTFT and the DWT. For the DWT, K is always rounded up to a
    /// power of two.
    #[must_use]
    pub const fn grid_size(self, m: u8, grid: Option<u16>) -> u16 {
        let k = match (grid, self) {
            (Some(k), _) => k,
            (None, Self::Dct) => m as u16,
            (None, Self::Dtft | Self::Dwt) => 2 * m as u16,
        };
        match self {
            Self::Dwt => k.next_power_of_two(),
            Self::Dct | Self::Dtft => k,
        }
    }

    /// Returns the rule that selects the kept coefficients.
    #[must_use]
    pub const fn rule(self) -> Rule {
        match self {
            Self::Dct => Rule::LowFrequency,
            Self::Dtft | Self::Dwt => Rule::Magnitude,
        }
    }

    /// Returns whether a coefficient is two numbers, re and im.
    #[must_use]
    pub const fn is_complex(self) -> bool {
        matches!(self, Self::Dtft)
    }
}

/// Selects which r of the K coefficients are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rule {
    /// The lowest frequencies, k = 0..r.
    LowFrequency,
    /// The r largest |c_k|; of equal ones, those with the lower k.
    Magnitude,
}
