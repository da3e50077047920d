//! The subcommands of `eecvs-hub`, one file each.

mod files;
pub mod hub;
pub mod keys;
pub mod options;
pub mod receive;
pub mod sensor;
pub mod simulate;
