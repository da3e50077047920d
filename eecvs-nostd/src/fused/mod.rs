//! Encodes a pixel from its events to its bits in one go: accumulate, prune, quantise, pack.

#[cfg(eecvs_dsp)]
pub(crate) mod dtft32_armv7em;
#[cfg(target_arch = "x86_64")]
pub(crate) mod dtft32_avx2;
#[cfg(eecvs_dsp)]
pub(crate) mod haar16_armv7em;
#[cfg(eecvs_dsp)]
pub(crate) mod walk_armv7em;

use crate::accumulate::dct8;
use crate::accumulate::dct8::Cosines;
use crate::accumulate::haar_bytes;
use crate::accumulate::haar_bytes::Lanes;
use crate::encoder::config::Scratch;
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, Sum, WideSum};
use crate::group::{Group, Impulses, Pixel};
use crate::pack::bits_lsb_first::BitWriter;
use crate::pack::packer::Packer;
use crate::prune::Kept;
use crate::quantise::Levels;
use crate::stage::{Stage, Trace};
#[cfg(any(eecvs_dsp, target_arch = "x86_64"))]
use crate::transform::Dtft;
use crate::transform::phase::PhaseScale;
use crate::transform::shape::{Packing, Shape};
use crate::transform::{Basis, Dct, Dwt, Rule, Transform};
use crate::window::{Slot, Window};
#[cfg(eecvs_dsp)]
use dtft32_armv7em::Waves;

const CHUNK_EVENTS_U32: u32 = CHUNK_EVENTS as u32;

/// Returns whether all DCT coefficients fit the registers and are kept, with a step of at most 1:
/// [`PixelEncoder::encode_few`] handles these frames.
pub(crate) fn is_few(packing: &Packing) -> bool {
    packing.transform == Transform::Dct
        && usize::from(packing.m) == dct8::GRID
        && usize::from(packing.grid) == dct8::GRID
        && packing.quantiser.step_log2() <= 0
}

/// Returns whether a pixel's Fourier coefficients are computed and packed in one go: [`PixelEncoder::encode_waves`]
/// handles these frames.
pub(crate) fn is_waves(packing: &Packing) -> bool {
    #[cfg(eecvs_dsp)]
    return dtft32_armv7em::is_for(packing);
    #[cfg(target_arch = "x86_64")]
    return dtft32_avx2::is_for(packing);
    #[cfg(not(any(eecvs_dsp, target_arch = "x86_64")))]
    {
        let _ = packing;
        false
    }
}

/// Largest number of words that a pixel takes if [`is_few`] holds: counts and gap, 3 * 31 bits and 3; a width of up
/// to 32 bits and 7 levels of 32; and one word for bits that were pending.
const FEW_WORDS_MAX: usize = 3 + 1 + 7 + 1;

/// Returns whether a pixel's Haar differences are bytes in a few words, and are also its levels:
/// [`PixelEncoder::encode_lanes`] handles these frames.
pub(crate) fn is_lanes(packing: &Packing, scale: PhaseScale) -> bool {
    let is_small = packing.transform == Transform::Dwt
        && usize::from(packing.grid) <= haar_bytes::GRID
        && packing.quantiser.step_log2() <= 0;
    // A firmware image has no room for the assembly's portable twin, so only what the assembly handles counts.
    #[cfg(eecvs_dsp)]
    let is_small = is_small && haar16_armv7em::divisor(packing.shape(), scale).is_some();
    #[cfg(not(eecvs_dsp))]
    let _ = scale;
    is_small
}

/// Largest number of words that a pixel takes in [`PixelEncoder::encode_lanes`]: counts and gap; the set; a width
/// and a level for each coefficient, of up to 32 bits; and one word for bits that were pending.
const LANES_WORDS_MAX: usize = 4 + 1 + haar_bytes::GRID + 1;

/// Encodes the pixels of a frame, one after the other.
pub(crate) struct PixelEncoder<'e, 'b> {
    shape: Shape,
    scale: PhaseScale,
    scratch: &'e mut Scratch<'b>,
    kept: &'e mut Kept,
    packer: Packer,
    cosines: Cosines,
}

impl<'e, 'b> PixelEncoder<'e, 'b> {
    pub(crate) fn new(
        packing: &Packing,
        scale: PhaseScale,
        scratch: &'e mut Scratch<'b>,
        kept: &'e mut Kept,
    ) -> Self {
        Self {
            shape: packing.shape(),
            scale,
            scratch,
            kept,
            packer: packing.packer(),
            cosines: Cosines::new(scale),
        }
    }

    /// Encodes a pixel; returns how many levels saturated.
    #[inline(always)]
    pub(crate) fn encode<B: Basis, T: Trace>(
        &mut self,
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> u32 {
        let events = pixel.on + pixel.off;
        if events == 1 {
            encode_single::<B, T>((self.scale, &mut self.packer), pixel, slots, writer, trace);
            return 0;
        }
        // In a firmware image, pixels without code of their own share the code of the widest sums.
        let is_rare = cfg!(eecvs_dsp) && B::TRANSFORM as u8 == Transform::Dwt as u8;
        if is_rare || events as usize > CHUNK_EVENTS {
            return self.encode_crowded::<B, T>(pixel, slots, writer, trace);
        }
        trace.enter(Stage::Accumulate);
        let Scratch {
            sums, magnitudes, ..
        } = &mut *self.scratch;
        let impulses = Impulses::new(pixel, slots);
        B::accumulate_list(&impulses, self.scale, self.shape.grid, sums);
        if B::RULE as u8 == Rule::Magnitude as u8 {
            set_zeroth::<B, _>(pixel, sums);
        }
        let mut rest = Rest {
            shape: self.shape,
            magnitudes,
            kept: self.kept,
            packer: &mut self.packer,
        };
        rest.encode::<B, Sum, T>(pixel, sums, writer, trace)
    }

    /// Encodes pixels as long as the output has room for any pixel, in a frame for which [`is_few`] holds. The few
    /// coefficients have a loop and a packing of their own. Returns the number of events, of pixels and of
    /// saturated levels.
    #[inline(never)]
    pub(crate) fn encode_few<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        let (mut events, mut pixels, mut saturated) = (0, 0, 0_u32);
        while writer.has_words(FEW_WORDS_MAX) {
            trace.enter(Stage::Group);
            #[cfg(eecvs_dsp)]
            if !T::LISTENS {
                let room = (&mut *writer, FEW_WORDS_MAX);
                let (some, places) =
                    walk_armv7em::walk((group, window), self.scale, &mut self.packer, room, None);
                events += some;
                pixels += places;
                if !writer.has_words(FEW_WORDS_MAX) {
                    break;
                }
            }
            let Some(pixel) = group.next(window) else {
                break;
            };
            let slots = window.slots();
            let here = pixel.on + pixel.off;
            if cfg!(eecvs_dsp) && !T::LISTENS && here <= CHUNK_EVENTS_U32 {
                // Never reached: the walk has encoded all of these.
                group.put_back(pixel);
                break;
            }
            match here {
                1 => encode_single::<Dct, T>(
                    (self.scale, &mut self.packer),
                    pixel,
                    slots,
                    writer,
                    trace,
                ),
                2..=CHUNK_EVENTS_U32 => self.encode_several(&pixel, slots, writer, trace),
                _ => {
                    let saturates = self.encode_crowded::<Dct, T>(pixel, slots, writer, trace);
                    saturated = saturated.saturating_add(saturates);
                }
            }
            events += here;
            pixels += 1;
        }
        (events, pixels, saturated)
    }

    /// Encodes pixels as long as the output has room for any pixel, in a frame for which [`dtft32_armv7em::is_for`]
    /// holds. Returns the number of events, of pixels and of saturated levels.
    #[cfg(eecvs_dsp)]
    #[inline(never)]
    pub(crate) fn encode_waves<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        let (mut events, mut pixels, mut saturated) = (0, 0, 0_u32);
        let words = dtft32_armv7em::words_max(self.shape);
        while writer.has_words(words) {
            let memory = (&mut *self.scratch.sums, &mut *self.scratch.magnitudes);
            let Some(mut waves) = Waves::new(self.shape, self.scale, memory, &self.packer) else {
                // Never reached: `Config::check` requires the memory.
                break;
            };
            if !T::LISTENS {
                let room = (&mut *writer, words);
                let all = (&mut *group, &mut *window);
                let (some, places) =
                    walk_armv7em::walk(all, self.scale, &mut self.packer, room, Some(&mut waves));
                events += some;
                pixels += places;
            }
            let crowded = loop {
                if !writer.has_words(words) {
                    break None;
                }
                trace.enter(Stage::Group);
                let Some(pixel) = group.next(window) else {
                    break None;
                };
                let here = pixel.on + pixel.off;
                if here > CHUNK_EVENTS_U32 {
                    break Some(pixel);
                }
                if !T::LISTENS {
                    // Never reached: the walk has encoded all of these.
                    group.put_back(pixel);
                    break None;
                }
                let slots = window.slots();
                if here == 1 {
                    let packer = (self.scale, &mut self.packer);
                    encode_single::<Dtft, T>(packer, pixel, slots, writer, trace);
                } else {
                    let gap = 2 * self.packer.step((pixel.x, pixel.y)) + 1;
                    let tally = (here << 16) | pixel.on;
                    let impulses = Impulses::new(pixel, slots);
                    waves.encode((gap, tally), &impulses, &self.packer, writer, trace);
                }
                events += here;
                pixels += 1;
            };
            let Some(pixel) = crowded else {
                break;
            };
            events += pixel.on + pixel.off;
            pixels += 1;
            let saturates = self.encode_crowded::<Dtft, T>(pixel, window.slots(), writer, trace);
            saturated = saturated.saturating_add(saturates);
        }
        (events, pixels, saturated)
    }

    /// Never called, because [`is_waves`] holds for no frame.
    #[cfg(not(any(eecvs_dsp, target_arch = "x86_64")))]
    pub(crate) const fn encode_waves<T: Trace>(
        &mut self,
        _: &mut Group,
        _: &mut Window<'_>,
        _: &mut BitWriter<'_>,
        _: &mut T,
    ) -> (u32, u32, u32) {
        (0, 0, 0)
    }

    /// Encodes pixels as long as the output has room for any pixel, in a frame for which [`dtft32_avx2::is_for`]
    /// holds. Returns the number of events, of pixels and of saturated levels.
    #[cfg(target_arch = "x86_64")]
    #[allow(unsafe_code)]
    #[inline(never)]
    pub(crate) fn encode_waves<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        let (mut events, mut pixels, mut saturated) = (0, 0, 0_u32);
        let waves = dtft32_avx2::Waves::new(self.shape, self.scale);
        while writer.has_words(dtft32_avx2::WORDS_MAX) {
            trace.enter(Stage::Group);
            let Some(pixel) = group.next(window) else {
                break;
            };
            let slots = window.slots();
            let here = pixel.on + pixel.off;
            let packer = &mut self.packer;
            match here {
                1 => encode_single::<Dtft, T>((self.scale, packer), pixel, slots, writer, trace),
                // SAFETY: this is called only for frames for which `dtft32_avx2::is_for` holds.
                2..=CHUNK_EVENTS_U32 => unsafe {
                    waves.encode(pixel, slots, packer, writer, trace);
                },
                _ => {
                    let saturates = self.encode_crowded::<Dtft, T>(pixel, slots, writer, trace);
                    saturated = saturated.saturating_add(saturates);
                }
            }
            events += here;
            pixels += 1;
        }
        (events, pixels, saturated)
    }

    /// Encodes pixels as long as the output has room for any pixel, in a frame for which [`is_lanes`] holds.
    /// Returns the number of events, of pixels and of saturated levels.
    #[inline(always)]
    pub(crate) fn encode_lanes<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        if self.shape.grid <= haar_bytes::GRID / 2 {
            self.encode_lanes_of::<4, T>(group, window, writer, trace)
        } else {
            self.encode_lanes_of::<8, T>(group, window, writer, trace)
        }
    }

    /// Does [`Self::encode_lanes`] with lanes of W words.
    #[inline(never)]
    fn encode_lanes_of<const W: usize, T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        let (mut events, mut pixels, mut saturated) = (0, 0, 0_u32);
        while writer.has_words(LANES_WORDS_MAX) {
            trace.enter(Stage::Group);
            #[cfg(eecvs_dsp)]
            if W == 4
                && !T::LISTENS
                && let Some(duration_us) = haar16_armv7em::divisor(self.shape, self.scale)
            {
                let r = self.shape.r as u32;
                let room = (&mut *writer, LANES_WORDS_MAX);
                let (some, places) =
                    haar16_armv7em::walk((group, window), duration_us, r, &mut self.packer, room);
                events += some;
                pixels += places;
                if !writer.has_words(LANES_WORDS_MAX) {
                    break;
                }
            }
            let Some(pixel) = group.next(window) else {
                break;
            };
            let slots = window.slots();
            let here = pixel.on + pixel.off;
            if cfg!(eecvs_dsp) && W == 4 && !T::LISTENS && here <= CHUNK_EVENTS_U32 {
                // Never reached: the walk has encoded all of these.
                group.put_back(pixel);
                break;
            }
            match here {
                1 => encode_single::<Dwt, T>(
                    (self.scale, &mut self.packer),
                    pixel,
                    slots,
                    writer,
                    trace,
                ),
                2..=CHUNK_EVENTS_U32 => self.encode_bytes::<W, T>(pixel, slots, writer, trace),
                _ => {
                    let saturates = self.encode_crowded::<Dwt, T>(pixel, slots, writer, trace);
                    saturated = saturated.saturating_add(saturates);
                }
            }
            events += here;
            pixels += 1;
        }
        (events, pixels, saturated)
    }

    /// Returns the differences of a pixel that comes from a group.
    #[inline(always)]
    #[cfg_attr(eecvs_dsp, allow(unsafe_code))]
    fn sum_lanes<const W: usize>(&self, impulses: &Impulses<'_>) -> Lanes<W> {
        #[cfg(eecvs_dsp)]
        {
            // Always present: `is_lanes` has checked this.
            let duration_us = haar16_armv7em::divisor(self.shape, self.scale).unwrap_or(u32::MAX);
            // SAFETY: the list is the group's, holds events of this window, and is not empty.
            unsafe { haar16_armv7em::sum(impulses, duration_us) }
        }
        #[cfg(not(eecvs_dsp))]
        haar_bytes::sum(
            impulses.clone(),
            self.scale,
            self.shape.grid.trailing_zeros(),
        )
    }

    /// Encodes a pixel of 2 events up to a chunk, with its differences as bytes.
    #[inline(always)]
    fn encode_bytes<const W: usize, T: Trace>(
        &mut self,
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        trace.enter(Stage::Accumulate);
        let mut sums = self.sum_lanes::<W>(&Impulses::new(pixel, slots));
        trace.enter(Stage::Prune);
        let nonzero = sums.nonzero();
        let mut kept = nonzero.bits();
        if nonzero.count() > self.shape.r as u32 {
            kept = haar_bytes::largest(sums, pixel.on + pixel.off, self.shape.r as u32);
            sums = sums.keep(kept);
        }
        trace.enter(Stage::Quantise);
        let levels = sums.levels();
        let spread = levels.spread();
        trace.enter(Stage::Pack);
        let (position, counts) = ((pixel.x, pixel.y), (pixel.on, pixel.off));
        self.packer
            .bytes(position, counts, (kept, levels, spread), writer);
    }

    /// Encodes a pixel of 2 events up to a chunk.
    #[inline(always)]
    fn encode_several<T: Trace>(
        &mut self,
        pixel: &Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        trace.enter(Stage::Accumulate);
        let impulses = Impulses::new(*pixel, slots);
        let (position, counts) = ((pixel.x, pixel.y), (pixel.on, pixel.off));
        #[cfg(target_arch = "x86_64")]
        {
            let sums = self.cosines.sums_of(&impulses);
            trace.enter(Stage::Pack);
            self.packer.seven_vectors(position, counts, sums, writer);
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            self.cosines.sum(&impulses);
            trace.enter(Stage::Pack);
            self.packer.seven(position, counts, &self.cosines, writer);
        }
    }

    /// Encodes a pixel of several chunks; returns how many levels saturated.
    #[cold]
    #[inline(never)]
    fn encode_crowded<B: Basis, T: Trace>(
        &mut self,
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> u32 {
        trace.enter(Stage::Accumulate);
        let Scratch {
            sums,
            totals,
            magnitudes,
            ..
        } = &mut *self.scratch;
        sum_crowded::<B>(pixel, slots, self.scale, self.shape.grid, (sums, totals));
        let mut rest = Rest {
            shape: self.shape,
            magnitudes,
            kept: self.kept,
            packer: &mut self.packer,
        };
        rest.encode::<B, WideSum, T>(pixel, totals, writer, trace)
    }
}

/// Encodes a pixel of one event, whose coefficients follow from its time.
#[inline(always)]
fn encode_single<B: Basis, T: Trace>(
    (scale, packer): (PhaseScale, &mut Packer),
    pixel: Pixel,
    slots: &[Slot],
    writer: &mut BitWriter<'_>,
    trace: &mut T,
) {
    trace.enter(Stage::Accumulate);
    let first = Impulses::new(pixel, slots).next();
    let offset_us = first.map_or(0, |impulse| impulse.offset_us);
    let cell = B::cell(scale, offset_us, packer.cells_log2());
    trace.enter(Stage::Pack);
    packer.single((pixel.x, pixel.y), pixel.on == 1, cell, writer);
}

/// Writes the coefficients of a pixel of several chunks to `totals`.
#[inline(always)]
pub(crate) fn sum_crowded<B: Basis>(
    pixel: Pixel,
    slots: &[Slot],
    scale: PhaseScale,
    grid: usize,
    (sums, totals): (&mut [Sum], &mut [WideSum]),
) {
    let values = B::values(grid);
    for total in totals.iter_mut().take(values) {
        *total = WideSum::ZERO;
    }
    let mut impulses = Impulses::new(pixel, slots);
    for _ in 0..(pixel.on + pixel.off).div_ceil(CHUNK_EVENTS_U32) {
        let rest = B::accumulate_list(&impulses, scale, grid, sums);
        for (total, sum) in totals.iter_mut().zip(sums.iter()).take(values) {
            // Fewer than 2^24 events of at most 1 each stay far below a total's limit of 2^38.
            *total = total.wrapping_add(sum.wide());
        }
        impulses = rest.unwrap_or_else(|| {
            let _ = impulses.nth(CHUNK_EVENTS - 1);
            impulses
        });
    }
    set_zeroth::<B, _>(pixel, totals);
}

/// Sets c_0 = on - off.
#[inline(always)]
pub(crate) fn set_zeroth<B: Basis, C: Coefficient>(pixel: Pixel, sums: &mut [C]) {
    if let Some(re) = sums.first_mut() {
        *re = C::from_integer(pixel.on as i32 - pixel.off as i32);
    }
    if B::TRANSFORM.is_complex()
        && let Some(im) = sums.get_mut(1)
    {
        *im = C::from_integer(0);
    }
}

/// The stages after accumulation, for coefficients of either width.
struct Rest<'e> {
    shape: Shape,
    magnitudes: &'e mut [u32],
    kept: &'e mut Kept,
    packer: &'e mut Packer,
}

impl Rest<'_> {
    #[inline(always)]
    fn encode<B: Basis, C: Coefficient, T: Trace>(
        &mut self,
        pixel: Pixel,
        sums: &[C],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> u32 {
        let shape = self.shape;
        let is_pruned = B::RULE as u8 == Rule::Magnitude as u8;
        let (counts, events) = ((pixel.on, pixel.off), pixel.on + pixel.off);
        if is_pruned {
            trace.enter(Stage::Prune);
            self.kept.clear(shape.grid);
            B::prune(sums, events, shape, self.magnitudes, self.kept);
        }
        trace.enter(Stage::Quantise);
        let mut levels = Levels::new(self.magnitudes);
        B::quantise(sums, shape, self.kept, &mut levels);
        trace.enter(Stage::Pack);
        let position = (pixel.x, pixel.y);
        if is_pruned {
            // In a firmware image most of these pixels have code of their own.
            self.packer.place_apart(position, counts, writer);
            self.packer.set(self.kept, writer);
        } else {
            self.packer.place(position, counts, writer);
        }
        self.packer.levels(events, &levels, writer);
        levels.saturated()
    }
}
