//! 16-bit words that DAVIS and DVXplorer share.
//!
//! | bits 15..12 | bits 11..0 | meaning |
//! |---|---|---|
//! | 1xxx | 15 bits of time in us | time of what follows |
//! | 0 | 1 | the counter was reset |
//! | 0 | 2 falling, 3 rising, 4 pulse | external input |
//! | 0 | 5 start, 7 end | inertial sample |
//! | 0 | 8, 9 start, 10 end; 11, 12 column, 13 its end; 14, 15 exposure | frame |
//! | 0 | 16 falling, 17 rising | generator |
//! | 1, 2, 3, 4 | | the model's own |
//! | 5 | 0 byte, 3 scale of an inertial sample; 1, 2 region of interest (bits 11..8) | |
//! | 6 | 0 (bits 11..10) | exposure |
//! | 7 | d, 1 to 4095 | the counter wrapped d times: + d * 2^15 us |

use super::parser::{State, Word};
use super::tally::Count;

/// Bits of time in a time word.
pub const TIME_BITS: u32 = 15;

/// Most wraps in one word.
pub const WRAPS_MAX: u64 = 0xFFF;

/// Marks a time word; its low 15 bits are the time.
pub const TIME: u16 = 0x8000;

/// Code of a row address (DAVIS) or of a column address (DVXplorer).
pub const ROW: u16 = 0x1000;

/// Code of a column with an OFF event (DAVIS).
pub const OFF: u16 = 0x2000;

/// Code of a column with an ON event (DAVIS).
pub const ON: u16 = 0x3000;

/// Code of a wrap.
pub const WRAP: u16 = 0x7000;

/// The counter was reset.
pub const RESET: u16 = 0x0001;

/// Takes a time word. Returns whether reading goes on.
#[inline(always)]
pub fn time(word: Word, state: &mut State) -> bool {
    let low = u64::from(word.bits & 0x7FFF);
    state.tally.add(Count::Times);
    state.clock.take(low) || state.settle(low, word)
}

/// Takes a word that is neither a time nor one of the model's own codes. Returns whether reading goes on.
pub fn other(word: Word, state: &mut State) -> bool {
    let data = word.bits & 0xFFF;
    let count = match word.bits >> 12 {
        0 => match data {
            1 => {
                state.clock.reset();
                Count::Resets
            }
            2..=4 => Count::Inputs,
            5 | 7 => Count::Imu,
            8..=15 => Count::Frames,
            16 | 17 => Count::Generator,
            _ => return state.strange(Count::Unknown, word),
        },
        5 => match data >> 8 {
            0 | 3 => Count::Imu,
            1 | 2 => Count::Exposures,
            _ => return state.strange(Count::Unknown, word),
        },
        6 if data >> 10 == 0 => Count::Exposures,
        7 if data > 0 => {
            state.clock.wrap(u64::from(data));
            Count::Wraps
        }
        _ => return state.strange(Count::Unknown, word),
    };
    state.count(count)
}
