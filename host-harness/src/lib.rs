//! Library behind the `eecvs` command.

pub mod convert;
pub mod formats;
pub mod recording_info;
