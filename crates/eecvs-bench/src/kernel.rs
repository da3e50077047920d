//! The core's kernels as contenders of the measurement.

use std::hint::black_box;

use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Sum};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::kernel::{
    Accumulate, Haar, Kernel, Libm, Micromath, Precise, PreciseSum, Recurrence, Table,
};
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft, Dwt, Transform};
use eecvs_oracle::dwt::height;
use num_complex::Complex64;

use super::Contender;
use super::window::{Pixel, Windows};

/// A number type of a kernel's sums.
pub trait Number: Copy {
    /// Returns the exact value.
    fn to_f64(self) -> f64;

    /// Returns the bits of the number; a type of 32 bits fills the lower half, and the upper half is 0.
    fn bits(self) -> u64;
}

impl Number for Sum {
    fn to_f64(self) -> f64 {
        self.to_num()
    }

    fn bits(self) -> u64 {
        u64::from(self.to_bits() as u32)
    }
}

impl Number for PreciseSum {
    fn to_f64(self) -> f64 {
        self.to_num()
    }

    fn bits(self) -> u64 {
        self.to_bits() as u64
    }
}

impl Number for f32 {
    fn to_f64(self) -> f64 {
        self.into()
    }

    fn bits(self) -> u64 {
        u64::from(self.to_bits())
    }
}

/// A kernel with its memory.
struct Core<A: Accumulate<B>, B: Basis> {
    grid: usize,
    work: Box<A::Work>,
    /// Sums of a chunk.
    sums: Vec<A::Sum>,
    /// Sums of a pixel with several chunks.
    totals: Vec<f64>,
}

/// Returns all kernels of a transform, for K = `grid`.
#[must_use]
pub fn kernels(transform: Transform, grid: usize) -> Vec<Box<dyn Contender>> {
    match transform {
        Transform::Dct => vec![
            core::<Table, Dct>(grid),
            core::<Recurrence, Dct>(grid),
            core::<Precise, Dct>(grid),
            core::<Micromath, Dct>(grid),
            core::<Libm, Dct>(grid),
        ],
        Transform::Dtft => vec![
            core::<Table, Dtft>(grid),
            core::<Recurrence, Dtft>(grid),
            core::<Precise, Dtft>(grid),
            core::<Micromath, Dtft>(grid),
            core::<Libm, Dtft>(grid),
        ],
        Transform::Dwt => vec![core::<Haar, Dwt>(grid)],
    }
}

fn core<A, B>(grid: usize) -> Box<dyn Contender>
where
    A: Accumulate<B> + 'static,
    B: Basis + 'static,
    A::Sum: Number,
{
    Box::new(Core::<A, B> {
        grid,
        work: Box::default(),
        sums: vec![A::Sum::default(); 2 * grid],
        totals: vec![0.0; 2 * grid],
    })
}

impl<A: Accumulate<B>, B: Basis> Core<A, B>
where
    A::Sum: Number,
{
    /// Accumulates a chunk into `sums`. Not inlined, so that the code that is timed is the code that is verified.
    #[inline(never)]
    fn chunk(&mut self, impulses: &[Impulse], scale: PhaseScale) {
        let impulses = impulses.iter().copied();
        A::accumulate(impulses, scale, self.grid, &mut self.work, &mut self.sums);
    }

    /// Accumulates a pixel. Returns whether the result is in `totals`, as for a pixel with several chunks, and not
    /// in `sums`.
    fn pixel(&mut self, pixel: Pixel<'_>) -> bool {
        let scale = pixel.window.scale;
        if pixel.impulses.len() <= CHUNK_EVENTS {
            self.chunk(pixel.impulses, scale);
            return false;
        }
        self.totals.fill(0.0);
        for impulses in pixel.impulses.chunks(CHUNK_EVENTS) {
            self.chunk(impulses, scale);
            for (total, sum) in self.totals.iter_mut().zip(&self.sums) {
                *total += sum.to_f64();
            }
        }
        true
    }
}

impl<A: Accumulate<B>, B: Basis> Contender for Core<A, B>
where
    A::Sum: Number,
{
    fn name(&self) -> &'static str {
        A::KERNEL.name()
    }

    fn kernel(&self) -> Option<Kernel> {
        Some(A::KERNEL)
    }

    fn pass(&mut self, windows: &Windows) {
        for pixel in windows.pixels() {
            self.pixel(pixel);
            black_box((&self.sums, &self.totals));
        }
    }

    fn checksum(&mut self, parts: &[Windows]) -> Option<u32> {
        let mut checksum = 0_u32;
        for pixel in parts.iter().flat_map(Windows::pixels) {
            for impulses in pixel.impulses.chunks(CHUNK_EVENTS) {
                self.chunk(impulses, pixel.window.scale);
                let sums = &self.sums[..B::values(self.grid)];
                for sum in sums.chunks(self.grid).flat_map(|part| &part[1..]) {
                    let bits = sum.bits();
                    for word in [bits as u32, (bits >> 32) as u32] {
                        checksum = (checksum.rotate_left(5) ^ word).wrapping_mul(0x9e37_79b1);
                    }
                }
            }
        }
        Some(checksum)
    }

    fn coefficients(&mut self, pixel: Pixel<'_>) -> Option<Vec<Complex64>> {
        let in_totals = self.pixel(pixel);
        let at = |i: usize| {
            if in_totals {
                self.totals[i]
            } else {
                self.sums[i].to_f64()
            }
        };
        let c_0: f64 = pixel.oracles.iter().map(|impulse| impulse.p).sum();
        let rest = (1..self.grid).map(|k| match B::TRANSFORM {
            Transform::Dct => Complex64::from(at(k)),
            Transform::Dtft => Complex64::new(at(2 * k), at(2 * k + 1)),
            Transform::Dwt => Complex64::from(height(k) * at(k)),
        });
        Some(std::iter::once(Complex64::from(c_0)).chain(rest).collect())
    }
}
