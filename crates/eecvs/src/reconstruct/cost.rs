//! Work of finding event times, in units that follow from the sizes of a pixel's problem.
//!
//! A unit is about a sixth of a nanosecond of one core, but it is counted, not timed: every step counts the work of
//! its loops before they run ([`Work::spend`](super::refine::Work::spend)), by the formulas below. [`Size::exact`],
//! [`Search::peaks`] and [`bins`] are the most that a pixel can cost. They multiply the same formulas by the largest
//! number of rounds of every loop, so no pixel spends more.

use eecvs_nostd::Transform;

use super::pursuit::pairs;
use super::{Pixel, crowd, ensemble, lattice, prony, pursuit, recover, refine};

/// Work for any pixel: memory, sorting its events and writing them.
pub const PIXEL: u64 = 500;
/// Work for each event of a pixel that is placed without being solved for.
const PLACED: u64 = 20;
/// Work of an exponential.
const FUNCTION: u64 = 8;
/// Work of a sine and a cosine.
const SINE: u64 = 60;
/// Work of an allocation.
const MEMORY: u64 = 50;
/// Work of an element of a linear system that is factorised: n^3 / 6 such elements of n equations.
const FACTOR: u64 = 1;
/// Work of an eigenvalue problem of n complex numbers, in units of n^3.
const EIGEN: u64 = 60;

/// Size of a table that is read from the processor's cache.
const CACHE_BYTES: u64 = 1 << 20;
/// Work of a number that comes from memory, where it would be 1 from the cache.
const UNCACHED: u64 = 8;

/// Sizes of a pixel's equations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Number of ON events.
    pub on: u64,
    /// Number of OFF events.
    pub off: u64,
    /// Number of k sent, without k = 0.
    pub terms: u64,
    /// Highest k sent.
    pub highest: u64,
    /// Number of equations, R.
    pub rows: u64,
}

impl Size {
    /// Returns the sizes of a pixel whose coefficients were sent.
    #[must_use]
    pub fn of(transform: Transform, pixel: &Pixel) -> Self {
        // k are in ascending order.
        let zeroth = pixel.coefficients.first().is_some_and(|(k, ..)| *k == 0);
        let terms = pixel.coefficients.len() as u64 - u64::from(zeroth);
        Self {
            on: pixel.on.into(),
            off: pixel.off.into(),
            terms,
            highest: pixel.coefficients.last().map_or(0, |(k, ..)| u64::from(*k)),
            rows: if transform.is_complex() {
                2 * terms
            } else {
                terms
            },
        }
    }

    /// Returns the number of events, n.
    #[must_use]
    pub const fn events(self) -> u64 {
        self.on + self.off
    }

    /// Returns whether the atoms of all k up to the highest are computed by a recurrence, rather than one by one.
    #[must_use]
    pub const fn is_dense(self) -> bool {
        self.highest <= 8 * self.terms
    }

    /// Work of the atoms of one event.
    const fn atoms(self) -> u64 {
        let of_terms = if self.is_dense() {
            SINE + 3 * self.highest
        } else {
            SINE * self.terms
        };
        of_terms + 2 * self.terms
    }

    /// Work of the residual of `events` events.
    pub(super) const fn residual(self, events: u64) -> u64 {
        events * (self.atoms() + self.rows) + self.rows
    }

    /// Work of the residual of `events` events with its slopes.
    pub(super) const fn linearise(self, events: u64) -> u64 {
        events * (self.atoms() + 3 * self.rows) + 4 * self.rows
    }

    /// Work of the normal equations of `events` events.
    pub(super) const fn normal(self, events: u64) -> u64 {
        events * (events + 5) / 2 * self.rows + MEMORY
    }

    /// Work of solving the normal equations.
    pub(super) const fn solve(self, events: u64) -> u64 {
        FACTOR * events * events * events / 6 + 4 * events * events + 3 * MEMORY
    }

    /// Work of trying a step of least squares.
    pub(super) const fn trial(self, events: u64) -> u64 {
        self.solve(events) + self.linearise(events)
    }

    /// The most that least squares can cost.
    const fn least_squares(self, events: u64, rounds: usize) -> u64 {
        let tried = refine::TRIALS as u64 * self.trial(events);
        self.linearise(events) + rounds as u64 * (self.normal(events) + tried)
    }

    /// The most that moving to the centre can cost.
    const fn centre(self) -> u64 {
        let events = self.events();
        let round = self.linearise(events)
            + self.normal(events)
            + self.solve(events)
            + refine::HALVINGS as u64 * self.residual(events);
        2 * self.residual(events)
            + self.least_squares(events, refine::WEIGHTED_ROUNDS)
            + refine::CENTRE_ROUNDS as u64 * round
    }

    /// Number of rows of the equations of densities.
    const fn density_rows(self) -> u64 {
        if self.rows < crowd::ROWS_MAX as u64 {
            self.rows
        } else {
            crowd::ROWS_MAX as u64
        }
    }

    /// Number of k of which a density has waves, and of its points, if the highest k used is `highest`.
    const fn waves(highest: u64) -> (u64, u64) {
        let highest = highest as usize;
        (crowd::limit(highest) as u64, crowd::points(highest) as u64)
    }

    /// Work of evaluating densities whose highest k is `highest`.
    pub(super) const fn density_value(self, highest: u64) -> u64 {
        let (waves, points) = Self::waves(highest);
        points * (waves / 4 + 2 * FUNCTION) + 2 * MEMORY
    }

    /// Work before the first step towards the flattest densities, and of placing the events in them.
    pub(super) const fn density_start(self, highest: u64) -> u64 {
        let (waves, points) = Self::waves(highest);
        points * waves + 2 * self.density_value(highest) + self.placed()
    }

    /// Work of a Newton step towards the flattest densities, without trying it.
    pub(super) const fn density_round(self, highest: u64) -> u64 {
        let ((waves, points), rows) = (Self::waves(highest), self.density_rows());
        2 * points * waves + 6 * rows * rows + self.solve(rows)
    }

    /// The most that the flattest densities can cost.
    const fn densities(self) -> u64 {
        // The highest k used is at most the highest k.
        let highest = if self.highest < crowd::USED_MAX {
            self.highest
        } else {
            crowd::USED_MAX
        };
        let tried = crowd::HALVINGS as u64 * self.density_value(highest);
        self.density_start(highest) + crowd::ROUNDS as u64 * (self.density_round(highest) + tried)
    }

    /// Work of placing all events in densities.
    pub(super) const fn placed(self) -> u64 {
        PLACED * self.events()
    }

    /// Work of sorting one solution among several, and of the median of its times.
    pub(super) const fn ordered(self) -> u64 {
        10 * PLACED * self.events()
    }

    /// Work of the matrix pencil.
    pub(super) const fn pencil(self) -> u64 {
        let size = if self.terms + 1 < prony::ROWS_MAX as u64 {
            self.terms + 1
        } else {
            prony::ROWS_MAX as u64
        };
        let events = self.events();
        let assigned = if events <= prony::ASSIGNED_MAX as u64 {
            (events * events) << events
        } else {
            0
        };
        EIGEN * (size * size * size + events * events * events) + assigned + 10 * MEMORY
    }

    /// Work of Newton's identities.
    pub(super) const fn newton(self) -> u64 {
        let events = self.events();
        EIGEN * events * events * events + 10 * MEMORY
    }

    /// The most that the median of many solutions can cost.
    const fn ensemble(self, search: Option<Search>, rounds: usize) -> u64 {
        let events = self.events();
        let mut starts = ensemble::PLACES.len() as u64;
        let mut units = self.densities();
        if let Some(search) = search {
            starts += 2;
            units += search.once(events) + search.refined(self);
        }
        let one = self.ordered() + self.least_squares(events, rounds) + self.residual(events);
        // The best one is refined again.
        units + (starts + 1) * one
    }

    /// The most that the first solution of several can cost.
    const fn fitted(self, search: Search) -> u64 {
        let events = self.events();
        let one = self.least_squares(events, refine::LEAST_SQUARES_ROUNDS) + self.residual(events);
        7 * one
            + search.paired(events)
            + search.once(events)
            + search.times(events)
            + search.refined(self)
            + self.pencil()
            + self.newton()
            + self.densities()
    }

    /// The most that exact decoding of a pixel can cost.
    #[must_use]
    pub const fn exact(self, search: Search, grid: OnGrid) -> u64 {
        let events = self.events();
        if recover::is_crowded(events, self.rows) {
            let found = if events > recover::CROWD_EVENTS_MAX as u64 {
                self.densities()
            } else {
                self.ensemble(None, recover::CROWD_ROUNDS) + self.residual(events)
            };
            return PIXEL + self.placed() + found;
        }
        let found = if events >= recover::MEDIAN_FROM as u64 {
            self.ensemble(Some(search), refine::LEAST_SQUARES_ROUNDS)
        } else {
            self.fitted(search)
        };
        PIXEL + found + 2 * self.residual(events) + self.centre() + 3 * grid.agree(events)
    }
}

/// Sizes of the search for peaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// Points of the search grid.
    pub points: u64,
    /// Number of known coefficients.
    pub known: u64,
    /// Highest known k plus 1.
    pub limit: u64,
    /// Whether a coefficient is two numbers.
    pub is_complex: bool,
    /// Whether a transform says which points are looked at.
    pub is_guided: bool,
}

impl Search {
    /// Work of the sums at a point.
    const fn of_point(self) -> u64 {
        // Sums over all k run in vector registers.
        let of_point = if self.limit > 8 * self.known {
            self.known
        } else {
            self.limit / 2
        };
        if self.is_complex {
            2 * of_point
        } else {
            of_point
        }
    }

    /// How much longer the sums of a point take where the table of all points does not fit into the processor's cache,
    /// and no transform leaves most of them out.
    const fn per_number(self) -> u64 {
        let table_bytes = 8 * self.points * self.limit;
        if self.is_guided || table_bytes <= CACHE_BYTES {
            1
        } else {
            UNCACHED
        }
    }

    /// Work of the transform, for a point.
    const fn guide(self) -> u64 {
        4 * self.points.ilog2() as u64 + 8
    }

    /// Returns whether the transform is cheaper than the sums at all points.
    #[must_use]
    pub const fn is_better_guided(self) -> bool {
        self.per_number() * self.of_point() > self.guide()
    }

    /// Work of finding an event if this many points are looked at.
    pub(super) const fn looked_at(self, points: u64) -> u64 {
        let polished = pursuit::NEWTON_STEPS as u64 * (8 * self.limit + SINE);
        let guided = if self.is_guided {
            self.points * self.guide()
        } else {
            0
        };
        guided + points * (self.per_number() * self.of_point() + 4) + polished
    }

    /// The most that finding an event can cost.
    const fn best(self) -> u64 {
        self.looked_at(self.points)
    }

    /// Work of finding a pair of events, and of taking it from the residual.
    pub(super) const fn pair(self) -> u64 {
        self.points * (self.of_point() + 4 + 3 * self.points / 2) + 2 * self.add()
    }

    /// The most that finding events two at a time can cost.
    const fn paired(self, events: u64) -> u64 {
        if self.points > pairs::POINTS_MAX as u64 || events > recover::PAIRED_EVENTS_MAX as u64 {
            return 0;
        }
        let table = self.points * (self.known + 3) + 4 * MEMORY;
        let again = pairs::PAIR_ROUNDS as u64 * events * events / 2;
        let single = self.best() + self.add();
        table + (events / 2) * self.pair() + single + again * (self.pair() + 2 * self.add())
    }

    /// Work of adding an event to the residual.
    pub(super) const fn add(self) -> u64 {
        4 * self.limit + SINE
    }

    /// Work of finding `events` events.
    const fn once(self, events: u64) -> u64 {
        events * (self.best() + self.add())
    }

    /// Work of finding `events` events and placing each of them again.
    const fn times(self, events: u64) -> u64 {
        let rounds = if events > 1 {
            pursuit::ROUNDS as u64
        } else {
            0
        };
        events * (self.best() + self.add() + rounds * (self.best() + 2 * self.add()))
    }

    /// The most that finding events with least squares after each can cost.
    const fn refined(self, size: Size) -> u64 {
        let events = size.events();
        let mut units = 0;
        let mut placed = 1;
        while placed <= events {
            units += self.best()
                + placed * self.add()
                + size.least_squares(placed, pursuit::PARTIAL_ROUNDS);
            placed += 1;
        }
        units
    }

    /// The most that finding the peaks of a pixel can cost.
    #[must_use]
    pub const fn peaks(self, events: u64) -> u64 {
        let found = if events <= pursuit::ROUNDS_EVENTS_MAX as u64 {
            self.times(events)
        } else {
            self.once(events)
        };
        PIXEL + found
    }
}

/// Sizes of the search on the microsecond grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OnGrid {
    /// K, of which the encoder's kernel computes all atoms.
    pub grid: u64,
    /// Number of equations, R.
    pub rows: u64,
}

impl OnGrid {
    /// Work of moving an event.
    pub(super) const fn place(self) -> u64 {
        lattice::PLACES as u64 * (4 * self.grid + self.rows + MEMORY) + 2 * self.rows
    }

    /// Work of looking for the best move, and of making it.
    pub(super) const fn descent(self, events: u64) -> u64 {
        let looks = if events <= lattice::PAIRS_EVENTS_MAX as u64 {
            2 * events * events
        } else {
            2 * events
        };
        looks * 4 * self.rows + 2 * self.place()
    }

    /// Work of looking at all moves of one or two events.
    pub(super) const fn pairs(self, events: u64) -> u64 {
        2 * events * events * 4 * self.rows
    }

    /// Work of looking at all candidates around one, of at most [`lattice::ALL_EVENTS_MAX`] events.
    pub(super) const fn around(self, events: u64) -> u64 {
        let reach = lattice::REACH[events as usize % lattice::REACH.len()];
        let around = (2 * reach as u64 + 1).pow(events as u32);
        events * self.place() + around * (events * self.rows + MEMORY)
    }

    /// The most that verifying times can cost.
    const fn agree(self, events: u64) -> u64 {
        let verified = if events <= lattice::ALL_EVENTS_MAX as u64 {
            lattice::CANDIDATES_MAX as u64 * self.around(events)
        } else {
            self.pairs(events)
        };
        events * self.place() + lattice::ROUNDS as u64 * self.descent(events) + verified
    }
}

/// Work of dealing `events` events to `grid` bins according to this many Haar coefficients.
#[must_use]
pub const fn bins(grid: u64, coefficients: u64, events: u64) -> u64 {
    let levels = grid.ilog2() as u64 + 1;
    // Coefficients of one scale cover each bin once.
    let covered = if coefficients < levels {
        coefficients
    } else {
        levels
    };
    PIXEL + grid * (8 + 2 * covered) + events * (PLACED + 12 * levels)
}
