//! Learned frequencies of a few symbols, so that one step of the range coder codes one of many symbols.
//!
//! Frequencies stay fixed for a block of up to `BLOCK` symbols, then move towards those of the block: a symbol
//! costs one count, and a block one pass over the table.

use super::{SCALE, move_shares};

/// Length of a block once the table has seen enough symbols.
const BLOCK: u8 = 32;
/// Length of the first block.
const BLOCK_FIRST: u8 = 4;
/// Most symbols remembered. At the end of a block the frequencies move by `block / seen` of the way.
const SEEN_MAX: u16 = 1024;

/// A table of N - 1 symbols.
#[derive(Debug, Clone)]
#[repr(C)]
pub struct Symbols<const N: usize> {
    /// Begin of each symbol's share of [`SCALE`]; the last element is the end of all.
    pub(super) starts: [u16; N],
    /// How often each symbol came in the current block.
    pub(super) counts: [u8; N],
    /// Symbols left of the current block, and symbols seen before it.
    left: u8,
    seen: u16,
}

impl<const N: usize> Symbols<N> {
    /// All zero, for memory in `.bss`; call [`Self::restart`] before use.
    pub const UNSET: Self = Self {
        starts: [0; N],
        counts: [0; N],
        left: 0,
        seen: 0,
    };

    /// Offsets of the counts and of what is left of the block, for assembly.
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(in crate::coder) const COUNTS_AT: usize = core::mem::offset_of!(Self, counts);
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(in crate::coder) const LEFT_AT: usize = core::mem::offset_of!(Self, left);

    /// Whether assembly may move the shares: the number of symbols is a multiple of four, or one less, and the rate
    /// is below 1.
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(super) const IS_MOVED_BY_FOURS: bool = N >= 8 && N % 4 <= 1;

    pub(super) const COUNT: u32 = {
        assert!(N >= 2 && N <= 256);
        N as u32 - 1
    };

    /// Forgets what was learned: makes all symbols equally likely.
    pub fn restart(&mut self) {
        let step = SCALE / Self::COUNT;
        for (start, at) in self.starts.iter_mut().zip(0..) {
            *start = (step * at) as u16;
        }
        self.end();
        self.counts = [0; N];
        self.left = BLOCK_FIRST;
        // The weight of this start: an eighth of a symbol each.
        self.seen = N as u16 / 8;
    }

    pub(super) fn end(&mut self) {
        if let Some(end) = self.starts.last_mut() {
            *end = SCALE as u16;
        }
    }

    /// Returns begin and end of a symbol's share, which is never empty. A symbol beyond the last is taken as the
    /// last.
    #[inline(always)]
    #[must_use]
    pub fn share(&self, symbol: usize) -> (u32, u32) {
        let symbol = symbol.min(N - 2);
        (
            u32::from(self.starts[symbol]),
            u32::from(self.starts[symbol + 1]),
        )
    }

    /// Returns the symbol whose share holds `place`, which is below [`SCALE`].
    #[inline(always)]
    #[must_use]
    pub fn find(&self, place: u32) -> usize {
        let (mut low, mut high) = (0, N - 1);
        while high - low > 1 {
            let middle = (low + high) / 2;
            if u32::from(self.starts[middle]) <= place {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// Counts a symbol; after the last one of a block, moves the frequencies.
    #[inline(always)]
    pub fn learn(&mut self, symbol: usize) {
        // A block is too short to overflow a count.
        let count = &mut self.counts[symbol.min(N - 2)];
        *count = count.wrapping_add(1);
        self.left = self.left.wrapping_sub(1);
        if self.left == 0 {
            self.renew();
        }
    }

    /// Moves the frequencies towards those of the block; each share stays at least 1.
    #[inline(never)]
    pub(in crate::coder) fn renew(&mut self) {
        // The block's length, a power of two, follows from what had been seen before it.
        let block = block(self.seen.saturating_sub(N as u16 / 8));
        let seen = (self.seen + u16::from(block)).min(SEEN_MAX);
        let rate = (u32::from(block) << 16) / u32::from(seen.max(1));
        // What one count stands for: all of the scale but one per symbol, divided by the block.
        let each = (SCALE - Self::COUNT) / u32::from(block);
        move_shares(self, each, rate >> 1);
        self.seen = seen;
        self.left = self::block(seen - N as u16 / 8);
    }
}

/// Returns the length, a power of two, of the block that begins after `seen` symbols.
const fn block(seen: u16) -> u8 {
    if seen < 2 * BLOCK_FIRST as u16 {
        BLOCK_FIRST
    } else if seen < 4 * BLOCK_FIRST as u16 {
        2 * BLOCK_FIRST
    } else if seen < BLOCK as u16 * 2 {
        BLOCK / 2
    } else {
        BLOCK
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn is_sound<const N: usize>(table: &Symbols<N>) -> bool {
        let shares = (0..N - 1).map(|symbol| table.share(symbol));
        let mut at = 0;
        for (symbol, (begin, end)) in shares.enumerate() {
            if begin != at || end <= begin {
                return false;
            }
            if table.find(begin) != symbol || table.find(end - 1) != symbol {
                return false;
            }
            at = end;
        }
        at == SCALE
    }

    proptest! {
        #[test]
        fn shares_are_whole_and_not_empty(
            symbols in proptest::collection::vec(prop_oneof![0_usize..63, Just(5), Just(62)], 0..3000),
        ) {
            let (mut wide, mut narrow) = (Symbols::<64>::UNSET, Symbols::<2>::UNSET);
            wide.restart();
            narrow.restart();
            prop_assert!(is_sound(&wide) && is_sound(&narrow));
            for symbol in symbols {
                wide.learn(symbol);
                narrow.learn(0);
                prop_assert!(is_sound(&wide) && is_sound(&narrow));
            }
        }
    }

    /// A symbol that always comes gets nearly the whole scale, and loses it again.
    #[test]
    fn frequencies_follow() {
        let mut table = Symbols::<17>::UNSET;
        table.restart();
        for symbol in [3, 9] {
            for _ in 0..5000 {
                table.learn(symbol);
            }
            let (begin, end) = table.share(symbol);
            assert!(end - begin > SCALE - SCALE / 32, "{}", end - begin);
        }
    }
}
