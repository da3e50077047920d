//! Zip files.

pub(crate) mod entry;
pub(crate) mod recording;
