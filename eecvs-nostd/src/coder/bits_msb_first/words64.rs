//! Writer for targets with 64-bit registers: all pending bits are stored after each code, without a branch.

use super::{CODE_BITS, Code};

/// Writes bits into a lent buffer.
///
/// Bits that do not fit are lost: call [`Self::has_words`] first.
#[derive(Debug)]
pub struct BigWriter<'o> {
    out: &'o mut [u8],
    state: Position,
}

/// A position in a [`BigWriter`]'s output to which it can rewind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Number of complete bytes.
    bytes: usize,
    /// Pending bits after those bytes, from the top.
    pending: u64,
    /// Number of pending bits, up to 7.
    bits: u32,
}

impl<'o> BigWriter<'o> {
    /// Starts writing at the start of `out`.
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

    /// Writes a code of `bits` (1 to [`CODE_BITS`]) bits; `code` has to be below 2^`bits`.
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

    /// Runs `write` on a copy of this writer and takes over the copy's state. The copy's state is in memory, so
    /// that this writer's can stay in registers.
    #[inline(always)]
    pub fn aside(&mut self, write: impl FnOnce(&mut BigWriter<'_>)) {
        let mut copy = BigWriter {
            out: self.out,
            state: self.state,
        };
        write(&mut copy);
        self.state = copy.state;
    }

    /// Returns whether `words` more 32-bit words fit beyond those that are complete.
    #[inline(always)]
    #[must_use]
    pub const fn has_words(&self, words: usize) -> bool {
        self.state.bytes / 4 + words < self.out.len() / 4
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
