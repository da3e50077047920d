//! The range coder of the tree coder: decisions from the front of a buffer, plain bits from its back.
//!
//! Decisions are coded by an arithmetic coder of 32 bits with carries. Bits that nothing can predict, the low bits of
//! times, do not pass through it: they fill the payload from its last byte towards its first, in words of 32 bits.

/// A probability of one half, in 1/65536.
pub(super) const EVEN_P16: u32 = 1 << 15;

/// Codes in either direction: an encoder writes what it is given and returns it; a decoder returns what it reads.
pub(super) trait BitCoder {
    /// Whether this is the encoder.
    const ENCODES: bool;

    /// Codes a decision. `p16` is the probability of a one in 1/65536, 1 to 65535.
    fn bit(&mut self, p16: u32, bit: bool) -> bool;

    /// Codes the low `count` bits (0 to 32) of a value, whose other bits are 0, as they are.
    fn raw(&mut self, value: u32, count: u32) -> u32;
}

/// Below this the range is widened by a byte.
const RANGE_MIN: u32 = 1 << 24;

/// Writes to a buffer.
#[derive(Debug)]
pub(super) struct Encoder<'o> {
    out: &'o mut [u8],
    /// Bytes of the front. It counts on where the buffer is full.
    len: usize,
    low: u32,
    range: u32,
    /// First byte of the plain bits, which grow downwards.
    back: usize,
    /// Plain bits that are not written yet, and how many.
    pending: u64,
    pending_bits: u32,
}

impl<'o> Encoder<'o> {
    pub(super) const fn new(out: &'o mut [u8]) -> Self {
        let back = out.len();
        Self {
            out,
            len: 0,
            low: 0,
            range: u32::MAX,
            back,
            pending: 0,
            pending_bits: 0,
        }
    }

    #[inline(always)]
    fn push(&mut self) {
        if let Some(byte) = self.out.get_mut(self.len) {
            *byte = (self.low >> 24) as u8;
        }
        self.len += 1;
        self.low <<= 8;
        self.range <<= 8;
    }

    /// Adds one to the bytes of the front.
    #[cold]
    #[inline(never)]
    fn carry(&mut self) {
        for byte in self.out.iter_mut().take(self.len).rev() {
            *byte = byte.wrapping_add(1);
            if *byte != 0 {
                break;
            }
        }
    }

    /// Completes the payload at the start of the buffer and returns its length in bytes, or `None` if the buffer was
    /// too small.
    pub(super) fn finish(mut self) -> Option<usize> {
        // The fewest bytes of which every continuation lies in the range.
        for rest_bits in [24_u32, 16, 8, 0] {
            let mask = (1_u32 << rest_bits) - 1;
            let (rounded, carries) = self.low.overflowing_add(mask);
            let rounded = rounded & !mask;
            let off = u64::from(rounded.wrapping_sub(self.low));
            if off + u64::from(mask) < u64::from(self.range) || rest_bits == 0 {
                if carries {
                    self.carry();
                }
                self.low = rounded;
                for _ in 0..(32 - rest_bits) / 8 {
                    self.push();
                }
                break;
            }
        }
        while self.pending_bits > 0 {
            self.back = self.back.checked_sub(1)?;
            *self.out.get_mut(self.back)? = self.pending as u8;
            self.pending >>= 8;
            self.pending_bits = self.pending_bits.saturating_sub(8);
        }
        if self.len > self.back {
            return None;
        }
        let end = self.out.len();
        self.out.copy_within(self.back..end, self.len);
        Some(self.len + end - self.back)
    }
}

impl BitCoder for Encoder<'_> {
    const ENCODES: bool = true;

    #[inline(always)]
    fn bit(&mut self, p16: u32, bit: bool) -> bool {
        let bound = (self.range >> 16) * p16;
        if bit {
            self.range = bound;
        } else {
            let (low, carries) = self.low.overflowing_add(bound);
            self.low = low;
            if carries {
                self.carry();
            }
            self.range -= bound;
        }
        // A decision takes off up to 16 bits.
        if self.range < RANGE_MIN {
            self.push();
            if self.range < RANGE_MIN {
                self.push();
            }
        }
        bit
    }

    #[inline(always)]
    fn raw(&mut self, value: u32, count: u32) -> u32 {
        self.pending |= u64::from(value) << self.pending_bits;
        self.pending_bits += count;
        if self.pending_bits >= 32 {
            let word = self.pending as u32;
            self.pending >>= 32;
            self.pending_bits -= 32;
            let at = self.back.wrapping_sub(4);
            if let Some(place) = self.out.get_mut(at..self.back) {
                place.copy_from_slice(&word.to_be_bytes());
                self.back = at;
            } else {
                // Full, and `finish` will say so.
                self.back = 0;
            }
        }
        value
    }
}

/// Reads a payload. After its end both parts go on with zeros.
#[derive(Debug)]
pub(super) struct Decoder<'i> {
    input: &'i [u8],
    /// Bytes of the front that were read.
    at: usize,
    code: u32,
    range: u32,
    /// Bytes of the plain bits that were read.
    taken: usize,
    pending: u64,
    pending_bits: u32,
}

impl<'i> Decoder<'i> {
    pub(super) fn new(input: &'i [u8]) -> Self {
        let mut decoder = Self {
            input,
            at: 0,
            code: 0,
            range: u32::MAX,
            taken: 0,
            pending: 0,
            pending_bits: 0,
        };
        for _ in 0..4 {
            decoder.code = decoder.code << 8 | decoder.byte();
        }
        decoder
    }

    #[inline(always)]
    fn byte(&mut self) -> u32 {
        let byte = self.input.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        u32::from(byte)
    }

    #[inline(always)]
    fn pull(&mut self) {
        self.range <<= 8;
        self.code = self.code << 8 | self.byte();
    }

    /// The next four bytes from the back; where the payload begins, the rest of them and zeros.
    #[inline(always)]
    fn word(&mut self) -> u32 {
        let back = self.input.len().saturating_sub(self.taken);
        self.taken += 4;
        let from = back.wrapping_sub(4);
        if let Some(bytes) = self.input.get(from..back) {
            bytes
                .iter()
                .fold(0, |word, byte| word << 8 | u32::from(*byte))
        } else {
            let first = self.input.get(..back).unwrap_or_default();
            let bytes = first.iter().rev().enumerate();
            bytes.fold(0, |word, (i, byte)| word | u32::from(*byte) << (8 * i))
        }
    }

    /// Returns whether exactly the payload was read: the encoder ends the front with one to four bytes of those that
    /// are read ahead, and the back with the last byte begun.
    pub(super) fn is_spent(&self) -> bool {
        let plain_bits = 8 * self.taken as u64 - u64::from(self.pending_bits);
        let used = (self.at as u64 - 4) + plain_bits.div_ceil(8);
        let left = (self.input.len() as u64).wrapping_sub(used);
        (1..=4).contains(&left)
    }
}

impl BitCoder for Decoder<'_> {
    const ENCODES: bool = false;

    #[inline(always)]
    fn bit(&mut self, p16: u32, _bit: bool) -> bool {
        let bound = (self.range >> 16) * p16;
        let bit = self.code < bound;
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        if self.range < RANGE_MIN {
            self.pull();
            if self.range < RANGE_MIN {
                self.pull();
            }
        }
        bit
    }

    #[inline(always)]
    fn raw(&mut self, _value: u32, count: u32) -> u32 {
        if self.pending_bits < count {
            self.pending |= u64::from(self.word()) << self.pending_bits;
            self.pending_bits += 32;
        }
        let value = (self.pending & ((1_u64 << count) - 1)) as u32;
        self.pending >>= count;
        self.pending_bits -= count;
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    #[derive(Debug, Clone, Copy)]
    enum Step {
        Bit(u32, bool),
        Raw(u32, u32),
    }

    fn step() -> impl Strategy<Value = Step> {
        let sure = (
            prop_oneof![Just(1_u32), Just(65535), 1_u32..65536],
            any::<bool>(),
        );
        prop_oneof![
            sure.prop_map(|(p16, bit)| Step::Bit(p16, bit)),
            (any::<u32>(), 0_u32..=32).prop_map(|(value, count)| {
                Step::Raw((u64::from(value) & ((1 << count) - 1)) as u32, count)
            }),
        ]
    }

    proptest! {
        #[test]
        fn decisions_and_bits_come_back(
            steps in proptest::collection::vec(step(), 0..400), spare in 0_usize..40
        ) {
            fn code<C: BitCoder>(coder: &mut C, steps: &[Step]) {
                for step in steps {
                    match *step {
                        Step::Bit(p16, bit) => assert_eq!(coder.bit(p16, bit), bit),
                        Step::Raw(value, count) => assert_eq!(coder.raw(value, count), value),
                    }
                }
            }
            fn decode(input: &[u8], steps: &[Step]) -> bool {
                let mut decoder = Decoder::new(input);
                for step in steps {
                    match *step {
                        Step::Bit(p16, bit) => assert_eq!(decoder.bit(p16, false), bit),
                        Step::Raw(value, count) => assert_eq!(decoder.raw(0, count), value),
                    }
                }
                decoder.is_spent()
            }
            let mut out = vec![0xA5; 4 * steps.len() + 8];
            let mut encoder = Encoder::new(&mut out);
            code(&mut encoder, &steps);
            let len = encoder.finish().unwrap();
            prop_assert!(decode(&out[..len], &steps));
            // A buffer of exactly that length suffices, and a shorter one is told to be too small.
            let mut exact = vec![0; len + spare];
            let mut encoder = Encoder::new(&mut exact);
            code(&mut encoder, &steps);
            prop_assert_eq!(encoder.finish(), Some(len));
            prop_assert_eq!(&exact[..len], &out[..len]);
            let mut encoder = Encoder::new(&mut exact[..len - 1]);
            code(&mut encoder, &steps);
            prop_assert_eq!(encoder.finish(), None);
        }
    }
}
