//! Bits in bytes: the first bit is the lowest of the first byte.

/// The buffer has no room left for what was put.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Full;

/// The bits end before what was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Ended;

/// Unary part of a Rice code from which on the value follows plainly: bounds a code to 56 bits.
const RICE_ESCAPE: u32 = 24;

/// Writes bits into a lent buffer.
#[derive(Debug)]
pub struct BitWriter<'o> {
    out: &'o mut [u8],
    state: Position,
}

/// A place in a [`BitWriter`]'s output to go back to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Position {
    bytes: usize,
    pending: u64,
    pending_bits: u32,
}

impl<'o> BitWriter<'o> {
    /// A writer at the start of `out`.
    #[must_use]
    pub const fn new(out: &'o mut [u8]) -> Self {
        Self {
            out,
            state: Position {
                bytes: 0,
                pending: 0,
                pending_bits: 0,
            },
        }
    }

    /// Puts the low `bits` (0 to 32) of `value`, whose others must be 0.
    ///
    /// # Errors
    /// [`Full`]: nothing of the value counts as written.
    #[inline]
    pub fn put(&mut self, value: u32, bits: u32) -> Result<(), Full> {
        debug_assert!(bits <= 32 && u64::from(value) >> bits == 0);
        let mut state = self.state;
        state.pending |= u64::from(value) << state.pending_bits;
        state.pending_bits += bits;
        let full_word = state.pending_bits >= 32;
        let end = state.bytes + 4 * usize::from(full_word);
        // Four bytes stay free for what `finish` has to write.
        if end + 4 > self.out.len() {
            return Err(Full);
        }
        if full_word {
            self.out[state.bytes..end].copy_from_slice(&(state.pending as u32).to_le_bytes());
            state.bytes = end;
            state.pending >>= 32;
            state.pending_bits -= 32;
        }
        self.state = state;
        Ok(())
    }

    /// `count` ones and a zero.
    fn put_unary(&mut self, mut count: u32) -> Result<(), Full> {
        while count >= 31 {
            self.put(0x7fff_ffff, 31)?;
            count -= 31;
        }
        self.put((1 << count) - 1, count + 1)
    }

    /// Exp-Golomb code of `order` (0 to 31) of a value below 2^32 - 2^order.
    ///
    /// # Errors
    /// [`Full`].
    pub fn put_exp_golomb(&mut self, value: u32, order: u32) -> Result<(), Full> {
        let shifted = value + (1 << order);
        let low_bits = shifted.ilog2();
        self.put_unary(low_bits - order)?;
        self.put(shifted - (1 << low_bits), low_bits)
    }

    /// Rice code of a signed value (zigzag: 0, -1, 1, -2, ...) with `low_bits` (0 to 31) plain
    /// bits; a value far above 2^`low_bits` is escaped.
    ///
    /// # Errors
    /// [`Full`].
    #[inline]
    pub fn put_rice(&mut self, value: i32, low_bits: u32) -> Result<(), Full> {
        let zigzag = ((value << 1) ^ (value >> 31)) as u32;
        let quotient = zigzag >> low_bits;
        if quotient < RICE_ESCAPE {
            self.put((1 << quotient) - 1, quotient + 1)?;
            self.put(zigzag & ((1 << low_bits) - 1), low_bits)
        } else {
            self.put((1 << RICE_ESCAPE) - 1, RICE_ESCAPE)?;
            self.put(zigzag, 32)
        }
    }

    /// Where the writer stands.
    #[must_use]
    pub const fn position(&self) -> Position {
        self.state
    }

    /// Takes back everything put after `position`.
    pub const fn rewind(&mut self, position: Position) {
        self.state = position;
    }

    /// Fills the last byte with zeros and returns the number of bytes written.
    #[must_use]
    pub fn finish(mut self) -> usize {
        while self.state.pending_bits > 0 {
            // In range: `put` keeps four bytes free, and fewer than 32 bits are pending.
            self.out[self.state.bytes] = self.state.pending as u8;
            self.state.bytes += 1;
            self.state.pending >>= 8;
            self.state.pending_bits = self.state.pending_bits.saturating_sub(8);
        }
        self.state.bytes
    }
}

/// Reads what a [`BitWriter`] wrote.
#[derive(Debug, Clone)]
pub struct BitReader<'i> {
    input: &'i [u8],
    pending: u64,
    pending_bits: u32,
}

impl<'i> BitReader<'i> {
    /// A reader at the start of `input`.
    #[must_use]
    pub const fn new(input: &'i [u8]) -> Self {
        Self {
            input,
            pending: 0,
            pending_bits: 0,
        }
    }

    #[inline]
    fn refill(&mut self) {
        while self.pending_bits <= 56 {
            let Some((byte, rest)) = self.input.split_first() else {
                break;
            };
            self.pending |= u64::from(*byte) << self.pending_bits;
            self.pending_bits += 8;
            self.input = rest;
        }
    }

    /// The next `bits` (0 to 32).
    ///
    /// # Errors
    /// [`Ended`].
    #[inline]
    pub fn get(&mut self, bits: u32) -> Result<u32, Ended> {
        debug_assert!(bits <= 32);
        if self.pending_bits < bits {
            self.refill();
            if self.pending_bits < bits {
                return Err(Ended);
            }
        }
        let value = (self.pending & ((1 << bits) - 1)) as u32;
        self.pending >>= bits;
        self.pending_bits -= bits;
        Ok(value)
    }

    /// Ones before the next zero, which is consumed; at most `most`, after which no zero follows.
    fn get_unary(&mut self, most: u32) -> Result<u32, Ended> {
        let mut count = 0;
        while count < most && self.get(1)? == 1 {
            count += 1;
        }
        Ok(count)
    }

    /// Inverse of [`BitWriter::put_exp_golomb`].
    ///
    /// # Errors
    /// [`Ended`], also for a code that no value has.
    pub fn get_exp_golomb(&mut self, order: u32) -> Result<u32, Ended> {
        let low_bits = order + self.get_unary(32)?;
        if low_bits > 31 {
            return Err(Ended);
        }
        Ok(((1 << low_bits) | self.get(low_bits)?) - (1 << order))
    }

    /// Inverse of [`BitWriter::put_rice`].
    ///
    /// # Errors
    /// [`Ended`].
    #[inline]
    pub fn get_rice(&mut self, low_bits: u32) -> Result<i32, Ended> {
        let quotient = self.get_unary(RICE_ESCAPE)?;
        let zigzag = if quotient < RICE_ESCAPE {
            // A quotient too large for 32 bits is no code: the writer escapes long before.
            quotient
                .checked_shl(low_bits)
                .filter(|high| high >> low_bits == quotient)
                .ok_or(Ended)?
                | self.get(low_bits)?
        } else {
            self.get(32)?
        };
        Ok((zigzag >> 1) as i32 ^ -((zigzag & 1) as i32))
    }

    /// Whether nothing but the zeros that fill the last byte is left.
    #[must_use]
    pub fn is_spent(&self) -> bool {
        self.input.is_empty() && self.pending_bits < 8 && self.pending == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, Clone, Copy)]
    enum Code {
        Plain(u32, u32),
        ExpGolomb(u32, u32),
        Rice(i32, u32),
    }

    fn code() -> impl Strategy<Value = Code> {
        prop_oneof![
            (any::<u32>(), 0..=32_u32)
                .prop_map(|(v, bits)| Code::Plain((u64::from(v) & ((1 << bits) - 1)) as u32, bits)),
            (0..1_u32 << 31, 0..=22_u32, 0..31_u32)
                .prop_map(|(v, order, shift)| Code::ExpGolomb((v - (v >> 9)) >> shift, order)),
            (any::<i32>(), 0..=31_u32, 0..32_u32)
                .prop_map(|(v, bits, shift)| Code::Rice(v >> shift, bits)),
        ]
    }

    fn put(writer: &mut BitWriter<'_>, code: Code) -> Result<(), Full> {
        match code {
            Code::Plain(value, bits) => writer.put(value, bits),
            Code::ExpGolomb(value, order) => writer.put_exp_golomb(value, order),
            Code::Rice(value, bits) => writer.put_rice(value, bits),
        }
    }

    proptest! {
        #[test]
        fn reads_what_was_written(codes in proptest::collection::vec(code(), 0..50)) {
            let mut out = [0xa5; 1024];
            let mut writer = BitWriter::new(&mut out);
            for code in &codes {
                prop_assert_eq!(put(&mut writer, *code), Ok(()));
            }
            let len = writer.finish();
            let mut reader = BitReader::new(&out[..len]);
            for code in codes {
                match code {
                    Code::Plain(value, bits) => prop_assert_eq!(reader.get(bits), Ok(value)),
                    Code::ExpGolomb(value, order) => {
                        prop_assert_eq!(reader.get_exp_golomb(order), Ok(value));
                    }
                    Code::Rice(value, bits) => prop_assert_eq!(reader.get_rice(bits), Ok(value)),
                }
            }
            prop_assert!(reader.is_spent());
        }

        #[test]
        fn a_full_buffer_is_reported_and_rewound(len in 0..40_usize, codes in proptest::collection::vec(code(), 1..40)) {
            let mut out = [0; 40];
            let mut writer = BitWriter::new(&mut out[..len]);
            let mut written = 0;
            for code in &codes {
                let before = writer.position();
                if put(&mut writer, *code).is_err() {
                    writer.rewind(before);
                    break;
                }
                written += 1;
            }
            let used = writer.finish();
            prop_assert!(used <= len);
            let mut reader = BitReader::new(&out[..used]);
            for code in &codes[..written] {
                let read = match code {
                    Code::Plain(_, bits) => reader.get(*bits).is_ok(),
                    Code::ExpGolomb(_, order) => reader.get_exp_golomb(*order).is_ok(),
                    Code::Rice(_, bits) => reader.get_rice(*bits).is_ok(),
                };
                prop_assert!(read);
            }
        }

        #[test]
        fn any_bytes_can_be_read(bytes in proptest::collection::vec(any::<u8>(), 0..64), order in 0..=31_u32) {
            let mut reader = BitReader::new(&bytes);
            for _ in 0..600 {
                let _ = reader.get_exp_golomb(order);
                let _ = reader.get_rice(order);
            }
        }
    }

    #[test]
    fn the_escape_begins_at_24_ones() {
        for (zigzag_half, expected) in [
            // 23 ones and a zero; 24 ones and the value in 32 bits.
            (-12, &[0xff, 0xff, 0x7f][..]),
            (12, &[0xff, 0xff, 0xff, 24, 0, 0, 0]),
        ] {
            let mut out = [0; 16];
            let mut writer = BitWriter::new(&mut out);
            writer.put_rice(zigzag_half, 0).unwrap();
            let len = writer.finish();
            assert_eq!(out[..len], *expected);
            assert_eq!(BitReader::new(&out[..len]).get_rice(0), Ok(zigzag_half));
        }
    }

    #[test]
    fn codes_that_no_value_has_are_refused() {
        // 32 ones, and an order that leaves too few bits for 20 of them.
        let ones = [0xff; 16];
        assert_eq!(BitReader::new(&ones).get_exp_golomb(0), Err(Ended));
        let twenty = [0xff, 0xff, 0x0f, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(
            BitReader::new(&twenty).get_exp_golomb(11),
            Ok((1 << 31) - (1 << 11))
        );
        assert_eq!(BitReader::new(&twenty).get_exp_golomb(12), Err(Ended));
        // A quotient of 2 with 31 plain bits is 2^32.
        assert_eq!(BitReader::new(&[3, 0, 0, 0, 0, 0]).get_rice(31), Err(Ended));
    }

    #[test]
    fn bit_order_is_low_first() {
        let mut out = [0; 8];
        let mut writer = BitWriter::new(&mut out);
        writer.put(0b1, 1).unwrap();
        writer.put(0b10, 2).unwrap();
        writer.put_exp_golomb(2, 0).unwrap(); // 3 = 0b11: unary 1, low bit 1
        writer.put_rice(-3, 1).unwrap(); // zigzag 5: quotient 2, low bit 1
        assert_eq!(writer.finish(), 2);
        assert_eq!(out[..2], [0b1110_1101, 0b10]);
    }
}
