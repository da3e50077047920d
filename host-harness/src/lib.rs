//! Library behind the `eecvs` command.

pub mod encode;
pub mod formats;
pub mod frame_file;
pub mod reconstruct;
