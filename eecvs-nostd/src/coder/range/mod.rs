//! Adaptive range coder: codes decisions and symbols with learned probabilities, and equally likely numbers.
//!
//! An outcome of learned probability p costs -log2 p bits, to within 0.1 %, as the range keeps at least 24 bits.
//! One trait serves both directions, so that each model is written once.

#[cfg(eecvs_dsp)]
pub(crate) mod armv7em;
#[cfg(eecvs_dsp)]
mod shares_armv7em;
mod shares_portable;
pub mod symbols;

#[cfg(eecvs_dsp)]
use shares_armv7em::move_shares;
#[cfg(not(eecvs_dsp))]
use shares_portable::move_shares;
use symbols::Symbols;

/// Probability of a one, learned from the decisions coded with it, in 16 bits.
///
/// The upper 13 bits are the probability in units of 2^-13, never nearer than 49 / 8192 to 0 or 1. The lower 3
/// count the first decisions, each of which moves the probability by less than the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(transparent)]
pub struct Probability(u16);

const ONE: u32 = 1 << 13;
const COUNT_BITS: u32 = 3;
const COUNT_MASK: u32 = (1 << COUNT_BITS) - 1;
/// How far a decision moves the probability, by the number of decisions before it, in units of 2^-16: from 1/2 to
/// 1/50. The lowest three bits, too small to matter as a rate, are the next count.
pub(super) const RATES: [u16; 1 << COUNT_BITS] = {
    let rates = [32768, 21845, 16384, 10923, 8192, 5461, 3641, 1311];
    let mut next = [0; 1 << COUNT_BITS];
    let mut count = 0;
    while count < rates.len() {
        let after = if count + 1 < rates.len() {
            count + 1
        } else {
            count
        };
        next[count] = rates[count] & !(COUNT_MASK as u16) | after as u16;
        count += 1;
    }
    next
};

impl Probability {
    /// All zero, for memory in `.bss`; to be set before use.
    pub const UNSET: Self = Self(0);

    /// One half, before any decision.
    pub const EVEN: Self = Self(((ONE / 2) as u16) << COUNT_BITS);

    /// Returns the probability of a one in units of 2^-13, 1 to 2^13 - 1.
    #[inline(always)]
    #[must_use]
    pub const fn of_one(self) -> u32 {
        (self.0 >> COUNT_BITS) as u32
    }

    /// Moves the probability towards a decision that was coded.
    #[inline(always)]
    pub const fn learn(&mut self, bit: bool) {
        let rate = RATES[(self.0 as u32 & COUNT_MASK) as usize] as u32;
        // Rounded towards the old value, which keeps the probability off both ends.
        let p = self.of_one();
        let p = if bit {
            p + (((ONE - p) * rate) >> 16)
        } else {
            p - ((p * rate) >> 16)
        };
        self.0 = ((p << COUNT_BITS) | (rate & COUNT_MASK)) as u16;
    }
}

/// How much of its input is left to a decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InputLeft {
    /// Bits that were not taken.
    bits: i64,
    /// Range of a range decoder, whose bits are left too; otherwise 1.
    range: u32,
}

impl InputLeft {
    /// Nothing is left.
    pub const NONE: Self = Self::bits(0);

    /// This many bits are left.
    #[must_use]
    pub const fn bits(bits: u64) -> Self {
        Self {
            bits: bits as i64,
            range: 1,
        }
    }

    /// Returns the number of bits: with a range decoder, also fractions of them.
    #[must_use]
    pub fn count(self) -> f64 {
        self.bits as f64 + libm::log2(f64::from(self.range))
    }
}

/// Codes decisions in either direction.
///
/// An encoder writes each value that it is given and returns it. A decoder returns the value that it reads and
/// ignores the one that it is given.
pub trait Binary {
    /// Codes a decision with a probability, which learns from it.
    fn bit(&mut self, probability: &mut Probability, bit: bool) -> bool;

    /// Codes a symbol with a table, which learns from it.
    fn symbol<const N: usize>(&mut self, table: &mut Symbols<N>, symbol: usize) -> usize;

    /// As [`Self::symbol`], where only symbols up to `last` are possible.
    fn symbol_up_to<const N: usize>(
        &mut self,
        table: &mut Symbols<N>,
        symbol: usize,
        last: usize,
    ) -> usize;

    /// Codes a number below `count` (1 to 32), all of them equally likely.
    fn one_of(&mut self, number: u32, count: u32) -> u32;

    /// Codes the low `count` (0 to 32) bits of `value`, each equally likely 0 or 1.
    fn plain(&mut self, value: u32, count: u32) -> u32;

    /// Returns whether an encoder has room for `bytes` more; for a decoder, whether all that it read was in its
    /// input.
    fn has_room(&self, bytes: usize) -> bool;

    /// Returns how much of its input is left to a decoder; nothing for an encoder.
    fn left(&self) -> InputLeft {
        InputLeft::NONE
    }

    /// Returns an encoder's state; `None` for a decoder.
    #[cfg(eecvs_dsp)]
    fn parts(&mut self) -> Option<RangeParts<'_>> {
        None
    }
}

/// Sum of the shares of a table's symbols.
pub const SCALE: u32 = 1 << 15;

/// floor(2^16 / n), to save a division.
const SHARES: [u32; 33] = {
    let (mut shares, mut n) = ([1 << 16; 33], 1);
    while n < shares.len() {
        shares[n] = (1 << 16) / n as u32;
        n += 1;
    }
    shares
};

/// Below this the range has too few bits for a decision, and a byte is shifted out.
pub(super) const RANGE_MIN: u32 = 1 << 24;
/// Most plain bits coded at once, so that at least 12 bits of the range remain.
pub(super) const PLAIN_BITS: u32 = 12;

/// Range encoder that writes into a lent buffer.
///
/// Call [`Binary::has_room`] before each write: bytes beyond the buffer are lost.
#[derive(Debug)]
pub struct RangeEncoder<'o> {
    out: &'o mut [u8],
    len: usize,
    low: u32,
    range: u32,
}

/// Most bytes that [`RangeEncoder::finish`] writes.
pub(super) const FINISH_BYTES: usize = 4;

/// An encoder's state, for an assembly walk that keeps it in registers.
#[cfg(eecvs_dsp)]
pub struct RangeParts<'r> {
    pub(super) out: &'r mut [u8],
    pub(super) len: &'r mut usize,
    pub(super) low: &'r mut u32,
    pub(super) range: &'r mut u32,
}

impl<'o> RangeEncoder<'o> {
    /// Starts encoding at the start of `out`.
    #[must_use]
    pub const fn new(out: &'o mut [u8]) -> Self {
        Self {
            out,
            len: 0,
            low: 0,
            range: u32::MAX,
        }
    }

    /// Adds to the low end of the range, and carries into the bytes written.
    #[inline(always)]
    fn add(&mut self, more: u32) {
        let (low, carries) = self.low.overflowing_add(more);
        self.low = low;
        if carries {
            carry(self.out, self.len);
        }
    }

    #[inline(always)]
    fn renew(&mut self) {
        if self.range < RANGE_MIN {
            self.push();
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

    /// Renews the range after a step that takes up to 15 bits off it.
    #[inline(always)]
    fn renew_twice(&mut self) {
        self.renew();
        self.renew();
    }

    #[inline(always)]
    fn decide(&mut self, of_one: u32, bit: bool) {
        let bound = (self.range / ONE) * of_one;
        if bit {
            self.range = bound;
        } else {
            self.add(bound);
            self.range -= bound;
        }
        self.renew();
    }

    /// Completes the number and returns its length in bytes; a decoder reads zeros after them.
    #[must_use]
    pub fn finish(mut self) -> usize {
        // Choose the number in the range with the fewest bytes that are not 0.
        for bits in [24_u32, 16, 8, 0] {
            let mask = (1_u32 << bits) - 1;
            // Rounding up beyond the top gives a carry and zeros.
            let (rounded, carries) = self.low.overflowing_add(mask);
            let rounded = rounded & !mask;
            if rounded.wrapping_sub(self.low) < self.range {
                if carries {
                    carry(self.out, self.len);
                }
                self.low = rounded;
                break;
            }
        }
        for byte in self.low.to_be_bytes() {
            if let Some(place) = self.out.get_mut(self.len) {
                *place = byte;
                self.len += 1;
            }
        }
        let written = self.out.get(..self.len).unwrap_or_default();
        let last = written.iter().rev().take(FINISH_BYTES);
        written.len() - last.take_while(|byte| **byte == 0).count()
    }
}

/// Adds one to the last of the bytes written. It takes only the values that it needs, so that the rest of the
/// encoder's state may stay in registers.
#[cold]
#[inline(never)]
pub(super) fn carry(out: &mut [u8], len: usize) {
    // Ends at the first byte at the latest, as the number is below 1.
    for byte in out.iter_mut().take(len).rev() {
        *byte = byte.wrapping_add(1);
        if *byte != 0 {
            break;
        }
    }
}

impl Binary for RangeEncoder<'_> {
    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    fn bit(&mut self, probability: &mut Probability, bit: bool) -> bool {
        self.decide(probability.of_one(), bit);
        probability.learn(bit);
        bit
    }

    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    fn symbol<const N: usize>(&mut self, table: &mut Symbols<N>, symbol: usize) -> usize {
        let (begin, end) = table.share(symbol);
        self.range /= SCALE;
        self.add(begin * self.range);
        self.range *= end - begin;
        self.renew_twice();
        table.learn(symbol);
        symbol
    }

    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    fn symbol_up_to<const N: usize>(
        &mut self,
        table: &mut Symbols<N>,
        symbol: usize,
        last: usize,
    ) -> usize {
        let (begin, end) = table.share(symbol);
        self.range /= table.share(last).1.max(1);
        self.add(begin * self.range);
        self.range *= end - begin;
        self.renew_twice();
        table.learn(symbol);
        symbol
    }

    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    fn one_of(&mut self, number: u32, count: u32) -> u32 {
        self.range = (self.range >> 16) * SHARES[(count as usize).min(SHARES.len() - 1)];
        self.add(number * self.range);
        self.renew();
        number
    }

    #[cfg_attr(eecvs_dsp, inline(never))]
    #[cfg_attr(not(eecvs_dsp), inline)]
    fn plain(&mut self, value: u32, count: u32) -> u32 {
        let mut left = count;
        while left > 0 {
            let bits = left.min(PLAIN_BITS);
            left -= bits;
            self.range >>= bits;
            self.add(((value >> left) & ((1 << bits) - 1)) * self.range);
            self.renew_twice();
        }
        value
    }

    #[inline(always)]
    fn has_room(&self, bytes: usize) -> bool {
        self.len + FINISH_BYTES + bytes <= self.out.len()
    }

    #[cfg(eecvs_dsp)]
    #[inline(always)]
    fn parts(&mut self) -> Option<RangeParts<'_>> {
        Some(RangeParts {
            out: self.out,
            len: &mut self.len,
            low: &mut self.low,
            range: &mut self.range,
        })
    }
}

/// Range decoder that reads what a [`RangeEncoder`] wrote.
#[derive(Debug, Clone)]
pub struct RangeDecoder<'i> {
    input: &'i [u8],
    /// Number of bytes taken beyond the input's end, which read as zeros.
    beyond: u32,
    /// The number minus the low end of the range.
    code: u32,
    range: u32,
}

impl<'i> RangeDecoder<'i> {
    /// Starts decoding at the start of `input`.
    #[must_use]
    pub fn new(input: &'i [u8]) -> Self {
        let mut decoder = Self {
            input,
            beyond: 0,
            code: 0,
            range: u32::MAX,
        };
        for _ in 0..4 {
            decoder.take();
        }
        decoder
    }

    #[inline(always)]
    fn take(&mut self) {
        let byte = match self.input.split_first() {
            Some((byte, rest)) => {
                self.input = rest;
                *byte
            }
            None => {
                self.beyond = self.beyond.saturating_add(1);
                0
            }
        };
        self.code = (self.code << 8) | u32::from(byte);
    }

    #[inline(always)]
    fn renew(&mut self) {
        while self.range < RANGE_MIN {
            self.range <<= 8;
            self.take();
        }
    }

    #[inline(always)]
    fn decide(&mut self, of_one: u32) -> bool {
        let bound = (self.range / ONE) * of_one;
        let bit = self.code < bound;
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        self.renew();
        bit
    }

    /// Returns whether more was read than was written, so that the last values are not to be trusted.
    #[inline]
    #[must_use]
    pub const fn is_beyond(&self) -> bool {
        // The decoder reads four bytes ahead, all of which `finish` may have left out.
        self.beyond > 4
    }

    /// Returns whether all of the input was read and nothing beyond it.
    #[must_use]
    pub const fn is_spent(&self) -> bool {
        self.input.is_empty() && !self.is_beyond()
    }
}

impl Binary for RangeDecoder<'_> {
    #[inline(always)]
    fn bit(&mut self, probability: &mut Probability, _bit: bool) -> bool {
        let bit = self.decide(probability.of_one());
        probability.learn(bit);
        bit
    }

    #[inline(always)]
    fn symbol<const N: usize>(&mut self, table: &mut Symbols<N>, _symbol: usize) -> usize {
        self.range /= SCALE;
        let symbol = table.find(self.code / self.range);
        let (begin, end) = table.share(symbol);
        // A number that no encoder writes may lie beyond the range.
        self.code = self.code.wrapping_sub(begin * self.range);
        self.range *= end - begin;
        self.renew();
        table.learn(symbol);
        symbol
    }

    #[inline(always)]
    fn symbol_up_to<const N: usize>(
        &mut self,
        table: &mut Symbols<N>,
        _symbol: usize,
        last: usize,
    ) -> usize {
        let all = table.share(last).1.max(1);
        self.range /= all;
        // A number that no encoder writes may lie beyond the range.
        let symbol = table.find((self.code / self.range).min(all - 1));
        let (begin, end) = table.share(symbol);
        self.code = self.code.wrapping_sub(begin * self.range);
        self.range *= end - begin;
        self.renew();
        table.learn(symbol);
        symbol
    }

    #[inline(always)]
    fn one_of(&mut self, _number: u32, count: u32) -> u32 {
        self.range = (self.range >> 16) * SHARES[(count as usize).min(SHARES.len() - 1)];
        let number = (self.code / self.range).min(count.saturating_sub(1));
        self.code = self.code.wrapping_sub(number * self.range);
        self.renew();
        number
    }

    #[inline]
    fn plain(&mut self, _value: u32, count: u32) -> u32 {
        let (mut value, mut left) = (0_u32, count);
        while left > 0 {
            let bits = left.min(PLAIN_BITS);
            left -= bits;
            self.range >>= bits;
            // A number that no encoder writes may lie beyond the range.
            let part = (self.code / self.range).min((1 << bits) - 1);
            self.code = self.code.wrapping_sub(part * self.range);
            value = (value << bits) | part;
            self.renew();
        }
        value
    }

    fn left(&self) -> InputLeft {
        InputLeft {
            bits: 8 * (self.input.len() as i64 - i64::from(self.beyond)),
            range: self.range,
        }
    }

    #[inline(always)]
    fn has_room(&self, _bytes: usize) -> bool {
        !self.is_beyond()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    type Learned = ([Probability; 6], Symbols<17>);

    fn learned() -> Learned {
        let mut table = Symbols::UNSET;
        table.restart();
        ([Probability::EVEN; 6], table)
    }

    #[derive(Debug, Clone, Copy)]
    enum Code {
        Bit(usize, bool),
        Symbol(usize, usize),
        OneOf(u32, u32),
        Plain(u32, u32),
    }

    fn codes() -> impl Strategy<Value = Vec<Code>> {
        let code = prop_oneof![
            (0_usize..4, any::<bool>()).prop_map(|(i, bit)| Code::Bit(i, bit)),
            // Rare ones and rare zeros take the probabilities to their ends.
            (0_usize..2, 0_u32..200).prop_map(|(i, x)| Code::Bit(4 + i, (x == 0) == (i == 0))),
            (0_usize..16, 0_usize..16).prop_map(|(a, b)| Code::Symbol(a.min(b), a.max(b))),
            (1_u32..=32)
                .prop_flat_map(|count| (0..count, Just(count)))
                .prop_map(|(number, count)| Code::OneOf(number, count)),
            (0_u32..=32, any::<u32>()).prop_map(|(bits, value)| Code::Plain(
                value & (u64::from(u32::MAX) >> (32 - bits)) as u32,
                bits
            )),
        ];
        proptest::collection::vec(code, 0..2000)
    }

    fn code(coder: &mut impl Binary, learned: &mut Learned, code: Code) -> Code {
        match code {
            Code::Bit(i, bit) => Code::Bit(i, coder.bit(&mut learned.0[i], bit)),
            Code::Symbol(symbol, 15) => Code::Symbol(coder.symbol(&mut learned.1, symbol), 15),
            Code::Symbol(symbol, last) => {
                Code::Symbol(coder.symbol_up_to(&mut learned.1, symbol, last), last)
            }
            Code::OneOf(number, count) => Code::OneOf(coder.one_of(number, count), count),
            Code::Plain(value, bits) => Code::Plain(coder.plain(value, bits), bits),
        }
    }

    fn blank(code: Code) -> Code {
        match code {
            Code::Bit(i, _) => Code::Bit(i, false),
            Code::Symbol(_, last) => Code::Symbol(0, last),
            Code::OneOf(_, count) => Code::OneOf(0, count),
            Code::Plain(_, bits) => Code::Plain(0, bits),
        }
    }

    fn written(codes: &[Code]) -> Vec<u8> {
        let mut out = vec![0xAA; 8 * codes.len() + 64];
        let mut encoder = RangeEncoder::new(&mut out);
        let mut learned = learned();
        for each in codes {
            code(&mut encoder, &mut learned, *each);
        }
        let bytes = encoder.finish();
        out.truncate(bytes);
        out
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(codes in codes()) {
            let bytes = written(&codes);
            let mut decoder = RangeDecoder::new(&bytes);
            let mut learned = learned();
            for each in &codes {
                let read = code(&mut decoder, &mut learned, blank(*each));
                prop_assert_eq!(std::format!("{read:?}"), std::format!("{each:?}"));
            }
            prop_assert!(decoder.is_spent());
        }

        #[test]
        fn any_bytes_are_read_without_a_panic(bytes in any::<Vec<u8>>(), codes in codes()) {
            let mut decoder = RangeDecoder::new(&bytes);
            let mut learned = learned();
            for each in codes {
                code(&mut decoder, &mut learned, each);
            }
        }

        #[test]
        fn a_probability_stays_off_its_ends(bits in proptest::collection::vec(any::<bool>(), 0..64), last: bool) {
            let mut learned = Probability::EVEN;
            for bit in bits {
                learned.learn(bit);
            }
            for _ in 0..5000 {
                learned.learn(last);
                prop_assert!((40..=ONE - 40).contains(&learned.of_one()));
            }
        }
    }

    /// All ones, then a carry: bytes of 255 wrap around.
    #[test]
    fn a_carry_runs_through() {
        let codes: Vec<_> = (0..64)
            .map(|_| Code::Plain((1 << 12) - 1, 12))
            .chain((0..64).map(|i| Code::Bit(0, i % 3 == 0)))
            .collect();
        let bytes = written(&codes);
        let mut decoder = RangeDecoder::new(&bytes);
        let mut learned = learned();
        for each in &codes {
            let read = code(&mut decoder, &mut learned, blank(*each));
            assert_eq!(std::format!("{read:?}"), std::format!("{each:?}"));
        }
    }

    /// The module's promise on a source of known entropy: with 1 one in 16, 0.337 bits each, plus the cost of a
    /// probability that follows every decision.
    #[test]
    fn the_cost_is_the_entropy() {
        let codes: Vec<_> = (0..100_000_u32)
            .map(|i| Code::Bit(0, i.wrapping_mul(2_654_435_761) >> 28 == 0))
            .collect();
        let bits = 8.0 * written(&codes).len() as f64 / codes.len() as f64;
        assert!((0.337..0.355).contains(&bits), "{bits}");
    }

    /// After the input's end four bytes read as zeros; then the decoder is beyond it.
    #[test]
    fn an_end_is_found() {
        let mut decoder = RangeDecoder::new(&[]);
        assert!(decoder.is_spent());
        let mut learned = Probability::EVEN;
        let mut decisions = 0;
        while !decoder.is_beyond() {
            decoder.bit(&mut learned, false);
            decisions += 1;
            assert!(decisions < 4000);
        }
    }
}
