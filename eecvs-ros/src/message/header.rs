//! `std_msgs/msg/Header` and the time in it.

use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

/// `builtin_interfaces/msg/Time`: a time since 1970.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds within the second.
    pub nanosec: u32,
}

impl Time {
    /// Returns the computer's time, by which messages are stamped by convention.
    #[must_use]
    pub fn now() -> Self {
        Self::from(SystemTime::now())
    }

    /// Returns the time in nanoseconds since 1970.
    #[must_use]
    pub const fn ns(self) -> i64 {
        self.sec as i64 * 1_000_000_000 + self.nanosec as i64
    }

    /// Converts nanoseconds since 1970. Seconds beyond 32 bits are clamped.
    #[must_use]
    pub fn from_ns(ns: i64) -> Self {
        let sec = ns.div_euclid(1_000_000_000);
        let limit = if sec < 0 { i32::MIN } else { i32::MAX };
        Self {
            sec: i32::try_from(sec).unwrap_or(limit),
            // Below 10^9.
            nanosec: ns.rem_euclid(1_000_000_000) as u32,
        }
    }
}

impl From<SystemTime> for Time {
    fn from(time: SystemTime) -> Self {
        let since = time.duration_since(SystemTime::UNIX_EPOCH);
        Self::from_ns(i64::try_from(since.unwrap_or(Duration::ZERO).as_nanos()).unwrap_or(i64::MAX))
    }
}

/// `std_msgs/msg/Header`: when and by which sensor a message was made.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// The computer's time.
    pub stamp: Time,
    /// Name of the sensor.
    pub frame_id: String,
}

/// Appends the definitions of a header and of its time, with which message definitions end.
macro_rules! with_header {
    ($fields:expr) => {
        concat!(
            $fields,
            "================================================================================\n",
            "MSG: std_msgs/Header\n",
            "builtin_interfaces/Time stamp\n",
            "string frame_id\n",
            "================================================================================\n",
            "MSG: builtin_interfaces/Time\n",
            "int32 sec\n",
            "uint32 nanosec\n"
        )
    };
}
pub(super) use with_header;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_nanoseconds_since_1970() {
        for (ns, sec, nanosec) in [
            (0, 0, 0),
            (1_500_000_007, 1, 500_000_007),
            (-1, -1, 999_999_999),
        ] {
            let time = Time { sec, nanosec };
            assert_eq!(Time::from_ns(ns), time);
            assert_eq!(time.ns(), ns);
        }
        assert_eq!(Time::from_ns(i64::MAX).sec, i32::MAX);
        assert!(Time::now() > Time::from_ns(1_700_000_000_000_000_000));
    }
}
