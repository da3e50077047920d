//! Events as a DVXplorer sends them: see [`super::parse`].
//!
//! A word of time where it changes, after it a column, which is the first of a readout where the one
//! before was not to the left of it; then groups in pairs with their masks. Events of one mask are
//! those that follow each other in the order in which a mask is read, so order and duplicates are
//! kept; where the order is another, masks have one bit. An event costs 0.5 to 8 bytes.

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};

use crate::device::WriteStream;
use crate::device::inivation::masks::Mask;
use crate::device::inivation::words16;
use crate::device::inivation::writer::{Order, Time16};

/// First column of a readout.
const FIRST: u16 = 0x800;

/// Code of two groups.
const GROUPS: u16 = 0x4000;

/// The second group is above the first.
const MINUS: u16 = 0x800;

/// Largest distance of two groups.
const DISTANCE_MAX: u16 = 31;

/// Codes of the masks of group 1 and 2.
const MASKS: [u16; 2] = [0x3000, 0x2000];

/// Writer of a DVXplorer's stream.
#[derive(Debug)]
pub struct DvxplorerWriter {
    order: Order,
    time: Time16,
    /// Column of what follows.
    column: Option<u16>,
}

impl DvxplorerWriter {
    /// A writer of events of `sensor`.
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

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}
