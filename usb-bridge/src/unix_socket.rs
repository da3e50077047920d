//! A Unix socket that is listened at.

use std::io::{self, ErrorKind};
use std::os::unix::fs::FileTypeExt as _;
use std::os::unix::net::UnixListener;
use std::path::Path;

use socket2::{Domain, SockAddr, Socket, Type};

/// Listens at `path`. A socket that nobody listens at any more, as a killed program leaves it, is replaced.
///
/// # Errors
/// Something else is at that path, or the folder is not writable.
pub fn listen(path: &Path) -> io::Result<UnixListener> {
    // A file that is not a socket refuses connections in the same way, and must not be removed.
    let is_socket =
        std::fs::symlink_metadata(path).is_ok_and(|metadata| metadata.file_type().is_socket());
    if is_socket && is_dead(path)? {
        std::fs::remove_file(path)?;
    }
    UnixListener::bind(path)
}

/// Returns whether nobody listens at a socket. A program that listens and accepts nobody, so that a connection would have
/// to wait, is not waited for.
fn is_dead(path: &Path) -> io::Result<bool> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
    socket.set_nonblocking(true)?;
    let connected = socket.connect(&SockAddr::unix(path)?);
    Ok(connected.is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused))
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
        // Whoever listens and accepts nobody is no reason to wait.
        let full = folder.path().join("full");
        let deaf = Socket::new(Domain::UNIX, Type::STREAM, None).unwrap();
        let address = SockAddr::unix(&full).unwrap();
        deaf.bind(&address).unwrap();
        deaf.listen(0).unwrap();
        let waiting: Vec<Socket> = (0..4)
            .map(|_| {
                let socket = Socket::new(Domain::UNIX, Type::STREAM, None).unwrap();
                socket.set_nonblocking(true).unwrap();
                let _ = socket.connect(&address);
                socket
            })
            .collect();
        assert_eq!(listen(&full).unwrap_err().kind(), ErrorKind::AddrInUse);
        drop(waiting);
        let file = folder.path().join("file");
        std::fs::write(&file, "content").unwrap();
        assert!(listen(&file).is_err());
        assert_eq!(std::fs::read(&file).unwrap(), b"content");
    }
}
