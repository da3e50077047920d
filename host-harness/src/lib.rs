//! Library behind the `eecvs` command.

pub mod baseline;
pub mod bench;
pub mod calibrate;
pub mod cmd;
pub mod convert;
pub mod decode;
pub mod density_series;
pub mod downstream;
pub mod encode;
pub mod exact_density;
pub mod formats;
pub mod frame_file;
pub mod hot_pixels;
pub mod mcu;
pub mod metrics;
pub mod npy;
pub mod output_file;
pub mod progress;
pub mod reconstruct;
pub mod recording_info;
pub mod reference;
pub mod report;
pub mod scene;
pub mod source;
pub mod thresholds_file;
pub mod view;
