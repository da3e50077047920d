//! EVT 2.0 words to events and back: 32 bits, little-endian, as Prophesee sensors send them.
//!
//! | bits 31..28 | 27..22 | 21..11 | 10..0 |
//! |---|---|---|---|
//! | 0 `CD_OFF`, 1 `CD_ON` | time bits 5..0 | x | y |
//! | 8 `TIME_HIGH` | time bits 33..6 (28 bits) ||
//! | others | triggers, padding, vendor words: no events ||

use crate::{Event, Polarity};

const CD_ON: u32 = 1;
/// What is below is an event: `CD_OFF` and `CD_ON` are the lowest types.
const EVENTS_END: u32 = (CD_ON + 1) << KIND_SHIFT;
/// Bits that no event has, and every other word has some of.
pub const NO_EVENT: u32 = !(EVENTS_END - 1);
const _: () = assert!(EVENTS_END.is_power_of_two());
/// The type, which is the polarity of an event.
pub const KIND_SHIFT: u32 = 28;
/// Where the time bits of an event begin.
pub const LOW_SHIFT: u32 = 22;
/// Where x of an event begins.
pub const X_SHIFT: u32 = 11;
/// Bits of x, and of y.
pub const SIDE_BITS: u32 = 11;
/// The bits of y.
pub const SIDE_MASK: u32 = (1 << SIDE_BITS) - 1;
const TIME_HIGH: u32 = 8;
/// Time bits of an event's own word.
pub const LOW_BITS: u32 = 6;
/// Bits of a `TIME_HIGH`.
const HIGH_MASK: u32 = (1 << 28) - 1;
/// Period of the format's time: 2^34 us, 4.8 hours.
const PERIOD_US: u64 = 1 << 34;
/// Microseconds that share a `TIME_HIGH`.
pub const SPAN_US: u32 = 1 << LOW_BITS;

/// What a word was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Word {
    /// An event.
    Event(Event),
    /// A time; nothing to do.
    Time,
    /// An event before the first time: it has none.
    Untimed,
    /// A word of another type.
    Other,
}

/// Whether a word is an event.
#[inline]
#[must_use]
pub const fn is_event(word: u32) -> bool {
    word < EVENTS_END
}

/// Decodes words; carries the time between them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Evt2Decoder {
    /// Time of the current `TIME_HIGH`, wraps and base included.
    time_us: u64,
    /// Bits of the current `TIME_HIGH`; none before the first.
    high: Option<u32>,
}

impl Evt2Decoder {
    /// A decoder whose times start at `base_us`, which stands for the format's 0.
    #[inline]
    #[must_use]
    pub const fn new(base_us: u64) -> Self {
        Self {
            time_us: base_us,
            high: None,
        }
    }

    /// Whether events have a time: a `TIME_HIGH` has come.
    #[inline]
    #[must_use]
    pub const fn has_time(&self) -> bool {
        self.high.is_some()
    }

    /// Bits of the current `TIME_HIGH` and its time in microseconds, wraps and base included; none before the
    /// first.
    #[inline]
    #[must_use]
    pub const fn time_high(&self) -> Option<(u32, u64)> {
        match self.high {
            Some(high) => Some((high, self.time_us)),
            None => None,
        }
    }

    /// Time of the current `TIME_HIGH`, to which an event's word adds less than [`SPAN_US`].
    #[inline]
    #[must_use]
    pub const fn span_us(&self) -> Option<u64> {
        match self.high {
            Some(_) => Some(self.time_us),
            None => None,
        }
    }

    /// The current `TIME_HIGH`.
    #[inline]
    #[must_use]
    pub fn time_word(&self) -> u32 {
        (TIME_HIGH << KIND_SHIFT) | self.high.unwrap_or(0)
    }

    /// The last `TIME_HIGH` that comes within `ahead_us` of the current one and does not wrap.
    #[inline]
    #[must_use]
    pub fn time_word_after(&self, ahead_us: u32) -> u32 {
        let last = (TIME_HIGH << KIND_SHIFT) | HIGH_MASK;
        last.min(self.time_word() + (ahead_us >> LOW_BITS))
    }

    /// Takes a `TIME_HIGH` from the current one to any of [`Self::time_word_after`].
    #[inline]
    pub fn step_to_word(&mut self, word: u32) {
        let step_us = time_step_us(self.time_word(), word);
        self.high = Some(word & HIGH_MASK);
        self.time_us = self.time_us.wrapping_add(u64::from(step_us));
    }

    /// Takes the next word.
    ///
    /// A `TIME_HIGH` that falls by half of its range or more has wrapped; one that rises by the last
    /// 1/256 of its range belongs to the time before a wrap, since events are not always in order.
    /// Every other step is taken as it is.
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

    /// Takes the bits of a `TIME_HIGH`.
    #[inline]
    fn step_to(&mut self, high: u32) {
        let now_us = u64::from(high) << LOW_BITS;
        let before = self.high.replace(high);
        let before_us = u64::from(before.unwrap_or(0)) << LOW_BITS;
        // Where the format's time was 0 last.
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

/// Microseconds from a `TIME_HIGH` to a later one, which are less than 2^32.
#[inline]
#[must_use]
pub const fn time_step_us(from: u32, to: u32) -> u32 {
    (to - from) << LOW_BITS
}

/// What an event's word adds to its `TIME_HIGH`, below [`SPAN_US`].
#[inline]
#[must_use]
pub const fn low_us(word: u32) -> u32 {
    (word >> LOW_SHIFT) & (SPAN_US - 1)
}

/// Encodes events as words, with the `TIME_HIGH` that they need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Evt2Encoder {
    base_us: u64,
    /// What the receiver's decoder has seen: an event that it would not give back is refused.
    decoder: Evt2Decoder,
    /// The next event gets a `TIME_HIGH` in any case.
    restates: bool,
}

impl Evt2Encoder {
    /// An encoder for times from `base_us` on.
    #[inline]
    #[must_use]
    pub const fn new(base_us: u64) -> Self {
        Self {
            base_us,
            decoder: Evt2Decoder::new(base_us),
            restates: false,
        }
    }

    /// Has the next event begin with a `TIME_HIGH`, due or not: the start of a packet, which must
    /// not depend on one that may be lost.
    #[inline]
    pub const fn restate_time(&mut self) {
        self.restates = true;
    }

    /// The `TIME_HIGH` to send first, if one is due, and the event's word.
    ///
    /// `None` for an event that the format cannot hold: before the base, beyond 2,048 x 2,048, or
    /// after a step of time that its 4.8-hour wraps do not show.
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
        // Too far ahead, before the base, beyond the coordinates.
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
        // Not beyond 0, and a large step forwards stays one.
        assert_eq!(times(0, &[0, TOP]), [0, top]);
        assert_eq!(
            times(PERIOD_US, &[0, LAST - 1]),
            [period, period + u64::from(LAST) - 1]
        );
        assert_eq!(times(PERIOD_US, &[TOP]), [period + top]);
        // Half of the range is a wrap, less is a step back.
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
