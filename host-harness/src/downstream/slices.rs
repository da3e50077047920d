//! Cuts events into slices of time.

use eecvs_nostd::{Event, Sensor};
use rayon::prelude::*;

/// A grid of slices that starts at the original's first event.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slices {
    pub(super) sensor: Sensor,
    pub(super) start_us: u64,
    /// Duration of a slice in us, at least 1.
    pub(super) slice_us: u32,
    /// Index of the last slice; the grid has slices 0 to `last`.
    pub(super) last: u64,
}

impl Slices {
    /// Makes the grid of `original`, which is sorted by time: from its first event to the slice of its last.
    pub(super) fn new(sensor: Sensor, original: &[Event], slice_us: u32) -> Self {
        let time_us = |event: Option<&Event>| event.map_or(0, |event| event.t_us);
        let start_us = time_us(original.first());
        let slice_us = slice_us.max(1);
        let span_us = time_us(original.last()).saturating_sub(start_us);
        Self {
            sensor,
            start_us,
            slice_us,
            last: span_us / u64::from(slice_us),
        }
    }

    /// Returns the slice that holds `event`; `None` outside of the grid or the sensor.
    fn number(&self, event: &Event) -> Option<u64> {
        let time_us = event.t_us.checked_sub(self.start_us)?;
        let number = time_us / u64::from(self.slice_us);
        (number <= self.last && self.sensor.contains(event.x, event.y)).then_some(number)
    }

    /// Returns the middle of slice `number` of the grid, in us from [`Self::start_us`].
    pub(super) fn middle_us(&self, number: u64) -> f64 {
        (number as f64 + 0.5) * f64::from(self.slice_us)
    }

    /// Copies the events on the grid, sorted, since the order in which a decoder writes events has no meaning.
    pub(super) fn sorted(&self, events: &[Event]) -> Vec<Event> {
        let mut inside: Vec<Event> = events
            .iter()
            .filter(|event| self.number(event).is_some())
            .copied()
            .collect();
        inside.par_sort_unstable();
        inside
    }

    /// Returns the slices that have events, with their numbers; the events must be [`sorted`](Self::sorted).
    pub(super) fn cut<'e>(&self, sorted: &'e [Event]) -> Vec<(u64, &'e [Event])> {
        sorted
            .chunk_by(|a, b| self.number(a) == self.number(b))
            .filter_map(|slice| Some((self.number(slice.first()?)?, slice)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Polarity;

    use super::*;

    #[test]
    fn events_off_the_grid_are_ignored_and_the_others_cut() {
        let event = |t_us, x| Event {
            t_us,
            x,
            y: 0,
            polarity: Polarity::On,
        };
        let sensor = Sensor::new(2, 1).unwrap();
        let original = [event(100, 0), event(125, 1), event(139, 0)];
        let slices = Slices::new(sensor, &original, 10);
        let decoded = [
            event(149, 0),
            event(139, 1),
            event(99, 0),
            event(0, 0),
            event(130, 0),
            event(u64::MAX, 0),
            event(100, 1),
            event(110, 2),
            event(140, 0),
        ];
        let sorted = slices.sorted(&decoded);
        assert_eq!(
            slices.cut(&sorted),
            [
                (0, &[event(100, 1)][..]),
                (3, &[event(130, 0), event(139, 1)][..]),
            ]
        );
        // The grid ends with the slice of the last event.
        assert_eq!(slices.last, 3);
    }

    #[test]
    fn grids_of_nothing_and_of_all_time_are_grids() {
        let sensor = Sensor::new(2, 1).unwrap();
        let event = |t_us| Event {
            t_us,
            x: 0,
            y: 0,
            polarity: Polarity::On,
        };
        let slices = Slices::new(sensor, &[], 0);
        assert!(slices.cut(&slices.sorted(&[event(5)])).is_empty());
        let all = [event(0), event(u64::MAX)];
        let slices = Slices::new(sensor, &all, 1);
        let sorted = slices.sorted(&all);
        let numbers: Vec<u64> = slices.cut(&sorted).iter().map(|(n, _)| *n).collect();
        assert_eq!(numbers, [0, u64::MAX]);
    }
}
