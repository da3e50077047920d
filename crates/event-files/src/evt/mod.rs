//! Prophesee's RAW files with EVT 2, 2.1, 3 and 4 words.

pub mod evt2;
pub mod evt21;
pub mod evt3;
pub mod evt4;
pub mod header;
#[cfg(target_arch = "x86_64")]
mod lanes;
pub(crate) mod row;
pub(crate) mod vector;
pub(crate) mod writer;
