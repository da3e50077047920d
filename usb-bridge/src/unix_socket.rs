//! A Unix socket that is listened at.

use std::io::{self, ErrorKind};
use std::os::unix::fs::FileTypeExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;

/// Listens at `path`. A socket that nobody listens at any more, as a killed program leaves it, is replaced.
///
/// # Errors
/// Something else is at that path, or the folder is not writable.
pub fn listen(path: &Path) -> io::Result<UnixListener> {
    // A file that is not a socket refuses connections in the same way, and must not be removed.
    let is_socket =
        std::fs::symlink_metadata(path).is_ok_and(|metadata| metadata.file_type().is_socket());
    let is_dead = || {
        UnixStream::connect(path).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused)
    };
    if is_socket && is_dead() {
        std::fs::remove_file(path)?;
    }
    UnixListener::bind(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_socket_that_was_left_is_replaced_and_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        // Its file stays when it is closed.
        drop(listen(&path).unwrap());
        assert!(path.exists());
        let second = listen(&path).unwrap();
        assert_eq!(listen(&path).unwrap_err().kind(), ErrorKind::AddrInUse);
        drop(second);
        let file = folder.path().join("file");
        std::fs::write(&file, "content").unwrap();
        assert!(listen(&file).is_err());
        assert_eq!(std::fs::read(&file).unwrap(), b"content");
    }
}
