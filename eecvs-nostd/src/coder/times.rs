//! Coded form of an event's time: the number of its cell, or its scan and the distance from it.

use super::cells::{Cells, Fidelity};
use super::scan::{FINE_BITS, Scans};

/// How the times of a frame are coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Times {
    /// As the numbers of cells.
    Cells(Cells),
    /// As scans and distances from them.
    Scans(Scans),
}

impl Times {
    /// Chooses the coding for a window of `duration_us`: `scans` if there are any, which are lossless whatever
    /// `fidelity` says, else the cells of `fidelity`.
    #[must_use]
    pub const fn new(fidelity: Fidelity, scans: Option<Scans>, duration_us: u32) -> Self {
        match scans {
            Some(scans) => Self::Scans(scans),
            None => Self::Cells(Cells::new(fidelity, duration_us)),
        }
    }

    /// Returns the number of cells or scans, at least 1.
    #[inline]
    #[must_use]
    pub const fn count(self) -> u32 {
        match self {
            Self::Cells(cells) => cells.count(),
            Self::Scans(scans) => scans.count(),
        }
    }

    /// Returns how many low bits of a coded time hold the distance from a scan; 0 for cells.
    #[inline]
    #[must_use]
    pub const fn fine_bits(self) -> u32 {
        match self {
            Self::Cells(_) => 0,
            Self::Scans(_) => FINE_BITS,
        }
    }

    /// Returns whether the coded time is the offset itself, in microseconds.
    #[inline]
    #[must_use]
    pub const fn are_plain(self) -> bool {
        match self {
            Self::Cells(cells) => cells.is_lossless(),
            Self::Scans(_) => false,
        }
    }

    /// Codes the time of an event of pixel `at`; `offset_us` is from the window's start and below its duration.
    #[inline]
    #[must_use]
    pub fn of(self, at: (u16, u16), offset_us: u32) -> u32 {
        match self {
            Self::Cells(cells) => cells.of(offset_us),
            Self::Scans(scans) => scans.of(at, offset_us),
        }
    }

    /// Decodes a time of pixel `at` to its offset from the window's start, below the window's duration.
    #[inline]
    #[must_use]
    pub const fn offset_us(self, at: (u16, u16), told: u32) -> u32 {
        match self {
            Self::Cells(cells) => cells.offset_us(told),
            Self::Scans(scans) => scans.offset_us(at, told),
        }
    }
}
