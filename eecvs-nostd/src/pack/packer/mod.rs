//! Packs descriptors to bits: the payload of a frame. [`crate::pack::unpack`] is its inverse.

#[cfg(eecvs_dsp)]
pub(crate) mod code_tables_armv7em;
#[cfg(eecvs_dsp)]
mod seven_armv7em;
#[cfg(target_arch = "x86_64")]
mod x86_64;

#[cfg(not(target_arch = "x86_64"))]
use crate::accumulate::dct8::Cosines;
use crate::accumulate::haar_bytes::Lanes;
use crate::fixed_point::CHUNK_EVENTS;
use crate::pack::bits_lsb_first::{BitWriter, Full, exp_golomb};
use crate::pack::descriptor::{Coded, Descriptor};
use crate::pack::timed::{self, TimedEvents};
use crate::prune::Kept;
use crate::quantise::{Levels, highest_bits, side_by_side};
use crate::transform::shape::{MASK_GRID_MAX, Packing, width_of};
use crate::transform::{M_MAX, Rule, Transform};

impl Packing {
    /// Returns the packer of a frame's pixels, before the first.
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

    /// Appends `descriptor`: a single event has a cell, several have levels. `next_index` is the raster index after
    /// the previous pixel's, and is moved on.
    ///
    /// # Errors
    /// [`Full`]; the caller then has to rewind the writer.
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

/// Packs pixel after pixel: of each [`Self::place`], then what the transform sends.
///
/// There are no errors: ask the writer after each pixel whether it [`BitWriter::is_full`].
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Packer {
    pub(crate) gap: GapCode,
    /// Bits of a level of one event.
    pub(crate) one_bits: u32,
    /// [`Quantiser::shift`](crate::quantise::Quantiser::shift) for the sums of
    /// [`rows`](crate::accumulate::dct8).
    pub(crate) shift: u32,
    /// Columns of the sensor.
    pub(crate) width: u32,
    /// [`Packing::cells_log2`].
    cells_log2: u32,
    pub(crate) packing: Packing,
}

/// Exp-Golomb code of the gap from one pixel to the next: [`exp_golomb`] with all that follows from its order g at
/// hand.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct GapCode {
    /// Raster index after the previous pixel's, minus 2^g.
    pub(crate) before: u32,
    /// 2^g - 1.
    less: u32,
    /// 31 - g.
    zeros_max: u32,
    /// 63 - g.
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

    /// Moves to the pixel at `index` and returns the gap plus 2^g.
    #[inline(always)]
    const fn step(&mut self, index: u32) -> u32 {
        let shifted = index.wrapping_sub(self.before);
        self.before = index.wrapping_sub(self.less);
        shifted
    }

    /// Returns the code of a value from [`Self::step`], with a 1 right above it, and its number of bits; the code
    /// is valid if that is below 32.
    #[inline(always)]
    const fn code(&self, shifted: u32) -> (u32, u32) {
        let zeros = shifted.leading_zeros();
        let code = ((shifted << 1) + 1) << (self.zeros_max.wrapping_sub(zeros) & 31);
        (code, self.bits_max.wrapping_sub(2 * zeros))
    }

    /// Returns the code of a pixel's place and counts, and its number of bits; the code is valid if that is below 32.
    #[inline(always)]
    const fn place(&self, shifted: u32, (on, off): (u32, u32)) -> (u32, u32) {
        let (gap_code, gap_bits) = self.code(shifted);
        let events = on + off;
        let (counts, counts_bits) = exp_golomb(events.wrapping_sub(1), 0);
        let before_on = gap_bits.wrapping_add(counts_bits);
        let bits = before_on.wrapping_add(width_of(events));
        // The 1 above each code is taken off the number that follows it.
        let code = gap_code
            .wrapping_add(counts.wrapping_sub(1) << (gap_bits & 31))
            .wrapping_add(on.wrapping_sub(1) << (before_on & 31));
        (code, bits)
    }

    /// Writes the code, whatever its length.
    fn put(&self, shifted: u32, writer: &mut BitWriter<'_>) {
        writer.put_exp_golomb(shifted.wrapping_sub(1 + self.less), self.order());
    }
}

impl Packer {
    /// Writes a pixel's place and counts. Pixels come in raster order.
    #[inline(always)]
    pub fn place(&mut self, (x, y): (u16, u16), counts: (u32, u32), writer: &mut BitWriter<'_>) {
        let index = u32::from(y) * self.width + u32::from(x);
        let (code, bits) = self.place_code(index, counts, writer);
        writer.put_clean(code, bits);
    }

    /// Returns what [`Self::place`] writes and its number of bits, at most 31. If it is longer, writes it and
    /// returns no bits.
    #[inline(always)]
    pub(crate) fn place_code(
        &mut self,
        index: u32,
        (on, off): (u32, u32),
        writer: &mut BitWriter<'_>,
    ) -> (u32, u32) {
        let shifted = self.gap.step(index);
        let (code, bits) = self.gap.place(shifted, (on, off));
        if bits < 32 {
            (code, bits)
        } else {
            let gap = self.gap;
            writer.aside(|writer| place_long((gap, shifted), (on, on + off), writer));
            (0, 0)
        }
    }

    /// Writes the levels of a pixel of `events` events, 2 or more.
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

    /// Writes a whole pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events: its place and the
    /// levels of its sums. The output has to have room for it.
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
        if seven_armv7em::put(self, index, counts, cosines, writer) {
            return;
        }
        self.seven_portable(index, counts, (cosines.sums(), cosines.spread()), writer);
    }

    /// As [`Self::seven`], for a raster index.
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
            // Unlike `Packing::level_bits_max` without a clamp: the step is at most 1, and events are few.
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

    /// Writes a whole pixel of 2 to [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events whose Haar
    /// differences fit bytes: its place, the set `kept`, and the levels of that set, which other lanes do not have.
    /// The output has to have room for it.
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

    /// As [`Self::bytes`], for a raster index.
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
            // A lane has up to n events: the widest level has 7 bits.
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

    /// As [`Self::place`], in one function for all callers that are in no hurry.
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

    /// Writes which coefficients are sent, for transforms that keep the largest.
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

    /// Writes a whole pixel with a single event; `cell` is its u in `cells_log2` bits.
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
        // n - 1 = 0 is coded as a one, and `on` as a bit.
        let bits = gap_bits + 2 + cells_log2;
        if bits < 32 {
            // The 1 above the gap's code is that of n - 1.
            let rest = (u32::from(is_on) + (cell << 1)) << ((gap_bits + 1) & 31);
            writer.put_here(gap_code + rest, bits);
        } else {
            let gap = self.gap;
            single_long((gap, shifted), is_on, (cell, cells_log2), writer);
        }
    }

    /// As [`Self::single`], for a pixel whose gap plus 2^g is `shifted`; `rest` holds its polarity and cell. The
    /// next gap is not counted from there: call [`Self::go_to`] first.
    #[cfg(eecvs_dsp)]
    pub(crate) fn single_after(&self, shifted: u32, rest: u32, writer: &mut BitWriter<'_>) {
        let cell = (rest >> 1, self.cells_log2);
        single_long((self.gap, shifted), rest & 1 == 1, cell, writer);
    }

    /// As [`Self::single_after`], for the pixel after which the next gap is counted from `before` (as in
    /// [`GapCode`]).
    #[cfg(eecvs_dsp)]
    pub(crate) fn single_to(&mut self, before: u32, rest: u32, writer: &mut BitWriter<'_>) {
        let shifted = self.gap.step(before.wrapping_add(self.gap.less));
        self.single_after(shifted, rest, writer);
    }

    /// As [`Self::seven`], for a gap as in [`Self::single_after`].
    #[cfg(eecvs_dsp)]
    pub(crate) fn seven_after(
        &mut self,
        shifted: u32,
        counts: (u32, u32),
        sums: &[i32; 7],
        writer: &mut BitWriter<'_>,
    ) {
        self.gap.before = 0;
        let spread = crate::accumulate::dct8::spread(sums);
        self.seven_portable(shifted, counts, (sums, spread), writer);
    }

    /// Counts the next gap from `next_index`.
    #[cfg(eecvs_dsp)]
    pub(crate) const fn go_to(&mut self, next_index: u32) {
        self.gap.go_to(next_index);
    }

    /// Returns the order of the gap code, and the index from which the next gap is counted.
    #[cfg(eecvs_dsp)]
    pub(crate) const fn gap_parts(&self) -> (u32, u32) {
        (self.gap.order(), self.gap.next_index())
    }

    /// Returns the shift from sums of [`dct8`](crate::accumulate::dct8) to levels, and the bits of a level of one
    /// event.
    #[cfg(eecvs_dsp)]
    pub(crate) const fn level_parts(&self) -> (u32, u32) {
        (self.shift, self.one_bits)
    }

    /// Moves to a pixel and returns its gap plus 2^g.
    #[cfg(eecvs_dsp)]
    pub(crate) fn step(&mut self, (x, y): (u16, u16)) -> u32 {
        self.gap.step(u32::from(y) * self.width + u32::from(x))
    }

    /// As [`Self::place`], for a pixel whose gap plus 2^g is `shifted`.
    #[cfg(eecvs_dsp)]
    pub(crate) fn place_after(&self, shifted: u32, counts: (u32, u32), writer: &mut BitWriter<'_>) {
        let (code, bits) = self.gap.place(shifted, counts);
        if bits < 32 {
            writer.put_clean(code, bits);
        } else {
            place_long((self.gap, shifted), (counts.0, counts.0 + counts.1), writer);
        }
    }

    /// Returns the number of bits of a single event's cell.
    #[inline(always)]
    #[must_use]
    pub const fn cells_log2(&self) -> u32 {
        self.cells_log2
    }

    fn times(
        &mut self,
        position: (u16, u16),
        counts: (u32, u32),
        sent: &TimedEvents,
        writer: &mut BitWriter<'_>,
    ) {
        let cells = self.packing.timed_cells(counts.0 + counts.1);
        let most = cells.count() - 1;
        self.place(position, counts, writer);
        let mut words = [0; CHUNK_EVENTS];
        for (at, event) in sent.iter().enumerate() {
            let word = event.cell.min(most) << 1 | u32::from(event.is_on);
            timed::insert(&mut words, at, word);
        }
        let words = words.iter().take(sent.len()).copied();
        timed::put(words, counts, cells, writer);
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
            Coded::Times(events) => return self.times(position, (on, off), events, writer),
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
        // Levels that no pixel of so many events can have are cut, as the code has no room for them.
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

/// Writes levels, at least one, the widest of which may have `most` bits; `spread` is [`Levels::spread`].
///
/// A function of its own for all transforms, as their levels are the same list.
#[inline(never)]
pub(crate) fn put_levels(most: u32, levels: &[u32], spread: u32, writer: &mut BitWriter<'_>) {
    // At most `most` bits anyway: |c| < n, and saturated levels have 32.
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

/// Writes levels in groups that fit a word.
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

/// [`Packer::place`], if one word does not hold it.
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

/// [`Packer::single`], if one word does not hold it.
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

/// Returns whether `kept` is 0..`r` of a grid.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantise::Level;
    use crate::quantise::Quantiser;
    use crate::transform::shape::PIXEL_BYTES_MAX;
    use crate::transform::shape::Timed;
    use event_types::Sensor;
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
            timed: Timed::NONE,
        }
    }

    /// Every code of a pixel is at its longest, for the grids whose indices take most bits.
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
        // The bound is met, not by chance: counts and gap, 640 bits of indices, one bit for the levels' width, and
        // 128 numbers of 32 bits. A narrower width takes at most 31 bits more.
        assert_eq!(
            longest,
            (45 + 47 + 24 + 1 + 640 + 1 + 128 * 32_usize).div_ceil(8)
        );
        assert!(longest + 31_usize.div_ceil(8) <= PIXEL_BYTES_MAX);
    }
}
