//! Reads the entries of zip files, and recordings inside them.

pub(crate) mod entry;
pub(crate) mod recording;
