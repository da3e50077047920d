//! Frames of a video, for what makes events of them.

use super::{Assumption, Result};
use crate::Sensor;

/// How the numbers of a picture follow the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Response {
    /// The curve of sRGB (IEC 61966-2-1), as in most pictures and videos.
    Srgb,
    /// In proportion, as a sensor's own numbers or those of a renderer.
    Linear,
}

impl Response {
    /// All responses.
    pub const ALL: [Self; 2] = [Self::Srgb, Self::Linear];

    /// Returns the name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Srgb => "srgb",
            Self::Linear => "linear",
        }
    }
}

/// A source of the frames of one video, which are read from first to last.
pub trait VideoReader: Send {
    /// Returns the format's name: a short word, such as `y4m`.
    fn format(&self) -> &'static str;

    /// Returns the frames' size.
    fn sensor(&self) -> Sensor;

    /// Returns how the numbers of such a source usually follow the light.
    fn response(&self) -> Response;

    /// Returns what the reader assumed because the source does not state it; meant to be shown to the user.
    fn assumptions(&self) -> &[Assumption] {
        &[]
    }

    /// Replaces `values` by the next frame's, row by row, and returns its time in microseconds; `None` at the end.
    /// Values are finite and not negative: 0 is black, 1 is white. Each frame is later than the one before.
    ///
    /// # Errors
    /// The source is damaged or truncated, or a frame cannot be used: the message names the file, the frame and the
    /// remedy.
    fn read(&mut self, values: &mut Vec<f32>) -> Result<Option<u64>>;
}
