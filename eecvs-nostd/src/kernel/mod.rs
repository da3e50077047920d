//! Kernels of the accumulate stage: ways to the same coefficients that differ in run time and error.
//!
//! The encoder takes what [`Kernel::in_use`] names, through [`Basis::accumulate`]; the others are
//! here to be measured against it (`eecvs bench`), and a host can encode with them ([`WithKernel`],
//! `eecvs encode --kernel`). A further kernel is one new file with a type that implements
//! [`Accumulate`], and one entry of [`Kernel`].
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
//! The error is |c_k - c_ref| of any coefficient, complex where c_k is, over the number of events in
//! the pixel, for K up to 1,024 and any window; `tests/kernels.rs` enforces it. The two in f32 are
//! behind the feature `float`.

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

/// A kernel by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kernel {
    /// [`Table`]
    Table,
    /// [`Recurrence`]
    Recurrence,
    /// [`Precise`]
    Precise,
    /// `Micromath`, with the feature `float`
    Micromath,
    /// `Libm`, with the feature `float`
    Libm,
    /// [`Haar`]
    Haar,
}

impl Kernel {
    /// Every kernel.
    pub const ALL: [Self; 6] = [
        Self::Table,
        Self::Recurrence,
        Self::Precise,
        Self::Micromath,
        Self::Libm,
        Self::Haar,
    ];

    /// Lower-case name.
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

    /// The kernel behind [`Basis::accumulate`], which the encoder takes: bit by bit the same sums.
    #[must_use]
    pub const fn in_use(transform: Transform) -> Self {
        match transform {
            Transform::Dct | Transform::Dtft => Self::Table,
            Transform::Dwt => Self::Haar,
        }
    }

    /// log2 of the bound on a coefficient's error per event; `None` where there is no error.
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

/// A kernel for the transform `B`.
pub trait Accumulate<B: Basis> {
    /// Its name.
    const KERNEL: Kernel;
    /// A sum of the signed atoms of a chunk.
    type Sum: KernelSum;
    /// Memory that it needs beside the sums.
    type Work: Default;

    /// As [`Basis::accumulate`], whose contract this is: at most a chunk of impulses, 2K or more
    /// `sums`, of which c_0 is left as it was.
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        work: &mut Self::Work,
        sums: &mut [Self::Sum],
    );

    /// As [`Basis::accumulate_list`].
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

/// u / 2, the DCT's step from k to k + 1 as a turn.
#[inline(always)]
fn dct_turn(scale: PhaseScale, impulse: Impulse) -> Phase {
    scale.half(impulse.offset_us)
}

/// -u, the DTFT's: exp(-i x) = cos(-x) + i sin(-x).
#[inline(always)]
fn dtft_turn(scale: PhaseScale, impulse: Impulse) -> Phase {
    let half = scale.half(impulse.offset_us).to_bits();
    Phase::from_bits((half << 1).wrapping_neg())
}

/// The sums of k = 1 to K - 1, zeroed.
#[inline(always)]
fn zeroed<T: Default + Copy>(sums: &mut [T], grid: usize) -> Option<&mut [T]> {
    let sums = sums.get_mut(1..grid)?;
    sums.fill(T::default());
    Some(sums)
}

/// The real and the imaginary sums of k = 1 to K - 1, zeroed.
#[inline(always)]
fn zeroed_pairs<T: Default + Copy>(sums: &mut [T], grid: usize) -> Option<&mut [[T; 2]]> {
    let (pairs, _) = sums.as_chunks_mut::<2>();
    let pairs = pairs.get_mut(1..grid)?;
    pairs.fill([T::default(); 2]);
    Some(pairs)
}

/// The phases of k = 1, 2, ...
#[cfg(feature = "float")]
#[inline(always)]
fn multiples(turn: Phase) -> impl Iterator<Item = Phase> {
    let mut phase = Phase::ZERO;
    core::iter::repeat_with(move || {
        phase = phase.wrapping_add(turn);
        phase
    })
}
