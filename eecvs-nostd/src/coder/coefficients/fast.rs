//! The fast coder of coefficients: Exp-Golomb codes whose orders adapt to what was coded before; every frame starts
//! anew.

use super::fields::{self, COARSE, Context, Fields, SetShape};
use super::pixel::{Common, Pixel};
use super::prediction::Foretold;
use super::{CoefficientMemory, tell};
use crate::coder::range::InputLeft;
use crate::pack::bits_lsb_first::{BitReader, BitWriter};
use crate::pack::unpack::UnpackError;
use crate::transform::GRID_MAX;
use crate::transform::shape::width_of;

/// log2 of the number of numbers that a mean averages.
const MEAN_LOG2: u32 = 4;
/// log2 of the most that a number counts as in a mean.
const LENGTH_MAX: u32 = 24;

/// Means of the numbers coded so far, per context, in units of 2^-[`MEAN_LOG2`].
#[derive(Debug, Clone, Copy)]
struct Means([u32; COARSE]);

impl Means {
    fn new(common: &Common) -> Self {
        let mut means = [4 << MEAN_LOG2; COARSE];
        let gap = 1 << common.packing.gap_order();
        means[fields::GAP.coarse] = gap << MEAN_LOG2;
        Self(means)
    }

    /// Returns the order of the code of a context's next number.
    fn order(&self, context: Context) -> u32 {
        let mean = self.0.get(context.coarse).copied().unwrap_or(0);
        // An Exp-Golomb code of order k has its shortest codes for numbers of k bits.
        width_of(mean >> MEAN_LOG2).saturating_sub(1)
    }

    fn learn(&mut self, context: Context, value: u32) {
        if let Some(mean) = self.0.get_mut(context.coarse) {
            *mean = *mean - (*mean >> MEAN_LOG2) + value.min(1 << LENGTH_MAX);
        }
    }
}

/// Writes or reads bits.
trait Bits {
    fn plain(&mut self, value: u32, bits: u32) -> u32;
    fn exp_golomb(&mut self, value: u32, order: u32) -> u32;
    fn is_sound(&self) -> bool;
}

impl Bits for &mut BitWriter<'_> {
    fn plain(&mut self, value: u32, bits: u32) -> u32 {
        self.put(value, bits);
        value
    }

    fn exp_golomb(&mut self, value: u32, order: u32) -> u32 {
        self.put_exp_golomb(value, order);
        value
    }

    fn is_sound(&self) -> bool {
        true
    }
}

/// A reader that returns 0 after its end.
struct Reader<'r, 'i> {
    reader: &'r mut BitReader<'i>,
    is_sound: bool,
}

impl Bits for Reader<'_, '_> {
    fn plain(&mut self, _: u32, bits: u32) -> u32 {
        let value = self.reader.get(bits);
        self.is_sound &= value.is_ok();
        value.unwrap_or(0)
    }

    fn exp_golomb(&mut self, _: u32, order: u32) -> u32 {
        let value = self.reader.get_exp_golomb(order);
        self.is_sound &= value.is_ok();
        value.unwrap_or(0)
    }

    fn is_sound(&self) -> bool {
        self.is_sound
    }
}

/// Codes [`Fields`] in bits.
struct LevelBits<B> {
    bits: B,
    means: Means,
}

impl<B: Bits> Fields for LevelBits<B> {
    fn flag(&mut self, _: usize, bit: bool) -> bool {
        self.bits.plain(bit.into(), 1) == 1
    }

    fn number(&mut self, context: Context, value: u32) -> u32 {
        let order = self.means.order(context);
        let value = self.bits.exp_golomb(value, order);
        self.means.learn(context, value);
        value
    }

    fn top(&mut self, _: usize, value: u32, bits: u32) -> u32 {
        self.bits.plain(value, bits)
    }

    fn set(&mut self, _: Option<&[u32]>, words: &mut [u32], shape: SetShape) {
        if shape.grid <= 64 {
            for (i, word) in words.iter_mut().enumerate() {
                *word = self.bits.plain(*word, (shape.grid - 32 * i).min(32) as u32);
            }
            return;
        }
        let count = words.iter().map(|word| word.count_ones()).sum();
        let mut left = shape.most as u32;
        if !shape.is_exact {
            left = self.bits.plain(count, width_of(left)).min(left);
        }
        let mut told = [0; GRID_MAX / 32];
        for (told, word) in told.iter_mut().zip(words.iter_mut()) {
            *told = core::mem::take(word);
        }
        let mut k = 0;
        while left > 0 && k < shape.grid {
            let is_next = |k: &usize| told[k / 32 % told.len()] >> (k % 32) & 1 == 1;
            let next = (k..shape.grid).find(is_next).unwrap_or(k);
            k = k.saturating_add(self.number(fields::SET, (next - k) as u32) as usize);
            if let Some(word) = words.get_mut(k / 32).filter(|_| k < shape.grid) {
                *word |= 1 << (k % 32);
            }
            k = k.saturating_add(1);
            left -= 1;
        }
    }

    fn residuals(&mut self, events: u32, foretold: &[Foretold], values: &mut [i32]) {
        let mut at = 0;
        while at < values.len() {
            let rest = values.get_mut(at..).unwrap_or_default();
            let zeros = rest.iter().take_while(|value| **value == 0).count();
            let run = self.number(fields::run(at == 0), zeros as u32) as usize;
            let run = run.min(rest.len());
            let (zeros, rest) = rest.split_at_mut(run);
            zeros.fill(0);
            at += run;
            let Some(value) = rest.first_mut() else {
                break;
            };
            let is_above = foretold.get(at).is_some_and(|foretold| foretold.place > 3);
            let is_out = self.flag(0, (*value > 0) == is_above);
            let beyond = value.unsigned_abs().wrapping_sub(1);
            let magnitude = self
                .number(fields::residual(events), beyond)
                .wrapping_add(1) as i32;
            *value = if is_out == is_above {
                magnitude
            } else {
                magnitude.wrapping_neg()
            };
            at += 1;
        }
    }

    fn is_sound(&self) -> bool {
        self.bits.is_sound()
    }
}

/// State kept from pixel to pixel of a frame.
#[derive(Debug)]
pub(crate) struct Fast {
    means: Means,
    /// Raster index after the last pixel's.
    next: u32,
}

impl Fast {
    /// State at the start of a frame.
    pub(crate) fn new(common: &Common) -> Self {
        Self {
            means: Means::new(common),
            next: 0,
        }
    }

    /// Codes a pixel of up to `left` events; a decoder's pixel is not known yet.
    fn pixel<B: Bits>(
        &mut self,
        bits: B,
        common: &Common,
        memory: &mut CoefficientMemory,
        left: u32,
    ) -> Result<(), UnpackError> {
        let CoefficientMemory {
            pixel, prediction, ..
        } = memory;
        let mut coded = LevelBits {
            bits,
            means: self.means,
        };
        let sensor = common.packing.sensor;
        let width = u32::from(sensor.width);
        let index = u32::from(pixel.y) * width + u32::from(pixel.x);
        let gap = coded.number(fields::GAP, index.wrapping_sub(self.next));
        let index = self.next.checked_add(gap);
        let index = index.filter(|index| *index < sensor.pixels());
        let index = index.ok_or(UnpackError::Position)?;
        (pixel.x, pixel.y) = ((index % width) as u16, (index / width) as u16);
        self.next = index + 1;
        let is_on = coded.flag(0, pixel.on >= pixel.off);
        let both = (pixel, prediction);
        tell(&mut coded, common, both, (is_on, left), (0, 0))?;
        self.means = coded.means;
        Ok(())
    }

    /// Writes the pixel in `memory`. There are no errors: ask the writer whether it is full.
    pub(crate) fn write(
        &mut self,
        common: &Common,
        memory: &mut CoefficientMemory,
        writer: &mut BitWriter<'_>,
    ) {
        // Everything that an encoder writes is valid.
        let _ = self.pixel(writer, common, memory, u32::MAX);
    }
}

/// Reads a frame's `pixels` pixels with `events` events in all, and calls `each` with every pixel, and what
/// is left of the payload after it.
///
/// # Errors
/// [`UnpackError`]; the pixels before the error have been handed on. No input makes it panic.
pub fn read(
    memory: &mut CoefficientMemory,
    common: &Common,
    (events, pixels): (u32, u32),
    payload: &[u8],
    mut each: impl FnMut(&Pixel, &Common, InputLeft),
) -> Result<(), UnpackError> {
    let mut bits = BitReader::new(payload);
    let mut fast = Fast::new(common);
    let mut left = events;
    for _ in 0..pixels {
        let reader = Reader {
            reader: &mut bits,
            is_sound: true,
        };
        fast.pixel(reader, common, memory, left)?;
        left = left.saturating_sub(memory.pixel.count());
        each(&memory.pixel, common, InputLeft::bits(bits.bits_left()));
    }
    if left > 0 {
        Err(UnpackError::Events)
    } else if bits.is_spent() {
        Ok(())
    } else {
        Err(UnpackError::Trailing)
    }
}
