//! Figures of the paper (arXiv 2603.14738) to compare with.
//!
//! Only figures from the paper's text are here. Its Tables I, II, IV and V were measured on EHPT-XC and MVSEC,
//! which are not shipped with this project; their single cells are in the paper.

use eecvs_nostd::Transform;

/// Returns the throughput in Table III: thousand events per second at M = 8, for windows of about 3,200 events, on
/// a desktop computer.
#[must_use]
pub const fn kev_per_s(transform: Transform) -> f64 {
    match transform {
        Transform::Dct => 2157.0,
        Transform::Dtft => 803.0,
        Transform::Dwt => 794.0,
    }
}

/// Table III: time per window by the DCT, in ms.
pub const DCT_MS_PER_WINDOW: f64 = 1.5;

/// Table III: events per window.
pub const EVENTS_PER_WINDOW: f64 = 3200.0;

/// Abstract: throughput of the DCT over that of the other transforms.
pub const DCT_THROUGHPUT: f64 = 2.7;

/// Table V (and the abstract): mean IoU on MVSEC with 24 channels, for the paper's codec and for voxel grids.
pub const IOU_MVSEC_24: [f64; 2] = [0.87, 0.44];

/// Table I: number of the nine scenes in which the DTFT has the lowest EMD.
pub const DTFT_LOWEST: usize = 8;
