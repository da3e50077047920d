//! Reports which stage the encoder is in, for measurements.

/// A stage of the path from a received word to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Stage {
    /// Decodes words to events and stores events in the window. The encoder itself never enters this stage.
    Ingest = 0,
    /// Walks the closed window: its segments and their pixels.
    Group = 1,
    /// Accumulates a pixel's events into coefficients.
    Accumulate = 2,
    /// Selects the coefficients to keep.
    Prune = 3,
    /// Quantises the kept coefficients to levels.
    Quantise = 4,
    /// Writes a pixel's descriptor, or its events, as bits.
    Pack = 5,
    /// Writes the header and the checksums.
    Frame = 6,
}

impl Stage {
    /// Every stage, in numerical order.
    pub const ALL: [Self; 7] = [
        Self::Ingest,
        Self::Group,
        Self::Accumulate,
        Self::Prune,
        Self::Quantise,
        Self::Pack,
        Self::Frame,
    ];

    /// Returns the stage's lower-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ingest => "ingest",
            Self::Group => "group",
            Self::Accumulate => "accumulate",
            Self::Prune => "prune",
            Self::Quantise => "quantise",
            Self::Pack => "pack",
            Self::Frame => "frame",
        }
    }
}

/// Receives the encoder's changes of stage. The implementation for `()` ignores them and costs nothing.
pub trait Trace {
    /// Whether [`Self::enter`] does anything; if not, the encoder may take paths that mix stages.
    const LISTENS: bool = true;
    /// Whether target-specific code is left out even where it would report every change of stage. Tests use this
    /// to compare it with the portable code.
    #[doc(hidden)]
    const IS_PORTABLE: bool = false;

    /// Announces that the work from here to the next call belongs to `stage`.
    fn enter(&mut self, stage: Stage);
}

impl Trace for () {
    const LISTENS: bool = false;

    #[inline(always)]
    fn enter(&mut self, _: Stage) {}
}
