//! Converts UTF-16 text to ASCII bytes for readers of text.
//!
//! PowerShell's redirection and Excel's "Unicode text" write UTF-16. Lines of events are ASCII: each unit of two
//! bytes becomes one byte, and a letter beyond ASCII a question mark, so that offsets stay known and the text can
//! be sought.

use std::io::{Read, Result, Seek, SeekFrom};

use crate::input::ReadSeek;

/// Size in bytes of the byte-order mark.
const MARK_BYTES: u64 = 2;

/// Returns whether a text begins with a byte-order mark of UTF-16.
pub fn is_utf16(start: &[u8]) -> bool {
    let is_utf32 = start.starts_with(&[0xff, 0xfe, 0, 0]);
    (start.starts_with(&[0xff, 0xfe]) || start.starts_with(&[0xfe, 0xff])) && !is_utf32
}

/// A source of UTF-16 text, without its byte-order mark.
pub struct Utf16 {
    source: Box<dyn ReadSeek>,
    big_endian: bool,
    /// Position of the next read, in letters.
    at: u64,
    units: Vec<u8>,
}

impl Utf16 {
    /// Begins after the byte-order mark, whose first byte is `first`.
    pub fn new(source: Box<dyn ReadSeek>, first: u8) -> Self {
        Self {
            source,
            big_endian: first == 0xfe,
            at: 0,
            units: Vec::new(),
        }
    }
}

impl Read for Utf16 {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize> {
        self.source
            .seek(SeekFrom::Start(MARK_BYTES + 2 * self.at))?;
        self.units.resize(2 * bytes.len(), 0);
        let mut filled = 0;
        // Reads until whole units of two bytes are filled.
        while let Some(free) = self.units.get_mut(filled..)
            && (filled == 0 || filled % 2 == 1)
        {
            match self.source.read(free)? {
                0 => break,
                read => filled += read,
            }
        }
        let units = self.units.get(..filled).unwrap_or_default();
        let (units, _) = units.as_chunks::<2>();
        for (byte, unit) in bytes.iter_mut().zip(units) {
            let letter = match self.big_endian {
                true => u16::from_be_bytes(*unit),
                false => u16::from_le_bytes(*unit),
            };
            *byte = u8::try_from(letter)
                .ok()
                .filter(u8::is_ascii)
                .unwrap_or(b'?');
        }
        self.at += units.len() as u64;
        Ok(units.len())
    }
}

impl Seek for Utf16 {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.at = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::Current(by) => self.at.saturating_add_signed(by),
            SeekFrom::End(by) => {
                let end = self.source.seek(SeekFrom::End(0))?;
                (end.saturating_sub(MARK_BYTES) / 2).saturating_add_signed(by)
            }
        };
        Ok(self.at)
    }
}
