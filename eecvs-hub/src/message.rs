//! What travels beside frames: small messages, in postcard's encoding behind a byte that tells their version.
//!
//! No bytes may make a reader panic or allocate more than they are long: what cannot be read is refused, and whoever
//! reads counts it.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Version of these messages.
const VERSION: u8 = 1;

/// Frames asked for in one wish, in so many runs of numbers at the most.
pub const RANGES_MAX: usize = 64;

/// What is told of what is held, in so many runs at the most.
pub const HELD_MAX: usize = 16;

/// A message.
pub trait Message: Serialize + DeserializeOwned {
    /// Its bytes.
    fn to_bytes(&self) -> Vec<u8> {
        // Memory takes all bytes, and no field here is one that the encoding lacks.
        postcard::to_extend(self, vec![VERSION]).unwrap_or_default()
    }

    /// The message of some bytes; none where they are no such message.
    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (&VERSION, rest) = bytes.split_first()? else {
            return None;
        };
        postcard::from_bytes(rest).ok()
    }
}

/// Microseconds since 1970, by this computer's clock.
#[must_use]
pub fn now_us() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0, |now| u64::try_from(now.as_micros()).unwrap_or(u64::MAX))
}

/// Beside every frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Stamp {
    /// When the sensor was started, which tells its runs apart: microseconds since 1970.
    pub run: u64,
    /// Number of the frame in the run, from 0 on.
    pub number: u64,
    /// When its window ended, by the sensor's computer: microseconds since 1970.
    pub end_us: u64,
}

impl Message for Stamp {}

/// Frames of a run, by their numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Range {
    /// The first.
    pub from: u64,
    /// The one behind the last.
    pub to: u64,
}

/// What a receiver asks a sensor for.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wish {
    /// Who asks: a later wish takes the place of an earlier one.
    pub receiver: u64,
    /// The run.
    pub run: u64,
    /// Numbers, [`RANGES_MAX`] runs of them at the most.
    pub ranges: Vec<Range>,
}

impl Message for Wish {}

/// What is said in answer to a wish, beside the frames themselves.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// The run.
    pub run: u64,
    /// Numbers that were asked for and are not held any more.
    pub gone: Vec<Range>,
}

impl Message for Answer {}

/// What a sensor is allowed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Budget {
    /// Bytes of frames a second; none: as its own command line says.
    pub bytes_per_second: Option<u32>,
}

impl Message for Budget {}

/// What became of a sensor's events, since its start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Events {
    /// In frames.
    pub encoded: u64,
    /// Of those, events whose times are not exact.
    pub approximate: u64,
    /// Too old for their window.
    pub late: u64,
    /// Kept out by a filter.
    pub filtered: u64,
    /// Lost before or in the encoder.
    pub dropped: u64,
    /// Left out so that the frames fit the budget.
    pub thinned: u64,
}

/// How a sensor's store fares.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// Frames and their bytes in memory.
    pub memory_frames: u64,
    /// Bytes.
    pub memory_bytes: u64,
    /// Frames and their bytes on disk.
    pub disk_frames: u64,
    /// Bytes.
    pub disk_bytes: u64,
    /// Frames made while there was no link, or just before it failed, that are held no longer.
    pub let_go_frames: u64,
    /// Frames that could not be written to disk.
    pub disk_failures: u64,
}

/// What a sensor says of itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// When it was started, as in [`Stamp`].
    pub run: u64,
    /// Number of the frame that comes next: those below it exist.
    pub next: u64,
    /// Columns of the sensor.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// When this was said, by the sensor's computer: microseconds since 1970.
    pub now_us: u64,
    /// Its events.
    pub events: Events,
    /// Bytes of frames made.
    pub bytes: u64,
    /// Windows of its regimes: sparse, moderate, dense.
    pub windows: [u64; 3],
    /// Bytes a second that it is held to.
    pub budget: Option<u32>,
    /// Whether it lowers its rate as its link does not take more.
    pub is_congested: bool,
    /// Times that it had no link.
    pub outages: u64,
    /// Microseconds of these, all together.
    pub outages_us: u64,
    /// Frames sent once more.
    pub again: u64,
    /// Its store.
    pub stored: Stored,
    /// What is held of earlier runs: run and numbers, [`HELD_MAX`] at the most.
    pub held: Vec<(u64, Range)>,
}

impl Message for Status {}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn messages_come_back() {
        let stamp = Stamp {
            run: 1 << 51,
            number: 7,
            end_us: (1 << 51) + 9,
        };
        assert_eq!(Stamp::from_bytes(&stamp.to_bytes()), Some(stamp));
        let status = Status {
            run: 3,
            width: 640,
            windows: [1, 2, 3],
            budget: Some(1_000_000),
            held: vec![(2, Range { from: 4, to: 9 })],
            ..Status::default()
        };
        assert_eq!(Status::from_bytes(&status.to_bytes()), Some(status));
        let mut other = stamp.to_bytes();
        other[0] = 2;
        assert_eq!(Stamp::from_bytes(&other), None);
        assert_eq!(Stamp::from_bytes(&[]), None);
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_message_or_none(bytes: Vec<u8>) {
            let mut bytes = bytes;
            bytes.insert(0, VERSION);
            let _ = (Stamp::from_bytes(&bytes), Wish::from_bytes(&bytes), Answer::from_bytes(&bytes));
            let _ = (Budget::from_bytes(&bytes), Status::from_bytes(&bytes));
        }
    }
}
