//! How much work finding the event times of a window of coefficients may cost.
//!
//! Pixels of few events are solved in microseconds, and crowded ones in tens of milliseconds. A window of nothing but
//! crowded pixels, made to harm or sent by a sensor in front of a lamp, would keep a decoder busy for hours. What is
//! beyond the limit gets approximate times at once, and is counted.

/// Most work that finding the event times of a window may cost, in units of about a sixth of a nanosecond of one core.
///
/// The units are counted and not timed ([`crate::reconstruct::cost`]), so which pixels are beyond the limit does not
/// depend on the load of the machine or on the number of threads. The default is some 8 s of one core: the densest
/// recording that the tests read, of 5.4 million events per second, costs two fifths of it at the encoder's default
/// M, K and choice of the transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WorkLimit(u64);

/// Units in a million, as limits are stated on the command line.
const MILLION: u64 = 1_000_000;

impl WorkLimit {
    /// The default, in millions of units.
    pub const DEFAULT_MILLIONS: u32 = 50_000;

    /// No limit.
    pub const NONE: Self = Self(u64::MAX);

    /// Creates a limit of this many units.
    #[must_use]
    pub const fn units(units: u64) -> Self {
        Self(units)
    }

    /// Creates a limit of this many millions of units: about six are a millisecond of one core.
    #[must_use]
    pub const fn millions(millions: u32) -> Self {
        Self(millions as u64 * MILLION)
    }

    /// Returns the limit in units.
    #[must_use]
    pub const fn get(self) -> u64 {
        self.0
    }
}

impl Default for WorkLimit {
    fn default() -> Self {
        Self::millions(Self::DEFAULT_MILLIONS)
    }
}

impl From<Option<u32>> for WorkLimit {
    /// Millions of units, or `None` for the default.
    fn from(millions: Option<u32>) -> Self {
        millions.map_or_else(Self::default, Self::millions)
    }
}
