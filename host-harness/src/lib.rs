//! Library behind the `eecvs` command.

pub mod formats;
pub mod scene;
