//! Inverse transform to a volume of B time bins, with the same layout for every transform.
//!
//! `V[b]` is the integral of `s_hat(u)` over `[b/B, (b+1)/B)`, where `s_hat` is the signal that the kept
//! coefficients describe:
//!
//! * DCT: s_hat(u) = c_0 + 2 sum_k c_k cos(pi k u)
//! * DTFT: s_hat(u) = c_0 + 2 Re sum_k c_k exp(i 2 pi k u)
//! * Haar: s_hat(u) = c_0 + sum_(j,m) c_(j,m) 2^(j/2) h(2^j u - m)
//!
//! c_0 is ON minus OFF, which is sent for every pixel whether k = 0 was kept or not, so a pixel's bins sum to it.
//! With all Haar coefficients and B = K, the bins are the exact sums of polarities. Those of a pixel whose few events
//! are sent as times are the sums of these.

use std::f64::consts::{PI, TAU};

use eecvs_nostd::Transform;

use super::super::{DecodedWindow, Pixel, haar_support};

/// By how much a time before a bin's edge, in bins, counts as on it: more than u and its product may be rounded by, and
/// less than a microsecond of the longest window.
const EDGE: f64 = 1.0 / (1_u64 << 33) as f64;

/// Integrals of every atom's synthesis function over every bin.
#[derive(Debug, Clone)]
pub struct Inverse {
    transform: Transform,
    grid: u16,
    bins: usize,
    /// Weights of re and im, at `[k * bins + b]`.
    weights: Vec<(f64, f64)>,
}

impl Inverse {
    /// Computes the weights of K = `grid` atoms on `bins` bins.
    #[must_use]
    pub fn new(transform: Transform, grid: u16, bins: usize) -> Self {
        let weights = (0..grid)
            .flat_map(|k| {
                (0..bins).map(move |bin| {
                    let from = bin as f64 / bins as f64;
                    let to = (bin + 1) as f64 / bins as f64;
                    weight(transform, k, from, to)
                })
            })
            .collect();
        Self {
            transform,
            grid,
            bins,
            weights,
        }
    }

    /// Returns whether the table has this transform, grid size and number of bins.
    #[must_use]
    pub fn fits(&self, transform: Transform, grid: u16, bins: usize) -> bool {
        (self.transform, self.grid, self.bins) == (transform, grid, bins)
    }

    /// Returns `V[b]` of one pixel for b = `bin`, in events.
    #[must_use]
    pub fn value(&self, pixel: &Pixel, bin: usize) -> f64 {
        if pixel.times.len() > 1 {
            let within = |u: f64| (u * self.bins as f64 + EDGE) as usize == bin;
            let here = pixel.times.iter().filter(|(u, _)| within(*u));
            let signs = here.map(|(_, polarity)| polarity.sign());
            return f64::from(signs.sum::<i32>());
        }
        let weights = |k: u16| self.weights[usize::from(k) * self.bins + bin];
        let others = pixel.coefficients.iter().filter(|(k, ..)| *k > 0);
        let others = others.map(|(k, re, im)| {
            let (of_re, of_im) = weights(*k);
            re * of_re + im * of_im
        });
        pixel.net() * weights(0).0 + others.sum::<f64>()
    }

    /// Writes `V[b]` of one pixel for all bins to `values`. Coefficients that the table does not have count as 0. For
    /// the Haar transform, each coefficient costs as many steps as bins that it changes.
    pub fn values(&self, pixel: &Pixel, values: &mut Vec<f64>) {
        values.clear();
        values.resize(self.bins, 0.0);
        let known = pixel.coefficients.iter();
        for (k, re, im) in known.filter(|(k, ..)| (1..self.grid).contains(k)) {
            let (from, to) = if self.transform == Transform::Dwt {
                let (_, start, end) = haar_support(*k);
                let bins = self.bins as f64;
                ((start * bins) as usize, (end * bins).ceil() as usize)
            } else {
                (0, self.bins)
            };
            let weights = &self.weights[usize::from(*k) * self.bins..];
            let changed = values[from..to].iter_mut().zip(&weights[from..to]);
            changed.for_each(|(value, (of_re, of_im))| *value += re * of_re + im * of_im);
        }
        for (value, (weight, _)) in values.iter_mut().zip(&self.weights) {
            *value += pixel.net() * weight;
        }
    }

    /// Writes bin `bin` of a window into `plane`, an H x W plane of zeros in raster order.
    pub fn plane(&self, window: &DecodedWindow, bin: usize, plane: &mut [f32]) {
        let width = usize::from(window.header.sensor.width);
        for pixel in &window.pixels {
            plane[usize::from(pixel.y) * width + usize::from(pixel.x)] =
                self.value(pixel, bin) as f32;
        }
    }
}

/// Integrals over [from, to) of the factors of re and im of coefficient k.
fn weight(transform: Transform, k: u16, from: f64, to: f64) -> (f64, f64) {
    if k == 0 {
        return (to - from, 0.0);
    }
    match transform {
        Transform::Dct => {
            let omega = PI * f64::from(k);
            (
                2.0 * ((omega * to).sin() - (omega * from).sin()) / omega,
                0.0,
            )
        }
        Transform::Dtft => {
            // Re((re + i im) exp(i w u)) = re cos(w u) - im sin(w u)
            let omega = TAU * f64::from(k);
            (
                2.0 * ((omega * to).sin() - (omega * from).sin()) / omega,
                2.0 * ((omega * to).cos() - (omega * from).cos()) / omega,
            )
        }
        Transform::Dwt => {
            let (height, start, end) = haar_support(k);
            let middle = f64::midpoint(start, end);
            let overlap = |a: f64, b: f64| (to.min(b) - from.max(a)).max(0.0);
            (
                height * (overlap(start, middle) - overlap(middle, end)),
                0.0,
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(coefficients: Vec<(u16, f64, f64)>) -> Pixel {
        Pixel {
            x: 0,
            y: 0,
            on: 3,
            off: 0,
            coefficients,
            times: vec![],
        }
    }

    #[test]
    fn bins_sum_to_the_net_count_for_any_number_of_bins() {
        for transform in Transform::ALL {
            for bins in [1, 3, 5, 8, 100] {
                let table = Inverse::new(transform, 16, bins);
                let pixel = pixel((0..16).map(|k| (k, 3.0 - f64::from(k), 0.5)).collect());
                let sum: f64 = (0..bins).map(|bin| table.value(&pixel, bin)).sum();
                assert!((sum - 3.0).abs() < 1e-9, "{transform:?} {bins}: {sum}");
            }
        }
    }

    /// Compares with the module's formulas, integrated numerically.
    #[test]
    fn bins_are_integrals_of_the_synthesis() {
        let coefficients = vec![(0, 3.0, 0.0), (1, 0.7, -0.4), (3, -1.2, 0.9)];
        for transform in [Transform::Dct, Transform::Dtft] {
            let synthesis = |u: f64| {
                let terms = coefficients.iter().map(|(k, re, im)| {
                    let (turns, factor) = (f64::from(*k) * u, if *k == 0 { 1.0 } else { 2.0 });
                    match transform {
                        Transform::Dct => factor * re * (PI * turns).cos(),
                        _ => factor * (re * (TAU * turns).cos() - im * (TAU * turns).sin()),
                    }
                });
                terms.sum::<f64>()
            };
            let table = Inverse::new(transform, 4, 5);
            let pixel = pixel(coefficients.clone());
            for bin in 0..5 {
                let middles =
                    (0..1000).map(|i| (f64::from(bin) + (f64::from(i) + 0.5) / 1e3) / 5.0);
                let integral = middles.map(synthesis).sum::<f64>() / 5e3;
                let value = table.value(&pixel, bin as usize);
                assert!(
                    (value - integral).abs() < 1e-5,
                    "{transform:?} {bin}: {value}"
                );
            }
        }
    }

    #[test]
    fn all_haar_coefficients_give_the_counts() {
        // One event in bin 2 of 4: c_0 = 1, c_1 = -1, c_3 = sqrt 2.
        let table = Inverse::new(Transform::Dwt, 4, 4);
        let coefficients = vec![(0, 1.0, 0.0), (1, -1.0, 0.0), (3, 2.0_f64.sqrt(), 0.0)];
        let pixel = Pixel {
            on: 1,
            ..pixel(coefficients)
        };
        for (bin, count) in [0.0, 0.0, 1.0, 0.0].into_iter().enumerate() {
            assert!((table.value(&pixel, bin) - count).abs() < 1e-12, "{bin}");
        }
    }
}
