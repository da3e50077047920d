//! Makes events fit a format that cannot hold them all, and counts what that loses.

use event_types::{Event, Sensor};

use crate::Limits;

/// What fitting changed or left out of a recording; all 0 if nothing was lost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Lost {
    /// Microseconds subtracted from every time.
    pub shifted_us: u64,
    /// Number of events left out because their pixel is beyond the format's columns or rows.
    pub outside: u64,
    /// Number of events left out because their time is beyond the format's range, or before the shifted time 0.
    pub beyond_time: u64,
    /// Number of events whose time was raised to that of the previous one, because the format's times cannot step
    /// back.
    pub raised: u64,
}

impl Lost {
    /// Returns whether every event was written as it was read.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Makes events fit the limits of a format.
///
/// Times are shifted only if the first one is beyond the format's largest time: the first then becomes 0.
#[derive(Debug, Clone)]
pub struct Fit {
    limits: Limits,
    lost: Lost,
    /// Shifted time of the last event that was kept; `None` before the first.
    last_us: Option<u64>,
}

impl Fit {
    /// Creates an adapter to `limits` that has not seen an event yet.
    #[must_use]
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            lost: Lost::default(),
            last_us: None,
        }
    }

    /// Returns the part of a sensor that the format can hold.
    #[must_use]
    pub fn sensor(limits: Limits, sensor: Sensor) -> Sensor {
        Sensor {
            width: sensor.width.min(limits.x_max.saturating_add(1)),
            height: sensor.height.min(limits.y_max.saturating_add(1)),
        }
    }

    /// Returns the event as the format can hold it, or `None` if it is left out.
    pub fn apply(&mut self, event: Event) -> Option<Event> {
        let Self {
            limits,
            lost,
            last_us,
        } = self;
        if event.x > limits.x_max || event.y > limits.y_max {
            lost.outside += 1;
            return None;
        }
        if last_us.is_none() && event.t_us > limits.t_max_us {
            lost.shifted_us = event.t_us;
        }
        let shifted = event.t_us.checked_sub(lost.shifted_us);
        let Some(mut t_us) = shifted.filter(|t_us| *t_us <= limits.t_max_us) else {
            lost.beyond_time += 1;
            return None;
        };
        if let Some(last) = *last_us
            && t_us < last
            && !limits.steps_back
        {
            lost.raised += 1;
            t_us = last;
        }
        *last_us = Some(t_us);
        Some(Event { t_us, ..event })
    }

    /// Returns what the events so far have lost.
    #[must_use]
    pub const fn lost(&self) -> Lost {
        self.lost
    }
}

/// Returns whether nothing of `events`, which lie on `sensor`, is beyond `limits`; `last_us` is the time of the event
/// before them.
#[must_use]
pub fn fits(limits: Limits, sensor: Sensor, events: &[Event], last_us: Option<u64>) -> bool {
    // No time is above all times' bits together.
    let is_early = || events.iter().fold(0, |all, event| all | event.t_us) <= limits.t_max_us;
    let is_on_time = || events.iter().all(|event| event.t_us <= limits.t_max_us);
    let is_near = || {
        let mut events = events.iter();
        events.all(|event| event.x <= limits.x_max && event.y <= limits.y_max)
    };
    let is_within =
        (is_early() || is_on_time()) && (Fit::sensor(limits, sensor) == sensor || is_near());
    let steps_back = || {
        let first = events.first().zip(last_us);
        first.is_some_and(|(first, last_us)| first.t_us < last_us)
            || !events.is_sorted_by_key(|event| event.t_us)
    };
    is_within && (limits.steps_back || !steps_back())
}

/// Describes what of `event`, event number `index`, is beyond `limits`, if anything; `last_us` is the previous
/// event's time.
#[must_use]
pub fn beyond(limits: Limits, index: u64, event: Event, last_us: Option<u64>) -> Option<String> {
    let Event { t_us, x, y, .. } = event;
    let Limits {
        x_max,
        y_max,
        t_max_us,
        steps_back,
    } = limits;
    let what = if x > x_max || y > y_max {
        format!("x = {x}, y = {y}: it has columns up to {x_max}, rows up to {y_max}")
    } else if t_us > t_max_us {
        format!("time {t_us} us: its times end at {t_max_us} us")
    } else if let Some(last) = last_us.filter(|last| t_us < *last && !steps_back) {
        format!("time {t_us} us after {last} us: its times cannot step back")
    } else {
        return None;
    };
    Some(format!("event {index} at {what}"))
}

#[cfg(test)]
mod tests {
    use event_types::Polarity;

    use super::*;

    const LIMITS: Limits = Limits {
        x_max: 255,
        y_max: 255,
        t_max_us: 1000,
        steps_back: false,
    };

    fn at(t_us: u64, x: u16) -> Event {
        Event {
            t_us,
            x,
            y: 7,
            polarity: Polarity::On,
        }
    }

    fn fitted(events: &[Event]) -> (Vec<(u64, u16)>, Lost) {
        let mut fit = Fit::new(LIMITS);
        let kept = events.iter().filter_map(|event| fit.apply(*event));
        let kept = kept.map(|event| (event.t_us, event.x)).collect();
        (kept, fit.lost())
    }

    #[test]
    fn what_fits_stays_as_it_is() {
        let (kept, lost) = fitted(&[at(0, 255), at(1000, 0), at(1000, 3)]);
        assert_eq!(kept, [(0, 255), (1000, 0), (1000, 3)]);
        assert!(lost.is_none());
    }

    #[test]
    fn absolute_times_are_shifted_and_the_rest_is_counted() {
        let events = [
            at(1 << 50, 1),
            at((1 << 50) + 9, 2),
            at((1 << 50) - 1, 3),
            at((1 << 50) + 8, 4),
            at((1 << 50) + 1001, 5),
            at((1 << 50) + 10, 256),
        ];
        let (kept, lost) = fitted(&events);
        assert_eq!(kept, [(0, 1), (9, 2), (9, 4)]);
        let want = Lost {
            shifted_us: 1 << 50,
            outside: 1,
            beyond_time: 2,
            raised: 1,
        };
        assert_eq!(lost, want);
    }

    #[test]
    fn only_the_first_kept_time_shifts() {
        let (kept, lost) = fitted(&[at(5, 1), at(1001, 1)]);
        assert_eq!(kept, [(5, 1)]);
        assert_eq!((lost.shifted_us, lost.beyond_time), (0, 1));
    }

    #[test]
    fn what_is_beyond_is_named() {
        assert_eq!(beyond(LIMITS, 0, at(1000, 255), Some(1000)), None);
        for (event, last, word) in [
            (at(0, 256), None, "columns up to 255"),
            (at(1001, 0), None, "end at 1000 us"),
            (at(3, 0), Some(4), "cannot step back"),
        ] {
            let text = beyond(LIMITS, 12, event, last).unwrap();
            assert!(
                text.contains("event 12 at") && text.contains(word),
                "{text}"
            );
        }
        let sensor = Sensor::new(1280, 720).unwrap();
        assert_eq!(Fit::sensor(LIMITS, sensor), Sensor::new(256, 256).unwrap());
    }
}
