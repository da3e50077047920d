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
use super::lanes::wide;
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
/// Places or moves whose atoms are looked at together.
const PLACE_LANES: usize = 8;
/// One number for each of them.
type Places = [i32; PLACE_LANES];
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

    /// Searches for times near `start` that encode to what was received, and for the middle of all that do.
    #[must_use]
    pub fn agree(&mut self, start: &[u32], work: &mut Work) -> Option<Agreed> {
        self.search(start, CANDIDATES_MAX, work)
    }

    /// Searches for times near `start` that encode to what was received. Unless they are unique, they are any that do.
    #[must_use]
    pub fn any(&mut self, start: &[u32], work: &mut Work) -> Option<Agreed> {
        self.search(start, 2, work)
    }

    fn search(&mut self, start: &[u32], most: usize, work: &mut Work) -> Option<Agreed> {
        let mut candidate = Candidate::new(self, start, work)?;
        if !candidate.descend(self, work) {
            return None;
        }
        Some(candidate.middle(self, most, work))
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

    /// Returns by how much the sums miss the received levels in total, or a number that is not below `bound`. The
    /// highest atoms change most, so their rows come first.
    fn outside(&self, lattice: &Lattice<'_>, moves: &[(usize, i32)], bound: u64) -> u64 {
        let mut outside = 0_u64;
        for (row, (least, most)) in lattice.rooms.iter().enumerate().rev() {
            let sum = self.sums[row] + self.moved(moves, row);
            let missed = (least - sum).max(sum - most).max(0).unsigned_abs();
            outside = outside.saturating_add(missed);
            if outside >= bound {
                break;
            }
        }
        outside
    }

    /// Writes the atoms of the first event at all places, row by row.
    fn by_row(&self, rows: &mut Vec<Places>) {
        let places = |row: usize| {
            let mut places = [0; PLACE_LANES];
            for (place, atom) in places.iter_mut().enumerate().take(PLACES) {
                *atom = self.atoms[self.at(0, place).start + row];
            }
            places
        };
        rows.clear();
        rows.extend((0..self.sums.len()).map(places));
    }

    /// Returns at which places of the first event all rows agree, with the atoms of the others that begin at `others`.
    #[inline(always)]
    fn agreeing(
        &self,
        lattice: &Lattice<'_>,
        first: &[Places],
        others: &[usize],
    ) -> [u32; PLACE_LANES] {
        let of_others = |row: usize| -> i64 {
            let atoms = others.iter().map(|at| i64::from(self.atoms[at + row]));
            atoms.sum()
        };
        let rooms = lattice.rooms.iter().enumerate();
        let rows = first.iter().zip(rooms).rev().map(|(atoms, (row, room))| {
            let others = of_others(row);
            (atoms, (room.0 - others, room.1 - others))
        });
        all_within(rows)
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
        let mut least = self.outside(lattice, &[], u64::MAX);
        for _ in 0..ROUNDS {
            if least == 0 {
                return true;
            }
            work.spend(lattice.grid_size.descent(n as u64));
            let mut best: Option<([(usize, i32); 2], usize)> = None;
            let mut look = |this: &Self, moves: [(usize, i32); 2], len: usize| {
                let outside = this.outside(lattice, &moves[..len], least);
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

    /// Collects the agreeing times that can be reached from these, until there are `most`, and returns those nearest to
    /// their mean.
    fn middle(mut self, lattice: &mut Lattice<'_>, most: usize, work: &mut Work) -> Agreed {
        let n = self.offsets.len();
        let first = self.offsets.clone();
        if n == 0 {
            return Agreed {
                offsets: first,
                is_unique: true,
            };
        }
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
        let of_others = places.pow(n as u32 - 1);
        let mut rows = Vec::new();
        'found: while next < found.len() && found.len() < most {
            let at = found[next];
            next += 1;
            work.spend(lattice.grid_size.around(n as u64));
            for i in 0..n {
                let offset = lattice.beside(first[i], at[i]).unwrap_or(first[i]);
                if self.offsets[i] != offset {
                    self.place(lattice, i, offset);
                }
            }
            self.by_row(&mut rows);
            for code in 0..of_others {
                let (mut places_of, mut to) = ([0; ALL_EVENTS_MAX], at);
                let mut rest = code;
                for (i, place) in places_of.iter_mut().enumerate().take(n).skip(1) {
                    let by = rest % places - reach;
                    *place = self.at(i, (by + REACH_MAX) as usize).start;
                    to[i] += by;
                    rest /= places;
                }
                let others = &places_of[1..n];
                let agreeing = agreeing(&self, lattice, &rows, others);
                for by in -reach..=reach {
                    to[0] = at[0] + by;
                    if agreeing[(by + REACH_MAX) as usize] != 0
                        && (0..n).all(|i| lattice.beside(first[i], to[i]).is_some())
                        && seen.insert(to)
                    {
                        found.push(to);
                    }
                }
                if most < CANDIDATES_MAX && found.len() >= most {
                    break 'found;
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
        let (n, rows) = (self.offsets.len(), self.sums.len());
        // The changes of all rows by all moves, several moves at a time: the moves of event i are 2 i and 2 i + 1.
        let blocks = (2 * n).div_ceil(PLACE_LANES);
        let mut changes = vec![[0; PLACE_LANES]; blocks * rows];
        for i in 0..n {
            let [back, still, on] = [-1, 0, 1].map(|by| self.at(i, (by + REACH_MAX) as usize));
            for (at, to) in [(2 * i, back), (2 * i + 1, on)] {
                let (block, lane) = (at / PLACE_LANES, at % PLACE_LANES);
                let rows = &mut changes[block * rows..][..rows];
                let atoms = self.atoms[to].iter().zip(&self.atoms[still.clone()]);
                for (row, (to, still)) in rows.iter_mut().zip(atoms) {
                    row[lane] = to - still;
                }
            }
        }
        let others = Others {
            sums: &self.sums,
            rooms: &lattice.rooms,
            changes: &changes,
        };
        others_agree(&others, n)
    }
}

/// Returns at which places of the first event all rows agree: see [`Candidate::agreeing`].
fn agreeing(
    candidate: &Candidate,
    lattice: &Lattice<'_>,
    first: &[Places],
    others: &[usize],
) -> [u32; PLACE_LANES] {
    wide!(
        Candidate::agreeing,
        candidate: &Candidate, lattice: &Lattice<'_>, first: &[Places], others: &[usize];
        [u32; PLACE_LANES]
    )
}

/// Changes of the sums by moves of single events.
struct Others<'c> {
    sums: &'c [i64],
    rooms: &'c [(i64, i64)],
    /// Blocks of moves: in each, all rows.
    changes: &'c [Places],
}

impl Others<'_> {
    /// Returns whether all rows agree after one of the moves of `n` events, or after two moves of different ones.
    #[inline(always)]
    fn agree(&self, n: usize) -> bool {
        let rows = self.sums.len();
        let blocks = || self.changes.chunks_exact(rows.max(1)).enumerate();
        // No move, and each move of the later event with all moves of those before it.
        (0..=2 * n).any(|later| {
            let (of_later, moves) = match later.checked_sub(1) {
                None => (None, 2 * n),
                Some(at) => (
                    Some((at / PLACE_LANES * rows, at % PLACE_LANES)),
                    at / 2 * 2,
                ),
            };
            let sum = |row: usize| {
                let change = of_later.map_or(0, |(first, lane)| self.changes[first + row][lane]);
                self.sums[row] + i64::from(change)
            };
            let used = blocks().take(moves.div_ceil(PLACE_LANES));
            used.into_iter().any(|(block, changes)| {
                let of_rooms = changes.iter().zip(self.rooms).enumerate().rev();
                let within = all_within(of_rooms.map(|(row, (changes, room))| {
                    let sum = sum(row);
                    (changes, (room.0 - sum, room.1 - sum))
                }));
                let lanes = PLACE_LANES.min(moves - block * PLACE_LANES);
                within[..lanes].iter().any(|within| *within != 0)
            })
        })
    }
}

fn others_agree(others: &Others<'_>, n: usize) -> bool {
    wide!(Others::agree, others: &Others<'_>, n: usize; bool)
}

/// Returns 1 for each lane whose numbers are in the rooms of all rows, and 0 for the others.
#[inline(always)]
fn all_within<'r>(rows: impl Iterator<Item = (&'r Places, (i64, i64))>) -> [u32; PLACE_LANES] {
    let mut within = [1; PLACE_LANES];
    for (numbers, (least, most)) in rows {
        // No number is at an end of what 32 bits hold.
        let limited = |end: i64| end.clamp(i32::MIN.into(), i32::MAX.into()) as i32;
        let (least, most) = (limited(least), limited(most));
        for lane in 0..PLACE_LANES {
            let number = numbers[lane];
            within[lane] &= u32::from((number >= least) & (number <= most));
        }
        if within.iter().fold(0, |any, within| any | within) == 0 {
            break;
        }
    }
    within
}
