//! One encoded pixel: its event counts and its kept coefficients.

use heapless::Vec;

use crate::quantise::Level;
use crate::transform::shape::Packing;
use crate::transform::{Basis, Dct, Dtft, Dwt, M_MAX, Transform};

/// A pixel's coefficients, as they are sent.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(
    clippy::large_enum_variant,
    reason = "there is no heap to put it on, and one descriptor exists at a time"
)]
pub enum Coded {
    /// A single event, whose time determines every coefficient: floor(2^b u), where b is [`Packing::cells_log2`].
    Cell(u32),
    /// Several events: the kept coefficients, k ascending.
    ///
    /// c_0 = on - off in every transform; if k = 0 is kept, it is in this list but takes no bits. The DCT has k =
    /// 0..r, the DTFT r of its K; of the DWT those that are 0 are left out.
    Levels(Vec<Level, M_MAX>),
}

/// One pixel's window: its event counts and its kept coefficients.
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
    /// Coefficients.
    pub coded: Coded,
}

impl Descriptor {
    /// A pixel without events, at column 0 and row 0.
    pub const EMPTY: Self = Self {
        x: 0,
        y: 0,
        on: 0,
        off: 0,
        coded: Coded::Levels(Vec::new()),
    };

    /// Returns the number of events, n = on + off.
    #[must_use]
    pub const fn events(&self) -> u32 {
        self.on + self.off
    }

    /// Calls `each` with k, re and im of every kept coefficient, k ascending, each within half a quantiser step of
    /// the encoder's value.
    pub fn dequantise(&self, packing: &Packing, mut each: impl FnMut(u16, f64, f64)) {
        let transform = packing.transform;
        match &self.coded {
            Coded::Levels(levels) => {
                for level in levels {
                    let (re, im) = packing.quantiser.dequantise(transform, *level);
                    each(level.k, re, im);
                }
            }
            Coded::Cell(_) => {
                let sign = f64::from(self.on) - f64::from(self.off);
                let shape = packing.shape();
                let u = self.single_u(packing).unwrap_or(0.5);
                match transform {
                    Transform::Dct => Dct::single(u, sign, shape, each),
                    Transform::Dtft => Dtft::single(u, sign, shape, each),
                    Transform::Dwt => Dwt::single(u, sign, shape, each),
                }
            }
        }
    }

    /// Returns the time u of a single event, 0 to 1 within the window, as the middle of its cell; `None` for
    /// several events.
    #[must_use]
    pub fn single_u(&self, packing: &Packing) -> Option<f64> {
        match self.coded {
            Coded::Cell(cell) => {
                let cells = f64::from(1_u32 << (packing.cells_log2() & 31));
                Some((f64::from(cell) + 0.5) / cells)
            }
            Coded::Levels(_) => None,
        }
    }
}
