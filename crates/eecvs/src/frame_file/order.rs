//! Follows the sequence numbers of frames, of each sensor separately.

use eecvs_nostd::frame::CRC_BYTES;
use eecvs_nostd::{Header, Order, Sensor, Sequence};

use super::report::LinkReport;

/// Number of recent frames remembered, the same as in [`Sequence`].
const RECENT: usize = 64;

/// Follows the sequence numbers of a stream: detects frames lost, repeated or out of order, and restarts.
#[derive(Debug, Clone)]
pub struct FrameOrder {
    sequence: Sequence,
    /// Sequence number and CRC-32 of the latest frames, at index number modulo [`RECENT`].
    recent: [Option<(u32, [u8; CRC_BYTES])>; RECENT],
    newest_t0_us: u64,
}

impl Default for FrameOrder {
    fn default() -> Self {
        Self {
            sequence: Sequence::new(),
            recent: [None; RECENT],
            newest_t0_us: 0,
        }
    }
}

impl FrameOrder {
    /// Counts a frame's place in the sequence in `report`; returns whether to deliver the frame. `crc` is its last
    /// bytes.
    pub fn take(&mut self, header: &Header, crc: [u8; CRC_BYTES], report: &mut LinkReport) -> bool {
        self.follow(header, crc, false, report)
    }

    /// As [`FrameOrder::take`], but the first frame of a segment of a file repeats none: a file may have the same
    /// segment twice.
    pub(super) fn follow(
        &mut self,
        header: &Header,
        crc: [u8; CRC_BYTES],
        is_first: bool,
        report: &mut LinkReport,
    ) -> bool {
        let number = header.sequence;
        if self.recent.iter().all(Option::is_none) {
            report.frames_before += u64::from(number);
        }
        let mut order = self.sequence.follow(number);
        if order == Order::Repeated && (is_first || self.begins_anew(header, crc)) {
            report.restarts += 1;
            *self = Self::default();
            report.frames_before += u64::from(number);
            order = self.sequence.follow(number);
        }
        match order {
            Order::InOrder => {}
            Order::Lost(frames) => report.frames_lost += u64::from(frames),
            Order::Reordered => {
                report.frames_reordered += 1;
                report.frames_lost = report.frames_lost.saturating_sub(1);
            }
            Order::Repeated => {
                report.frames_repeated += 1;
                return false;
            }
        }
        report.frames += 1;
        self.recent[number as usize % RECENT] = Some((number, crc));
        self.newest_t0_us = if header.begins_run {
            header.t0_us
        } else {
            self.newest_t0_us.max(header.t0_us)
        };
        true
    }

    /// Returns whether a sequence number seen before belongs to a new frame: of a concatenated file, or of an
    /// encoder that was restarted.
    fn begins_anew(&self, header: &Header, crc: [u8; CRC_BYTES]) -> bool {
        match self.recent[header.sequence as usize % RECENT] {
            Some((number, seen)) if number == header.sequence => seen != crc,
            // Too old to be remembered. A repeated frame is neither newer than all others nor an encoder's first.
            _ => header.sequence == 0 || header.t0_us > self.newest_t0_us,
        }
    }
}

/// Sensors whose sequence numbers are followed separately; no camera setup has more.
const SENSORS_MAX: usize = 256;

/// Returns the sequence state of a sensor, and creates it if needed.
pub(super) fn order_of(orders: &mut Vec<(Sensor, FrameOrder)>, sensor: Sensor) -> &mut FrameOrder {
    let at = orders.iter().position(|(of, _)| *of == sensor);
    let at = at.unwrap_or_else(|| {
        orders.truncate(SENSORS_MAX - 1);
        orders.push((sensor, FrameOrder::default()));
        orders.len() - 1
    });
    &mut orders[at].1
}
