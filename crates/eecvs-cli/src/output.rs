//! Results on stdout.

use std::io::{ErrorKind, Write, stderr, stdout};
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Error, Result};
use event_files::output::{Output, is_stdout};
use serde::Serialize;

/// How a program ends: an error is one line on stderr, and exit status 1.
pub fn end(program: &str, result: Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{program}: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Whether stdout's reader, such as `head`, has seen enough.
#[must_use]
pub fn is_closed_pipe(error: &Error) -> bool {
    io_causes(error).any(|io| io.kind() == ErrorKind::BrokenPipe)
}

/// The system's errors among the causes of `error`.
pub fn io_causes(error: &Error) -> impl Iterator<Item = &std::io::Error> {
    error.chain().filter_map(|cause| {
        let of_events = || cause.downcast_ref().and_then(event_files::Error::io);
        cause.downcast_ref().or_else(of_events)
    })
}

/// Prints text as it is.
///
/// # Errors
/// Stdout that cannot be written; a closed pipe is found by [`end`], which takes it as the reader's
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
/// As [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<()> {
    print(&format!("{}\n", serde_json::to_string(value)?))
}

/// Where a command says what it did: on stdout, unless a stream of the command's own goes there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// stdout.
    Stdout,
    /// stderr.
    Stderr,
}

impl Place {
    /// Beside what is written to these outputs.
    pub fn beside<'p>(outputs: impl IntoIterator<Item = &'p Path>) -> Self {
        Self::unless_taken(outputs.into_iter().any(is_stdout))
    }

    /// Stdout, unless it is taken.
    #[must_use]
    pub const fn unless_taken(is_stdout_taken: bool) -> Self {
        if is_stdout_taken {
            Self::Stderr
        } else {
            Self::Stdout
        }
    }

    /// Prints a report, as one JSON object or as its table.
    ///
    /// # Errors
    /// As [`print()`].
    pub fn tell(
        self,
        json: bool,
        report: &impl Serialize,
        table: impl FnOnce() -> String,
    ) -> Result<()> {
        if json {
            return self.print(&format!("{}\n", serde_json::to_string(report)?));
        }
        self.print(&table())
    }

    /// Prints text as it is.
    ///
    /// # Errors
    /// As [`print()`].
    pub fn print(self, text: &str) -> Result<()> {
        match self {
            Self::Stdout => print(text),
            // Nobody is left to be told that stderr is gone.
            Self::Stderr => {
                let _ = stderr().write_all(text.as_bytes());
                Ok(())
            }
        }
    }
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

/// Gives a live output its name where `outcome` is good; otherwise what came stays as it is, which the
/// error says, and a file without a byte is removed.
///
/// # Errors
/// That of `outcome`, or the file cannot be renamed.
pub fn keep_or_mark<T>(output: Output, outcome: Result<T>) -> Result<T> {
    match outcome {
        Ok(done) => Ok(output.keep().map(|()| done)?),
        Err(error) => match output.leave() {
            Some(part) => {
                Err(error.context(format!("incomplete: what came is in {}", part.display())))
            }
            None => Err(error),
        },
    }
}
