//! Pairs slices of one or two streams into frames, and shortens stretches without events.

use anyhow::Result;
use event_pictures::frame_picture::FrameSums;

use super::slices::{Grid, Slice, Slices};

/// What is shown at once: the same slice of time of every input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Start of the slice, in us of the first input's clock.
    pub start_us: u64,
    /// Number of events of the first input.
    pub events: u64,
    /// Number of events of the second input; 0 if there is none.
    pub decoded_events: u64,
    /// Sums of the first input per pixel.
    pub original: FrameSums,
    /// Sums of the second input per pixel, if there is one.
    pub decoded: Option<FrameSums>,
    /// Time omitted before this frame, in us.
    pub skipped_us: u64,
}

/// Walks one or two streams slice by slice; events of both are placed on one grid by their own times.
pub struct Frames {
    grid: Grid,
    /// Largest number of consecutive empty frames.
    empty_max: u64,
    original: Peeked,
    decoded: Option<Peeked>,
    /// Index of the slice to show next; `None` before the first.
    next: Option<u64>,
    skipped_us: u64,
    shared: u64,
}

/// Slices of one stream, with a look at the next one.
struct Peeked {
    slices: Slices,
    next: Option<Slice>,
}

impl Peeked {
    fn index(&mut self) -> Result<Option<u64>> {
        if self.next.is_none() {
            self.next = self.slices.next_slice()?;
        }
        Ok(self.next.as_ref().map(|slice| slice.index))
    }

    fn take(&mut self, index: u64) -> Option<Slice> {
        self.next.take_if(|slice| slice.index == index)
    }
}

impl Frames {
    /// Pairs the slices of `original` with those of `decoded`, which use the same `grid`. The first frame is the
    /// first slice with events; at most `empty_max` consecutive frames without events are shown.
    #[must_use]
    pub fn new(grid: Grid, empty_max: u64, original: Slices, decoded: Option<Slices>) -> Self {
        let peeked = |slices| Peeked { slices, next: None };
        Self {
            grid,
            empty_max,
            original: peeked(original),
            decoded: decoded.map(peeked),
            next: None,
            skipped_us: 0,
            shared: 0,
        }
    }

    /// Returns the duration of a slice, in us.
    #[must_use]
    pub const fn slice_us(&self) -> u64 {
        self.grid.slice_us
    }

    /// Returns the slices of the first input, for their counts.
    #[must_use]
    pub const fn original(&self) -> &Slices {
        &self.original.slices
    }

    /// Returns the slices of the second input, if there is one, for their counts.
    #[must_use]
    pub fn decoded(&self) -> Option<&Slices> {
        self.decoded.as_ref().map(|peeked| &peeked.slices)
    }

    /// Returns the duration of the stretches without events omitted so far, in us.
    #[must_use]
    pub const fn skipped_us(&self) -> u64 {
        self.skipped_us
    }

    /// Returns the number of frames so far in which both inputs have events.
    #[must_use]
    pub const fn shared(&self) -> u64 {
        self.shared
    }

    /// Returns the next frame, or `None` at the end.
    ///
    /// # Errors
    /// Fails if an input is damaged, after every frame before the damage has been returned.
    pub fn next_frame(&mut self) -> Result<Option<Frame>> {
        let decoded = match &mut self.decoded {
            Some(decoded) => decoded.index()?,
            None => None,
        };
        let busy = match (self.original.index()?, decoded) {
            (Some(a), Some(b)) => a.min(b),
            (Some(index), None) | (None, Some(index)) => index,
            (None, None) => return Ok(None),
        };
        // Slices come in order, so `busy` is never less than `next`.
        let wanted = self.next.unwrap_or(busy).min(busy);
        let empty = busy - wanted;
        // A short stretch is shown whole; of a long one, only its last `empty_max` slices.
        let left_out = empty.saturating_sub(self.empty_max);
        let index = wanted.saturating_add(left_out);
        let skipped_us = left_out.saturating_mul(self.grid.slice_us);
        self.skipped_us = self.skipped_us.saturating_add(skipped_us);
        self.next = Some(index.saturating_add(1));
        let original = self.original.take(index);
        let sensor = self.original.slices.sensor();
        let decoded = self.decoded.as_mut().map(|decoded| decoded.take(index));
        let events = |slice: Option<&Slice>| slice.map_or(0, |slice| slice.events);
        let sums = |slice: Option<Slice>| {
            slice.map_or_else(|| FrameSums::empty(sensor), |slice| slice.sums)
        };
        let frame = Frame {
            start_us: self.grid.start_us(index),
            events: events(original.as_ref()),
            decoded_events: events(decoded.as_ref().and_then(Option::as_ref)),
            original: sums(original),
            decoded: decoded.map(sums),
            skipped_us,
        };
        self.shared += u64::from(frame.events > 0 && frame.decoded_events > 0);
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use eecvs_nostd::Event;
    use event_files::Ahead;
    use event_types::test_events::{SENSOR, event, reader};

    use super::*;
    use crate::view::input::Input;

    const GRID: Grid = Grid {
        from_us: 1_000,
        to_us: None,
        slice_us: 100,
    };
    const HOUR_US: u64 = 3_600_000_000;

    fn slices(events: &[Event]) -> Slices {
        let reader = reader(events, 3);
        let input = Input::Recording(Ahead::new(Box::new(reader), 0));
        Slices::new(input, GRID, SENSOR, Arc::default())
    }

    fn all(mut frames: Frames) -> (Vec<Frame>, Frames) {
        let found = std::iter::from_fn(|| frames.next_frame().unwrap()).collect();
        (found, frames)
    }

    #[test]
    fn a_jump_of_hours_is_shortened_and_told() {
        let events = [
            event(1_250, 0, 0, true),
            event(1_650, 0, 0, true),
            event(1_650 + 3 * HOUR_US, 0, 0, true),
            event(1_750 + 3 * HOUR_US, 0, 0, true),
        ];
        let (found, frames) = all(Frames::new(GRID, 5, slices(&events), None));
        let starts: Vec<_> = found.iter().map(|f| (f.start_us, f.events)).collect();
        // The time before the first event is skipped, a pause of 3 slices is kept, and one of hours is shortened to
        // 5.
        let after = |slices: u64| 1_600 + 3 * HOUR_US + slices * 100;
        let expected = [
            (1_200, 1),
            (1_300, 0),
            (1_400, 0),
            (1_500, 0),
            (1_600, 1),
            (after(0) - 500, 0),
            (after(0) - 400, 0),
            (after(0) - 300, 0),
            (after(0) - 200, 0),
            (after(0) - 100, 0),
            (after(0), 1),
            (after(1), 1),
        ];
        assert_eq!(starts, expected);
        assert_eq!(frames.skipped_us(), 3 * HOUR_US - 600);
        assert_eq!(found[5].skipped_us, 3 * HOUR_US - 600);
        assert!(found[4].decoded.is_none());
    }

    #[test]
    fn both_inputs_are_shown_at_their_own_times() {
        let a = [event(1_010, 1, 1, true), event(1_210, 2, 2, true)];
        let b = [event(1_110, 1, 1, true), event(1_290, 2, 2, false)];
        let (found, frames) = all(Frames::new(GRID, 5, slices(&a), Some(slices(&b))));
        let counts: Vec<_> = found.iter().map(|f| (f.events, f.decoded_events)).collect();
        assert_eq!(counts, [(1, 0), (0, 1), (1, 1)]);
        let decoded = |i: usize| found[i].decoded.as_ref().unwrap();
        assert_eq!(decoded(0), &FrameSums::empty(SENSOR));
        assert_eq!(decoded(1).sum(1, 1), 1);
        assert_eq!(decoded(2).minus(&found[2].original).sum(2, 2), -2);
        assert_eq!(frames.shared(), 1);
    }

    #[test]
    fn memory_does_not_grow_with_the_length() {
        // Slices close as they are taken: no more events wait than the allowed disorder requires.
        let events: Vec<_> = (0..100_000)
            .map(|i| event(1_000 + 1_000 * i, 0, 0, true))
            .collect();
        let mut frames = Frames::new(GRID, 0, slices(&events), None);
        let mut count = 0;
        while frames.next_frame().unwrap().is_some() {
            count += 1;
            let waits = frames.original().events_read() - count;
            assert!(waits < 40, "{waits}");
        }
        assert_eq!(count, 100_000);
    }
}
