//! Event times of a pixel with nearly as many unknowns as equations: the median of many solutions.
//!
//! From different starting points, least squares ends in different times that explain the coefficients equally
//! well. The coefficients do not say which are right, but the median of each event's times over all possible
//! solutions has the smallest mean error. Events are matched by their order within each polarity.

use super::Pixel;
use super::crowd::Densities;
use super::equations::Equations;
use super::pursuit::Peaks;
use super::refine::{Patience, RMS_SOLVED, Work, least_squares, rms};

/// Values of `place` at which the flattest densities are sampled (see [`Densities::times`]).
pub(super) const PLACES: [f64; 7] = [0.5, 0.3, 0.7, 0.15, 0.85, 0.4, 0.6];

/// Returns the median times u, ON events first; starting points are the flattest densities and, if `peaks` is
/// given, the peaks. Each is refined by at most `rounds` steps of least squares, with more patience for the best one if
/// there is no solution.
#[must_use]
pub fn times(
    equations: &Equations,
    peaks: Option<(&Peaks, &Pixel)>,
    rounds: usize,
    work: &mut Work,
) -> Vec<f64> {
    let densities = Densities::flattest(equations, work);
    let mut starts: Vec<Vec<f64>> = PLACES.map(|place| densities.times(place)).into();
    if let Some((peaks, pixel)) = peaks {
        starts.push(peaks.once(pixel, work));
        starts.push(peaks.refined(pixel, equations, work));
    }
    let mut solutions: Vec<(f64, Vec<f64>)> = starts
        .into_iter()
        .map(|mut times| {
            work.spend(equations.size().ordered());
            least_squares(equations, &mut times, (rounds, Patience::Short), work);
            let rms = rms(equations, &times, work);
            in_order(equations, &mut times);
            (rms, times)
        })
        .collect();
    solutions.sort_by(|a, b| a.0.total_cmp(&b.0));
    let solved = solutions.partition_point(|(rms, _)| *rms < RMS_SOLVED);
    // If there is no solution, keep the one nearest to it, and come as near as possible.
    solutions.truncate(solved.max(1));
    if let (0, Some((_, times))) = (solved, solutions.first_mut()) {
        least_squares(equations, times, (rounds, Patience::Medium), work);
        in_order(equations, times);
    }
    let mut alike = Vec::with_capacity(solutions.len());
    (0..equations.events())
        .map(|event| {
            alike.clear();
            alike.extend(solutions.iter().map(|(_, times)| times[event]));
            alike.sort_by(f64::total_cmp);
            (alike[(alike.len() - 1) / 2] + alike[alike.len() / 2]) / 2.0
        })
        .collect()
}

/// Sorts the times of each polarity, after wrapping them into the window for periodic atoms.
fn in_order(equations: &Equations, times: &mut [f64]) {
    if equations.transform.is_complex() {
        times.iter_mut().for_each(|u| *u = u.rem_euclid(1.0));
    }
    let (on, off) = times.split_at_mut(equations.on as usize);
    on.sort_by(f64::total_cmp);
    off.sort_by(f64::total_cmp);
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Transform;

    use super::*;
    use crate::reconstruct::test_pixel;

    /// The order of events within each polarity is recovered, and the times of the ON events to within 1,000 us.
    #[test]
    fn times_are_in_order_by_polarity() {
        let header = test_pixel::header(Transform::Dtft, 16, -6, 32_768);
        let events: Vec<(u32, bool)> = (0..30)
            .map(|i| (1_000 * i + 37 * (i % 7), i % 3 > 0))
            .collect();
        let pixel = test_pixel::pixel(&header, &events);
        let equations = Equations::new(&header, &pixel).with_signs();
        let peaks = Peaks::new(Transform::Dtft, 16, 16);
        let mut work = Work::default();
        let times = times(&equations, Some((&peaks, &pixel)), 40, &mut work);
        assert_eq!(times.len(), 30);
        let (on, off) = times.split_at(pixel.on as usize);
        assert!(on.is_sorted() && off.is_sorted());
        let mut truth: Vec<_> = events.iter().filter(|event| event.1).collect();
        truth.sort_unstable();
        for (u, (t, _)) in on.iter().zip(truth) {
            assert!((u * 32_768.0 - f64::from(*t)).abs() < 1_000.0, "{u} {t}");
        }
    }
}
