//! The files by which a program finds a device on USB: sysfs and the device's node.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};

use crate::peripheral::{Descriptors, Speed};

/// Folders of the root hub and of the device in sysfs.
const HUB: &str = "sys/devices/pci0000:00/0000:00:14.0/usb1";
const DEVICE: &str = "sys/devices/pci0000:00/0000:00:14.0/usb1/1-4";
/// Nodes of both, below `/dev`.
const HUB_NODE: &str = "bus/usb/001/001";
const DEVICE_NODE: &str = "bus/usb/001/007";

/// What the device's node is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Node {
    /// Everybody may open it.
    Open,
    /// Only its owner may open it.
    Private,
}

/// A folder with the files, which is removed when it is dropped.
pub struct Tree {
    root: PathBuf,
}

impl Tree {
    /// Creates the files of a device with these descriptors.
    pub fn create(descriptors: &Descriptors) -> io::Result<Self> {
        // The path of a Unix socket has at most 107 bytes: nothing long before it.
        let tree = Self {
            root: unique_folder()?,
        };
        // The preloaded library makes sockets there, for whatever user.
        fs::set_permissions(&tree.root, fs::Permissions::from_mode(0o777))?;
        tree.add(HUB, HUB_NODE, &root_hub())?;
        tree.add(DEVICE, DEVICE_NODE, &attributes(descriptors))?;
        tree.set_node(Node::Open)?;
        fs::create_dir_all(tree.root.join("run/udev/data"))?;
        let socket = tree.socket();
        fs::create_dir_all(socket.parent().unwrap_or(&tree.root))?;
        Ok(tree)
    }

    /// Returns the folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the path of the socket that the device's ioctls go to.
    pub fn socket(&self) -> PathBuf {
        self.root.join("ioctl/dev").join(DEVICE_NODE)
    }

    fn node(&self) -> PathBuf {
        self.root.join("dev").join(DEVICE_NODE)
    }

    /// Makes the device's node.
    pub fn set_node(&self, node: Node) -> io::Result<()> {
        let path = self.node();
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        match node {
            // Memory of the device cannot be mapped there, as from an empty file it could be, until it is used.
            Node::Open => symlink("/dev/null", path),
            Node::Private => {
                fs::write(&path, [])?;
                fs::set_permissions(&path, fs::Permissions::from_mode(0o600))
            }
        }
    }

    /// Removes the device; the root hub stays.
    pub fn remove(&self) -> io::Result<()> {
        fs::remove_file(self.root.join("sys/bus/usb/devices/1-4"))?;
        fs::remove_dir_all(self.root.join(DEVICE))?;
        fs::remove_file(self.node())
    }

    fn add(&self, folder: &str, node: &str, attributes: &[(&str, Vec<u8>)]) -> io::Result<()> {
        let place = self.root.join(folder);
        fs::create_dir_all(&place)?;
        for (name, value) in attributes {
            fs::write(place.join(name), value)?;
        }
        let number = |at: usize| node.rsplit('/').nth(at).and_then(|text| text.parse().ok());
        let (address, bus): (u32, u32) = (number(0).unwrap_or(0), number(1).unwrap_or(0));
        let minor = (bus - 1) * 128 + address - 1;
        let mut uevent =
            format!("MAJOR=189\nMINOR={minor}\nDEVNAME={node}\nDEVTYPE=usb_device\nDRIVER=usb\n");
        let _ = writeln!(uevent, "BUSNUM={bus:03}\nDEVNUM={address:03}");
        fs::write(place.join("uevent"), uevent)?;
        fs::write(place.join("dev"), format!("189:{minor}\n"))?;
        fs::write(place.join("busnum"), format!("{bus}\n"))?;
        fs::write(place.join("devnum"), format!("{address}\n"))?;
        fs::write(place.join("bConfigurationValue"), "1\n")?;
        let subsystem = self.root.join("sys/bus/usb");
        fs::create_dir_all(subsystem.join("devices"))?;
        let up = "../".repeat(folder.split('/').count() - 1);
        symlink(format!("{up}bus/usb"), place.join("subsystem"))?;
        let name = folder.rsplit('/').next().unwrap_or(folder);
        let below_sys = folder.trim_start_matches("sys/");
        symlink(
            format!("../../../{below_sys}"),
            subsystem.join("devices").join(name),
        )?;
        let characters = self.root.join("sys/dev/char");
        fs::create_dir_all(&characters)?;
        symlink(
            format!("../../{below_sys}"),
            characters.join(format!("189:{minor}")),
        )?;
        let path = self.root.join("dev").join(node);
        fs::create_dir_all(path.parent().unwrap_or(&self.root))?;
        let numbers = self.root.join("dev/.node");
        fs::create_dir_all(&numbers)?;
        symlink(format!("189:{minor}"), numbers.join(node.replace('/', "_")))?;
        fs::write(path, [])
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        // What cannot be removed is left to whoever cleans the folder for temporary files.
        let _ = fs::remove_dir_all(&self.root);
    }
}

/// Creates a folder with a name of its own.
fn unique_folder() -> io::Result<PathBuf> {
    let base = std::env::temp_dir();
    let process = std::process::id();
    for number in 0..u32::MAX {
        let path = base.join(format!("eecvs-usb.{process}.{number}"));
        match fs::create_dir(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            result => return result.map(|()| path),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Returns the attributes of a device in sysfs, without those of its place.
fn attributes(descriptors: &Descriptors) -> Vec<(&'static str, Vec<u8>)> {
    let device = &descriptors.device;
    let byte = |at: usize| device.get(at).copied().unwrap_or(0);
    let word = |at: usize| format!("{:02x}{:02x}\n", byte(at + 1), byte(at));
    let speed = match descriptors.speed {
        Speed::Full => "12\n",
        Speed::High => "480\n",
        Speed::Super => "5000\n",
    };
    let mut all = vec![
        ("speed", speed.into()),
        ("idVendor", word(8).into()),
        ("idProduct", word(10).into()),
        ("bcdDevice", word(12).into()),
        ("bNumConfigurations", "1\n".into()),
        (
            "descriptors",
            [&device[..], &descriptors.configuration].concat(),
        ),
    ];
    for (name, at) in [("manufacturer", 14), ("product", 15), ("serial", 16)] {
        let string = usize::from(byte(at))
            .checked_sub(1)
            .and_then(|index| descriptors.strings.get(index));
        if let Some(string) = string {
            all.push((name, format!("{string}\n").into()));
        }
    }
    all
}

/// Returns the attributes of the hub that the device is at: without one there is no USB once the device has gone.
fn root_hub() -> Vec<(&'static str, Vec<u8>)> {
    const DEVICE: [u8; 18] = [
        0x12, 1, 0, 2, 9, 0, 1, 0x40, 0x6B, 0x1D, 2, 0, 0, 6, 0, 0, 0, 1,
    ];
    const CONFIGURATION: [u8; 25] = [
        9, 2, 0x19, 0, 1, 1, 0, 0xE0, 0, 9, 4, 0, 0, 1, 9, 0, 0, 0, 7, 5, 0x81, 3, 4, 0, 0x0C,
    ];
    vec![
        ("speed", "480\n".into()),
        ("idVendor", "1d6b\n".into()),
        ("idProduct", "0002\n".into()),
        ("descriptors", [&DEVICE[..], &CONFIGURATION].concat()),
    ]
}
