//! Hides the byte-order mark of UTF-8 that an editor has put in front of a header of text.

use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom};

use crate::input::ReadSeek;

/// The mark.
pub const MARK: &[u8] = b"\xef\xbb\xbf";

/// A source without its first three bytes.
pub struct Marked(Box<dyn ReadSeek>);

impl Marked {
    /// Hides the mark of `source`, which must begin with one.
    ///
    /// # Errors
    /// I/O.
    pub fn new(mut source: Box<dyn ReadSeek>) -> Result<Self> {
        source.seek(SeekFrom::Start(MARK.len() as u64))?;
        Ok(Self(source))
    }
}

impl Read for Marked {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize> {
        self.0.read(bytes)
    }
}

impl Seek for Marked {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        let hidden = MARK.len() as u64;
        let at = self.0.seek(match to {
            SeekFrom::Start(at) => SeekFrom::Start(at.saturating_add(hidden)),
            other => other,
        })?;
        at.checked_sub(hidden)
            .ok_or_else(|| Error::from(ErrorKind::InvalidInput))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn offsets_are_counted_from_the_mark_on() {
        let mut marked = Marked::new(Box::new(Cursor::new(b"\xef\xbb\xbf% evt".to_vec()))).unwrap();
        let mut text = String::new();
        marked.read_to_string(&mut text).unwrap();
        assert_eq!(text, "% evt");
        assert_eq!(marked.seek(SeekFrom::End(0)).unwrap(), 5);
        assert_eq!(marked.seek(SeekFrom::Start(2)).unwrap(), 2);
        assert_eq!(marked.seek(SeekFrom::Current(1)).unwrap(), 3);
        text.clear();
        marked.read_to_string(&mut text).unwrap();
        assert_eq!(text, "vt");
        assert!(marked.seek(SeekFrom::End(-6)).is_err());
    }
}
