//! Cuts two event streams into the same windows and pairs them.
//!
//! The grid is A's: half-open windows of `window_us`, aligned to A's earliest event. Windows before that event have
//! negative indices. A stream keeps a window open until it has seen an event [`Grid::slack_us`] past the window's
//! end, so events may be out of order by that much without loss. An event whose window has closed is counted as late.

use std::collections::{BTreeMap, VecDeque};

use event_types::stream::{BATCH_EVENTS, Context, EventReader, Result};
use event_types::{Event, Sensor, bail, ensure};

/// Disorder within a recording, in us, that never makes an event late.
pub const DISORDER_US: u64 = 32_768;

/// Position and length of the windows in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    origin_us: u64,
    window_us: u64,
}

impl Grid {
    /// Creates a grid of windows of `window_us`, aligned to `origin_us`.
    ///
    /// # Errors
    /// `window_us` is 0.
    pub fn new(origin_us: u64, window_us: u64) -> Result<Self> {
        ensure!(
            window_us > 0,
            Undecided,
            "the window must be 1 us or longer; give --window-us"
        );
        Ok(Self {
            origin_us,
            window_us,
        })
    }

    /// Returns the window length T in us.
    #[must_use]
    pub const fn window_us(&self) -> u64 {
        self.window_us
    }

    /// Returns how long a window stays open past its end, in us: the window length or [`DISORDER_US`], whichever is
    /// longer.
    #[must_use]
    pub fn slack_us(&self) -> u64 {
        self.window_us.max(DISORDER_US)
    }

    /// Returns the index of the window that holds time `t_us`; window 0 starts at the origin.
    #[must_use]
    pub fn index_of(&self, t_us: u64) -> i128 {
        (i128::from(t_us) - i128::from(self.origin_us)).div_euclid(i128::from(self.window_us))
    }

    /// Returns the start of window `index`, in us; it may be negative for a window that contains time 0.
    #[must_use]
    pub fn start_us(&self, index: i128) -> i128 {
        i128::from(self.origin_us) + index * i128::from(self.window_us)
    }
}

/// Returns the earliest time among the first [`BATCH_EVENTS`] events of a recording, `None` if it has no events.
///
/// # Errors
/// An error of the reader.
pub fn first_time_us(reader: &mut dyn EventReader) -> Result<Option<u64>> {
    let mut events = Vec::new();
    while events.len() < BATCH_EVENTS && reader.read(&mut events)? > 0 {}
    // The cut makes the result independent of how many events a reader returns at a time.
    Ok(events.iter().take(BATCH_EVENTS).map(|e| e.t_us).min())
}

/// The events of one window of one stream, in no particular order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Window {
    /// Index of the window on the grid.
    pub index: i128,
    /// Events of the window; never empty when returned by [`Windower::next_window`].
    pub events: Vec<Event>,
}

/// Cuts one stream into the windows of a grid, skipping empty windows.
pub struct Windower {
    reader: Box<dyn EventReader>,
    grid: Grid,
    sensor: Sensor,
    batch: Vec<Event>,
    open: BTreeMap<i128, Vec<Event>>,
    closed: VecDeque<Window>,
    /// Windows below this index have closed.
    first_open: i128,
    newest_us: Option<u64>,
    ended: bool,
    events_read: u64,
    late: u64,
}

impl Windower {
    /// Creates a windower that reads `reader` on `grid`; an event outside `sensor` is an error.
    #[must_use]
    pub fn new(reader: Box<dyn EventReader>, grid: Grid, sensor: Sensor) -> Self {
        Self {
            reader,
            grid,
            sensor,
            batch: Vec::new(),
            open: BTreeMap::new(),
            closed: VecDeque::new(),
            first_open: i128::MIN,
            newest_us: None,
            ended: false,
            events_read: 0,
            late: 0,
        }
    }

    /// Returns the number of events read so far, including late events.
    #[must_use]
    pub fn events_read(&self) -> u64 {
        self.events_read
    }

    /// Returns the number of late events so far, whose window had already closed.
    #[must_use]
    pub fn late(&self) -> u64 {
        self.late
    }

    /// Returns the next window that holds events, in time order; `None` at the end.
    ///
    /// # Errors
    /// An error of the reader, or an event outside the sensor.
    pub fn next_window(&mut self) -> Result<Option<Window>> {
        while self.closed.is_empty() && !self.ended {
            self.read_batch()?;
        }
        Ok(self.closed.pop_front())
    }

    fn read_batch(&mut self) -> Result<()> {
        let mut batch = std::mem::take(&mut self.batch);
        batch.clear();
        if self.reader.read(&mut batch)? == 0 {
            self.ended = true;
            self.close_below(i128::MAX);
        }
        self.sort_into_windows(&batch)?;
        self.batch = batch;
        Ok(())
    }

    fn sort_into_windows(&mut self, batch: &[Event]) -> Result<()> {
        let mut rest = batch;
        while let Some(first) = rest.first() {
            let index = self.grid.index_of(first.t_us);
            let start = self.grid.start_us(index);
            let end = start + i128::from(self.grid.window_us());
            // The division in `index_of` is slow, so runs of events of one window are moved at once.
            let run_end = rest
                .iter()
                .position(|e| !(start..end).contains(&i128::from(e.t_us)))
                .unwrap_or(rest.len());
            let (run, after) = rest.split_at(run_end);
            rest = after;
            if let Some(outside) = run.iter().position(|e| !self.sensor.contains(e.x, e.y)) {
                let event = run.get(outside).context("position lies in the run")?;
                bail!(
                    Undecided,
                    "event {} at ({}, {}) lies outside the {}x{} sensor; give --width and --height",
                    self.events_read + outside as u64,
                    event.x,
                    event.y,
                    self.sensor.width,
                    self.sensor.height,
                );
            }
            self.events_read += run.len() as u64;
            if index < self.first_open {
                self.late += run.len() as u64;
                continue;
            }
            self.open.entry(index).or_default().extend_from_slice(run);
            let newest = run.iter().map(|e| e.t_us).max().max(self.newest_us);
            if newest > self.newest_us {
                self.newest_us = newest;
                let settled_us = newest.unwrap_or(0).saturating_sub(self.grid.slack_us());
                self.close_below(self.grid.index_of(settled_us));
            }
        }
        Ok(())
    }

    /// Closes the windows whose index is below `index`.
    fn close_below(&mut self, index: i128) {
        if index <= self.first_open {
            return;
        }
        self.first_open = index;
        while let Some(entry) = self.open.first_entry() {
            if *entry.key() >= index {
                break;
            }
            let (index, events) = entry.remove_entry();
            self.closed.push_back(Window { index, events });
        }
    }
}

/// The same window of both recordings; at least one side holds events.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct WindowPair {
    /// Index of the window on A's grid.
    pub index: i128,
    /// A's events in the window.
    pub a: Vec<Event>,
    /// B's events in the window.
    pub b: Vec<Event>,
}

/// Walks through two streams window by window. Gaps cost nothing, however long they are.
pub struct Pairs {
    a: Windower,
    b: Windower,
    next_a: Option<Window>,
    next_b: Option<Window>,
}

impl Pairs {
    /// Pairs the windows of two streams on the same grid.
    #[must_use]
    pub fn new(a: Windower, b: Windower) -> Self {
        Self {
            a,
            b,
            next_a: None,
            next_b: None,
        }
    }

    /// Returns the next window in which either side holds events; `None` at the end of both.
    ///
    /// # Errors
    /// An error of either stream.
    pub fn next_pair(&mut self) -> Result<Option<WindowPair>> {
        if self.next_a.is_none() {
            self.next_a = self.a.next_window().context("recording A")?;
        }
        if self.next_b.is_none() {
            self.next_b = self.b.next_window().context("recording B")?;
        }
        let next = [&self.next_a, &self.next_b];
        let Some(index) = next.into_iter().flatten().map(|w| w.index).min() else {
            return Ok(None);
        };
        let take = |next: &mut Option<Window>| next.take_if(|w| w.index == index);
        Ok(Some(WindowPair {
            index,
            a: take(&mut self.next_a).map_or_else(Vec::new, |w| w.events),
            b: take(&mut self.next_b).map_or_else(Vec::new, |w| w.events),
        }))
    }

    /// Returns stream A, for its counts of events.
    #[must_use]
    pub fn a(&self) -> &Windower {
        &self.a
    }

    /// Returns stream B, for its counts of events.
    #[must_use]
    pub fn b(&self) -> &Windower {
        &self.b
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event, reader};

    use super::*;

    fn windower(events: &[Event], batch: usize) -> Windower {
        let grid = Grid::new(100, 1000).unwrap();
        Windower::new(Box::new(reader(events, batch)), grid, SENSOR)
    }

    fn drain(mut windower: Windower) -> (Vec<(i128, usize)>, u64) {
        let mut windows = Vec::new();
        while let Some(window) = windower.next_window().unwrap() {
            windows.push((window.index, window.events.len()));
        }
        (windows, windower.late())
    }

    #[test]
    fn windows_are_half_open_and_reach_below_the_origin() {
        let times = [99, 100, 1099, 1100, 5_000_000_000_000_000];
        let events: Vec<_> = times.iter().map(|t| event(*t, 1, 1, true)).collect();
        let (windows, late) = drain(windower(&events, 2));
        assert_eq!(windows, [(-1, 1), (0, 2), (1, 1), (4_999_999_999_999, 1)]);
        assert_eq!(late, 0);
    }

    #[test]
    fn disorder_within_the_slack_is_sorted_and_beyond_it_counted() {
        let slack = DISORDER_US;
        let times = [100, 1100 + slack - 1, 1099, 1100 + slack, 1098, 1100];
        let events: Vec<_> = times.iter().map(|t| event(*t, 1, 1, true)).collect();
        for batch in 1..=times.len() {
            let (windows, late) = drain(windower(&events, batch));
            assert_eq!(windows, [(0, 2), (1, 1), (33, 2)], "batch {batch}");
            assert_eq!(late, 1);
        }
    }

    #[test]
    fn events_outside_of_the_sensor_are_named() {
        let events = [event(100, 1, 1, true), event(101, SENSOR.width, 1, true)];
        let message = windower(&events, 1).next_window().unwrap_err().to_string();
        assert!(message.starts_with("event 1 at (64, 1)"), "{message}");
    }

    #[test]
    fn the_origin_does_not_depend_on_batches() {
        let mut events = vec![event(50, 0, 0, true); BATCH_EVENTS];
        events.push(event(7, 0, 0, true));
        for batch in [1000, BATCH_EVENTS] {
            let first = first_time_us(&mut reader(&events, batch)).unwrap();
            assert_eq!(first, Some(50));
        }
    }
}
