//! A limit on the work of looking for messages inside damaged ones.

/// How often the bytes of a stream may be checked again.
const TIMES: u64 = 4;

/// Limits how many bytes of damaged messages are searched for other messages: four times the longest message, plus
/// four times the bytes of the stream so far.
///
/// The checksum of a damaged message was computed over all of its bytes, and the search goes on behind its first one.
/// Only messages that were nested on purpose reach the limit; without it, their checksums would take the square of
/// their length.
#[derive(Debug, Clone, Copy)]
pub struct SearchBudget {
    longest: u64,
    searched: u64,
    checked: u64,
}

impl SearchBudget {
    /// Creates the budget of a stream whose longest message has this many bytes.
    #[must_use]
    pub const fn new(longest: usize) -> Self {
        Self {
            longest: longest as u64,
            searched: 0,
            checked: 0,
        }
    }

    /// Returns whether a damaged message of `bytes` bytes may be searched, and counts it if so; otherwise it is to be
    /// skipped as a whole. It begins after `used` bytes of the stream.
    pub const fn allows(&mut self, bytes: u64, used: u64) -> bool {
        self.checked = self.checked.saturating_add(bytes);
        let searched = self.searched.saturating_add(bytes);
        let is_allowed = searched <= TIMES.saturating_mul(self.longest.saturating_add(used));
        if is_allowed {
            self.searched = searched;
        }
        is_allowed
    }

    /// Returns the bytes of all damaged messages, searched or not: the work of their checksums.
    #[must_use]
    pub const fn checked(&self) -> u64 {
        self.checked
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_work_grows_with_the_stream_and_not_with_its_square() {
        let mut budget = SearchBudget::new(1000);
        let mut used = 0_u64;
        while used < 1_000_000 {
            used += if budget.allows(1000, used) { 1 } else { 1000 };
        }
        let checked = budget.checked();
        assert!(
            (4 * used..6 * used).contains(&checked),
            "{checked} of {used}"
        );
        let mut one = SearchBudget::new(1000);
        assert!((0..4).all(|_| one.allows(1000, 0)) && !one.allows(1, 0));
    }
}
