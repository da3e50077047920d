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
use crate::pack::timed::{self, FewCells};
use crate::prune::Kept;
use crate::quantise::Levels;
use crate::stage::{Stage, Trace};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::{Packing, Shape, Timed};
use crate::transform::{Basis, Dct, Dwt, Rule, Transform};
use crate::window::{Slot, Window};
#[cfg(target_arch = "x86_64")]
use dtft32_avx2::InRegisters;
#[cfg(eecvs_dsp)]
use walk_armv7em::InRegisters;

const CHUNK_EVENTS_U32: u32 = CHUNK_EVENTS as u32;

/// Returns whether the frame's pixels may be encoded by a [`Way`]. An image for a microcontroller has no room for its
/// ways once more, beside pixels that are sent as times: [`PixelEncoder::encode_times`] has a walk for these.
pub(crate) const fn has_ways(packing: &Packing) -> bool {
    !cfg!(eecvs_dsp) || packing.timed.events_max() == 0
}

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

/// What the pixels of a frame share.
pub(crate) struct Shared {
    pub shape: Shape,
    pub scale: PhaseScale,
    pub packer: Packer,
    cosines: Cosines,
    timed: Timed,
    few_cells: FewCells,
}

/// Encodes the pixels of a frame, one after the other.
pub(crate) struct PixelEncoder<'e, 'b> {
    shared: Shared,
    scratch: &'e mut Scratch<'b>,
    kept: &'e mut Kept,
}

impl<'e, 'b> PixelEncoder<'e, 'b> {
    pub(crate) fn new(
        packing: &Packing,
        scale: PhaseScale,
        scratch: &'e mut Scratch<'b>,
        kept: &'e mut Kept,
    ) -> Self {
        let shared = Shared {
            shape: packing.shape(),
            scale,
            packer: packing.packer(),
            cosines: Cosines::new(scale),
            timed: packing.timed,
            few_cells: packing.few_cells(),
        };
        Self {
            shared,
            scratch,
            kept,
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
            encode_single::<B, T>(&mut self.shared, pixel, slots, writer, trace);
            return 0;
        }
        if self.shared.timed.has(events) {
            encode_timed::<T>(&mut self.shared, pixel, slots, writer, trace);
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
        B::accumulate_list(&impulses, self.shared.scale, self.shared.shape.grid, sums);
        if B::RULE as u8 == Rule::Magnitude as u8 {
            set_zeroth::<B, _>(pixel, sums);
        }
        let mut rest = Rest {
            shape: self.shared.shape,
            magnitudes,
            kept: self.kept,
            packer: &mut self.shared.packer,
        };
        rest.encode::<B, Sum, T>(pixel, sums, writer, trace)
    }

    /// Encodes pixels as long as the output has room for any pixel, in a frame for which [`is_few`] holds. Returns the
    /// number of events, of pixels and of saturated levels.
    #[inline(never)]
    pub(crate) fn encode_few<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        self.encode_by::<Few, T>(group, window, writer, trace)
    }

    /// Does the same in a frame for which [`is_waves`] holds.
    #[cfg(any(eecvs_dsp, target_arch = "x86_64"))]
    #[inline(never)]
    pub(crate) fn encode_waves<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        self.encode_by::<InRegisters, T>(group, window, writer, trace)
    }

    /// Encodes pixels of the DCT or the DTFT that are sent as times, up to one that is not, where the target has a walk
    /// for them. Returns the number of events and of pixels.
    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    pub(crate) fn encode_times(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
    ) -> (u32, u32) {
        #[cfg(eecvs_dsp)]
        {
            let shared = &mut self.shared;
            let times = (shared.scale, shared.few_cells);
            let room = shared.timed.words_max();
            if !writer.has_words(room) {
                return (0, 0);
            }
            let (input, output) = ((group, window), (writer, room));
            walk_armv7em::walk_times(input, times, &mut shared.packer, output)
        }
        #[cfg(not(eecvs_dsp))]
        {
            let _ = (group, window, writer);
            (0, 0)
        }
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

    /// Does the same in a frame for which [`is_lanes`] holds.
    #[inline(always)]
    pub(crate) fn encode_lanes<T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        if self.shared.shape.grid <= haar_bytes::GRID / 2 {
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
        self.encode_by::<HaarBytes<W>, T>(group, window, writer, trace)
    }

    /// Encodes pixels in a way that its frame allows, as long as the output has room for any pixel. Returns the
    /// number of events, of pixels and of saturated levels.
    #[inline(always)]
    fn encode_by<W: Way, T: Trace>(
        &mut self,
        group: &mut Group,
        window: &mut Window<'_>,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> (u32, u32, u32) {
        let (mut events, mut pixels, mut saturated) = (0, 0, 0_u32);
        let room = W::words_max(self.shared.shape).max(self.shared.timed.words_max());
        while writer.has_words(room) {
            trace.enter(Stage::Group);
            let crowded = 'chunk: {
                let shared = &mut self.shared;
                let Some(mut memory) = W::memory(shared, self.scratch) else {
                    // Never reached: `Config::check` requires the memory.
                    break 'chunk None;
                };
                // A trace wants to know each stage, which a walk mixes.
                if W::HAS_WALK && !T::LISTENS {
                    let (some, places) =
                        W::walk(shared, &mut memory, (group, window), (writer, room));
                    events += some;
                    pixels += places;
                }
                loop {
                    if !writer.has_words(room) {
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
                    if W::HAS_WALK && !T::LISTENS {
                        // Never reached: the walk has encoded all of these.
                        group.put_back(pixel);
                        break None;
                    }
                    let slots = window.slots();
                    if here == 1 {
                        encode_single::<W::Basis, T>(shared, pixel, slots, writer, trace);
                    } else if shared.timed.has(here) {
                        encode_timed::<T>(shared, pixel, slots, writer, trace);
                    } else {
                        W::encode(shared, &mut memory, pixel, slots, writer, trace);
                    }
                    events += here;
                    pixels += 1;
                }
            };
            let Some(pixel) = crowded else {
                break;
            };
            events += pixel.on + pixel.off;
            pixels += 1;
            let slots = window.slots();
            let saturates = self.encode_crowded::<W::Basis, T>(pixel, slots, writer, trace);
            saturated = saturated.saturating_add(saturates);
        }
        (events, pixels, saturated)
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
        sum_crowded::<B>(
            pixel,
            slots,
            self.shared.scale,
            self.shared.shape.grid,
            (sums, totals),
        );
        let mut rest = Rest {
            shape: self.shared.shape,
            magnitudes,
            kept: self.kept,
            packer: &mut self.shared.packer,
        };
        rest.encode::<B, WideSum, T>(pixel, totals, writer, trace)
    }
}

/// A way to encode the pixels of a frame in one go. Each way gives the bits of [`PixelEncoder::encode`].
pub(crate) trait Way {
    type Basis: Basis;
    /// What it has borrowed for its sums.
    type Memory<'p>;

    /// Whether [`Self::walk`] encodes pixels, all up to a crowded one.
    const HAS_WALK: bool = false;

    /// Returns the largest number of words that a pixel of 1 event up to a chunk takes.
    fn words_max(shape: Shape) -> usize;

    /// Borrows memory for pixels up to a crowded one; `None` if there is too little.
    fn memory<'p>(shared: &Shared, scratch: &'p mut Scratch<'_>) -> Option<Self::Memory<'p>>;

    /// Encodes pixels up to the window's last one or to a crowded one, which the group then returns next, or until
    /// the output has less than `room` words left. Returns the number of events and of pixels.
    fn walk(
        _: &mut Shared,
        _: &mut Self::Memory<'_>,
        _input: (&mut Group, &mut Window<'_>),
        _output: (&mut BitWriter<'_>, usize),
    ) -> (u32, u32) {
        (0, 0)
    }

    /// Encodes a pixel of 2 events up to a chunk.
    fn encode<T: Trace>(
        shared: &mut Shared,
        memory: &mut Self::Memory<'_>,
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    );
}

/// Few DCT coefficients, all kept: [`is_few`].
struct Few;

impl Way for Few {
    type Basis = Dct;
    type Memory<'p> = ();

    const HAS_WALK: bool = cfg!(eecvs_dsp);

    #[inline(always)]
    fn words_max(_: Shape) -> usize {
        FEW_WORDS_MAX
    }

    #[inline(always)]
    fn memory(_: &Shared, _: &mut Scratch<'_>) -> Option<()> {
        Some(())
    }

    #[cfg(eecvs_dsp)]
    #[inline(always)]
    fn walk(
        shared: &mut Shared,
        (): &mut (),
        input: (&mut Group, &mut Window<'_>),
        output: (&mut BitWriter<'_>, usize),
    ) -> (u32, u32) {
        walk_armv7em::walk(input, shared.scale, &mut shared.packer, output, None)
    }

    #[inline(always)]
    fn encode<T: Trace>(
        shared: &mut Shared,
        (): &mut (),
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        trace.enter(Stage::Accumulate);
        let impulses = Impulses::new(pixel, slots);
        let (position, counts) = ((pixel.x, pixel.y), (pixel.on, pixel.off));
        #[cfg(target_arch = "x86_64")]
        {
            let sums = shared.cosines.sums_of(&impulses);
            trace.enter(Stage::Pack);
            shared.packer.seven_vectors(position, counts, sums, writer);
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            shared.cosines.sum(&impulses);
            trace.enter(Stage::Pack);
            shared
                .packer
                .seven(position, counts, &shared.cosines, writer);
        }
    }
}

/// Haar differences as bytes in W words: [`is_lanes`].
struct HaarBytes<const W: usize>;

impl<const W: usize> Way for HaarBytes<W> {
    type Basis = Dwt;
    type Memory<'p> = ();

    const HAS_WALK: bool = cfg!(eecvs_dsp) && W == 4;

    #[inline(always)]
    fn words_max(_: Shape) -> usize {
        LANES_WORDS_MAX
    }

    #[inline(always)]
    fn memory(_: &Shared, _: &mut Scratch<'_>) -> Option<()> {
        Some(())
    }

    #[cfg(eecvs_dsp)]
    #[inline(always)]
    fn walk(
        shared: &mut Shared,
        (): &mut (),
        input: (&mut Group, &mut Window<'_>),
        output: (&mut BitWriter<'_>, usize),
    ) -> (u32, u32) {
        // Always present: `is_lanes` has checked this.
        let duration_us = haar16_armv7em::divisor(shared.shape, shared.scale);
        let r = shared.shape.r as u32;
        duration_us.map_or((0, 0), |duration_us| {
            haar16_armv7em::walk(input, duration_us, r, &mut shared.packer, output)
        })
    }

    #[inline(always)]
    fn encode<T: Trace>(
        shared: &mut Shared,
        (): &mut (),
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        trace.enter(Stage::Accumulate);
        let r = shared.shape.r as u32;
        let mut sums = sum_lanes::<W>(&Impulses::new(pixel, slots), shared.shape, shared.scale);
        trace.enter(Stage::Prune);
        let nonzero = sums.nonzero();
        let mut kept = nonzero.bits();
        if nonzero.count() > r {
            kept = haar_bytes::largest(sums, pixel.on + pixel.off, r);
            sums = sums.keep(kept);
        }
        trace.enter(Stage::Quantise);
        let levels = sums.levels();
        let spread = levels.spread();
        trace.enter(Stage::Pack);
        let (position, counts) = ((pixel.x, pixel.y), (pixel.on, pixel.off));
        shared
            .packer
            .bytes(position, counts, (kept, levels, spread), writer);
    }
}

/// Returns the Haar differences of a pixel that comes from a group.
#[inline(always)]
#[cfg_attr(eecvs_dsp, allow(unsafe_code))]
fn sum_lanes<const W: usize>(impulses: &Impulses<'_>, shape: Shape, scale: PhaseScale) -> Lanes<W> {
    #[cfg(eecvs_dsp)]
    {
        // Always present: `is_lanes` has checked this.
        let duration_us = haar16_armv7em::divisor(shape, scale).unwrap_or(u32::MAX);
        // SAFETY: the list is the group's, holds events of this window, and is not empty.
        unsafe { haar16_armv7em::sum(impulses, duration_us) }
    }
    #[cfg(not(eecvs_dsp))]
    haar_bytes::sum(impulses.clone(), scale, shape.grid.trailing_zeros())
}

/// Encodes a pixel of one event, whose coefficients follow from its time.
#[inline(always)]
fn encode_single<B: Basis, T: Trace>(
    shared: &mut Shared,
    pixel: Pixel,
    slots: &[Slot],
    writer: &mut BitWriter<'_>,
    trace: &mut T,
) {
    trace.enter(Stage::Accumulate);
    let first = Impulses::new(pixel, slots).next();
    let offset_us = first.map_or(0, |impulse| impulse.offset_us);
    let cell = B::cell(shared.scale, offset_us, shared.packer.cells_log2());
    trace.enter(Stage::Pack);
    shared
        .packer
        .single((pixel.x, pixel.y), pixel.on == 1, cell, writer);
}

/// Encodes a pixel of few events as their times.
#[inline(never)]
fn encode_timed<T: Trace>(
    shared: &mut Shared,
    pixel: Pixel,
    slots: &[Slot],
    writer: &mut BitWriter<'_>,
    trace: &mut T,
) {
    trace.enter(Stage::Quantise);
    let counts = (pixel.on, pixel.off);
    let cells = shared.few_cells.of(pixel.on + pixel.off);
    trace.enter(Stage::Pack);
    shared
        .packer
        .place_apart((pixel.x, pixel.y), counts, writer);
    let impulses = Impulses::new(pixel, slots);
    timed::put_pixel(&impulses, counts, (cells, shared.scale), writer);
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
