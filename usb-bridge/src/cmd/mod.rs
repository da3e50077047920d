//! Subcommands of `eecvs-usb`, one file each, their flags beside them.

pub mod capture;
pub mod forward;
pub mod list;
pub mod mcu;
pub mod options;
pub mod receive;
pub mod simulate;

use std::io::{Write, stderr};

/// A line on stderr.
fn warn(text: &str) {
    // Nobody is left to be told that stderr is gone.
    let _ = writeln!(stderr(), "eecvs-usb: {text}");
}
