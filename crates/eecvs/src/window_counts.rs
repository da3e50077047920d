//! Counts the events in the windows of a stream, without storing the events.

use std::num::{NonZeroU32, NonZeroUsize};

use event_types::Event;

use crate::storage::WINDOW_EVENTS;

/// Default capacity of a window on the host in events, after which the window closes early.
pub const CAPACITY: NonZeroUsize = NonZeroUsize::new(WINDOW_EVENTS).unwrap();

/// One closed window; it has at least one event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowCount {
    /// Start in microseconds.
    pub t0_us: u64,
    /// Duration in microseconds: the configured T, or less if the window closed early; at least 1.
    pub duration_us: u32,
    /// Number of events, 1 to the capacity.
    pub events: u32,
    /// Whether the clock fell back before this window.
    pub begins_run: bool,
}

/// Counts events in windows that are cut as the encoder's windows are: consecutive on a grid from the first event
/// on, closed early when the capacity is reached, and started again when the clock falls back.
#[derive(Debug, Clone)]
pub struct WindowCounter {
    window_us: NonZeroU32,
    capacity: u32,
    open: Option<Open>,
}

#[derive(Debug, Clone, Copy)]
struct Open {
    window: WindowCount,
    /// Time of the latest event, in microseconds from the window's start.
    latest_us: u32,
}

impl WindowCounter {
    /// Creates a counter for windows of `window_us` microseconds and at most `capacity` events.
    #[must_use]
    pub fn new(window_us: NonZeroU32, capacity: NonZeroUsize) -> Self {
        Self {
            window_us,
            capacity: u32::try_from(capacity.get()).unwrap_or(u32::MAX),
            open: None,
        }
    }

    /// Adds the next event; returns the window that it closed, if any.
    pub fn push(&mut self, event: &Event) -> Option<WindowCount> {
        let period_us = self.window_us.get();
        let open_at = |t0_us: u64, begins_run| Open {
            window: WindowCount {
                t0_us,
                duration_us: period_us,
                events: 1,
                begins_run,
            },
            // Fits a u32: less than a period.
            latest_us: (event.t_us - t0_us) as u32,
        };
        let Some(open) = &mut self.open else {
            self.open = Some(open_at(event.t_us, false));
            return None;
        };
        let mut closed = open.window;
        let next = match event.t_us.checked_sub(closed.t0_us) {
            None => open_at(event.t_us, true),
            Some(elapsed_us) => match u32::try_from(elapsed_us) {
                Ok(offset_us) if offset_us < period_us => {
                    if closed.events < self.capacity {
                        open.window.events += 1;
                        open.latest_us = open.latest_us.max(offset_us);
                        return None;
                    }
                    // The window ends at the event that does not fit, but in any case after its latest event.
                    closed.duration_us = offset_us.max(open.latest_us + 1);
                    open_at(event.t_us, false)
                }
                _ => open_at(event.t_us - elapsed_us % u64::from(period_us), false),
            },
        };
        self.open = Some(next);
        Some(closed)
    }

    /// Closes the open window at the end of the stream and returns it; its duration is the configured T.
    #[must_use]
    pub fn flush(self) -> Option<WindowCount> {
        self.open.map(|open| open.window)
    }
}

#[cfg(test)]
mod tests {
    use eecvs_oracle::window::windows;
    use event_types::Polarity;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn windows_are_the_oracles(
            times in prop::collection::vec(prop_oneof![0..300u64, Just(u64::MAX)], 0..80),
            window_us in prop_oneof![1..60u32, Just(u32::MAX)],
            capacity in 1..9usize,
        ) {
            let events: Vec<Event> = times
                .iter()
                .map(|&t_us| Event { t_us, x: 0, y: 0, polarity: Polarity::On })
                .collect();
            let (window_us, capacity) = (
                NonZeroU32::new(window_us).unwrap(),
                NonZeroUsize::new(capacity).unwrap(),
            );
            let mut counter = WindowCounter::new(window_us, capacity);
            let mut counts: Vec<_> = events.iter().filter_map(|event| counter.push(event)).collect();
            counts.extend(counter.flush());
            let want: Vec<_> = windows(&events, window_us, capacity)
                .iter()
                .map(|window| WindowCount {
                    t0_us: window.t0_us,
                    duration_us: window.duration_us,
                    events: window.events.len() as u32,
                    begins_run: window.begins_run,
                })
                .collect();
            prop_assert_eq!(counts, want);
        }
    }
}
