//! One pixel's coefficients, in an encoder or a decoder.

use heapless::Vec;

use crate::coder::cells::{Cells, Fidelity};
use crate::fixed_point::CHUNK_EVENTS;
use crate::group;
use crate::pack::descriptor::{Coded, Descriptor};
use crate::pack::timed::{TimedEvent, insert};
use crate::prune::Kept;
use crate::quantise::Level;
use crate::transform::phase::PhaseScale;
use crate::transform::shape::{Packing, Shape, width_of};
use crate::transform::{M_MAX, Transform};

/// Largest K of pixels that are coded by their events. It bounds what a decoder computes for a pixel, and the
/// memory for it.
pub(super) const TOLD_GRID_MAX: usize = 128;
/// For the DTFT, whose levels are twice as many and of higher frequencies, the events that code a pixel have finer
/// cells than a single event: this is how much, as a power of two.
const FINER_LOG2: u32 = 1;

/// Returns the fidelity of cells that extend on either side of their middle by at most half of 2^-`cells_log2` of
/// the window. Where these would be of three microseconds, they are of one.
const fn told_within(cells_log2: u32, duration_us: u32) -> Fidelity {
    match duration_us >> (cells_log2 + 1) {
        0 | 1 => Fidelity::Lossless,
        tolerance_us => Fidelity::ToleranceUs(tolerance_us),
    }
}

/// Parameters that all pixels of a frame share.
#[derive(Debug, Clone, Copy)]
pub struct Common {
    /// Parameters of the plain payload too.
    pub(super) packing: Packing,
    pub(super) scale: PhaseScale,
    /// log2 of the number of cells for a single event: b.
    pub(super) cells_log2: u32,
    /// Cells of the events that code a pixel.
    pub(super) cells: Cells,
}

impl Common {
    /// Returns the parameters of a frame of a window of `duration_us`.
    #[must_use]
    pub fn new(packing: Packing, duration_us: u32) -> Self {
        let cells_log2 = packing.cells_log2();
        let fidelity = match packing.transform {
            // All Haar differences follow from the bins.
            Transform::Dwt => Fidelity::Bins(packing.grid),
            Transform::Dct => told_within(cells_log2, duration_us),
            Transform::Dtft => told_within(cells_log2 + FINER_LOG2, duration_us),
        };
        Self {
            packing,
            scale: PhaseScale::new(duration_us),
            cells_log2,
            cells: Cells::new(fidelity, duration_us),
        }
    }

    pub(crate) const fn scale(&self) -> PhaseScale {
        self.scale
    }

    pub(crate) const fn cells_log2(&self) -> u32 {
        self.cells_log2
    }

    pub(crate) const fn grid(&self) -> usize {
        self.packing.grid as usize
    }

    pub(crate) const fn shape(&self) -> Shape {
        self.packing.shape()
    }

    /// Returns the cells of a pixel of `events` events if it is sent as their times.
    pub(crate) fn timed_cells(&self, events: u32) -> Option<Cells> {
        let has = self.packing.timed.has(events);
        has.then(|| self.packing.timed_cells(events))
    }

    /// Returns the cell of an event that codes its pixel.
    pub(crate) const fn cell(&self, offset_us: u32) -> u32 {
        self.cells.of(offset_us)
    }

    /// Returns how many numbers are sent per coefficient other than c_0.
    pub(super) const fn numbers(&self) -> usize {
        if self.packing.transform.is_complex() {
            2
        } else {
            1
        }
    }

    /// Returns whether a pixel of `events` events may be coded by them.
    pub(super) fn may_tell(&self, events: u32) -> bool {
        events as usize <= CHUNK_EVENTS && usize::from(self.packing.grid) <= TOLD_GRID_MAX
    }

    /// Returns whether an encoder codes a pixel by its events: if these are estimated to take at most 5/4 of the
    /// bits that its levels would.
    pub(super) fn tells(&self, events: u32, levels: usize) -> bool {
        let cell_bits = width_of(self.cells.count() - 1) + 2;
        let told = events * cell_bits.saturating_sub(width_of(events) - 1);
        let level_bits = self.packing.level_bits_max(events);
        let set_bits = if self.packing.transform == Transform::Dct {
            0
        } else {
            u32::from(self.packing.grid)
        };
        let direct = levels as u32 * level_bits.saturating_sub(width_of(events) / 2) + set_bits;
        self.may_tell(events) && 4 * told <= 5 * direct
    }
}

/// One pixel, as a frame codes it.
#[derive(Debug, Clone)]
pub struct Pixel {
    pub(super) x: u16,
    pub(super) y: u16,
    pub(super) on: u32,
    pub(super) off: u32,
    /// Cell of a single event.
    pub(super) cell: u32,
    /// Whether the pixel is coded by its events, and these: cell << 1 plus the polarity, ascending.
    pub(super) is_told: bool,
    pub(super) events: [u32; CHUNK_EVENTS],
    /// Which coefficients are sent.
    pub(super) kept: Kept,
    /// Their levels as in the plain payload, without that of k = 0.
    pub(super) levels: [i32; 2 * M_MAX],
    pub(super) levels_len: usize,
}

impl Pixel {
    /// All zero, for memory in `.bss`.
    pub const EMPTY: Self = Self {
        x: 0,
        y: 0,
        on: 0,
        off: 0,
        cell: 0,
        is_told: false,
        events: [0; CHUNK_EVENTS],
        kept: Kept::NONE,
        levels: [0; 2 * M_MAX],
        levels_len: 0,
    };

    /// Starts a pixel of a window.
    pub(crate) fn begin(&mut self, pixel: group::Pixel) {
        (self.x, self.y) = (pixel.x, pixel.y);
        (self.on, self.off) = (pixel.on, pixel.off);
        self.is_told = false;
        self.levels_len = 0;
    }

    pub(crate) const fn set_cell(&mut self, cell: u32) {
        self.cell = cell;
    }

    /// Decides whether the pixel is coded by its events; they have to be inserted then.
    pub(crate) fn choose(&mut self, common: &Common) -> bool {
        self.is_told = common.tells(self.count(), self.levels_len);
        self.is_told
    }

    /// Returns the number of events, n.
    pub(crate) const fn count(&self) -> u32 {
        self.on + self.off
    }

    /// Inserts event number `at` of the pixel in the order of cells.
    pub(crate) fn insert(&mut self, at: usize, cell: u32, is_on: bool) {
        insert(&mut self.events, at, cell << 1 | u32::from(is_on));
    }

    /// Sets which coefficients are sent and their levels, cut to the bits that n events can need.
    pub(crate) fn set(&mut self, common: &Common, kept: &Kept, levels: &[u32]) {
        let unused = 32 - common.packing.level_bits_max(self.count());
        self.kept = *kept;
        self.levels_len = levels.len().min(self.levels.len());
        for (to, level) in self.levels.iter_mut().zip(levels) {
            *to = ((*level << unused) as i32) >> unused;
        }
    }

    /// Returns how many levels the set of coefficients has.
    pub(super) fn levels_of_set(&self, common: &Common) -> usize {
        let grid = usize::from(common.packing.grid);
        let zeroth = usize::from(self.kept.contains(0));
        (self.kept.count(grid) as usize).saturating_sub(zeroth) * common.numbers()
    }

    /// Returns the pixel as the plain payload has it.
    #[must_use]
    pub fn descriptor(&self, common: &Common) -> Descriptor {
        let packing = &common.packing;
        let coded = if self.count() == 1 {
            Coded::Cell(self.cell)
        } else if packing.timed.has(self.count()) {
            let events = self.events.iter().take(self.count() as usize);
            Coded::Times(
                events
                    .map(|event| TimedEvent {
                        cell: event >> 1,
                        is_on: event & 1 == 1,
                    })
                    .collect(),
            )
        } else {
            let mut levels = Vec::new();
            let mut left = self.levels.iter().copied();
            self.kept.for_each(usize::from(packing.grid), |k| {
                let mut next = || left.next().unwrap_or(0);
                let (re, im) = match (k, packing.transform) {
                    (0, _) => (self.on as i32 - self.off as i32, 0),
                    (_, Transform::Dct) => (next(), 0),
                    (_, Transform::Dtft) => (next(), next()),
                    (_, Transform::Dwt) => {
                        let level = next();
                        (level.saturating_add(i32::from(level >= 0)), 0)
                    }
                };
                // There are at most r of them.
                let _ = levels.push(Level {
                    k: k as u16,
                    re,
                    im,
                });
            });
            Coded::Levels(levels)
        };
        Descriptor {
            x: self.x,
            y: self.y,
            on: self.on,
            off: self.off,
            coded,
        }
    }
}
