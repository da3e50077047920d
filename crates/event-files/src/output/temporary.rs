//! Temporary files that have a name, since a library wants one: in the system's folder for these.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use event_types::ensure;
use event_types::stream::{Context, Result};

use super::part::Part;

/// Most bytes that are copied to a temporary file: 64 GiB. A pipe without an end and a compressed file made to harm
/// would fill the disk.
const BYTES_MAX: u64 = 1 << 36;

/// A temporary file, removed when it is dropped, or when a signal ends the process.
#[derive(Debug)]
pub struct Temporary(Part);

impl Temporary {
    /// Creates an empty file that only its owner may read.
    ///
    /// # Errors
    /// I/O.
    pub fn create() -> io::Result<(File, Self)> {
        let builder = tempfile::Builder::new();
        Part::build(&builder, &std::env::temp_dir()).map(|(file, part)| (file, Self(part)))
    }

    /// Returns its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

/// Copies all of `from`, which messages call `name`, to a temporary file.
///
/// # Errors
/// I/O; there are more than 64 GiB.
pub(crate) fn copy(from: &mut impl Read, to: &mut impl Write, name: &str) -> Result<()> {
    let copied = io::copy(&mut from.take(BYTES_MAX + 1), to);
    let copied = copied.with_context(|| format!("{name}: cannot be copied"))?;
    ensure!(
        copied <= BYTES_MAX,
        Refused,
        "{name}: longer than {BYTES_MAX} bytes: save it to a file first"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_lives_as_long_as_its_value() {
        let (mut file, temporary) = Temporary::create().unwrap();
        file.write_all(b"bytes").unwrap();
        let path = temporary.path().to_owned();
        assert_eq!(std::fs::read(&path).unwrap(), b"bytes");
        drop(temporary);
        assert!(!path.exists());
    }
}
