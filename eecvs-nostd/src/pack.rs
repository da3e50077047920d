//! Descriptors to bits and back: the payload of a frame.
//!
//! Pixels follow each other in raster order. Per pixel: the gap to the previous pixel, the event
//! counts, which coefficients follow, and their levels; docs/wire-format.md has every field.
//! Nothing adapts: every code parameter follows from the header and from what the pixel sent
//! before, so a frame decodes by itself.

use heapless::Vec;

use crate::bits::{BitReader, BitWriter, Ended, Full, exp_golomb};
use crate::descriptor::Descriptor;
use crate::event::Sensor;
use crate::prune::Kept;
use crate::quantise::{Level, Levels, Quantiser, Run, Seven};
use crate::transform::dwt::{bin_is_told, bin_of, single_levels};
use crate::transform::{M_MAX, Rule, Transform, rows};

/// Bytes that one packed pixel can take at the most: gap and counts 15, which coefficients 81,
/// 128 numbers of 4; `the_largest_pixel_fits_its_bound` packs it.
pub const PIXEL_BYTES_MAX: usize = 620;

/// Largest K whose set of coefficients is always sent as a bit each.
const MASK_GRID_MAX: u16 = 32;

/// How a payload is malformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UnpackError {
    /// The payload ends inside of a pixel.
    Ended,
    /// A pixel lies beyond the sensor.
    Position,
    /// A pixel's counts are more than what the header has left.
    Events,
    /// More coefficients than M, or an index beyond the grid.
    Levels,
    /// Bits are left after the last pixel.
    Trailing,
}

impl core::fmt::Display for UnpackError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Ended => "the payload ends inside of a pixel",
            Self::Position => "a pixel lies beyond the sensor",
            Self::Events => "a pixel's event count contradicts the header",
            Self::Levels => "a coefficient contradicts M or the grid",
            Self::Trailing => "bits are left after the last pixel",
        })
    }
}

impl core::error::Error for UnpackError {}

impl From<Ended> for UnpackError {
    fn from(_: Ended) -> Self {
        Self::Ended
    }
}

/// What both directions know of a frame before its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Packing {
    /// Sensor size.
    pub sensor: Sensor,
    /// N_w, which sets the order of the gap code.
    pub window_events: u32,
    /// Transform.
    pub transform: Transform,
    /// M, 1 to 64.
    pub m: u8,
    /// K, 1 to 1024.
    pub grid: u16,
    /// Quantiser.
    pub quantiser: Quantiser,
}

/// Bits that hold a value from 0 to `most`.
const fn width_of(most: u32) -> u32 {
    u32::BITS - most.leading_zeros()
}

impl Packing {
    /// r = min(M, K).
    #[must_use]
    pub const fn kept(&self) -> usize {
        if (self.m as u16) < self.grid {
            self.m as usize
        } else {
            self.grid as usize
        }
    }

    /// Order of the gap code: log2 of the mean gap, were every event alone in its pixel.
    const fn gap_order(&self) -> u32 {
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

    /// Bits of the widest level that a pixel of `events` can have: |c| < n.
    #[inline(always)]
    const fn level_bits_max(&self, events: u32) -> u32 {
        let fraction_bits = match self.transform {
            Transform::Dct | Transform::Dtft => -(self.quantiser.step_log2() as i32),
            // Haar levels count events, or several of them at a coarse step.
            Transform::Dwt => 0,
        };
        let bits = width_of(events.wrapping_sub(1)) as i32 + fraction_bits;
        let bits = if bits < 0 { 0 } else { bits as u32 };
        if bits < 32 { bits + 1 } else { 32 }
    }

    /// log2 of K, a power of two for the DWT, and r.
    #[inline(always)]
    const fn haar_shape(&self) -> (u32, u32) {
        ((self.grid as u32 | 1).ilog2(), self.kept() as u32)
    }

    const fn index_bits(&self) -> u32 {
        width_of((self.grid as u32).wrapping_sub(1))
    }

    /// Whether a list of indices is shorter than a bit per grid point.
    const fn lists_indices(&self, count: u32) -> bool {
        self.grid > MASK_GRID_MAX && count * self.index_bits() < self.grid as u32
    }

    /// What packs the pixels of a frame, from its first.
    #[must_use]
    pub const fn packer(&self) -> Packer {
        Packer {
            packing: *self,
            gap_order: self.gap_order(),
            one_bits: self.level_bits_max(1),
            shift: self.quantiser.shift() + rows::MORE_BITS,
            next_index: 0,
        }
    }

    /// Appends `descriptor`; `next_index` is the raster index after the previous pixel's.
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
        (x, y): (u16, u16),
        (on, off): (u32, u32),
        writer: &mut BitWriter<'_>,
    ) -> (u32, u32) {
        let index = u32::from(y) * u32::from(self.packing.sensor.width) + u32::from(x);
        let gap = index.wrapping_sub(self.next_index);
        self.next_index = index + 1;
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

    /// The levels of a pixel of `events`, none where `levels` has none.
    #[inline(always)]
    pub fn levels(&self, events: u32, levels: &impl Levels, writer: &mut BitWriter<'_>) {
        let most = self.packing.level_bits_max(events);
        put_levels((events, most), levels, writer);
    }

    /// `place`, which is what [`Self::place_code`] gave, and then [`Self::levels`] of up to
    /// [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) events; `IS_ONE` where it is one.
    #[inline(always)]
    pub fn seven_levels<const IS_ONE: bool>(
        &self,
        place: (u32, u32),
        events: u32,
        bits_of_sums: [i32; 7],
        writer: &mut BitWriter<'_>,
    ) {
        let levels = Seven {
            bits: bits_of_sums,
            shift: self.shift,
        };
        // No clamp as in `Packing::level_bits_max`: the step is 1 at the most, and events few.
        let most = width_of(events.wrapping_sub(1)) + self.one_bits;
        let (mut bits, mut code, mut code_bits) = (most, place.0, place.1);
        if !IS_ONE {
            bits = (width_of(levels.spread()) + 1).min(most);
            code_bits += most - bits;
            code |= 1 << (code_bits & 31);
            code_bits += 1;
        }
        if bits > 8 || code_bits > 32 {
            return writer.aside(|writer| seven_wide(place, (events, most), &levels, writer));
        }
        let (mut three, four) = levels.side_by_side(bits);
        let mut three_bits = 3 * bits;
        if IS_ONE && code_bits + three_bits <= 32 {
            three = code | (three << (code_bits & 31));
            three_bits += code_bits;
        } else {
            writer.put_here(code, code_bits);
        }
        writer.put_here(three, three_bits);
        writer.put_here(four, 4 * bits);
    }

    /// Which coefficients are sent, for the transforms that keep the largest.
    #[inline(always)]
    pub fn set(&self, events: u32, kept: &Kept, writer: &mut BitWriter<'_>) {
        let grid = usize::from(self.packing.grid);
        let words = kept.words(grid);
        let first = words.first().copied().unwrap_or(0);
        if self.packing.transform.is_complex() {
            let r = self.packing.kept() as u32;
            if events == 1 || r as usize == grid {
                return;
            }
            let contiguous = is_low(kept, grid, r);
            if contiguous {
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

    /// The bin of a pixel with a single event: its Haar coefficients.
    #[inline(always)]
    pub fn bin(&self, bin: u32, writer: &mut BitWriter<'_>) {
        let shape = self.packing.haar_shape();
        if bin_is_told(shape, self.packing.quantiser) {
            writer.put(bin, shape.0);
        }
    }

    fn pack(&mut self, descriptor: &Descriptor, writer: &mut BitWriter<'_>) {
        let (on, off) = (descriptor.on, descriptor.off);
        let events = descriptor.events();
        self.place((descriptor.x, descriptor.y), (on, off), writer);
        if self.packing.transform == Transform::Dwt && events == 1 {
            let finest = descriptor.levels.last().copied().unwrap_or(Level::NONE);
            let sign = on as i32 - off as i32;
            return self.bin(bin_of(finest, sign, self.packing.haar_shape().0), writer);
        }
        if self.packing.transform.rule() == Rule::Magnitude {
            let mut kept = Kept::NONE;
            for level in &descriptor.levels {
                kept.insert(usize::from(level.k));
            }
            self.set(events, &kept, writer);
        }
        let levels = DescriptorLevels {
            transform: self.packing.transform,
            levels: &descriptor.levels,
        };
        if descriptor.levels.iter().any(|level| level.k > 0) {
            self.levels(events, &levels, writer);
        }
    }
}

/// Puts the levels of a pixel of `events`, whose widest has up to `most` bits.
#[inline(always)]
fn put_levels((events, most): (u32, u32), levels: &impl Levels, writer: &mut BitWriter<'_>) {
    let mut bits = most;
    if events > 1 {
        // The bits that are not copies of the sign, of any of the levels.
        let mut spread = 0;
        levels.for_each(|level| spread |= (level ^ (level >> 31)) as u32);
        // Never more than `most`: |c| < n, and saturated levels have 32 bits.
        bits = (width_of(spread) + 1).min(most);
        writer.put_unary(most - bits);
    }
    levels.put(bits, writer);
}

/// [`Packer::seven_levels`] of any width.
#[cold]
#[inline(never)]
fn seven_wide(
    (code, code_bits): (u32, u32),
    events_and_most: (u32, u32),
    levels: &Seven,
    writer: &mut BitWriter<'_>,
) {
    writer.put_clean(code, code_bits);
    let run = Run {
        sums: &levels.bits.map(rows::sum),
        shift: levels.shift - rows::MORE_BITS,
    };
    put_levels(events_and_most, &run, writer);
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

impl Packing {
    /// Reads the next pixel; the inverse of [`Packing::pack`]. At most `events_left` events.
    ///
    /// # Errors
    /// [`UnpackError`] for bits that no encoder writes; no input makes it panic or loop.
    pub fn unpack(
        &self,
        next_index: &mut u32,
        events_left: u32,
        reader: &mut BitReader<'_>,
    ) -> Result<Descriptor, UnpackError> {
        let more = reader.get_exp_golomb(0)?;
        if more >= events_left {
            return Err(UnpackError::Events);
        }
        let events = more + 1;
        let on = reader.get(width_of(events))?;
        let off = events.checked_sub(on).ok_or(UnpackError::Events)?;
        let gap = reader.get_exp_golomb(self.gap_order())?;
        let index = next_index.checked_add(gap).ok_or(UnpackError::Position)?;
        if index >= self.sensor.pixels() {
            return Err(UnpackError::Position);
        }
        let width = u32::from(self.sensor.width);
        let mut descriptor = Descriptor {
            x: (index % width) as u16,
            y: (index / width) as u16,
            on,
            off,
            levels: Vec::new(),
        };
        if self.transform == Transform::Dwt && events == 1 {
            self.unpack_bin(&mut descriptor, reader)?;
        } else {
            self.unpack_levels(&mut descriptor, reader)?;
        }
        *next_index = index + 1;
        Ok(descriptor)
    }

    fn unpack_bin(
        &self,
        descriptor: &mut Descriptor,
        reader: &mut BitReader<'_>,
    ) -> Result<(), UnpackError> {
        let shape = self.haar_shape();
        let bin = if bin_is_told(shape, self.quantiser) {
            reader.get(shape.0)?
        } else {
            0
        };
        let sign = descriptor.on as i32 - descriptor.off as i32;
        single_levels(bin, sign, shape, self.quantiser, |level| {
            // Never full: at most r of them.
            let _ = descriptor.levels.push(level);
        });
        Ok(())
    }

    fn unpack_levels(
        &self,
        descriptor: &mut Descriptor,
        reader: &mut BitReader<'_>,
    ) -> Result<(), UnpackError> {
        let events = descriptor.events();
        let ks = self.unpack_set(events, reader)?;
        let mut bits = self.level_bits_max(events);
        let has_width = events > 1 && ks.iter().any(|k| *k > 0);
        if has_width {
            let less = reader.get_unary(32)?;
            bits = bits
                .checked_sub(less)
                .filter(|bits| *bits > 0)
                .ok_or(UnpackError::Levels)?;
        }
        let mut spread = 0;
        let mut next = || -> Result<i32, UnpackError> {
            let level = (reader.get(bits)? << (32 - bits)) as i32 >> (32 - bits);
            spread |= (level ^ (level >> 31)) as u32;
            Ok(level)
        };
        for k in ks {
            let (re, im) = match (k, self.transform) {
                (0, _) => (descriptor.on as i32 - descriptor.off as i32, 0),
                (_, Transform::Dct) => (next()?, 0),
                (_, Transform::Dtft) => (next()?, next()?),
                (_, Transform::Dwt) => {
                    let re = next()?;
                    // 25 bits at the most.
                    (re + i32::from(re >= 0), 0)
                }
            };
            if self.transform == Transform::Dwt && re == 0 {
                return Err(UnpackError::Levels);
            }
            descriptor
                .levels
                .push(Level { k, re, im })
                .map_err(|_| UnpackError::Levels)?;
        }
        // Narrower levels have a narrower width: a pixel has one encoding.
        if has_width && width_of(spread) + 1 != bits {
            return Err(UnpackError::Levels);
        }
        Ok(())
    }

    /// Indices of the coefficients that are sent, k = 0 among them where it is kept.
    fn unpack_set(
        &self,
        events: u32,
        reader: &mut BitReader<'_>,
    ) -> Result<Vec<u16, M_MAX>, UnpackError> {
        let r = self.kept() as u32;
        let mut ks = Vec::new();
        let mut keep = |k: u32| ks.push(k as u16).map_err(|_| UnpackError::Levels);
        let is_low = match self.transform {
            Transform::Dct => true,
            Transform::Dtft => events == 1 || r == u32::from(self.grid) || reader.get(1)? == 1,
            Transform::Dwt => false,
        };
        if is_low {
            (0..r).try_for_each(keep)?;
            return Ok(ks);
        }
        let mut count = None;
        if self.transform.is_complex() {
            count = Some(r);
        } else if self.grid > MASK_GRID_MAX {
            count = Some(reader.get(width_of(r))?);
        }
        if count.is_some_and(|count| count > r) {
            return Err(UnpackError::Levels);
        }
        if count.is_some_and(|count| self.lists_indices(count)) {
            let mut least = 0;
            for _ in 0..count.unwrap_or(0) {
                let k = reader.get(self.index_bits())?;
                if k < least || k >= u32::from(self.grid) {
                    return Err(UnpackError::Levels);
                }
                least = k + 1;
                keep(k)?;
            }
        } else {
            for k in 0..u32::from(self.grid) {
                if reader.get(1)? == 1 {
                    keep(k)?;
                }
            }
        }
        let found = ks.len() as u32;
        let is_contiguous = || ks.last().is_none_or(|last| u32::from(*last) + 1 == r);
        if found > r
            || count.is_some_and(|count| count != found)
            || (self.transform.is_complex() && is_contiguous())
        {
            return Err(UnpackError::Levels);
        }
        Ok(ks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn the_widest_level_follows_from_steps_and_events() {
        for (transform, step_log2, events, bits) in [
            // -64 to 63
            (Transform::Dct, -6, 1, 7),
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
                        levels: Vec::new(),
                    };
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
                        let _ = descriptor.levels.push(level);
                    }
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

    /// Unpacks a pixel at (0, 0) with `on` ON events whose `fields` (value, bits) follow its
    /// counts.
    fn unpack(packing: Packing, on: u32, fields: &[(u32, u32)]) -> Result<Descriptor, UnpackError> {
        let mut bytes = [0; 64];
        let mut writer = BitWriter::new(&mut bytes);
        writer.put_exp_golomb(on - 1, 0);
        writer.put(on, width_of(on));
        writer.put_exp_golomb(0, 0);
        for (value, bits) in fields {
            writer.put(*value, *bits);
        }
        let len = writer.finish();
        packing.unpack(&mut 0, on, &mut BitReader::new(&bytes[..len]))
    }

    /// Levels' widths of the widest possible, and of one and two less.
    const WIDEST: (u32, u32) = (1, 1);
    const ONE_LESS: (u32, u32) = (2, 2);
    const TWO_LESS: (u32, u32) = (4, 3);

    #[test]
    fn a_pixel_has_one_encoding() {
        let refused = Err(UnpackError::Levels);
        let levels = |descriptor: Result<Descriptor, _>| {
            let levels = descriptor.unwrap().levels;
            levels
                .iter()
                .map(|l| (l.k, l.re, l.im))
                .collect::<std::vec::Vec<_>>()
        };
        // Two events: Haar levels of -2 to 2, of which the positive ones move down.
        let set = packing(Transform::Dwt, 4, 16, 0);
        let mask = |mask: u32, width, first: (u32, u32), second: (u32, u32)| {
            unpack(set, 2, &[(mask, 16), width, first, second])
        };
        let found = mask(1 << 3 | 1 << 5, WIDEST, (1, 2), (3, 2));
        assert_eq!(levels(found), [(3, 2, 0), (5, -1, 0)]);
        let found = mask(1 << 3 | 1 << 5, ONE_LESS, (0, 1), (1, 1));
        assert_eq!(levels(found), [(3, 1, 0), (5, -1, 0)]);
        let found = mask(1 << 3 | 1 << 5, WIDEST, (0, 2), (3, 2));
        assert_eq!(found, refused, "a width that no level needs");
        let found = mask(1 << 3 | 1 << 5, TWO_LESS, (0, 1), (0, 1));
        assert_eq!(found, refused, "a width of 0");
        assert_eq!(
            unpack(set, 2, &[(0x1f << 3, 16), WIDEST]),
            refused,
            "5 of 4"
        );
        assert_eq!(levels(unpack(set, 2, &[(1, 16)])), [(0, 2, 0)]);
        assert_eq!(levels(unpack(set, 2, &[(0, 16)])), []);

        // More than 32 coefficients: as many as are sent, and a list.
        let wide = packing(Transform::Dwt, 4, 64, 0);
        let list = |first, second| {
            let fields = [(2, 3), (first, 6), (second, 6), ONE_LESS, (0, 1), (0, 1)];
            unpack(wide, 2, &fields)
        };
        assert_eq!(levels(list(3, 5)), [(3, 1, 0), (5, 1, 0)]);
        assert_eq!(list(5, 5), refused, "an index twice");
        assert_eq!(list(5, 3), refused, "descending indices");
        assert_eq!(unpack(wide, 2, &[(5, 3), WIDEST]), refused, "more than M");

        let complex = packing(Transform::Dtft, 2, 16, 0);
        let pair = [ONE_LESS, (0, 1), (1, 1), (1, 1), (0, 1)];
        let found = unpack(
            complex,
            2,
            &[&[(0, 1), (1 << 3 | 1 << 5, 16)], &pair[..]].concat(),
        );
        assert_eq!(levels(found), [(3, 0, -1), (5, -1, 0)]);
        let low = [&[(0, 1), (3, 16)], &pair[..]].concat();
        assert_eq!(unpack(complex, 2, &low), refused, "the lowest as a set");
        let one = [&[(0, 1), (1 << 3, 16)], &pair[..]].concat();
        assert_eq!(unpack(complex, 2, &one), refused, "fewer than r");

        let run = packing(Transform::Dct, 3, 3, 0);
        assert_eq!(
            levels(unpack(run, 2, &[WIDEST, (1, 2), (0, 2)])),
            [(0, 2, 0), (1, 1, 0), (2, 0, 0)]
        );
        let found = unpack(run, 2, &[WIDEST, (3, 2), (0, 2)]);
        assert_eq!(found, refused, "a width that no level needs");
        assert_eq!(
            levels(unpack(run, 1, &[(1, 1), (0, 1)])),
            [(0, 1, 0), (1, -1, 0), (2, 0, 0)]
        );
    }

    #[test]
    fn a_single_haar_event_is_its_bin() {
        let set = packing(Transform::Dwt, 3, 8, 0);
        let descriptor = unpack(set, 1, &[(6, 3)]).unwrap();
        let levels = descriptor.levels.iter().map(|l| (l.k, l.re));
        assert_eq!(
            levels.collect::<std::vec::Vec<_>>(),
            [(0, 1), (3, -1), (7, 1)]
        );
    }
}
