//! Event times without solving: a pixel's events are spread over the window as its lowest coefficients say.
//!
//! The window is divided into cells. With n events, of which c_0 = on - off is the sum of polarities, and V_b their
//! sum in cell b according to the coefficients below k = 8,
//!
//! ```text
//! a_b ~ n / B + (V_b - c_0 / B),   b_b ~ n / B - (V_b - c_0 / B)
//! ```
//!
//! are the densities of ON and OFF events. These are the flattest densities ([`super::crowd`]) to first order, without
//! iterations. The work is linear in the coefficients and the events.

use eecvs_nostd::Header;

use super::Pixel;
use super::crowd::quantiles;
use super::pursuit::Placed;
use super::volume::inverse::Inverse;

/// Number of lowest coefficients used.
const ATOMS: u16 = 8;
/// Number of cells B: two per period of the highest atom used.
const CELLS: usize = 16;
/// Smallest density, as a share of the mean: truncated sums of atoms fall below 0.
const LEAST: f64 = 0.05;

/// Spreads the events of pixels of one transform.
#[derive(Debug)]
pub struct Spread(Inverse);

impl Spread {
    /// Computes the table for windows of the header's transform and grid size K.
    #[must_use]
    pub fn new(header: &Header) -> Self {
        Self(Inverse::new(
            header.transform,
            header.grid.min(ATOMS),
            CELLS,
        ))
    }

    /// Returns times u and polarities of a pixel's events, ON events first.
    #[must_use]
    pub fn pixel(&self, pixel: &Pixel) -> Vec<Placed> {
        let mut sums = Vec::with_capacity(CELLS);
        self.0.values(pixel, &mut sums);
        let events = f64::from(pixel.on) + f64::from(pixel.off);
        let (mean, shared) = (events / CELLS as f64, pixel.net() / CELLS as f64);
        let mut placed = Vec::with_capacity(pixel.on as usize + pixel.off as usize);
        for (count, sign) in [(pixel.on, 1.0), (pixel.off, -1.0)] {
            let of_cell = |sum: &f64| (mean + sign * (sum - shared)).max(LEAST * mean);
            let mut density: Vec<f64> = sums.iter().map(of_cell).collect();
            let whole: f64 = density.iter().sum();
            density.iter_mut().for_each(|part| *part /= whole);
            let times = quantiles(&density, count as usize, 0.5);
            placed.extend(times.into_iter().map(|u| (u, sign)));
        }
        placed
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Transform;

    use super::*;
    use crate::reconstruct::{test_header, test_pixel};

    #[test]
    fn events_are_where_the_lowest_coefficients_say() {
        for transform in [Transform::Dct, Transform::Dtft] {
            let header = test_pixel::header(transform, 16, -6, 32_768);
            // ON events in the first third, OFF events in the last one.
            let events: Vec<(u32, bool)> = (0..20)
                .flat_map(|i| [(500 * i, true), (22_000 + 500 * i, false)])
                .collect();
            let pixel = test_pixel::pixel(&header, &events);
            let placed = Spread::new(&header).pixel(&pixel);
            assert_eq!(placed.len(), 40);
            let (on, off) = placed.split_at(20);
            let in_third = |events: &[Placed], third: f64| {
                let is_in = |(u, _): &&Placed| (u * 3.0).floor() == third;
                events.iter().filter(is_in).count()
            };
            assert!(
                on.iter()
                    .all(|(u, sign)| (0.0..=1.0).contains(u) && *sign > 0.0)
            );
            assert!(in_third(on, 0.0) >= 12, "{transform:?} {on:?}");
            assert!(in_third(off, 2.0) >= 12, "{transform:?} {off:?}");
        }
    }

    #[test]
    fn any_pixel_has_its_counts() {
        for transform in Transform::ALL {
            let header = Header {
                transform,
                ..test_header::header(1000)
            };
            let spread = Spread::new(&header);
            for (on, off) in [(0, 0), (1, 0), (0, 2), (1000, 3)] {
                let pixel = Pixel {
                    x: 0,
                    y: 0,
                    on,
                    off,
                    coefficients: vec![(1, 1e12, -1e12), (15, 3.0, 0.0)],
                    times: vec![],
                };
                let placed = spread.pixel(&pixel);
                let found = placed.iter().filter(|(_, sign)| *sign > 0.0).count() as u32;
                assert_eq!((found, placed.len() as u32), (on, on + off));
                assert!(placed.iter().all(|(u, _)| (0.0..=1.0).contains(u)));
            }
        }
    }
}
