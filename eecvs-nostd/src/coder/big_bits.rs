//! Bits in bytes, as in a big-endian number: the first bit is the highest of the first byte.
//!
//! So the zeros in front of a code need not be put: a code of n bits is a number below 2^n.

use crate::bits::Ended;

/// The widest code that goes out at once.
#[cfg(target_pointer_width = "64")]
pub type Code = u64;
/// The widest code that goes out at once.
#[cfg(not(target_pointer_width = "64"))]
pub type Code = u32;

/// Bits of a code at the most: seven wait for those that complete their byte.
#[cfg(target_pointer_width = "64")]
pub const CODE_BITS: u32 = u64::BITS - 8;
/// Bits of a code at the most.
#[cfg(not(target_pointer_width = "64"))]
pub const CODE_BITS: u32 = u32::BITS;

pub use writer::{BigWriter, Position};

/// With a register of 64 bits: what is there goes out at once, whole bytes or not, without a branch.
#[cfg(target_pointer_width = "64")]
mod writer {
    use super::{CODE_BITS, Code};

    /// Writes bits into a lent buffer.
    ///
    /// What does not fit is lost: ask [`Self::has_words`] before.
    #[derive(Debug)]
    pub struct BigWriter<'o> {
        out: &'o mut [u8],
        state: Position,
    }

    /// A place in a [`BigWriter`]'s output to go back to.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub struct Position {
        /// Whole bytes written.
        bytes: usize,
        /// The bits after those, from the top.
        pending: u64,
        /// How many: up to 7.
        bits: u32,
    }

    impl<'o> BigWriter<'o> {
        /// A writer at the start of `out`.
        #[must_use]
        pub const fn new(out: &'o mut [u8]) -> Self {
            Self {
                out,
                state: Position {
                    bytes: 0,
                    pending: 0,
                    bits: 0,
                },
            }
        }

        /// Puts a code of `bits` (1 to [`CODE_BITS`]) bits, which has no others.
        #[inline(always)]
        pub fn put(&mut self, code: Code, bits: u32) {
            debug_assert!(0 < bits && bits <= CODE_BITS && code >> bits == 0);
            let Position {
                bytes,
                pending,
                bits: before,
            } = self.state;
            let end = before + bits;
            let pending = pending | (code << (u64::BITS.wrapping_sub(end) & 63));
            if let Some(place) = self.out.get_mut(bytes..bytes + 8) {
                place.copy_from_slice(&pending.to_be_bytes());
            } else {
                put_at_end(self.out.get_mut(bytes..).unwrap_or_default(), pending);
            }
            self.state = Position {
                bytes: bytes + (end / 8) as usize,
                pending: pending << (end & 56),
                bits: end % 8,
            };
        }

        /// Lets `write` put something into a copy of this writer, whose state is in memory there;
        /// here it stays in registers.
        #[inline(always)]
        pub fn aside(&mut self, write: impl FnOnce(&mut BigWriter<'_>)) {
            let mut copy = BigWriter {
                out: self.out,
                state: self.state,
            };
            write(&mut copy);
            self.state = copy.state;
        }

        /// Whether there is room for so many more words of 32 bits, beyond those that are complete.
        #[inline(always)]
        #[must_use]
        pub const fn has_words(&self, words: usize) -> bool {
            self.state.bytes / 4 + words < self.out.len() / 4
        }

        /// Where the writer stands.
        #[inline(always)]
        #[must_use]
        pub const fn position(&self) -> Position {
            self.state
        }

        /// Takes back everything put after `position`.
        #[inline(always)]
        pub const fn rewind(&mut self, position: Position) {
            self.state = position;
        }

        /// The last byte's other bits are zeros; returns the number of bytes written.
        #[must_use]
        pub fn finish(self) -> usize {
            let Position { bytes, bits, .. } = self.state;
            (bytes + bits.div_ceil(8) as usize).min(self.out.len())
        }
    }

    #[cold]
    #[inline(never)]
    fn put_at_end(rest: &mut [u8], pending: u64) {
        for (place, byte) in rest.iter_mut().zip(pending.to_be_bytes()) {
            *place = byte;
        }
    }
}

/// With one of 32 bits: a word goes out when it is complete.
#[cfg(not(target_pointer_width = "64"))]
mod writer {
    use super::{CODE_BITS, Code};

    /// Writes bits into a lent buffer, of which up to three bytes at the end stay unused.
    ///
    /// What does not fit is lost: ask [`Self::has_words`] before.
    #[derive(Debug)]
    #[repr(C)]
    pub struct BigWriter<'o> {
        pub(crate) state: Position,
        pub(crate) words: &'o mut [[u8; 4]],
    }

    /// A place in a [`BigWriter`]'s output to go back to.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    #[repr(C)]
    pub struct Position {
        /// Bits of the next word, from the top.
        pub(crate) pending: u32,
        /// Bits that the next word still takes: 1 to 32.
        pub(crate) free: u32,
        /// Words written.
        pub(crate) words: usize,
    }

    impl<'o> BigWriter<'o> {
        /// A writer at the start of `out`.
        #[must_use]
        pub const fn new(out: &'o mut [u8]) -> Self {
            Self {
                words: out.as_chunks_mut().0,
                state: Position {
                    pending: 0,
                    free: 32,
                    words: 0,
                },
            }
        }

        /// Puts a code of `bits` (1 to [`CODE_BITS`]) bits, which has no others.
        #[inline(always)]
        pub fn put(&mut self, code: Code, bits: u32) {
            debug_assert!(0 < bits && bits <= CODE_BITS && u64::from(code) >> bits == 0);
            let Position { pending, free, .. } = self.state;
            if bits < free {
                let free = free - bits;
                self.state.pending = pending | (code << (free & 31));
                self.state.free = free;
            } else {
                self.complete(code, bits - free);
            }
        }

        /// Puts a code that completes a word, of which `beyond` bits (0 to 31) begin the next.
        #[inline(never)]
        fn complete(&mut self, code: u32, beyond: u32) {
            let Position { pending, words, .. } = self.state;
            let word = pending | (code >> (beyond & 31));
            if let Some(place) = self.words.get_mut(words) {
                *place = word.to_be_bytes();
            }
            self.state = Position {
                pending: (code << 1) << (31_u32.wrapping_sub(beyond) & 31),
                free: 32 - beyond,
                words: words + 1,
            };
        }

        /// Lets `write` put something into a copy of this writer, whose state is in memory there;
        /// here it stays in registers.
        #[inline(always)]
        pub fn aside(&mut self, write: impl FnOnce(&mut BigWriter<'_>)) {
            let mut copy = BigWriter {
                words: self.words,
                state: self.state,
            };
            write(&mut copy);
            self.state = copy.state;
        }

        /// Whether there is room for so many more words of 32 bits, beyond those that are complete.
        #[inline(always)]
        #[must_use]
        pub const fn has_words(&self, words: usize) -> bool {
            self.state.words + words < self.words.len()
        }

        /// Where the writer stands.
        #[inline(always)]
        #[must_use]
        pub const fn position(&self) -> Position {
            self.state
        }

        /// Takes back everything put after `position`.
        #[inline(always)]
        pub const fn rewind(&mut self, position: Position) {
            self.state = position;
        }

        /// The last byte's other bits are zeros; returns the number of bytes written.
        #[must_use]
        pub fn finish(self) -> usize {
            let Position {
                pending,
                free,
                words,
            } = self.state;
            match self.words.get_mut(words) {
                Some(place) => {
                    *place = pending.to_be_bytes();
                    4 * words + (32 - free).div_ceil(8) as usize
                }
                None => 4 * self.words.len(),
            }
        }
    }
}

/// Bits that [`BigReader::look`] looks ahead.
pub(super) const AHEAD_BITS: u32 = 56;

/// Reads what a [`BigWriter`] wrote.
#[derive(Debug, Clone)]
pub struct BigReader<'i> {
    input: &'i [u8],
    /// The next bits, from the top; after them those that follow, as far as they are known, or zeros.
    ahead: u64,
    /// How many are counted.
    bits: u32,
}

impl<'i> BigReader<'i> {
    /// A reader at the start of `input`.
    #[must_use]
    pub const fn new(input: &'i [u8]) -> Self {
        Self {
            input,
            ahead: 0,
            bits: 0,
        }
    }

    /// Looks at least 56 bits ahead, or at all that there are.
    #[inline(always)]
    fn refill(&mut self) {
        if let Some((bytes, _)) = self.input.split_first_chunk::<8>() {
            self.ahead |= u64::from_be_bytes(*bytes) >> self.bits;
            let whole = (63 - self.bits) / 8;
            self.input = self.input.get(whole as usize..).unwrap_or_default();
            // What is there of a byte beyond comes again with the next.
            self.bits += 8 * whole;
        } else {
            self.refill_at_end();
        }
    }

    #[cold]
    #[inline(never)]
    fn refill_at_end(&mut self) {
        while self.bits < 56
            && let Some((byte, rest)) = self.input.split_first()
        {
            self.ahead |= u64::from(*byte) << (56 - self.bits);
            self.bits += 8;
            self.input = rest;
        }
    }

    /// Looks [`AHEAD_BITS`] bits ahead, or further; not near the end.
    #[inline(always)]
    pub(super) fn look(&mut self) -> bool {
        let Some((bytes, _)) = self.input.split_first_chunk::<8>() else {
            return false;
        };
        self.ahead |= u64::from_be_bytes(*bytes) >> (self.bits & 63);
        // Fewer than 8, which is plain to see for the compiler.
        let whole = ((self.bits ^ 63) >> 3) & 7;
        self.input = self.input.get(whole as usize..).unwrap_or_default();
        self.bits |= AHEAD_BITS;
        true
    }

    /// The next bit.
    ///
    /// # Errors
    /// [`Ended`].
    #[inline(always)]
    pub(super) fn one(&mut self) -> Result<u32, Ended> {
        if self.bits == 0 {
            let mut copy = self.clone();
            copy.refill_at_end();
            *self = copy;
            if self.bits == 0 {
                return Err(Ended);
            }
        }
        let bit = (self.ahead >> 63) as u32;
        self.skip(1);
        Ok(bit)
    }

    /// Zeros that come next, up to 63, as far as can be seen.
    #[inline(always)]
    pub(super) const fn zeros(&self) -> u32 {
        (self.ahead | 1).leading_zeros()
    }

    /// The next `bits` (1 to 64), as far as can be seen.
    #[inline(always)]
    pub(super) const fn top(&self, bits: u32) -> u64 {
        self.ahead >> (bits.wrapping_neg() & 63)
    }

    /// Makes sure of `bits` (0 to 56) bits.
    ///
    /// # Errors
    /// [`Ended`].
    #[inline(always)]
    fn need(&mut self, bits: u32) -> Result<(), Ended> {
        if self.bits < bits {
            self.refill();
            if self.bits < bits {
                return Err(Ended);
            }
        }
        Ok(())
    }

    /// Goes on by `bits` (0 to 63) bits, which are there.
    #[inline(always)]
    pub(super) const fn skip(&mut self, bits: u32) {
        self.ahead <<= bits & 63;
        self.bits = self.bits.wrapping_sub(bits);
    }

    /// The next `bits` (0 to 32).
    ///
    /// # Errors
    /// [`Ended`].
    #[inline(always)]
    pub fn get(&mut self, bits: u32) -> Result<u32, Ended> {
        self.need(bits)?;
        // In two steps, for none at all.
        let value = (self.ahead >> 1) >> (63_u32.wrapping_sub(bits) & 63);
        self.skip(bits);
        Ok(value as u32)
    }

    /// An Exp-Golomb code of `order` (0 to 31) and its value plus 2^order: as many zeros as that has
    /// bits beyond `order` + 1, and its bits.
    ///
    /// # Errors
    /// [`Ended`], also for one of more than 32 bits, which no value has.
    #[inline(always)]
    pub fn get_raised(&mut self, order: u32) -> Result<u32, Ended> {
        if self.bits < 32 {
            self.refill();
        }
        let zeros = self.ahead.leading_zeros();
        let digits = zeros + order + 1;
        if digits > 32 {
            return Err(Ended);
        }
        let all = zeros + digits;
        if all <= self.bits {
            let value = (self.ahead >> 1) >> (63_u32.wrapping_sub(all) & 63);
            self.skip(all);
            return Ok(value as u32);
        }
        self.need(zeros)?;
        self.skip(zeros);
        self.get(digits)
    }

    /// Whether nothing but the zeros that fill the last byte is left.
    #[must_use]
    pub const fn is_spent(&self) -> bool {
        self.input.is_empty() && self.bits < 8 && self.ahead == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    proptest! {
        #[test]
        fn reads_what_was_written(
            codes in proptest::collection::vec((any::<u32>(), 1..=32_u32), 0..80),
        ) {
            let mut out = [0xa5; 1024];
            let mut writer = BigWriter::new(&mut out);
            for (value, bits) in &codes {
                writer.put(Code::from(value >> (32 - bits)), *bits);
            }
            let len = writer.finish();
            let mut reader = BigReader::new(&out[..len]);
            for (value, bits) in codes {
                prop_assert_eq!(reader.get(bits), Ok(value >> (32 - bits)));
            }
            prop_assert!(reader.is_spent());
        }

        #[test]
        fn raised_values_come_back(
            values in proptest::collection::vec((any::<u32>(), 0..32_u32, 0..=30_u32), 0..40),
        ) {
            let mut out = [0; 1024];
            let mut writer = BigWriter::new(&mut out);
            let values = values.iter().map(|(value, shift, order)| {
                ((value >> shift >> 1) | (1 << order), *order)
            });
            for (value, order) in values.clone() {
                let zeros = 31 - value.leading_zeros() - order;
                if zeros > 0 {
                    writer.put(0, zeros);
                }
                writer.put(Code::from(value), zeros + order + 1);
            }
            let len = writer.finish();
            let mut reader = BigReader::new(&out[..len]);
            for (value, order) in values {
                prop_assert_eq!(reader.get_raised(order), Ok(value));
            }
            prop_assert!(reader.is_spent());
        }

        /// Also beyond a buffer's end, where it is lost.
        #[test]
        fn as_much_as_there_is_room_for(len in 0..40_usize, codes in 1..80_usize) {
            let mut out = vec![0xa5; len];
            let mut writer = BigWriter::new(&mut out);
            let mut fitting = 0;
            for _ in 0..codes {
                fitting += usize::from(writer.has_words(1));
                writer.put(1, 11);
            }
            prop_assert!(writer.finish() <= len);
            let mut reader = BigReader::new(&out);
            for _ in 0..fitting {
                prop_assert_eq!(reader.get(11), Ok(1));
            }
        }

        #[test]
        fn any_bytes_can_be_read(bytes in proptest::collection::vec(any::<u8>(), 0..64), order in 0..=31_u32) {
            let mut reader = BigReader::new(&bytes);
            for _ in 0..600 {
                let _ = reader.get_raised(order);
                let _ = reader.get(order);
            }
        }
    }

    #[test]
    fn bit_order_is_high_first() {
        let mut out = [0; 8];
        let mut writer = BigWriter::new(&mut out);
        writer.put(0b1, 1);
        writer.put(0b10, 3);
        let before = writer.position();
        writer.put(0b1111, 4);
        writer.rewind(before);
        writer.put(0b00_1101, 6);
        assert_eq!(writer.finish(), 2);
        assert_eq!(out[..2], [0b1010_0011, 0b0100_0000]);
    }
}
