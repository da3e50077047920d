//! Predicts a pixel's coefficients as if its events were in the middle of their cells.

use super::pixel::{Common, Pixel, TOLD_GRID_MAX};
use crate::fixed_point::{Coefficient, Sum};
use crate::group::Impulse;
use crate::prune::{Kept, low_frequency};
use crate::transform::haar_scale::scale_of;
use crate::transform::{Basis, Dct, Dtft, Dwt, M_MAX, Rule, Transform};

/// Predicted coefficients, and which of them would be sent.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// The second half is for complex numbers, and for the Haar transform as working memory.
    sums: [Sum; 2 * TOLD_GRID_MAX],
    magnitudes: [u32; TOLD_GRID_MAX],
    pub(super) kept: Kept,
    foretold: [Foretold; 2 * M_MAX],
}

/// A predicted level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foretold {
    pub(super) level: i32,
    /// Where the coefficient would be within its step, in eighths.
    pub(super) place: u8,
    /// Height of its frequency or scale, 0 to 3.
    pub(super) height: u8,
}

impl Prediction {
    /// All zero, for memory in `.bss`.
    pub const EMPTY: Self = Self {
        sums: [Sum::ZERO; 2 * TOLD_GRID_MAX],
        magnitudes: [0; TOLD_GRID_MAX],
        kept: Kept::NONE,
        foretold: [Foretold {
            level: 0,
            place: 0,
            height: 0,
        }; 2 * M_MAX],
    };

    /// Predicts a pixel that is coded by its events.
    pub(super) fn make(&mut self, common: &Common, pixel: &Pixel) {
        match common.packing.transform {
            Transform::Dct => self.make_of::<Dct>(common, pixel),
            Transform::Dtft => self.make_of::<Dtft>(common, pixel),
            Transform::Dwt => self.make_of::<Dwt>(common, pixel),
        }
    }

    fn make_of<B: Basis>(&mut self, common: &Common, pixel: &Pixel) {
        let shape = common.packing.shape();
        let events = pixel.events.iter().take(pixel.count() as usize);
        let impulses = events.map(|event| Impulse {
            offset_us: common.cells.offset_us(event >> 1),
            is_on: event & 1 == 1,
        });
        B::accumulate(impulses, common.scale, shape.grid, &mut self.sums);
        self.kept = Kept::NONE;
        if let Some(re) = self.sums.first_mut() {
            *re = Sum::from_integer(pixel.on as i32 - pixel.off as i32);
        }
        if B::TRANSFORM.is_complex()
            && let Some(im) = self.sums.get_mut(1)
        {
            *im = Sum::ZERO;
        }
        match B::RULE {
            Rule::LowFrequency => low_frequency(shape.r, &mut self.kept),
            Rule::Magnitude => {
                let (sums, magnitudes) = (&self.sums, &mut self.magnitudes);
                // The Haar transform looks at a word of them at once.
                let sums = sums.get(..B::values(shape.grid)).unwrap_or(sums);
                B::prune(sums, pixel.count(), shape, magnitudes, &mut self.kept);
            }
        }
    }

    /// Returns the predicted levels of the coefficients in `kept`, without k = 0.
    pub(super) fn levels(&mut self, common: &Common, kept: &Kept) -> &[Foretold] {
        let packing = &common.packing;
        let grid = usize::from(packing.grid);
        let (numbers, quantiser) = (common.numbers(), packing.quantiser);
        let shift = quantiser.shift();
        let Self { sums, foretold, .. } = self;
        let mut len = 0;
        kept.for_each(grid, |k| {
            if k == 0 {
                return;
            }
            let height = (4 * k / grid.max(1)) as u8 & 3;
            for i in 0..numbers {
                let sum = sums.get(k * numbers + i).copied().unwrap_or_default();
                let (level, place) = if packing.transform == Transform::Dwt {
                    let level = quantiser.haar(sum.integer(), scale_of(k));
                    (level - i32::from(level > 0), 4)
                } else {
                    let below = (i64::from(sum.to_bits()) << 3) >> shift;
                    (sum.level(shift), (below & 7) as u8)
                };
                if let Some(next) = foretold.get_mut(len) {
                    *next = Foretold {
                        level,
                        place,
                        height,
                    };
                    len += 1;
                }
            }
        });
        foretold.get(..len).unwrap_or_default()
    }
}
