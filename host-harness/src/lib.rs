//! Library behind the `eecvs` command.

pub mod baseline;
pub mod cmd;
pub mod downstream;
pub mod rate;
pub mod recordings;
pub mod report;
pub mod round_trip;
pub mod split;
pub mod study;
pub mod view;
pub mod volume_file;
