//! Lines of text with their numbers, and the fields of a line.

use event_types::stream::Result;

use crate::input::Input;
use crate::input::marked::MARK;

/// Longest line in bytes.
const LINE_MAX: usize = 4096;

/// Largest number of fields kept of a line; a file with more columns is not an event file.
pub const FIELDS_MAX: usize = 32;

/// The lines of a file, with their numbers.
pub struct Lines {
    pub input: Input,
    pub line: Vec<u8>,
    /// Number of the current line, from 1, and its offset.
    pub number: u64,
    pub offset: u64,
    /// Whether the current line has a line break.
    pub is_ended: bool,
}

impl Lines {
    pub fn new(input: Input) -> Self {
        Self {
            input,
            line: Vec::with_capacity(LINE_MAX),
            number: 0,
            offset: 0,
            is_ended: true,
        }
    }

    /// Moves to the next line; returns `false` at the end.
    pub fn advance(&mut self) -> Result<bool> {
        self.line.clear();
        self.offset = self.input.offset();
        let read = self.input.line(&mut self.line, LINE_MAX)?;
        self.number += 1;
        self.is_ended = self.line.last() == Some(&b'\n');
        if read == LINE_MAX && self.line.last() != Some(&b'\n') {
            return Err(self.error("the line is longer than 4096 bytes: not event text"));
        }
        if self.number == 1 && self.line.starts_with(MARK) {
            self.line.drain(..MARK.len());
        }
        while self.line.last().is_some_and(u8::is_ascii_whitespace) {
            self.line.pop();
        }
        Ok(read > 0)
    }

    /// Moves past `count` lines of `bytes` bytes in all.
    pub fn pass(&mut self, bytes: usize, count: u64) {
        self.input.consume(bytes);
        self.number += count;
    }

    /// Returns whether the current line is empty or a comment.
    pub fn is_comment(&self) -> bool {
        let first = self.line.iter().find(|byte| !byte.is_ascii_whitespace());
        matches!(first, None | Some(b'#' | b'%'))
    }

    pub fn error(&self, what: impl std::fmt::Display) -> event_types::stream::Error {
        self.input
            .error_at(self.offset, format!("line {}: {what}", self.number))
    }

    /// Goes to the line of number `number` at byte `offset`.
    ///
    /// # Errors
    /// Those of [`Input::seek`].
    pub fn go_to(&mut self, offset: u64, number: u64) -> Result<()> {
        self.input.seek(offset)?;
        self.number = number - 1;
        Ok(())
    }
}

pub const fn is_separator(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b',' | b';')
}

/// Returns a field without the quotes around it.
pub fn unquoted(field: &[u8]) -> &[u8] {
    match field {
        [b'"', inner @ .., b'"'] => inner,
        field => field,
    }
}

/// Returns the fields of a line.
pub fn split(line: &[u8]) -> Vec<&[u8]> {
    line.split(|byte| is_separator(*byte))
        .filter(|field| !field.is_empty())
        .take(FIELDS_MAX)
        .map(unquoted)
        .collect()
}

/// Returns the column names of a line; between commas, semicolons or tabs, a name may be empty or have several
/// words.
pub fn names(line: &[u8]) -> Vec<&[u8]> {
    let separator = [b',', b';', b'\t']
        .into_iter()
        .find(|byte| line.contains(byte));
    match separator {
        Some(separator) => {
            let names = line.split(|byte| *byte == separator);
            names.take(FIELDS_MAX).collect()
        }
        None => split(line),
    }
}

/// Returns whether a comma stands between two digits in a line with another separator.
pub fn has_decimal_comma(line: &[u8]) -> bool {
    let is_decimal = line.windows(3).any(|letters| {
        matches!(letters, [before, b',', after] if before.is_ascii_digit() && after.is_ascii_digit())
    });
    // A space beside a comma is only padding.
    let separates = |letters: &[u8]| matches!(letters, [before, b' ', after] if !is_separator(*before) && !is_separator(*after));
    let others = line.contains(&b';') || line.contains(&b'\t') || line.windows(3).any(separates);
    is_decimal && others
}
