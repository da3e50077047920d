//! What a time is told as: the number of its cell, or its scan and the distance from it.

use super::cells::{Cells, Fidelity};
use super::scan::{FINE_BITS, Scans};

/// How the times of a frame are told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Times {
    /// As cells.
    Cells(Cells),
    /// As scans.
    Scans(Scans),
}

impl Times {
    /// Those of a window of `duration_us`; only lossless ones are told as scans.
    #[must_use]
    pub const fn new(fidelity: Fidelity, scans: Option<Scans>, duration_us: u32) -> Self {
        match scans {
            Some(scans) => Self::Scans(scans),
            None => Self::Cells(Cells::new(fidelity, duration_us)),
        }
    }

    /// How many cells or scans there are, at least 1.
    #[inline]
    #[must_use]
    pub const fn count(self) -> u32 {
        match self {
            Self::Cells(cells) => cells.count(),
            Self::Scans(scans) => scans.count(),
        }
    }

    /// Bits below the number of a cell or scan that are told beside it.
    #[inline]
    #[must_use]
    pub const fn fine_bits(self) -> u32 {
        match self {
            Self::Cells(_) => 0,
            Self::Scans(_) => FINE_BITS,
        }
    }

    /// Whether every time is told as itself.
    #[inline]
    #[must_use]
    pub const fn are_plain(self) -> bool {
        match self {
            Self::Cells(cells) => cells.is_lossless(),
            Self::Scans(_) => false,
        }
    }

    /// What an event of a pixel is told as, at an offset below the window's duration.
    #[inline]
    #[must_use]
    pub fn of(self, at: (u16, u16), offset_us: u32) -> u32 {
        match self {
            Self::Cells(cells) => cells.of(offset_us),
            Self::Scans(scans) => scans.of(at, offset_us),
        }
    }

    /// The time that is decoded, below the window's duration.
    #[inline]
    #[must_use]
    pub const fn offset_us(self, at: (u16, u16), told: u32) -> u32 {
        match self {
            Self::Cells(cells) => cells.offset_us(told),
            Self::Scans(scans) => scans.offset_us(at, told),
        }
    }
}
