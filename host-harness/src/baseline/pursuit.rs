//! Finds the events of a pixel in its CES coefficients: matching pursuit with atoms of +1 and -1.
//!
//! ```text
//! c_k = sum over events of p a_k(u)      a_k(u) = exp(-i 2 pi f_k u)      |a(u)|^2 = M
//! ```
//!
//! An event is p a(u), so it lowers the energy of a residual r by 2 p Re<r, a(u)> - M. Pursuit:
//!
//! 1. the time of a grid, and the sign, that lower it the most become an event; where an event of the
//!    opposite sign lies there, it goes instead;
//! 2. the times of all events are refined together: damped least squares (Levenberg, Marquardt);
//! 3. again, until no event lowers it;
//! 4. where more is left than rounding explains, one event more, or one of each sign, at the best times
//!    for them stay if all, refined together, leave half of the energy or less; then again from 1.
//!
//! Where f_0 = 0, c_0 is the signed sum of the pixel: last come the events, as few as can be, that make
//! theirs the same. M complex numbers tell of 2 M times at the most: what c_0 has above that lies evenly
//! over the window.

use std::f64::consts::TAU;

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::Polarity;

use super::representation::Found;

/// Times of the grid for each coefficient, and the fewest.
const GRID_PER_COEFFICIENT: usize = 16;
const GRID_MIN: usize = 64;
/// An event goes instead of its opposite beside it where that lowers the energy so nearly as well.
const CANCEL: f64 = 0.9;
/// Rounds of refining after each event, and at the end.
const ROUNDS: usize = 3;
const ROUNDS_LAST: usize = 12;
/// The share of the energy that an escape must leave at the most.
const ESCAPE: f64 = 0.5;
/// Nothing is sought in an energy of this many times what rounding makes of it, or of this share of an
/// event's, which is what f32 makes of some dozen events.
const NOISE: f64 = 2.0;
const NATURAL: f64 = 1e-10;
/// Refining ends at steps below this share of a window: 0.003 us.
const STEP_MIN: f64 = 1e-7;
/// Damping at the start, and most of it.
const DAMPING: f64 = 1e-3;
const DAMPING_MAX: f64 = 1e6;

/// Finds the events of pixels.
#[derive(Debug, Clone)]
pub struct Pursuit {
    /// 2 pi f_k.
    turns: Vec<f64>,
    has_sum: bool,
    /// Times of the grid.
    grid: usize,
    /// a_k over the grid, real parts and imaginary ones, k by k.
    re: Vec<f32>,
    im: Vec<f32>,
}

/// Memory of [`Pursuit`].
#[derive(Debug, Default)]
pub struct Work {
    /// The residual.
    residual: Vec<[f64; 2]>,
    energy: f64,
    events: Vec<Atom>,
    /// Re<r, a> over the grid.
    correlation: Vec<f32>,
    trial: Vec<Atom>,
    trial_residual: Vec<[f64; 2]>,
    /// Derivatives of the events' coefficients, event by event.
    slopes: Vec<[f64; 2]>,
    /// Normal equations: matrix, the same damped and then factored, right side and solution.
    normal: Vec<f64>,
    factor: Vec<f64>,
    right: Vec<f64>,
    step: Vec<f64>,
}

/// An event.
#[derive(Debug, Clone, Copy)]
struct Atom {
    /// Of the window, 0 to 1.
    u: f64,
    sign: f64,
}

/// Where an event lowers the energy the most.
#[derive(Debug, Clone, Copy)]
enum Place {
    /// A new one.
    New(Atom),
    /// That of its opposite, which is this one.
    Cancel(usize),
}

impl Pursuit {
    /// Of frequencies in turns a window.
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

    /// Adds the events of a pixel, from the real and the imaginary part of each coefficient, which are
    /// multiples of `step`; of 0 where they are not.
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
        // Without a frequency above 0 nothing is told of times.
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
            // The cast saturates, of what no window holds.
            found.extend(Found::evenly(left.abs() as u64, polarity));
        }
    }

    fn events_max(&self) -> usize {
        2 * self.turns.len()
    }

    /// Steps 1 to 4.
    fn pursue(&self, step: f64, work: &mut Work) {
        let power = self.turns.len() as f64;
        // Errors of two numbers for each coefficient are uniform, with variances of step^2 / 12.
        let floor = power * (NATURAL + NOISE * step * step / 6.0);
        let mut is_refined = false;
        // Each lowers the energy, so this ends; events that come and go by little are cut short.
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

    /// Step 4; false where it helps not.
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

    /// Makes the sum of the signs `sum`, as far as there is room for events.
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

    /// Where an event, of one sign or of any, lowers the energy the most; and p Re<r, a(u)> there.
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

    /// Re<r, a(u)>.
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

    /// Damped least squares of all times, which never raises the energy.
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

    /// Moves the events by `step` where that lowers the energy.
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

    /// Of the residual's linear part in the times.
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

/// exp(-i `turns` u).
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

/// Solves symmetric equations, n x n, in place (Cholesky); false where they are not positive definite.
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

    /// Coefficients of events (u, sign).
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
        // Of noise alone, with a sum.
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
