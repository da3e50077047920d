//! Files and their names, written to the disk: what is there after a power cut.

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

/// Writes what the system still holds of a file to the disk.
///
/// # Errors
/// The file cannot be opened, or the disk fails.
pub fn sync(path: &Path) -> std::io::Result<()> {
    // Windows syncs only what is open for writing.
    let file = match File::options().write(true).open(path) {
        Ok(file) => file,
        // A new file has the rights of the one that it replaces, which may be read-only.
        Err(error) if error.kind() == ErrorKind::PermissionDenied => File::open(path)?,
        Err(error) => return Err(error),
    };
    allow_unsynced(file.sync_all())
}

/// Writes the names in a folder to the disk.
///
/// # Errors
/// The folder cannot be opened, or the disk fails.
#[cfg(unix)]
pub fn sync_folder(folder: &Path) -> std::io::Result<()> {
    match File::open(folder) {
        Ok(folder) => allow_unsynced(folder.sync_all()),
        // A folder may be writable without being readable.
        Err(error) if error.kind() == ErrorKind::PermissionDenied => Ok(()),
        Err(error) => Err(error),
    }
}

/// Does nothing: the system writes names to the disk itself.
///
/// # Errors
/// None.
#[cfg(not(unix))]
pub fn sync_folder(_: &Path) -> std::io::Result<()> {
    Ok(())
}

/// Some file systems have nothing to sync, and say so.
fn allow_unsynced(synced: std::io::Result<()>) -> std::io::Result<()> {
    match synced {
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::InvalidInput | ErrorKind::Unsupported
            ) =>
        {
            Ok(())
        }
        other => other,
    }
}
