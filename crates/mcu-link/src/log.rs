//! The log of a firmware image: defmt frames, decoded with the strings stored in the image.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::sync::{Arc, Mutex, PoisonError};

use defmt_decoder::{DecodeError, Locations, Table};
use event_types::stream::Result;
use event_types::{error, plain};

/// Number of lines kept for error messages.
const KEPT_LINES: usize = 20;

/// The latest lines of a log; clones share the same lines.
#[derive(Debug, Clone, Default)]
pub struct LogLines(Arc<Mutex<VecDeque<String>>>);

impl LogLines {
    fn push(&self, line: String) {
        let mut lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.len() == KEPT_LINES {
            lines.pop_front();
        }
        lines.push_back(line);
    }

    /// Returns the latest lines, oldest first.
    #[must_use]
    pub fn latest(&self) -> Vec<String> {
        let lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        lines.iter().cloned().collect()
    }
}

/// Decodes the log of an image.
pub struct LogDecoder {
    /// `None` for an image without defmt.
    table: Option<Table>,
    locations: Locations,
}

impl LogDecoder {
    /// Creates the decoder for an ELF image.
    ///
    /// # Errors
    /// An image that is damaged or uses another version of defmt.
    pub fn new(image: &[u8]) -> Result<Self> {
        let table = Table::parse(image)
            .map_err(|error| error!(Damaged, "the image's defmt strings: {error}"))?;
        // Without debug information there are no locations, which is not an error.
        let locations = table
            .as_ref()
            .and_then(|table| table.get_locations(image).ok())
            .unwrap_or_default();
        Ok(Self { table, locations })
    }

    /// Reads a log to its end, keeps its latest lines in `lines`, and prints it to stderr: all of it, or warnings and
    /// errors only.
    pub fn follow(&self, source: &mut dyn Read, all: bool, lines: &LogLines) {
        let mut bytes = [0; 1024];
        let mut decoder = self.table.as_ref().map(Table::new_stream_decoder);
        // A read error ends the log silently: the link shows whether the encoder works.
        while let Ok(read @ 1..) = source.read(&mut bytes) {
            let (Some(decoder), Some(table)) = (&mut decoder, &self.table) else {
                continue;
            };
            decoder.received(&bytes[..read]);
            loop {
                let frame = match decoder.decode() {
                    Ok(frame) => frame,
                    Err(DecodeError::Malformed) if table.encoding().can_recover() => {
                        show("warn", "malformed log", "", true, lines);
                        continue;
                    }
                    Err(_) => break,
                };
                let level = frame.level().map_or("print", |level| level.as_str());
                let place = self
                    .locations
                    .get(&frame.index())
                    .map(|at| format!(" ({}:{})", file_name(&at.file), at.line))
                    .unwrap_or_default();
                let message = frame.display_message().to_string();
                show(level, &message, &place, all, lines);
            }
        }
    }
}

fn file_name(path: &std::path::Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

fn show(level: &str, message: &str, place: &str, all: bool, lines: &LogLines) {
    let line = format!("{level:<5} {message}{place}");
    if all || ["warn", "error"].contains(&level) {
        // A closed stderr is no reason to stop reading: the emulator would stall.
        let _ = writeln!(std::io::stderr(), "mcu: {}", plain::line(&line));
    }
    lines.push(line);
}
