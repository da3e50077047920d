//! Coders of the events themselves: the payload of `hybrid` frames.
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
pub mod tree;
#[cfg(feature = "coefficients")]
pub(crate) mod window_coefficients;
pub(crate) mod window_events;

pub use cells::{Cells, Fidelity};
pub use scan::{Axis, Readout, Scans};
pub use times::Times;

/// How events are coded into bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Coder {
    /// Adaptive Golomb-like codes, the cheaper to compute: [`fast`].
    #[default]
    Fast,
    /// A range coder with learned contexts, the fewest bits: [`dense`].
    Dense,
}

impl Coder {
    /// Returns the name in lower case: `fast` or `dense`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Dense => "dense",
        }
    }
}

/// Settings of mode `hybrid`, which codes the events themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hybrid {
    /// Coder of the events.
    pub coder: Coder,
    /// Fidelity of the decoded times.
    pub fidelity: Fidelity,
}
