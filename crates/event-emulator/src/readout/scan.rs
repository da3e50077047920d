//! A scan: columns are read in turn, from the last to the first, whether or not their pixels have fired.
//!
//! A scan takes `scan_us`, and each column an equal part of it. Events of a column have the time at which it is read. A pixel
//! does not fire again before it has been read.

use std::collections::BTreeMap;

use event_types::Sensor;

use super::parameters::ReadoutParameters;
use super::{Read, Waiting};

/// Events by the number of the reading of a column that takes them.
#[derive(Debug, Clone)]
pub(super) struct Scan {
    waiting: BTreeMap<u64, Vec<Waiting>>,
    width: u64,
    column_ns: f64,
}

impl Scan {
    pub(super) fn new(sensor: Sensor, parameters: &ReadoutParameters) -> Self {
        Self {
            waiting: BTreeMap::new(),
            width: sensor.width.into(),
            column_ns: parameters.scan_us * 1e3 / f64::from(sensor.width),
        }
    }

    /// Reads what is read before an event, and lets it wait; returns false if its pixel waits already.
    pub(super) fn push(&mut self, waiting: Waiting, read: &mut Vec<Read>) -> bool {
        let now_ns = waiting.fired_ns;
        while let Some((number, _)) = self.waiting.first_key_value() {
            if *number as f64 * self.column_ns >= now_ns {
                break;
            }
            self.read_first(read);
        }
        // The first reading of the column at or after the event.
        let place = self.width - 1 - u64::from(waiting.event.x).min(self.width - 1);
        let next = (now_ns / self.column_ns).ceil() as u64;
        let scans = next.saturating_sub(place).div_ceil(self.width);
        let number = scans * self.width + place;
        let column = self.waiting.entry(number).or_default();
        if column.iter().any(|other| other.event.y == waiting.event.y) {
            return false;
        }
        column.push(waiting);
        true
    }

    /// Reads all that waits.
    pub(super) fn finish(&mut self, read: &mut Vec<Read>) {
        while !self.waiting.is_empty() {
            self.read_first(read);
        }
    }

    fn read_first(&mut self, read: &mut Vec<Read>) {
        let Some((number, mut column)) = self.waiting.pop_first() else {
            return;
        };
        let at_ns = number as f64 * self.column_ns;
        column.sort_unstable_by_key(|waiting| waiting.event.y);
        read.extend(column.into_iter().map(|waiting| Read {
            waiting,
            at_ns,
            stamp_ns: at_ns,
        }));
    }
}
