//! A sensor's claim to its folder: the frames in it are sent under one name, by one process at a time.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read as _, Seek as _, Write as _};
use std::path::Path;

use anyhow::{Context as _, Result, bail};

use crate::key::Name;

/// Name of the file that is locked while a sensor uses the folder; it has the sensor's name.
const FILE: &str = "sensor";

/// A claim, which lasts until it is dropped.
#[derive(Debug)]
pub struct Claim {
    _file: File,
}

impl Claim {
    /// Claims a folder for a sensor, and creates the folder if needed.
    ///
    /// # Errors
    /// The folder is another sensor's, or a process uses it at this moment, or it cannot be written.
    pub fn new(folder: &Path, name: &Name) -> Result<Self> {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let path = folder.join(FILE);
        let at = || path.display().to_string();
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(&path).with_context(at)?;
        lock(&file, &path)?;
        let mut text = String::new();
        let read = (&file).take(1024).read_to_string(&mut text);
        read.with_context(at)?;
        // A line without its end was cut short, by a full disk say, before a frame was in the folder.
        let owner = if text.ends_with('\n') {
            text.trim()
        } else {
            ""
        };
        match owner {
            "" => {
                file.set_len(0).with_context(at)?;
                file.rewind().with_context(at)?;
                file.write_all(format!("{name}\n").as_bytes())
                    .with_context(at)?;
                // The frames are synced too: after a power cut they must not be anybody's.
                file.sync_all().with_context(at)?;
            }
            owner if owner == name.as_str() => {}
            owner => bail!(
                "{}: it holds the frames of the sensor {owner}: give {name} a folder of its own",
                folder.display()
            ),
        }
        Ok(Self { _file: file })
    }
}

/// Locks a file for this process alone, where the file system can; the lock ends when the file is closed.
///
/// # Errors
/// Another process has locked it.
pub(crate) fn lock(file: &File, path: &Path) -> Result<()> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => Ok(()),
        Err(TryLockError::Error(error)) => Err(error).with_context(|| path.display().to_string()),
        Err(TryLockError::WouldBlock) => bail!(
            "{}: another process uses it: end that process, or give another folder",
            path.display()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_of_one_sensor_and_one_process() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("kept");
        let [door, gate]: [Name; 2] = ["hall/door", "gate"].map(|name| name.parse().unwrap());
        let first = Claim::new(&folder, &door).unwrap();
        let said = Claim::new(&folder, &door).unwrap_err().to_string();
        assert!(said.contains("another process uses it"), "{said}");
        drop(first);
        let said = Claim::new(&folder, &gate).unwrap_err().to_string();
        assert!(
            said.contains("the frames of the sensor hall/door"),
            "{said}"
        );
        assert!(Claim::new(&folder, &door).is_ok());
        fs::write(folder.join(FILE), [0xff, 0xfe]).unwrap();
        assert!(Claim::new(&folder, &door).is_err());
    }
}
