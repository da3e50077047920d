//! A simulated device on the USB of a program on this machine, without a kernel's part in it.
//!
//! ```text
//! program: libusb -> sysfs and ioctls of usbfs -> libumockdev-preload, in the program
//!                       | files (tree)               | a socket (preload)
//! this process:      a folder                 the ioctls as the kernel answers them (kernel) -> Peripheral
//! ```
//!
//! The program runs with umockdev's library preloaded, which sends what it does with files below `/sys` and `/dev` to
//! the folder, and its ioctls to the socket. Any program that reaches USB through libusb sees the device and no other.

pub mod kernel;
mod preload;
mod tree;

use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, bail};

use self::kernel::Usbfs;
use self::preload::Server;
use self::tree::{Node, Tree};
use super::Peripheral;

/// Name of umockdev's library, which the dynamic linker finds.
const PRELOAD: &str = "libumockdev-preload.so.0";

/// A USB with one device, at port 4 of bus 1, with address 7.
pub struct MockedUsb {
    tree: Tree,
    usbfs: Arc<Mutex<Usbfs>>,
    // Before the folder goes, in which its socket is.
    _server: Server,
}

impl MockedUsb {
    /// Attaches `peripheral`.
    ///
    /// # Errors
    /// umockdev's library is not installed, or the folder for temporary files cannot be used.
    pub fn new(peripheral: Box<dyn Peripheral>) -> Result<Self> {
        check_library()?;
        let tree = Tree::create(peripheral.descriptors())
            .context("cannot create the simulated device in the folder for temporary files")?;
        let usbfs = Arc::new(Mutex::new(Usbfs::new(peripheral)));
        let server = Server::start(&tree.socket(), &usbfs)?;
        Ok(Self {
            tree,
            usbfs,
            _server: server,
        })
    }

    /// Returns the command that runs a program which sees this USB and no other.
    #[must_use]
    pub fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command
            .env("LD_PRELOAD", PRELOAD)
            .env("UMOCKDEV_DIR", self.tree.root());
        command
    }

    /// Calls `use_it` with the kernel's side of the device.
    pub fn with_usbfs<T>(&self, use_it: impl FnOnce(&mut Usbfs) -> T) -> T {
        use_it(&mut self.usbfs.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Takes the device off the bus: it disappears, and whatever is asked of it fails.
    ///
    /// # Errors
    /// The folder cannot be changed.
    pub fn unplug(&mut self) -> Result<()> {
        self.with_usbfs(Usbfs::unplug);
        self.tree.remove().context("unplugging the device")
    }

    /// Sets whether everybody may open the device, or its owner alone.
    ///
    /// # Errors
    /// The folder cannot be changed.
    pub fn permit(&self, everybody: bool) -> Result<()> {
        let node = if everybody { Node::Open } else { Node::Private };
        self.tree
            .set_node(node)
            .context("setting the permissions of the device")
    }

    /// Returns the folder that holds the program's `/sys` and `/dev`.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.tree.root()
    }
}

/// Checks that the dynamic linker finds the library: it only warns if it does not.
fn check_library() -> Result<()> {
    let output = Command::new("true")
        .env("LD_PRELOAD", PRELOAD)
        .stdin(Stdio::null())
        .output()
        .context("true: cannot be run")?;
    if !output.status.success() || !output.stderr.is_empty() {
        bail!(
            "{PRELOAD} is missing: install umockdev (Debian, Ubuntu: apt install umockdev; Fedora: dnf install \
             umockdev)"
        );
    }
    Ok(())
}
