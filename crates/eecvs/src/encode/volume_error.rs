//! The coarsest times of a window whose smoothed volume is off by as little as asked.
//!
//! The volume holds, per pixel, the events as signed impulses that are smoothed in time by a Gaussian of sigma = 4 ms:
//!
//! ```text
//! S(t) = sum_i s_i exp(-(t - t_i)^2 / 2 sigma^2),  s_i = 1 (ON) or -1 (OFF)
//! error = sum over pixels of the integral of (S' - S)^2 / that of S^2,  S' of the decoded times
//! ```
//!
//! S is summed at points half a sigma apart. The spectrum of its square is a Gaussian too, of which that sampling folds
//! back less than 10^-16, so the sums are the integrals; impulses count up to six sigma away. A trial costs
//! as many products as there are such points, for each event and for its decoded twin, however many events a pixel has.

use std::iter::Peekable;

use eecvs_nostd::coder::Cells;
use eecvs_nostd::{Fidelity, Window};
use event_types::stream::{Context, Result};

use crate::storage::NO_MEMORY;

/// Sigma of the Gaussian in microseconds.
pub const SIGMA_US: u32 = 4000;
/// Distance of the points.
const STEP_US: u32 = SIGMA_US / 2;
/// Points on either side of an impulse.
const REACH: usize = 12;
/// Points that an impulse adds to.
const POINTS: usize = 2 * REACH;
/// Tolerances grow by this share of themselves, in eighths of an octave or so.
const GROWTH: u32 = 11;

/// What the sums of a pixel's events are off by at the most, per square of their number: rounding, and impulses that no
/// longer count.
const NOISE: f64 = 1e-12;

/// A pixel's event: its pixel, its time since the window's start, and its sign.
type Impulse = (u32, u32, f64);

/// Chooses the tolerances of windows.
#[derive(Debug)]
pub struct VolumeError {
    most: f64,
    /// Of an impulse 0 to [`STEP_US`] after a point: the Gaussian at the points around it.
    rows: Vec<[f64; POINTS]>,
    impulses: Vec<Impulse>,
    tolerances_us: Vec<u32>,
}

impl VolumeError {
    /// Prepares to keep the error of every window at or below `most`.
    #[must_use]
    pub fn new(most: f64) -> Self {
        let sigma = f64::from(SIGMA_US);
        let row = |after_us: u32| {
            let mut row = [0.0; POINTS];
            for (i, value) in row.iter_mut().enumerate() {
                let point_us = (i as f64 + 1.0 - REACH as f64) * f64::from(STEP_US);
                let apart = (point_us - f64::from(after_us)) / sigma;
                *value = libm::exp(-apart * apart / 2.0);
            }
            row
        };
        Self {
            most,
            rows: (0..STEP_US).map(row).collect(),
            impulses: Vec::new(),
            tolerances_us: Vec::new(),
        }
    }

    /// Returns the largest tolerance found for a closed window with which its error is at most that asked for; 0 if there
    /// is none, or no event.
    ///
    /// # Errors
    /// The system refuses the memory for the window's events.
    pub fn tolerance_us(&mut self, window: &Window<'_>) -> Result<u32> {
        let Some(closed) = window.closed().filter(|_| window.events() > 0) else {
            return Ok(0);
        };
        self.impulses.clear();
        let reserved = self.impulses.try_reserve(window.events() as usize);
        reserved.ok().context(NO_MEMORY)?;
        window.each_event(|event| {
            let pixel = u32::from(event.y) << 16 | u32::from(event.x);
            let sign = f64::from(event.polarity.sign());
            self.impulses.push((pixel, event.t_us as u32, sign));
        });
        self.impulses
            .sort_unstable_by_key(|(pixel, t_us, _)| (*pixel, *t_us));
        let most = self.most * self.power(|_| None) - self.noise();
        // With the last of these all of the window is one cell.
        self.tolerances_us.clear();
        let (mut tolerance_us, largest_us) = (0, closed.duration_us / 2);
        while tolerance_us < largest_us {
            tolerance_us = (tolerance_us + (tolerance_us / GROWTH).max(1)).min(largest_us);
            self.tolerances_us.push(tolerance_us);
        }
        // Errors grow with the tolerance, nearly always: what is found is within the error in any case.
        let (mut found, mut low, mut high) = (0, 0, self.tolerances_us.len());
        while low < high {
            let middle = low.midpoint(high);
            let Some(tolerance_us) = self.tolerances_us.get(middle).copied() else {
                break;
            };
            let cells = Cells::new(Fidelity::ToleranceUs(tolerance_us), closed.duration_us);
            let error = self.power(|t_us| Some(cells.offset_us(cells.of(t_us))));
            if error <= most {
                (found, low) = (tolerance_us, middle + 1);
            } else {
                high = middle;
            }
        }
        Ok(found)
    }

    /// Returns more than the sums are off by. Events of both signs may cancel so far that nothing else is left of them:
    /// their times then stay exact.
    fn noise(&self) -> f64 {
        let pixels = self.impulses.chunk_by(|a, b| a.0 == b.0);
        let squares = pixels.map(|pixel| (pixel.len() as f64).powi(2));
        NOISE * squares.sum::<f64>()
    }

    /// Returns the sum over the pixels of the integral of the squared volume, but for a factor, less that of the events
    /// as `decoded` has them, whose order stays.
    fn power(&self, decoded: impl Fn(u32) -> Option<u32>) -> f64 {
        let mut sum = 0.0;
        for pixel in self.impulses.chunk_by(|a, b| a.0 == b.0) {
            let events = pixel.iter().map(|(_, t_us, sign)| (*t_us, *sign));
            let others = pixel
                .iter()
                .filter_map(|(_, t_us, sign)| decoded(*t_us).map(|t_us| (t_us, -*sign)));
            sum += self.pixel_power(merge(events.peekable(), others.peekable()));
        }
        sum
    }

    /// Returns the integral of the square of one pixel's smoothed impulses, in the order of time, but for a factor.
    fn pixel_power(&self, impulses: impl Iterator<Item = (u32, f64)>) -> f64 {
        let mut sum = 0.0;
        // Values at the points from the first that an impulse still adds to, which stands at `at % POINTS`.
        let mut points = [0.0; POINTS];
        let mut at = 0;
        for (t_us, weight) in impulses {
            let next = (t_us / STEP_US) as usize;
            for passed in at..next.min(at + POINTS) {
                if let Some(point) = points.get_mut(passed % POINTS) {
                    sum += f64::powi(std::mem::take(point), 2);
                }
            }
            at = next;
            let Some(row) = self.rows.get((t_us % STEP_US) as usize) else {
                continue;
            };
            let (before, after) = points.split_at_mut(at % POINTS);
            for (point, value) in after.iter_mut().chain(before).zip(row) {
                *point += weight * value;
            }
        }
        sum + points.iter().map(|point: &f64| point.powi(2)).sum::<f64>()
    }
}

/// Merges two sequences in the order of time.
fn merge(
    mut one: Peekable<impl Iterator<Item = (u32, f64)>>,
    mut other: Peekable<impl Iterator<Item = (u32, f64)>>,
) -> impl Iterator<Item = (u32, f64)> {
    std::iter::from_fn(move || match (one.peek(), other.peek()) {
        (Some((t_us, _)), Some((other_us, _))) if other_us < t_us => other.next(),
        (Some(_), _) => one.next(),
        (None, _) => other.next(),
    })
}
