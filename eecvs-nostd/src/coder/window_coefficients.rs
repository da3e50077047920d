//! Codes a window's coefficients into a frame of an adaptive coder: group, accumulate, prune, quantise, then code.

use crate::coder::coefficients::CoefficientMemory;
use crate::coder::coefficients::dense::{self, Pixels};
use crate::coder::coefficients::fast::Fast;
use crate::coder::coefficients::pixel::{Common, Pixel as Told};
use crate::coder::content::{Content, Node};
use crate::coder::dense::Dense;
use crate::coder::range::{InputLeft, RangeEncoder};
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, Sum, WideSum};
use crate::fused::{set_zeroth, sum_crowded};
use crate::group::{Group, Impulses, Pixel};
use crate::pack::bits_lsb_first::BitWriter;
use crate::prune::Kept;
use crate::quantise::Levels;
use crate::transform::{Basis, M_MAX, Rule};
use crate::window::{Slot, Window};

/// What one frame holds.
pub(crate) struct TakenCoefficients {
    pub(crate) payload_bytes: usize,
    pub(crate) events: u32,
    pub(crate) pixels: u32,
    pub(crate) saturated: u32,
    /// The window is coded to its end.
    pub(crate) is_last: bool,
    /// The output overran, so the next frame of the dense coder must be a key frame.
    pub(crate) overran: bool,
}

/// Lent memory for one pixel's coefficients.
pub(crate) struct Numbers<'n> {
    pub(crate) sums: &'n mut [Sum],
    pub(crate) totals: &'n mut [WideSum],
    pub(crate) magnitudes: &'n mut [u32],
    pub(crate) kept: &'n mut Kept,
}

/// What is kept of a window between frames.
pub(crate) struct CoefficientEncoder<'e, 'b> {
    pub(crate) group: &'e mut Group,
    pub(crate) window: &'e mut Window<'b>,
    pub(crate) numbers: Numbers<'e>,
    pub(crate) common: Common,
    /// Events of the window that are in no frame yet.
    pub(crate) left: u32,
}

impl CoefficientEncoder<'_, '_> {
    /// Codes pixels with [`Fast`] into `out`.
    #[inline(never)]
    pub(crate) fn fast<B: Basis>(
        &mut self,
        memory: &mut CoefficientMemory,
        out: &mut [u8],
    ) -> TakenCoefficients {
        let mut writer = BitWriter::new(out);
        let mut fast = Fast::new(&self.common);
        let mut taken = TakenCoefficients {
            payload_bytes: 0,
            events: 0,
            pixels: 0,
            saturated: 0,
            is_last: true,
            overran: false,
        };
        while let Some(pixel) = self.group.next(self.window) {
            let saturated =
                self.numbers
                    .fill::<B>(&self.common, pixel, self.window.slots(), &mut memory.pixel);
            let position = writer.position();
            fast.write(&self.common, memory, &mut writer);
            if writer.is_full() {
                writer.rewind(position);
                self.group.put_back(pixel);
                taken.is_last = false;
                break;
            }
            taken.events += pixel.on + pixel.off;
            taken.pixels += 1;
            taken.saturated = taken.saturated.saturating_add(saturated);
        }
        taken.payload_bytes = writer.finish();
        taken
    }

    /// Codes pixels with [`Dense`] into `out`.
    #[inline(never)]
    pub(crate) fn dense<B: Basis>(
        &mut self,
        dense: &mut Dense<'_>,
        memory: &mut CoefficientMemory,
        out: &mut [u8],
    ) -> TakenCoefficients {
        let mut coder = RangeEncoder::new(out);
        let common = self.common;
        let left = self.left;
        let (told, learned) = memory.parts();
        let mut content = Counted::<B> {
            pixel: None,
            told,
            on: false,
            saturated: 0,
            saturates: 0,
            encoder: self,
            basis: core::marker::PhantomData,
        };
        let coded = dense::code(dense, learned, &mut coder, &mut content, &common);
        // An encoder's own pixels are never refused.
        let coded = coded.unwrap_or(dense::CodedRows {
            pixels: 0,
            events: 0,
            overran: true,
        });
        let (pixel, saturated) = (content.pixel, content.saturated);
        if let Some(pixel) = pixel {
            self.group.put_back(pixel);
        }
        TakenCoefficients {
            payload_bytes: coder.finish(),
            events: coded.events,
            pixels: coded.pixels,
            saturated,
            is_last: coded.events == left,
            overran: coded.overran,
        }
    }
}

impl Numbers<'_> {
    /// Computes a pixel's coefficients, the same as in the plain payload, and where it pays its events as cells.
    /// Returns how many levels saturated.
    fn fill<B: Basis>(
        &mut self,
        common: &Common,
        pixel: Pixel,
        slots: &[Slot],
        told: &mut Told,
    ) -> u32 {
        let events = pixel.on + pixel.off;
        let Self {
            sums,
            totals,
            magnitudes,
            kept,
        } = self;
        told.begin(pixel);
        if events == 1 {
            let first = Impulses::new(pixel, slots).next();
            let offset_us = first.map_or(0, |impulse| impulse.offset_us);
            told.set_cell(B::cell(common.scale(), offset_us, common.cells_log2()));
            return 0;
        }
        if let Some(cells) = common.timed_cells(events) {
            for (at, impulse) in Impulses::new(pixel, slots).enumerate() {
                let cell = cells.of_scaled(common.scale(), impulse.offset_us);
                told.insert(at, cell, impulse.is_on);
            }
            return 0;
        }
        let grid = common.grid();
        if events as usize > CHUNK_EVENTS {
            sum_crowded::<B>(pixel, slots, common.scale(), grid, (sums, totals));
            return finish::<B, _>(common, totals, (magnitudes, kept), told);
        }
        let impulses = Impulses::new(pixel, slots);
        B::accumulate_list(&impulses, common.scale(), grid, sums);
        set_zeroth::<B, _>(pixel, sums);
        let saturated = finish::<B, _>(common, sums, (magnitudes, kept), told);
        if told.choose(common) {
            for (at, impulse) in impulses.enumerate() {
                told.insert(at, common.cell(impulse.offset_us), impulse.is_on);
            }
        }
        saturated
    }
}

/// Prunes and quantises one pixel's sums. Returns how many levels saturated.
fn finish<B: Basis, C: Coefficient>(
    common: &Common,
    sums: &[C],
    (magnitudes, kept): (&mut [u32], &mut Kept),
    told: &mut Told,
) -> u32 {
    let shape = common.shape();
    *kept = Kept::NONE;
    match B::RULE {
        Rule::LowFrequency => crate::prune::low_frequency(shape.r, kept),
        Rule::Magnitude => B::prune(sums, told.count(), shape, magnitudes, kept),
    }
    let mut memory = [0; 2 * M_MAX];
    let mut levels = Levels::new(&mut memory);
    B::quantise(sums, shape, kept, &mut levels);
    told.set(common, kept, levels.as_slice());
    levels.saturated()
}

/// The window, as the dense coder reads it.
struct Counted<'c, 'e, 'b, B> {
    encoder: &'c mut CoefficientEncoder<'e, 'b>,
    told: &'c mut Told,
    /// The current pixel, until it is coded.
    pixel: Option<Pixel>,
    /// Whether the current pixel has at least as many ON events as OFF events.
    on: bool,
    /// Levels that saturated so far, and those of the current pixel.
    saturated: u32,
    saturates: u32,
    basis: core::marker::PhantomData<B>,
}

impl<B: Basis> Pixels for Counted<'_, '_, '_, B> {
    fn pixel(&mut self) -> &mut Told {
        self.told
    }

    fn left(&self) -> u32 {
        self.encoder.left
    }

    fn done(&mut self, _: &Common, _: InputLeft) {
        self.encoder.left = self.encoder.left.saturating_sub(self.told.count());
        self.saturated = self.saturated.saturating_add(self.saturates);
        self.pixel = None;
    }
}

impl<B: Basis> Content for Counted<'_, '_, '_, B> {
    fn has_row(&mut self, y: u16) -> bool {
        let CoefficientEncoder { group, window, .. } = &mut *self.encoder;
        group.is_next_in_row(window, y)
    }

    fn has_segment(&mut self, segment: u16, y: u16) -> bool {
        let CoefficientEncoder { group, window, .. } = &mut *self.encoder;
        group.is_next_in_segment(window, (segment, y))
    }

    fn columns(&mut self) -> u32 {
        // `has_segment` has moved the group to this segment.
        self.encoder.group.columns
    }

    fn enter(&mut self, _: (u16, u16)) -> u32 {
        let CoefficientEncoder {
            group,
            window,
            numbers,
            common,
            ..
        } = &mut *self.encoder;
        self.pixel = group.next(window);
        if let Some(pixel) = self.pixel {
            self.on = pixel.on >= pixel.off;
            self.saturates = numbers.fill::<B>(common, pixel, window.slots(), self.told);
        }
        0
    }

    fn is_more(&self) -> bool {
        false
    }

    fn peek(&self) -> (u32, bool) {
        (0, self.on)
    }

    fn take(&mut self, _: u32, _: bool) {}

    fn is_over(&self) -> bool {
        self.encoder.left == 0
    }

    fn at(&self, _: u32) -> Option<Node> {
        None
    }
}
