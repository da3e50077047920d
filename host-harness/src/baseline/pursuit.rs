//! Finds the events of a pixel from its CES coefficients: matching pursuit with atoms of sign +1 and -1.
//!
//! ```text
//! c_k = sum over events of p a_k(u)      a_k(u) = exp(-i 2 pi f_k u)      |a(u)|^2 = M
//! ```
//!
//! Subtracting an event p a(u) from a residual r lowers its energy by 2 p Re<r, a(u)> - M. The pursuit has four
//! steps:
//!
//! 1. Add the event whose time on a grid and sign lower the energy the most; if removing an event of the opposite
//!    sign lowers it nearly as well, remove that event instead.
//! 2. Refine the times of all events together: damped least squares (Levenberg, Marquardt).
//! 3. Repeat until no event lowers the energy.
//! 4. If the residual exceeds what rounding explains, try one more event, then one of each sign, at the best times for
//!    them, and refine all events together. Keep them, and continue from 1, if less than half of the energy is left.
//!
//! If f_0 = 0, c_0 is the signed sum of the pixel's polarities. Then as few events as possible are added or removed
//! at the end, until their signed sum equals c_0. M complex numbers determine at most 2 M times; events that c_0
//! requires beyond that are spread evenly over the window.

use std::f64::consts::TAU;

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::Polarity;

use super::representation::Found;

/// Grid times per coefficient, and the least number of grid times.
const GRID_PER_COEFFICIENT: usize = 16;
const GRID_MIN: usize = 64;
/// An event of the opposite sign is removed instead of adding a new one if its gain is at least this share of the
/// new one's.
const CANCEL: f64 = 0.9;
/// Rounds of refinement after each event, and at the end.
const ROUNDS: usize = 3;
const ROUNDS_LAST: usize = 12;
/// An escape (step 4) must leave less than this share of the energy.
const ESCAPE: f64 = 0.5;
/// The search stops at a residual energy of `NOISE` times that expected from rounding, plus `NATURAL` times that of
/// an event, which covers the f32 rounding of some dozen events.
const NOISE: f64 = 2.0;
const NATURAL: f64 = 1e-10;
/// Refinement ends at steps below this share of a window: 0.003 us.
const STEP_MIN: f64 = 1e-7;
/// Initial and largest damping.
const DAMPING: f64 = 1e-3;
const DAMPING_MAX: f64 = 1e6;

/// Decoder for the events of pixels.
#[derive(Debug, Clone)]
pub struct Pursuit {
    /// 2 pi f_k, in radians per window.
    turns: Vec<f64>,
    has_sum: bool,
    /// Number of grid times.
    grid: usize,
    /// Real and imaginary parts of a_k at the grid times, k by k.
    re: Vec<f32>,
    im: Vec<f32>,
}

/// Reusable memory of [`Pursuit`].
#[derive(Debug, Default)]
pub struct Work {
    /// Coefficients that the events found so far do not explain.
    residual: Vec<[f64; 2]>,
    energy: f64,
    events: Vec<Atom>,
    /// Re<r, a> at the grid times.
    correlation: Vec<f32>,
    trial: Vec<Atom>,
    trial_residual: Vec<[f64; 2]>,
    /// Derivatives of each event's coefficients by its time, event by event.
    slopes: Vec<[f64; 2]>,
    /// Normal equations: matrix, damped matrix (then its factor), right-hand side and solution.
    normal: Vec<f64>,
    factor: Vec<f64>,
    right: Vec<f64>,
    step: Vec<f64>,
}

/// An event found.
#[derive(Debug, Clone, Copy)]
struct Atom {
    /// Time within the window, 0 to 1.
    u: f64,
    sign: f64,
}

/// Change that lowers the energy the most.
#[derive(Debug, Clone, Copy)]
enum Place {
    /// Add this event.
    New(Atom),
    /// Remove the event at this index, which has the opposite sign.
    Cancel(usize),
}

impl Pursuit {
    /// Prepares a decoder for frequencies in turns per window.
    #[must_use]
    pub fn new(frequencies: &[f64]) -> Self {
        let grid = (GRID_PER_COEFFICIENT * frequencies.len()).max(GRID_MIN);
        let turns: Vec<f64> = frequencies.iter().map(|f| TAU * f).collect();
        let atoms = turns
            .iter()
            .flat_map(|turns| (0..grid).map(move |place| atom(*turns, grid_time(place, grid))));
        let (re, im) = atoms.map(|[re, im]| (re as f32, im as f32)).unzip();
        Self {
            has_sum: frequencies.first() == Some(&0.0),
            turns,
            grid,
            re,
            im,
        }
    }

    /// Appends the events of a pixel to `found`. `numbers` holds the real and the imaginary part of each
    /// coefficient, which are multiples of `step`; `step` is 0 for unquantised numbers.
    pub fn find(&self, numbers: &[f64], step: f64, work: &mut Work, found: &mut Vec<Found>) {
        let sum = numbers.first().map_or(0.0, |re| re.round());
        work.residual.clear();
        let coefficients = numbers.chunks_exact(2);
        work.residual.extend(coefficients.map(|c| match c {
            [re, im] => [*re, *im],
            _ => [0.0; 2],
        }));
        work.energy = energy(&work.residual);
        work.events.clear();
        // Without a frequency above 0, the coefficients carry no times.
        if self.turns.iter().any(|turns| *turns != 0.0) {
            self.pursue(step, work);
        }
        if self.has_sum {
            self.balance(sum, work);
        }
        found.extend(work.events.iter().map(|event| {
            let polarity = Polarity::from_bool(event.sign > 0.0);
            Found::at(event.u * f64::from(WINDOW_US), polarity)
        }));
        if self.has_sum {
            let left = sum - signs(&work.events);
            let polarity = Polarity::from_bool(left > 0.0);
            // The cast saturates, at more events than any window holds.
            found.extend(Found::evenly(left.abs() as u64, polarity));
        }
    }

    fn events_max(&self) -> usize {
        2 * self.turns.len()
    }

    /// Runs steps 1 to 4.
    fn pursue(&self, step: f64, work: &mut Work) {
        let power = self.turns.len() as f64;
        // The errors of a coefficient's two numbers are uniform, with variances of step^2 / 12.
        let floor = power * (NATURAL + NOISE * step * step / 6.0);
        let mut is_refined = false;
        // Each step lowers the energy, so this would end by itself; the limit cuts short events that come and go
        // for little gain.
        for _ in 0..2 * self.events_max() {
            if work.energy <= floor {
                break;
            }
            let (place, gain) = self.best(work, None);
            let is_full = work.events.len() >= self.events_max();
            let is_better = 2.0 * gain > power && !(is_full && matches!(place, Place::New(_)));
            if is_better {
                self.take(place, work);
                self.refine(ROUNDS, work);
                is_refined = false;
            } else if is_refined {
                if !self.escape(floor, work) {
                    break;
                }
            } else {
                self.refine(ROUNDS_LAST, work);
                is_refined = true;
            }
        }
        if !is_refined {
            self.refine(ROUNDS_LAST, work);
        }
    }

    /// Tries step 4; returns false, and restores the events, if it does not help.
    fn escape(&self, floor: f64, work: &mut Work) -> bool {
        if work.energy <= floor {
            return false;
        }
        let (events, residual) = (work.events.clone(), work.residual.clone());
        let energy = work.energy;
        for tried in [&[None][..], &[Some(1.0), Some(-1.0)]] {
            for sign in tried {
                let (place, _) = self.best(work, *sign);
                self.take(place, work);
            }
            if work.events.len() <= self.events_max() {
                self.refine(ROUNDS_LAST, work);
                if work.energy < ESCAPE * energy {
                    return true;
                }
            }
            work.events.clone_from(&events);
            work.residual.clone_from(&residual);
            work.energy = energy;
        }
        false
    }

    /// Changes events until their signs sum to `sum`, as far as there is room for events.
    fn balance(&self, sum: f64, work: &mut Work) {
        for _ in 0..2 * self.events_max() {
            let left = sum - signs(&work.events);
            if left == 0.0 || self.turns.len() < 2 {
                return;
            }
            let (place, _) = self.best(work, Some(left.signum()));
            if work.events.len() >= self.events_max() && matches!(place, Place::New(_)) {
                return;
            }
            self.take(place, work);
            self.refine(ROUNDS, work);
        }
    }

    /// Returns the event, of the given sign or of any, that lowers the energy the most, and its p Re<r, a(u)>.
    fn best(&self, work: &mut Work, sign: Option<f64>) -> (Place, f64) {
        let correlation = &mut work.correlation;
        correlation.clear();
        correlation.resize(self.grid, 0.0);
        let atoms = self.re.chunks(self.grid).zip(self.im.chunks(self.grid));
        for ([r_re, r_im], (re, im)) in work.residual.iter().zip(atoms) {
            let (r_re, r_im) = (*r_re as f32, *r_im as f32);
            for (sum, (re, im)) in correlation.iter_mut().zip(re.iter().zip(im)) {
                *sum += r_re * re + r_im * im;
            }
        }
        let gain = |value: f32| sign.map_or(value.abs(), |sign| value * sign as f32);
        let mut best = (0, f32::NEG_INFINITY, 1.0);
        for (place, value) in correlation.iter().enumerate() {
            if gain(*value) > best.1 {
                best = (place, gain(*value), f64::from(*value));
            }
        }
        let new = Atom {
            u: grid_time(best.0, self.grid),
            sign: sign.unwrap_or(best.2.signum()),
        };
        let gain = f64::from(best.1);
        let opposite = work.events.iter().enumerate();
        let opposite = opposite
            .filter(|(_, event)| event.sign == -new.sign)
            .map(|(at, event)| (at, new.sign * self.correlation(&work.residual, event.u)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match opposite {
            Some((at, of_it)) if of_it >= gain - (1.0 - CANCEL) * gain.abs() => {
                (Place::Cancel(at), of_it)
            }
            _ => (Place::New(new), gain),
        }
    }

    /// Returns Re<r, a(u)>.
    fn correlation(&self, residual: &[[f64; 2]], u: f64) -> f64 {
        let terms = residual.iter().zip(&self.turns);
        terms
            .map(|([r_re, r_im], turns)| {
                let [re, im] = atom(*turns, u);
                r_re * re + r_im * im
            })
            .sum()
    }

    fn take(&self, place: Place, work: &mut Work) {
        let (of, sign) = match place {
            Place::New(event) => {
                work.events.push(event);
                (event.u, event.sign)
            }
            Place::Cancel(at) => {
                if at >= work.events.len() {
                    return;
                }
                let event = work.events.swap_remove(at);
                (event.u, -event.sign)
            }
        };
        for (residual, turns) in work.residual.iter_mut().zip(&self.turns) {
            let [re, im] = atom(*turns, of);
            residual[0] -= sign * re;
            residual[1] -= sign * im;
        }
        work.energy = energy(&work.residual);
    }

    /// Refines all times by damped least squares, which never raises the energy.
    fn refine(&self, rounds: usize, work: &mut Work) {
        let count = work.events.len();
        let mut damping = DAMPING;
        let mut is_moved = true;
        for _ in 0..rounds {
            if count == 0 || damping > DAMPING_MAX {
                return;
            }
            if is_moved {
                self.normal_equations(work);
            }
            work.factor.clone_from(&work.normal);
            for diagonal in work.factor.iter_mut().step_by(count + 1) {
                *diagonal += damping * *diagonal + f64::MIN_POSITIVE;
            }
            work.step.clone_from(&work.right);
            is_moved = solve(&mut work.factor, &mut work.step) && self.try_step(work);
            if !is_moved {
                damping *= 10.0;
                continue;
            }
            damping *= 0.1;
            if work.step.iter().all(|step| step.abs() < STEP_MIN) {
                return;
            }
        }
    }

    /// Moves the events by `step` if that lowers the energy; returns whether it did.
    fn try_step(&self, work: &mut Work) -> bool {
        work.trial.clear();
        let moved = work.events.iter().zip(&work.step);
        work.trial.extend(moved.map(|(event, step)| Atom {
            u: (event.u + step).clamp(0.0, 1.0),
            ..*event
        }));
        work.trial_residual.clone_from(&work.residual);
        for (before, after) in work.events.iter().zip(&work.trial) {
            for (residual, turns) in work.trial_residual.iter_mut().zip(&self.turns) {
                let ([old_re, old_im], [re, im]) = (atom(*turns, before.u), atom(*turns, after.u));
                residual[0] += before.sign * (old_re - re);
                residual[1] += before.sign * (old_im - im);
            }
        }
        let energy = energy(&work.trial_residual);
        let is_lower = energy < work.energy;
        if is_lower {
            std::mem::swap(&mut work.events, &mut work.trial);
            std::mem::swap(&mut work.residual, &mut work.trial_residual);
            work.energy = energy;
        }
        is_lower
    }

    /// Builds the normal equations of the residual, linearised in the times.
    fn normal_equations(&self, work: &mut Work) {
        let (count, m) = (work.events.len(), self.turns.len());
        work.slopes.clear();
        for event in &work.events {
            // d/du exp(-i w u) = -i w exp(-i w u).
            work.slopes.extend(self.turns.iter().map(|turns| {
                let [re, im] = atom(*turns, event.u);
                [event.sign * turns * im, -event.sign * turns * re]
            }));
        }
        let dot = |a: &[[f64; 2]], b: &[[f64; 2]]| -> f64 {
            let terms = a.iter().zip(b);
            terms.map(|(a, b)| a[0] * b[0] + a[1] * b[1]).sum()
        };
        work.right.clear();
        work.normal.clear();
        for slope in work.slopes.chunks(m) {
            work.right.push(dot(slope, &work.residual));
            let row = work.slopes.chunks(m).take(count);
            work.normal.extend(row.map(|other| dot(slope, other)));
        }
    }
}

/// Returns exp(-i `turns` u).
fn atom(turns: f64, u: f64) -> [f64; 2] {
    let (sin, cos) = (turns * u).sin_cos();
    [cos, -sin]
}

fn grid_time(place: usize, grid: usize) -> f64 {
    (place as f64 + 0.5) / grid as f64
}

fn energy(residual: &[[f64; 2]]) -> f64 {
    residual.iter().map(|[re, im]| re * re + im * im).sum()
}

fn signs(events: &[Atom]) -> f64 {
    events.iter().map(|event| event.sign).sum()
}

/// Solves n x n symmetric equations in place (Cholesky); returns false if the matrix is not positive definite.
fn solve(matrix: &mut [f64], right: &mut [f64]) -> bool {
    let n = right.len();
    for i in 0..n {
        let (above, rest) = matrix.split_at_mut(i * n);
        let Some(row) = rest.get_mut(..n) else {
            return false;
        };
        for j in 0..=i {
            let (done, left) = row.split_at_mut(j);
            let Some(value) = left.first_mut() else {
                return false;
            };
            if j < i {
                let Some((diagonal, other)) =
                    above.get(j * n..=j * n + j).and_then(<[f64]>::split_last)
                else {
                    return false;
                };
                let dot: f64 = done.iter().zip(other).map(|(a, b)| a * b).sum();
                *value = (*value - dot) / diagonal;
            } else {
                let dot: f64 = done.iter().map(|a| a * a).sum();
                let square = *value - dot;
                if square.is_nan() || square <= 0.0 {
                    return false;
                }
                *value = square.sqrt();
            }
        }
    }
    for i in 0..n {
        let Some((diagonal, row)) = matrix.get(i * n..=i * n + i).and_then(<[f64]>::split_last)
        else {
            return false;
        };
        let (done, left) = right.split_at_mut(i);
        let dot: f64 = row.iter().zip(&*done).map(|(a, b)| a * b).sum();
        if let Some(value) = left.first_mut() {
            *value = (*value - dot) / diagonal;
        }
    }
    for i in (0..n).rev() {
        let column = matrix.iter().skip(i * n + i).step_by(n);
        let (_, left) = right.split_at_mut(i);
        let Some((value, after)) = left.split_first_mut() else {
            return false;
        };
        let mut column = column.copied();
        let diagonal = column.next().unwrap_or(f64::NAN);
        let dot: f64 = column.zip(&*after).map(|(a, b)| a * b).sum();
        *value = (*value - dot) / diagonal;
    }
    right.iter().all(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_are_solved() {
        let matrix = [4.0, 2.0, 1.0, 2.0, 5.0, 3.0, 1.0, 3.0, 6.0];
        let expected = [1.0, -2.0, 3.0];
        let mut right = [3.0, 1.0, 13.0];
        assert!(solve(&mut matrix.clone(), &mut right));
        for (found, expected) in right.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{right:?}");
        }
        assert!(!solve(&mut [1.0, 2.0, 2.0, 1.0], &mut [1.0, 1.0]));
        assert!(!solve(&mut [f64::NAN], &mut [1.0]));
    }

    /// Returns the coefficients of events (u, sign).
    fn coefficients(frequencies: &[f64], events: &[(f64, f64)]) -> Vec<f64> {
        let of = |f: &f64| -> [f64; 2] {
            let terms = events.iter().map(|(u, sign)| (atom(TAU * f, *u), sign));
            terms.fold([0.0; 2], |sum, ([re, im], sign)| {
                [sum[0] + sign * re, sum[1] + sign * im]
            })
        };
        frequencies.iter().flat_map(of).collect()
    }

    fn found(frequencies: &[f64], numbers: &[f64]) -> Vec<(u32, i32)> {
        let (mut work, mut found) = (Work::default(), Vec::new());
        Pursuit::new(frequencies).find(numbers, 0.0, &mut work, &mut found);
        let mut found: Vec<_> = found
            .iter()
            .map(|found| (found.since_us, found.polarity.sign()))
            .collect();
        found.sort_unstable();
        found
    }

    #[test]
    fn a_few_events_are_exact() {
        let frequencies = [0.0, 0.6, 1.3, 2.2, 3.1, 4.5, 5.2, 7.7];
        let events = [(0.11, 1.0), (0.34, -1.0), (0.62, 1.0), (0.97, 1.0)];
        let expected = [(3604, 1), (11_141, -1), (20_316, 1), (31_785, 1)];
        for count in 0..=4 {
            let numbers = coefficients(&frequencies, &events[..count]);
            assert_eq!(found(&frequencies, &numbers), expected[..count]);
        }
    }

    #[test]
    fn the_sum_is_that_of_the_first_coefficient() {
        let frequencies = [0.0, 1.0, 2.5];
        for count in [1, 3, 6, 7, 60] {
            let events: Vec<(f64, f64)> = (0..count)
                .map(|i| (f64::from(i * i % 60) / 60.0, -1.0))
                .collect();
            let found = found(&frequencies, &coefficients(&frequencies, &events));
            let sum: i32 = found.iter().map(|(_, sign)| sign).sum();
            assert_eq!(sum, -count);
        }
        // Coefficients of no event, but with a sum.
        let found = found(&frequencies, &[5.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(found.iter().map(|(_, sign)| sign).sum::<i32>(), 5);
    }

    #[test]
    fn hostile_numbers_end() {
        for number in [f64::NAN, f64::INFINITY, -f64::INFINITY, f64::from(f32::MAX)] {
            let mut numbers = [1.0; 8];
            numbers[5] = number;
            let _ = found(&[0.0, 1.0, 2.0, 3.5], &numbers);
        }
        assert_eq!(found(&[0.0], &[0.0, 0.0]), []);
        assert_eq!(found(&[], &[]), []);
    }
}
