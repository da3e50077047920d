//! With a register of 64 bits: what is there goes out at once, whole bytes or not, without a branch.

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
