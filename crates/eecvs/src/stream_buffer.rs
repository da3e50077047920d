//! Received bytes in which messages are looked for.

use crate::search_budget::SearchBudget;

/// The bytes of a stream from the first one that is not used up, and counts of those that belonged to no message.
/// Where messages are taken as soon as they are whole, it holds up to twice the longest one and the bytes of one push.
///
/// Copies and checksums take work by the bytes of the stream, however they arrive and whatever they are: the rest is
/// moved only when it is no longer than what is used up, and damaged messages are searched within a [`SearchBudget`].
#[derive(Debug)]
pub struct StreamBuffer {
    bytes: Vec<u8>,
    /// Bytes of `bytes`, and of the stream, that are used up.
    start: usize,
    used: u64,
    budget: SearchBudget,
    damaged_bytes: u64,
    damaged_runs: u64,
    in_damage: bool,
}

impl StreamBuffer {
    /// Creates the buffer of a stream whose longest message has this many bytes.
    #[must_use]
    pub const fn new(longest: usize) -> Self {
        Self {
            bytes: Vec::new(),
            start: 0,
            used: 0,
            budget: SearchBudget::new(longest),
            damaged_bytes: 0,
            damaged_runs: 0,
            in_damage: false,
        }
    }

    /// Sets another length of the longest message, and begins a new budget.
    pub const fn limit(&mut self, longest: usize) {
        self.budget = SearchBudget::new(longest);
    }

    /// Appends received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.start >= self.bytes.len() - self.start {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// Returns the bytes that are not used up.
    #[must_use]
    pub fn rest(&self) -> &[u8] {
        self.bytes.get(self.start..).unwrap_or_default()
    }

    /// Uses up the `bytes` bytes of a message, which [`StreamBuffer::last`] still returns until the next push.
    pub const fn take(&mut self, bytes: usize) {
        self.in_damage = false;
        self.advance(bytes);
    }

    /// Returns the last `bytes` bytes that were used up.
    #[must_use]
    pub fn last(&self, bytes: usize) -> &[u8] {
        let start = self.start.saturating_sub(bytes);
        self.bytes.get(start..self.start).unwrap_or_default()
    }

    /// Returns the number of bytes of the stream that are used up.
    #[must_use]
    pub const fn used(&self) -> u64 {
        self.used
    }

    /// Uses up `skip` bytes that belong to no message, after a checksum over `checked` bytes has shown it: all of those
    /// if the budget allows no search among them.
    pub fn damage(&mut self, skip: usize, checked: usize) {
        let is_allowed = self.budget.allows(checked as u64, self.used);
        let bytes = if is_allowed { skip } else { checked.max(skip) };
        self.damaged_runs += u64::from(!self.in_damage);
        self.in_damage = true;
        self.damaged_bytes += bytes as u64;
        self.advance(bytes);
    }

    /// Creates the buffer of the rest of a stream, from byte `used` on.
    #[must_use]
    pub const fn from_byte(longest: usize, used: u64) -> Self {
        let mut buffer = Self::new(longest);
        buffer.used = used;
        buffer
    }

    /// Removes and returns the bytes that are not used up.
    #[must_use]
    pub fn take_rest(&mut self) -> Vec<u8> {
        let rest = self.bytes.split_off(self.start);
        (self.bytes, self.start) = (Vec::new(), 0);
        rest
    }

    /// Returns the number of bytes that belonged to no message, and the number of runs of such bytes.
    #[must_use]
    pub const fn damaged(&self) -> (u64, u64) {
        (self.damaged_bytes, self.damaged_runs)
    }

    /// Returns the bytes of all damaged messages: the work of their checksums.
    #[must_use]
    pub const fn checked_bytes(&self) -> u64 {
        self.budget.checked()
    }

    const fn advance(&mut self, bytes: usize) {
        self.start += bytes;
        self.used += bytes as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_kept_until_they_are_used_up() {
        let mut buffer = StreamBuffer::new(8);
        buffer.push(b"abc");
        buffer.take(2);
        assert_eq!((buffer.rest(), buffer.last(2)), (&b"c"[..], &b"ab"[..]));
        buffer.push(b"defgh");
        buffer.damage(1, 0);
        buffer.damage(2, 0);
        assert_eq!((buffer.rest(), buffer.damaged()), (&b"fgh"[..], (3, 1)));
        buffer.take(1);
        buffer.damage(1, 0);
        assert_eq!(buffer.damaged(), (4, 2));
        assert_eq!(buffer.take_rest(), b"h");
        assert!(buffer.rest().is_empty());
    }

    #[test]
    fn a_message_is_skipped_whole_where_the_budget_allows_no_search() {
        let mut buffer = StreamBuffer::new(1000);
        let stream = vec![0; 1000];
        let mut looks = 0;
        for _ in 0..100 {
            buffer.push(&stream);
            while buffer.rest().len() >= 1000 {
                buffer.damage(1, 1000);
                looks += 1;
            }
        }
        // Each look checks 1,000 bytes: four times the stream and the longest message, and the rest once.
        assert!((404..=505).contains(&looks), "{looks}");
    }
}
