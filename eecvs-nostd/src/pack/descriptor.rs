//! One encoded pixel: its event counts and its kept coefficients.

use heapless::Vec;

use crate::pack::timed::{TIMED_GRID_MAX, TimedEvents};
use crate::quantise::Level;
use crate::transform::dct::cosines;
use crate::transform::dtft::exponentials;
use crate::transform::shape::Packing;
use crate::transform::{Basis, Dct, Dtft, Dwt, M_MAX, Rule, Transform};

/// A pixel's coefficients, as they are sent.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(
    clippy::large_enum_variant,
    reason = "there is no heap to put it on, and one descriptor exists at a time"
)]
pub enum Coded {
    /// A single event, whose time determines every coefficient: floor(2^b u), where b is [`Packing::cells_log2`].
    Cell(u32),
    /// Several events: the kept coefficients, k ascending.
    ///
    /// c_0 = on - off in every transform; if k = 0 is kept, it is in this list but takes no bits. The DCT has k =
    /// 0..r, the DTFT r of its K; of the DWT those that are 0 are left out.
    Levels(Vec<Level, M_MAX>),
    /// Several events, but few, whose times determine every coefficient: see [`crate::pack::timed`].
    Times(TimedEvents),
}

/// One pixel's window: its event counts and its kept coefficients.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Descriptor {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// ON events in the window.
    pub on: u32,
    /// OFF events in the window.
    pub off: u32,
    /// Coefficients.
    pub coded: Coded,
}

impl Descriptor {
    /// A pixel without events, at column 0 and row 0.
    pub const EMPTY: Self = Self {
        x: 0,
        y: 0,
        on: 0,
        off: 0,
        coded: Coded::Levels(Vec::new()),
    };

    /// Returns the number of events, n = on + off.
    #[must_use]
    pub const fn events(&self) -> u32 {
        self.on + self.off
    }

    /// Calls `each` with k, re and im of every kept coefficient, k ascending, each within half a quantiser step of
    /// the encoder's value.
    pub fn dequantise(&self, packing: &Packing, mut each: impl FnMut(u16, f64, f64)) {
        let transform = packing.transform;
        match &self.coded {
            Coded::Levels(levels) => {
                for level in levels {
                    let (re, im) = packing.quantiser.dequantise(transform, *level);
                    each(level.k, re, im);
                }
            }
            Coded::Times(events) => self.of_times(events, packing, each),
            Coded::Cell(_) => {
                let sign = f64::from(self.on) - f64::from(self.off);
                let shape = packing.shape();
                let u = self.single_u(packing).unwrap_or(0.5);
                match transform {
                    Transform::Dct => Dct::single(u, sign, shape, each),
                    Transform::Dtft => Dtft::single(u, sign, shape, each),
                    Transform::Dwt => Dwt::single(u, sign, shape, each),
                }
            }
        }
    }

    /// Calls `each` with the coefficients of events that are sent as times: those that an encoder would keep of them.
    fn of_times(
        &self,
        events: &TimedEvents,
        packing: &Packing,
        mut each: impl FnMut(u16, f64, f64),
    ) {
        let cells = packing.timed_cells(self.events());
        let (r, is_complex) = (packing.kept(), packing.transform.is_complex());
        let count = match packing.transform.rule() {
            Rule::LowFrequency => r,
            Rule::Magnitude => usize::from(packing.grid),
        };
        let mut sums = [(0.0, 0.0); TIMED_GRID_MAX as usize];
        let sums = sums.get_mut(..count).unwrap_or_default();
        for event in events {
            let sign = if event.is_on { 1.0 } else { -1.0 };
            add_atoms(packing.transform, cells.u(event.cell), sign, sums);
        }
        // Equal magnitudes have to be equal here too, whatever the rounding of their sums.
        let magnitude =
            |(re, im): (f64, f64)| libm::round((re * re + im * im) * MAGNITUDE_UNITS) as u64;
        let mut descending = [0; TIMED_GRID_MAX as usize];
        let descending = descending.get_mut(..count).unwrap_or_default();
        for (magnitude_of, sum) in descending.iter_mut().zip(&*sums) {
            *magnitude_of = magnitude(*sum);
        }
        descending.sort_unstable_by(|a, b| b.cmp(a));
        // The r largest, ties to the lower k: all, where there are no more.
        let least = descending.get(r.wrapping_sub(1)).copied().unwrap_or(0);
        let largest = descending.iter().take(r);
        let mut ties = largest.filter(|magnitude| **magnitude == least).count();
        let is_all = count <= r;
        for (k, sum) in (0..).zip(&*sums) {
            let magnitude = magnitude(*sum);
            let is_tie = magnitude == least && ties > 0;
            ties -= usize::from(is_tie);
            let is_sent = packing.transform != Transform::Dwt || magnitude > 0;
            if is_sent && (is_all || is_tie || magnitude > least) {
                each(k, sum.0, if is_complex { sum.1 } else { 0.0 });
            }
        }
    }

    /// Calls `each` with the time u, 0 to 1 within the window, and the polarity of every event whose time is sent, as
    /// the middle of its cell: of a single event, and of few.
    pub fn times(&self, packing: &Packing, mut each: impl FnMut(f64, bool)) {
        match &self.coded {
            Coded::Cell(_) => {
                if let Some(u) = self.single_u(packing) {
                    each(u, self.on > 0);
                }
            }
            Coded::Times(events) => {
                let cells = packing.timed_cells(self.events());
                for event in events {
                    each(cells.u(event.cell), event.is_on);
                }
            }
            Coded::Levels(_) => {}
        }
    }

    /// Returns the time u of a single event, 0 to 1 within the window, as the middle of its cell; `None` for
    /// several events.
    #[must_use]
    pub fn single_u(&self, packing: &Packing) -> Option<f64> {
        match self.coded {
            Coded::Cell(cell) => {
                let cells = f64::from(1_u32 << (packing.cells_log2() & 31));
                Some((f64::from(cell) + 0.5) / cells)
            }
            Coded::Levels(_) | Coded::Times(_) => None,
        }
    }
}

/// Units of |c|^2 in which coefficients computed from times are compared.
const MAGNITUDE_UNITS: f64 = 16_777_216.0;

/// Adds the atoms phi_k(u) (section 2 of the definitions) of an event of sign `sign` to the sums of k = 0, 1, ..., each re
/// and im.
fn add_atoms(transform: Transform, u: f64, sign: f64, sums: &mut [(f64, f64)]) {
    match transform {
        Transform::Dct => {
            for ((re, _), cos) in sums.iter_mut().zip(cosines(u)) {
                *re += sign * cos;
            }
        }
        Transform::Dtft => {
            for ((re, im), atom) in sums.iter_mut().zip(exponentials(u)) {
                *re += sign * atom.0;
                *im += sign * atom.1;
            }
        }
        Transform::Dwt => {
            let scales = (sums.len() | 1).ilog2();
            if let Some((re, _)) = sums.first_mut() {
                *re += sign;
            }
            for scale in 0..scales {
                let shifts = f64::from(1_u32 << scale);
                let shift = shifts * u;
                let m = shift as u32;
                let height = libm::sqrt(shifts);
                let is_first_half = shift - f64::from(m) < 0.5;
                let k = (1_usize << scale) + m as usize;
                if let Some((re, _)) = sums.get_mut(k) {
                    *re += sign * if is_first_half { height } else { -height };
                }
            }
        }
    }
}
