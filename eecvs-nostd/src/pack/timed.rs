//! Pixels of few events, sent as the times of these events in place of coefficients.
//!
//! n events determine every coefficient of their pixel, and up to some n their times take fewer bits than the levels
//! do. A pixel of 2 to n0 events is then sent as the cells of its events: C(n) cells of equal width in the window, so
//! narrow that every coefficient which the decoder computes from the cells' middles is within half a step D of that of
//! the events, as a level is. With |phi_k'| the steepest slope of an atom that may be kept, by the triangle inequality:
//!
//! | transform | \|phi_k'\| | C(n) |
//! |---|---|---|
//! | DCT | pi (r - 1) | n ceil(pi (r - 1) / D) |
//! | DTFT | 2 pi (K - 1) | n ceil(2 pi (K - 1) / D) |
//! | Haar DWT | | K, whose bins determine all coefficients |
//!
//! and T cells of a microsecond where that is fewer. [`Packing::few`] is the rule for n0, which needs no data: it
//! compares the bits of n cells with those of the widest levels that n events can have. The bits of a pixel are an
//! event's cell in full and the distances to each next one in an Exp-Golomb code, whose order follows from the
//! distance before.

use heapless::Vec;

use crate::coder::cells::Cells;
use crate::fixed_point::CHUNK_EVENTS;
use crate::group::Impulses;
use crate::pack::bits_lsb_first::{BitWriter, exp_golomb};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::{Packing, Timed, width_of};
use crate::transform::{Rule, Transform};

/// Largest number of cells C(n).
const CELLS_MAX: u32 = 1 << 24;
/// Longest window of pixels that are sent as times.
const DURATION_US_MAX: u32 = (1 << 31) - 1;
/// Largest K where the kept coefficients are the largest ones. It bounds what a decoder computes for a pixel.
pub(super) const TIMED_GRID_MAX: u16 = 128;
/// Largest n0.
pub const TIMED_EVENTS_MAX: u8 = CHUNK_EVENTS as u8;
/// How far below the bits of a cell's number the first distance's code begins.
const FIRST_ORDER_BELOW: u32 = 3;

/// An event of a pixel that is sent as times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimedEvent {
    /// Number of its cell.
    pub cell: u32,
    /// Polarity: `true` for p = +1, `false` for p = -1.
    pub is_on: bool,
}

/// The events of a pixel that is sent as times, in the order of their cells, and OFF before ON within a cell.
pub type TimedEvents = Vec<TimedEvent, CHUNK_EVENTS>;

/// The cells of a frame's pixels that are sent as times.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FewCells {
    /// C(1).
    per_event: u32,
    /// C(n) is C(1).
    is_same: bool,
    duration_us: u32,
}

impl FewCells {
    /// Returns the C(n) cells of a pixel of n = `events` events.
    #[inline(always)]
    pub(crate) fn of(self, events: u32) -> Cells {
        let events = if self.is_same { 1 } else { events };
        // At most 2^24 in a frame: `Header::parse` and `Packing::few` admit no pixel with more cells.
        let count = self.per_event.saturating_mul(events);
        Cells::equal(count, self.duration_us)
    }
}

/// What codes the levels that times are compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LevelCoder {
    /// Plain codes.
    Plain,
    /// The fast coder of coefficients.
    Fast,
    /// The dense coder of coefficients.
    Dense,
}

impl Packing {
    /// Returns C(1): at most 2^32 - 1, where more are beyond any use.
    fn cells_per_event(&self) -> u32 {
        let half_turns = match self.transform {
            Transform::Dct => self.kept().saturating_sub(1) as u64,
            Transform::Dtft => 2 * u64::from(self.grid.saturating_sub(1)),
            Transform::Dwt => return self.grid.into(),
        };
        // 3217 / 1024 exceeds pi by a relative 2.8e-6.
        let cells_1024 = (3217 * half_turns) << (8 - i32::from(self.quantiser.step_log2()));
        let cells = cells_1024.div_ceil(1024 << 8).max(1);
        u32::try_from(cells).unwrap_or(u32::MAX)
    }

    /// Returns the C(n) cells of a pixel of n = `events` events; `None` if they are more than 2^24, or K is above 128
    /// where the largest coefficients are kept, or T is 2^31 us or more.
    fn cells_in(&self, events: u32, duration_us: u32) -> Option<Cells> {
        let is_small = self.grid <= TIMED_GRID_MAX || self.transform.rule() == Rule::LowFrequency;
        let cells = self.few_cells_of(duration_us).of(events);
        let fits = is_small && duration_us <= DURATION_US_MAX && cells.count() <= CELLS_MAX;
        fits.then_some(cells)
    }

    /// Returns the cells of a pixel of `events` events that is sent as times.
    #[must_use]
    pub fn timed_cells(&self, events: u32) -> Cells {
        self.few_cells().of(events)
    }

    /// Returns the cells of the pixels of a frame that are sent as times.
    pub(crate) fn few_cells(&self) -> FewCells {
        self.few_cells_of(self.timed.duration_us())
    }

    fn few_cells_of(&self, duration_us: u32) -> FewCells {
        FewCells {
            per_event: self.cells_per_event(),
            is_same: self.transform == Transform::Dwt,
            duration_us,
        }
    }

    /// Returns whether a decoder accepts that pixels of up to `events_max` events are sent as times.
    #[must_use]
    pub fn takes_timed(&self, events_max: u8, duration_us: u32) -> bool {
        (2..=TIMED_EVENTS_MAX).contains(&events_max)
            && self.cells_in(u32::from(events_max), duration_us).is_some()
    }

    /// Returns which pixels take fewer bits as times, in a window of `duration_us`: those of up to n0 events.
    ///
    /// The rule looks at no event. It holds for events at times of their own: where pixels share their times, as under a
    /// flash, or have ON and OFF at the same time, levels may take fewer bits.
    ///
    /// n0 is the largest n for which n (width(C(1) - 1) + 1) <= L w, with L the numbers that a pixel sends, w the bits of
    /// their widest, which follow from n and s = -log2 of the step, and width(v) the bits of v:
    ///
    /// | transform | L | w |
    /// |---|---|---|
    /// | DCT | r - 1 | s + min(v, 1 + v / 2), v = width(n - 1): as sums of signs grow |
    /// | DTFT | 2 (r - 1), of the largest coefficients | s + min(v, 1 + 3 v / 4) |
    ///
    /// For the Haar DWT, which sends a set of K bits and few levels, it is the smaller of r and K / 2, or none if the
    /// step is above 1.
    ///
    /// The adaptive coders themselves describe pixels by coarser cells and what these leave of the levels: for them n0 is
    /// no n for which the cells of n events have e bits more than that of a single one and n e > 6 L / 5 (fast) or n e >
    /// L / 2 (dense). By the dense coder it is none at all where C(1) cells have as many bits as T microseconds, and for
    /// the DWT, as its cells then leave nothing of the levels. The shares were measured where the events of all pixels
    /// are spread evenly over the window, where times are the dearest. The tests `best_takes_no_more_bits` and
    /// `even_pixels_take_hardly_more_bits` compare the frames.
    #[must_use]
    pub fn few(&self, duration_us: u32, coder: LevelCoder) -> Timed {
        let is_dense = coder == LevelCoder::Dense;
        let left_tenths = match coder {
            LevelCoder::Plain => None,
            LevelCoder::Fast => Some(12),
            LevelCoder::Dense => Some(5),
        };
        let step_log2 = i32::from(self.quantiser.step_log2());
        let r = self.kept() as u32;
        let mut events_max = 0;
        let bits_in = |events: u32| {
            let cells = self.cells_in(events, duration_us);
            cells.map(|cells| width_of(cells.count() - 1))
        };
        if self.transform == Transform::Dwt {
            if step_log2 <= 0 && !is_dense && bits_in(1).is_some() {
                events_max = r.min(u32::from(self.grid) / 2).min(TIMED_EVENTS_MAX.into());
            }
        } else if let Some(bits) = bits_in(1) {
            let numbers = r.saturating_sub(1) << u32::from(self.transform.is_complex());
            let is_told = is_dense && bits == width_of(duration_us.saturating_sub(1));
            let most = if is_told { 0 } else { TIMED_EVENTS_MAX };
            // In quarters of a bit for each bit of the number of events.
            let growth = if self.transform == Transform::Dct {
                2
            } else {
                3
            };
            for events in 2..=u32::from(most) {
                let count = width_of(events - 1) as i32;
                let level_quarters = (4 * count).min(4 + growth * count) - 4 * step_log2;
                let Some(finer) = bits_in(events).map(|here| here.saturating_sub(bits)) else {
                    break;
                };
                let is_less = 4 * events * (bits + 1) <= numbers * level_quarters.max(0) as u32;
                let is_less_than_told =
                    left_tenths.is_none_or(|left| 10 * events * finer <= left * numbers);
                if is_less && is_less_than_told {
                    events_max = events;
                }
            }
        }
        Timed::new(events_max as u8, duration_us)
    }
}

/// Returns the order of the first distance's code, with cells of `bits` bits.
#[inline(always)]
pub(super) const fn first_order(bits: u32) -> u32 {
    bits.saturating_sub(FIRST_ORDER_BELOW)
}

/// Returns the order of the code after a `distance` that was coded with `order`.
#[inline(always)]
pub(super) const fn next_order(order: u32, distance: u32) -> u32 {
    width_of(distance + (1 << (order & 31))).saturating_sub(2)
}

/// Writes the events of a pixel after its counts.
#[inline(always)]
pub(crate) fn put_pixel(
    impulses: &Impulses<'_>,
    counts: (u32, u32),
    (cells, scale): (Cells, PhaseScale),
    writer: &mut BitWriter<'_>,
) {
    let position = writer.position();
    let events = events(impulses, (cells, scale));
    if !put(events, counts, cells, writer) {
        writer.rewind(position);
        put_sorted(impulses, counts, (cells, scale), writer);
    }
}

/// Returns a pixel's events in their order of arrival, each as its cell << 1 and its polarity.
#[inline(always)]
fn events(
    impulses: &Impulses<'_>,
    (cells, scale): (Cells, PhaseScale),
) -> impl Iterator<Item = u32> {
    impulses.clone().map(move |impulse| {
        let cell = cells.of_scaled(scale, impulse.offset_us);
        cell << 1 | u32::from(impulse.is_on)
    })
}

/// [`put_pixel`] for events that do not come in order.
#[cold]
#[inline(never)]
fn put_sorted(
    impulses: &Impulses<'_>,
    counts: (u32, u32),
    (cells, scale): (Cells, PhaseScale),
    writer: &mut BitWriter<'_>,
) {
    let mut memory = [0; CHUNK_EVENTS];
    let mut count = 0;
    for event in events(impulses, (cells, scale)).take(CHUNK_EVENTS) {
        insert(&mut memory, count, event);
        count += 1;
    }
    put(memory.into_iter().take(count), counts, cells, writer);
}

/// Inserts `event` into the first `count` of `events`, which ascend.
#[inline(always)]
pub(crate) fn insert(events: &mut [u32], count: usize, event: u32) {
    let mut at = count;
    if let Some(last) = events.get_mut(at) {
        *last = event;
    }
    // Events nearly always come in order.
    while let Some(from) = at.checked_sub(1)
        && let Some([before, here, ..]) = events.get_mut(from..)
        && before > here
    {
        core::mem::swap(before, here);
        at = from;
    }
}

/// Writes the events of a pixel after its counts, each given as its cell << 1 and its polarity. Returns false as soon as
/// they do not ascend.
#[inline(always)]
pub(crate) fn put(
    events: impl Iterator<Item = u32>,
    (on, off): (u32, u32),
    cells: Cells,
    writer: &mut BitWriter<'_>,
) -> bool {
    let mut events = events;
    let Some(first) = events.next() else {
        return true;
    };
    let bits = width_of(cells.count() - 1);
    // While both polarities are left, each event says its own.
    let mut left = [off, on];
    let mut tell = |event: u32| {
        let is_told = u32::from(left[0] > 0 && left[1] > 0);
        let polarity = &mut left[event as usize & 1];
        *polarity = polarity.wrapping_sub(1);
        (event & is_told, is_told)
    };
    let (polarity, told_bits) = tell(first);
    writer.put_clean(polarity | (first >> 1 << told_bits), told_bits + bits);
    let (mut before, mut order) = (first, first_order(bits));
    for event in events {
        if event < before {
            return false;
        }
        let distance = (event >> 1) - (before >> 1);
        let (polarity, told_bits) = tell(event);
        let (code, code_bits) = exp_golomb(distance, order);
        if code_bits < 31 {
            // Without the 1 above it.
            let code = code ^ (1 << (code_bits & 31));
            writer.put_clean(polarity | (code << told_bits), told_bits + code_bits);
        } else {
            put_far((distance, order), (polarity, told_bits), writer);
        }
        (before, order) = (event, next_order(order, distance));
    }
    true
}

/// Writes a distance whose code is long.
#[cold]
#[inline(never)]
fn put_far(
    (distance, order): (u32, u32),
    (polarity, told_bits): (u32, u32),
    writer: &mut BitWriter<'_>,
) {
    writer.put_clean(polarity, told_bits);
    writer.put_exp_golomb(distance, order);
}
