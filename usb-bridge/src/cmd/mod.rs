//! Subcommands of `eecvs-usb`, one file each, their flags beside them.

pub mod capture;
pub mod forward;
pub mod list;
pub mod mcu;
pub mod options;
pub mod receive;
pub mod simulate;

use std::io::{Write, stderr};
use std::path::Path;

/// A line on stderr, under the name of the program that runs: `eecvs-usb`, or `eecvs-hub`.
fn warn(text: &str) {
    let path = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&path).file_stem().unwrap_or_default();
    // Nobody reads a stderr that is gone.
    let _ = writeln!(stderr(), "{}: {text}", name.display());
}
