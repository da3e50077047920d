//! Coders of the events themselves: the payload of `hybrid` frames.
//!
//! ```text
//! group -> cells -> fast, dense or tree -> frame
//! window in order of arrival -> quick or keys -> frame
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
pub mod keys;
pub mod quick;
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
pub use tree::Effort;

/// How events are coded into bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Coder {
    /// Adaptive Golomb-like codes, the cheaper to compute: [`fast`].
    #[default]
    Fast,
    /// Events sorted by place and time, and the differences of their keys in prefix codes, for whole windows on a host:
    /// [`keys`]. Fewer bits than [`Self::Fast`] from some dozen events a window on, and in less time from some
    /// thousand on; an image has no memory for it.
    Keys,
    /// Blocks of events in order of arrival, by vectors, the cheapest to compute: [`quick`]. Lossless alone.
    Quick,
    /// A range coder with learned contexts, for fewer bits: [`dense`].
    Dense,
    /// Trees of places and times, the fewest bits, for whole windows of events on a host: [`tree`]. A window that does
    /// not fit its output or memory is coded by [`dense`].
    Tree(Effort),
}

impl Coder {
    /// Returns the name in lower case: `fast`, `keys`, `quick`, `dense`, or `tree-1` to `tree-3` by the effort.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Keys => "keys",
            Self::Quick => "quick",
            Self::Dense => "dense",
            Self::Tree(Effort::One) => "tree-1",
            Self::Tree(Effort::Two) => "tree-2",
            Self::Tree(Effort::Three) => "tree-3",
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
