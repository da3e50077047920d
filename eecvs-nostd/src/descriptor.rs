//! The meaning of one encoded pixel.

use heapless::Vec;

use crate::quantise::Level;
use crate::transform::M_MAX;

/// One pixel's window: its event counts, and the quantised coefficients that were kept.
///
/// c_0 = on - off in every transform; where k = 0 is kept it stands here but costs nothing on the
/// link. The DCT has k = 0..r, the DTFT r of its K; of the DWT those that are 0 are left out.
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
    /// Kept coefficients, k ascending.
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
