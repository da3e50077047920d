//! Subcommands of `eecvs`, one file each, their flags beside them.

pub mod calibrate;
