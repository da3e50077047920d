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
#[cfg(feature = "onnx")]
mod onnx;

use std::path::Path;

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

/// A segmenter by the trained model in an ONNX file: docs/segmentation.md tells which ones fit.
///
/// # Errors
/// A file that cannot be read or holds no model that fits; a build without the feature `onnx`.
#[cfg(feature = "onnx")]
pub fn open_model(path: &Path) -> Result<Box<dyn Segmenter>> {
    Ok(Box::new(onnx::OnnxModel::open(path)?))
}

/// A segmenter by the trained model in an ONNX file: not in this build.
///
/// # Errors
/// Always: build with the feature `onnx`.
#[cfg(not(feature = "onnx"))]
pub fn open_model(path: &Path) -> Result<Box<dyn Segmenter>> {
    anyhow::bail!(
        "{}: this build runs no ONNX models; build with `cargo build --release --features onnx`",
        path.display()
    )
}

#[cfg(all(test, not(feature = "onnx")))]
mod tests {
    use super::*;

    #[test]
    fn a_build_without_models_tells_how_to_get_them() {
        let Err(error) = open_model(Path::new("some.onnx")) else {
            panic!("a model was opened");
        };
        let error = error.to_string();
        assert!(
            error.contains("some.onnx") && error.contains("--features onnx"),
            "{error}"
        );
    }
}
