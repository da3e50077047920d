//! Event times by matching pursuit: peaks of the summed atoms, one after the other.
//!
//! The frames carry the counts, so n times are sought. They are found one by one with known amplitudes: an event of
//! polarity p at u explains the residual c best where
//!
//! ```text
//! J(u) = p sum_k Re(c_k conj(phi_k(u))) - sum_k |phi_k(u)|^2 / 2
//! ```
//!
//! is largest. The peak is searched on a grid of 4 K points (at least 64), which is four per half-period of the
//! highest DCT atom or per period of the highest DTFT atom, and polished by Newton steps. In small pixels each
//! event is then taken out and placed again in further rounds. [`Peaks::refined`] moves all events placed so far by
//! least squares after each event.
//!
//! Mallat, Zhang: *Matching pursuits with time-frequency dictionaries*, IEEE Trans. Signal Processing 41 (1993).

pub(super) mod pairs;

use std::array::from_fn;
use std::f64::consts::FRAC_PI_2;

use eecvs_nostd::Transform;
use nalgebra::Complex;

use super::Pixel;
use super::cost::{PIXEL, Search};
use super::equations::Equations;
use super::guide::Guide;
use super::lanes::{LANES, Lanes, sin_cos, sum, wide};
use super::refine::{Patience, Work, least_squares};
use pairs::Turns;

/// Points of the search grid for each atom.
const POINTS_PER_ATOM: usize = 4;
/// Largest number of Newton steps to polish a peak.
pub(super) const NEWTON_STEPS: usize = 12;
/// Largest number of Newton steps where least squares follow.
const ROUGH_STEPS: usize = 2;
/// Rounds in which every event is placed again.
pub(super) const ROUNDS: usize = 3;
/// Largest number of events in a pixel whose events are placed again; for more, the rounds cost more than they
/// gain.
pub(super) const ROUNDS_EVENTS_MAX: usize = 16;

/// Largest number of least-squares rounds after each event.
pub(super) const PARTIAL_ROUNDS: usize = 6;

/// A decoded event of a pixel: time u, normalised to the window, and polarity p (+1 or -1).
pub type Placed = (f64, f64);

/// Finds the events of pixels of one transform, grid size K and M by their peaks.
#[derive(Debug)]
pub struct Peaks {
    transform: Transform,
    grid: usize,
    /// r = min(M, K).
    kept: usize,
    /// Number of points of the search grid.
    points: usize,
    /// phi_k(point), real and imaginary parts: [k * points + point].
    atoms_re: Vec<f32>,
    atoms_im: Vec<f32>,
    /// sum_k |phi_k|^2 / 2 at each point, for the DCT.
    half_energy: Vec<f32>,
    /// Which points of a fine grid are looked at, for the DTFT.
    guide: Option<Guide>,
    /// Unless the grid is too fine to look at all pairs of points.
    turns: Option<Turns>,
}

impl Peaks {
    /// Creates the tables for the DCT or the DTFT with K = `grid`, of which `kept` coefficients are sent.
    #[must_use]
    pub fn new(transform: Transform, grid: usize, kept: usize) -> Self {
        let points = (POINTS_PER_ATOM * grid).max(64);
        let mut peaks = Self {
            transform,
            grid,
            kept,
            points,
            atoms_re: Vec::with_capacity(points * grid),
            atoms_im: Vec::with_capacity(points * grid),
            half_energy: Vec::with_capacity(points),
            guide: None,
            turns: (points <= pairs::POINTS_MAX).then(|| Turns::new(transform, points, grid)),
        };
        if transform.is_complex() {
            peaks.guide = Guide::new(points, grid);
        }
        let middles = (0..points).map(|point| (point as f64 + 0.5) / points as f64);
        let middles: Vec<f64> = middles.collect();
        let mut energy = vec![0.0; points];
        for k in 0..grid {
            for (u, energy) in middles.iter().zip(&mut energy) {
                let (sin, cos) = (peaks.omega(k) * u).sin_cos();
                peaks.atoms_re.push(cos as f32);
                peaks.atoms_im.push(-sin as f32);
                if k > 0 && k < kept {
                    *energy += cos * cos;
                }
            }
        }
        let halves = energy.iter().map(|energy| (energy / 2.0) as f32);
        peaks.half_energy.extend(halves);
        peaks
    }

    /// Returns (u, p) of a pixel's events, `on` with p = +1 and `off` with p = -1, in no particular order.
    #[must_use]
    pub fn pixel(&self, pixel: &Pixel, work: &mut Work) -> Vec<Placed> {
        work.spend(PIXEL);
        let events = pixel.on as usize + pixel.off as usize;
        let rounds = if events <= ROUNDS_EVENTS_MAX {
            ROUNDS
        } else {
            0
        };
        placed(Pursuit::new(self, pixel), pixel, rounds, work)
    }

    /// Returns rough times u of a pixel's events, those of the ON events first, each placed once.
    #[must_use]
    pub fn once(&self, pixel: &Pixel, work: &mut Work) -> Vec<f64> {
        on_first(&placed(Pursuit::rough(self, pixel), pixel, 0, work))
    }

    /// Returns rough times u of a pixel's events, those of the ON events first. Unlike [`Self::pixel`] it places
    /// events again whatever their number.
    #[must_use]
    pub fn times(&self, pixel: &Pixel, work: &mut Work) -> Vec<f64> {
        on_first(&placed(Pursuit::rough(self, pixel), pixel, ROUNDS, work))
    }

    /// Returns the times u of a pixel's events, those of the ON events first, placed two at a time (`pairs`) on
    /// the points of the grid; `None` if the grid is too large, or the coefficients for f32.
    #[must_use]
    pub fn paired(&self, pixel: &Pixel, work: &mut Work) -> Option<Vec<f64>> {
        if pixel.on + pixel.off < 2 {
            return None;
        }
        let (pursuit, counts) = (Pursuit::rough(self, pixel), (pixel.on, pixel.off));
        let turns = self.turns.as_ref()?;
        Some(on_first(&pairs::placed(pursuit, counts, turns, work)?))
    }

    /// As [`Self::times`], but after each event all events placed so far move to where together they explain the
    /// coefficients best. Neighbours that share one peak separate at once, and the remaining residual has no side
    /// lobes from them.
    #[must_use]
    pub fn refined(&self, pixel: &Pixel, equations: &Equations, work: &mut Work) -> Vec<f64> {
        let peaks = self;
        wide!(
            Peaks::refining,
            peaks: &Peaks, pixel: &Pixel, equations: &Equations, work: &mut Work;
            Vec<f64>
        )
    }

    #[inline(always)]
    fn refining(&self, pixel: &Pixel, equations: &Equations, work: &mut Work) -> Vec<f64> {
        let mut partial = equations.clone();
        partial.signs.clear();
        let mut pursuit = Pursuit::rough(self, pixel);
        let whole = (pursuit.re.clone(), pursuit.im.clone());
        let (mut on, mut off) = (pixel.on, pixel.off);
        let mut times: Vec<f64> = Vec::new();
        while on + off > 0 {
            let placed = times.len() as u64 + 1;
            work.spend(placed * pursuit.search.add());
            let (u, sign) = pursuit.best(on > 0, off > 0, work);
            if sign > 0.0 {
                on -= 1;
            } else {
                off -= 1;
            }
            times.push(u);
            partial.signs.push(sign);
            least_squares(&partial, &mut times, (PARTIAL_ROUNDS, Patience::Long), work);
            pursuit.re.clone_from(&whole.0);
            pursuit.im.clone_from(&whole.1);
            for (u, sign) in times.iter().zip(&partial.signs) {
                pursuit.add((*u, *sign), -1.0);
            }
        }
        let placed: Vec<Placed> = times.into_iter().zip(partial.signs).collect();
        on_first(&placed)
    }

    /// Returns the sizes of the search for a pixel's events.
    #[must_use]
    pub fn search(&self, pixel: &Pixel) -> Search {
        let (known, limit) = if self.transform == Transform::Dct {
            (self.kept.saturating_sub(1), self.kept)
        } else {
            let sent = pixel.coefficients.iter().filter(|(k, ..)| *k > 0);
            let highest = pixel.coefficients.last().map_or(0, |(k, ..)| *k);
            (sent.count(), usize::from(highest) + 1)
        };
        let plain = Search {
            points: self.points as u64,
            known: known as u64,
            limit: limit as u64,
            is_complex: self.transform.is_complex(),
            is_guided: false,
        };
        Search {
            is_guided: self.guide.is_some() && plain.is_better_guided(),
            ..plain
        }
    }

    /// Angle of atom k per unit of u.
    fn omega(&self, k: usize) -> f64 {
        omega(self.transform) * k as f64
    }
}

/// Places a pixel's events, and then each of them again in so many rounds.
fn placed(pursuit: Pursuit<'_>, pixel: &Pixel, rounds: usize, work: &mut Work) -> Vec<Placed> {
    let counts = (pixel.on, pixel.off);
    wide!(
        Pursuit::run,
        pursuit: Pursuit<'_>, counts: (u32, u32), rounds: usize, work: &mut Work;
        Vec<Placed>
    )
}

/// Returns the times of the ON events, followed by those of the OFF events.
fn on_first(placed: &[Placed]) -> Vec<f64> {
    let of = |is_on: bool| {
        placed
            .iter()
            .filter(move |(_, sign)| (*sign > 0.0) == is_on)
    };
    of(true).chain(of(false)).map(|(u, _)| *u).collect()
}

/// Returns the angle of atom k = 1 per unit of u: pi for the DCT, 2 pi for the DTFT.
pub(super) fn omega(transform: Transform) -> f64 {
    match transform {
        Transform::Dct => std::f64::consts::PI,
        Transform::Dtft | Transform::Dwt => std::f64::consts::TAU,
    }
}

/// Matching pursuit of one pixel.
struct Pursuit<'d> {
    peaks: &'d Peaks,
    /// Indices of the known coefficients, ascending; without k = 0, which says nothing about times.
    known: Vec<usize>,
    /// 1 for these, 0 for all others.
    is_known: Vec<f64>,
    /// Residual coefficients after the events placed so far.
    re: Vec<f32>,
    im: Vec<f32>,
    /// Numbers of the guide.
    numbers: Vec<Complex<f64>>,
    /// Sums of all points.
    correlations: Vec<f32>,
    /// Heights of the second of two events, and the largest ones of both.
    numbers_of_pairs: [Vec<f32>; 2],
    /// Points that the guide found.
    candidates: Vec<usize>,
    /// Sizes from which the work follows.
    search: Search,
    /// Largest number of Newton steps to polish a peak.
    newton_steps: usize,
}

impl<'d> Pursuit<'d> {
    fn new(peaks: &'d Peaks, pixel: &Pixel) -> Self {
        let mut re = vec![0.0; peaks.grid];
        let mut im = vec![0.0; peaks.grid];
        for (k, of_re, of_im) in &pixel.coefficients {
            (re[usize::from(*k)], im[usize::from(*k)]) = (*of_re as f32, *of_im as f32);
        }
        let known: Vec<usize> = if peaks.transform == Transform::Dct {
            // The DCT keeps every k < r, so a coefficient that was not sent is known to be 0.
            (1..peaks.kept).collect()
        } else {
            let sent = pixel.coefficients.iter().map(|(k, ..)| usize::from(*k));
            sent.filter(|k| *k > 0).collect()
        };
        (re[0], im[0]) = (0.0, 0.0);
        let mut is_known = vec![0.0; peaks.grid];
        known.iter().for_each(|k| is_known[*k] = 1.0);
        Self {
            peaks,
            known,
            is_known,
            re,
            im,
            numbers: Vec::new(),
            correlations: Vec::new(),
            numbers_of_pairs: Default::default(),
            candidates: Vec::new(),
            search: peaks.search(pixel),
            newton_steps: NEWTON_STEPS,
        }
    }

    /// Begins a pursuit whose times least squares refine.
    fn rough(peaks: &'d Peaks, pixel: &Pixel) -> Self {
        Self {
            newton_steps: ROUGH_STEPS,
            ..Self::new(peaks, pixel)
        }
    }

    /// Returns the highest known k plus 1.
    fn limit(&self) -> usize {
        self.known.last().map_or(0, |k| k + 1)
    }

    #[inline(always)]
    fn run(mut self, (mut on, mut off): (u32, u32), rounds: usize, work: &mut Work) -> Vec<Placed> {
        let mut placed = Vec::with_capacity((on + off) as usize);
        while on + off > 0 {
            let event = self.best(on > 0, off > 0, work);
            if event.1 > 0.0 {
                on -= 1;
            } else {
                off -= 1;
            }
            work.spend(self.search.add());
            self.add(event, -1.0);
            placed.push(event);
        }
        if placed.len() > 1 {
            for _ in 0..rounds {
                work.spend(2 * placed.len() as u64 * self.search.add());
                for event in &mut placed {
                    self.add(*event, 1.0);
                    *event = self.best(event.1 > 0.0, event.1 < 0.0, work);
                    self.add(*event, -1.0);
                }
            }
        }
        placed
    }

    /// Adds `factor` times an event's atoms to the residual.
    #[inline(always)]
    fn add(&mut self, (u, sign): Placed, factor: f64) {
        let by = factor * sign;
        let is_complex = self.peaks.transform.is_complex();
        let mut atoms = Atoms::of(self.peaks.transform, u);
        for at in (0..self.limit()).step_by(LANES) {
            let (sin, cos) = atoms.next();
            for lane in 0..LANES.min(self.re.len() - at) {
                // What is not known stays 0.
                let by = by * self.is_known[at + lane];
                self.re[at + lane] += (by * cos[lane]) as f32;
                if is_complex {
                    self.im[at + lane] -= (by * sin[lane]) as f32;
                }
            }
        }
    }

    /// Returns the event that explains the residual best.
    #[inline(always)]
    fn best(&mut self, may_be_on: bool, may_be_off: bool, work: &mut Work) -> Placed {
        let allowed = (may_be_on, may_be_off);
        let (point, sign) = if self.guided(allowed) {
            work.spend(self.search.looked_at(self.candidates.len() as u64));
            let mut best = (f32::NEG_INFINITY, 0, 1.0);
            for point in &self.candidates {
                self.look(*point, allowed, &mut best);
            }
            (best.1, best.2)
        } else {
            work.spend(self.search.looked_at(self.search.points));
            self.highest(allowed)
        };
        let u = (point as f64 + 0.5) / self.peaks.points as f64;
        (self.polish(u, sign), sign)
    }

    /// Computes the sums of all points.
    #[inline(always)]
    fn correlate(&mut self) {
        let peaks = self.peaks;
        let correlations = &mut self.correlations;
        correlations.clear();
        correlations.resize(peaks.points, 0.0);
        let row = |k: usize| k * peaks.points..(k + 1) * peaks.points;
        for k in &self.known {
            let (re, im) = (self.re[*k], self.im[*k]);
            let atoms = &peaks.atoms_re[row(*k)];
            if peaks.transform.is_complex() {
                let atoms = atoms.iter().zip(&peaks.atoms_im[row(*k)]);
                for (sum, (cos, sin)) in correlations.iter_mut().zip(atoms) {
                    *sum += re * cos + im * sin;
                }
            } else {
                for (sum, cos) in correlations.iter_mut().zip(atoms) {
                    *sum += re * cos;
                }
            }
        }
    }

    /// Returns the first point of highest J, and its sign.
    #[inline(always)]
    fn highest(&mut self, (may_be_on, may_be_off): (bool, bool)) -> (usize, f64) {
        self.correlate();
        let peaks = self.peaks;
        let is_complex = peaks.transform.is_complex();
        let correlations = &self.correlations;
        let of = |at: usize, correlation: f32, sign: f32| {
            let energy = if is_complex {
                0.0
            } else {
                peaks.half_energy[at]
            };
            sign * correlation - energy
        };
        let mut best = (f32::NEG_INFINITY, 0, 1.0);
        for (is_allowed, sign) in [(may_be_on, 1.0), (may_be_off, -1.0)] {
            if !is_allowed {
                continue;
            }
            let most = highest_of(correlations, |at, c| of(at, c, sign));
            let mut all = correlations.iter().enumerate();
            // Of equal heights the first counts, and at one point ON.
            if most >= best.0
                && let Some((at, _)) = all.find(|(at, c)| of(*at, **c, sign) == most)
                && (most > best.0 || at < best.1)
            {
                best = (most, at, f64::from(sign));
            }
        }
        (best.1, best.2)
    }

    /// Collects the points where J may be largest; returns whether that could be done.
    fn guided(&mut self, allowed: (bool, bool)) -> bool {
        let guide = self.peaks.guide.as_ref();
        let Some(guide) = guide.filter(|_| self.search.is_guided) else {
            return false;
        };
        let residual = (&self.re[..], &self.im[..]);
        self.candidates.clear();
        let candidates = &mut self.candidates;
        guide.peaks(&self.known, residual, allowed, &mut self.numbers, |point| {
            candidates.push(point);
        })
    }

    /// Compares a point with the best one so far: its J, its index and its sign.
    #[inline]
    fn look(&self, point: usize, may_be: (bool, bool), best: &mut (f32, usize, f64)) {
        let peaks = self.peaks;
        // The order of the sums is that of `highest`.
        let mut correlation = 0.0;
        let mut half_energy = 0.0;
        for k in &self.known {
            let at = k * peaks.points + point;
            let mut term = self.re[*k] * peaks.atoms_re[at];
            if peaks.transform.is_complex() {
                term += self.im[*k] * peaks.atoms_im[at];
            }
            correlation += term;
        }
        if !peaks.transform.is_complex() {
            half_energy = peaks.half_energy[point];
        }
        if may_be.0 && correlation - half_energy > best.0 {
            *best = (correlation - half_energy, point, 1.0);
        }
        if may_be.1 && -correlation - half_energy > best.0 {
            *best = (-correlation - half_energy, point, -1.0);
        }
    }

    /// Takes Newton steps on J from a grid point, within one grid spacing of it.
    #[inline(always)]
    fn polish(&self, start: f64, sign: f64) -> f64 {
        let reach = 1.0 / self.peaks.points as f64;
        let mut u = start;
        for _ in 0..self.newton_steps {
            let (slope, curvature) = self.derivatives(u, sign);
            if curvature >= 0.0 {
                break;
            }
            let next = (u - slope / curvature)
                .clamp(start - reach, start + reach)
                .clamp(0.0, 1.0);
            let moved = (next - u).abs();
            u = next;
            if moved < 1e-9 {
                break;
            }
        }
        u
    }

    /// Returns J'(u) and J''(u).
    #[inline(always)]
    fn derivatives(&self, u: f64, sign: f64) -> (f64, f64) {
        let base = self.peaks.omega(1);
        let is_complex = self.peaks.transform.is_complex();
        let mut atoms = Atoms::of(self.peaks.transform, u);
        let (mut slopes, mut curvatures) = ([0.0; LANES], [0.0; LANES]);
        let of = |numbers: &[f32], at: usize| -> Lanes {
            match numbers[at..].first_chunk::<LANES>() {
                Some(numbers) => numbers.map(f64::from),
                None => from_fn(|lane| numbers.get(at + lane).map_or(0.0, |c| f64::from(*c))),
            }
        };
        // Unknown coefficients add nothing: k = 0 has omega = 0, the DCT knows all others, and those that the DTFT
        // does not know have re = im = 0.
        for at in (0..self.limit()).step_by(LANES) {
            let (sin, cos) = atoms.next();
            let (re, im) = (of(&self.re, at), of(&self.im, at));
            for lane in 0..LANES {
                let (sin, cos, re, im) = (sin[lane], cos[lane], re[lane], im[lane]);
                let omega = base * (at + lane) as f64;
                if is_complex {
                    // Re(c conj(phi)) = re cos - im sin
                    slopes[lane] -= sign * omega * (re * sin + im * cos);
                    curvatures[lane] -= sign * omega * omega * (re * cos - im * sin);
                } else if at + lane < self.limit() {
                    // p c cos - cos^2 / 2
                    slopes[lane] += omega * sin * (cos - sign * re);
                    curvatures[lane] += omega * omega * (cos * cos - sin * sin - sign * re * cos);
                }
            }
        }
        (sum(slopes), sum(curvatures))
    }
}

/// Sines and cosines of k omega u for all k from 0 on, several at a time.
struct Atoms {
    sin: Lanes,
    cos: Lanes,
    /// Of as many k as there are lanes.
    step: (f64, f64),
}

impl Atoms {
    #[inline(always)]
    fn of(transform: Transform, u: f64) -> Self {
        let quarters = omega(transform) / FRAC_PI_2 * u;
        let (sin, cos) = sin_cos(from_fn(|lane| lane as f64 * quarters));
        let (sin_step, cos_step) = sin_cos([LANES as f64 * quarters; LANES]);
        Self {
            sin,
            cos,
            step: (sin_step[0], cos_step[0]),
        }
    }

    #[inline(always)]
    fn next(&mut self) -> (Lanes, Lanes) {
        let (sin, cos) = (self.sin, self.cos);
        let (sin_step, cos_step) = self.step;
        self.sin = from_fn(|lane| sin[lane] * cos_step + cos[lane] * sin_step);
        self.cos = from_fn(|lane| cos[lane] * cos_step - sin[lane] * sin_step);
        (sin, cos)
    }
}

/// Returns the largest of the heights of all numbers.
#[inline(always)]
fn highest_of(numbers: &[f32], height: impl Fn(usize, f32) -> f32) -> f32 {
    // Eight lanes, so that the compiler may use vector registers.
    let mut most = [f32::NEG_INFINITY; 8];
    for (chunk, numbers) in numbers.chunks(8).enumerate() {
        for (lane, number) in numbers.iter().enumerate() {
            most[lane] = larger(most[lane], height(8 * chunk + lane, *number));
        }
    }
    most.into_iter().fold(f32::NEG_INFINITY, larger)
}

/// Returns the larger number: `most`, if the other one is none.
#[inline(always)]
const fn larger(most: f32, other: f32) -> f32 {
    if other > most { other } else { most }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;

    fn coefficients(transform: Transform, grid: u16, events: &[Placed]) -> Vec<(u16, f64, f64)> {
        (0..grid)
            .map(|k| {
                let (mut re, mut im) = (0.0, 0.0);
                for (u, sign) in events {
                    let k = f64::from(k);
                    match transform {
                        Transform::Dct => re += sign * (PI * k * u).cos(),
                        _ => {
                            re += sign * (TAU * k * u).cos();
                            im -= sign * (TAU * k * u).sin();
                        }
                    }
                }
                (k, re, im)
            })
            .collect()
    }

    fn decode(transform: Transform, events: &[Placed]) -> Vec<Placed> {
        let on = events.iter().filter(|event| event.1 > 0.0).count() as u32;
        let off = events.len() as u32 - on;
        let grid = transform.grid_size(16, None).min(16);
        let peaks = Peaks::new(transform, usize::from(grid), 16);
        let coefficients = coefficients(transform, grid, events);
        let mut placed = peaks.pixel(
            &Pixel {
                x: 0,
                y: 0,
                on,
                off,
                coefficients,
                times: vec![],
            },
            &mut Work::default(),
        );
        placed.sort_by(|a, b| a.0.total_cmp(&b.0));
        placed
    }

    /// On a fine grid, a transform leaves out points, and changes nothing else.
    #[test]
    fn the_guide_leaves_out_only_points_that_are_lower() {
        let grid = 1024;
        let guided = Peaks::new(Transform::Dtft, grid, 64);
        assert!(guided.guide.is_some());
        let plain = Peaks {
            guide: None,
            ..Peaks::new(Transform::Dtft, grid, 64)
        };
        let mut random = 1_u64;
        let mut next = || {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (random >> 33) as f64 / f64::from(1_u32 << 31)
        };
        for events in [2, 3, 8, 40] {
            for spread in [1, 15] {
                let true_events: Vec<Placed> = (0..events)
                    .map(|i| (next(), if i % 3 == 0 { -1.0 } else { 1.0 }))
                    .collect();
                let on = true_events.iter().filter(|event| event.1 > 0.0).count() as u32;
                let coefficients = coefficients(Transform::Dtft, 1024, &true_events);
                let kept = coefficients.into_iter().step_by(spread).take(64);
                let pixel = Pixel {
                    x: 0,
                    y: 0,
                    on,
                    off: events - on,
                    coefficients: kept.collect(),
                    times: vec![],
                };
                let [mut work, mut others] = [Work::default(), Work::default()];
                let found = guided.pixel(&pixel, &mut work);
                assert_eq!(found, plain.pixel(&pixel, &mut others));
                let (units, plainly) = (work.take_units(), others.take_units());
                assert!(5 * units < plainly, "{units} {plainly}");
            }
        }
    }

    /// AVX2 only makes the search faster: the events are the same to the bit.
    #[test]
    fn vector_instructions_change_nothing() {
        for transform in [Transform::Dct, Transform::Dtft] {
            let peaks = Peaks::new(transform, 16, 16);
            for count in 2..12_u32 {
                let placed = |i: u32| (f64::from(i * i * 7 % 41) / 41.0, 1.0 - f64::from(i % 3));
                let events: Vec<Placed> = (0..count)
                    .map(placed)
                    .map(|(u, sign)| (u, if sign < 0.0 { -1.0 } else { 1.0 }))
                    .collect();
                let on = events.iter().filter(|event| event.1 > 0.0).count() as u32;
                let pixel = Pixel {
                    x: 0,
                    y: 0,
                    on,
                    off: count - on,
                    coefficients: coefficients(transform, 16, &events),
                    times: vec![],
                };
                let counts = (pixel.on, pixel.off);
                let [mut work, mut other] = [Work::default(), Work::default()];
                let plain = Pursuit::new(&peaks, &pixel).run(counts, ROUNDS, &mut other);
                let pursuit = Pursuit::new(&peaks, &pixel);
                assert_eq!(super::placed(pursuit, &pixel, ROUNDS, &mut work), plain);
                let turns = peaks.turns.as_ref().unwrap();
                let pursuit = || Pursuit::new(&peaks, &pixel);
                let plain = pursuit().run_pairs(counts, turns, &mut other);
                let placed = pairs::placed(pursuit(), counts, turns, &mut work);
                assert_eq!(placed, plain);
                assert_eq!(work.take_units(), other.take_units());
            }
        }
    }

    /// Two events in one place that cancel each other but for a little, and two of one polarity that share a peak.
    #[test]
    fn pairs_find_events_that_have_no_peak_of_their_own() {
        for transform in [Transform::Dct, Transform::Dtft] {
            let peaks = Peaks::new(transform, 16, 16);
            for events in [
                [(0.412, 1.0), (0.434, -1.0)],
                [(0.412, 1.0), (0.44, 1.0)],
                [(0.3, -1.0), (0.33, -1.0)],
            ] {
                let on = events.iter().filter(|event| event.1 > 0.0).count() as u32;
                let pixel = Pixel {
                    x: 0,
                    y: 0,
                    on,
                    off: 2 - on,
                    coefficients: coefficients(transform, 16, &events),
                    times: vec![],
                };
                let mut times = peaks.paired(&pixel, &mut Work::default()).unwrap();
                if on != 1 {
                    times.sort_by(f64::total_cmp);
                }
                for (u, (true_u, _)) in times.iter().zip(events) {
                    assert!(
                        (u - true_u).abs() < 1.5 / 64.0,
                        "{transform:?} {times:?} {events:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn separate_events_come_back_to_a_millionth_of_the_window() {
        for transform in [Transform::Dct, Transform::Dtft] {
            for events in [
                vec![(0.3, 1.0)],
                vec![(0.001, -1.0)],
                vec![(0.2, 1.0), (0.7, -1.0)],
                vec![(0.15, 1.0), (0.45, 1.0), (0.8, -1.0)],
            ] {
                let placed = decode(transform, &events);
                for (found, true_event) in placed.iter().zip(&events) {
                    assert_eq!(found.1, true_event.1);
                    let error = (found.0 - true_event.0).abs();
                    assert!(error < 1e-5, "{transform:?} {events:?} {placed:?}");
                }
            }
        }
    }
}
