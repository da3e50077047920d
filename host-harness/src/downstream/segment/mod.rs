//! Segmentation of event frames, and how well two segmentations agree.
//!
//! ```text
//! events of a slice -> Frame -> Segmenter (classical, ONNX) -> Masks -\
//! decoded events    -> Frame -> the same                    -> Masks --> IoU
//! ```

pub mod classical;
mod frame;
pub mod iou;
mod masks;

use anyhow::Result;

pub use frame::Frame;
pub use masks::Masks;

/// What finds segments in event frames.
pub trait Segmenter {
    /// Its name, for tables.
    fn name(&self) -> &str;

    /// The segments of a frame; they have its size. The same frame gives the same segments.
    ///
    /// # Errors
    /// What keeps it from segmenting the frame.
    fn segment(&mut self, frame: &Frame) -> Result<Masks>;

    /// The segments of each frame in turn.
    ///
    /// # Errors
    /// As [`Segmenter::segment`].
    fn segment_all(&mut self, frames: &[Frame]) -> Result<Vec<Masks>> {
        frames.iter().map(|frame| self.segment(frame)).collect()
    }
}
