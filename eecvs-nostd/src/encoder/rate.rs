//! Rate control: the frames of every second fit a number of bytes, whatever the scene does.
//!
//! A bucket of bytes holds a share c of the second's budget B and fills at (1 - c) B per second of the sensor's
//! time, so that the windows of no second take more than B. c is 1/8, or more where windows are so long that the
//! bucket could not hold what one window's time adds. A window is meant to take a part of what is in the bucket: as
//! large a part as keeps a steady flow below the brim, and at least a quarter, so that what a burst leaves is
//! spread over the windows after it. A window that is estimated to take more is degraded, no further than needed,
//! in this order:
//!
//! 1. times within a tolerance that doubles from step to step, up to a sixteenth of the window;
//! 2. the volume of 8, 4, 2 bins, then 1;
//! 3. without isolated events ([`crate::window::filter`]);
//! 4. with 7/8 of the events, 7/8 of that, and so on, spread evenly over the order in which they arrived.
//!
//! Every window is decided anew from its own events, so that a quiet one after a flood is exact again. A window
//! that takes more than the estimate, which learns from it, is cut where its bytes end, and what is left out is
//! counted. Every window has a frame. If there is no room for an event, the frame has none: some 40 bytes, and only
//! such frames may overdraw the bucket.

use core::num::NonZeroU32;

use crate::coder::{Cells, Fidelity};
use crate::window::filter::remove_isolated;
use crate::window::{Closed, Window};

/// Smallest share of the budget that the bucket holds, in 2^-16.
const SHARE_MIN_Q16: u64 = 1 << 13;
/// Smallest part of the bucket that a window is meant to take, in 2^-8.
const PART_MIN_Q8: u64 = 1 << 6;
/// Units per byte in the bucket, chosen so that the budget of a microsecond is a whole number of units.
const PARTS: i64 = 1_000_000;
/// Bytes of a frame that the estimate does not include: its header and its CRC.
const FRAME_BYTES: u32 = 64;
/// Fewest bytes per window, so that headers alone do not fill the link.
pub(crate) const WINDOW_BYTES_MIN: u32 = 128;
/// Fewest cells that a tolerance leaves.
const CELLS_MIN: u32 = 16;
/// Smallest share of the events that is sent, in 2^-16.
const SHARE_EVENTS_MIN_Q16: u32 = 8;
/// Windows of fewer events are not learned from.
const LEARN_EVENTS_MIN: u32 = 64;
/// What a window takes of its estimate before anything was learned; in real scenes the fast coder takes some 0.7.
const RATIO_START_Q8: u32 = 192;
/// Numbers of bits that a cell's number may have, including 0.
const RATIOS: usize = u32::BITS as usize + 1;
/// Bounds of the ratio.
const RATIO_Q8: (u32, u32) = (1 << 5, 1 << 10);

/// State of the budget, and what was learned.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rate {
    /// Bytes that the bucket holds, times [`PARTS`], and what flows into it per microsecond.
    brim: i64,
    flow: i64,
    part_q8: u64,
    /// Bytes in the bucket, times [`PARTS`]; frames without events may take it below 0.
    bucket: i64,
    /// End of the last window.
    end_us: Option<u64>,
    /// What windows took of their estimate, by the bits of a cell's number, 0 before the first such window. Element
    /// 0 is for windows from which events were left out evenly. Then the ratio that is used where no window was.
    ratios_q8: [u16; RATIOS],
    untried_q8: u32,
    /// Bits of a cell's number in the current window.
    cell_bits: usize,
    /// Estimate for the current window in bits, before the ratio, and its events.
    estimate: u64,
    events: u32,
    /// Bytes that the current window may take, and its bytes and events so far, without the order section.
    planned: u64,
    spent: u64,
    coded: u32,
}

/// What is done to a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Plan {
    /// Fidelity of its times.
    pub(crate) fidelity: Fidelity,
    /// Number of events left out.
    pub(crate) thinned: u32,
}

impl Rate {
    /// Starts with a full bucket, for windows of `window_us`.
    pub(crate) const fn new(budget: NonZeroU32, window_us: u32) -> Self {
        let mut rate = Self {
            brim: 0,
            flow: 0,
            part_q8: 0,
            bucket: i64::MAX,
            end_us: None,
            ratios_q8: [0; RATIOS],
            untried_q8: RATIO_START_Q8,
            cell_bits: 0,
            estimate: 0,
            events: 0,
            planned: 0,
            spent: 0,
            coded: 0,
        };
        rate.set_budget(budget, window_us);
        rate
    }

    /// Changes the budget. What is in the bucket stays there as far as it has room, and so does what was learned. A
    /// second in which the budget changes takes no more than the larger of both budgets.
    pub(crate) const fn set_budget(&mut self, budget: NonZeroU32, window_us: u32) {
        let window_us = window_us as u64;
        // c = T / (1 s + T) holds what flows in during a window, (1 - c) T.
        let share_q16 = max(
            (window_us << 16) / (1_000_000 + window_us) + 1,
            SHARE_MIN_Q16,
        );
        let budget = budget.get() as i64;
        self.brim = ((budget * PARTS) >> 16) * share_q16 as i64;
        self.flow = (budget * ((1 << 16) - share_q16 as i64)) >> 16;
        let part_q8 = self.flow as u64 * window_us / max((self.brim >> 8) as u64, 1);
        self.part_q8 = if part_q8 > 1 << 8 {
            1 << 8
        } else {
            max(part_q8, PART_MIN_Q8)
        };
        if self.bucket > self.brim {
            self.bucket = self.brim;
        }
    }

    /// Returns the number of bytes that frames may take now.
    pub(crate) fn room(&self) -> usize {
        (self.bucket / PARTS).max(0) as usize
    }

    /// Returns the number of bytes that the order section may take beside a payload of `payload_bytes`: what the
    /// window was meant to take and no more, so that the order does not coarsen the times of later windows.
    pub(crate) fn order_room(&self, payload_bytes: usize) -> usize {
        let taken = self.spent + payload_bytes as u64;
        self.planned.saturating_sub(taken).min(self.room() as u64) as usize
    }

    /// Takes a frame out of the bucket; `order_bytes` of its bytes are the order section.
    pub(crate) fn spend(&mut self, bytes: usize, order_bytes: usize, events: u32) {
        self.bucket -= bytes as i64 * PARTS;
        self.spent += bytes.saturating_sub(order_bytes) as u64;
        self.coded += events;
    }

    /// Fills the bucket for a window that ends at `end_us`. If it begins a run, the time since the window before is
    /// not known, and nothing is added.
    fn fill(&mut self, end_us: u64, begins_run: bool) {
        if begins_run {
            self.end_us = None;
        }
        let since_us = match self.end_us {
            Some(before_us) => end_us.saturating_sub(before_us).min(1_000_000),
            None => 0,
        };
        // A clock that goes back adds nothing.
        self.end_us = Some(
            self.end_us
                .map_or(end_us, |before_us| before_us.max(end_us)),
        );
        self.bucket = (self.bucket + self.flow * since_us as i64).min(self.brim);
    }

    /// Learns from the window before, which is complete.
    fn learn(&mut self) {
        let bits = self.estimate.min(u64::from(u32::MAX)) as u32;
        let Some(bits) = NonZeroU32::new(bits) else {
            return;
        };
        let Some(coded) = NonZeroU32::new(self.coded) else {
            return;
        };
        if self.events < LEARN_EVENTS_MIN {
            return;
        }
        // A window that was cut counts as if all of it had been coded.
        let spent = self.spent * 8 * u64::from(self.events) / u64::from(coded.get());
        let (least, most) = RATIO_Q8;
        let ratio = (spent << 8) / u64::from(bits.get());
        let ratio = (ratio.min(u64::from(most)) as u32).max(least);
        let ratio = ratio.max((3 * self.ratio_q8(self.cell_bits) + ratio) / 4);
        if self.cell_bits > 0 {
            self.untried_q8 = ratio;
        } else {
            // All events in the coarsest cells might have been better: let what is known of these age.
            self.untried_q8 -= self.untried_q8 / 8;
            if let Some(coarsest) = self.ratios_q8.get_mut(1) {
                *coarsest -= *coarsest / 16;
            }
        }
        if let Some(place) = self.ratios_q8.get_mut(self.cell_bits) {
            *place = ratio as u16;
        }
    }

    fn ratio_q8(&self, cell_bits: usize) -> u32 {
        match self.ratios_q8.get(cell_bits) {
            Some(&ratio) if ratio > 0 => ratio.into(),
            _ => self.untried_q8,
        }
    }

    /// Decides on a closed window, after the user's filter, and removes from it what does not fit.
    #[inline(never)]
    pub(crate) fn plan(
        &mut self,
        asked: Fidelity,
        closed: Closed,
        window: &mut Window<'_>,
    ) -> Plan {
        self.learn();
        let duration_us = closed.duration_us;
        let end_us = closed.t0_us.saturating_add(u64::from(duration_us));
        self.fill(end_us, closed.begins_run);
        (self.spent, self.coded) = (0, 0);
        let room =
            ((self.room() as u64 * self.part_q8) >> 8).saturating_sub(u64::from(FRAME_BYTES)) * 8;
        self.planned = room / 8;
        let pixels = window.config().sensor.pixels();
        let mut active = active(window);
        let mut fidelity = asked;
        let mut thinned = 0;
        let mut is_filtered = false;
        let mut share_q16 = 1 << 16;
        loop {
            let cells = Cells::new(fidelity, duration_us).count();
            let events = ((u64::from(window.events()) * u64::from(share_q16)) >> 16) as u32;
            let estimate = estimate_bits(pixels, active.min(events), events, cells);
            // Plan for an eighth more than the estimate.
            let cell_bits = if share_q16 == 1 << 16 {
                (u32::BITS - cells.leading_zeros()) as usize
            } else {
                0
            };
            let needed = ((estimate * u64::from(self.ratio_q8(cell_bits))) >> 8) * 9 / 8;
            if needed <= room || share_q16 < SHARE_EVENTS_MIN_Q16 {
                (self.estimate, self.cell_bits) = (estimate, cell_bits);
                break;
            }
            if let Some(next) = coarser(fidelity, duration_us) {
                fidelity = next;
            } else if !is_filtered {
                is_filtered = true;
                thinned += remove_isolated(window);
                active = self::active(window);
            } else {
                share_q16 -= share_q16 / 8;
            }
        }
        if share_q16 < 1 << 16 {
            thinned += window.thin(share_q16);
        }
        self.events = window.events();
        Plan { fidelity, thinned }
    }
}

const fn max(a: u64, b: u64) -> u64 {
    if a > b { a } else { b }
}

/// Returns the number of pixels with events.
fn active(window: &Window<'_>) -> u32 {
    let (mut pixels, mut from) = (0, 0);
    while let Some(segment) = window.next_used(from) {
        pixels += window.columns_of(segment).0.count_ones();
        from = segment + 1;
    }
    pixels
}

/// Returns the next coarser fidelity; `None` after the last.
fn coarser(fidelity: Fidelity, duration_us: u32) -> Option<Fidelity> {
    let tolerance_us = match fidelity {
        Fidelity::Lossless => 1,
        Fidelity::ToleranceUs(tolerance_us) => tolerance_us.saturating_mul(2).max(1),
        Fidelity::SpreadUs(width_us) => width_us,
        Fidelity::Bins(bins) => return (bins > 1).then_some(Fidelity::Bins(bins / 2)),
    };
    let next = Fidelity::ToleranceUs(tolerance_us);
    let is_fine = Cells::new(next, duration_us).count() >= CELLS_MIN;
    Some(if is_fine { next } else { Fidelity::Bins(8) })
}

/// Returns log2 of `value` (at least 1) in sixteenths, by at most two and a half of them too low.
const fn log2_q4(value: u64) -> u64 {
    let Some(whole) = value.checked_ilog2() else {
        return 0;
    };
    let fraction = (value << (63 - whole) >> 59) & 15;
    whole as u64 * 16 + fraction
}

/// Estimates what `events` events in `active` pixels of a sensor of `pixels` take, in bits: for each pixel its gap
/// and its first event's cell among all cells, for each further event its distance, by the number of events per
/// pixel, and something for polarities and ends.
fn estimate_bits(pixels: u32, active: u32, events: u32, cells: u32) -> u64 {
    let (Some(active), Some(events)) = (NonZeroU32::new(active), NonZeroU32::new(events)) else {
        return 0;
    };
    let gap = log2_q4(u64::from(pixels / active) + 1) + 2 * 16;
    let first = gap + 16 + log2_q4(u64::from(cells));
    let of_pixel = u64::from(cells) * u64::from(active.get());
    let further = 24 + log2_q4(of_pixel / u64::from(events.get()) + 1);
    let (active, events) = (u64::from(active.get()), u64::from(events.get()));
    (active * first + events.saturating_sub(active) * further) >> 4
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The steps end, and none has more cells than the one before.
        #[test]
        fn every_fidelity_has_an_end(
            duration_us in 1_u32..,
            asked in prop_oneof![
                Just(Fidelity::Lossless),
                any::<u32>().prop_map(Fidelity::ToleranceUs),
                (1_u16..).prop_map(Fidelity::Bins),
                (1_u32..).prop_map(Fidelity::SpreadUs),
            ],
        ) {
            let mut fidelity = asked;
            let mut steps = 0;
            while let Some(next) = coarser(fidelity, duration_us) {
                let cells = |fidelity| Cells::new(fidelity, duration_us).count();
                let is_first_bins = matches!(next, Fidelity::Bins(8));
                prop_assert!(is_first_bins || cells(next) <= cells(fidelity));
                fidelity = next;
                steps += 1;
                prop_assert!(steps < 40);
            }
            prop_assert_eq!(fidelity, Fidelity::Bins(1));
        }

        #[test]
        fn logarithms_are_near(value in 1_u64..) {
            let exact = (value as f64).log2() * 16.0;
            let found = log2_q4(value) as f64;
            prop_assert!(found <= exact + 0.01 && found > exact - 2.5, "{} {}", found, exact);
        }

        /// No second takes more than the largest of the budgets that it had, whatever windows come and whatever
        /// part they spend of what they are offered.
        #[test]
        fn no_second_exceeds_the_budget(
            budget in 1_u32.., window_us in 1_u32..,
            windows in proptest::collection::vec((1_u32..3_000_000, 0.0_f64..=1.0, 0_u32..3, 0_u32..40), 1..200),
        ) {
            let mut rate = Rate::new(NonZeroU32::new(budget).unwrap(), window_us);
            let mut end_us = 1_u64 << 40;
            let mut spent = std::vec::Vec::new();
            let mut now = budget;
            for (since_us, share, shift, change) in windows {
                let before = now;
                // Now and then change the budget, down to a thousandth of the first one.
                if change < 10 {
                    now = (budget >> change).max(1);
                    rate.set_budget(NonZeroU32::new(now).unwrap(), window_us);
                }
                end_us += u64::from(since_us >> (8 * shift));
                rate.fill(end_us, false);
                let bytes = (rate.room() as f64 * share) as usize;
                rate.spend(bytes.min(rate.room()), 0, 1);
                spent.push((end_us, bytes.min(rate.room() + bytes) as u64, now.max(before)));
            }
            for (i, (start_us, ..)) in spent.iter().enumerate() {
                let second = || spent[i..].iter().take_while(|(end_us, ..)| *end_us < start_us + 1_000_000);
                let bytes: u64 = second().map(|(_, bytes, _)| bytes).sum();
                let budget = second().map(|(.., budget)| u64::from(*budget)).max().unwrap();
                prop_assert!(bytes <= budget, "{} {}", bytes, budget);
            }
        }
    }
}
