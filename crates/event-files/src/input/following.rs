//! Detects files that were concatenated, as by `cat`.
//!
//! Formats that are read from their end (zip, Parquet) or that state their own length (HDF5, Arrow) would read
//! such a file as only one of the recordings, or read the first by the directory of the last if both are alike.
//! The other recording would be lost silently.

use std::io::{self, Read, Seek, SeekFrom};

/// Message for the place where another recording begins.
pub const ANOTHER: &str = "another recording begins here: separate the files";

/// Number of bytes that are searched: more than a footer of some 100,000 row groups.
pub const SEARCHED_BYTES: u64 = 1 << 24;

/// Number of bytes read at once.
const BLOCK_BYTES: usize = 1 << 16;

/// Returns the first offset of `mark` from byte `from` on, within the [`SEARCHED_BYTES`] that a footer may take.
///
/// # Errors
/// I/O.
pub fn find(
    source: &mut (impl Read + Seek + ?Sized),
    from: u64,
    mark: &[u8],
) -> io::Result<Option<u64>> {
    source.seek(SeekFrom::Start(from))?;
    let mut source = source.take(SEARCHED_BYTES);
    let mut block = Vec::with_capacity(BLOCK_BYTES + mark.len());
    let mut start = from;
    loop {
        let read = source
            .by_ref()
            .take(BLOCK_BYTES as u64)
            .read_to_end(&mut block)?;
        let mut places = block.windows(mark.len());
        if let Some(place) = places.position(|bytes| bytes == mark) {
            return Ok(Some(start + place as u64));
        }
        if read == 0 {
            return Ok(None);
        }
        // A mark may straddle two blocks.
        let passed = block.len().saturating_sub(mark.len() - 1);
        block.drain(..passed);
        start += passed as u64;
    }
}

/// Returns whether `mark` is at byte `at`.
///
/// # Errors
/// I/O; the end of the file is not an error.
pub fn is_at(source: &mut (impl Read + Seek + ?Sized), at: u64, mark: &[u8]) -> io::Result<bool> {
    source.seek(SeekFrom::Start(at))?;
    let mut bytes = Vec::new();
    source.take(mark.len() as u64).read_to_end(&mut bytes)?;
    Ok(bytes == mark)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn a_mark_is_found_wherever_it_lies() {
        for at in [
            0,
            7,
            BLOCK_BYTES - 5,
            BLOCK_BYTES - 1,
            BLOCK_BYTES,
            3 * BLOCK_BYTES - 2,
        ] {
            let mut bytes = vec![b'P'; 3 * BLOCK_BYTES + 20];
            bytes[at..at + 8].copy_from_slice(b"PAR1PAR1");
            let mut source = Cursor::new(bytes);
            let found = find(&mut source, 0, b"PAR1PAR1").unwrap();
            assert_eq!(found, Some(at as u64));
            assert_eq!(find(&mut source, at as u64 + 1, b"PAR1PAR1").unwrap(), None);
            assert!(is_at(&mut source, at as u64, b"PAR1PAR1").unwrap());
            assert!(!is_at(&mut source, at as u64 + 1, b"PAR1PAR1").unwrap());
        }
        assert!(!is_at(&mut Cursor::new(b"PAR"), 1, b"PAR1").unwrap());
        assert_eq!(find(&mut Cursor::new(b""), 9, b"PAR1").unwrap(), None);
    }
}
