//! Results on stdout.

use std::io::{Write, stdout};

use anyhow::{Context, Result};
use serde::Serialize;

/// Prints text as it is.
///
/// # Errors
/// Stdout that cannot be written; a closed pipe is found by `main`, which takes it as the reader's
/// wish to see no more.
pub fn print(text: &str) -> Result<()> {
    let mut out = stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .context("stdout")
}

/// Prints one JSON value and a newline.
///
/// # Errors
/// As [`fn@print`].
pub fn print_json(value: &impl Serialize) -> Result<()> {
    print(&format!("{}\n", serde_json::to_string(value)?))
}

/// Rows of a name and a value, aligned.
#[must_use]
pub fn rows<'a>(rows: impl IntoIterator<Item = (&'a str, String)>) -> String {
    let rows: Vec<_> = rows.into_iter().collect();
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    rows.iter()
        .map(|(name, value)| format!("{name:<width$}  {value}\n"))
        .collect()
}
