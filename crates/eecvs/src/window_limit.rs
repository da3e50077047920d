//! How many events a window of frames may have.
//!
//! A frame of a few bytes may state millions of events. Genuine frames do so rarely, since no sensor sends them, and
//! hostile ones fill memory and disks. Frames beyond the limit are refused and counted, and everything else is used.

use crate::storage::WINDOW_EVENTS;

/// Events that the fastest sensors send in a microsecond: 1.066e9 a second.
const SENSOR_EVENTS_PER_US: u64 = 1100;

/// Events of one pixel beyond which its rate counts.
const PIXEL_EVENTS: u64 = 1 << 16;

/// Shortest time between two events of a pixel, over a long time, in microseconds.
const PIXEL_EVERY_US: u64 = 10;

/// Largest number of events that a decoder accepts in a window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum WindowLimit {
    /// What a sensor can send in the window's duration T: max(2^20, 1100 T / us) events, of them
    /// 2^16 + T / (10 us) from one pixel. 2^20 is also where encoders close a window by default.
    #[default]
    Sensor,
    /// This many events, from one pixel or from all.
    Events(u32),
}

impl From<Option<u32>> for WindowLimit {
    /// `None` stands for what a sensor can send.
    fn from(events_max: Option<u32>) -> Self {
        events_max.map_or(Self::Sensor, Self::Events)
    }
}

impl WindowLimit {
    /// Returns the largest number of events of a window of this duration.
    #[must_use]
    pub fn events_max(self, duration_us: u32) -> u64 {
        match self {
            Self::Sensor => {
                let sent = SENSOR_EVENTS_PER_US * u64::from(duration_us);
                sent.max(WINDOW_EVENTS as u64)
            }
            Self::Events(events) => events.into(),
        }
    }

    /// Returns the largest number of events of one pixel in a window of this duration.
    #[must_use]
    pub fn pixel_events_max(self, duration_us: u32) -> u64 {
        match self {
            Self::Sensor => PIXEL_EVENTS + u64::from(duration_us) / PIXEL_EVERY_US,
            Self::Events(events) => events.into(),
        }
    }
}
