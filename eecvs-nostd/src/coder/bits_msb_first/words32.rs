//! Writer for targets with 32-bit registers: a word is stored once it is complete.

use super::{CODE_BITS, Code};

/// Writes bits into a lent buffer, of which up to three bytes at the end stay unused.
///
/// Bits that do not fit are lost: call [`Self::has_words`] first.
#[derive(Debug)]
#[repr(C)]
pub struct BigWriter<'o> {
    pub(crate) state: Position,
    pub(crate) words: &'o mut [[u8; 4]],
}

/// A position in a [`BigWriter`]'s output to which it can rewind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub struct Position {
    /// Pending bits of the next word, from the top.
    pub(crate) pending: u32,
    /// Number of bits that the next word still has room for: 1 to 32.
    pub(crate) free: u32,
    /// Number of complete words.
    pub(crate) words: usize,
}

impl<'o> BigWriter<'o> {
    /// Starts writing at the start of `out`.
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

    /// Writes a code of `bits` (1 to [`CODE_BITS`]) bits; `code` has to be below 2^`bits`.
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

    /// Writes a code that completes a word; its last `beyond` bits (0 to 31) begin the next word.
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

    /// Runs `write` on a copy of this writer and takes over the copy's state. The copy's state is in memory, so
    /// that this writer's can stay in registers.
    #[inline(always)]
    pub fn aside(&mut self, write: impl FnOnce(&mut BigWriter<'_>)) {
        let mut copy = BigWriter {
            words: self.words,
            state: self.state,
        };
        write(&mut copy);
        self.state = copy.state;
    }

    /// Returns whether `words` more 32-bit words fit beyond those that are complete.
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
    #[inline(always)]
    pub const fn rewind(&mut self, position: Position) {
        self.state = position;
    }

    /// Fills the last byte with zeros and returns the number of bytes written.
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
