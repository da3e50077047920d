//! Descriptors to bits: the payload of a frame. [`crate::unpack`] is its inverse.

use crate::bits::{BitWriter, Full, exp_golomb};
use crate::descriptor::{Coded, Descriptor};
use crate::packing::{MASK_GRID_MAX, Packing, width_of};
use crate::prune::Kept;
use crate::quantise::{Level, Levels, Run, Seven};
use crate::transform::{Rule, Transform, rows};

impl Packing {
    /// What packs the pixels of a frame, from its first.
    #[must_use]
    pub fn packer(&self) -> Packer {
        Packer {
            packing: *self,
            gap_order: self.gap_order(),
            cells_log2: self.cells_log2(),
            one_bits: self.level_bits_max(1),
            shift: self.quantiser.shift() + rows::MORE_BITS,
            next_index: 0,
        }
    }

    /// Appends `descriptor`, of which a single event has a cell and several have levels;
    /// `next_index` is the raster index after the previous pixel's.
    ///
    /// # Errors
    /// [`Full`], with the writer to be rewound by the caller.
    pub fn pack(
        &self,
        descriptor: &Descriptor,
        next_index: &mut u32,
        writer: &mut BitWriter<'_>,
    ) -> Result<(), Full> {
        let mut packer = Packer {
            next_index: *next_index,
            ..self.packer()
        };
        packer.pack(descriptor, writer);
        *next_index = packer.next_index;
        if writer.is_full() { Err(Full) } else { Ok(()) }
    }
}

/// Packs pixel after pixel: [`Self::place`], then what the transform sends of it.
///
/// Nothing is an error here: ask the writer whether it [`BitWriter::is_full`] after each pixel.
#[derive(Debug, Clone, Copy)]
pub struct Packer {
    packing: Packing,
    gap_order: u32,
    /// [`Packing::cells_log2`]
    cells_log2: u32,
    /// Bits of a level of one event.
    one_bits: u32,
    /// [`Quantiser::shift`] for the sums of [`rows`].
    shift: u32,
    /// Raster index after the previous pixel's.
    next_index: u32,
}

impl Packer {
    /// Where a pixel is and what it counts. Pixels come in raster order.
    #[inline(always)]
    pub fn place(&mut self, position: (u16, u16), counts: (u32, u32), writer: &mut BitWriter<'_>) {
        let (code, bits) = self.place_code(position, counts, writer);
        writer.put_clean(code, bits);
    }

    /// What [`Self::place`] puts and how many bits, 31 at the most; nothing where these do not hold
    /// it and it has been put.
    #[inline(always)]
    pub fn place_code(
        &mut self,
        position: (u16, u16),
        (on, off): (u32, u32),
        writer: &mut BitWriter<'_>,
    ) -> (u32, u32) {
        let gap = self.gap(position);
        let events = on + off;
        let (counts, more_bits) = exp_golomb(events.wrapping_sub(1), 0);
        let on_bits = width_of(events);
        let (gap_code, gap_bits) = exp_golomb(gap, self.gap_order);
        let counts_bits = more_bits + on_bits;
        let bits = counts_bits + gap_bits;
        if bits < 32 {
            // The 1 above the first code is taken off the number that follows it.
            let on = on.wrapping_sub(1) << (more_bits & 31);
            let counts = counts.wrapping_add(on);
            let code = counts | (gap_code << (counts_bits & 31));
            (code ^ (1 << (bits & 31)), bits)
        } else {
            let gap_order = self.gap_order;
            writer.aside(|writer| place_long(gap, (on, events), gap_order, writer));
            (0, 0)
        }
    }

    /// The levels of a pixel of `events`, 2 or more.
    #[inline(always)]
    pub fn levels(&self, events: u32, levels: &impl Levels, writer: &mut BitWriter<'_>) {
        if levels.is_empty() {
            return;
        }
        let most = self.packing.level_bits_max(events);
        put_levels(most, levels, writer);
    }

    /// `place`, which is what [`Self::place_code`] gave, and then [`Self::levels`] of 2 to
    /// [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events: their sums, and the bits of these
    /// that are not copies of the sign.
    #[inline(always)]
    pub fn seven_levels(
        &self,
        place: (u32, u32),
        events: u32,
        (sums, spread): (&[i32; 7], u32),
        writer: &mut BitWriter<'_>,
    ) {
        let levels = Seven {
            bits: sums,
            shift: self.shift,
        };
        // No clamp as in `Packing::level_bits_max`: the step is 1 at the most, and events few.
        let most = width_of(events.wrapping_sub(1)) + self.one_bits;
        let bits = (width_of(spread >> (self.shift & 31)) + 1).min(most);
        let code_bits = place.1 + (most - bits);
        let code = place.0 | (1 << (code_bits & 31));
        let code_bits = code_bits + 1;
        if bits > 8 || code_bits > 32 {
            return writer.aside(|writer| seven_wide(place, most, &levels, writer));
        }
        let (three, four) = levels.side_by_side(bits);
        writer.put_here(code, code_bits);
        writer.put_here(three, 3 * bits);
        writer.put_here(four, 4 * bits);
    }

    /// Which coefficients are sent, for the transforms that keep the largest.
    #[inline(always)]
    pub fn set(&self, kept: &Kept, writer: &mut BitWriter<'_>) {
        let grid = usize::from(self.packing.grid);
        let words = kept.words(grid);
        let first = words.first().copied().unwrap_or(0);
        if self.packing.transform.is_complex() {
            let r = self.packing.kept() as u32;
            if r as usize == grid {
                return;
            }
            if is_low(kept, grid, r) {
                return writer.put(1, 1);
            }
            writer.put(0, 1);
        }
        if self.packing.grid <= MASK_GRID_MAX {
            return writer.put(first, u32::from(self.packing.grid));
        }
        let count = kept.count(grid);
        if !self.packing.transform.is_complex() {
            writer.put(count, width_of(self.packing.kept() as u32));
        }
        if self.packing.lists_indices(count) {
            kept.for_each(grid, |k| writer.put(k as u32, self.packing.index_bits()));
        } else {
            for (index, word) in words.iter().enumerate() {
                writer.put(*word, (grid - 32 * index).min(32) as u32);
            }
        }
    }

    /// A pixel with a single event, whole: `cell` tells `cells_log2` bits of its u.
    #[inline(always)]
    pub fn single(
        &mut self,
        position: (u16, u16),
        is_on: bool,
        cell: u32,
        writer: &mut BitWriter<'_>,
    ) {
        let gap = self.gap(position);
        let (gap_code, gap_bits) = exp_golomb(gap, self.gap_order);
        let cells_log2 = self.cells_log2;
        // n - 1 = 0 is a one, and `on` a bit.
        let bits = 2 + gap_bits + cells_log2;
        if bits < 32 {
            // The 1 above the gap's code is taken off the cell.
            let cell = cell.wrapping_sub(1) << ((2 + gap_bits) & 31);
            let code = (1 | (u32::from(is_on) << 1) | (gap_code << 2)).wrapping_add(cell);
            writer.put_here(code, bits);
        } else {
            writer.put_clean(1 | (u32::from(is_on) << 1), 2);
            writer.put_exp_golomb(gap, self.gap_order);
            writer.put_clean(cell, cells_log2);
        }
    }

    /// From the pixel before to this one.
    #[inline(always)]
    const fn gap(&mut self, (x, y): (u16, u16)) -> u32 {
        let index = y as u32 * self.packing.sensor.width as u32 + x as u32;
        let gap = index.wrapping_sub(self.next_index);
        self.next_index = index + 1;
        gap
    }

    /// Bits of a single event's cell.
    #[inline(always)]
    #[must_use]
    pub const fn cells_log2(&self) -> u32 {
        self.cells_log2
    }

    fn pack(&mut self, descriptor: &Descriptor, writer: &mut BitWriter<'_>) {
        let (on, off) = (descriptor.on, descriptor.off);
        let events = descriptor.events();
        let position = (descriptor.x, descriptor.y);
        let levels = match &descriptor.coded {
            Coded::Cell(cell) => {
                let cells = !(u32::MAX << (self.cells_log2 & 31));
                return self.single(position, on == 1, *cell & cells, writer);
            }
            Coded::Levels(levels) => levels,
        };
        self.place(position, (on, off), writer);
        if self.packing.transform.rule() == Rule::Magnitude {
            let mut kept = Kept::NONE;
            for level in levels {
                kept.insert(usize::from(level.k));
            }
            self.set(&kept, writer);
        }
        let levels = DescriptorLevels {
            transform: self.packing.transform,
            levels,
        };
        self.levels(events, &levels, writer);
    }
}

/// Puts levels, of which there are some and the widest has up to `most` bits.
#[inline(always)]
fn put_levels(most: u32, levels: &impl Levels, writer: &mut BitWriter<'_>) {
    // The bits that are not copies of the sign, of any of the levels.
    let mut spread = 0;
    levels.for_each(|level| spread |= (level ^ (level >> 31)) as u32);
    // Never more than `most`: |c| < n, and saturated levels have 32 bits.
    let bits = (width_of(spread) + 1).min(most);
    writer.put_unary(most - bits);
    levels.put(bits, writer);
}

/// [`Packer::seven_levels`] of any width.
#[cold]
#[inline(never)]
fn seven_wide(
    (code, code_bits): (u32, u32),
    most: u32,
    levels: &Seven<'_>,
    writer: &mut BitWriter<'_>,
) {
    writer.put_clean(code, code_bits);
    let run = Run {
        sums: &levels.bits.map(rows::sum),
        shift: levels.shift - rows::MORE_BITS,
    };
    put_levels(most, &run, writer);
}

/// [`Packer::place`] where one word does not hold it.
#[cold]
#[inline(never)]
fn place_long(gap: u32, (on, events): (u32, u32), gap_order: u32, writer: &mut BitWriter<'_>) {
    writer.put_exp_golomb(events.wrapping_sub(1), 0);
    writer.put(on, width_of(events));
    writer.put_exp_golomb(gap, gap_order);
}

/// Whether `kept` is 0..`r` of a grid.
#[inline(always)]
fn is_low(kept: &Kept, grid: usize, r: u32) -> bool {
    kept.words(grid).iter().enumerate().all(|(index, word)| {
        let before = 32 * index as u32;
        let here = r.saturating_sub(before);
        *word
            == if here >= 32 {
                u32::MAX
            } else {
                !(u32::MAX << here)
            }
    })
}

/// A descriptor's levels as they are on the link.
struct DescriptorLevels<'d> {
    transform: Transform,
    levels: &'d [Level],
}

impl Levels for DescriptorLevels<'_> {
    fn is_empty(&self) -> bool {
        self.levels.iter().all(|level| level.k == 0)
    }

    fn for_each(&self, mut each: impl FnMut(i32)) {
        for level in self.levels.iter().filter(|level| level.k > 0) {
            match self.transform {
                Transform::Dct => each(level.re),
                Transform::Dtft => {
                    each(level.re);
                    each(level.im);
                }
                Transform::Dwt => each(level.re - i32::from(level.re > 0)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Sensor;
    use crate::packing::PIXEL_BYTES_MAX;
    use crate::quantise::Quantiser;
    use heapless::Vec;

    fn packing(transform: Transform, m: u8, grid: u16, step_log2: i8) -> Packing {
        Packing {
            sensor: Sensor {
                width: Sensor::SIDE_MAX,
                height: Sensor::SIDE_MAX,
            },
            // As many events as pixels: the gap code's order is 0, its longest.
            window_events: 1 << 22,
            transform,
            m,
            grid,
            quantiser: Quantiser::new(step_log2).unwrap(),
        }
    }

    /// Every code of a pixel at its longest, for the grids where the indices take most.
    #[test]
    fn the_largest_pixel_fits_its_bound() {
        let mut longest = 0;
        for transform in Transform::ALL {
            for grid in [64, 512, 640, 1024] {
                for step_log2 in [-15, -6, 8] {
                    let grid = transform.grid_size(64, Some(grid));
                    let packing = packing(transform, 64, grid, step_log2);
                    let side = Sensor::SIDE_MAX;
                    let mut descriptor = Descriptor {
                        x: side - 1,
                        y: side - 1,
                        on: (1 << 24) - 2,
                        off: 1,
                        coded: Coded::Levels(Vec::new()),
                    };
                    let mut levels = Vec::new();
                    let first = match transform.rule() {
                        Rule::LowFrequency => 0,
                        Rule::Magnitude => grid - 64,
                    };
                    for k in first..first + 64 {
                        let level = Level {
                            k,
                            re: i32::MIN,
                            im: i32::from(transform.is_complex()) * i32::MIN,
                        };
                        let _ = levels.push(level);
                    }
                    descriptor.coded = Coded::Levels(levels);
                    let mut bytes = [0; 2 * PIXEL_BYTES_MAX];
                    let mut writer = BitWriter::new(&mut bytes);
                    packing.pack(&descriptor, &mut 0, &mut writer).unwrap();
                    longest = longest.max(writer.finish());
                }
            }
        }
        assert!(longest <= PIXEL_BYTES_MAX, "{longest}");
        // Not by chance: counts and gap, 640 bits of indices, the levels' width in a bit, 128
        // numbers of 32 bits. A narrower width takes 31 bits more at the most.
        assert_eq!(
            longest,
            (45 + 47 + 24 + 1 + 640 + 1 + 128 * 32_usize).div_ceil(8)
        );
        assert!(longest + 31_usize.div_ceil(8) <= PIXEL_BYTES_MAX);
    }
}
