//! Library behind the `eecvs` command.

pub mod calibrate;
pub mod cmd;
pub mod encode;
pub mod exact_density;
pub mod formats;
pub mod frame_file;
pub mod reconstruct;
pub mod reference;
pub mod thresholds_file;
