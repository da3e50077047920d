//! Subcommands of `eecvs-usb`, one file each, their flags beside them.

pub mod capture;
pub mod forward;
pub mod list;
pub mod mcu;
pub mod options;
pub mod receive;
pub mod simulate;
mod tell;
