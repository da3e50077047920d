//! Files that are read as a whole, such as settings: one without an end, or a large one in its place, is refused.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::{Context, Result};
use crate::ensure;

/// Reads a file of at most `bytes_max` bytes.
///
/// # Errors
/// The file cannot be read, or is longer; the message names it.
pub fn read(path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
    let name = path.display();
    let mut bytes = Vec::new();
    let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
    // Of a device or a pipe, nobody knows the length before.
    let read = file.take(bytes_max + 1).read_to_end(&mut bytes);
    read.with_context(|| format!("{name}: cannot be read"))?;
    ensure!(
        bytes.len() as u64 <= bytes_max,
        Damaged,
        "{name}: byte {bytes_max}: longer than a file of this kind may be"
    );
    Ok(bytes)
}

/// Reads a text file of at most `bytes_max` bytes.
///
/// # Errors
/// Those of [`read`]; the file is not UTF-8.
pub fn read_text(path: &Path, bytes_max: u64) -> Result<String> {
    let text = String::from_utf8(read(path, bytes_max)?);
    text.map_err(|error| {
        let byte = error.utf8_error().valid_up_to();
        crate::error!(Damaged, "{}: byte {byte}: not UTF-8 text", path.display())
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_an_end_is_refused() {
        for (path, want) in [
            ("/dev/zero", "longer"),
            (env!("CARGO_MANIFEST_DIR"), "cannot be read"),
            ("/none", "cannot be opened"),
        ] {
            let error = read(Path::new(path), 1000).unwrap_err();
            let error = format!("{error:#}");
            assert!(error.starts_with(path) && error.contains(want), "{error}");
        }
        let own = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"));
        let length = std::fs::metadata(own).unwrap().len();
        assert_eq!(read_text(own, length).unwrap().len() as u64, length);
        read_text(own, length - 1).unwrap_err();
    }
}
