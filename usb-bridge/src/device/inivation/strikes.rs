//! Misaligned words, seen by how many of them no device sends.
//!
//! Words that began in the middle of a word are strange often: of a misaligned stream of any model
//! here at least every third one has an unknown code, an address outside, or a time that runs back.
//! Of an aligned one none is, but for the words that were damaged.

use super::clock::Clock;

/// Words in which strikes add up.
const WINDOW_WORDS: u64 = 32;

/// Strikes of a window that tell misalignment.
const LIMIT: u32 = 8;

/// Strange words of the latest window.
#[derive(Debug, Clone, Copy)]
pub struct Strikes {
    /// Number of the window's first strange word.
    first: u64,
    count: u32,
    /// The clock before that word: what strange words make of time is undone.
    clock: Clock,
}

impl Strikes {
    /// None so far.
    #[must_use]
    pub const fn new(clock: Clock) -> Self {
        Self {
            first: 0,
            count: 0,
            clock,
        }
    }

    /// Counts word number `word`, before which the clock was as `clock` is; with the last one that
    /// was needed, returns the clock from before the first.
    #[cold]
    pub fn add(&mut self, word: u64, clock: &Clock) -> Option<Clock> {
        if self.count == 0 || word.saturating_sub(self.first) >= WINDOW_WORDS {
            *self = Self {
                first: word,
                count: 0,
                clock: *clock,
            };
        }
        self.count += 1;
        (self.count >= LIMIT).then(|| {
            self.count = 0;
            self.clock
        })
    }
}
