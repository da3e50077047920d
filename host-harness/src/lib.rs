//! Library behind the `eecvs` command.

pub mod cmd;
pub mod formats;
pub mod metrics;
pub mod report;
