//! What packing and unpacking know before the first pixel.
//!
//! Pixels follow in raster order. Each has its event counts, the gap to the previous pixel, and what determines its
//! coefficients; docs/wire-format.md describes every field. Nothing adapts: every code parameter follows from the
//! header and from the pixel's earlier fields, so each frame decodes by itself.

use crate::quantise::Quantiser;
use crate::transform::{Basis, Dct, Dtft, Dwt, Transform};
use event_types::Sensor;

/// Largest size of a packed pixel in bytes: at most 15 for gap and counts, 81 for the set of coefficients, and 128
/// numbers of 4. `the_largest_pixel_fits_its_bound` packs a pixel of this size.
pub const PIXEL_BYTES_MAX: usize = 620;

/// Largest K for which the set of coefficients is always sent as one bit per coefficient.
pub(crate) const MASK_GRID_MAX: u16 = 32;

/// What the encoder and the decoder know of a frame before its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Packing {
    /// Size of the sensor.
    pub sensor: Sensor,
    /// N_w, the number of events in the window; it sets the order of the gap code.
    pub window_events: u32,
    /// Transform of the window.
    pub transform: Transform,
    /// M, the number of coefficients to keep per pixel, 1 to 64.
    pub m: u8,
    /// K, the size of the grid, 1 to 1024.
    pub grid: u16,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
    /// Which pixels are sent as the times of their events.
    pub timed: Timed,
}

/// The parameters that the coefficients of all pixels share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Shape {
    /// K, the size of the grid.
    pub grid: usize,
    /// r = min(M, K), the number of coefficients kept per pixel.
    pub r: usize,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
}

/// Which pixels of a frame are sent as times: see [`crate::pack::timed`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Timed {
    events_max: u8,
    duration_us: u32,
}

impl Timed {
    /// No pixel of several events is sent as times.
    pub const NONE: Self = Self {
        events_max: 0,
        duration_us: 1,
    };

    /// Pixels of 2 to `events_max` events are, n0 of the formulas, in a window of `duration_us`. 0 and 1 stand for
    /// none.
    #[must_use]
    pub const fn new(events_max: u8, duration_us: u32) -> Self {
        if events_max < 2 {
            return Self::NONE;
        }
        Self {
            events_max,
            duration_us,
        }
    }

    /// Returns n0: 0 if no pixel of several events is sent as times.
    #[must_use]
    pub const fn events_max(self) -> u8 {
        self.events_max
    }

    /// Returns the window's duration.
    pub(crate) const fn duration_us(self) -> u32 {
        self.duration_us
    }

    /// Returns the largest number of words that such a pixel takes: counts and gap, 3 * 31 bits and 3; of each event a
    /// polarity and a distance of at most 24 bits in a code of twice as many and 1; and one word for bits that were
    /// pending.
    pub(crate) const fn words_max(self) -> usize {
        4 + (self.events_max as usize * 50).div_ceil(32) + 1
    }

    /// Returns whether a pixel of `events` events, 2 or more, is sent as times.
    #[inline(always)]
    #[must_use]
    pub const fn has(self, events: u32) -> bool {
        events <= self.events_max as u32
    }
}

/// Returns the number of bits that hold any value from 0 to `most`.
#[inline(always)]
pub(crate) const fn width_of(most: u32) -> u32 {
    u32::BITS - most.leading_zeros()
}

impl Packing {
    /// Returns r = min(M, K), the number of coefficients kept per pixel.
    #[must_use]
    pub const fn kept(&self) -> usize {
        if (self.m as u16) < self.grid {
            self.m as usize
        } else {
            self.grid as usize
        }
    }

    /// Returns K, r and the quantiser as a [`Shape`].
    #[must_use]
    pub const fn shape(&self) -> Shape {
        Shape {
            grid: self.grid as usize,
            r: self.kept(),
            quantiser: self.quantiser,
        }
    }

    /// Returns b, 0 to 24: the time of a single event is sent as one of 2^b cells of the window.
    #[must_use]
    pub fn cells_log2(&self) -> u32 {
        let shape = self.shape();
        match self.transform {
            Transform::Dct => Dct::cells_log2(shape),
            Transform::Dtft => Dtft::cells_log2(shape),
            Transform::Dwt => Dwt::cells_log2(shape),
        }
    }

    /// Returns the order of the gap code: log2 of the mean gap if every event were alone in its pixel.
    pub(crate) const fn gap_order(&self) -> u32 {
        let pixels = self.sensor.pixels();
        let events = if self.window_events == 0 {
            1
        } else {
            self.window_events
        };
        if pixels <= events {
            0
        } else {
            (pixels / events).ilog2()
        }
    }

    /// Returns the width in bits of the widest level of a pixel with `events` events, which follows from |c| < n.
    #[inline(always)]
    pub(crate) const fn level_bits_max(&self, events: u32) -> u32 {
        let fraction_bits = match self.transform {
            Transform::Dct | Transform::Dtft => -(self.quantiser.step_log2() as i32),
            // Haar levels count events, or several events at a coarse step.
            Transform::Dwt => 0,
        };
        let bits = width_of(events.wrapping_sub(1)) as i32 + fraction_bits;
        let bits = if bits < 0 { 0 } else { bits as u32 };
        if bits < 32 { bits + 1 } else { 32 }
    }

    pub(crate) const fn index_bits(&self) -> u32 {
        width_of((self.grid as u32).wrapping_sub(1))
    }

    /// Returns whether a list of indices is shorter than one bit per grid point.
    pub(crate) const fn lists_indices(&self, count: u32) -> bool {
        self.grid > MASK_GRID_MAX && count * self.index_bits() < self.grid as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_widest_level_follows_from_steps_and_events() {
        for (transform, step_log2, events, bits) in [
            // -128 to 127
            (Transform::Dct, -6, 2, 8),
            (Transform::Dtft, -6, 3, 9),
            (Transform::Dtft, -6, 4, 9),
            (Transform::Dtft, -15, 1 << 17, 32),
            (Transform::Dct, -15, 1 << 23, 32),
            // 1,024 events in steps of 4: -256 to 255
            (Transform::Dtft, 2, 1 << 10, 9),
            (Transform::Dtft, 2, (1 << 10) + 1, 10),
            (Transform::Dct, 8, 256, 1),
            (Transform::Dct, 8, 257, 2),
            // -n to n without 0
            (Transform::Dwt, -6, 2, 2),
            (Transform::Dwt, -15, 16, 5),
            (Transform::Dwt, 2, 17, 6),
        ] {
            let packing = packing(transform, 8, 16, step_log2);
            assert_eq!(
                packing.level_bits_max(events),
                bits,
                "{transform:?} {step_log2} {events}"
            );
        }
    }

    #[test]
    fn indices_are_listed_only_where_that_is_shorter() {
        for (grid, count, lists) in [
            (32, 1, false),
            (33, 1, true),
            (64, 10, true),
            (64, 11, false),
            (1024, 64, true),
            (640, 64, false),
        ] {
            let packing = packing(Transform::Dtft, 64, grid, 0);
            assert_eq!(packing.lists_indices(count), lists, "{count} of {grid}");
        }
    }

    fn packing(transform: Transform, m: u8, grid: u16, step_log2: i8) -> Packing {
        Packing {
            sensor: Sensor {
                width: Sensor::SIDE_MAX,
                height: Sensor::SIDE_MAX,
            },
            window_events: 1 << 22,
            transform,
            m,
            grid,
            quantiser: Quantiser::new(step_log2).unwrap(),
            timed: Timed::NONE,
        }
    }

    /// Every coefficient of an event anywhere in a cell is within half a step, or a quarter in the DTFT, of that of
    /// the cell's middle. With half as many cells it would not be.
    #[test]
    fn cells_are_as_wide_as_half_a_step_allows() {
        for step_log2 in -15..=8 {
            for m in [1, 2, 3, 8, 16, 64] {
                for (transform, turns, part) in
                    [(Transform::Dct, 0.5, 0.5), (Transform::Dtft, 1.0, 0.25)]
                {
                    let packing = packing(transform, m, u16::from(m), step_log2);
                    let b = packing.cells_log2();
                    let slope = core::f64::consts::TAU * turns * f64::from(m - 1);
                    let step = libm::exp2(f64::from(step_log2));
                    let half_cell = |b: i32| libm::exp2(f64::from(-b - 1));
                    // b cannot exceed 24, so the error of the finest cells may be larger.
                    let most = if b == 24 { 0.5 } else { part };
                    assert!(slope * half_cell(b as i32) <= step * most);
                    assert!(b == 0 || slope * half_cell(b as i32 - 1) > step * part * 0.999_99);
                    assert!(b <= 24);
                }
            }
        }
    }
}
