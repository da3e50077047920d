//! The `eecvs-hub` command: one file for each of its own.

pub mod hub;
pub mod keys;
pub mod options;
pub mod receive;
pub mod sensor;
pub mod simulate;
