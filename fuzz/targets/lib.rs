//! What fuzz targets run: functions of an input's bytes, which panic where a promise does not hold.
//!
//! The programs in fuzz_targets/ hand them to libFuzzer; a test of the workspace runs them on the seeds.

mod drain;
pub mod encode;
pub mod event_link;
pub mod frames;
pub mod hdf5_chunk;
pub mod ingest;
pub mod read;
pub mod sealed;
pub mod unpack;
pub mod video;
