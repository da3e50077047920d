//! Properties and recordings, across the crates.

mod coefficients;
mod documents;
mod exact_times;
mod firmware_image;
mod fixed_vs_float;
mod frame_files;
mod fuzz_targets;
mod hostile;
mod hybrid;
mod ingest;
mod keep_order;
mod kernels;
mod keys;
mod link_faults;
mod memory_budget;
mod quick;
mod rate_control;
mod rates;
mod recordings;
mod roundtrip;
mod runs;
mod stress;
mod structure;
mod threads;
mod walks;
mod windows;
