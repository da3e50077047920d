//! Subcommands of `eecvs-usb`, one file each, together with their flags.

pub mod capture;
pub mod forward;
pub mod list;
pub mod mcu;
pub mod options;
pub mod receive;
pub mod simulate;

use std::path::Path;

use eecvs_cli::say;

/// Prints a line on stderr, prefixed with the name of the running program: `eecvs-usb` or `eecvs-hub`.
fn warn(text: &str) {
    let path = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&path).file_stem().unwrap_or_default();
    say!("{}: {text}", name.display());
}
