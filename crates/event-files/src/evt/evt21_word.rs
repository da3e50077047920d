//! EVT 2.1 words, as used in files and by cameras: 64 bits with up to 32 events each.
//!
//! | bits | in 0 `EVT_NEG` and 1 `EVT_POS` | in 8 `EVT_TIME_HIGH` |
//! |---|---|---|
//! | 63..60 | type | type |
//! | 59..54 | time bits 5..0 | time bits 33..6 in 59..32 |
//! | 53..43, 42..32 | first x, y | |
//! | 31..0 | bit i set: an event at x + i | unused |
//!
//! Other types: A `EXT_TRIGGER`, E `OTHERS`, F `CONTINUED`. [`Order`] is the order of a word's bytes.

use event_types::{Event, Polarity};

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
