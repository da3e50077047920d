//! What perception makes of what came back: Tables IV and V, and optical flow.

use std::sync::OnceLock;

use anyhow::Result;
use eecvs_bench::source::{Source, WINDOW_US};
use serde::{Deserialize, Serialize};

use super::method::{Method, Trip};
use super::set::Set;
use crate::downstream::segment::Segmenter;
use crate::downstream::{FlowReference, SegmentationReference};

/// Length of the frames whose contents depend on decoded times: about a tenth of a window, and no whole
/// number of the bins of any representation, which would come back whole.
pub const SLICE_US: u32 = 3277;

/// A row; the fields are the columns of `perception.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Perception {
    /// `scenes` or `recordings`.
    pub set: String,
    /// Of the set.
    pub source: String,
    /// As [`Method::name`] has it.
    pub method: String,
    /// Coefficients or channels; 0 where events are sent.
    pub m: u8,
    /// As [`Method::setting`] has it.
    pub setting: String,
    /// Name of the segmenter.
    pub segmenter: String,
    /// Frames of whole windows with a segment on either side.
    pub window_frames: u64,
    /// Mean IoU of what is no background, whole windows.
    pub window_foreground_iou: f64,
    /// Mean IoU of matched segments, whole windows.
    pub window_mean_iou: f64,
    /// Frames of [`SLICE_US`] with a segment on either side.
    pub slice_frames: u64,
    /// As of whole windows.
    pub slice_foreground_iou: f64,
    /// As of whole windows.
    pub slice_mean_iou: f64,
    /// Tiles whose flow is told by the original.
    pub flow_tiles: u64,
    /// Those of them whose flow what came back does not tell.
    pub flow_lost: u64,
    /// Mean end-point difference in pixels per window, over the others; `None` where there are none.
    pub flow_mean_px: Option<f64>,
    /// Median end-point difference in pixels per window.
    pub flow_median_px: Option<f64>,
}

/// What is the original's alone, for all methods.
#[derive(Debug)]
pub struct Reference {
    windows: SegmentationReference,
    slices: SegmentationReference,
    flow: FlowReference,
}

impl Reference {
    fn new(source: &Source, segmenter: &mut dyn Segmenter) -> Result<Self> {
        Ok(Self {
            windows: SegmentationReference::new(source, WINDOW_US, segmenter)?,
            slices: SegmentationReference::new(source, SLICE_US, segmenter)?,
            flow: FlowReference::new(source),
        })
    }
}

/// Segments frames of both and follows both through windows; `reference` keeps what is the original's
/// alone.
///
/// # Errors
/// A segmenter that fails.
pub fn measure(
    set: &Set,
    source: &Source,
    method: Method,
    trip: &Trip,
    segmenter: &mut dyn Segmenter,
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
