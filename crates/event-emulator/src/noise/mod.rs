//! What a pixel's events have besides its light: random numbers of a pixel's own, shot noise, pixels with defects.

pub(crate) mod defects;
mod draws;
mod shot;

pub(crate) use draws::Draws;
pub(crate) use shot::ShotNoise;

/// Why a pixel fired.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Cause {
    /// Its light changed.
    Signal = 0,
    /// Its reference leaked: at least half of the way to the threshold.
    Leak = 1,
    /// Shot noise.
    ShotNoise = 2,
    /// It is a hot pixel.
    Hot = 3,
    /// It is a stuck pixel.
    Stuck = 4,
}

impl Cause {
    /// All causes, by their numbers.
    pub const ALL: [Self; 5] = [
        Self::Signal,
        Self::Leak,
        Self::ShotNoise,
        Self::Hot,
        Self::Stuck,
    ];

    /// Returns the name, for example `shot-noise`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Signal => "signal",
            Self::Leak => "leak",
            Self::ShotNoise => "shot-noise",
            Self::Hot => "hot",
            Self::Stuck => "stuck",
        }
    }
}
