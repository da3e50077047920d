//! Equations for a pixel's event times: one for every number sent in the frame.
//!
//! ```text
//! | sum_i p_i a_m(u_i) - c_m | <= h,   m = 0..R
//! ```
//!
//! Here a_m is the real or the imaginary part of an atom phi_k, c_m is the middle of the received quantiser step,
//! and h is half a step plus the error bound of the encoder's kernel. The signs p_i are known, because the frames
//! carry the counts of ON and OFF events; k = 0 adds nothing to these.

use std::array::from_fn;
use std::f64::consts::FRAC_PI_2;

use eecvs_nostd::{Header, Kernel, Transform};

use super::Pixel;
use super::cost::Size;
use super::lanes::{LANES, Lanes, blocks, filled, sin_cos, sum};
use super::pursuit::omega;

/// The equations of one pixel.
#[derive(Debug, Clone)]
pub struct Equations {
    /// Transform of the window; the DCT has only real parts.
    pub transform: Transform,
    /// k of the coefficients sent, ascending, without 0.
    pub ks: Vec<u16>,
    /// c_m: for each k the real part, followed by the imaginary part for a complex transform.
    pub middles: Vec<f64>,
    /// Number of ON events.
    pub on: u32,
    /// Number of OFF events.
    pub off: u32,
    /// p_i of the events whose times are sought; empty until [`Self::with_signs`].
    pub signs: Vec<f64>,
    /// Half a quantiser step, in units of a coefficient.
    pub half_step: f64,
    /// h: half a step plus the kernel's error bound, in units of a coefficient.
    pub half: f64,
    /// Duration T of the window in microseconds.
    pub duration_us: u32,
}

impl Equations {
    /// Creates the equations of a pixel with several events, whose coefficients were sent; signs are empty.
    #[must_use]
    pub fn new(header: &Header, pixel: &Pixel) -> Self {
        let transform = header.transform;
        let sent = || pixel.coefficients.iter().filter(|(k, ..)| *k > 0);
        let is_complex = transform.is_complex();
        let middles = sent()
            .flat_map(|(_, re, im)| [*re, *im].into_iter().take(1 + usize::from(is_complex)))
            .collect();
        let half_step = f64::from(header.quantiser.step_log2()).exp2() / 2.0;
        let kernel = Kernel::in_use(transform).error_log2();
        let kernel = kernel.map_or(0.0, |log2| f64::from(log2).exp2());
        Self {
            transform,
            ks: sent().map(|(k, ..)| *k).collect(),
            middles,
            half: half_step + kernel * (f64::from(pixel.on) + f64::from(pixel.off)),
            on: pixel.on,
            off: pixel.off,
            signs: Vec::new(),
            half_step,
            duration_us: header.duration_us,
        }
    }

    /// Sets the signs of all events, ON events first.
    #[must_use]
    pub fn with_signs(mut self) -> Self {
        self.signs = std::iter::repeat_n(1.0, self.on as usize)
            .chain(std::iter::repeat_n(-1.0, self.off as usize))
            .collect();
        self
    }

    /// Returns the number of events, n.
    #[must_use]
    pub const fn events(&self) -> usize {
        self.on as usize + self.off as usize
    }

    /// Returns the size of the pixel's problem.
    #[must_use]
    pub fn size(&self) -> Size {
        Size {
            on: self.on.into(),
            off: self.off.into(),
            terms: self.ks.len() as u64,
            highest: self.ks.last().copied().unwrap_or(0).into(),
            rows: self.rows() as u64,
        }
    }

    /// Returns the number of equations, R.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.middles.len()
    }

    /// Returns whether all k from 1 to the highest one were sent.
    #[must_use]
    pub fn are_contiguous(&self) -> bool {
        self.ks
            .last()
            .is_some_and(|last| usize::from(*last) == self.ks.len())
    }

    /// Calls `each` with the row m, and a_m(u) and da_m/du of several events, for every row.
    #[inline(always)]
    pub fn atoms(&self, u: Lanes, mut each: impl FnMut(usize, Lanes, Lanes)) {
        let base = omega(self.transform);
        let is_complex = self.transform.is_complex();
        let quarters = base / FRAC_PI_2;
        // Use a recurrence where that is cheaper than a sine and a cosine for each k.
        let is_dense = self.size().is_dense();
        let (sin_1, cos_1) = sin_cos(u.map(|u| quarters * u));
        let (mut sin, mut cos, mut at) = ([0.0; LANES], [1.0; LANES], 0);
        for (index, k) in self.ks.iter().enumerate() {
            let k_quarters = quarters * f64::from(*k);
            if is_dense {
                while at < *k {
                    (sin, cos) = (
                        from_fn(|lane| sin[lane] * cos_1[lane] + cos[lane] * sin_1[lane]),
                        from_fn(|lane| cos[lane] * cos_1[lane] - sin[lane] * sin_1[lane]),
                    );
                    at += 1;
                }
            } else {
                (sin, cos) = sin_cos(u.map(|u| k_quarters * u));
            }
            let frequency = base * f64::from(*k);
            let slope = sin.map(|sin| -frequency * sin);
            if is_complex {
                each(2 * index, cos, slope);
                let sine = sin.map(|sin| -sin);
                each(2 * index + 1, sine, cos.map(|cos| -frequency * cos));
            } else {
                each(index, cos, slope);
            }
        }
    }

    /// Computes the residual r_m = c_m - sum_i p_i a_m(u_i); `sums` is memory to do so.
    #[inline(always)]
    pub fn residual(&self, u: &[f64], sums: &mut Vec<Lanes>, residual: &mut Vec<f64>) {
        sums.clear();
        sums.resize(self.rows(), [0.0; LANES]);
        for (u, signs) in u.chunks(LANES).zip(self.signs.chunks(LANES)) {
            let signs = filled(signs);
            self.atoms(filled(u), |row, values, _| {
                let before = sums[row];
                sums[row] = from_fn(|lane| before[lane] + signs[lane] * values[lane]);
            });
        }
        self.subtract(sums, residual);
    }

    /// Computes the residual, and the slopes p_i da_m/du: rows m of the blocks of lanes of all
    /// events.
    #[inline(always)]
    pub fn linearise(
        &self,
        u: &[f64],
        sums: &mut Vec<Lanes>,
        residual: &mut Vec<f64>,
        slopes: &mut Vec<Lanes>,
    ) {
        let (rows, blocks) = (self.rows(), blocks(u.len()));
        sums.clear();
        sums.resize(rows, [0.0; LANES]);
        slopes.resize(rows * blocks, [0.0; LANES]);
        let chunks = u.chunks(LANES).zip(self.signs.chunks(LANES));
        for (block, (u, signs)) in chunks.enumerate() {
            let signs = filled(signs);
            self.atoms(filled(u), |row, values, of| {
                let before = sums[row];
                sums[row] = from_fn(|lane| before[lane] + signs[lane] * values[lane]);
                slopes[row * blocks + block] = from_fn(|lane| signs[lane] * of[lane]);
            });
        }
        self.subtract(sums, residual);
    }

    /// Subtracts the sums of lanes from the coefficients.
    #[inline(always)]
    fn subtract(&self, sums: &[Lanes], residual: &mut Vec<f64>) {
        residual.clear();
        let rest = self.middles.iter().zip(sums);
        residual.extend(rest.map(|(middle, lanes)| middle - sum(*lanes)));
    }

    /// Returns the offset in microseconds nearest to u, 0 to T - 1; wraps around the window for periodic atoms.
    #[must_use]
    pub fn offset_us(&self, u: f64) -> u32 {
        let duration = f64::from(self.duration_us);
        let offset = (u * duration).round();
        let offset = if self.transform.is_complex() {
            offset.rem_euclid(duration)
        } else {
            offset
        };
        // NaN becomes 0.
        offset.clamp(0.0, duration - 1.0) as u32
    }
}
