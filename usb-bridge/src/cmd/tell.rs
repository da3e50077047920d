//! What commands say beside the stream: a report on stdout, or on stderr where the stream itself is on stdout.

use std::io::{ErrorKind, Write, stderr};

use anyhow::{Context, Error, Result};
use host_harness::cmd::output::Place;
use serde::Serialize;

/// Where a report goes, and how.
#[derive(Debug, Clone, Copy)]
pub struct Telling {
    /// As one JSON object in place of the table.
    pub json: bool,
    /// Stdout has the stream.
    pub is_stdout_taken: bool,
}

impl Telling {
    /// Tells a report.
    ///
    /// # Errors
    /// Stdout that cannot be written.
    pub fn tell(self, report: &impl Serialize, table: impl FnOnce() -> String) -> Result<()> {
        let text = if self.json {
            serde_json::to_string(report).context("JSON")? + "\n"
        } else {
            table()
        };
        let place = match self.is_stdout_taken {
            true => Place::Stderr,
            false => Place::Stdout,
        };
        place.print(&text)
    }
}

/// A line on stderr.
pub fn warn(text: &str) {
    let _ = writeln!(stderr(), "eecvs-usb: {text}");
}

/// Whether a reader of stdout, such as `head`, has seen enough.
#[must_use]
pub fn is_closed_pipe(error: &Error) -> bool {
    error.chain().any(|cause| {
        let io = cause.downcast_ref::<std::io::Error>();
        io.is_some_and(|io| io.kind() == ErrorKind::BrokenPipe)
    })
}
