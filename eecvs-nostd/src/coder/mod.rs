//! The events themselves in few bits: what `hybrid` frames hold.
//!
//! ```text
//! group -> cells -> fast or dense -> frame
//! ```

pub mod arrival_order;
pub mod bits_msb_first;
pub mod cells;
#[cfg_attr(not(feature = "coefficients"), allow(dead_code))]
pub mod coefficients;
pub mod content;
pub mod dense;
pub mod fast;
pub mod key_frames;
pub mod range;
pub mod scan;
pub mod times;
#[cfg(feature = "coefficients")]
pub(crate) mod window_coefficients;
pub(crate) mod window_events;

pub use cells::{Cells, Fidelity};
pub use scan::{Axis, Readout, Scans};
pub use times::Times;

/// How events become bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Coder {
    /// Golomb-like codes that adapt: [`fast`].
    #[default]
    Fast,
    /// A range coder with learned contexts: [`dense`].
    Dense,
}

impl Coder {
    /// Lower-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Dense => "dense",
        }
    }
}

/// Mode `hybrid`: the events, as exactly as is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hybrid {
    /// How they become bits.
    pub coder: Coder,
    /// How exactly their times are told.
    pub fidelity: Fidelity,
}
