//! Runs of words of a few frequent types, decoded without a branch per word.
//!
//! The order of a camera's time, row and column words depends on the scene and is unpredictable, and a
//! mispredicted branch costs more than decoding many words. A decoder therefore first determines which words of a
//! run are plain, several per instruction, and then decodes these one by one: every word writes an event to the
//! next free slot, but only a word that is an event advances the slot. Other words take the path with branches,
//! where everything is checked and counted.

use event_types::{Event, Polarity};

/// Number of words in a run: few enough for the words and their events to stay in the first-level cache.
pub const RUN_WORDS: usize = 256;

/// Placeholder in a slot to which no event has been written yet.
pub const NO_EVENT: Event = Event {
    t_us: 0,
    x: 0,
    y: 0,
    polarity: Polarity::Off,
};

/// Number of flags that are tested together.
const TOGETHER: usize = 16;

/// Returns the number of plain words before the first that is not plain.
pub fn plain_words(is_plain: &[bool]) -> usize {
    let (chunks, _) = is_plain.as_chunks::<TOGETHER>();
    let all_plain = |chunk: &&[bool; TOGETHER]| chunk.iter().fold(true, |all, plain| all & plain);
    let whole = chunks.iter().take_while(all_plain).count() * TOGETHER;
    let rest = is_plain.get(whole..).unwrap_or_default();
    whole + rest.iter().take_while(|plain| **plain).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_words_end_before_the_first_other() {
        for length in 0..3 * TOGETHER {
            let mut plain = vec![true; length];
            assert_eq!(plain_words(&plain), length);
            for other in (0..length).rev() {
                plain[other] = false;
                assert_eq!(plain_words(&plain), other);
            }
        }
    }
}
