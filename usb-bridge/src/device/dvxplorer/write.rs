//! Writes events as a DVXplorer sends them; [`super::parse`] describes the format.
//!
//! When the time changes, the writer emits a time word and a column. A column is marked as the first of a readout
//! unless the column before it was to its left. Pairs of groups with their masks follow. A mask holds consecutive
//! events that are in the order in which a mask is read, so order and duplicates are kept; events in another order
//! get masks of one bit. An event costs 0.4 to 8 bytes, not counting wraps.

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};

use crate::device::WriteStream;
use crate::device::inivation::masks::Mask;
use crate::device::inivation::words16;
use crate::device::inivation::writer::{Order, Time16};

/// Marks the first column of a readout.
const FIRST: u16 = 0x800;

/// Code of two groups.
const GROUPS: u16 = 0x4000;

/// The number of the second group is lower than that of the first.
const MINUS: u16 = 0x800;

/// Largest distance between two groups.
const DISTANCE_MAX: u16 = 31;

/// Codes of the masks of groups 1 and 2.
const MASKS: [u16; 2] = [0x3000, 0x2000];

/// Writes the stream of a DVXplorer.
#[derive(Debug)]
pub struct DvxplorerWriter {
    order: Order,
    time: Time16,
    /// Column of what follows.
    column: Option<u16>,
}

impl DvxplorerWriter {
    /// Creates a writer for events of `sensor`.
    #[must_use]
    pub const fn new(sensor: Sensor) -> Self {
        Self {
            order: Order::new(super::NAME, sensor),
            time: Time16::new(),
            column: None,
        }
    }

    fn column(&mut self, event: &Event, is_new_time: bool, bytes: &mut Vec<u8>) {
        let last = self.column.replace(event.x);
        if is_new_time || last != Some(event.x) {
            let first = last.is_none_or(|last| last >= event.x);
            let mark = if first { FIRST } else { 0 };
            bytes.extend((words16::ROW | mark | event.x).to_le_bytes());
        }
    }
}

impl WriteStream for DvxplorerWriter {
    fn write(&mut self, mut events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        while let Some((first, count)) = Mask::first(events) {
            let second = Mask::next(events, count)
                .filter(|(second, _)| second.group.abs_diff(first.group) <= DISTANCE_MAX);
            let used = count + second.map_or(0, |(_, count)| count);
            for event in &events[..used] {
                self.order.check(event)?;
            }
            let is_new_time = self.time.write(events[0].t_us, &self.order, bytes)?;
            self.column(&events[0], is_new_time, bytes);
            let other = second.map_or(first.group, |(second, _)| second.group);
            let minus = if other < first.group { MINUS } else { 0 };
            let distance = other.abs_diff(first.group) << 6;
            bytes.extend((GROUPS | minus | distance | first.group).to_le_bytes());
            let masks = [Some(first), second.map(|(second, _)| second)];
            for (code, mask) in MASKS.iter().zip(masks) {
                if let Some(Mask { bits, off, .. }) = mask {
                    bytes.extend((code | off << 8 | u16::from(bits)).to_le_bytes());
                }
            }
            events = &events[used..];
        }
        Ok(())
    }

    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        self.time.advance(t_us, bytes);
    }

    fn reset_time(&mut self, bytes: &mut Vec<u8>) -> bool {
        self.time.reset(bytes);
        self.order.reset_time();
        self.column = None;
        true
    }

    fn restart(&mut self) {
        self.time = Time16::new();
        self.order.restart();
        self.column = None;
    }

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}
