//! A plainly written second encoder, in which each kind of skipping can be switched off.
//!
//! It uses the core's stages, and its frames are the core's bit by bit, except with [`Skips::singles`] off. Runs
//! with different [`Skips`] therefore differ in time only by what they skip.

use std::hint::black_box;
use std::marker::PhantomData;
use std::mem;
use std::ops::Range;

use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Coefficient, Sum, WideSum};
use eecvs_nostd::frame::{CRC_BYTES, HEADER_BYTES_MAX, seal};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::pack::bits_lsb_first::BitWriter;
use eecvs_nostd::pack::packer::Packer;
use eecvs_nostd::prune::Kept;
use eecvs_nostd::quantise::Levels;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, GRID_MAX, Rule, Transform};
use eecvs_nostd::window::SEGMENT_PIXELS;
use eecvs_nostd::{Event, Header, NoRoom, Polarity, Shape, bitmap_words, segments};

/// The kinds of skipping; `true` means that the encoder skips.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skips {
    /// Finds the segments of 32 pixels that have events by a bitmap with one bit per segment, instead of visiting
    /// every segment.
    pub segments: bool,
    /// Finds the pixels of a segment that have events by a bitmap with one bit per pixel, instead of visiting every
    /// pixel.
    pub pixels: bool,
    /// Does not transform pixels without events.
    pub transforms: bool,
    /// Sends a pixel's single event as the cell of its time, instead of accumulating it and sending levels.
    pub singles: bool,
    /// Accumulates the Haar transform as [`Basis::accumulate`] does, instead of always from bins by butterflies.
    /// For K up to 32, which M = 8 has, that function sums rows of bytes on a host; for larger K it adds few events
    /// directly to the coefficients that they change.
    pub butterflies: bool,
}

impl Skips {
    /// Skips everything, as the core's encoder does.
    pub const ALL: Self = Self {
        segments: true,
        pixels: true,
        transforms: true,
        singles: true,
        butterflies: true,
    };
    /// Skips nothing.
    pub const NONE: Self = Self {
        segments: false,
        pixels: false,
        transforms: false,
        singles: false,
        butterflies: false,
    };
}

/// The index that means "no slot".
const NONE: u32 = u32::MAX;
const COLUMNS: usize = SEGMENT_PIXELS as usize;

/// A buffered event.
#[derive(Debug, Clone, Copy)]
struct Slot {
    impulse: Impulse,
    column: u8,
    /// The next slot of the same list, or [`NONE`].
    next: u32,
}

/// An encoder that makes one frame per window, with the transform `B`.
pub struct Plain<B> {
    skips: Skips,
    /// Number of segments in a row.
    stride: usize,
    width: usize,
    slots: Vec<Slot>,
    /// The slot of each segment's newest event, or [`NONE`].
    heads: Vec<u32>,
    /// One bit per segment: whether it has events.
    bitmap: Vec<u32>,
    stages: Stages<B>,
}

/// The stages from a pixel's events to bits, with their memory.
struct Stages<B> {
    skips: Skips,
    shape: Shape,
    scale: PhaseScale,
    sums: Vec<Sum>,
    totals: Vec<WideSum>,
    magnitudes: Vec<u32>,
    kept: Kept,
    basis: PhantomData<B>,
}

/// A pixel's coordinates and numbers of events.
#[derive(Debug, Clone, Copy)]
struct Place {
    x: u16,
    y: u16,
    on: u32,
    off: u32,
}

/// Iterates over the events of a pixel's list, oldest first.
#[derive(Clone)]
struct List<'s> {
    slots: &'s [Slot],
    next: u32,
}

impl Iterator for List<'_> {
    type Item = Impulse;

    #[inline(always)]
    fn next(&mut self) -> Option<Impulse> {
        let slot = self.slots.get(self.next as usize)?;
        self.next = slot.next;
        Some(slot.impulse)
    }
}

impl<B: Basis> Plain<B> {
    /// Creates an encoder of windows with the sensor, T and parameters of `header`; it skips everything.
    pub fn new(header: &Header) -> Self {
        let skips = Skips::ALL;
        let [width, height] = [header.sensor.width, header.sensor.height];
        let segments = segments(width, height);
        Self {
            skips,
            stride: width.div_ceil(SEGMENT_PIXELS).into(),
            width: width.into(),
            slots: Vec::new(),
            heads: vec![NONE; segments],
            bitmap: vec![0; bitmap_words(segments)],
            stages: Stages {
                skips,
                shape: header.packing().shape(),
                scale: PhaseScale::new(header.duration_us),
                sums: vec![Sum::ZERO; 2 * GRID_MAX],
                totals: vec![WideSum::ZERO; 2 * GRID_MAX],
                magnitudes: vec![0; 2 * GRID_MAX],
                kept: Kept::NONE,
                basis: PhantomData,
            },
        }
    }

    /// Sets what is skipped from now on. The memory stays the same.
    pub const fn skip(&mut self, skips: Skips) {
        self.skips = skips;
        self.stages.skips = skips;
    }

    /// Encodes the events of a window and returns the range of the frame within `out`.
    ///
    /// `events` must lie in the window and on the sensor. The frame's header is `header`, whose `events`, `pixels`
    /// and `saturated` are replaced by what is counted here.
    ///
    /// # Errors
    /// [`NoRoom`] if the frame does not fit into `out`.
    pub fn frame(
        &mut self,
        events: &[Event],
        mut header: Header,
        out: &mut [u8],
    ) -> Result<Range<usize>, NoRoom> {
        self.slots.clear();
        for event in events {
            self.store(event, header.t0_us);
        }
        let end = out.len() - CRC_BYTES;
        let mut writer = BitWriter::new(&mut out[HEADER_BYTES_MAX..end]);
        let mut packer = header.packing().packer();
        (header.events, header.pixels, header.saturated) = (0, 0, 0);
        let mut each = |stages: &mut Stages<B>, place: Place, list: List<'_>| {
            header.events += place.on + place.off;
            header.pixels += u32::from(place.on + place.off > 0);
            header.saturated += stages.pixel(place, list, &mut packer, &mut writer);
        };
        if self.skips.segments {
            for word in 0..self.bitmap.len() {
                let mut bits = mem::take(&mut self.bitmap[word]);
                while bits != 0 {
                    self.segment(32 * word + bits.trailing_zeros() as usize, &mut each);
                    bits &= bits - 1;
                }
            }
        } else {
            self.bitmap.fill(0);
            for segment in 0..self.heads.len() {
                self.segment(segment, &mut each);
            }
        }
        let bytes = writer.finish();
        seal(&header, bytes, out)
    }

    #[inline(always)]
    fn store(&mut self, event: &Event, t0_us: u64) {
        let x = usize::from(event.x);
        let segment = usize::from(event.y) * self.stride + x / COLUMNS;
        self.bitmap[segment / 32] |= 1 << (segment % 32);
        let slot = self.slots.len() as u32;
        self.slots.push(Slot {
            impulse: Impulse {
                offset_us: (event.t_us - t0_us) as u32,
                is_on: event.polarity == Polarity::On,
            },
            column: (x % COLUMNS) as u8,
            next: mem::replace(&mut self.heads[segment], slot),
        });
    }

    /// Calls `each` with the pixels of a segment: those with events, or all if `skips.pixels` is off.
    #[inline(always)]
    fn segment(&mut self, segment: usize, each: &mut impl FnMut(&mut Stages<B>, Place, List<'_>)) {
        let mut next = mem::replace(&mut self.heads[segment], NONE);
        if next == NONE && self.skips.pixels {
            return;
        }
        let (mut columns, mut heads) = (0_u32, [NONE; COLUMNS]);
        let mut counts = [[0_u32; 2]; COLUMNS];
        while let Some(slot) = self.slots.get_mut(next as usize) {
            let here = mem::replace(&mut next, slot.next);
            let column = usize::from(slot.column) % COLUMNS;
            columns |= 1 << column;
            counts[column][usize::from(slot.impulse.is_on)] += 1;
            slot.next = mem::replace(&mut heads[column], here);
        }
        let (y, first) = (segment / self.stride, segment % self.stride * COLUMNS);
        let mut pixel = |column: usize| {
            let [off, on] = counts[column];
            let place = Place {
                x: (first + column) as u16,
                y: y as u16,
                on,
                off,
            };
            let list = List {
                slots: &self.slots,
                next: heads[column],
            };
            each(&mut self.stages, place, list);
        };
        if self.skips.pixels {
            while columns != 0 {
                pixel(columns.trailing_zeros() as usize % COLUMNS);
                columns &= columns - 1;
            }
        } else {
            for column in 0..COLUMNS.min(self.width - first) {
                pixel(column);
            }
        }
    }
}

impl<B: Basis> Stages<B> {
    /// Encodes a pixel and returns the number of saturated levels.
    #[inline(always)]
    fn pixel(
        &mut self,
        place: Place,
        mut list: List<'_>,
        packer: &mut Packer,
        writer: &mut BitWriter<'_>,
    ) -> u32 {
        let events = place.on + place.off;
        if events == 0 && self.skips.transforms {
            return 0;
        }
        if events == 1 && self.skips.singles {
            let offset_us = list.next().map_or(0, |impulse| impulse.offset_us);
            let cell = B::cell(self.scale, offset_us, packer.cells_log2());
            packer.single((place.x, place.y), place.on == 1, cell, writer);
            return 0;
        }
        let grid = self.shape.grid;
        if events as usize <= CHUNK_EVENTS {
            self.accumulate(list);
            let mut sums = mem::take(&mut self.sums);
            let saturated = self.rest(place, &mut sums, packer, writer);
            self.sums = sums;
            return saturated;
        }
        let mut totals = mem::take(&mut self.totals);
        let values = B::values(grid);
        totals[..values].fill(WideSum::ZERO);
        for _ in 0..events.div_ceil(CHUNK_EVENTS as u32) {
            self.accumulate(list.clone());
            for (total, sum) in totals.iter_mut().zip(&self.sums).take(values) {
                *total = total.wrapping_add(sum.wide());
            }
            let _ = list.nth(CHUNK_EVENTS - 1);
        }
        let saturated = self.rest(place, &mut totals, packer, writer);
        self.totals = totals;
        saturated
    }

    #[inline(always)]
    fn accumulate(&mut self, list: List<'_>) {
        let grid = self.shape.grid;
        if B::TRANSFORM == Transform::Dwt && !self.skips.butterflies {
            return haar(list, self.scale, grid, &mut self.sums);
        }
        B::accumulate(list, self.scale, grid, &mut self.sums);
    }

    /// Prunes, quantises and packs the sums of a pixel, and returns the number of saturated levels. A pixel without
    /// events is not packed.
    #[inline(always)]
    fn rest<C: Coefficient>(
        &mut self,
        place: Place,
        sums: &mut [C],
        packer: &mut Packer,
        writer: &mut BitWriter<'_>,
    ) -> u32 {
        let Shape { grid, .. } = self.shape;
        let Place { x, y, on, off } = place;
        let events = on + off;
        sums[0] = C::from_integer(on as i32 - off as i32);
        if B::TRANSFORM.is_complex() {
            sums[1] = C::from_integer(0);
        }
        let is_pruned = B::RULE == Rule::Magnitude;
        if is_pruned {
            self.kept.clear(grid);
            let (magnitudes, kept) = (&mut self.magnitudes, &mut self.kept);
            B::prune(sums, events.max(1), self.shape, magnitudes, kept);
        }
        let mut levels = Levels::new(&mut self.magnitudes);
        B::quantise(sums, self.shape, &self.kept, &mut levels);
        if events == 0 {
            black_box(levels.as_slice());
            return 0;
        }
        packer.place((x, y), (on, off), writer);
        if is_pruned {
            packer.set(&self.kept, writer);
        }
        packer.levels(events, &levels, writer);
        levels.saturated()
    }
}

/// Accumulates the Haar sums of at most a chunk of events by bins and butterflies, however few they are.
#[inline(always)]
fn haar(list: List<'_>, scale: PhaseScale, grid: usize, sums: &mut [Sum]) {
    let (differences, bins) = sums.split_at_mut(grid);
    let bins = &mut bins[..grid];
    bins.fill(Sum::ZERO);
    for impulse in list.take(CHUNK_EVENTS) {
        let sign = if impulse.is_on {
            Sum::ONE
        } else {
            Sum::NEG_ONE
        };
        bins[scale.bin(impulse.offset_us, grid.trailing_zeros()) as usize] += sign;
    }
    let mut half = grid / 2;
    while half > 0 {
        for i in 0..half {
            let (first, second) = (bins[2 * i], bins[2 * i + 1]);
            differences[half + i] = first - second;
            bins[i] = first + second;
        }
        half /= 2;
    }
}
