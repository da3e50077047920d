//! Writes events as a DVXplorer with MIPI sends them; [`super::parse`] describes the format.
//!
//! A frame has one time and increasing columns. Events of one time are therefore sorted by column, keeping their
//! order within it, and are held back until the time changes or the stream is finished. A reference is written for
//! every millisecond, except across gaps of more than a second, where one is written only every 17 minutes.

use anyhow::{Result, ensure};
use eecvs_nostd::{Event, Sensor};

use super::parse::{COLUMN, FIRST, GROUPS, REFERENCE, REFERENCE_BITS};
use crate::device::WriteStream;
use crate::device::inivation::masks::Mask;
use crate::device::inivation::writer::Order;

/// Most events of one time, which are held in memory.
const FRAME_EVENTS_MAX: usize = 1 << 22;

/// Longest gap across which every reference is written, in ms.
const QUIET_MS: u64 = 1000;

/// Step between references across longer gaps, in ms: less than half of the wrap.
const STEP_MS: u64 = 1 << (REFERENCE_BITS - 2);

/// Largest distance between two groups.
const DISTANCE_MAX: u16 = 31;

/// Writes the stream of a DVXplorer with MIPI.
#[derive(Debug)]
pub struct MipiWriter {
    order: Order,
    /// Events of the latest time.
    frame: Vec<Event>,
    /// Latest reference, in ms.
    reference: Option<u64>,
}

impl MipiWriter {
    /// Creates a writer for events of `sensor`.
    #[must_use]
    pub const fn new(sensor: Sensor) -> Self {
        Self {
            order: Order::new(super::NAME, sensor),
            frame: Vec::new(),
            reference: None,
        }
    }

    fn references(&mut self, wanted: u64, bytes: &mut Vec<u8>) {
        let mut write = |reference: u64| {
            let low = (reference & ((1 << REFERENCE_BITS) - 1)) as u32;
            bytes.extend((REFERENCE | low).to_le_bytes());
        };
        let mut last = match self.reference {
            Some(last) if last >= wanted => return,
            Some(last) => last,
            // The device counts from 0.
            None => 0,
        };
        self.reference = Some(wanted);
        let step = if wanted - last > QUIET_MS { STEP_MS } else { 1 };
        while wanted - last > step {
            last += step;
            write(last);
        }
        write(wanted);
    }

    fn write_frame(&mut self, bytes: &mut Vec<u8>) {
        let mut frame = std::mem::take(&mut self.frame);
        frame.sort_by_key(|event| event.x);
        let mut rest = frame.as_slice();
        if let Some(first) = rest.first() {
            self.references(first.t_us / 1000, bytes);
        }
        let mut column = None;
        while let Some((first, count)) = Mask::first(rest) {
            let second = Mask::next(rest, count).filter(|(second, _)| {
                (first.group..=first.group + DISTANCE_MAX).contains(&second.group)
            });
            let event = &rest[0];
            if column != Some(event.x) {
                let sub = (event.t_us % 1000) as u32;
                let mark = if column.is_none() { FIRST } else { 0 };
                let word = COLUMN | mark | sub << 11 | u32::from(event.x);
                bytes.extend(word.to_le_bytes());
                column = Some(event.x);
            }
            let mut word = GROUPS
                | u32::from(first.group) << 18
                | u32::from(first.off) << 16
                | u32::from(first.bits);
            if let Some((second, _)) = second {
                word |= u32::from(second.group - first.group) << 26
                    | u32::from(second.off) << 17
                    | u32::from(second.bits) << 8;
            }
            bytes.extend(word.to_le_bytes());
            rest = &rest[count + second.map_or(0, |(_, count)| count)..];
        }
        frame.clear();
        self.frame = frame;
    }
}

impl WriteStream for MipiWriter {
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        for event in events {
            self.order.check(event)?;
            if self
                .frame
                .first()
                .is_some_and(|first| first.t_us != event.t_us)
            {
                self.write_frame(bytes);
            }
            let gap = (event.t_us / 1000).saturating_sub(self.reference.unwrap_or(0));
            self.order.check_gap(gap / STEP_MS)?;
            ensure!(
                self.frame.len() < FRAME_EVENTS_MAX,
                "{}: more than {FRAME_EVENTS_MAX} events at {} us do not fit in one frame of the device",
                super::NAME,
                event.t_us
            );
            self.frame.push(*event);
        }
        Ok(())
    }

    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        if self.frame.first().is_some_and(|first| first.t_us < t_us) {
            self.write_frame(bytes);
        }
        // The first reference that a device sends is later than 0, which some hosts take for a wrap.
        if self.frame.is_empty() && t_us / 1000 > self.reference.unwrap_or(0) {
            self.references(t_us / 1000, bytes);
        }
    }

    fn reset_time(&mut self, _: &mut Vec<u8>) -> bool {
        false
    }

    fn restart(&mut self) {
        self.order.restart();
        self.frame.clear();
        self.reference = None;
    }

    fn finish(&mut self, bytes: &mut Vec<u8>) -> Result<()> {
        self.write_frame(bytes);
        Ok(())
    }
}
