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

use eecvs_nostd::Transform;
use nalgebra::Complex;

use super::Pixel;
use super::cost::{PIXEL, Search};
use super::equations::Equations;
use super::guide::Guide;
use super::refine::{Work, least_squares};

/// Points of the search grid for each atom.
const POINTS_PER_ATOM: usize = 4;
/// Largest number of Newton steps to polish a peak.
pub(super) const NEWTON_STEPS: usize = 12;
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
    /// phi_k(point), real and imaginary parts: [point * grid + k].
    atoms_re: Vec<f32>,
    atoms_im: Vec<f32>,
    /// sum_k |phi_k|^2 / 2 at each point, for the DCT.
    half_energy: Vec<f32>,
    /// Which points of a fine grid are looked at, for the DTFT.
    guide: Option<Guide>,
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
        };
        if transform.is_complex() {
            peaks.guide = Guide::new(points, grid);
        }
        for point in 0..points {
            let u = (point as f64 + 0.5) / points as f64;
            let mut energy = 0.0;
            for k in 0..grid {
                let (sin, cos) = (peaks.omega(k) * u).sin_cos();
                peaks.atoms_re.push(cos as f32);
                peaks.atoms_im.push(-sin as f32);
                if k > 0 && k < kept {
                    energy += cos * cos;
                }
            }
            peaks.half_energy.push((energy / 2.0) as f32);
        }
        peaks
    }

    /// Returns (u, p) of a pixel's events, `on` with p = +1 and `off` with p = -1, in no particular order.
    #[must_use]
    pub fn pixel(&self, pixel: &Pixel, work: &mut Work) -> Vec<Placed> {
        work.spend(PIXEL);
        Pursuit::new(self, pixel).run(pixel.on, pixel.off, ROUNDS_EVENTS_MAX, work)
    }

    /// Returns the times u of a pixel's events, those of the ON events first. Unlike [`Self::pixel`] it places
    /// events again whatever their number.
    #[must_use]
    pub fn times(&self, pixel: &Pixel, work: &mut Work) -> Vec<f64> {
        let placed = Pursuit::new(self, pixel).run(pixel.on, pixel.off, usize::MAX, work);
        on_first(&placed)
    }

    /// As [`Self::times`], but after each event all events placed so far move to where together they explain the
    /// coefficients best. Neighbours that share one peak separate at once, and the remaining residual has no side
    /// lobes from them.
    #[must_use]
    pub fn refined(&self, pixel: &Pixel, equations: &Equations, work: &mut Work) -> Vec<f64> {
        let mut partial = equations.clone();
        partial.signs.clear();
        let mut pursuit = Pursuit::new(self, pixel);
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
            least_squares(&partial, &mut times, PARTIAL_ROUNDS, work);
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
    /// Residual coefficients after the events placed so far.
    re: Vec<f32>,
    im: Vec<f32>,
    /// Numbers of the guide.
    numbers: Vec<Complex<f64>>,
    /// Points that the guide found.
    candidates: Vec<usize>,
    /// Sizes from which the work follows.
    search: Search,
}

impl<'d> Pursuit<'d> {
    fn new(peaks: &'d Peaks, pixel: &Pixel) -> Self {
        let mut re = vec![0.0; peaks.grid];
        let mut im = vec![0.0; peaks.grid];
        for (k, of_re, of_im) in &pixel.coefficients {
            (re[usize::from(*k)], im[usize::from(*k)]) = (*of_re as f32, *of_im as f32);
        }
        let known = if peaks.transform == Transform::Dct {
            // The DCT keeps every k < r, so a coefficient that was not sent is known to be 0.
            (1..peaks.kept).collect()
        } else {
            let sent = pixel.coefficients.iter().map(|(k, ..)| usize::from(*k));
            sent.filter(|k| *k > 0).collect()
        };
        (re[0], im[0]) = (0.0, 0.0);
        Self {
            peaks,
            known,
            re,
            im,
            numbers: Vec::new(),
            candidates: Vec::new(),
            search: peaks.search(pixel),
        }
    }

    /// Returns the highest known k plus 1.
    fn limit(&self) -> usize {
        self.known.last().map_or(0, |k| k + 1)
    }

    /// Returns sum_k a_k b_k over the known coefficients; all others of `a` are 0.
    #[inline]
    fn dot_known(&self, a: &[f32], b: &[f32]) -> f32 {
        let limit = self.limit();
        // A few coefficients of a large grid are picked out; otherwise summing all of them in vector registers is
        // faster.
        if limit > 8 * self.known.len() {
            self.known.iter().map(|k| a[*k] * b[*k]).sum()
        } else {
            dot(&a[..limit], &b[..limit])
        }
    }

    fn run(
        mut self,
        mut on: u32,
        mut off: u32,
        rounds_events_max: usize,
        work: &mut Work,
    ) -> Vec<Placed> {
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
        if placed.len() > 1 && placed.len() <= rounds_events_max {
            for _ in 0..ROUNDS {
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
    fn add(&mut self, (u, sign): Placed, factor: f64) {
        let step = self.peaks.omega(1) * u;
        let (sin, cos) = step.sin_cos();
        let (mut atom_re, mut atom_im) = (1.0, 0.0);
        let complex = self.peaks.transform.is_complex();
        let mut known = self.known.iter().peekable();
        for k in 0..self.limit() {
            if known.next_if_eq(&&k).is_some() {
                self.re[k] += (factor * sign * atom_re) as f32;
                if complex {
                    self.im[k] -= (factor * sign * atom_im) as f32;
                }
            }
            (atom_re, atom_im) = (atom_re * cos - atom_im * sin, atom_re * sin + atom_im * cos);
        }
    }

    /// Returns the event that explains the residual best.
    fn best(&mut self, may_be_on: bool, may_be_off: bool, work: &mut Work) -> Placed {
        let mut best = (f32::NEG_INFINITY, 0, 1.0);
        let allowed = (may_be_on, may_be_off);
        if self.guided(allowed) {
            for point in &self.candidates {
                self.look(*point, allowed, &mut best);
            }
            work.spend(self.search.looked_at(self.candidates.len() as u64));
        } else {
            for point in 0..self.peaks.points {
                self.look(point, allowed, &mut best);
            }
            work.spend(self.search.looked_at(self.search.points));
        }
        let (_, point, sign) = best;
        let u = (point as f64 + 0.5) / self.peaks.points as f64;
        (self.polish(u, sign), sign)
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
        let atoms = point * peaks.grid..(point + 1) * peaks.grid;
        let mut correlation: f32 = self.dot_known(&self.re, &peaks.atoms_re[atoms.clone()]);
        let mut half_energy = 0.0;
        if peaks.transform.is_complex() {
            correlation += self.dot_known(&self.im, &peaks.atoms_im[atoms]);
        } else {
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
    fn polish(&self, start: f64, sign: f64) -> f64 {
        let reach = 1.0 / self.peaks.points as f64;
        let mut u = start;
        for _ in 0..NEWTON_STEPS {
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
    fn derivatives(&self, u: f64, sign: f64) -> (f64, f64) {
        let base = self.peaks.omega(1);
        let complex = self.peaks.transform.is_complex();
        let (sin_1, cos_1) = (base * u).sin_cos();
        let (mut cos, mut sin) = (1.0, 0.0);
        let (mut slope, mut curvature) = (0.0, 0.0);
        // Unknown coefficients add nothing: k = 0 has omega = 0, the DCT knows all others, and those that the DTFT
        // does not know have re = im = 0.
        for k in 0..self.limit() {
            let omega = base * k as f64;
            let (re, im) = (f64::from(self.re[k]), f64::from(self.im[k]));
            if complex {
                // Re(c conj(phi)) = re cos - im sin
                slope -= sign * omega * (re * sin + im * cos);
                curvature -= sign * omega * omega * (re * cos - im * sin);
            } else {
                // p c cos - cos^2 / 2
                slope += omega * sin * (cos - sign * re);
                curvature += omega * omega * (cos * cos - sin * sin - sign * re * cos);
            }
            (cos, sin) = (cos * cos_1 - sin * sin_1, sin * cos_1 + cos * sin_1);
        }
        (slope, curvature)
    }
}

#[inline]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    // Eight lanes, so that the compiler may use vector registers.
    let mut lanes = [0.0_f32; 8];
    let (a_blocks, a_rest) = a.as_chunks::<8>();
    let (b_blocks, b_rest) = b.as_chunks::<8>();
    let tail: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    let b_blocks = &b_blocks[..a_blocks.len()];
    for (i, a) in a_blocks.iter().enumerate() {
        let b = &b_blocks[i];
        for (lane, sum) in lanes.iter_mut().enumerate() {
            *sum += a[lane] * b[lane];
        }
    }
    lanes.iter().sum::<f32>() + tail
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
