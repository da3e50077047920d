//! Event times on the microsecond grid, verified by encoding them again.
//!
//! Atoms come from the encoder's own fixed-point kernel, whose sums add without rounding, so the levels of a
//! candidate are bit for bit what the encoder would have sent. No decoder can distinguish two candidates with the
//! same levels. If no other candidate agrees next to one that does, its times are taken as those of the events.

use std::ops::Range;

use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Sum};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft};
use eecvs_nostd::{Header, Transform};

use super::cost::OnGrid;
use super::equations::Equations;
use super::refine::Work;

/// Largest number of events in a pixel for which all neighbouring candidates are examined.
pub(super) const ALL_EVENTS_MAX: usize = 4;
/// Largest move of each event in microseconds, by the number of events: 5^3 neighbours are examined for 3 events,
/// and 3^4 for 4.
pub(super) const REACH: [i32; ALL_EVENTS_MAX + 1] = [2, 2, 2, 2, 1];
/// Largest move of an event from one candidate to the next, in microseconds.
const REACH_MAX: i32 = 2;
/// Number of offsets per event whose atoms are stored.
pub(super) const PLACES: usize = 2 * REACH_MAX as usize + 1;
/// Largest number of agreeing candidates collected.
pub(super) const CANDIDATES_MAX: usize = 64;
/// Largest number of steps in the descent to a candidate that agrees.
pub(super) const ROUNDS: usize = 40;
/// Largest number of events in a pixel for which the descent also moves pairs of events.
pub(super) const PAIRS_EVENTS_MAX: usize = 12;

/// Largest number of events that can be verified, which is the number that the encoder sums in one chunk.
pub const EVENTS_MAX: usize = CHUNK_EVENTS;

/// Returns the offset in microseconds of a single event, and whether it is the only possible one.
///
/// `u` is the middle of the cell that was sent. The result is the middle of the offsets that the encoder maps to
/// that cell.
#[must_use]
pub fn single(header: &Header, u: f64) -> (u32, bool) {
    let duration = u64::from(header.duration_us.max(1));
    let cells_log2 = header.packing().cells_log2();
    let cell = (u * f64::from(cells_log2).exp2()) as u64;
    let scale = PhaseScale::new(header.duration_us);
    let is_in = |offset: u64| {
        let of = match header.transform {
            Transform::Dct => Dct::cell(scale, offset as u32, cells_log2),
            _ => Dtft::cell(scale, offset as u32, cells_log2),
        };
        u64::from(of) == cell
    };
    // The encoder's phase is slightly below u, so the edges may be off by one.
    let edge = |cell: u64| ((cell * duration) >> cells_log2).min(duration - 1);
    let (from, to) = (
        edge(cell).saturating_sub(1),
        edge(cell + 1).saturating_add(1).min(duration - 1),
    );
    let first = (from..=to).take(4).find(|offset| is_in(*offset));
    let last = (from..=to).rev().take(4).find(|offset| is_in(*offset));
    match first.zip(last) {
        Some((first, last)) => (first.midpoint(last) as u32, first == last),
        // No offset falls into this cell.
        None => (edge(cell) as u32, false),
    }
}

/// Verifies event times of one pixel.
#[derive(Debug)]
pub struct Lattice<'e> {
    equations: &'e Equations,
    scale: PhaseScale,
    grid: usize,
    /// Sizes from which the work follows.
    grid_size: OnGrid,
    sums: Vec<Sum>,
    /// For each row, the smallest and the largest sum that quantise to the received level.
    rooms: Vec<(i64, i64)>,
}

/// Times that encode to what was received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Agreed {
    /// Offsets in microseconds, in the order of the signs.
    pub offsets: Vec<u32>,
    /// Whether no other times examined next to these agree.
    pub is_unique: bool,
}

impl<'e> Lattice<'e> {
    /// Prepares the verification of a pixel with at most [`EVENTS_MAX`] events.
    #[must_use]
    pub fn new(header: &Header, equations: &'e Equations) -> Self {
        let grid = usize::from(header.grid);
        let step = 2.0 * equations.half_step;
        let unit = f64::from(header.quantiser.shift()).exp2();
        // Sums of so few events stay far below this; it prevents overflow whatever a frame contains.
        let bound = (1_u64 << 60) as f64;
        let room = |middle: &f64| {
            let level = (middle / step - 0.5).round();
            let least = (level * unit).clamp(-bound, bound) as i64;
            (least, least + unit as i64 - 1)
        };
        Self {
            equations,
            scale: PhaseScale::new(equations.duration_us),
            grid,
            grid_size: OnGrid {
                grid: grid as u64,
                rows: equations.rows() as u64,
            },
            sums: vec![Sum::ZERO; 2 * grid],
            rooms: equations.middles.iter().map(room).collect(),
        }
    }

    /// Writes the encoder's atoms for event `i` at an offset.
    fn atoms(&mut self, i: usize, offset_us: u32, atoms: &mut [i32]) {
        let impulse = Impulse {
            offset_us,
            is_on: self.equations.signs[i] > 0.0,
        };
        let one = std::iter::once(impulse);
        match self.equations.transform {
            Transform::Dct => Dct::accumulate(one, self.scale, self.grid, &mut self.sums),
            _ => Dtft::accumulate(one, self.scale, self.grid, &mut self.sums),
        }
        let ks = self.equations.ks.iter().map(|k| usize::from(*k));
        if self.equations.transform.is_complex() {
            let (pairs, _) = atoms.as_chunks_mut::<2>();
            for (atoms, k) in pairs.iter_mut().zip(ks) {
                *atoms = [self.sums[2 * k], self.sums[2 * k + 1]].map(Sum::to_bits);
            }
        } else {
            for (atom, k) in atoms.iter_mut().zip(ks) {
                *atom = self.sums[k].to_bits();
            }
        }
    }

    /// Returns the offset moved by `by` microseconds, wrapped around the window for periodic atoms; `None` outside
    /// the window.
    fn beside(&self, offset_us: u32, by: i32) -> Option<u32> {
        let duration = i64::from(self.equations.duration_us);
        let next = i64::from(offset_us) + i64::from(by);
        if (0..duration).contains(&next) {
            return Some(next as u32);
        }
        self.equations
            .transform
            .is_complex()
            .then(|| next.rem_euclid(duration) as u32)
    }

    /// Returns by how much the sums miss the received levels in total.
    fn outside(&self, sums: impl Iterator<Item = i64>) -> u64 {
        let outside = |(sum, (least, most)): (i64, &(i64, i64))| {
            (least - sum).max(sum - most).max(0).unsigned_abs()
        };
        sums.zip(&self.rooms)
            .map(outside)
            .fold(0, u64::saturating_add)
    }

    /// Searches for times near `start` that encode to what was received.
    #[must_use]
    pub fn agree(&mut self, start: &[u32], work: &mut Work) -> Option<Agreed> {
        let mut candidate = Candidate::new(self, start, work)?;
        if !candidate.descend(self, work) {
            return None;
        }
        Some(candidate.middle(self, work))
    }
}

/// Distances of candidates that were found already; there are at most [`CANDIDATES_MAX`] and those around one.
#[derive(Debug)]
struct Seen {
    /// Distances plus 2^15, at the first free place from that of their hash; 0 is free.
    slots: [u64; Seen::SLOTS],
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            slots: [0; Self::SLOTS],
        }
    }
}

impl Seen {
    /// More than twice as many as there can be.
    const SLOTS: usize = 512;

    /// Adds distances; returns whether they are new.
    fn insert(&mut self, distances: [i32; ALL_EVENTS_MAX]) -> bool {
        let key = distances.iter().fold(0, |key, distance| {
            key << 16 | u64::from((distance + (1 << 15)) as u16)
        });
        let mut at = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 55) as usize;
        while self.slots[at] != 0 {
            if self.slots[at] == key {
                return false;
            }
            at = (at + 1) % Self::SLOTS;
        }
        self.slots[at] = key;
        true
    }
}

/// Candidate times with their atoms, and those of the neighbouring offsets.
struct Candidate {
    offsets: Vec<u32>,
    /// For each event and each offset from -[`REACH_MAX`] to +[`REACH_MAX`] microseconds, the atoms of all rows.
    atoms: Vec<i32>,
    sums: Vec<i64>,
}

impl Candidate {
    fn new(lattice: &mut Lattice<'_>, offsets: &[u32], work: &mut Work) -> Option<Self> {
        if offsets.len() > EVENTS_MAX || lattice.equations.duration_us <= PLACES as u32 {
            return None;
        }
        let rows = lattice.rooms.len();
        let mut candidate = Self {
            offsets: offsets.to_vec(),
            atoms: vec![0; offsets.len() * PLACES * rows],
            sums: vec![0; rows],
        };
        work.spend(offsets.len() as u64 * lattice.grid_size.place());
        for i in 0..offsets.len() {
            for place in 0..PLACES {
                candidate.compute(lattice, i, place);
            }
            candidate.add(i, 1);
        }
        Some(candidate)
    }

    /// Returns where the atoms of event `i` at a place are.
    const fn at(&self, i: usize, place: usize) -> Range<usize> {
        let rows = self.sums.len();
        let first = (i * PLACES + place) * rows;
        first..first + rows
    }

    /// Computes the atoms of event `i` at a place.
    fn compute(&mut self, lattice: &mut Lattice<'_>, i: usize, place: usize) {
        let (at, offset_us) = (self.at(i, place), self.offsets[i]);
        let beside = lattice.beside(offset_us, place as i32 - REACH_MAX);
        lattice.atoms(i, beside.unwrap_or(offset_us), &mut self.atoms[at]);
    }

    /// Adds `factor` times the atoms of event `i` to the sums.
    fn add(&mut self, i: usize, factor: i64) {
        let at = self.at(i, REACH_MAX as usize);
        for (sum, atom) in self.sums.iter_mut().zip(&self.atoms[at]) {
            *sum += factor * i64::from(*atom);
        }
    }

    /// Moves event `i` to an offset.
    fn place(&mut self, lattice: &mut Lattice<'_>, i: usize, offset_us: u32) {
        self.add(i, -1);
        let by = i64::from(offset_us) - i64::from(self.offsets[i]);
        self.offsets[i] = offset_us;
        // What both places have is kept; beyond the window's ends, places hold other offsets.
        let margin = PLACES as u32;
        let is_inside = |offset_us: u32| {
            (margin..lattice.equations.duration_us.saturating_sub(margin)).contains(&offset_us)
        };
        let kept = match usize::try_from(by.abs()) {
            Ok(by) if by < PLACES && is_inside(offset_us) => PLACES - by,
            _ => 0,
        };
        let rows = self.sums.len();
        let all = self.at(i, 0).start..self.at(i, PLACES - 1).end;
        let moved = (PLACES - kept) * rows;
        let is_later = by > 0;
        if is_later {
            self.atoms[all].copy_within(moved.., 0);
        } else {
            self.atoms[all].copy_within(..kept * rows, moved);
        }
        let new = if is_later {
            kept..PLACES
        } else {
            0..PLACES - kept
        };
        for place in new {
            self.compute(lattice, i, place);
        }
        self.add(i, 1);
    }

    /// Returns the change of a row's sum if these events move by these microseconds.
    fn moved(&self, moves: &[(usize, i32)], row: usize) -> i64 {
        moves
            .iter()
            .map(|(i, by)| {
                let of = |by: i32| self.atoms[self.at(*i, (by + REACH_MAX) as usize).start + row];
                i64::from(of(*by)) - i64::from(of(0))
            })
            .sum()
    }

    fn outside(&self, lattice: &Lattice<'_>, moves: &[(usize, i32)]) -> u64 {
        let sums = self.sums.iter().enumerate();
        lattice.outside(sums.map(|(row, sum)| sum + self.moved(moves, row)))
    }

    /// Returns whether all rows agree; mostly the first rows decide.
    fn agrees(&self, lattice: &Lattice<'_>, moves: &[(usize, i32)]) -> bool {
        let mut rows = self.sums.iter().zip(&lattice.rooms).enumerate();
        rows.all(|(row, (sum, (least, most)))| {
            (*least..=*most).contains(&(sum + self.moved(moves, row)))
        })
    }

    /// Returns whether all rows agree with the atoms of all events that begin at these places.
    fn agrees_at(&self, lattice: &Lattice<'_>, places: &[usize]) -> bool {
        let mut rows = lattice.rooms.iter().enumerate();
        rows.all(|(row, (least, most))| {
            let atoms = places.iter().map(|at| i64::from(self.atoms[at + row]));
            (*least..=*most).contains(&atoms.sum::<i64>())
        })
    }

    fn apply(&mut self, lattice: &mut Lattice<'_>, moves: &[(usize, i32)]) {
        for (i, by) in moves {
            if let Some(offset_us) = lattice.beside(self.offsets[*i], *by) {
                self.place(lattice, *i, offset_us);
            }
        }
    }

    /// Moves one or two events at a time by a microsecond, taking the move with the smallest miss, until all rows
    /// agree.
    fn descend(&mut self, lattice: &mut Lattice<'_>, work: &mut Work) -> bool {
        let n = self.offsets.len();
        let mut least = self.outside(lattice, &[]);
        for _ in 0..ROUNDS {
            if least == 0 {
                return true;
            }
            work.spend(lattice.grid_size.descent(n as u64));
            let mut best: Option<([(usize, i32); 2], usize)> = None;
            let mut look = |this: &Self, moves: [(usize, i32); 2], len: usize| {
                let outside = this.outside(lattice, &moves[..len]);
                if outside < least {
                    (least, best) = (outside, Some((moves, len)));
                }
            };
            for i in 0..n {
                for by in [-1, 1] {
                    look(self, [(i, by), (0, 0)], 1);
                    if n > PAIRS_EVENTS_MAX {
                        continue;
                    }
                    for j in 0..i {
                        for other in [-1, 1] {
                            look(self, [(i, by), (j, other)], 2);
                        }
                    }
                }
            }
            let Some((moves, len)) = best else {
                return false;
            };
            self.apply(lattice, &moves[..len]);
        }
        least == 0
    }

    /// Collects the agreeing times that can be reached from these, and returns those nearest to their mean.
    fn middle(mut self, lattice: &mut Lattice<'_>, work: &mut Work) -> Agreed {
        let n = self.offsets.len();
        let first = self.offsets.clone();
        if n > ALL_EVENTS_MAX {
            work.spend(lattice.grid_size.pairs(n as u64));
            let is_unique = !self.has_other(lattice);
            return Agreed {
                offsets: first,
                is_unique,
            };
        }
        // Distances from the first candidate, which do not wrap around the window.
        let mut found: Vec<[i32; ALL_EVENTS_MAX]> = vec![[0; ALL_EVENTS_MAX]];
        let mut seen = Seen::default();
        seen.insert(found[0]);
        let mut next = 0;
        let reach = REACH[n];
        let places = 2 * reach + 1;
        let around = places.pow(n as u32);
        while next < found.len() && found.len() < CANDIDATES_MAX {
            let at = found[next];
            next += 1;
            work.spend(lattice.grid_size.around(n as u64));
            for i in 0..n {
                let offset = lattice.beside(first[i], at[i]).unwrap_or(first[i]);
                if self.offsets[i] != offset {
                    self.place(lattice, i, offset);
                }
            }
            for code in 0..around {
                let (mut places_of, mut to) = ([0; ALL_EVENTS_MAX], at);
                let mut rest = code;
                for (i, place) in places_of.iter_mut().take(n).enumerate() {
                    let by = rest % places - reach;
                    *place = self.at(i, (by + REACH_MAX) as usize).start;
                    to[i] += by;
                    rest /= places;
                }
                if self.agrees_at(lattice, &places_of[..n])
                    && (0..n).all(|i| lattice.beside(first[i], to[i]).is_some())
                    && seen.insert(to)
                {
                    found.push(to);
                }
            }
        }
        let mean: Vec<f64> = (0..n)
            .map(|i| found.iter().map(|at| f64::from(at[i])).sum::<f64>() / found.len() as f64)
            .collect();
        let distance = |at: &[i32; ALL_EVENTS_MAX]| -> f64 {
            at.iter()
                .zip(&mean)
                .map(|(at, mean)| (f64::from(*at) - mean).abs())
                .sum()
        };
        let best = found
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let best = best.copied().unwrap_or_default();
        let offsets = (0..n).map(|i| lattice.beside(first[i], best[i]).unwrap_or(first[i]));
        Agreed {
            offsets: offsets.collect(),
            is_unique: found.len() == 1,
        }
    }

    /// Returns whether other times agree when one or two events move by a microsecond.
    fn has_other(&self, lattice: &Lattice<'_>) -> bool {
        let n = self.offsets.len();
        let agrees = |moves: &[(usize, i32)]| self.agrees(lattice, moves);
        (0..n).any(|i| {
            [-1, 1].into_iter().any(|by| {
                let pairs = (0..i).flat_map(|j| [(j, -1), (j, 1)]);
                agrees(&[(i, by)]) || pairs.into_iter().any(|other| agrees(&[(i, by), other]))
            })
        })
    }
}
