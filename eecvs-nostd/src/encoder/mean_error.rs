//! The coarsest times of a window whose mean error is as small as asked.
//!
//! Cells decoded as their middle are off by a quarter of their width on average, and events that are spread over their
//! cell ([`Fidelity::SpreadUs`]) by less where pixels have many; how much less depends on the scene, and in bursts they
//! are off by more. So the window's own errors are summed for a few of the widths below, and the widest within the error
//! is taken. A tolerance of the error itself always is.
//!
//! ```text
//! error = sum |t - t'| / N_w,  t' the decoded time of an event, in order per pixel and polarity
//! ```
//!
//! A decoder's events can be matched with the window's at that cost, so it bounds the earth mover's distance (`emd_pixel`
//! of `eecvs compare`).
//!
//! The dense and the tree coder take some percent more bits where the width changes from window to window. So what a
//! window leaves of its error is kept for the next ones of its chain, and the widths are few.

use core::num::NonZeroU32;
use core::ops::Range;

use crate::coder::cells::spread_us;
use crate::coder::{Cells, Fidelity};
use crate::encoder::config::HAS_KEYS;
use crate::group::sort::gather_pixels;
use crate::window::{NO_SLOT, Slot, Window};

/// Widths in 2^-8 of that whose middles are off by the asked error on average: the first [`MIDDLES`] for cells that are
/// decoded as their middle, the others for cells that events are spread over.
const WIDTHS_Q8: [u32; 35] = [
    128, 144, 160, 176, 192, 208, 224, 232, 240, 248, 252, 256, 257, 260, 264, //
    256, 272, 288, 304, 320, 344, 368, 392, 420, 448, 480, 512, 576, 640, 704, 768, 896, 1024,
    1280, 1536,
];
const MIDDLES: usize = 15;
/// The first width that is tried for middles: the one that is expected to do.
const EXPECTED: usize = 12;
/// How many widths are tried of either kind.
const TRIES: u32 = 4;
/// Share of its error that a window may take over from those before it, as the reciprocal.
const BORROWED: u64 = 16;

/// What the windows of a chain have left of their error, and the widths of the last one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MeanError {
    left_us: u64,
    /// Of it what the last window left, or less.
    own_us: u32,
    middle: u8,
    spread: u8,
}

impl MeanError {
    /// State before the first window of a chain.
    pub(crate) const START: Self = Self {
        left_us: 0,
        own_us: 0,
        middle: EXPECTED as u8,
        spread: MIDDLES as u8,
    };

    /// Returns the coarsest fidelity found for a closed window of `duration_us`, with which the decoded times of the
    /// chain's windows so far are off by at most `max_us` on average; `spreads` tells whether events may be spread.
    /// Where the window may begin a chain (`may_be_key`), it has to do without what those before left.
    #[inline(never)]
    pub(crate) fn coarsest(
        &mut self,
        max_us: NonZeroU32,
        duration_us: u32,
        (spreads, may_be_key): (bool, bool),
        window: &mut Window<'_>,
    ) -> Fidelity {
        if may_be_key {
            self.left_us = 0;
        }
        let asked_us = u64::from(max_us.get()) * u64::from(window.events());
        let all_us = asked_us + self.left_us.min(asked_us / BORROWED);
        let widths = Widths {
            max_us: max_us.get(),
            duration_us: duration_us.max(1),
        };
        let middle = widths.widest(self.middle.into(), 0..MIDDLES, all_us, window);
        // A tolerance of the error needs no sum.
        let tolerance_us = max_us.get().min(widths.duration_us / 2);
        let mut found = (Fidelity::ToleranceUs(tolerance_us), asked_us);
        let mut width_q8 = 0;
        if let Some((at, error_us)) = middle {
            self.middle = at as u8;
            (found, width_q8) = ((widths.fidelity(at), error_us), WIDTHS_Q8[at % WIDTHS]);
        }
        if spreads {
            gather(window);
            let spread = widths.widest(self.spread.into(), MIDDLES..WIDTHS, all_us, window);
            if let Some((at, error_us)) = spread {
                self.spread = at as u8;
                if WIDTHS_Q8[at % WIDTHS] > width_q8 {
                    found = (widths.fidelity(at), error_us);
                }
            }
        }
        let (fidelity, error_us) = found;
        let own_us = asked_us.saturating_sub(error_us);
        self.own_us = own_us.min(u32::MAX.into()) as u32;
        self.left_us = (self.left_us.saturating_add(asked_us)).saturating_sub(error_us);
        fidelity
    }

    /// Notes that a key frame was sent, as part `part` of the last window: those to come have what a decoder that
    /// begins there has seen.
    pub(crate) const fn note_key(&mut self, part: u32) {
        self.left_us = if part == 0 { self.own_us as u64 } else { 0 };
    }
}

const WIDTHS: usize = WIDTHS_Q8.len();

/// The widths for a window.
#[derive(Clone, Copy)]
struct Widths {
    max_us: u32,
    duration_us: u32,
}

impl Widths {
    /// Returns the width of the cells of element `at` of [`WIDTHS_Q8`].
    fn width_us(self, at: usize) -> u32 {
        // The middles of cells of 4 E - 1 are off by a little less than E.
        let width_us = (u64::from(self.max_us) * u64::from(WIDTHS_Q8[at % WIDTHS])) >> 6;
        width_us.saturating_sub(1).min(self.duration_us.into()) as u32
    }

    /// Returns the fidelity of element `at`.
    fn fidelity(self, at: usize) -> Fidelity {
        match (self.width_us(at), at < MIDDLES) {
            (0 | 1, _) => Fidelity::Lossless,
            (width_us, true) => Fidelity::ToleranceUs(width_us.saturating_sub(1) / 2),
            (width_us, false) => Fidelity::SpreadUs(width_us),
        }
    }

    /// Returns the sum of the window's errors with element `at`.
    fn error(self, at: usize, window: &Window<'_>) -> u64 {
        let cells = Cells::new(self.fidelity(at), self.duration_us);
        if at < MIDDLES {
            middle_error(cells, window)
        } else {
            spread_error(cells, window)
        }
    }

    /// Returns the element of `range` for the widest cells found whose error is at most `all_us`, and that error; the
    /// search begins at `first`.
    #[inline(never)]
    fn widest(
        self,
        first: usize,
        range: Range<usize>,
        all_us: u64,
        window: &Window<'_>,
    ) -> Option<(usize, u64)> {
        let (mut at, mut low, mut high) = (first, range.start, range.end);
        let mut best = None;
        for _ in 0..TRIES {
            let error_us = self.error(at, window);
            if error_us <= all_us {
                best = Some((at, error_us));
                low = at + 1;
            } else {
                high = at;
            }
            // Errors grow with the width, nearly in proportion; some elements have the same width.
            let width_us = self.width_us(at);
            let wanted_us = u64::from(width_us).saturating_mul(all_us) / error_us.max(1);
            let is_same = |other: usize| self.width_us(other) == width_us;
            while low < high && best.is_some() && is_same(low) {
                low += 1;
            }
            while low < high && error_us > all_us && is_same(high - 1) {
                high -= 1;
            }
            let fits = |other: &usize| u64::from(self.width_us(*other)) <= wanted_us;
            let fitting = (range.start..high).take_while(fits).last();
            at = match (fitting, best) {
                (Some(fitting), Some(_)) => fitting,
                (fitting, _) => fitting.unwrap_or(low).max(low),
            };
            if !(low..high).contains(&at) {
                break;
            }
        }
        best
    }
}

/// Returns whether a window's events lie in their order of arrival: of the coders that have it, the keys coder alone
/// takes a mean error.
const fn is_in_order(window: &Window<'_>) -> bool {
    HAS_KEYS && window.keeps_arrival()
}

/// Puts the events of a closed window in the order that [`spread_error`] needs.
fn gather(window: &mut Window<'_>) {
    if is_in_order(window) {
        let events = window.in_order_mut();
        events.sort_unstable_by_key(|[offset_us, place]| (*place, *offset_us));
    } else {
        gather_pixels(window);
    }
}

/// Returns the sum of the errors of times that are decoded as their cells' middles.
fn middle_error(cells: Cells, window: &Window<'_>) -> u64 {
    let error = |offset_us: u32| {
        let decoded_us = cells.offset_us(cells.of(offset_us));
        u64::from(offset_us.abs_diff(decoded_us))
    };
    if is_in_order(window) {
        let events = window.in_order().iter();
        return events.map(|[offset_us, _]| error(*offset_us)).sum();
    }
    let mut sum = 0;
    each_list(window, |slots, head| {
        let mut at = head;
        while let Some(slot) = slots.get(at as usize) {
            sum += error(slot.offset_us());
            at = slot.next();
        }
    });
    sum
}

/// Returns the sum of the errors of times that are spread over their cells, for a window whose events were gathered.
fn spread_error(cells: Cells, window: &Window<'_>) -> u64 {
    if is_in_order(window) {
        let cell = |[offset_us, place]: [u32; 2]| (place, cells.of(offset_us));
        let runs = window.in_order().chunk_by(|a, b| cell(*a) == cell(*b));
        return runs
            .map(|run| {
                let times = run.iter().map(|[offset_us, _]| *offset_us);
                run_error(cells, times, (0..run.len() as u32, run.len() as u32))
            })
            .sum();
    }
    let mut sum = 0;
    each_list(window, |slots, head| {
        let mut runs = [Run::NONE; 2];
        let mut at = head;
        while let Some(slot) = slots.get(at as usize) {
            let (column, cell) = (slot.column(), cells.of(slot.offset_us()));
            let run = &mut runs[usize::from(slot.is_on())];
            if run.count == 0 || (run.column, run.cell) != (column, cell) {
                sum += run.error(cells, slots);
                *run = Run {
                    column,
                    cell,
                    count: 0,
                    newest: at,
                };
            }
            run.count += 1;
            at = slot.next();
        }
        for run in runs {
            sum += run.error(cells, slots);
        }
    });
    sum
}

/// Calls `each` with the slots and the newest one of every segment that has events.
fn each_list(window: &Window<'_>, mut each: impl FnMut(&[Slot], u32)) {
    let mut from = 0;
    while let Some(segment) = window.next_used(from) {
        each(window.slots_now(), window.head_of(segment));
        from = segment + 1;
    }
}

/// Returns the sum of the errors of `count` events of a cell; `numbers` are those of the events that `times` has.
fn run_error(
    cells: Cells,
    times: impl Iterator<Item = u32>,
    (numbers, count): (impl Iterator<Item = u32>, u32),
) -> u64 {
    let error = |(i, offset_us): (u32, u32)| {
        let span = cells.span_us(cells.of(offset_us));
        let decoded_us = span.map_or(0, |(start_us, width_us)| {
            start_us + spread_us(width_us, i, count)
        });
        u64::from(offset_us.abs_diff(decoded_us))
    };
    numbers.zip(times).map(error).sum()
}

/// Events of a pixel and a polarity in the same cell.
#[derive(Clone, Copy)]
struct Run {
    column: u32,
    cell: u32,
    count: u32,
    /// Slot of the newest one; the others follow, with events of the other polarity between.
    newest: u32,
}

impl Run {
    const NONE: Self = Self {
        column: 0,
        cell: 0,
        count: 0,
        newest: NO_SLOT,
    };

    /// Returns the sum of the errors of its events.
    fn error(self, cells: Cells, slots: &[Slot]) -> u64 {
        let Some(newest) = slots.get(self.newest as usize).copied() else {
            return 0;
        };
        let mut next = Some(newest);
        let all = core::iter::from_fn(|| {
            let slot = next?;
            next = slots.get(slot.next() as usize).copied();
            Some(slot)
        });
        let same = all.filter(|slot| slot.is_on() == newest.is_on());
        let times = same.map(Slot::offset_us);
        run_error(cells, times, ((0..self.count).rev(), self.count))
    }
}
