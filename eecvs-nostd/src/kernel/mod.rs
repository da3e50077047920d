//! Kernels of the accumulate stage: different ways to compute the same coefficients, with different run time and
//! error.
//!
//! The encoder uses the kernel that [`Kernel::in_use`] returns, through [`Basis::accumulate`]. The others exist to
//! be measured against it (`eecvs bench`), and a host can encode with them ([`WithKernel`], `eecvs encode
//! --kernel`). To add a kernel, add a file with a type that implements [`Accumulate`], and a variant of [`Kernel`].
//!
//! | kernel | transforms | arithmetic | error per event at most |
//! |---|---|---|---|
//! | [`Table`] | DCT, DTFT | Q15 tables, lines between their rows | 2^-14 |
//! | [`Recurrence`] | DCT, DTFT | Chebyshev recurrence, 30 fractional bits | 2^-16 |
//! | [`Precise`] | DCT, DTFT | an atom at a time, 30 fractional bits | 2^-26 |
//! | `Micromath` | DCT, DTFT | an atom at a time, f32 | 2^-9 |
//! | `Libm` | DCT, DTFT | Chebyshev recurrence, f32 | 2^-14 |
//! | [`Haar`] | Haar DWT | bytes for K up to 32, else histogram and butterflies, integers | 0 |
//!
//! The error is |c_k - c_ref| of any coefficient, as a complex magnitude for the DTFT, divided by the number of
//! events in the pixel, for K up to 1,024 and any window; `tests/across/kernels.rs` enforces it. The two f32 kernels need
//! the feature `float`.

mod haar;
#[cfg(feature = "float")]
mod libm;
#[cfg(feature = "float")]
mod micromath;
mod oscillator;
mod precise;
mod recurrence;
mod table;
mod with_kernel;

use crate::fixed_point::Phase;
use crate::group::Impulse;
use crate::group::Impulses;
use crate::transform::phase::PhaseScale;
use crate::transform::{Basis, Transform};

#[cfg(feature = "float")]
pub use self::libm::Libm;
#[cfg(feature = "float")]
pub use self::micromath::Micromath;
pub use haar::Haar;
pub use oscillator::Oscillators;
pub use precise::{Precise, PreciseSum};
pub use recurrence::Recurrence;
pub use table::Table;
pub use with_kernel::{KernelSum, WithKernel};

/// The kernels, by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kernel {
    /// [`Table`]: table with linear interpolation, the encoder's kernel for DCT and DTFT.
    Table,
    /// [`Recurrence`]: Chebyshev recurrence in fixed point.
    Recurrence,
    /// [`Precise`]: single atoms with 30 fractional bits.
    Precise,
    /// `Micromath`: single atoms in f32; needs the feature `float`.
    Micromath,
    /// `Libm`: Chebyshev recurrence in f32; needs the feature `float`.
    Libm,
    /// [`Haar`]: exact integers, the encoder's kernel for the Haar DWT.
    Haar,
}

impl Kernel {
    /// Every kernel, in the order of the variants.
    pub const ALL: [Self; 6] = [
        Self::Table,
        Self::Recurrence,
        Self::Precise,
        Self::Micromath,
        Self::Libm,
        Self::Haar,
    ];

    /// Returns the kernel's lower-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Recurrence => "recurrence",
            Self::Precise => "precise",
            Self::Micromath => "micromath",
            Self::Libm => "libm",
            Self::Haar => "haar",
        }
    }

    /// Returns the kernel whose sums [`Basis::accumulate`] computes for the encoder, bit by bit.
    #[must_use]
    pub const fn in_use(transform: Transform) -> Self {
        match transform {
            Transform::Dct | Transform::Dtft => Self::Table,
            Transform::Dwt => Self::Haar,
        }
    }

    /// Returns log2 of the bound on a coefficient's error per event, or `None` if there is no error.
    #[must_use]
    pub const fn error_log2(self) -> Option<i8> {
        match self {
            Self::Table | Self::Libm => Some(-14),
            Self::Recurrence => Some(-16),
            Self::Precise => Some(-26),
            Self::Micromath => Some(-9),
            Self::Haar => None,
        }
    }
}

/// A kernel that computes the coefficients of the transform `B`.
pub trait Accumulate<B: Basis> {
    /// The kernel's name.
    const KERNEL: Kernel;
    /// Type of a sum of the signed atoms of a chunk.
    type Sum: KernelSum;
    /// Memory that the kernel needs in addition to the sums.
    type Work: Default;

    /// Computes the coefficients, by the contract of [`Basis::accumulate`]: over at most a chunk of impulses, into
    /// 2K or more `sums`, leaving c_0 as it is.
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        work: &mut Self::Work,
        sums: &mut [Self::Sum],
    );

    /// Computes the coefficients of a pixel's list, by the contract of [`Basis::accumulate_list`].
    #[inline(always)]
    fn accumulate_list<'s>(
        impulses: &Impulses<'s>,
        scale: PhaseScale,
        grid: usize,
        work: &mut Self::Work,
        sums: &mut [Self::Sum],
    ) -> Option<Impulses<'s>> {
        Self::accumulate(impulses.clone(), scale, grid, work, sums);
        None
    }
}

/// Returns u / 2, the phase step of the DCT from k to k + 1, as a turn.
#[inline(always)]
fn dct_turn(scale: PhaseScale, impulse: Impulse) -> Phase {
    scale.half(impulse.offset_us)
}

/// Returns -u, the phase step of the DTFT: exp(-i x) = cos(-x) + i sin(-x).
#[inline(always)]
fn dtft_turn(scale: PhaseScale, impulse: Impulse) -> Phase {
    let half = scale.half(impulse.offset_us).to_bits();
    Phase::from_bits((half << 1).wrapping_neg())
}

/// Zeroes and returns the sums of k = 1 to K - 1.
#[inline(always)]
fn zeroed<T: Default + Copy>(sums: &mut [T], grid: usize) -> Option<&mut [T]> {
    let sums = sums.get_mut(1..grid)?;
    sums.fill(T::default());
    Some(sums)
}

/// Zeroes and returns the real and imaginary sums of k = 1 to K - 1.
#[inline(always)]
fn zeroed_pairs<T: Default + Copy>(sums: &mut [T], grid: usize) -> Option<&mut [[T; 2]]> {
    let (pairs, _) = sums.as_chunks_mut::<2>();
    let pairs = pairs.get_mut(1..grid)?;
    pairs.fill([T::default(); 2]);
    Some(pairs)
}

/// Returns the phases of k = 1, 2, ...
#[cfg(feature = "float")]
#[inline(always)]
fn multiples(turn: Phase) -> impl Iterator<Item = Phase> {
    let mut phase = Phase::ZERO;
    core::iter::repeat_with(move || {
        phase = phase.wrapping_add(turn);
        phase
    })
}
