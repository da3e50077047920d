//! The small messages that accompany frames: a byte with the version, then postcard's encoding.
//!
//! No bytes can make a reader panic, or allocate more than their own length: unreadable messages are rejected, and
//! the reader counts them.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Version of these messages.
const VERSION: u8 = 3;

/// Maximum number of ranges of frame numbers in one [`Wish`].
pub const RANGES_MAX: usize = 64;

/// Maximum number of runs in [`Status::held`].
pub const HELD_MAX: usize = 16;

/// A message with a versioned encoding.
pub trait Message: Serialize + DeserializeOwned {
    /// Returns the encoded message.
    fn to_bytes(&self) -> Vec<u8> {
        // Writing to memory does not fail, and postcard can encode every field here.
        postcard::to_extend(self, vec![VERSION]).unwrap_or_default()
    }

    /// Decodes a message, or returns `None` if the bytes are not this message in this version.
    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (&VERSION, rest) = bytes.split_first()? else {
            return None;
        };
        postcard::from_bytes(rest).ok()
    }
}

/// Returns the time by this computer's clock, which may be set at any moment, in microseconds since 1970.
#[must_use]
pub fn now_us() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0, |now| u64::try_from(now.as_micros()).unwrap_or(u64::MAX))
}

/// Identification of a frame, attached to every frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Stamp {
    /// Identifies the run, which is one start of the sensor's process: when it started by the clock of the sensor's
    /// computer, in microseconds since 1970, or a later time if the sensor's store has frames of that run or a later
    /// one. That clock may be wrong, so a run's number says nothing of its age.
    pub run: u64,
    /// Number of the frame in the run, from 0.
    pub number: u64,
    /// End of the frame's window, by the run's [`crate::clock::Clock`]: microseconds since 1970.
    pub end_us: u64,
    /// Time from the run's start to when the frame was sent, in microseconds; 0 if it was sent again.
    pub up_us: u64,
}

impl Message for Stamp {}

/// A range of frame numbers in a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Range {
    /// The first number.
    pub from: u64,
    /// One past the last number.
    pub to: u64,
}

/// A receiver's request to a sensor to send frames again.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wish {
    /// The receiver. A later request replaces its earlier one.
    pub receiver: u64,
    /// The run, as in [`Stamp`].
    pub run: u64,
    /// Numbers of the frames, in at most [`RANGES_MAX`] ranges.
    pub ranges: Vec<Range>,
}

impl Message for Wish {}

/// Reply to a [`Wish`], sent after the requested frames.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// The run, as in [`Stamp`].
    pub run: u64,
    /// The run of the sensor that answers: a later one than `run`, if the sensor was started again.
    pub by: u64,
    /// Requested numbers that the sensor does not hold.
    pub gone: Vec<Range>,
}

impl Message for Answer {}

/// Reply to a question for a sensor's clock.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// The run, as in [`Stamp`].
    pub run: u64,
    /// What the run's clock shows: microseconds since 1970.
    pub now_us: u64,
}

impl Message for Time {}

/// A hub's limit on a sensor's rate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Budget {
    /// Bytes of frames per second; `None` means that only the sensor's own command line sets a limit.
    pub bytes_per_second: Option<u32>,
}

impl Message for Budget {}

/// What became of a sensor's events since its start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Events {
    /// Events in frames.
    pub encoded: u64,
    /// Of those in frames, events whose times are not exact.
    pub approximate: u64,
    /// Events too old for their window.
    pub late: u64,
    /// Events removed by a filter.
    pub filtered: u64,
    /// Events lost before or in the encoder.
    pub dropped: u64,
    /// Events left out so that the frames fit the budget.
    pub thinned: u64,
}

/// State of a sensor's store of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// Number of frames in memory.
    pub memory_frames: u64,
    /// Bytes of the frames in memory.
    pub memory_bytes: u64,
    /// Number of frames on disk.
    pub disk_frames: u64,
    /// Bytes that the store takes on disk.
    pub disk_bytes: u64,
    /// Frames made while there was no link, or just before it failed, that are no longer held.
    pub let_go_frames: u64,
    /// Frames that could not be written to disk, or of which it is not known that they are there.
    pub disk_failures: u64,
    /// Frames on disk that are damaged or missing.
    pub disk_damaged_frames: u64,
    /// Bytes of damaged records on disk.
    pub disk_damaged_bytes: u64,
}

/// Frames of an earlier run that a sensor's store holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// The run, as in [`Stamp`].
    pub run: u64,
    /// Numbers of the frames, from the first to the last that is held.
    pub range: Range,
    /// How long ago the run began, by the clock of the sensor's computer, in microseconds; `None` if that clock was
    /// set back since, and cannot tell.
    pub ago_us: Option<u64>,
}

/// A sensor's report on itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The run, as in [`Stamp`].
    pub run: u64,
    /// Number of the next frame: all frames below it exist.
    pub next: u64,
    /// Columns of the sensor.
    pub width: u16,
    /// Rows of the sensor.
    pub height: u16,
    /// Time from the run's start to this report, in microseconds.
    pub up_us: u64,
    /// Counts of the sensor's events.
    pub events: Events,
    /// Bytes of all frames made.
    pub bytes: u64,
    /// Windows per regime: sparse, moderate, dense.
    pub windows: [u64; 3],
    /// Limit on the sensor's rate in bytes per second, if there is one.
    pub budget: Option<u32>,
    /// Whether the sensor lowers its rate because its link cannot take more.
    pub is_congested: bool,
    /// Number of times that the link failed.
    pub outages: u64,
    /// Total time without a link after the first connection, in microseconds.
    pub outages_us: u64,
    /// Frames sent again.
    pub again: u64,
    /// State of the sensor's store.
    pub stored: Stored,
    /// What the store holds of earlier runs, the newest [`HELD_MAX`] of them.
    pub held: Vec<Held>,
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
            up_us: 8,
        };
        assert_eq!(Stamp::from_bytes(&stamp.to_bytes()), Some(stamp));
        let status = Status {
            run: 3,
            width: 640,
            windows: [1, 2, 3],
            budget: Some(1_000_000),
            held: vec![Held {
                run: 2,
                range: Range { from: 4, to: 9 },
                ago_us: Some(1),
            }],
            ..Status::default()
        };
        assert_eq!(Status::from_bytes(&status.to_bytes()), Some(status));
        let mut other = stamp.to_bytes();
        other[0] = 1;
        assert_eq!(Stamp::from_bytes(&other), None);
        assert_eq!(Stamp::from_bytes(&[]), None);
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_message_or_none(bytes: Vec<u8>) {
            let mut bytes = bytes;
            bytes.insert(0, VERSION);
            let _ = (Stamp::from_bytes(&bytes), Wish::from_bytes(&bytes), Answer::from_bytes(&bytes));
            let _ = (Budget::from_bytes(&bytes), Status::from_bytes(&bytes), Time::from_bytes(&bytes));
        }
    }
}
