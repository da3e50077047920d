//! Output of results, and exit status.

use std::io::{ErrorKind, Write, stderr, stdout};
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Error, Result, bail};
use eecvs::frame_file::FrameFileWriter;
use event_files::output::{Output, OutputFile, is_stdout};
use event_types::plain;
use serde::Serialize;

/// An error of the command line that only its flags together show.
#[derive(Debug)]
pub struct Usage(String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Returns the error of a wrong command line, for which [`end`] gives exit status 2.
#[must_use]
pub fn usage(what: &str) -> Usage {
    Usage(what.to_owned())
}

/// Ends a program: an error is printed as one line on stderr and gives exit status 1, or 2 if it is one of the command
/// line ([`usage`]); a closed pipe is a success.
pub fn end(program: &str, result: Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("{program}: {error:#}"));
            if error.is::<Usage>() {
                ExitCode::from(2)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}

/// Prints one line on stderr, in which a terminal acts on nothing: see [`plain`].
pub fn say(line: &str) {
    // If stderr is gone, nobody can be informed of it.
    let _ = writeln!(stderr(), "{}", plain::line(line));
}

/// Prints lines on stderr, each as [`say()`] does.
pub fn say_lines(lines: &str) {
    lines.lines().for_each(say);
}

/// Prints one line on stderr, with the arguments of [`format!`]; like [`say()`].
#[macro_export]
macro_rules! say {
    ($($argument:tt)*) => {
        $crate::output::say(&format!($($argument)*))
    };
}

/// Ends the process at an error of the command line, or after the help or the version that it asked for.
pub fn exit_at(error: &clap::Error) -> ! {
    if error.use_stderr() {
        // It may quote the name of a file.
        eprint!("{}", plain::lines(&error.render().to_string()));
        std::process::exit(error.exit_code());
    }
    error.exit()
}

/// Parses the command line of this process; bad usage ends it with exit status 2.
#[must_use]
pub fn parse<P: clap::Parser>() -> P {
    P::try_parse().unwrap_or_else(|error| exit_at(&error))
}

/// Returns whether the error is a closed pipe: the reader of stdout, such as `head`, has stopped reading.
#[must_use]
pub fn is_closed_pipe(error: &Error) -> bool {
    io_causes(error).any(|io| io.kind() == ErrorKind::BrokenPipe)
}

/// Returns the I/O errors among the causes of `error`.
pub fn io_causes(error: &Error) -> impl Iterator<Item = &std::io::Error> {
    error.chain().filter_map(|cause| {
        let of_events = || cause.downcast_ref().and_then(event_files::Error::io);
        cause.downcast_ref().or_else(of_events)
    })
}

/// Prints text of several lines to stdout, in which a terminal acts on nothing but newlines and tabs: see [`plain`].
///
/// # Errors
/// Stdout cannot be written; [`end`] treats a closed pipe as a success.
pub fn print(text: &str) -> Result<()> {
    write(&plain::lines(text))
}

fn write(text: &str) -> Result<()> {
    let mut out = stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .context("stdout")
}

/// Prints one JSON value and a newline to stdout.
///
/// # Errors
/// As for [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<()> {
    write(&json_line(value)?)
}

fn json_line(value: &impl Serialize) -> Result<String> {
    let text = serde_json::to_string(value)?;
    Ok(format!("{}\n", plain::json(&text)))
}

/// Begins a file of frames, with marks; a device or a pipe takes a stream, without them.
///
/// # Errors
/// The file cannot be created; the message names it.
pub fn frame_file(path: &Path) -> Result<FrameFileWriter<OutputFile>> {
    let out = OutputFile::create(path)?;
    Ok(if out.is_direct() {
        FrameFileWriter::stream(out)
    } else {
        FrameFileWriter::new(out)
    })
}

/// Where a command prints its report: stdout, unless the command writes a data stream there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Standard output.
    Stdout,
    /// Standard error.
    Stderr,
}

impl Place {
    /// Returns the place for a report of a command that writes to these outputs.
    pub fn beside<'p>(outputs: impl IntoIterator<Item = &'p Path>) -> Self {
        Self::unless_taken(outputs.into_iter().any(is_stdout))
    }

    /// Returns stdout, or stderr if stdout is taken.
    #[must_use]
    pub const fn unless_taken(is_stdout_taken: bool) -> Self {
        if is_stdout_taken {
            Self::Stderr
        } else {
            Self::Stdout
        }
    }

    /// Prints a report as one JSON object, or as its table.
    ///
    /// # Errors
    /// As for [`print()`].
    pub fn tell(
        self,
        json: bool,
        report: &impl Serialize,
        table: impl FnOnce() -> String,
    ) -> Result<()> {
        if json {
            return self.put(&json_line(report)?);
        }
        self.print(&table())
    }

    /// Prints text of several lines, like [`print()`].
    ///
    /// # Errors
    /// As for [`print()`]; errors of stderr are ignored.
    pub fn print(self, text: &str) -> Result<()> {
        self.put(&plain::lines(text))
    }

    fn put(self, text: &str) -> Result<()> {
        match self {
            Self::Stdout => write(text),
            // If stderr is gone, nobody can be informed of it.
            Self::Stderr => {
                let _ = stderr().write_all(text.as_bytes());
                Ok(())
            }
        }
    }
}

/// Formats rows of names and values as an aligned table.
#[must_use]
pub fn rows<'a>(rows: impl IntoIterator<Item = (&'a str, String)>) -> String {
    let rows: Vec<_> = rows.into_iter().collect();
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    rows.iter()
        .map(|(name, value)| format!("{name:<width$}  {}\n", plain::line(value)))
        .collect()
}

/// Completes a live output if `outcome` is good. Otherwise the data received so far is kept, which the error
/// mentions, and an empty file is removed.
///
/// # Errors
/// The error of `outcome`; nothing arrived, and an empty file is not one of its format; or the file cannot be renamed.
pub fn keep_or_mark<T>(output: Output, outcome: Result<T>) -> Result<T> {
    match outcome {
        Ok(_) if output.is_empty() => {
            let name = output.name().display().to_string();
            let _ = output.leave();
            bail!("{name}: not written, since nothing arrived")
        }
        Ok(done) => Ok(output.keep().map(|()| done)?),
        Err(error) => match output.leave() {
            Some(part) => {
                Err(error.context(format!("incomplete: what arrived is in {}", part.display())))
            }
            None => Err(error),
        },
    }
}
