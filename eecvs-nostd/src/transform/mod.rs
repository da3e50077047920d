//! The transforms: one file each, and the enum that names them.
//!
//! A further transform is one new file with a type that implements [`Basis`], one entry of
//! [`Transform`], and one oracle in the host's `reference`.

pub mod dct;
pub mod dtft;
pub mod dwt;

use crate::fixed_point::{Coefficient, Phase, Sum};
use crate::quantise::{Level, Quantiser};

pub use dct::Dct;
pub use dtft::Dtft;
pub use dwt::Dwt;

/// Largest M: coefficients kept of a pixel.
pub const M_MAX: usize = 64;
/// Largest K: grid size of any transform.
pub const GRID_MAX: usize = 1024;

/// A transform by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Transform {
    /// Cosine atoms cos(pi k u), low frequencies kept.
    Dct = 0,
    /// Complex exponentials exp(-i 2 pi k u), the largest kept.
    Dtft = 1,
    /// Haar wavelets, the largest kept.
    Dwt = 2,
}

impl Transform {
    /// Every transform, in the order of its code on the link.
    pub const ALL: [Self; 3] = [Self::Dct, Self::Dtft, Self::Dwt];

    /// The transform with this code on the link.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Dct),
            1 => Some(Self::Dtft),
            2 => Some(Self::Dwt),
            _ => None,
        }
    }

    /// Lower-case name, as on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dct => "dct",
            Self::Dtft => "dtft",
            Self::Dwt => "dwt",
        }
    }

    /// K: the grid size for `m` kept coefficients, from `grid` where one is asked for.
    ///
    /// Default K: M for the DCT, 2M for the DTFT, 2M rounded up to a power of two for the DWT,
    /// whose K is always rounded up so.
    #[must_use]
    pub const fn grid_size(self, m: u8, grid: Option<u16>) -> u16 {
        let k = match (grid, self) {
            (Some(k), _) => k,
            (None, Self::Dct) => m as u16,
            (None, Self::Dtft | Self::Dwt) => 2 * m as u16,
        };
        match self {
            Self::Dwt => k.next_power_of_two(),
            Self::Dct | Self::Dtft => k,
        }
    }

    /// Which coefficients are kept.
    #[must_use]
    pub const fn rule(self) -> Rule {
        match self {
            Self::Dct => Dct::RULE,
            Self::Dtft => Dtft::RULE,
            Self::Dwt => Dwt::RULE,
        }
    }

    /// Whether a coefficient is two numbers, re and im.
    #[must_use]
    pub const fn is_complex(self) -> bool {
        matches!(self, Self::Dtft)
    }
}

/// Which r of the K coefficients are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rule {
    /// k = 0..r.
    LowFrequency,
    /// The r largest |c_k|, ties to the lower k.
    Magnitude,
}

/// One event as the transforms see it: p * delta(u - phase).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Impulse {
    /// u = (t - t0) / T.
    pub phase: Phase,
    /// p: +1 or -1.
    pub sign: i32,
}

impl Impulse {
    /// No event: what a buffer of impulses is filled with.
    pub const NONE: Self = Self {
        phase: Phase::ZERO,
        sign: 0,
    };
}

/// What a transform does in each stage.
///
/// `sums` hold K values for a real transform; a complex one has K real parts, then K imaginary.
pub trait Basis {
    /// The transform's name.
    const TRANSFORM: Transform;
    /// Which coefficients are kept.
    const RULE: Rule;

    /// Accumulate: c_k = sum_i p_i phi_k(u_i) (eq. 6) for k in 0..`grid`, over one chunk of at
    /// most [`crate::fixed_point::CHUNK_EVENTS`] impulses. `sums`, 2K or longer, is overwritten.
    fn accumulate(impulses: &[Impulse], grid: usize, sums: &mut [Sum]);

    /// Numbers in `sums` that are coefficients: K, or 2K for a complex transform.
    #[must_use]
    fn values(grid: usize) -> usize {
        if Self::TRANSFORM.is_complex() {
            2 * grid
        } else {
            grid
        }
    }

    /// Prune: a number that orders the coefficients as |c_k| does.
    fn magnitude<C: Coefficient>(sums: &[C], grid: usize, k: usize) -> u64;

    /// Quantise: the level of coefficient k, and whether it saturated.
    fn level<C: Coefficient>(
        sums: &[C],
        grid: usize,
        k: usize,
        quantiser: Quantiser,
    ) -> (Level, bool);
}

/// Impulse sums of `B` neighbouring frequencies at a time: `step` is what k advances the phase by,
/// and the sums stay in registers over all impulses.
#[inline]
fn cosine_sums<const B: usize>(
    impulses: &[Impulse],
    first_k: usize,
    offset: u32,
    step: impl Fn(Phase) -> u32,
) -> [Sum; B] {
    let mut sums = [Sum::ZERO; B];
    for impulse in impulses {
        let step = step(impulse.phase);
        let mut turn = step.wrapping_mul(first_k as u32).wrapping_add(offset);
        for sum in &mut sums {
            let atom = crate::atom::cos(Phase::from_bits(turn)).to_bits() * impulse.sign;
            *sum = Sum::from_bits(sum.to_bits().wrapping_add(atom));
            turn = turn.wrapping_add(step);
        }
    }
    sums
}

/// Fills `sums` with [`cosine_sums`], four at a time.
fn accumulate_cosines(
    impulses: &[Impulse],
    offset: u32,
    step: impl Fn(Phase) -> u32 + Copy,
    sums: &mut [Sum],
) {
    let mut blocks = sums.chunks_exact_mut(4);
    let mut k = 0;
    for block in &mut blocks {
        block.copy_from_slice(&cosine_sums::<4>(impulses, k, offset, step));
        k += 4;
    }
    for sum in blocks.into_remainder() {
        [*sum] = cosine_sums::<1>(impulses, k, offset, step);
        k += 1;
    }
}

/// c_0 of every transform here: the sum of the signs, without rounding.
fn net_sign(impulses: &[Impulse]) -> Sum {
    Sum::from_num(impulses.iter().map(|impulse| impulse.sign).sum::<i32>())
}
