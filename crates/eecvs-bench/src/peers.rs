//! The peers with which the kernels are compared: the oracle, binning followed by an FFT, and a voxel grid.

use std::f64::consts::PI;
use std::hint::black_box;
use std::sync::Arc;

use eecvs_nostd::Transform;
use eecvs_oracle::transform as oracle;
use num_complex::{Complex32, Complex64};
use rustfft::{Fft, FftPlanner};

use super::window::{Pixel, Windows};
use super::{Contender, oracle_of};

/// The f64 reference itself, which evaluates an atom for every event and coefficient.
struct Oracle {
    transform: oracle::Transform,
    grid: usize,
}

/// Number of time bins of a pixel before the FFT.
pub const BINS: usize = 1024;

/// Moves each event to the middle of its bin, one of [`BINS`], then applies an FFT of f32. The position of an event
/// within its bin is lost.
struct BinningFft {
    transform: Transform,
    fft: Arc<dyn Fft<f32>>,
    bins: Vec<Complex32>,
    scratch: Vec<Complex32>,
    /// exp(-i pi k / BINS), for the DCT with half of the angle, which moves the bins' starts to their middles.
    to_middle: Vec<Complex32>,
    coefficients: Vec<Complex32>,
}

/// A voxel grid with B time bins per pixel and bilinear weights, the input of many networks.
struct Voxel {
    bins: Vec<f32>,
}

/// Returns the peers of a transform, for K = `grid`: the oracle and, except for the DWT, binning with an FFT.
///
/// The FFT gives the coefficients of the events' binned times, in f32. `grid` must not exceed [`BINS`].
#[must_use]
pub fn peers(transform: Transform, grid: usize) -> Vec<Box<dyn Contender>> {
    let oracle = Oracle {
        transform: oracle_of(transform),
        grid,
    };
    if transform == Transform::Dwt {
        return vec![Box::new(oracle)];
    }
    let fft = FftPlanner::new().plan_fft_forward(BINS);
    let turns = if transform == Transform::Dct {
        0.5
    } else {
        1.0
    };
    let to_middle = (0..grid).map(|k| {
        let angle = -turns * PI * k as f64 / BINS as f64;
        Complex32::new(angle.cos() as f32, angle.sin() as f32)
    });
    let binning = BinningFft {
        transform,
        scratch: vec![Complex32::ZERO; fft.get_inplace_scratch_len()],
        fft,
        bins: vec![Complex32::ZERO; BINS],
        to_middle: to_middle.collect(),
        coefficients: vec![Complex32::ZERO; grid],
    };
    vec![Box::new(oracle), Box::new(binning)]
}

/// Returns a voxel grid of `bins` time bins; 0 is taken as 1. It has no coefficients.
#[must_use]
pub fn voxel(bins: usize) -> Box<dyn Contender> {
    Box::new(Voxel {
        bins: vec![0.0; bins.max(1)],
    })
}

impl Contender for Oracle {
    fn name(&self) -> &'static str {
        "oracle-f64"
    }

    fn pass(&mut self, windows: &Windows) {
        for pixel in windows.pixels() {
            black_box(self.coefficients(pixel));
        }
    }

    fn coefficients(&mut self, pixel: Pixel<'_>) -> Option<Vec<Complex64>> {
        let duration_us = pixel.window.duration_us;
        Some(
            self.transform
                .coefficients(pixel.oracles, duration_us, self.grid),
        )
    }
}

impl BinningFft {
    fn pixel(&mut self, pixel: Pixel<'_>) {
        self.bins.fill(Complex32::ZERO);
        for impulse in pixel.impulses {
            // Always present: the offset is below T.
            let bin = pixel
                .window
                .scale
                .bin(impulse.offset_us, BINS.trailing_zeros()) as usize;
            let at = match self.transform {
                // In the order of the even bins, then the odd bins backwards, their FFT turned by `to_middle` is
                // the DCT of all bins.
                Transform::Dct if bin.is_multiple_of(2) => bin / 2,
                Transform::Dct => BINS - 1 - bin / 2,
                Transform::Dtft | Transform::Dwt => bin,
            };
            if let Some(sum) = self.bins.get_mut(at) {
                sum.re += if impulse.is_on { 1.0 } else { -1.0 };
            }
        }
        self.fft
            .process_with_scratch(&mut self.bins, &mut self.scratch);
        let turned = self.bins.iter().zip(&self.to_middle);
        for (coefficient, (bin, to_middle)) in self.coefficients.iter_mut().zip(turned) {
            *coefficient = bin * to_middle;
        }
    }
}

impl Contender for BinningFft {
    fn name(&self) -> &'static str {
        "binning-fft"
    }

    fn pass(&mut self, windows: &Windows) {
        for pixel in windows.pixels() {
            self.pixel(pixel);
            black_box(&self.coefficients);
        }
    }

    fn coefficients(&mut self, pixel: Pixel<'_>) -> Option<Vec<Complex64>> {
        self.pixel(pixel);
        let is_real = self.transform == Transform::Dct;
        let number = |c: &Complex32| {
            let im = if is_real { 0.0 } else { f64::from(c.im) };
            Complex64::new(f64::from(c.re), im)
        };
        Some(self.coefficients.iter().map(number).collect())
    }
}

impl Contender for Voxel {
    fn name(&self) -> &'static str {
        "voxel-bilinear"
    }

    fn pass(&mut self, windows: &Windows) {
        let last = self.bins.len() - 1;
        for window in &windows.windows {
            let scale = last as f32 / window.duration_us as f32;
            for pixel in window.pixels() {
                self.bins.fill(0.0);
                for impulse in pixel.impulses {
                    let at = impulse.offset_us as f32 * scale;
                    let bin = (at as usize).min(last);
                    let sign = if impulse.is_on { 1.0 } else { -1.0 };
                    let above = sign * (at - bin as f32);
                    self.bins[bin] += sign - above;
                    if let Some(next) = self.bins.get_mut(bin + 1) {
                        *next += above;
                    }
                }
                black_box(&self.bins);
            }
        }
    }

    fn coefficients(&mut self, _: Pixel<'_>) -> Option<Vec<Complex64>> {
        None
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Event, Polarity, Sensor};

    use super::*;
    use crate::cut::Cut;

    /// Nothing is lost by binning if every event lies in the middle of its bin.
    #[test]
    fn binning_is_exact_in_the_middle_of_bins() {
        let events: Vec<Event> = [0, 1, 2, 511, 700, 1023]
            .into_iter()
            .map(|bin| Event {
                t_us: 2 * bin + 1,
                x: 3,
                y: 4,
                polarity: Polarity::from_bool(bin % 3 > 0),
            })
            .collect();
        let cut = Cut {
            name: "middles",
            sensor: Sensor {
                width: 8,
                height: 8,
            },
            window_us: 2 * BINS as u32,
            // The window is aligned to its first event, so an event of another pixel comes first, at time 0.
            events: [Event {
                t_us: 0,
                x: 0,
                ..events[0]
            }]
            .into_iter()
            .chain(events)
            .collect(),
        };
        let windows = Windows::new(&cut, usize::MAX).unwrap();
        let pixel = windows.pixels().last().unwrap();
        assert_eq!(pixel.impulses.len(), 6);
        for transform in [Transform::Dct, Transform::Dtft] {
            let [oracle, binning] = &mut peers(transform, 128)[..] else {
                panic!("two peers");
            };
            let expected = oracle.coefficients(pixel).unwrap();
            let found = binning.coefficients(pixel).unwrap();
            for (k, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert!((found - expected).norm() < 1e-4, "{transform:?} {k}");
            }
        }
    }
}
