//! Writes and reads bits as in a big-endian number: the first bit is the highest bit of the first byte.
//!
//! The zeros that lead a code then need no instruction: a code of n bits is just a number below 2^n.

#[cfg(not(target_pointer_width = "64"))]
mod words32;
#[cfg(target_pointer_width = "64")]
mod words64;

use crate::pack::bits_lsb_first::Ended;

/// Unsigned integer that holds the widest code.
#[cfg(target_pointer_width = "64")]
pub type Code = u64;
/// Unsigned integer that holds the widest code.
#[cfg(not(target_pointer_width = "64"))]
pub type Code = u32;

/// Most bits of one code: up to seven bits of an incomplete byte wait in the same register.
#[cfg(target_pointer_width = "64")]
pub const CODE_BITS: u32 = u64::BITS - 8;
/// Most bits of one code: a whole register.
#[cfg(not(target_pointer_width = "64"))]
pub const CODE_BITS: u32 = u32::BITS;

#[cfg(not(target_pointer_width = "64"))]
pub use words32::{BigWriter, Position};
#[cfg(target_pointer_width = "64")]
pub use words64::{BigWriter, Position};

/// Bits that [`BigReader::look`] makes available.
pub(super) const AHEAD_BITS: u32 = 56;

/// Reads bits from a byte slice, as a [`BigWriter`] wrote them.
#[derive(Debug, Clone)]
pub struct BigReader<'i> {
    input: &'i [u8],
    /// The next bits, from the top. Below them may be further bits of the input that are not counted yet, or zeros.
    ahead: u64,
    /// How many bits of `ahead` are counted.
    bits: u32,
}

impl<'i> BigReader<'i> {
    /// Starts reading at the start of `input`.
    #[must_use]
    pub const fn new(input: &'i [u8]) -> Self {
        Self {
            input,
            ahead: 0,
            bits: 0,
        }
    }

    /// Makes at least 56 bits available, or all that are left.
    #[inline(always)]
    fn refill(&mut self) {
        if let Some((bytes, _)) = self.input.split_first_chunk::<8>() {
            self.ahead |= u64::from_be_bytes(*bytes) >> self.bits;
            let whole = (63 - self.bits) / 8;
            self.input = self.input.get(whole as usize..).unwrap_or_default();
            // The bits of a byte that is not counted are read again with the next refill.
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

    /// Makes at least [`AHEAD_BITS`] bits available. Returns false, and does nothing, in the last 7 bytes of the
    /// input.
    #[inline(always)]
    pub(super) fn look(&mut self) -> bool {
        let Some((bytes, _)) = self.input.split_first_chunk::<8>() else {
            return false;
        };
        self.ahead |= u64::from_be_bytes(*bytes) >> (self.bits & 63);
        // Fewer than 8, in a form from which the compiler can see it.
        let whole = ((self.bits ^ 63) >> 3) & 7;
        self.input = self.input.get(whole as usize..).unwrap_or_default();
        self.bits |= AHEAD_BITS;
        true
    }

    /// Reads one bit.
    ///
    /// # Errors
    /// [`Ended`] if no bit is left.
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

    /// Returns the number of leading zeros of the bits available, up to 63.
    #[inline(always)]
    pub(super) const fn zeros(&self) -> u32 {
        (self.ahead | 1).leading_zeros()
    }

    /// Returns the next `bits` (1 to 64) bits without consuming them; zeros where they are not available.
    #[inline(always)]
    pub(super) const fn top(&self, bits: u32) -> u64 {
        self.ahead >> (bits.wrapping_neg() & 63)
    }

    /// Makes sure that `bits` (0 to 56) bits are available.
    ///
    /// # Errors
    /// [`Ended`] if fewer are left.
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

    /// Consumes `bits` (0 to 63) bits, which have to be available.
    #[inline(always)]
    pub(super) const fn skip(&mut self, bits: u32) {
        self.ahead <<= bits & 63;
        self.bits = self.bits.wrapping_sub(bits);
    }

    /// Reads a number of `bits` (0 to 32) bits.
    ///
    /// # Errors
    /// [`Ended`] if fewer bits are left.
    #[inline(always)]
    pub fn get(&mut self, bits: u32) -> Result<u32, Ended> {
        self.need(bits)?;
        // Two shifts, so that 0 bits work too.
        let value = (self.ahead >> 1) >> (63_u32.wrapping_sub(bits) & 63);
        self.skip(bits);
        Ok(value as u32)
    }

    /// Reads an Exp-Golomb code of `order` (0 to 31) and returns its value plus 2^order. The code is that number,
    /// after as many zeros as the number has bits beyond `order` + 1.
    ///
    /// # Errors
    /// [`Ended`] if the bits end too early, and for a number of more than 32 bits, which no value has.
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

    /// Returns whether nothing is left but the zeros that fill the last byte.
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

        /// Also writes beyond the end of the buffer, where codes are lost.
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
