//! Writes and reads bits in bytes: the first bit is the lowest bit of the first byte.

use core::mem::offset_of;

/// Error: the buffer has no room for what was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Full;

/// Error: the bits end before what was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Ended;

/// Writes bits into a lent buffer, a word of 32 bits at a time.
///
/// Once the buffer is full, everything written is lost until [`Self::rewind`]: check [`Self::is_full`] after a
/// pixel, not after each of its fields.
#[derive(Debug)]
#[repr(C)]
pub struct BitWriter<'o> {
    state: Position,
    words: &'o mut [[u8; 4]],
}

/// A position in a [`BitWriter`]'s output to which it can rewind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
pub struct Position {
    /// Number of words written.
    words: usize,
    /// Pending bits of the next word, the oldest lowest.
    pending: u32,
    /// Number of bits that the next word still has room for: 1 to 32.
    free: u32,
}

// Assumptions of the assembly.
const _: () = assert!(
    offset_of!(Position, words) == 0
        && offset_of!(Position, pending) == size_of::<usize>()
        && offset_of!(Position, free) == size_of::<usize>() + 4
);

impl<'o> BitWriter<'o> {
    /// Starts writing at the start of `out`, of which up to three bytes at the end stay unused.
    #[must_use]
    pub const fn new(out: &'o mut [u8]) -> Self {
        Self {
            words: out.as_chunks_mut().0,
            state: Position {
                words: 0,
                pending: 0,
                free: 32,
            },
        }
    }

    /// Writes the low `bits` (0 to 32) bits of `value`; its other bits are ignored.
    #[inline(always)]
    pub fn put(&mut self, value: u32, bits: u32) {
        if bits > 0 {
            self.put_clean(value & (u32::MAX >> (32_u32.wrapping_sub(bits) & 31)), bits);
        }
    }

    /// As [`Self::put`], for a `value` below 2^`bits`.
    #[inline(always)]
    pub fn put_clean(&mut self, value: u32, bits: u32) {
        debug_assert!(bits <= 32 && u64::from(value) < 1 << bits);
        if cfg!(target_pointer_width = "64") {
            self.put_at_once(value, bits);
        } else if !self.put_within(value, bits) {
            self.complete_apart(value, bits);
        }
    }

    /// As [`Self::put_clean`], always inlined: for code whose speed is worth the flash.
    #[inline(always)]
    pub fn put_here(&mut self, value: u32, bits: u32) {
        debug_assert!(bits <= 32 && u64::from(value) < 1 << bits);
        if cfg!(target_pointer_width = "64") {
            self.put_at_once(value, bits);
        } else if !self.put_within(value, bits) {
            self.complete(value, bits);
        }
    }

    /// As [`Self::put_clean`], where a register holds two words. A processor cannot predict which value completes a
    /// word, so the word is stored each time.
    #[inline(always)]
    fn put_at_once(&mut self, value: u32, bits: u32) {
        let Position {
            words,
            pending,
            free,
        } = self.state;
        let filled = 32_u32.wrapping_sub(free);
        let both = u64::from(pending) | (u64::from(value) << (filled & 31));
        if let Some(place) = self.words.get_mut(words) {
            *place = (both as u32).to_le_bytes();
        }
        let filled = filled.wrapping_add(bits);
        self.state = Position {
            words: words + (filled / 32) as usize,
            pending: (both >> (filled & 32)) as u32,
            free: 32 - filled % 32,
        };
    }

    /// Writes the value if it leaves room in the word, and returns whether it did; otherwise writes nothing.
    #[inline(always)]
    fn put_within(&mut self, value: u32, bits: u32) -> bool {
        let Position { pending, free, .. } = self.state;
        if bits < free {
            self.state.pending = pending | value.rotate_right(free);
            self.state.free = free - bits;
            return true;
        }
        false
    }

    #[inline(never)]
    fn complete_apart(&mut self, value: u32, bits: u32) {
        self.complete(value, bits);
    }

    /// The rest of [`Self::put_clean`], if the value completes a word.
    #[inline(always)]
    fn complete(&mut self, value: u32, bits: u32) {
        let Position {
            words,
            pending,
            free,
        } = self.state;
        // Rotate the lowest bit next to the newest pending one; bits beyond the word wrap to the bottom.
        let turned = value.rotate_right(free);
        // The bits for the next word: in the places of those that were pending, and none if there were none.
        let beyond = turned & (1_u32.rotate_right(free).wrapping_sub(1));
        let word = pending | turned.wrapping_sub(beyond);
        if let Some(place) = self.words.get_mut(words) {
            *place = word.to_le_bytes();
        }
        self.state = Position {
            words: words + 1,
            pending: beyond,
            free: 32 + free - bits,
        };
    }

    /// As [`Self::put_clean`], for up to 64 bits.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(crate) fn put_long(&mut self, value: u64, bits: u32) {
        debug_assert!(bits <= 64 && u128::from(value) < 1 << bits);
        let Position {
            words,
            pending,
            free,
        } = self.state;
        let filled = 32_u32.wrapping_sub(free);
        let all = u128::from(pending) | (u128::from(value) << (filled & 31));
        let place = self.words.get_mut(words..);
        if let Some(place) = place.and_then(|words| words.first_chunk_mut::<2>()) {
            *place = [all as u32, (all >> 32) as u32].map(u32::to_le_bytes);
        } else if let Some(place) = self.words.get_mut(words) {
            // The last word: there is none for the bits beyond it.
            *place = (all as u32).to_le_bytes();
        }
        let filled = filled.wrapping_add(bits);
        self.state = Position {
            words: words + (filled / 32) as usize,
            pending: (all >> (filled & 96)) as u32,
            free: 32 - filled % 32,
        };
    }

    /// Writes `count` (0 to 31) zeros and a one.
    #[inline(always)]
    pub fn put_unary(&mut self, count: u32) {
        self.put_clean(1 << (count & 31), count + 1);
    }

    /// Writes the Exp-Golomb code of `order` (0 to 31) of a value below 2^32 - 2^order.
    #[inline(always)]
    pub fn put_exp_golomb(&mut self, value: u32, order: u32) {
        let (code, bits) = exp_golomb(value, order);
        if bits < 32 {
            // Without the 1 above it.
            self.put_clean(code ^ (1 << (bits & 31)), bits);
        } else {
            self.put_long_exp_golomb(value, order);
        }
    }

    /// [`Self::put_exp_golomb`], if one word does not hold the code.
    #[cold]
    #[inline(never)]
    fn put_long_exp_golomb(&mut self, value: u32, order: u32) {
        let shifted = value.wrapping_add(1 << (order & 31));
        let low_bits = shifted.leading_zeros() ^ 31;
        self.put_unary(low_bits.wrapping_sub(order) & 31);
        self.put(shifted, low_bits);
    }

    /// Runs `write` on a copy of this writer and takes over the copy's state. The copy's state is in memory, so
    /// that this writer's can stay in registers.
    #[inline(always)]
    pub fn aside(&mut self, write: impl FnOnce(&mut BitWriter<'_>)) {
        let mut copy = BitWriter {
            words: self.words,
            state: self.state,
        };
        write(&mut copy);
        self.state = copy.state;
    }

    /// Returns whether something written did not fit. Then all that was written since the last [`Self::position`]
    /// that was not full is invalid.
    #[inline(always)]
    #[must_use]
    pub const fn is_full(&self) -> bool {
        // One word stays free for what `finish` has to write.
        self.state.words >= self.words.len()
    }

    /// Returns the state, the words and their number, for assembly.
    ///
    /// # Safety
    /// `writer` has to be valid.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[allow(unsafe_code)]
    pub(crate) const unsafe fn raw_parts(
        writer: *mut Self,
    ) -> (*mut Position, *mut [u8; 4], usize) {
        // SAFETY: the caller ensures that `writer` is valid.
        let (state, words) = unsafe { (&raw mut (*writer).state, &mut *(*writer).words) };
        (state, words.as_mut_ptr(), words.len())
    }

    /// Returns whether `words` more words can be written without the writer being full.
    #[inline(always)]
    #[must_use]
    pub const fn has_words(&self, words: usize) -> bool {
        self.state.words + words < self.words.len()
    }

    /// Returns the current position, for [`Self::rewind`].
    #[inline(always)]
    #[must_use]
    pub const fn position(&self) -> Position {
        self.state
    }

    /// Goes back to `position` and discards everything written after it.
    pub const fn rewind(&mut self, position: Position) {
        self.state = position;
    }

    /// Fills the last byte with zeros and returns the number of bytes written.
    #[must_use]
    pub fn finish(self) -> usize {
        let Position {
            words,
            pending,
            free,
        } = self.state;
        match self.words.get_mut(words) {
            Some(word) => {
                *word = pending.to_le_bytes();
                4 * words + (32 - free).div_ceil(8) as usize
            }
            None => 4 * self.words.len(),
        }
    }
}

/// Returns the Exp-Golomb code of `order` (0 to 31) of a value below 2^32 - 2^order, with a 1 right above it, and
/// its number of bits. The code is valid for up to 32 bits.
#[inline(always)]
#[must_use]
pub const fn exp_golomb(value: u32, order: u32) -> (u32, u32) {
    let shifted = value.wrapping_add(1 << (order & 31));
    let zeros = shifted.leading_zeros();
    let unary = 31_u32.wrapping_sub(order).wrapping_sub(zeros);
    // `unary` zeros, a one, and the bits of `shifted`, whose highest is the 1 above.
    let code = ((shifted << 1) | 1) << (unary & 31);
    (code, unary.wrapping_add(32 - zeros))
}

/// Reads bits from a byte slice, as a [`BitWriter`] wrote them.
#[derive(Debug, Clone)]
pub struct BitReader<'i> {
    input: &'i [u8],
    pending: u64,
    pending_bits: u32,
}

impl<'i> BitReader<'i> {
    /// Starts reading at the start of `input`.
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

    /// Reads a number of `bits` (0 to 32) bits.
    ///
    /// # Errors
    /// [`Ended`] if fewer bits are left.
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

    /// Counts the zeros up to the next one and consumes them with it. After `most` zeros it stops, and no one
    /// follows.
    ///
    /// # Errors
    /// [`Ended`] if the bits end too early.
    pub fn get_unary(&mut self, most: u32) -> Result<u32, Ended> {
        let mut count = 0;
        while count < most && self.get(1)? == 0 {
            count += 1;
        }
        Ok(count)
    }

    /// Reads an Exp-Golomb code of `order`: the inverse of [`BitWriter::put_exp_golomb`].
    ///
    /// # Errors
    /// [`Ended`] if the bits end too early, and for a code that no value has.
    pub fn get_exp_golomb(&mut self, order: u32) -> Result<u32, Ended> {
        let low_bits = order + self.get_unary(32)?;
        if low_bits > 31 {
            return Err(Ended);
        }
        Ok(((1 << low_bits) | self.get(low_bits)?) - (1 << order))
    }

    /// Returns how many bits are left.
    #[must_use]
    pub const fn bits_left(&self) -> u64 {
        self.input.len() as u64 * 8 + self.pending_bits as u64
    }

    /// Returns whether nothing is left but the zeros that fill the last byte.
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
        Unary(u32),
    }

    fn code() -> impl Strategy<Value = Code> {
        prop_oneof![
            (any::<u32>(), 0..=32_u32)
                .prop_map(|(v, bits)| Code::Plain((u64::from(v) & ((1 << bits) - 1)) as u32, bits)),
            (0..1_u32 << 31, 0..=22_u32, 0..31_u32)
                .prop_map(|(v, order, shift)| Code::ExpGolomb((v - (v >> 9)) >> shift, order)),
            (0..=31_u32).prop_map(Code::Unary),
        ]
    }

    fn put(writer: &mut BitWriter<'_>, code: Code) {
        match code {
            Code::Plain(value, bits) => writer.put(value, bits),
            Code::ExpGolomb(value, order) => writer.put_exp_golomb(value, order),
            Code::Unary(count) => writer.put_unary(count),
        }
    }

    fn get(reader: &mut BitReader<'_>, code: Code) -> bool {
        match code {
            Code::Plain(value, bits) => reader.get(bits) == Ok(value),
            Code::ExpGolomb(value, order) => reader.get_exp_golomb(order) == Ok(value),
            Code::Unary(count) => reader.get_unary(32) == Ok(count),
        }
    }

    #[cfg(target_arch = "x86_64")]
    proptest! {
        /// Also tests the end of the buffer.
        #[test]
        fn a_long_value_is_its_two_halves(
            len in 0..40_usize, values in proptest::collection::vec((any::<u64>(), 0..=64_u32), 0..20),
        ) {
            let mut out = [[0; 40]; 2];
            let [once, twice] = &mut out;
            let (mut once, mut twice) = (BitWriter::new(&mut once[..len]), BitWriter::new(&mut twice[..len]));
            for (value, bits) in values {
                let value = (u128::from(value) & ((1 << bits) - 1)) as u64;
                once.put_long(value, bits);
                twice.put(value as u32, bits.min(32));
                twice.put((value >> 32) as u32, bits.saturating_sub(32));
                prop_assert_eq!(once.is_full(), twice.is_full());
                if !once.is_full() {
                    prop_assert_eq!(once.position(), twice.position());
                }
            }
            if !once.is_full() {
                prop_assert_eq!(once.finish(), twice.finish());
                prop_assert_eq!(out[0], out[1]);
            }
        }
    }

    proptest! {
        #[test]
        fn reads_what_was_written(codes in proptest::collection::vec(code(), 0..50)) {
            let mut out = [0xa5; 1024];
            let mut writer = BitWriter::new(&mut out);
            for code in &codes {
                put(&mut writer, *code);
            }
            prop_assert!(!writer.is_full());
            let len = writer.finish();
            let mut reader = BitReader::new(&out[..len]);
            for code in codes {
                prop_assert!(get(&mut reader, code), "{:?}", code);
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
                put(&mut writer, *code);
                if writer.is_full() {
                    writer.rewind(before);
                    break;
                }
                written += 1;
            }
            let used = writer.finish();
            prop_assert!(used <= len);
            let mut reader = BitReader::new(&out[..used]);
            for code in &codes[..written] {
                prop_assert!(get(&mut reader, *code), "{:?}", code);
            }
        }

        #[test]
        fn any_bytes_can_be_read(bytes in proptest::collection::vec(any::<u8>(), 0..64), order in 0..=31_u32) {
            let mut reader = BitReader::new(&bytes);
            for _ in 0..600 {
                let _ = reader.get_exp_golomb(order);
                let _ = reader.get_unary(order);
            }
        }
    }

    #[test]
    fn a_buffer_of_one_word_holds_what_is_less() {
        let mut out = [0; 7];
        let mut writer = BitWriter::new(&mut out);
        writer.put(0x7fff_ffff, 31);
        assert!(!writer.is_full());
        assert_eq!(writer.finish(), 4);
        let mut writer = BitWriter::new(&mut out);
        writer.put(u32::MAX, 32);
        assert!(writer.is_full());
        assert!(BitWriter::new(&mut []).is_full());
    }

    #[test]
    fn codes_that_no_value_has_are_refused() {
        // 32 zeros, and an order that leaves too few bits for 20 of them.
        assert_eq!(BitReader::new(&[0; 16]).get_exp_golomb(0), Err(Ended));
        let twenty = [0, 0, 0x10, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(
            BitReader::new(&twenty).get_exp_golomb(11),
            Ok((1 << 31) - (1 << 11))
        );
        assert_eq!(BitReader::new(&twenty).get_exp_golomb(12), Err(Ended));
    }

    #[test]
    fn bit_order_is_low_first() {
        let mut out = [0; 8];
        let mut writer = BitWriter::new(&mut out);
        writer.put(0b1, 1);
        writer.put(0b10, 2);
        writer.put_exp_golomb(2, 0); // 3 = 0b11: unary 1, low bit 1
        writer.put_unary(2);
        assert_eq!(writer.finish(), 2);
        assert_eq!(out[..2], [0b0011_0101, 0b1]);
    }
}
