//! A Unix socket through which QEMU gets a simulated device.

use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::server::{LOOK, Service, is_later};
use super::socket::{self, Change};
use super::usbredir::UsbRedir;
use crate::unix_socket;

/// A Unix socket that hosts connect to; its file is removed when it is dropped.
pub struct UnixServer {
    listener: UnixListener,
    path: PathBuf,
}

impl UnixServer {
    /// Listens at `path`; a stale socket at that path is replaced.
    ///
    /// # Errors
    /// Something else is at that path, or the folder is not writable.
    pub fn listen(path: &Path) -> Result<Self> {
        let name = path.display();
        let listener = unix_socket::listen(path).with_context(|| {
            format!("{name}: cannot listen there: use a path that does not exist")
        })?;
        let path = path.to_owned();
        listener.set_nonblocking(true).context("socket")?;
        Ok(Self { listener, path })
    }

    /// Serves one host at a time over usbredir.
    ///
    /// # Errors
    /// As for [`super::server::serve_usbip`].
    pub fn serve_usbredir(&self, service: &mut Service<'_>) -> Result<()> {
        let stop = service.stop;
        let stopped = || stop.is_asked();
        while !stopped() {
            let mut socket = match self.listener.accept() {
                Ok((socket, _)) => socket,
                Err(error) if is_later(&error) => {
                    std::thread::sleep(LOOK);
                    continue;
                }
                Err(error) => return Err(error).context(self.path.display().to_string()),
            };
            let mut session = UsbRedir::with((service.device)()?);
            let served = socket::serve(&mut socket, &mut session, &mut || {
                stopped().then_some(Change::End)
            });
            (service.left)(&served);
            if service.once {
                return served.map(|_| ());
            }
        }
        Ok(())
    }
}

impl Drop for UnixServer {
    fn drop(&mut self) {
        // If the file is gone already, nothing is left to do.
        let _ = std::fs::remove_file(&self.path);
    }
}
