//! Parameters on the command line and in files, of the pixel and of the readout alike.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use clap::{Arg, value_parser};

/// Largest file of parameters, in bytes.
const FILE_MAX: u64 = 1 << 20;

/// Reads a file of parameters; the message of an error names it.
pub fn table(path: &Path) -> anyhow::Result<toml::Table> {
    read(path).with_context(|| path.display().to_string())
}

/// Reads a file of parameters.
///
/// # Errors
/// It cannot be read, is too long, or is not TOML.
pub fn read(path: &Path) -> anyhow::Result<toml::Table> {
    let mut text = String::new();
    let file = File::open(path).context("cannot be opened")?;
    file.take(FILE_MAX + 1)
        .read_to_string(&mut text)
        .context("cannot be read")?;
    ensure!(
        text.len() as u64 <= FILE_MAX,
        "is longer than {FILE_MAX} bytes, which no file of parameters is"
    );
    Ok(text.parse()?)
}

/// Returns the value of a parameter in a file.
pub fn number(name: &str, value: &toml::Value) -> anyhow::Result<f64> {
    match value {
        toml::Value::Float(value) => Ok(*value),
        toml::Value::Integer(value) => Ok(*value as f64),
        other => bail!("{name} is {other}, which is not a number"),
    }
}

/// Returns the flag of a parameter, of which `range` has the least and the most.
pub fn flag(
    heading: &'static str,
    name: &'static str,
    about: &str,
    unit: &str,
    [least, most]: [f64; 2],
    default: f64,
) -> Arg {
    let about = about.trim_end_matches('.');
    Arg::new(name)
        .long(name.replace('_', "-"))
        .value_name("X")
        .value_parser(value_parser!(f64))
        .allow_negative_numbers(true)
        .help_heading(heading)
        .help(format!(
            "{about}; unit {unit}, {least} to {most} [default: {default}]"
        ))
}
