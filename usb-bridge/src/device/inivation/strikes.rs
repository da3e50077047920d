//! Detects misaligned words by the number of words that no device sends.
//!
//! Words read from the middle of other words are often invalid: in a misaligned stream of any model here at least
//! every third word has an unknown code, an address outside the sensor, or a time that runs back. In an aligned
//! stream no word does, except damaged ones.

use super::clock::Clock;

/// Length of the window in which strikes add up, in words.
const WINDOW_WORDS: u64 = 32;

/// Number of strikes in a window that shows misalignment.
const LIMIT: u32 = 8;

/// Invalid words of the latest window.
#[derive(Debug, Clone, Copy)]
pub struct Strikes {
    /// Number of the window's first invalid word.
    first: u64,
    count: u32,
    /// The clock before that word; restoring it undoes what invalid words did to time.
    clock: Clock,
}

impl Strikes {
    /// Starts without strikes, at the time of `clock`.
    #[must_use]
    pub const fn new(clock: Clock) -> Self {
        Self {
            first: 0,
            count: 0,
            clock,
        }
    }

    /// Counts word number `word` as a strike; `clock` is the clock before that word. When the limit is reached,
    /// returns the clock from before the window's first strike.
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
