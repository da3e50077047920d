//! The meaning of one encoded pixel.

use heapless::Vec;

use crate::quantise::Level;
use crate::transform::M_MAX;

/// One pixel's window: its event counts, and the quantised coefficients that were kept.
///
/// Coefficients whose level is 0 are left out: they decode to 0 either way. c_0 = on - off in
/// every transform; where k = 0 is kept its level stands here but costs nothing on the link.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Descriptor {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// ON events in the window.
    pub on: u32,
    /// OFF events in the window.
    pub off: u32,
    /// Kept coefficients, k ascending, none of them (0, 0).
    pub levels: Vec<Level, M_MAX>,
}

impl Descriptor {
    /// A pixel without events.
    pub const EMPTY: Self = Self {
        x: 0,
        y: 0,
        on: 0,
        off: 0,
        levels: Vec::new(),
    };

    /// n = on + off.
    #[must_use]
    pub const fn events(&self) -> u32 {
        self.on + self.off
    }
}
