//! Adaptive probabilities that learn fast at first.

use zerocopy::FromZeros;

use super::range::BitCoder;

/// The probability of a one in the upper 22 bits; below them how often it was learned from, up to a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, FromZeros)]
pub struct Counter(u32);

/// Number of decisions after which a single counter learns no slower.
pub(super) const LIMIT: u32 = 64;

/// Bits of the count.
const COUNT_BITS: u32 = 10;
const COUNT_MASK: u32 = (1 << COUNT_BITS) - 1;

/// Part of the way to a certain outcome that the n-th decision moves a probability, in 1/65536: 1 / (n + 3).
const RATES: [u16; 1 << COUNT_BITS] = {
    let mut rates = [0; 1 << COUNT_BITS];
    let mut n = 0;
    while n < rates.len() {
        rates[n] = (655_360 / (10 * n as u32 + 30)) as u16;
        n += 1;
    }
    rates
};

/// Probabilities stay this far from 0 and 1, in 1/65536.
pub(super) const NEAREST_P16: u32 = 24;
const NEAREST: u32 = NEAREST_P16 << 16;

impl Counter {
    /// Nothing is known.
    pub(super) const EVEN: Self = Self(1 << 31);
    /// All zero, for memory in `.bss`.
    pub const UNSET: Self = Self(0);

    /// The probability of a one in 1/65536.
    #[inline(always)]
    pub(super) const fn p16(self) -> u32 {
        self.0 >> 16
    }

    /// The probability of a one in 1/4096.
    #[inline(always)]
    pub(super) const fn p12(self) -> u32 {
        self.0 >> 20
    }

    /// How often it was learned from, up to the limit.
    #[inline(always)]
    pub(super) const fn count(self) -> u32 {
        self.0 & COUNT_MASK
    }

    /// Moves towards an outcome; `limit` is the count at which it stops to slow down.
    #[inline(always)]
    pub(super) fn learn(&mut self, bit: bool, limit: u32) {
        let rate = i64::from(RATES[self.count() as usize]);
        let target = if bit { u32::MAX - NEAREST } else { NEAREST };
        // The count's bits hardly matter in the distance.
        let step = ((i64::from(target) - i64::from(self.0)) * rate) >> 16;
        let slower = u32::from(self.count() < limit);
        self.0 = self.0.wrapping_add(step as u32 & !COUNT_MASK) + slower;
    }

    /// Codes a decision by this counter alone.
    #[inline(always)]
    pub(super) fn code<C: BitCoder>(&mut self, coder: &mut C, bit: bool) -> bool {
        let bit = coder.bit(self.p16(), bit);
        self.learn(bit, LIMIT);
        bit
    }
}

/// Codes a value of `bits` bits from the top one on; the bits above decide which counter codes the next. `N` is a power
/// of two of more than `bits` bits.
#[inline(always)]
pub(super) fn code_value<C: BitCoder, const N: usize>(
    coder: &mut C,
    counters: &mut [Counter; N],
    bits: u32,
    value: u32,
) -> u32 {
    let mut node = 1_usize;
    for i in (0..bits).rev() {
        let bit = counters[node & (N - 1)].code(coder, value >> i & 1 == 1);
        node = node << 1 | usize::from(bit);
    }
    node as u32 & ((1 << bits) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the range coder and the tables of the mixed efforts rely on.
    #[test]
    fn probabilities_stay_within_their_bounds() {
        for outcome in [false, true] {
            let mut counter = Counter::EVEN;
            for n in 0..100_000_u32 {
                counter.learn(outcome, 120);
                assert!((1..65536).contains(&counter.p16()), "{}", counter.p16());
                assert_eq!(counter.count(), (n + 1).min(120));
            }
            let far = if outcome {
                65536 - counter.p16()
            } else {
                counter.p16()
            };
            assert!((20..200).contains(&far), "{far}");
        }
    }
}
