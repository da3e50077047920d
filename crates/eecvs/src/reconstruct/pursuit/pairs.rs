//! Times of few events, two at a time: the best pair of points of a grid.
//!
//! Two events that cancel each other, or that share a peak, have no peak of their own. Together, two events of
//! polarities p and q explain the residual c best where, with J of [`super`],
//!
//! ```text
//! J(u) + J(v) - p q sum_k Re(phi_k(u) conj(phi_k(v)))
//! ```
//!
//! is largest. The sum depends on u - v alone, and for the DCT on u + v too, so that it is a table, and all pairs of a
//! grid are looked at.

use eecvs_nostd::Transform;

use super::{Placed, Pursuit, omega};
use crate::reconstruct::lanes::wide;
use crate::reconstruct::refine::Work;

/// Largest number of points of a grid all of whose pairs are looked at.
pub const POINTS_MAX: usize = 512;

/// Rounds in which every pair of events is placed again.
pub(in crate::reconstruct) const PAIR_ROUNDS: usize = 2;

/// sum_k cos(omega_k m / P) over known coefficients k > 0, for m from -P to 2 P - 1.
#[derive(Debug, Clone)]
pub struct Overlaps {
    points: usize,
    is_complex: bool,
    /// At index m + P.
    sums: Vec<f32>,
}

/// Two points with their signs.
pub type Pair = [(usize, f32); 2];

/// cos(omega_k m / P) for m from 0 to P, of all k below K.
#[derive(Debug)]
pub struct Turns {
    points: usize,
    is_complex: bool,
    cosines: Vec<f32>,
}

impl Turns {
    /// Computes the table for P = `points` and K = `grid`.
    pub fn new(transform: Transform, points: usize, grid: usize) -> Self {
        let step = omega(transform) / points as f64;
        let row = |k: usize| (0..=points).map(move |m| (step * (k * m) as f64).cos() as f32);
        Self {
            points,
            is_complex: transform.is_complex(),
            cosines: (0..grid).flat_map(row).collect(),
        }
    }

    /// Sums the cosines of these k.
    #[inline(always)]
    pub fn overlaps(&self, known: &[usize]) -> Overlaps {
        let points = self.points;
        let mut sums = vec![0.0; points + 1];
        for k in known {
            let row = &self.cosines[k * (points + 1)..][..=points];
            for (sum, cosine) in sums.iter_mut().zip(row) {
                *sum += cosine;
            }
        }
        // Cosines are the same on both sides of 0 and of P.
        let mut all = Vec::with_capacity(3 * points);
        all.extend(sums[1..].iter().rev());
        all.extend(&sums[..points]);
        all.extend(sums[1..].iter().rev());
        Overlaps {
            points,
            is_complex: self.is_complex,
            sums: all,
        }
    }
}

impl Overlaps {
    /// Returns the best pair of points with these signs and its height, or `None` if no height is a number.
    /// `heights` are p J(u) without the term of the energy, for p = 1, at all points; `energies` is that term, and
    /// `numbers` memory to compare them.
    #[inline(always)]
    pub fn best(
        &self,
        heights: &[f32],
        energies: &[f32],
        [first, second]: [f32; 2],
        numbers: &mut [Vec<f32>; 2],
    ) -> Option<(f32, Pair)> {
        let points = self.points;
        let energy = |at: usize| if self.is_complex { 0.0 } else { energies[at] };
        let [of_second, most] = numbers;
        of_second.clear();
        of_second.extend((0..points).map(|at| second * heights[at] - energy(at)));
        // For the DCT, cos a cos b = (cos (a - b) + cos (a + b)) / 2.
        let factor = if self.is_complex {
            first * second
        } else {
            first * second / 2.0
        };
        let apart = |at: usize| &self.sums[points - at..2 * points - at];
        let summed = |at: usize| &self.sums[points + at + 1..][..points];
        // For every second point the largest height, so that all points are compared at once.
        most.clear();
        most.resize(points, f32::NEG_INFINITY);
        for (at, height) in heights.iter().enumerate() {
            let of_first = first * height - energy(at);
            let seconds = most.iter_mut().zip(&*of_second).zip(apart(at));
            if self.is_complex {
                for ((most, of_second), apart) in seconds {
                    *most = most.max(of_first + (of_second - factor * apart));
                }
            } else {
                for (((most, of_second), apart), summed) in seconds.zip(summed(at)) {
                    let both = of_second - factor * (apart + summed);
                    *most = most.max(of_first + both);
                }
            }
        }
        let height = most.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        if height == f32::NEG_INFINITY {
            return None;
        }
        let value = |at: usize, other: usize| {
            let summed = if self.is_complex {
                0.0
            } else {
                summed(at)[other]
            };
            let both = of_second[other] - factor * (apart(at)[other] + summed);
            (first * heights[at] - energy(at)) + both
        };
        // Of equal heights, the first of the first points and the last of the second ones counts.
        let highest = (0..points).filter(|other| most[*other] == height);
        let pairs = highest.filter_map(|other| {
            let at = (0..points).find(|at| value(*at, other) == height)?;
            Some((at, other))
        });
        let (at, other) = pairs.min_by_key(|(at, other)| (*at, points - other))?;
        Some((height, [(at, first), (other, second)]))
    }
}

impl Pursuit<'_> {
    /// Places events two at a time, and then each pair again, until none moves.
    #[inline(always)]
    pub(super) fn run_pairs(
        mut self,
        (mut on, mut off): (u32, u32),
        turns: &Turns,
        work: &mut Work,
    ) -> Option<Vec<Placed>> {
        let overlaps = turns.overlaps(&self.known);
        let mut placed = Vec::with_capacity((on + off) as usize);
        while on + off > 1 {
            let signs = [
                ([1.0, 1.0], on > 1),
                ([1.0, -1.0], on > 0 && off > 0),
                ([-1.0, -1.0], off > 1),
            ];
            let allowed = signs.into_iter().filter(|(_, is_allowed)| *is_allowed);
            let pair = self.best_pair(&overlaps, allowed.map(|(signs, _)| signs), work)?;
            for event in pair {
                if event.1 > 0.0 {
                    on -= 1;
                } else {
                    off -= 1;
                }
                placed.push(event);
            }
        }
        if on + off > 0 {
            work.spend(self.search.add());
            let event = self.best(on > 0, off > 0, work);
            self.add(event, -1.0);
            placed.push(event);
        }
        if placed.len() == 2 {
            return Some(placed);
        }
        for _ in 0..PAIR_ROUNDS {
            let mut is_moved = false;
            for i in 1..placed.len() {
                for j in 0..i {
                    let before = [placed[i], placed[j]];
                    work.spend(2 * self.search.add());
                    before.iter().for_each(|event| self.add(*event, 1.0));
                    let signs = before.map(|(_, sign)| sign as f32);
                    let pair = self.best_pair(&overlaps, [signs].into_iter(), work)?;
                    is_moved |= pair != before;
                    [placed[i], placed[j]] = pair;
                }
            }
            if !is_moved {
                break;
            }
        }
        Some(placed)
    }

    /// Returns the pair of events with some of these signs that explains the residual best, and takes it from there.
    #[inline(always)]
    fn best_pair(
        &mut self,
        overlaps: &Overlaps,
        signs: impl Iterator<Item = [f32; 2]>,
        work: &mut Work,
    ) -> Option<[Placed; 2]> {
        work.spend(self.search.pair());
        self.correlate();
        let mut best = None;
        for signs in signs {
            let energies = &self.peaks.half_energy;
            let found = overlaps.best(
                &self.correlations,
                energies,
                signs,
                &mut self.numbers_of_pairs,
            );
            if let Some((height, pair)) = found
                && best.is_none_or(|(most, _)| height > most)
            {
                best = Some((height, pair));
            }
        }
        let (_, pair) = best?;
        let of_point = |(point, sign): (usize, f32)| {
            let u = (point as f64 + 0.5) / self.peaks.points as f64;
            (u, f64::from(sign))
        };
        let pair = pair.map(of_point);
        pair.iter().for_each(|event| self.add(*event, -1.0));
        Some(pair)
    }
}

/// Places events two at a time: see [`Pursuit::run_pairs`].
pub(super) fn placed(
    pursuit: Pursuit<'_>,
    counts: (u32, u32),
    turns: &Turns,
    work: &mut Work,
) -> Option<Vec<Placed>> {
    wide!(
        Pursuit::run_pairs,
        pursuit: Pursuit<'_>, counts: (u32, u32), turns: &Turns, work: &mut Work;
        Option<Vec<Placed>>
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The best pair is that of all pairs, each computed from its atoms.
    #[test]
    fn the_best_pair_is_found() {
        let (points, grid) = (64, 16);
        for transform in [Transform::Dct, Transform::Dtft] {
            let known = if transform == Transform::Dct {
                vec![1, 2, 3, 4, 5]
            } else {
                vec![1, 3, 4, 9]
            };
            let overlaps = Turns::new(transform, points, grid).overlaps(&known);
            let heights: Vec<f32> = (0..points)
                .map(|at| (at * at % 23) as f32 / 7.0 - 1.5)
                .collect();
            let energies: Vec<f32> = (0..points).map(|at| (at % 5) as f32 / 9.0).collect();
            let energy = |at: usize| {
                if transform == Transform::Dct {
                    energies[at]
                } else {
                    0.0
                }
            };
            let atoms = |at: usize| {
                let u = (at as f64 + 0.5) / points as f64;
                let known = known.clone();
                known
                    .into_iter()
                    .map(move |k| (omega(transform) * k as f64 * u).sin_cos())
            };
            let overlap = |a: usize, b: usize| -> f64 {
                let products = atoms(a)
                    .zip(atoms(b))
                    .map(|((s, c), (t, d))| match transform {
                        Transform::Dct => c * d,
                        _ => c * d + s * t,
                    });
                products.sum()
            };
            for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]] {
                let [p, q] = signs;
                let value = |a: usize, b: usize| {
                    let alone = p * heights[a] - energy(a) + q * heights[b] - energy(b);
                    alone - p * q * overlap(a, b) as f32
                };
                let all = (0..points).flat_map(|a| (0..points).map(move |b| (a, b)));
                let most = all
                    .map(|(a, b)| value(a, b))
                    .fold(f32::NEG_INFINITY, f32::max);
                let found = overlaps.best(&heights, &energies, signs, &mut Default::default());
                let (height, [(a, of_a), (b, of_b)]) = found.unwrap();
                assert_eq!([of_a, of_b], signs);
                assert!((height - most).abs() < 1e-4, "{height} {most}");
                assert!((value(a, b) - most).abs() < 1e-4);
            }
        }
    }
}
