//! Descriptors to bits: the payload of a frame. [`crate::unpack`] is its inverse.

use crate::bits::{BitWriter, Full, exp_golomb};
use crate::descriptor::{Coded, Descriptor};
use crate::packing::{MASK_GRID_MAX, Packing, width_of};
use crate::prune::Kept;
use crate::quantise::{Levels, highest_bits, side_by_side};
use crate::transform::lanes::Lanes;
#[cfg(target_arch = "x86_64")]
use crate::transform::rows;
#[cfg(not(target_arch = "x86_64"))]
use crate::transform::rows::Cosines;
use crate::transform::{M_MAX, Rule, Transform};

impl Packing {
    /// What packs the pixels of a frame, from its first.
    #[must_use]
    pub fn packer(&self) -> Packer {
        Packer {
            packing: *self,
            gap: GapCode::new(self.gap_order()),
            width: u32::from(self.sensor.width),
            cells_log2: self.cells_log2(),
            one_bits: self.level_bits_max(1),
            shift: self.quantiser.shift(),
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
        let mut packer = self.packer();
        packer.gap.go_to(*next_index);
        packer.pack(descriptor, writer);
        *next_index = packer.gap.next_index();
        if writer.is_full() { Err(Full) } else { Ok(()) }
    }
}

/// Packs pixel after pixel: [`Self::place`], then what the transform sends of it.
///
/// Nothing is an error here: ask the writer whether it [`BitWriter::is_full`] after each pixel.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Packer {
    gap: GapCode,
    /// Bits of a level of one event.
    one_bits: u32,
    /// [`Quantiser::shift`](crate::quantise::Quantiser::shift) for the sums of [`rows`].
    shift: u32,
    /// Columns of the sensor.
    width: u32,
    /// [`Packing::cells_log2`]
    cells_log2: u32,
    packing: Packing,
}

/// From the pixel before to the next, as an Exp-Golomb code: [`exp_golomb`] with what follows from
/// its order g at hand.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
struct GapCode {
    /// Raster index after the previous pixel's, less 2^g.
    before: u32,
    /// 2^g - 1
    less: u32,
    /// 31 - g
    zeros_max: u32,
    /// 63 - g
    bits_max: u32,
}

impl GapCode {
    const fn new(order: u32) -> Self {
        let less = (1 << (order & 31)) - 1;
        Self {
            before: 0_u32.wrapping_sub(1 + less),
            less,
            zeros_max: 31_u32.wrapping_sub(order),
            bits_max: 63_u32.wrapping_sub(order),
        }
    }

    const fn order(&self) -> u32 {
        31_u32.wrapping_sub(self.zeros_max)
    }

    const fn next_index(&self) -> u32 {
        self.before.wrapping_add(1 + self.less)
    }

    const fn go_to(&mut self, next_index: u32) {
        self.before = next_index.wrapping_sub(1 + self.less);
    }

    /// Goes to the pixel at `index`; returns the gap plus 2^g.
    #[inline(always)]
    const fn step(&mut self, index: u32) -> u32 {
        let shifted = index.wrapping_sub(self.before);
        self.before = index.wrapping_sub(self.less);
        shifted
    }

    /// The code of what [`Self::step`] gave, a 1 right above it, and its bits; the code holds where
    /// they are below 32.
    #[inline(always)]
    const fn code(&self, shifted: u32) -> (u32, u32) {
        let zeros = shifted.leading_zeros();
        let code = ((shifted << 1) + 1) << (self.zeros_max.wrapping_sub(zeros) & 31);
        (code, self.bits_max.wrapping_sub(2 * zeros))
    }

    /// Puts it whatever its length.
    fn put(&self, shifted: u32, writer: &mut BitWriter<'_>) {
        writer.put_exp_golomb(shifted.wrapping_sub(1 + self.less), self.order());
    }
}

impl Packer {
    /// Where a pixel is and what it counts. Pixels come in raster order.
    #[inline(always)]
    pub fn place(&mut self, (x, y): (u16, u16), counts: (u32, u32), writer: &mut BitWriter<'_>) {
        let index = u32::from(y) * self.width + u32::from(x);
        let (code, bits) = self.place_code(index, counts, writer);
        writer.put_clean(code, bits);
    }

    /// What [`Self::place`] puts and how many bits, 31 at the most; nothing where these do not hold
    /// it and it has been put.
    #[inline(always)]
    fn place_code(
        &mut self,
        index: u32,
        (on, off): (u32, u32),
        writer: &mut BitWriter<'_>,
    ) -> (u32, u32) {
        let shifted = self.gap.step(index);
        let (gap_code, gap_bits) = self.gap.code(shifted);
        let events = on + off;
        let (counts, counts_bits) = exp_golomb(events.wrapping_sub(1), 0);
        let on_bits = width_of(events);
        let before_on = gap_bits + counts_bits;
        let bits = before_on + on_bits;
        if bits < 32 {
            // The 1 above each code is taken off the number that follows it.
            let code = gap_code
                .wrapping_add(counts.wrapping_sub(1) << (gap_bits & 31))
                .wrapping_add(on.wrapping_sub(1) << (before_on & 31));
            (code, bits)
        } else {
            let gap = self.gap;
            writer.aside(|writer| place_long((gap, shifted), (on, events), writer));
            (0, 0)
        }
    }

    /// The levels of a pixel of `events`, 2 or more.
    #[inline(always)]
    pub fn levels(&self, events: u32, levels: &Levels<'_>, writer: &mut BitWriter<'_>) {
        let spread = levels.spread();
        let levels = levels.as_slice();
        if levels.is_empty() {
            return;
        }
        let most = self.packing.level_bits_max(events);
        put_levels(most, levels, spread, writer);
    }

    /// A pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events, whole: its place
    /// and the levels of its sums. The output has room for it.
    #[cfg(not(target_arch = "x86_64"))]
    #[inline(always)]
    pub fn seven(
        &mut self,
        (x, y): (u16, u16),
        counts: (u32, u32),
        cosines: &Cosines,
        writer: &mut BitWriter<'_>,
    ) {
        let index = u32::from(y) * self.width + u32::from(x);
        #[cfg(eecvs_dsp)]
        if seven_dsp::put(self, index, counts, cosines, writer) {
            return;
        }
        self.seven_portable(index, counts, (cosines.sums(), cosines.spread()), writer);
    }

    /// A pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events, whole: its place
    /// and the levels of its sums, which are in vectors. The output has room for it.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(crate) fn seven_vectors(
        &mut self,
        (x, y): (u16, u16),
        (on, off): (u32, u32),
        sums: rows::Sums,
        writer: &mut BitWriter<'_>,
    ) {
        let index = u32::from(y) * self.width + u32::from(x);
        writer.aside(|writer| {
            let (code, code_bits) = self.place_code(index, (on, off), writer);
            let levels = sums.levels(self.shift);
            // No clamp as in `Packing::level_bits_max`: the step is 1 at the most, and events few.
            let most = width_of((on + off).wrapping_sub(1)) + self.one_bits;
            let bits = width_of(levels.spread()) + 1;
            let width = 1 << (most.wrapping_sub(bits) & 31);
            let width_bits = most.wrapping_sub(bits) + 1;
            writer.put_long(
                u64::from(code) | (width << code_bits),
                code_bits + width_bits,
            );
            let [a, b, c, d] = levels.pairs(bits);
            if bits <= 16 {
                writer.put_long(a | (b << (2 * bits)), 4 * bits);
                writer.put_long(c | (d << (2 * bits)), 3 * bits);
            } else {
                for pair in [a, b, c] {
                    writer.put_long(pair, 2 * bits);
                }
                writer.put_long(d, bits);
            }
        });
    }

    /// The same for a raster index.
    #[cfg(not(target_arch = "x86_64"))]
    #[cfg_attr(eecvs_dsp, cold)]
    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    fn seven_portable(
        &mut self,
        index: u32,
        (on, off): (u32, u32),
        (sums, spread): (&[i32; 7], u32),
        writer: &mut BitWriter<'_>,
    ) {
        writer.aside(|writer| {
            let (code, code_bits) = self.place_code(index, (on, off), writer);
            let shift = self.shift & 31;
            let levels = sums.map(|sum| (sum >> shift) as u32);
            // No clamp as in `Packing::level_bits_max`: the step is 1 at the most, and events few.
            let most = width_of((on + off).wrapping_sub(1)) + self.one_bits;
            let bits = width_of(spread >> shift) + 1;
            let width_bits = most - bits + 1;
            if bits > 8 || code_bits + width_bits > 32 {
                writer.put_clean(code, code_bits);
                return put_levels(most, &levels, spread >> shift, writer);
            }
            let width = 1 << ((code_bits + width_bits - 1) & 31);
            writer.put_here(code | width, code_bits + width_bits);
            let [a, b, c, rest @ ..] = levels;
            let highest = highest_bits::<4>(bits);
            let three = side_by_side([a, b, c], bits, highest >> bits);
            writer.put_here(three, 3 * bits);
            writer.put_here(side_by_side(rest, bits, highest), 4 * bits);
        });
    }

    /// A pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events, whole, whose Haar
    /// differences are bytes: its place, the set of those in `kept`, and their levels, of which no
    /// other lane has any. The output has room for it.
    #[inline(always)]
    pub(crate) fn bytes<const W: usize>(
        &mut self,
        (x, y): (u16, u16),
        (on, off): (u32, u32),
        (kept, levels, spread): (u32, Lanes<W>, u32),
        writer: &mut BitWriter<'_>,
    ) {
        let index = u32::from(y) * self.width + u32::from(x);
        self.bytes_at(index, (on, off), (kept, levels, spread), writer);
    }

    /// The same for a raster index.
    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    pub(crate) fn bytes_at<const W: usize>(
        &mut self,
        index: u32,
        (on, off): (u32, u32),
        (kept, levels, spread): (u32, Lanes<W>, u32),
        writer: &mut BitWriter<'_>,
    ) {
        let grid = u32::from(self.packing.grid);
        writer.aside(|writer| {
            let (code, code_bits) = self.place_code(index, (on, off), writer);
            if code_bits + grid <= 32 {
                writer.put_here(code | (kept << (code_bits & 31)), code_bits + grid);
            } else {
                writer.put_clean(code, code_bits);
                writer.put_clean(kept, grid);
            }
            let mut left = kept & !1;
            if left == 0 {
                return;
            }
            let bits = width_of(spread) + 1;
            // Up to n events in a lane of bytes: 7 bits are the widest level.
            let narrower = width_of((on + off).wrapping_sub(1)) + 1 - bits;
            let (mut word, mut word_bits) = (1 << (narrower & 31), narrower + 1);
            let bytes = levels.into_bytes();
            let bytes = bytes.as_flattened();
            let mask = !(u32::MAX << (bits & 31));
            while left != 0 {
                let k = left.trailing_zeros() as usize;
                left &= left - 1;
                if word_bits + bits > 32 {
                    writer.put_here(word, word_bits);
                    (word, word_bits) = (0, 0);
                }
                let byte = u32::from(bytes[k % (4 * W)]);
                word |= (byte & mask) << (word_bits & 31);
                word_bits += bits;
            }
            writer.put_here(word, word_bits);
        });
    }

    /// A pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events of complex coefficients,
    /// whole: its place, the set `kept`, fewer than K of up to 32, and out of `pairs` their levels, of
    /// `bits` each and side by side. The output has room for it.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(crate) fn pairs(
        &mut self,
        (x, y): (u16, u16),
        (on, off): (u32, u32),
        (kept, pairs, bits): (u32, &[u64], u32),
        writer: &mut BitWriter<'_>,
    ) {
        let index = u32::from(y) * self.width + u32::from(x);
        let grid = u32::from(self.packing.grid);
        let low = !(u32::MAX << (self.packing.kept() as u32 & 31));
        writer.aside(|writer| {
            let (code, code_bits) = self.place_code(index, (on, off), writer);
            // A one where the set is k = 0..r, else a zero and a bit for each k.
            let (set, set_bits) = if kept == low {
                (1, 1)
            } else {
                (u64::from(kept) << 1, grid + 1)
            };
            writer.put_long(u64::from(code) | (set << code_bits), code_bits + set_bits);
            let mut left = kept & !1;
            if left == 0 {
                return;
            }
            // The step is 1 at the most, and events few: 22 bits are the widest level.
            let most = width_of((on + off).wrapping_sub(1)) + self.one_bits;
            writer.put_unary(most.wrapping_sub(bits) & 31);
            let pair = |k: u32| pairs.get(k as usize).copied().unwrap_or_default();
            if bits > 16 {
                while left != 0 {
                    writer.put_long(pair(left.trailing_zeros()), 2 * bits);
                    left &= left - 1;
                }
                return;
            }
            while left != 0 {
                let first = pair(left.trailing_zeros());
                left &= left - 1;
                if left == 0 {
                    return writer.put_long(first, 2 * bits);
                }
                let second = pair(left.trailing_zeros());
                left &= left - 1;
                writer.put_long(first | (second << (2 * bits)), 4 * bits);
            }
        });
    }

    /// [`Self::place`], one for all that are in no hurry.
    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    pub(crate) fn place_apart(
        &mut self,
        position: (u16, u16),
        counts: (u32, u32),
        writer: &mut BitWriter<'_>,
    ) {
        self.place(position, counts, writer);
    }

    /// Which coefficients are sent, for the transforms that keep the largest.
    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
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
        (x, y): (u16, u16),
        is_on: bool,
        cell: u32,
        writer: &mut BitWriter<'_>,
    ) {
        let shifted = self.gap.step(u32::from(y) * self.width + u32::from(x));
        let (gap_code, gap_bits) = self.gap.code(shifted);
        let cells_log2 = self.cells_log2;
        // n - 1 = 0 is a one, and `on` a bit.
        let bits = gap_bits + 2 + cells_log2;
        if bits < 32 {
            // The 1 above the gap's code is that of n.
            let rest = (u32::from(is_on) + (cell << 1)) << ((gap_bits + 1) & 31);
            writer.put_here(gap_code + rest, bits);
        } else {
            let gap = self.gap;
            single_long((gap, shifted), is_on, (cell, cells_log2), writer);
        }
    }

    /// The same of a pixel whose gap plus 2^g is `shifted`, where `rest` holds polarity and cell. The
    /// gap after it is not counted from there before [`Self::go_to`].
    #[cfg(eecvs_dsp)]
    pub(crate) fn single_after(&self, shifted: u32, rest: u32, writer: &mut BitWriter<'_>) {
        let cell = (rest >> 1, self.cells_log2);
        single_long((self.gap, shifted), rest & 1 == 1, cell, writer);
    }

    /// The same where `before` is what the gap's code comes to: the next gap is counted from there.
    #[cfg(eecvs_dsp)]
    pub(crate) fn single_to(&mut self, before: u32, rest: u32, writer: &mut BitWriter<'_>) {
        let shifted = self.gap.step(before.wrapping_add(self.gap.less));
        self.single_after(shifted, rest, writer);
    }

    /// [`Self::seven`], as [`Self::single_after`].
    #[cfg(eecvs_dsp)]
    pub(crate) fn seven_after(
        &mut self,
        shifted: u32,
        counts: (u32, u32),
        sums: &[i32; 7],
        writer: &mut BitWriter<'_>,
    ) {
        self.gap.before = 0;
        let spread = crate::transform::rows::spread(sums);
        self.seven_portable(shifted, counts, (sums, spread), writer);
    }

    /// The next gap is counted from `next_index`.
    #[cfg(eecvs_dsp)]
    pub(crate) const fn go_to(&mut self, next_index: u32) {
        self.gap.go_to(next_index);
    }

    /// Order of the gap code, and where the next gap is counted from.
    #[cfg(eecvs_dsp)]
    pub(crate) const fn gap_parts(&self) -> (u32, u32) {
        (self.gap.order(), self.gap.next_index())
    }

    /// What brings sums of [`rows`] to levels; bits of a level of one event.
    #[cfg(eecvs_dsp)]
    pub(crate) const fn level_parts(&self) -> (u32, u32) {
        (self.shift, self.one_bits)
    }

    /// Goes to a pixel; returns its gap plus 2^g.
    #[cfg(eecvs_dsp)]
    pub(crate) fn step(&mut self, (x, y): (u16, u16)) -> u32 {
        self.gap.step(u32::from(y) * self.width + u32::from(x))
    }

    /// [`Self::place`] of a pixel whose gap plus 2^g is `shifted`.
    #[cfg(eecvs_dsp)]
    pub(crate) fn place_after(&self, shifted: u32, counts: (u32, u32), writer: &mut BitWriter<'_>) {
        let mut packer = *self;
        packer.gap.before = 0;
        let (code, bits) = packer.place_code(shifted, counts, writer);
        writer.put_clean(code, bits);
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
        let mut memory = [0; 2 * M_MAX];
        let mut flat = Levels::new(&mut memory);
        // What no pixel of these events can have is cut: the link has no room for it.
        let unused = 32 - self.packing.level_bits_max(events);
        let cut = |level: i32| (level << unused) >> unused;
        for level in levels.iter().filter(|level| level.k > 0) {
            match self.packing.transform {
                Transform::Dct => flat.push([cut(level.re)]),
                Transform::Dtft => flat.push([cut(level.re), cut(level.im)]),
                Transform::Dwt => flat.push([cut(level.re - i32::from(level.re > 0))]),
            }
        }
        self.levels(events, &flat, writer);
    }
}

/// Puts levels, of which there are some and the widest has up to `most` bits; `spread` is
/// [`Levels::spread`].
///
/// Apart: one for all transforms, as the levels are the same list in each.
#[inline(never)]
pub(crate) fn put_levels(most: u32, levels: &[u32], spread: u32, writer: &mut BitWriter<'_>) {
    // Never more than `most`: |c| < n, and saturated levels have 32 bits.
    let bits = (width_of(spread) + 1).min(most);
    writer.aside(|writer| {
        writer.put_unary(most - bits);
        match bits {
            0..=8 => put_groups::<4>(levels, bits, writer),
            9..=10 => put_groups::<3>(levels, bits, writer),
            11..=16 => put_groups::<2>(levels, bits, writer),
            _ => put_groups::<1>(levels, bits, writer),
        }
    });
}

/// Puts levels in groups that a word has room for.
#[inline(always)]
fn put_groups<const N: usize>(levels: &[u32], bits: u32, writer: &mut BitWriter<'_>) {
    let highest = highest_bits::<N>(bits);
    let (groups, rest) = levels.as_chunks::<N>();
    for group in groups {
        writer.put_here(side_by_side(*group, bits, highest), N as u32 * bits);
    }
    for level in rest {
        writer.put(*level, bits);
    }
}

/// [`Packer::place`] where one word does not hold it.
#[cold]
#[inline(never)]
fn place_long(
    (gap, shifted): (GapCode, u32),
    (on, events): (u32, u32),
    writer: &mut BitWriter<'_>,
) {
    gap.put(shifted, writer);
    writer.put_exp_golomb(events.wrapping_sub(1), 0);
    writer.put(on, width_of(events));
}

/// [`Packer::single`] where one word does not hold it.
#[cold]
#[inline(never)]
fn single_long(
    (gap, shifted): (GapCode, u32),
    is_on: bool,
    (cell, cells_log2): (u32, u32),
    writer: &mut BitWriter<'_>,
) {
    gap.put(shifted, writer);
    writer.put_clean(1 | (u32::from(is_on) << 1), 2);
    writer.put_clean(cell, cells_log2);
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

/// [`Packer::seven`] with everything in registers.
#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
mod seven_dsp {
    use core::arch::naked_asm;
    use core::mem::offset_of;

    use super::{GapCode, Packer};
    use crate::bits::{BitWriter, Position};
    use crate::transform::rows::Cosines;

    /// Words that [`put`] writes at the most: 32 bits, 70 of levels, and 31 that were there.
    const WORDS_MAX: usize = 5;

    /// The bits of [`Packer::seven_portable`]; `false`, and nothing has changed, where levels have
    /// over 10 bits, the place over 31, or the output is nearly full.
    #[inline(always)]
    pub fn put(
        packer: &mut Packer,
        index: u32,
        (on, off): (u32, u32),
        cosines: &Cosines,
        writer: &mut BitWriter<'_>,
    ) -> bool {
        if !writer.has_words(WORDS_MAX) {
            return false;
        }
        let counts = ((on + off) << 16) | on;
        // SAFETY: the pointer is that of the reference. `seven` writes `before` of `packer`, the
        // position, and up to `WORDS_MAX` words from there on, which are there. The build script
        // sets `eecvs_dsp` only for cores that have the instructions.
        unsafe {
            let (position, words, _) = BitWriter::raw_parts(writer);
            seven(packer, index, counts, cosines, &mut *position, words)
        }
    }

    const _: () = assert!(offset_of!(Packer, gap) == 0 && offset_of!(GapCode, before) == 0);
    const _: () = assert!(offset_of!(Packer, one_bits) == 16 && offset_of!(Packer, shift) == 20);
    /// `counts` are n (2 to 64) << 16 and the ON events.
    ///
    /// # Safety
    /// The words from `position.words` on are `WORDS_MAX` or more.
    #[unsafe(naked)]
    unsafe extern "C" fn seven(
        packer: &mut Packer,
        index: u32,
        counts: u32,
        cosines: &Cosines,
        position: &mut Position,
        words: *mut [u8; 4],
    ) -> bool {
        // Appends `$bits` bits of `$value`, which has no others; overwrites `$bits` and `$tmp`.
        // r12: bits of the next word, lr: how many there are, r11: where the word goes.
        macro_rules! put {
            ($value:literal, $bits:literal, $tmp:literal) => {
                concat!(
                    "lsl ",
                    $tmp,
                    ", ",
                    $value,
                    ", lr\n",
                    "orr r12, r12, ",
                    $tmp,
                    "\n",
                    "add lr, ",
                    $bits,
                    "\n",
                    "cmp lr, #32\n",
                    "blo 2f\n",
                    "str r12, [r11], #4\n",
                    "sub lr, #32\n",
                    "sub ",
                    $bits,
                    ", ",
                    $bits,
                    ", lr\n",
                    // What the word had no room for; nothing where that is a shift by 32.
                    "lsr r12, ",
                    $value,
                    ", ",
                    $bits,
                    "\n",
                    "2:"
                )
            };
        }
        naked_asm!(
            "push {{r4-r11, lr}}",
            // r4: the code; r7: its bits. The gap first, and a 1 above it.
            "ldm r0, {{r4-r7}}",
            "subs r4, r1, r4",
            "subs r1, r1, r5",
            "clz r5, r4",
            "subs r6, r6, r5",
            "sub r7, r7, r5, lsl #1",
            "adds r4, r4, r4",
            "adds r4, #1",
            "lsls r4, r6",
            // n, whose code has its 1 from the gap's; r2: n, r12: ON events.
            "uxth r12, r2",
            "lsrs r2, r2, #16",
            "clz r5, r2",
            "rsb r5, r5, #31",
            "adds r6, r2, r2",
            "adds r6, #1",
            "lsls r6, r5",
            "subs r6, #1",
            "lsls r6, r7",
            "adds r4, r4, r6",
            "adds r7, #1",
            "add r7, r7, r5, lsl #1",
            // ON events, with the 1 above n's code taken off.
            "sub r12, r12, #1",
            "lsl r12, r12, r7",
            "add r4, r4, r12",
            "adds r7, r7, r5",
            "adds r7, #1",
            // r5: bits of the widest level that there can be; r6: of the one that there is.
            "subs r2, #1",
            "clz r5, r2",
            "ldrd r6, r8, [r0, #16]",
            "rsb r5, r5, #32",
            "adds r5, r5, r6",
            "ldr r6, [r3, #{spread_at}]",
            "lsrs r6, r8",
            "clz r6, r6",
            "rsb r6, r6, #33",
            "cmp r6, r5",
            "it hi",
            "movhi r6, r5",
            "cmp r6, #10",
            "bhi 4f",
            "subs r5, r5, r6",
            "adds r7, r7, r5",
            "movs r9, #1",
            "lsl r5, r9, r7",
            "orrs r4, r5",
            "adds r7, #1",
            "cmp r7, #32",
            "bhi 4f",
            // No way back from here.
            "str r1, [r0]",
            "ldrd r10, r0, [sp, #36]",
            "ldm r10, {{r11, r12, lr}}",
            "add r11, r0, r11, lsl #2",
            "rsb lr, lr, #32",
            put!("r4", "r7", "r5"),
            // The first three levels; r9: 2^bits, r5: half of it, r4: the highest bit of each.
            "add r10, r3, #{sums_at}",
            "ldm r10!, {{r1-r3}}",
            "asrs r1, r8",
            "asrs r2, r8",
            "asrs r3, r8",
            "lsl r9, r9, r6",
            "lsr r5, r9, #1",
            "mla r2, r3, r9, r2",
            "mla r4, r5, r9, r5",
            "mla r1, r2, r9, r1",
            "mla r4, r4, r9, r5",
            // A negative level has borrowed from its neighbour, which half of a range more gives
            // back.
            "adds r1, r1, r4",
            "eors r1, r4",
            "add r7, r6, r6, lsl #1",
            put!("r1", "r7", "r2"),
            "cmp r6, #8",
            "bhi 3f",
            // The other four.
            "ldm r10, {{r1, r2, r3, r7}}",
            "asrs r1, r8",
            "asrs r2, r8",
            "asrs r3, r8",
            "asrs r7, r8",
            "mla r3, r7, r9, r3",
            "mla r4, r4, r9, r5",
            "mla r2, r3, r9, r2",
            "mla r1, r2, r9, r1",
            "adds r1, r1, r4",
            "eors r1, r4",
            "lsls r7, r6, #2",
            put!("r1", "r7", "r2"),
            "5:",
            "ldrd r10, r0, [sp, #36]",
            "sub r11, r11, r0",
            "lsr r11, r11, #2",
            "rsb lr, lr, #32",
            "stm r10, {{r11, r12, lr}}",
            "movs r0, #1",
            "pop {{r4-r11, pc}}",
            // Four of over 8 bits are more than a word: three and one.
            "3:",
            "ldm r10!, {{r1-r3}}",
            "asrs r1, r8",
            "asrs r2, r8",
            "asrs r3, r8",
            "mla r2, r3, r9, r2",
            "mla r1, r2, r9, r1",
            "adds r1, r1, r4",
            "eors r1, r4",
            "add r7, r6, r6, lsl #1",
            put!("r1", "r7", "r2"),
            "ldr r1, [r10]",
            "asrs r1, r8",
            "adds r1, r1, r5",
            "eors r1, r5",
            put!("r1", "r6", "r2"),
            "b 5b",
            "4:",
            "movs r0, #0",
            "pop {{r4-r11, pc}}",
            sums_at = const Cosines::SUMS_AT,
            spread_at = const Cosines::SUMS_AT + 28,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Sensor;
    use crate::packing::PIXEL_BYTES_MAX;
    use crate::quantise::Level;
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
