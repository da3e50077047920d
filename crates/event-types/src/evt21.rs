//! EVT 2.1: the words that files, cameras and sensors have, of 64 bits with up to 32 events each.
//!
//! | bits | in 0 `EVT_NEG` and 1 `EVT_POS` | in 8 `EVT_TIME_HIGH` |
//! |---|---|---|
//! | 63..60 | type | type |
//! | 59..54 | time bits 5..0 | time bits 33..6 in 59..32 |
//! | 53..43, 42..32 | first x, y | |
//! | 31..0 | bit i set: an event at x + i | unused |
//!
//! Other types: A `EXT_TRIGGER`, E `OTHERS`, F `CONTINUED`. [`Order`] is the order of a word's bytes.

use crate::evt2::{self, Evt2Decoder};
use crate::{Event, Polarity};

/// Type of the word with the upper bits of time.
pub const TIME_HIGH: u64 = 8;
/// Number of time bits in an `EVT_TIME_HIGH`.
pub const HIGH_BITS: u32 = 28;
/// Number of time bits in a word with events.
pub const LOW_BITS: u32 = 6;
/// Lowest bit of the type.
pub const TYPE_SHIFT: u32 = 60;
/// Lowest bit of the lower time bits.
pub const TIME_SHIFT: u32 = 54;
/// Lowest bit of the first column.
pub const X_SHIFT: u32 = 43;
/// Lowest bit of the row, and of the upper bits of time.
pub const Y_SHIFT: u32 = 32;
/// Mask of a column or row, shifted to bit 0.
pub const SIDE: u64 = 0x7ff;
/// Number of columns in a word.
pub const COLUMNS: u16 = 32;

/// The order of the eight bytes of a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// The upper half comes first, each half little-endian: IMX636 and Gen 4.1.
    UpperFirst,
    /// The whole word is little-endian: GenX320.
    Little,
}

impl Order {
    /// Returns the word that these bytes encode in this order.
    #[inline]
    #[must_use]
    pub const fn word(self, bytes: [u8; 8]) -> u64 {
        let word = u64::from_le_bytes(bytes);
        match self {
            Self::UpperFirst => word.rotate_left(32),
            Self::Little => word,
        }
    }

    /// Returns the bytes that encode a word in this order.
    #[inline]
    #[must_use]
    pub const fn bytes(self, word: u64) -> [u8; 8] {
        match self {
            Self::UpperFirst => word.rotate_left(32),
            Self::Little => word,
        }
        .to_le_bytes()
    }
}

/// Returns the `EVT_TIME_HIGH` with these upper bits of time, which must be below 2^28.
#[inline]
#[must_use]
pub const fn time_word(high: u64) -> u64 {
    TIME_HIGH << TYPE_SHIFT | high << Y_SHIFT
}

/// Returns the upper bits of time in an `EVT_TIME_HIGH`.
#[inline]
#[must_use]
pub const fn time_high(word: u64) -> u64 {
    word >> Y_SHIFT & ((1 << HIGH_BITS) - 1)
}

/// Returns how many events at the start of `events` fit into one word in their order, and that word.
///
/// They must have the same time, row and polarity, and x must rise within an aligned group of 32 columns. For no
/// events, returns (0, 0).
#[must_use]
pub fn vector(events: &[Event]) -> (usize, u64) {
    let Some(first) = events.first() else {
        return (0, 0);
    };
    let group = |event: &Event| {
        let Event { t_us, y, .. } = *event;
        (t_us, y, event.polarity, event.x / COLUMNS)
    };
    let (mut count, mut columns) = (0, 0_u32);
    for event in events {
        let column = event.x % COLUMNS;
        // Stop at a column that is not above all columns so far.
        if group(event) != group(first) || columns >> column != 0 {
            break;
        }
        columns |= 1 << column;
        count += 1;
    }
    let word = u64::from(first.polarity == Polarity::On) << TYPE_SHIFT
        | (first.t_us & ((1 << LOW_BITS) - 1)) << TIME_SHIFT
        | u64::from(first.x - first.x % COLUMNS) << X_SHIFT
        | u64::from(first.y) << Y_SHIFT
        | u64::from(columns);
    (count, word)
}

/// What [`Evt21Decoder::decode`] found in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Word {
    /// Events, in the vector's columns; none is a vector without events.
    Vector(Vector),
    /// An `EVT_TIME_HIGH`; the decoder has stored its time.
    Time,
    /// As many events, before the first `EVT_TIME_HIGH`, so that their time is unknown.
    Untimed(u32),
    /// The word has another type.
    Other,
}

/// The events of a word: an iterator over their EVT 2.0 words, from the first column on.
///
/// EVT 2.0 has the same fields, so that what takes its words takes these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vector {
    /// Type, time and row as EVT 2.0 has them.
    place: u32,
    x: u16,
    columns: u32,
}

impl Vector {
    /// Returns the columns that are left, bit i for x + i.
    #[must_use]
    pub const fn columns(&self) -> u32 {
        self.columns
    }

    /// Leaves only those of these columns.
    #[must_use]
    pub const fn only(self, columns: u32) -> Self {
        Self {
            columns: self.columns & columns,
            ..self
        }
    }

    /// Splits events off the end whose column has no place in an EVT 2.0 word, and returns how many they are: columns
    /// from 2048 on, which no sensor has.
    pub const fn drop_beyond(&mut self) -> u32 {
        // x is below 2048.
        let inside = (1 << evt2::SIDE_BITS) - self.x as u32;
        if inside >= COLUMNS as u32 {
            return 0;
        }
        let beyond = self.columns >> inside;
        self.columns &= (1 << inside) - 1;
        beyond.count_ones()
    }
}

impl Iterator for Vector {
    type Item = u32;

    #[inline]
    fn next(&mut self) -> Option<u32> {
        if self.columns == 0 {
            return None;
        }
        let x = (u32::from(self.x) + self.columns.trailing_zeros()) & evt2::SIDE_MASK;
        self.columns &= self.columns - 1;
        Some(self.place | x << evt2::X_SHIFT)
    }
}

/// A decoder of EVT 2.1 words, which keeps the time from word to word, in the same way as [`Evt2Decoder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Evt21Decoder {
    /// EVT 2.0 has the same time bits in its two types of words.
    time: Evt2Decoder,
}

impl Evt21Decoder {
    /// Returns a decoder that adds `base_us` to the format's times.
    #[must_use]
    pub const fn new(base_us: u64) -> Self {
        Self {
            time: Evt2Decoder::new(base_us),
        }
    }

    /// Returns the decoder of EVT 2.0 words with this one's time, for the words of a [`Vector`].
    pub const fn evt2(&mut self) -> &mut Evt2Decoder {
        &mut self.time
    }

    /// Decodes the next word.
    #[inline]
    pub fn decode(&mut self, word: u64) -> Word {
        match word >> TYPE_SHIFT {
            0 | 1 => {
                let vector = Vector {
                    place: (word >> 32) as u32 & !((SIDE as u32) << evt2::X_SHIFT),
                    x: (word >> X_SHIFT & SIDE) as u16,
                    columns: word as u32,
                };
                match self.time.has_time() {
                    true => Word::Vector(vector),
                    false => Word::Untimed(vector.columns.count_ones()),
                }
            }
            // The upper half is EVT 2.0's word.
            TIME_HIGH => {
                self.time.decode((word >> 32) as u32);
                Word::Time
            }
            _ => Word::Other,
        }
    }
}

// A word's upper half has the fields of an EVT 2.0 word in their places.
const _: () = {
    assert!(TYPE_SHIFT - 32 == evt2::KIND_SHIFT && TIME_SHIFT - 32 == evt2::LOW_SHIFT);
    assert!(X_SHIFT - 32 == evt2::X_SHIFT && Y_SHIFT == 32 && LOW_BITS == evt2::LOW_BITS);
};

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The example in the format's description.
    #[test]
    fn the_upper_half_comes_first() {
        let word = 0x0102_0304_0506_0708;
        let bytes = [4, 3, 2, 1, 8, 7, 6, 5];
        assert_eq!(Order::UpperFirst.bytes(word), bytes);
        assert_eq!(Order::UpperFirst.word(bytes), word);
        assert_eq!(Order::Little.bytes(word), [8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!(Order::Little.word(Order::Little.bytes(word)), word);
    }

    #[test]
    fn a_word_holds_rising_columns_of_one_group() {
        let at = |x| Event {
            t_us: 0x45,
            x,
            y: 7,
            polarity: Polarity::On,
        };
        let head = 1 << 60 | 5 << 54 | 32 << 43 | 7_u64 << 32;
        let cases: [(&[u16], usize, u64); 5] = [
            (&[33, 35, 63, 64], 3, 0x8000_000a),
            (&[63, 62], 1, 0x8000_0000),
            (&[40, 40], 1, 0x100),
            (&[32, 31], 1, 1),
            (&[32, 96], 1, 1),
        ];
        for (columns, count, bits) in cases {
            let events: Vec<Event> = columns.iter().copied().map(at).collect();
            assert_eq!(vector(&events), (count, head | bits), "{columns:?}");
        }
        assert_eq!(vector(&[]), (0, 0));
        let mut events = [at(33), at(34)];
        for change in [
            |event: &mut Event| event.t_us += 1,
            |event: &mut Event| event.y += 1,
            |event: &mut Event| event.polarity = Polarity::Off,
        ] {
            events[1] = at(34);
            change(&mut events[1]);
            assert_eq!(vector(&events).0, 1);
        }
    }
    proptest! {
        /// A vector's words of EVT 2.0 are its events, and those off every sensor are counted.
        #[test]
        fn vectors_are_words_of_evt2(
            high in 0..1_u64 << HIGH_BITS,
            low in 0..1_u64 << LOW_BITS,
            (x, y) in (0..=SIDE, 0..=SIDE),
            (on, columns) in (0..2_u64, any::<u32>()),
        ) {
            let mut decoder = Evt21Decoder::new(7);
            let word =
                on << TYPE_SHIFT | low << TIME_SHIFT | x << X_SHIFT | y << Y_SHIFT | u64::from(columns);
            prop_assert_eq!(decoder.decode(word), Word::Untimed(columns.count_ones()));
            prop_assert_eq!(decoder.decode(time_word(high)), Word::Time);
            let Word::Vector(mut vector) = decoder.decode(word) else {
                return Err(TestCaseError::fail("a vector"));
            };
            let mut expected = Vec::new();
            let mut beyond = 0;
            for column in (0..32).filter(|column| columns >> column & 1 == 1) {
                match u16::try_from(x + column) {
                    Ok(x) if u64::from(x) <= SIDE => expected.push(evt2::Word::Event(Event {
                        t_us: 7 + (high << LOW_BITS | low),
                        x,
                        y: y as u16,
                        polarity: Polarity::from_bool(on == 1),
                    })),
                    _ => beyond += 1,
                }
            }
            prop_assert_eq!(vector.drop_beyond(), beyond);
            let events: Vec<_> = vector.map(|word| decoder.evt2().decode(word)).collect();
            prop_assert_eq!(events, expected);
        }
    }

    #[test]
    fn other_words_are_named() {
        let mut decoder = Evt21Decoder::new(0);
        for kind in [2, 7, 9, 0xa, 0xe, 0xf_u64] {
            assert_eq!(decoder.decode(kind << TYPE_SHIFT), Word::Other);
        }
    }
}
