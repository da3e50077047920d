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

/// Finds segments in event frames.
pub trait Segmenter: Send + Sync {
    /// Returns the name of the segmenter, for tables; two that give other segments have other names.
    fn name(&self) -> &str;

    /// Returns the segments of a frame, in its size; equal frames give equal segments.
    ///
    /// # Errors
    /// Fails if the frame cannot be segmented.
    fn segment(&self, frame: &Frame) -> Result<Masks>;

    /// Segments each of `frames`, in order.
    ///
    /// # Errors
    /// Fails as [`Segmenter::segment`] does.
    fn segment_all(&self, frames: &[Frame]) -> Result<Vec<Masks>> {
        frames.iter().map(|frame| self.segment(frame)).collect()
    }
}

/// Loads a segmenter from the trained model in an ONNX file; docs/segmentation.md says which models fit.
///
/// # Errors
/// Fails if the file cannot be read or holds no model that fits; always in a build without the feature `onnx`.
#[cfg(feature = "onnx")]
pub fn open_model(path: &Path) -> Result<Box<dyn Segmenter>> {
    Ok(Box::new(onnx::OnnxModel::open(path)?))
}

/// Loads a segmenter from the trained model in an ONNX file; not supported by this build.
///
/// # Errors
/// Always fails: build with the feature `onnx`.
#[cfg(not(feature = "onnx"))]
pub fn open_model(path: &Path) -> Result<Box<dyn Segmenter>> {
    anyhow::bail!(
        "{}: this build cannot run ONNX models; build with `cargo build --release --features onnx`",
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
