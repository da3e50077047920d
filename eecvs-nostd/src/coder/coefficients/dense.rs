//! The dense coder of coefficients: the walk and the range coder of the dense event coder, with contexts of its
//! own.

use super::fields::{self, Context, FLAGS, Fields, KINDS, SetShape, TOPS};
use super::pixel::{Common, Pixel};
use super::prediction::{Foretold, Prediction};
use super::{CoefficientMemory, tell};
use crate::coder::content::{Content, END};
use crate::coder::dense::times::{CodedPixel, Following, LearnedTimes, Neighbour};
use crate::coder::dense::{Dense, Step};
use crate::coder::range::{Binary, InputLeft, Probability};
use crate::pack::unpack::UnpackError;
use crate::transform::shape::width_of;

/// Most bytes that a pixel takes: K decisions for its set, 63 events of 7 decisions and 31 plain bits each, and
/// levels of 9 decisions and 31 bits each; a decision costs up to 7.4 bits.
pub(crate) const fn pixel_bytes_max(common: &Common) -> usize {
    let levels = common.numbers() * common.shape().r;
    (8 * common.grid() + 63 * (7 * 8 + 31) + levels * (9 * 8 + 31) + 1024) / 8
}

/// Decisions that code a number's length in bits; numbers of [`LENGTH_LONG`] bits follow plain.
const LENGTH_BITS: u32 = 5;
const LENGTH_LONG: u32 = (1 << LENGTH_BITS) - 1;
/// Bits of [`Fields::top`] that are learned.
const TOP_BITS: u32 = 5;
/// Contexts of whether a level is as predicted: by floor(log2 n), its height, the distance from its step's edge,
/// and how the one before differed.
const RESIDUALS: usize = 4 * 4 * 4 * 3;
/// Contexts of a set's decisions: with a prediction; else by n, the height, and the two decisions before.
const SETS: usize = 4 + 4 * 4 * 4;

/// Everything that the dense coder of coefficients learns.
#[derive(Debug, Clone)]
pub struct Learned {
    flags: [Probability; FLAGS],
    lengths: [[Probability; 1 << LENGTH_BITS]; fields::FINE],
    seconds: [[Probability; 32]; KINDS],
    tops: [[Probability; 1 << TOP_BITS]; TOPS],
    sets: [Probability; SETS],
    zeros: [Probability; RESIDUALS],
    ones: [Probability; 16],
    sides: [Probability; 12],
}

impl Learned {
    pub(super) const UNSET: Self = Self {
        flags: [Probability::UNSET; _],
        lengths: [[Probability::UNSET; _]; _],
        seconds: [[Probability::UNSET; _]; _],
        tops: [[Probability::UNSET; _]; _],
        sets: [Probability::UNSET; _],
        zeros: [Probability::UNSET; _],
        ones: [Probability::UNSET; _],
        sides: [Probability::UNSET; _],
    };

    pub(super) fn restart(&mut self) {
        let Self {
            flags,
            lengths,
            seconds,
            tops,
            sets,
            zeros,
            ones,
            sides,
        } = self;
        flags.fill(Probability::EVEN);
        lengths.as_flattened_mut().fill(Probability::EVEN);
        seconds.as_flattened_mut().fill(Probability::EVEN);
        tops.as_flattened_mut().fill(Probability::EVEN);
        sets.fill(Probability::EVEN);
        zeros.fill(Probability::EVEN);
        ones.fill(Probability::EVEN);
        sides.fill(Probability::EVEN);
    }
}

/// Returns what is learned in a context. Contexts are sums of bounded parts; the bound here is for the compiler.
#[inline(always)]
fn at<T, const N: usize>(learned: &mut [T; N], context: usize) -> &mut T {
    &mut learned[context.min(N - 1)]
}

/// Codes decisions from the top bit down, each in the context of those before.
fn tree<C: Binary>(coder: &mut C, learned: &mut [Probability; 32], value: u32, bits: u32) -> u32 {
    let mut node = 1;
    for i in (0..bits).rev() {
        let bit = coder.bit(at(learned, node), value >> i & 1 == 1);
        node = 2 * node + usize::from(bit);
    }
    node as u32 - (1 << bits)
}

/// Memory with which a pixel is coded.
pub(crate) type Memory<'m> = (&'m mut Prediction, &'m mut Learned);

/// Codes [`Fields`] with a range coder.
struct Ranged<'r, C> {
    coder: &'r mut C,
    learned: &'r mut Learned,
}

impl<C: Binary> Fields for Ranged<'_, C> {
    fn flag(&mut self, context: usize, bit: bool) -> bool {
        self.coder.bit(at(&mut self.learned.flags, context), bit)
    }

    fn number(&mut self, context: Context, value: u32) -> u32 {
        let length = width_of(value);
        let learned = at(&mut self.learned.lengths, context.fine);
        let mut length = tree(self.coder, learned, length.min(LENGTH_LONG), LENGTH_BITS);
        if length == LENGTH_LONG {
            // 31 bits; no encoder has 32.
            return self.coder.plain(value & (u32::MAX >> 1), 31);
        }
        if length < 2 {
            return length;
        }
        length -= 1;
        let learned = at(&mut self.learned.seconds, context.kind);
        let learned = at(learned, length as usize);
        let second = self.coder.bit(learned, value >> (length - 1) & 1 == 1);
        let below = length - 1;
        let rest = self.coder.plain(value & ((1 << below) - 1), below);
        (2 | u32::from(second)) << below | rest
    }

    fn top(&mut self, table: usize, value: u32, bits: u32) -> u32 {
        let learned = at(&mut self.learned.tops, table);
        let below = bits.saturating_sub(TOP_BITS);
        let top = tree(self.coder, learned, value >> below, bits - below);
        top << below | self.coder.plain(value & ((1 << below) - 1), below)
    }

    fn set(&mut self, foretold: Option<&[u32]>, words: &mut [u32], shape: SetShape) {
        let mut left = shape.most;
        let mut before = 0;
        let power = fields::power(shape.events).min(4).saturating_sub(1);
        for (i, word) in words.iter_mut().enumerate() {
            let told = foretold.map(|words| words.get(i).copied().unwrap_or(0));
            let mut made = 0;
            for k in 0..(shape.grid - 32 * i).min(32) {
                let here = 32 * i + k;
                let is_rest = shape.is_exact && left >= shape.grid - here;
                let context = match told {
                    Some(told) => 2 * (told >> k & 1) as usize + (before & 1),
                    None => 4 + (power * 4 + 4 * here / shape.grid) * 4 + (before & 3),
                };
                let is_kept = if left == 0 {
                    false
                } else {
                    let learned = at(&mut self.learned.sets, context);
                    is_rest || self.coder.bit(learned, *word >> k & 1 == 1)
                };
                made |= u32::from(is_kept) << k;
                left -= usize::from(is_kept);
                before = before << 1 | usize::from(is_kept);
            }
            *word = made;
        }
    }

    fn residuals(&mut self, events: u32, foretold: &[Foretold], values: &mut [i32]) {
        let power = fields::power(events).min(4).saturating_sub(1);
        let mut before = 0;
        for (foretold, value) in foretold.iter().zip(values) {
            // How far the prediction is from its step's edge, and whether it is above the step's middle.
            let (edge, is_above) = match foretold.place {
                place @ 0..=3 => (place, false),
                place => (7_u8.saturating_sub(place), true),
            };
            let (edge, height) = (usize::from(edge & 3), usize::from(foretold.height & 3));
            let context = ((power * 4 + height) * 4 + edge) * 3 + before;
            let is_zero = self
                .coder
                .bit(at(&mut self.learned.zeros, context), *value == 0);
            if is_zero {
                (*value, before) = (0, 0);
                continue;
            }
            let learned = at(&mut self.learned.sides, edge * 3 + before);
            let is_out = self.coder.bit(learned, (*value > 0) == is_above);
            let is_positive = is_out == is_above;
            let magnitude = value.unsigned_abs().wrapping_sub(1);
            let learned = at(&mut self.learned.ones, power * 4 + height);
            let is_one = self.coder.bit(learned, magnitude == 0);
            let magnitude = if is_one {
                1
            } else {
                let beyond = magnitude.wrapping_sub(1);
                self.number(fields::residual(events), beyond)
                    .wrapping_add(2)
            };
            *value = if is_positive {
                magnitude as i32
            } else {
                (magnitude as i32).wrapping_neg()
            };
            before = 1 + usize::from(magnitude > 1);
        }
    }

    fn is_sound(&self) -> bool {
        self.coder.has_room(0)
    }
}

/// The pixels of a frame, as the walk asks for them.
pub(crate) trait Pixels: Content {
    /// Returns the pixel that was entered; a decoder's has only its place.
    fn pixel(&mut self) -> &mut Pixel;
    /// Returns how many events are left of the window, or of a decoder's frame.
    fn left(&self) -> u32;
    /// Takes note that the pixel has been coded, and what a decoder has left of its input after it.
    fn done(&mut self, common: &Common, left: InputLeft);
}

/// How much of a frame was coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CodedRows {
    pub(crate) pixels: u32,
    pub(crate) events: u32,
    /// The encoder learned from more than a decoder will read.
    pub(crate) overran: bool,
}

/// Codes a frame until its content ends or the coder is full.
///
/// # Errors
/// [`UnpackError`], in a decoder.
pub(crate) fn code<C: Binary, P: Pixels>(
    dense: &mut Dense<'_>,
    (prediction, learned): Memory<'_>,
    coder: &mut C,
    content: &mut P,
    common: &Common,
) -> Result<CodedRows, UnpackError> {
    let mut step = Tell {
        common,
        bytes_max: pixel_bytes_max(common),
        prediction,
        learned,
        coded: CodedRows {
            pixels: 0,
            events: 0,
            overran: false,
        },
        failed: None,
    };
    let walked = dense.code_with(coder, content, &mut step);
    match step.failed {
        Some(error) => Err(error),
        None => Ok(CodedRows {
            overran: step.coded.overran || walked.overran,
            ..step.coded
        }),
    }
}

/// The walk's step, which codes all of a pixel.
struct Tell<'t> {
    common: &'t Common,
    bytes_max: usize,
    prediction: &'t mut Prediction,
    learned: &'t mut Learned,
    coded: CodedRows,
    failed: Option<UnpackError>,
}

impl<P: Pixels> Step<P> for &mut Tell<'_> {
    fn pixel<C: Binary>(
        &mut self,
        _: &mut LearnedTimes,
        coder: &mut C,
        content: &mut P,
        on: bool,
        ((west, north), _): ((Neighbour, Neighbour), Following),
    ) -> CodedPixel {
        let stop = CodedPixel {
            events: 0,
            last: 0,
            goes_on: false,
        };
        if !coder.has_room(self.bytes_max) {
            self.coded.overran = true;
            return stop;
        }
        let left = content.left();
        let mut fields = Ranged {
            coder,
            learned: &mut *self.learned,
        };
        let events = |neighbour: Neighbour| match neighbour.list {
            END => 0,
            _ => neighbour.last >> 1,
        };
        let both = (content.pixel(), &mut *self.prediction);
        let around = (events(west), events(north));
        if let Err(error) = tell(&mut fields, self.common, both, (on, left), around) {
            self.failed = Some(error);
            return stop;
        }
        let count = content.pixel().count();
        content.done(self.common, coder.left());
        self.coded.pixels += 1;
        self.coded.events += count;
        CodedPixel {
            events: count,
            last: count << 1 | u32::from(on),
            goes_on: !content.is_over(),
        }
    }
}

/// Decodes a frame of the dense coder; `memory` is as the frame before left it, or restarted. Calls `each` with every
/// pixel, and what is left of the payload after it.
///
/// # Errors
/// [`UnpackError`]; the pixels before the error have been handed on. No input makes it panic.
pub fn read(
    dense: &mut Dense<'_>,
    memory: &mut CoefficientMemory,
    common: &Common,
    (events, pixels): (u32, u32),
    coder: &mut crate::coder::range::RangeDecoder<'_>,
    each: impl FnMut(&Pixel, &Common, InputLeft),
) -> Result<(), UnpackError> {
    let CoefficientMemory {
        pixel,
        prediction,
        learned,
    } = memory;
    let mut content = Found {
        pixel,
        left: events,
        each,
    };
    let coded = code(dense, (prediction, learned), coder, &mut content, common)?;
    if coder.is_beyond() {
        Err(UnpackError::Ended)
    } else if (coded.events, coded.pixels) == (events, pixels) {
        Ok(())
    } else {
        Err(UnpackError::Events)
    }
}

/// Hands a decoder's pixels on as they are found.
struct Found<'f, E> {
    pixel: &'f mut Pixel,
    left: u32,
    each: E,
}

impl<E: FnMut(&Pixel, &Common, InputLeft)> Pixels for Found<'_, E> {
    fn pixel(&mut self) -> &mut Pixel {
        self.pixel
    }

    fn left(&self) -> u32 {
        self.left
    }

    fn done(&mut self, common: &Common, left: InputLeft) {
        self.left = self.left.saturating_sub(self.pixel.count());
        (self.each)(self.pixel, common, left);
    }
}

impl<E> Content for Found<'_, E> {
    fn has_row(&mut self, _: u16) -> bool {
        false
    }

    fn has_segment(&mut self, _segment: u16, _y: u16) -> bool {
        false
    }

    fn columns(&mut self) -> u32 {
        0
    }

    fn enter(&mut self, (x, y): (u16, u16)) -> u32 {
        (self.pixel.x, self.pixel.y) = (x, y);
        0
    }

    fn is_more(&self) -> bool {
        false
    }

    fn peek(&self) -> (u32, bool) {
        (0, false)
    }

    fn take(&mut self, _: u32, _: bool) {}

    fn is_over(&self) -> bool {
        self.left == 0
    }

    fn at(&self, _: u32) -> Option<crate::coder::content::Node> {
        None
    }
}
