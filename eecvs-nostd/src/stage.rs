//! Where the encoder is: told to a measurement, or to nobody.

/// A stage of the path from a word to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Stage {
    /// Words to events, events into the window. The encoder itself never enters it.
    Ingest = 0,
    /// The closed window, its segments and their pixels.
    Group = 1,
    /// Events of a pixel to coefficients.
    Accumulate = 2,
    /// The choice of the kept coefficients.
    Prune = 3,
    /// Kept coefficients to levels.
    Quantise = 4,
    /// A pixel's descriptor, or its events, to bits.
    Pack = 5,
    /// Header and checksums.
    Frame = 6,
}

impl Stage {
    /// Every stage, in the order of its number.
    pub const ALL: [Self; 7] = [
        Self::Ingest,
        Self::Group,
        Self::Accumulate,
        Self::Prune,
        Self::Quantise,
        Self::Pack,
        Self::Frame,
    ];

    /// Lower-case name.
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

/// Listens to the encoder's changes of stage; `()` does not, and costs nothing.
pub trait Trace {
    /// Whether there is anything to tell it.
    const LISTENS: bool = true;
    /// Whether code for some targets alone is left out even where it would not miss a change of stage: for
    /// tests that compare it with the portable one.
    const IS_PORTABLE: bool = false;

    /// What follows, up to the next call, belongs to `stage`.
    fn enter(&mut self, stage: Stage);
}

impl Trace for () {
    const LISTENS: bool = false;

    #[inline(always)]
    fn enter(&mut self, _: Stage) {}
}
