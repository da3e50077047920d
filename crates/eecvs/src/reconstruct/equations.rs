//! What a frame says of a pixel's event times: an equation for every number that was sent.
//!
//! ```text
//! | sum_i p_i a_m(u_i) - c_m | <= h,   m = 0..R
//! ```
//!
//! where a_m is the real or the imaginary part of an atom phi_k, c_m the middle of the step that was
//! received, and h half of a step, widened by what the encoder's kernel may be off. The signs p_i
//! are known, since the counts of ON and OFF events are on the link; k = 0 says no more than these.

use eecvs_nostd::{Header, Kernel, Transform};

use super::Pixel;
use super::pursuit::omega;

/// The equations of one pixel.
#[derive(Debug, Clone)]
pub struct Equations {
    /// Transform: of the DCT there is a real part alone.
    pub transform: Transform,
    /// k of the coefficients that were sent, ascending, without 0.
    pub ks: Vec<u16>,
    /// c_m: of each k the real part and, of a complex one, the imaginary part.
    pub middles: Vec<f64>,
    /// ON events.
    pub on: u32,
    /// OFF events.
    pub off: u32,
    /// p_i, of the events whose times are sought: none until they are asked for.
    pub signs: Vec<f64>,
    /// Half of a step.
    pub half_step: f64,
    /// h, half of a step and the kernel's error.
    pub half: f64,
    /// T.
    pub duration_us: u32,
}

impl Equations {
    /// Of a pixel of several events, of which the frame has sent coefficients.
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

    /// The same for all of its events, the ON ones first.
    #[must_use]
    pub fn with_signs(mut self) -> Self {
        self.signs = std::iter::repeat_n(1.0, self.on as usize)
            .chain(std::iter::repeat_n(-1.0, self.off as usize))
            .collect();
        self
    }

    /// n.
    #[must_use]
    pub const fn events(&self) -> usize {
        self.on as usize + self.off as usize
    }

    /// R.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.middles.len()
    }

    /// Whether k = 1 to r - 1 were all sent.
    #[must_use]
    pub fn are_contiguous(&self) -> bool {
        self.ks
            .last()
            .is_some_and(|last| usize::from(*last) == self.ks.len())
    }

    /// Calls `each` with the row and with a_m and da_m/du at `u`.
    #[inline]
    pub fn atoms(&self, u: f64, mut each: impl FnMut(usize, f64, f64)) {
        let base = omega(self.transform);
        let is_complex = self.transform.is_complex();
        // A recurrence where it is shorter than a sine and a cosine of each.
        let is_dense = usize::from(self.ks.last().copied().unwrap_or(0)) <= 8 * self.ks.len();
        let (sin_1, cos_1) = (base * u).sin_cos();
        let (mut cos, mut sin, mut at) = (1.0_f64, 0.0_f64, 0);
        for (index, k) in self.ks.iter().enumerate() {
            let frequency = base * f64::from(*k);
            if is_dense {
                while at < *k {
                    (cos, sin) = (cos * cos_1 - sin * sin_1, sin * cos_1 + cos * sin_1);
                    at += 1;
                }
            } else {
                (sin, cos) = (frequency * u).sin_cos();
            }
            if is_complex {
                each(2 * index, cos, -frequency * sin);
                each(2 * index + 1, -sin, -frequency * cos);
            } else {
                each(index, cos, -frequency * sin);
            }
        }
    }

    /// r_m = c_m - sum_i p_i a_m(u_i).
    pub fn residual(&self, u: &[f64], residual: &mut Vec<f64>) {
        residual.clear();
        residual.extend_from_slice(&self.middles);
        for (u, sign) in u.iter().zip(&self.signs) {
            self.atoms(*u, |row, value, _| residual[row] -= sign * value);
        }
    }

    /// The residual, and its derivatives: p_i da_m/du at [i R + m].
    pub fn linearise(&self, u: &[f64], residual: &mut Vec<f64>, slopes: &mut Vec<f64>) {
        residual.clear();
        residual.extend_from_slice(&self.middles);
        let rows = self.rows();
        slopes.clear();
        slopes.resize(u.len() * rows, 0.0);
        for ((u, sign), slopes) in u
            .iter()
            .zip(&self.signs)
            .zip(slopes.chunks_exact_mut(rows.max(1)))
        {
            self.atoms(*u, |row, value, slope| {
                residual[row] -= sign * value;
                slopes[row] = sign * slope;
            });
        }
    }

    /// The offset in microseconds nearest to u: around the window where atoms go around it.
    #[must_use]
    pub fn offset_us(&self, u: f64) -> u32 {
        let duration = f64::from(self.duration_us);
        let offset = (u * duration).round();
        let offset = if self.transform.is_complex() {
            offset.rem_euclid(duration)
        } else {
            offset
        };
        // A number that is none becomes 0.
        offset.clamp(0.0, duration - 1.0) as u32
    }
}
