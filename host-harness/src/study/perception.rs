//! Measures perception on the decoded events: Tables IV and V, and optical flow.

use std::sync::OnceLock;

use anyhow::Result;
use eecvs_bench::source::{Source, WINDOW_US};
use serde::{Deserialize, Serialize};

use super::method::{Method, Trip};
use super::set::Set;
use crate::downstream::segment::Segmenter;
use crate::downstream::{FlowReference, SegmentationReference};

/// Duration of the slices whose contents depend on decoded times: about a tenth of a window, and not a multiple of
/// any representation's bins, whose counts would be exact.
pub const SLICE_US: u32 = 3277;

/// Results for one method and source; the fields are the columns of `perception.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Perception {
    /// `scenes` or `recordings`.
    pub set: String,
    /// Name of the source in the set.
    pub source: String,
    /// Name of the method, see [`Method::name`].
    pub method: String,
    /// Number of coefficients or channels; 0 if events are sent.
    pub m: u8,
    /// Setting of the method, see [`Method::setting`].
    pub setting: String,
    /// Name of the segmenter.
    pub segmenter: String,
    /// Number of frames of whole windows whose segments can be compared: masks that are all empty, all full or all
    /// the same say nothing.
    pub window_frames: u64,
    /// Mean IoU of foreground against background, over whole windows; `None` if no frame has one.
    pub window_foreground_iou: Option<f64>,
    /// Mean IoU of matched segments, over whole windows; `None` if no frame has one.
    pub window_mean_iou: Option<f64>,
    /// Number of frames of [`SLICE_US`] whose segments can be compared.
    pub slice_frames: u64,
    /// Mean IoU of foreground against background, over slices; `None` if no frame has one.
    pub slice_foreground_iou: Option<f64>,
    /// Mean IoU of matched segments, over slices; `None` if no frame has one.
    pub slice_mean_iou: Option<f64>,
    /// Number of tiles with reliable flow in the original.
    pub flow_tiles: u64,
    /// Number of these without reliable flow in the decoded events.
    pub flow_lost: u64,
    /// Mean end-point difference of the others, in pixels per window; `None` if there are none.
    pub flow_mean_px: Option<f64>,
    /// Median end-point difference of the others, in pixels per window.
    pub flow_median_px: Option<f64>,
}

impl Perception {
    /// Returns the mean IoU of matched segments, over whole windows and over slices.
    #[must_use]
    pub fn mean_iou(&self) -> [Option<f64>; 2] {
        self.compared([self.window_mean_iou, self.slice_mean_iou])
    }

    /// Returns the mean IoU of foreground against background, over whole windows and over slices.
    #[must_use]
    pub fn foreground_iou(&self) -> [Option<f64>; 2] {
        self.compared([self.window_foreground_iou, self.slice_foreground_iou])
    }

    /// Leaves out the 1 that rows of earlier versions have in place of `None`.
    fn compared(&self, [window, slice]: [Option<f64>; 2]) -> [Option<f64>; 2] {
        [
            window.filter(|_| self.window_frames > 0),
            slice.filter(|_| self.slice_frames > 0),
        ]
    }
}

/// Results on the original, shared by all methods.
#[derive(Debug)]
pub struct Reference {
    windows: SegmentationReference,
    slices: SegmentationReference,
    flow: FlowReference,
}

impl Reference {
    fn new(source: &Source, segmenter: &dyn Segmenter) -> Result<Self> {
        Ok(Self {
            windows: SegmentationReference::new(source, WINDOW_US, segmenter)?,
            slices: SegmentationReference::new(source, SLICE_US, segmenter)?,
            flow: FlowReference::new(source),
        })
    }
}

/// Segments frames of original and decoded events, and compares their flow. `reference` caches the results on the
/// original.
///
/// # Errors
/// Fails if the segmenter fails.
pub fn measure(
    set: &Set,
    source: &Source,
    method: Method,
    trip: &Trip,
    segmenter: &dyn Segmenter,
    reference: &OnceLock<Reference>,
) -> Result<Perception> {
    let reference = match reference.get() {
        Some(reference) => reference,
        None => {
            let made = Reference::new(source, segmenter)?;
            reference.get_or_init(|| made)
        }
    };
    let windows = reference.windows.against(&trip.events, segmenter)?;
    let slices = reference.slices.against(&trip.events, segmenter)?;
    let flow = reference.flow.against(&trip.events);
    Ok(Perception {
        set: set.name.to_owned(),
        source: source.name.clone(),
        method: method.name().to_owned(),
        m: method.m(),
        setting: method.setting(),
        segmenter: segmenter.name().to_owned(),
        window_frames: windows.frames as u64,
        window_foreground_iou: windows.foreground_iou,
        window_mean_iou: windows.mean_iou,
        slice_frames: slices.frames as u64,
        slice_foreground_iou: slices.foreground_iou,
        slice_mean_iou: slices.mean_iou,
        flow_tiles: flow.tiles as u64,
        flow_lost: flow.lost as u64,
        flow_mean_px: flow.mean_px,
        flow_median_px: flow.median_px,
    })
}
