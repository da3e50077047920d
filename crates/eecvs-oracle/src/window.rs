//! Windows of an event stream: which events belong together, and over which duration.
//!
//! Window w covers the half-open interval [t0, t0 + T). Windows are consecutive, and the first is aligned to the
//! first event. Three rules complete the definition:
//!
//! * An event at or after t0 + T closes the window. The next window that holds an event starts a whole number of T
//!   later; the empty windows in between are skipped.
//! * A full window closes early when another event of its interval arrives. Its duration ends at that event, but in
//!   any case after the latest event held, so that every u = (t - t0) / duration stays below 1. The next window
//!   starts at that event.
//! * An event older than the open window's start closes the window and begins a new run: the next window starts at
//!   that event.

use std::num::{NonZeroU32, NonZeroUsize};

use event_types::Event;

/// Maximum number of events that the host holds in one window: 2^20.
pub const HOST_CAPACITY: NonZeroUsize = NonZeroUsize::new(1 << 20).unwrap();

/// One closed window; it holds at least one event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Start in microseconds, inclusive.
    pub t0_us: u64,
    /// T of the formulas in microseconds, at least 1: the configured T, or less for a window that closed early.
    pub duration_us: u32,
    /// Events in order of arrival, each with `0 <= t - t0 < duration_us`.
    pub events: Vec<Event>,
    /// Whether the clock jumped back before this window.
    pub begins_run: bool,
}

impl Window {
    /// Returns the time of a held event since the window's start, in microseconds: `0..duration_us`.
    ///
    /// # Panics
    /// If `event` is older than the window, or 2^32 us or more after its start; a [`Windower`] holds no such event.
    #[must_use]
    pub fn offset_us(&self, event: &Event) -> u32 {
        offset_us(self.t0_us, event.t_us)
    }
}

/// Cuts a stream into windows, one event at a time; only the open window is held.
#[derive(Debug, Clone)]
pub struct Windower {
    window_us: NonZeroU32,
    capacity: NonZeroUsize,
    open: Option<Window>,
}

impl Windower {
    /// Creates a windower with windows of `window_us` microseconds and at most `capacity` events.
    #[must_use]
    pub fn new(window_us: NonZeroU32, capacity: NonZeroUsize) -> Self {
        Self {
            window_us,
            capacity,
            open: None,
        }
    }

    /// Takes the next event and returns the window that it closed, if any.
    pub fn push(&mut self, event: Event) -> Option<Window> {
        let Some(open) = &mut self.open else {
            self.open = Some(self.start(event.t_us, event));
            return None;
        };
        if event.t_us < open.t0_us {
            let next = Window {
                begins_run: true,
                ..self.start(event.t_us, event)
            };
            return self.open.replace(next);
        }
        let period_us = u64::from(self.window_us.get());
        let elapsed_us = event.t_us - open.t0_us;
        let next_t0_us = if elapsed_us >= period_us {
            event.t_us - elapsed_us % period_us
        } else if open.events.len() < self.capacity.get() {
            open.events.push(event);
            return None;
        } else {
            let latest_us = open
                .events
                .iter()
                .map(|e| e.t_us)
                .max()
                .unwrap_or(open.t0_us);
            let latest_offset_us = offset_us(open.t0_us, latest_us);
            open.duration_us = offset_us(open.t0_us, event.t_us).max(latest_offset_us + 1);
            event.t_us
        };
        let next = self.start(next_t0_us, event);
        self.open.replace(next)
    }

    /// Returns the open window at the end of the stream; its duration is the configured T.
    #[must_use]
    pub fn flush(self) -> Option<Window> {
        self.open
    }

    fn start(&self, t0_us: u64, event: Event) -> Window {
        Window {
            t0_us,
            duration_us: self.window_us.get(),
            events: vec![event],
            begins_run: false,
        }
    }
}

/// Returns all windows of a stream that is in memory.
#[must_use]
pub fn windows(events: &[Event], window_us: NonZeroU32, capacity: NonZeroUsize) -> Vec<Window> {
    let mut windower = Windower::new(window_us, capacity);
    let mut closed: Vec<Window> = events.iter().filter_map(|e| windower.push(*e)).collect();
    closed.extend(windower.flush());
    closed
}

/// Returns `t_us - t0_us` for a time inside a window, which is shorter than 2^32 us.
fn offset_us(t0_us: u64, t_us: u64) -> u32 {
    let offset_us = t_us
        .checked_sub(t0_us)
        .and_then(|offset| u32::try_from(offset).ok());
    offset_us.expect("a held event lies less than 2^32 us after t0")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_events::at;

    fn cut(times: &[u64], window_us: u32, capacity: usize) -> Vec<Window> {
        let events: Vec<Event> = times.iter().map(|t| at(*t)).collect();
        windows(
            &events,
            NonZeroU32::new(window_us).unwrap(),
            NonZeroUsize::new(capacity).unwrap(),
        )
    }

    /// (t0, duration, held times, whether a run begins) of each window.
    fn shape(windows: &[Window]) -> Vec<(u64, u32, Vec<u64>, u64)> {
        windows
            .iter()
            .map(|w| {
                (
                    w.t0_us,
                    w.duration_us,
                    w.events.iter().map(|e| e.t_us).collect(),
                    u64::from(w.begins_run),
                )
            })
            .collect()
    }

    #[test]
    fn no_event_makes_no_window() {
        assert!(cut(&[], 10, 4).is_empty());
    }

    #[test]
    fn interval_is_half_open_and_aligned_to_the_first_event() {
        assert_eq!(
            shape(&cut(&[7, 16, 17, 26], 10, 9)),
            [(7, 10, vec![7, 16], 0), (17, 10, vec![17, 26], 0)]
        );
    }

    #[test]
    fn gaps_keep_the_grid_and_empty_windows_are_skipped() {
        assert_eq!(
            shape(&cut(&[5, 38, 45], 10, 9)),
            [
                (5, 10, vec![5], 0),
                (35, 10, vec![38], 0),
                (45, 10, vec![45], 0)
            ]
        );
    }

    #[test]
    fn full_window_closes_at_the_event_that_no_longer_fits() {
        assert_eq!(
            shape(&cut(&[100, 103, 105, 109, 114, 115], 10, 2)),
            [
                (100, 5, vec![100, 103], 0),
                (105, 9, vec![105, 109], 0),
                (114, 10, vec![114, 115], 0)
            ]
        );
    }

    #[test]
    fn full_window_that_runs_its_time_keeps_its_duration() {
        assert_eq!(
            shape(&cut(&[0, 3, 10], 10, 2)),
            [(0, 10, vec![0, 3], 0), (10, 10, vec![10], 0)]
        );
    }

    #[test]
    fn ties_at_the_closing_time_keep_u_below_one() {
        // The third event has the same time as the second: the interval is [0, 4), not [0, 3).
        assert_eq!(
            shape(&cut(&[0, 3, 3, 4], 10, 2)),
            [(0, 4, vec![0, 3], 0), (3, 10, vec![3, 4], 0)]
        );
        // All at t0: the duration is 1, never 0.
        assert_eq!(
            shape(&cut(&[8, 8, 8], 10, 1)),
            [(8, 1, vec![8], 0), (8, 1, vec![8], 0), (8, 10, vec![8], 0)]
        );
    }

    #[test]
    fn unordered_event_that_does_not_fit_starts_the_next_window_at_its_own_time() {
        assert_eq!(
            shape(&cut(&[0, 6, 2, 1, 11], 10, 2)),
            [
                (0, 7, vec![0, 6], 0),
                (2, 10, vec![2], 0),
                (1, 10, vec![1], 1),
                (11, 10, vec![11], 0)
            ]
        );
    }

    #[test]
    fn a_clock_that_falls_back_begins_a_run() {
        assert_eq!(
            shape(&cut(&[10, 9, 12, 20, 19, 0, 21], 10, 9)),
            [
                (10, 10, vec![10], 0),
                (9, 10, vec![9, 12], 1),
                (19, 10, vec![20, 19], 0),
                (0, 10, vec![0], 1),
                (20, 10, vec![21], 0)
            ]
        );
        // A full window closed by a backward jump keeps its duration as well.
        assert_eq!(
            shape(&cut(&[10, 9], 10, 1)),
            [(10, 10, vec![10], 0), (9, 10, vec![9], 1)]
        );
    }

    #[test]
    fn epoch_times_and_extreme_periods() {
        let t = 1_700_000_000_000_000;
        assert_eq!(
            shape(&cut(&[t, t + 32_767, t + 32_768], 32_768, 9)),
            [
                (t, 32_768, vec![t, t + 32_767], 0),
                (t + 32_768, 32_768, vec![t + 32_768], 0)
            ]
        );
        assert_eq!(
            shape(&cut(&[t, t, t + 1, t + 5], 1, 9)),
            [
                (t, 1, vec![t, t], 0),
                (t + 1, 1, vec![t + 1], 0),
                (t + 5, 1, vec![t + 5], 0)
            ]
        );
        let hour_us = 3_600_000_000;
        let hour = u64::from(hour_us);
        assert_eq!(
            shape(&cut(&[t, t + hour - 1, t + 7 * hour + 3], hour_us, 9)),
            [
                (t, hour_us, vec![t, t + hour - 1], 0),
                (t + 7 * hour, hour_us, vec![t + 7 * hour + 3], 0)
            ]
        );
        // The end of the clock: t0 + T would overflow.
        assert_eq!(
            shape(&cut(&[0, u64::MAX - 1, u64::MAX, u64::MAX], u32::MAX, 2)).len(),
            3
        );
    }

    proptest! {
        #[test]
        fn every_event_is_held(
            times in prop::collection::vec(0u64..200, 0..60),
            window_us in 1u32..40,
            capacity in 1usize..6,
        ) {
            let cut = cut(&times, window_us, capacity);
            let held: usize = cut.iter().map(|w| w.events.len()).sum();
            prop_assert_eq!(held, times.len());
            for w in &cut {
                prop_assert!((1..=window_us).contains(&w.duration_us));
                prop_assert!((1..=capacity).contains(&w.events.len()));
                prop_assert!(w.events.iter().all(|e| w.offset_us(e) < w.duration_us));
            }
            for pair in cut.windows(2) {
                prop_assert_eq!(pair[0].t0_us > pair[1].t0_us, pair[1].begins_run);
            }
        }

        #[test]
        fn without_a_capacity_starts_lie_on_the_grid(
            mut times in prop::collection::vec(0u64..500, 1..60),
            window_us in 1u32..40,
        ) {
            times.sort_unstable();
            for w in cut(&times, window_us, 1000) {
                prop_assert_eq!((w.t0_us - times[0]) % u64::from(window_us), 0);
                prop_assert_eq!(w.duration_us, window_us);
                prop_assert!(!w.begins_run);
            }
        }
    }
}
