//! Subcommands of `eecvs-usb`, one file each, their flags beside them.

pub mod list;
pub mod simulate;
