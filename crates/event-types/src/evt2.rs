//! EVT 2.0: conversion between events and the 32-bit little-endian words that Prophesee's sensors send.
//!
//! | bits 31..28 | 27..22 | 21..11 | 10..0 |
//! |---|---|---|---|
//! | 0 `CD_OFF`, 1 `CD_ON` | time bits 5..0 | x | y |
//! | 8 `TIME_HIGH` | time bits 33..6 (28 bits) ||
//! | others | triggers, padding, vendor words: not events ||

use crate::{Event, Polarity};

const CD_ON: u32 = 1;
/// Every word below this value is an event, because `CD_OFF` and `CD_ON` are the two lowest types.
const EVENTS_END: u32 = (CD_ON + 1) << KIND_SHIFT;
/// Mask of the bits that are 0 in every event word; every other word has at least one of them set.
pub const NO_EVENT: u32 = !(EVENTS_END - 1);
const _: () = assert!(EVENTS_END.is_power_of_two());
/// Lowest bit of a word's type; an event's type is its polarity (0 `CD_OFF`, 1 `CD_ON`).
pub const KIND_SHIFT: u32 = 28;
/// Lowest bit of the time bits in an event word.
pub const LOW_SHIFT: u32 = 22;
/// Lowest bit of x in an event word.
pub const X_SHIFT: u32 = 11;
/// Width of x, and of y, in bits.
pub const SIDE_BITS: u32 = 11;
/// Mask of y in an event word.
pub const SIDE_MASK: u32 = (1 << SIDE_BITS) - 1;
const TIME_HIGH: u32 = 8;
/// Number of time bits in an event word.
pub const LOW_BITS: u32 = 6;
/// Mask of the time bits in a `TIME_HIGH` word.
const HIGH_MASK: u32 = (1 << 28) - 1;
/// Period of the format's time counter: 2^34 us, or 4.8 hours.
const PERIOD_US: u64 = 1 << 34;
/// Time span that one `TIME_HIGH` covers, in microseconds.
pub const SPAN_US: u32 = 1 << LOW_BITS;

/// What [`Evt2Decoder::decode`] found in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Word {
    /// The word is an event.
    Event(Event),
    /// The word is a `TIME_HIGH`; the decoder has stored its time.
    Time,
    /// The word is an event that came before the first `TIME_HIGH`, so that its time is unknown.
    Untimed,
    /// The word has another type.
    Other,
}

/// Returns whether a word is an event.
#[inline]
#[must_use]
pub const fn is_event(word: u32) -> bool {
    word < EVENTS_END
}

/// Returns whether a word is a `TIME_HIGH`.
#[inline]
#[must_use]
pub const fn is_time(word: u32) -> bool {
    word >> KIND_SHIFT == TIME_HIGH
}

/// A decoder of EVT 2.0 words, which keeps the time from word to word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Evt2Decoder {
    /// Time of the current `TIME_HIGH` in microseconds, including the base and all wraps.
    time_us: u64,
    /// Time bits of the current `TIME_HIGH`; `None` before the first.
    high: Option<u32>,
}

impl Evt2Decoder {
    /// Returns a decoder that adds `base_us` to the format's times.
    #[inline]
    #[must_use]
    pub const fn new(base_us: u64) -> Self {
        Self {
            time_us: base_us,
            high: None,
        }
    }

    /// Returns whether a `TIME_HIGH` has been decoded, so that events have a time.
    #[inline]
    #[must_use]
    pub const fn has_time(&self) -> bool {
        self.high.is_some()
    }

    /// Returns the time bits of the current `TIME_HIGH` and its time in microseconds, including the base and all
    /// wraps; `None` before the first.
    #[inline]
    #[must_use]
    pub const fn time_high(&self) -> Option<(u32, u64)> {
        match self.high {
            Some(high) => Some((high, self.time_us)),
            None => None,
        }
    }

    /// Returns the time of the current `TIME_HIGH` in microseconds, to which an event word adds less than
    /// [`SPAN_US`]; `None` before the first.
    #[inline]
    #[must_use]
    pub const fn span_us(&self) -> Option<u64> {
        match self.high {
            Some(_) => Some(self.time_us),
            None => None,
        }
    }

    /// Returns the current `TIME_HIGH` as a word; before the first, the word for time 0.
    #[inline]
    #[must_use]
    pub fn time_word(&self) -> u32 {
        (TIME_HIGH << KIND_SHIFT) | self.high.unwrap_or(0)
    }

    /// Returns the word of the latest `TIME_HIGH` that is at most `ahead_us` after the current one and does not
    /// wrap.
    #[inline]
    #[must_use]
    pub fn time_word_after(&self, ahead_us: u32) -> u32 {
        let last = (TIME_HIGH << KIND_SHIFT) | HIGH_MASK;
        last.min(self.time_word() + (ahead_us >> LOW_BITS))
    }

    /// Moves to the `TIME_HIGH` in `word`, which must lie between [`Self::time_word`] and a
    /// [`Self::time_word_after`].
    #[inline]
    pub fn step_to_word(&mut self, word: u32) {
        let step_us = time_step_us(self.time_word(), word);
        self.high = Some(word & HIGH_MASK);
        self.time_us = self.time_us.wrapping_add(u64::from(step_us));
    }

    /// Decodes the next word.
    ///
    /// A `TIME_HIGH` that falls by at least half of its range has wrapped. One that rises by more than 255/256 of
    /// its range belongs to the period before the last wrap, since events are not always in order. Every other
    /// step is taken as it is.
    #[inline]
    pub fn decode(&mut self, word: u32) -> Word {
        let kind = word >> KIND_SHIFT;
        if word < EVENTS_END {
            if self.high.is_none() {
                return Word::Untimed;
            }
            return Word::Event(Event {
                t_us: self.time_us.wrapping_add(u64::from(low_us(word))),
                x: ((word >> X_SHIFT) & SIDE_MASK) as u16,
                y: (word & SIDE_MASK) as u16,
                polarity: Polarity::from_bool(kind == CD_ON),
            });
        }
        if kind != TIME_HIGH {
            return Word::Other;
        }
        self.step_to(word & HIGH_MASK);
        Word::Time
    }

    /// Stores the time bits of a `TIME_HIGH`.
    #[inline]
    fn step_to(&mut self, high: u32) {
        let now_us = u64::from(high) << LOW_BITS;
        let before = self.high.replace(high);
        let before_us = u64::from(before.unwrap_or(0)) << LOW_BITS;
        // Time at which the format's time counter was last 0.
        let mut zero_us = self.time_us.wrapping_sub(before_us);
        if before.is_some() {
            if before_us >= now_us + PERIOD_US / 2 {
                zero_us = zero_us.wrapping_add(PERIOD_US);
            } else if now_us > before_us + (PERIOD_US - PERIOD_US / 256) && zero_us >= PERIOD_US {
                zero_us -= PERIOD_US;
            }
        }
        self.time_us = zero_us.wrapping_add(now_us);
    }
}

/// Returns the microseconds from one `TIME_HIGH` word to a later one; the step must be below 2^32 us.
#[inline]
#[must_use]
pub const fn time_step_us(from: u32, to: u32) -> u32 {
    (to - from) << LOW_BITS
}

/// Returns the microseconds, below [`SPAN_US`], that an event word adds to its `TIME_HIGH`.
#[inline]
#[must_use]
pub const fn low_us(word: u32) -> u32 {
    (word >> LOW_SHIFT) & (SPAN_US - 1)
}

/// An encoder of events as EVT 2.0 words, which inserts the `TIME_HIGH` words that they need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Evt2Encoder {
    base_us: u64,
    /// A copy of the receiver's decoder: an event that it would not decode correctly is refused.
    decoder: Evt2Decoder,
    /// Whether the next event gets a `TIME_HIGH` even if none is due.
    restates: bool,
}

impl Evt2Encoder {
    /// Returns an encoder of times from `base_us` on.
    #[inline]
    #[must_use]
    pub const fn new(base_us: u64) -> Self {
        Self {
            base_us,
            decoder: Evt2Decoder::new(base_us),
            restates: false,
        }
    }

    /// Makes the next event start with a `TIME_HIGH` even if none is due: a packet must not depend on an earlier
    /// one, which may be lost.
    #[inline]
    pub const fn restate_time(&mut self) {
        self.restates = true;
    }

    /// Returns the `TIME_HIGH` to send first, if one is due, and the event's word.
    ///
    /// Returns `None` for an event that the format cannot hold: one before the base, one outside 2,048 x 2,048
    /// pixels, or one whose step in time is ambiguous under the 4.8-hour wrap. The encoder's state is then
    /// unchanged.
    #[inline]
    pub fn encode(&mut self, event: Event) -> Option<(Option<u32>, u32)> {
        let time_us = event.t_us.checked_sub(self.base_us)?;
        let high = (time_us >> LOW_BITS) as u32 & HIGH_MASK;
        let is_due = self.restates || self.decoder.high != Some(high);
        let due = is_due.then_some((TIME_HIGH << KIND_SHIFT) | high);
        let low = time_us as u32 & ((1 << LOW_BITS) - 1);
        let word = ((event.polarity as u32) << KIND_SHIFT)
            | (low << LOW_SHIFT)
            | ((u32::from(event.x) & SIDE_MASK) << X_SHIFT)
            | (u32::from(event.y) & SIDE_MASK);
        let mut decoder = self.decoder;
        if let Some(due) = due {
            decoder.decode(due);
        }
        if decoder.decode(word) != Word::Event(event) {
            return None;
        }
        self.decoder = decoder;
        self.restates = false;
        Some((due, word))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(t_us: u64) -> Event {
        Event {
            t_us,
            x: 2047,
            y: 5,
            polarity: Polarity::On,
        }
    }

    #[test]
    fn words_are_those_of_the_format() {
        let mut encoder = Evt2Encoder::new(0);
        let event = Event {
            t_us: 0x1234_5678,
            x: 0x123,
            y: 0x0ab,
            polarity: Polarity::Off,
        };
        let low = 0x1234_5678 & 63;
        assert_eq!(
            encoder.encode(event),
            Some((
                Some(0x8000_0000 | (0x1234_5678 >> 6)),
                (low << 22) | (0x123 << 11) | 0x0ab
            ))
        );
        let on = Event {
            polarity: Polarity::On,
            ..event
        };
        let word = (1 << 28) | (low << 22) | (0x123 << 11) | 0x0ab;
        assert_eq!(encoder.encode(on), Some((None, word)));
    }

    #[test]
    fn words_that_are_no_events_are_told_apart() {
        let mut decoder = Evt2Decoder::new(7);
        assert_eq!(decoder.decode(1 << 28), Word::Untimed);
        assert_eq!(decoder.decode(0xA000_0001), Word::Other);
        assert_eq!(decoder.decode(0x8000_0002), Word::Time);
        let Word::Event(event) = decoder.decode(1 << 28) else {
            panic!("an event")
        };
        assert_eq!(event.t_us, 7 + 128);
    }

    #[test]
    fn wraps_are_carried_and_steps_back_are_not() {
        let mut encoder = Evt2Encoder::new(1000);
        let mut decoder = Evt2Decoder::new(1000);
        let hour = 3_600_000_000;
        for t_us in [
            1000,
            1000 + 2 * hour,
            1000 + 4 * hour,
            1000 + 6 * hour,
            1000 + 6 * hour - 100,
        ] {
            let (due, word) = encoder.encode(at(t_us)).unwrap();
            if let Some(due) = due {
                assert_eq!(decoder.decode(due), Word::Time);
            }
            assert_eq!(decoder.decode(word), Word::Event(at(t_us)));
        }
        // Too far ahead, before the base, outside the coordinate range.
        assert_eq!(encoder.encode(at(1000 + 16 * hour)), None);
        assert_eq!(encoder.encode(at(999)), None);
        assert_eq!(
            encoder.encode(Event {
                x: 2048,
                ..at(1000 + 6 * hour)
            }),
            None
        );
    }

    #[test]
    fn steps_back_across_a_wrap_are_followed() {
        const TOP: u32 = HIGH_MASK;
        const LAST: u32 = TOP - TOP / 256;
        let times = |base_us: u64, highs: &[u32]| -> Vec<u64> {
            let mut decoder = Evt2Decoder::new(base_us);
            let time = |high: &u32| {
                assert_eq!(decoder.decode(0x8000_0000 | *high), Word::Time);
                decoder.time_us >> LOW_BITS
            };
            highs.iter().map(time).collect()
        };
        let top = u64::from(TOP);
        let period = top + 1;
        assert_eq!(
            times(0, &[TOP, 0, TOP, 3, LAST + 4, LAST - 1]),
            [
                top,
                period,
                top,
                period + 3,
                u64::from(LAST) + 4,
                u64::from(LAST) - 1
            ]
        );
        // No step back below time 0; a large step forwards is taken as it is.
        assert_eq!(times(0, &[0, TOP]), [0, top]);
        assert_eq!(
            times(PERIOD_US, &[0, LAST - 1]),
            [period, period + u64::from(LAST) - 1]
        );
        assert_eq!(times(PERIOD_US, &[TOP]), [period + top]);
        // A fall by half of the range is a wrap, a smaller one is a step back.
        let half = TOP / 2 + 1;
        assert_eq!(
            times(0, &[half, 0, half + 1, 2]),
            [period / 2, period, period + period / 2 + 1, period + 2]
        );
    }

    proptest! {
        #[test]
        fn what_is_encoded_decodes(
            base_us in prop_oneof![Just(0), Just(1_700_000_000_000_000_u64), any::<u32>().prop_map(u64::from)],
            steps in proptest::collection::vec((-500_i64..5_000_000_000, 0..2048_u16, 0..2048_u16, any::<bool>()), 1..100),
        ) {
            let mut encoder = Evt2Encoder::new(base_us);
            let mut decoder = Evt2Decoder::new(base_us);
            let mut t_us = base_us;
            for (step, x, y, on) in steps {
                t_us = t_us.saturating_add_signed(step).max(base_us);
                let event = Event { t_us, x, y, polarity: Polarity::from_bool(on) };
                let (due, word) = encoder.encode(event).expect("small steps fit");
                if let Some(due) = due {
                    prop_assert_eq!(decoder.decode(due), Word::Time);
                }
                prop_assert_eq!(decoder.decode(word), Word::Event(event));
            }
        }

        #[test]
        fn any_words_are_survived(words in proptest::collection::vec(any::<u32>(), 0..200), base_us: u64) {
            let mut decoder = Evt2Decoder::new(base_us);
            for word in words {
                decoder.decode(word);
            }
        }
    }
}
