//! Library behind the `eecvs` command.

pub mod calibrate;
pub mod cmd;
pub mod exact_density;
pub mod formats;
pub mod reference;
pub mod thresholds_file;
