//! Sorts the events of a step and holds back the events delayed into a later step.

use event_types::{Event, Polarity};

use crate::noise::Cause;

/// Bits below the time in a packed event: y 11, x 11, polarity 1, cause 3.
const PLACE_BITS: u32 = 26;
const CAUSE_BITS: u32 = 3;

/// Events of the current step, packed so that integer order is the scene's order: time, y, x, OFF before ON.
///
/// Events are only ever delayed, so once a step is computed, every event before its end is known. Later events wait
/// for their own step.
#[derive(Debug, Clone, Default)]
pub(crate) struct Queue {
    packed: Vec<u64>,
    /// Time that corresponds to a packed time of 0.
    origin_us: u64,
    /// `packed[taken..ready]` is sorted and may be taken.
    taken: usize,
    ready: usize,
}

impl Queue {
    /// Begins a step at `start_us`; all ready events must have been taken.
    pub(crate) fn begin(&mut self, start_us: u64) {
        self.packed.drain(..self.taken);
        let advance = start_us.saturating_sub(self.origin_us) << PLACE_BITS;
        for packed in &mut self.packed {
            *packed -= advance;
        }
        self.origin_us = start_us;
        self.taken = 0;
        self.ready = 0;
    }

    /// Adds an event `after_us` after the start of the step.
    pub(crate) fn push(&mut self, after_us: u32, x: u16, y: u16, polarity: Polarity) {
        self.push_with(after_us, x, y, polarity, Cause::Signal);
    }

    /// Adds an event and its cause.
    pub(crate) fn push_with(
        &mut self,
        after_us: u32,
        x: u16,
        y: u16,
        polarity: Polarity,
        cause: Cause,
    ) {
        let place = u64::from(y) << 12 | u64::from(x) << 1 | u64::from(polarity as u8);
        self.packed
            .push(u64::from(after_us) << PLACE_BITS | place << CAUSE_BITS | u64::from(cause as u8));
    }

    /// Returns whether all ready events have been taken.
    pub(crate) fn is_taken(&self) -> bool {
        self.taken >= self.ready
    }

    /// Ends the step: events earlier than `end_us` become ready.
    pub(crate) fn end(&mut self, end_us: u64) {
        self.packed.sort_unstable();
        let limit = end_us.saturating_sub(self.origin_us) << PLACE_BITS;
        self.ready = self.packed.partition_point(|packed| *packed < limit);
    }

    /// Appends at most `most` of the ready events, their times offset by `start_us`, and returns their number.
    pub(crate) fn take(&mut self, most: usize, start_us: u64, events: &mut Vec<Event>) -> usize {
        self.take_with(most, start_us, events, None)
    }

    /// As [`Self::take`]; appends the events' causes, too.
    pub(crate) fn take_with(
        &mut self,
        most: usize,
        start_us: u64,
        events: &mut Vec<Event>,
        causes: Option<&mut Vec<Cause>>,
    ) -> usize {
        let until = self.ready.min(self.taken.saturating_add(most));
        let origin_us = self.origin_us + start_us;
        let batch = self.packed.get(self.taken..until).unwrap_or_default();
        events.extend(batch.iter().map(|packed| {
            let place = packed >> CAUSE_BITS;
            Event {
                t_us: origin_us + (packed >> PLACE_BITS),
                x: (place >> 1 & 0x7ff) as u16,
                y: (place >> 12 & 0x7ff) as u16,
                polarity: Polarity::from_bool(place & 1 == 1),
            }
        }));
        if let Some(causes) = causes {
            let number = |packed: &u64| (packed & ((1 << CAUSE_BITS) - 1)) as usize;
            causes.extend(batch.iter().map(|packed| Cause::ALL[number(packed)]));
        }
        self.taken = until;
        batch.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_is_time_row_column_polarity_and_late_events_wait() {
        let mut queue = Queue::default();
        queue.begin(1_000);
        for (after, x, y, polarity) in [
            (7, 2047, 3, Polarity::On),
            (7, 0, 2047, Polarity::Off),
            (7, 2047, 3, Polarity::Off),
            (7, 5, 3, Polarity::On),
            (1_200, 1, 1, Polarity::On),
            (0, 9, 9, Polarity::On),
        ] {
            queue.push(after, x, y, polarity);
        }
        queue.end(2_000);
        let mut events = Vec::new();
        assert_eq!(queue.take(2, 10, &mut events), 2);
        assert_eq!(queue.take(9, 10, &mut events), 3);
        assert_eq!(queue.take(9, 10, &mut events), 0);
        queue.begin(2_000);
        queue.push(100, 0, 0, Polarity::Off);
        queue.end(3_000);
        assert_eq!(queue.take(9, 10, &mut events), 2);
        let seen: Vec<_> = events
            .iter()
            .map(|e| (e.t_us, e.y, e.x, e.polarity as u8))
            .collect();
        assert_eq!(
            seen,
            [
                (1_010, 9, 9, 1),
                (1_017, 3, 5, 1),
                (1_017, 3, 2047, 0),
                (1_017, 3, 2047, 1),
                (1_017, 2047, 0, 0),
                (2_110, 0, 0, 0),
                (2_210, 1, 1, 1),
            ]
        );
    }

    #[test]
    fn causes_stay_with_their_events() {
        let mut queue = Queue::default();
        queue.begin(0);
        for (i, cause) in Cause::ALL.into_iter().enumerate() {
            queue.push_with(90 - i as u32, 2047, 2047, Polarity::On, cause);
        }
        queue.end(100);
        assert!(!queue.is_taken());
        let (mut events, mut causes) = (Vec::new(), Vec::new());
        assert_eq!(queue.take_with(9, 0, &mut events, Some(&mut causes)), 5);
        assert!(queue.is_taken());
        let mut expected = Cause::ALL;
        expected.reverse();
        assert_eq!(causes, expected);
        assert!(events.iter().all(|e| (e.x, e.y) == (2047, 2047)));
    }
}
