//! An arbiter: a pixel that fires asks for its row, and rows are read in the order in which they asked.
//!
//! The row is chosen in `row_ns`; then its events that have come until then are read, from the first column to the last, in
//! `event_ns` for each group of columns with any. Events of the row that come later ask again. A pixel does not fire again
//! before it has been read.

use std::collections::VecDeque;

use event_types::Sensor;

use super::parameters::ReadoutParameters;
use super::{Read, Waiting};

/// Rows that ask, and their events.
#[derive(Debug, Clone)]
pub(super) struct Arbiter {
    rows: Vec<Vec<Waiting>>,
    queue: VecDeque<u16>,
    width: usize,
    /// Until when a pixel cannot fire, in ns; infinite while its event waits.
    busy_ns: Vec<f64>,
    row_ns: f64,
    event_ns: f64,
    group_columns: u16,
    row_time: bool,
    /// When the arbiter is free.
    free_ns: f64,
}

impl Arbiter {
    pub(super) fn new(sensor: Sensor, parameters: &ReadoutParameters) -> Self {
        Self {
            rows: vec![Vec::new(); usize::from(sensor.height)],
            queue: VecDeque::new(),
            width: usize::from(sensor.width),
            busy_ns: vec![0.0; sensor.pixels() as usize],
            row_ns: parameters.row_ns,
            event_ns: parameters.event_ns,
            group_columns: parameters.group_columns as u16,
            row_time: parameters.row_time > 0.0,
            free_ns: 0.0,
        }
    }

    /// Reads what is read before an event, and lets it ask; returns false if its pixel waits already.
    pub(super) fn push(&mut self, waiting: Waiting, read: &mut Vec<Read>) -> bool {
        let now_ns = waiting.fired_ns;
        while let Some(start_ns) = self.next_ns().filter(|start_ns| *start_ns < now_ns) {
            self.read_row(start_ns, read);
        }
        let y = waiting.event.y;
        let pixel = usize::from(y) * self.width + usize::from(waiting.event.x);
        let busy_ns = self.busy_ns.get_mut(pixel);
        let Some(busy_ns) = busy_ns.filter(|busy_ns| **busy_ns <= now_ns) else {
            return false;
        };
        *busy_ns = f64::INFINITY;
        let row = &mut self.rows[usize::from(y)];
        if row.is_empty() {
            self.queue.push_back(y);
        }
        row.push(waiting);
        true
    }

    /// Reads all that asks.
    pub(super) fn finish(&mut self, read: &mut Vec<Read>) {
        while let Some(start_ns) = self.next_ns() {
            self.read_row(start_ns, read);
        }
    }

    /// Returns when the next row begins to be read.
    fn next_ns(&self) -> Option<f64> {
        let row = &self.rows[usize::from(*self.queue.front()?)];
        let asked_ns = row.first()?.fired_ns;
        Some(asked_ns.max(self.free_ns))
    }

    fn read_row(&mut self, start_ns: f64, read: &mut Vec<Read>) {
        let Some(y) = self.queue.pop_front() else {
            return;
        };
        let mut row = std::mem::take(&mut self.rows[usize::from(y)]);
        row.sort_unstable_by_key(|waiting| waiting.event.x);
        let chosen_ns = start_ns + self.row_ns;
        let mut at_ns = chosen_ns;
        let mut group = None;
        for waiting in row.drain(..) {
            let x = waiting.event.x;
            if group != Some(x / self.group_columns) {
                group = Some(x / self.group_columns);
                at_ns += self.event_ns;
            }
            self.busy_ns[usize::from(y) * self.width + usize::from(x)] = at_ns;
            read.push(Read {
                waiting,
                at_ns,
                stamp_ns: if self.row_time { chosen_ns } else { at_ns },
            });
        }
        self.free_ns = at_ns;
        // Its memory serves again.
        self.rows[usize::from(y)] = row;
    }
}
