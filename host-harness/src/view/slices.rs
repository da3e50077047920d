//! Sums a stream of events per slice of time and pixel, and omits empty slices.
//!
//! A slice stays open until an event arrives that is [`DISORDER_US`] past its end, so events may be out of order by
//! that much. Memory is bounded whatever the times of the events are: beyond [`WAITING_BYTES`] the oldest slices
//! close early.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Error, Result};
use eecvs_nostd::{Event, Sensor};
use event_metrics::windows::DISORDER_US;
use event_pictures::frame_picture::FrameSums;

use super::input::Input;

/// Largest memory of the events that wait for their slice to close.
pub const WAITING_BYTES: usize = 64 << 20;

/// Grid of slices: slice i is [from + i T, from + (i + 1) T).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Start of slice 0, in us; earlier events are left out.
    pub from_us: u64,
    /// End in us; events at or after this time are left out.
    pub to_us: Option<u64>,
    /// Duration T of a slice in us, at least 1.
    pub slice_us: u64,
}

impl Grid {
    /// Returns the start of a slice, in us.
    #[must_use]
    pub fn start_us(&self, index: u64) -> u64 {
        let offset = index.saturating_mul(self.slice_us);
        self.from_us.saturating_add(offset)
    }

    /// Returns the slice that holds a time; `None` outside of the range shown.
    #[must_use]
    pub fn index_of(&self, t_us: u64) -> Option<u64> {
        if self.to_us.is_some_and(|to_us| t_us >= to_us) {
            return None;
        }
        t_us.checked_sub(self.from_us)?.checked_div(self.slice_us)
    }
}

/// A slice that has events.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slice {
    /// Index on the grid.
    pub index: u64,
    /// Number of events.
    pub events: u64,
    /// Signed sum of the polarities per pixel.
    pub sums: FrameSums,
}

/// Contents of an open slice: its events while they are few, after that their sums.
#[derive(Debug)]
enum Open {
    Events(Vec<Event>),
    Sums(u64, FrameSums),
}

/// Cuts a stream into slices.
pub struct Slices {
    input: Input,
    grid: Grid,
    sensor: Sensor,
    stop: Arc<AtomicBool>,
    batch: Vec<Event>,
    open: BTreeMap<u64, Open>,
    closed: VecDeque<(u64, Open)>,
    /// Slices with a lower index have closed.
    first_open: u64,
    /// Memory of `open` in bytes.
    waiting_bytes: usize,
    /// Largest value of `waiting_bytes`.
    bytes_max: usize,
    newest_us: u64,
    /// Whether an event lay within the grid.
    is_begun: bool,
    ended: bool,
    /// Error that ended the stream, until it is returned.
    failure: Option<Error>,
    events_read: u64,
    late: u64,
    outside: u64,
}

impl Slices {
    /// Reads `input` on `grid` until `stop` is set, and sums over frames of the size of `sensor`.
    #[must_use]
    pub fn new(input: Input, grid: Grid, sensor: Sensor, stop: Arc<AtomicBool>) -> Self {
        Self {
            input,
            grid,
            sensor,
            stop,
            batch: Vec::new(),
            open: BTreeMap::new(),
            closed: VecDeque::new(),
            first_open: 0,
            waiting_bytes: 0,
            bytes_max: WAITING_BYTES,
            newest_us: 0,
            is_begun: false,
            ended: false,
            failure: None,
            events_read: 0,
            late: 0,
            outside: 0,
        }
    }

    /// Returns the input.
    #[must_use]
    pub const fn input(&self) -> &Input {
        &self.input
    }

    /// Returns the size of the frames.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the number of events read so far.
    #[must_use]
    pub const fn events_read(&self) -> u64 {
        self.events_read
    }

    /// Returns the number of events read so far whose slice had closed already.
    #[must_use]
    pub const fn late(&self) -> u64 {
        self.late
    }

    /// Returns the number of events read so far that lie outside of the sensor.
    #[must_use]
    pub const fn outside(&self) -> u64 {
        self.outside
    }

    /// Returns the next slice with events, in order of time; `None` at the end.
    ///
    /// # Errors
    /// Fails if the input is damaged, after everything before the damage has been returned.
    pub fn next_slice(&mut self) -> Result<Option<Slice>> {
        while self.closed.is_empty() && !self.ended {
            self.read_batch();
        }
        let Some((index, open)) = self.closed.pop_front() else {
            return self.failure.take().map_or(Ok(None), Err);
        };
        let (events, sums) = match open {
            Open::Events(events) => {
                let count = events.len() as u64;
                (count, FrameSums::new(self.sensor, &events))
            }
            Open::Sums(count, sums) => (count, sums),
        };
        Ok(Some(Slice {
            index,
            events,
            sums,
        }))
    }

    fn read_batch(&mut self) {
        let mut batch = std::mem::take(&mut self.batch);
        batch.clear();
        match self.input.read(&mut batch) {
            Ok(0) => self.ended = true,
            Ok(_) => {}
            Err(error) => {
                self.failure = Some(error);
                self.ended = true;
            }
        }
        for event in &batch {
            self.take(event);
        }
        self.batch = batch;
        // From here on, no event can belong to a slice that is shown.
        let past = self
            .grid
            .to_us
            .map(|to_us| to_us.saturating_add(DISORDER_US));
        self.ended |= past.is_some_and(|past| self.newest_us >= past);
        self.ended |= self.stop.load(Ordering::Relaxed);
        if self.ended {
            self.close_below(u64::MAX);
            // Only a slice of 1 us at the time `u64::MAX` has the index `u64::MAX`, which `close_below` leaves.
            self.closed.extend(std::mem::take(&mut self.open));
        }
    }

    fn take(&mut self, event: &Event) {
        self.events_read += 1;
        let index = self.grid.index_of(event.t_us);
        self.is_begun |= index.is_some();
        if !self.is_begun {
            // Times past the end may be those of another run, whose clock began anew behind it.
            return;
        }
        if event.t_us > self.newest_us {
            self.newest_us = event.t_us;
            let settled_us = event.t_us.saturating_sub(DISORDER_US);
            if settled_us >= self.grid.start_us(self.first_open.saturating_add(1)) {
                // Past the end of the range shown, every slice closes.
                let index = self.grid.index_of(settled_us).unwrap_or(u64::MAX);
                self.close_below(index);
            }
        }
        let Some(index) = index else {
            return;
        };
        if !self.sensor.contains(event.x, event.y) {
            self.outside += 1;
            return;
        }
        if index < self.first_open {
            self.late += 1;
            return;
        }
        let sums_bytes = self.sensor.pixels() as usize * size_of::<i64>();
        let open = self.open.entry(index).or_insert(Open::Events(vec![]));
        let before = open.bytes(sums_bytes);
        open.add(event, self.sensor, sums_bytes);
        self.waiting_bytes = self.waiting_bytes - before + open.bytes(sums_bytes);
        // The newest slice stays open, so that even a slice larger than the limit makes progress.
        while self.waiting_bytes > self.bytes_max && self.open.len() > 1 {
            let Some(oldest) = self.open.first_key_value().map(|(index, _)| *index) else {
                break;
            };
            self.close_below(oldest.saturating_add(1));
        }
    }

    /// Closes the slices with an index below `index`.
    fn close_below(&mut self, index: u64) {
        if index <= self.first_open {
            return;
        }
        self.first_open = index;
        let sums_bytes = self.sensor.pixels() as usize * size_of::<i64>();
        while let Some(entry) = self.open.first_entry() {
            if *entry.key() >= index {
                break;
            }
            let (index, open) = entry.remove_entry();
            self.waiting_bytes -= open.bytes(sums_bytes);
            self.closed.push_back((index, open));
        }
    }
}

impl Open {
    fn bytes(&self, sums_bytes: usize) -> usize {
        match self {
            Self::Events(events) => events.capacity() * size_of::<Event>(),
            Self::Sums(..) => sums_bytes,
        }
    }

    fn add(&mut self, event: &Event, sensor: Sensor, sums_bytes: usize) {
        match self {
            Self::Events(events) if size_of_val(events.as_slice()) >= sums_bytes => {
                let mut sums = FrameSums::new(sensor, events);
                sums.add(event);
                *self = Self::Sums(events.len() as u64 + 1, sums);
            }
            Self::Events(events) => events.push(*event),
            Self::Sums(count, sums) => {
                *count += 1;
                sums.add(event);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use event_files::Ahead;
    use event_types::test_events::{SENSOR, event, reader};

    use super::*;

    const GRID: Grid = Grid {
        from_us: 1_000,
        to_us: None,
        slice_us: 100,
    };

    fn slices(events: &[Event], batch: usize, grid: Grid) -> Slices {
        let reader = reader(events, batch);
        let input = Input::Recording(Ahead::new(Box::new(reader), 0));
        Slices::new(input, grid, SENSOR, Arc::default())
    }

    fn all(slices: &mut Slices) -> Vec<Slice> {
        std::iter::from_fn(|| slices.next_slice().unwrap()).collect()
    }

    #[test]
    fn slices_are_half_open_and_start_at_the_grid() {
        let events = [
            event(999, 0, 0, true),
            event(1_000, 1, 0, true),
            event(1_099, 1, 0, true),
            event(1_100, 2, 3, false),
            event(5_000, 9, 9, true),
        ];
        for batch in [1, 2, 100] {
            let mut slices = slices(&events, batch, GRID);
            let found = all(&mut slices);
            let indices: Vec<_> = found.iter().map(|s| (s.index, s.events)).collect();
            assert_eq!(indices, [(0, 2), (1, 1), (40, 1)]);
            assert_eq!(found[0].sums, FrameSums::new(SENSOR, &events[1..3]));
            assert_eq!(found[1].sums.sum(2, 3), -1);
            assert_eq!((slices.events_read(), slices.late()), (5, 0));
        }
    }

    #[test]
    fn disorder_within_bounds_loses_nothing_and_beyond_is_counted() {
        let events = [
            event(1_000 + DISORDER_US, 0, 0, true),
            event(1_050, 1, 1, true),
            event(1_100 + DISORDER_US, 0, 0, true),
            event(1_050, 1, 1, true),
            event(1_100, 1, 1, true),
        ];
        let mut slices = slices(&events, 1, GRID);
        let found = all(&mut slices);
        assert_eq!(found.iter().map(|s| s.events).sum::<u64>(), 4);
        assert_eq!(slices.late(), 1);
        assert!(found.is_sorted_by_key(|slice| slice.index));
    }

    #[test]
    fn what_is_not_wanted_is_left_out_and_not_read_for() {
        let mut events: Vec<_> = (0..1_000).map(|i| event(1_000 * i, 0, 0, true)).collect();
        events.insert(3, event(2_100, 64, 0, true));
        let grid = Grid {
            to_us: Some(3_000),
            ..GRID
        };
        let mut slices = slices(&events, 1, grid);
        let indices: Vec<_> = all(&mut slices).iter().map(|s| s.index).collect();
        assert_eq!(indices, [0, 10]);
        assert_eq!(slices.outside(), 1);
        assert!(slices.events_read() < 40, "{}", slices.events_read());
    }

    /// Of two recordings in one file, the second may hold the times that are wanted.
    #[test]
    fn times_of_a_later_run_are_found() {
        let later = (0..100).map(|i| event(1_000_000 + 1_000 * i, 0, 0, true));
        let wanted = (0..100).map(|i| event(1_000 * i, 0, 0, true));
        let events: Vec<_> = later.chain(wanted).collect();
        let grid = Grid {
            to_us: Some(3_000),
            ..GRID
        };
        let mut slices = slices(&events, 10, grid);
        let found = all(&mut slices);
        assert_eq!(found.iter().map(|slice| slice.events).sum::<u64>(), 2);
    }

    #[test]
    fn times_at_both_ends_are_times() {
        let events = [event(0, 0, 0, true), event(u64::MAX, 1, 1, true)];
        let grid = Grid {
            from_us: 0,
            to_us: None,
            slice_us: 1,
        };
        let indices: Vec<_> = all(&mut slices(&events, 2, grid))
            .iter()
            .map(|s| s.index)
            .collect();
        assert_eq!(indices, [0, u64::MAX]);
    }

    #[test]
    fn many_events_of_a_slice_take_no_more_than_their_sums() {
        let pixels = SENSOR.pixels() as usize;
        let many: Vec<_> = (0..4 * pixels)
            .map(|i| event(1_000, (i % 64) as u16, (i / 64 % 48) as u16, i % 3 > 0))
            .collect();
        let mut slices = slices(&many, 1_000, GRID);
        let mut peak = 0;
        while !slices.ended {
            slices.read_batch();
            peak = peak.max(slices.waiting_bytes);
        }
        assert!(peak <= 16 * pixels, "{peak}");
        let found = all(&mut slices);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].events, many.len() as u64);
        assert_eq!(found[0].sums, FrameSums::new(SENSOR, &many));
    }

    #[test]
    fn what_waits_is_bounded() {
        let events: Vec<_> = (0..30_000).map(|i| event(1_000 + i, 0, 0, true)).collect();
        let grid = Grid {
            slice_us: 1,
            ..GRID
        };
        let mut slices = slices(&events, 64, grid);
        slices.bytes_max = 10_000;
        let mut count = 0;
        while let Some(slice) = slices.next_slice().unwrap() {
            assert_eq!(slice.index, count);
            count += 1;
            assert!(slices.waiting_bytes <= 10_000);
        }
        assert_eq!((count, slices.late()), (30_000, 0));
    }

    #[test]
    fn a_stop_ends_it() {
        let events: Vec<_> = (0..30_000).map(|i| event(1_000 + i, 0, 0, true)).collect();
        let mut slices = slices(&events, 10, GRID);
        slices.stop.store(true, Ordering::Relaxed);
        assert!(all(&mut slices).len() < 300);
        assert!(slices.events_read() <= 10);
    }
}
