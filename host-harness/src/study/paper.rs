//! Figures of the paper (arXiv 2603.14738) that ours stand beside.
//!
//! Only those that this project has from the paper's text are here. Its Tables I, II, IV and V are on
//! EHPT-XC and MVSEC, which are not shipped with anything; their single cells are in the paper.

use eecvs_nostd::Transform;

/// Table III: thousand events per second at M = 8, windows of about 3,200 events, a desktop computer.
#[must_use]
pub const fn kev_per_s(transform: Transform) -> f64 {
    match transform {
        Transform::Dct => 2157.0,
        Transform::Dtft => 803.0,
        Transform::Dwt => 794.0,
    }
}

/// Table III: time of a window by DCT.
pub const DCT_MS_PER_WINDOW: f64 = 1.5;

/// Table III's windows.
pub const EVENTS_PER_WINDOW: f64 = 3200.0;

/// Abstract: throughput of the DCT over that of the others.
pub const DCT_THROUGHPUT: f64 = 2.7;

/// Table V (and the abstract): mean IoU on MVSEC at 24 channels, of the paper's codec and of voxel grids.
pub const IOU_MVSEC_24: [f64; 2] = [0.87, 0.44];

/// Table I: scenes of nine in which the DTFT has the lowest EMD.
pub const DTFT_LOWEST: usize = 8;
