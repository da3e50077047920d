//! The command line end to end, and what it is compared with.

mod bench;
#[path = "../browser/mod.rs"]
mod browser;
mod decode;
mod formats_peers;
mod frame_files;
mod frames;
mod hybrid;
mod kernel;
mod mcu;
mod mcu_peer;
#[cfg(target_os = "linux")]
mod memory;
mod metrics_reference;
#[cfg(feature = "onnx")]
mod onnx;
mod outputs;
mod rate;
mod recordings;
mod report_page;
mod save;
mod status;
mod streams;
mod support;
mod truth;
mod view;
#[cfg(target_os = "linux")]
mod view_keys;
mod volume;
mod volumes_reference;
