//! Runs of words of a few frequent types, decoded without a branch for each word.
//!
//! A camera's words of time, row and column follow each other as the scene has it, which no processor
//! foretells; a mispredicted branch takes longer than many words. So a decoder tells first which words of a run
//! are plain, several in one instruction, then takes these one by one: each writes an event where the next one
//! belongs, and only a word that is one moves that place on. What is not plain goes the way with branches, where
//! everything is checked and counted.

use event_types::{Event, Polarity};

/// Words of a run: they and their events are in the processor's first cache.
pub const RUN_WORDS: usize = 256;

/// What stands where no event has been written yet.
pub const NO_EVENT: Event = Event {
    t_us: 0,
    x: 0,
    y: 0,
    polarity: Polarity::Off,
};

/// Flags that are looked at together.
const TOGETHER: usize = 16;

/// How many words are plain, up to the first that is not.
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
