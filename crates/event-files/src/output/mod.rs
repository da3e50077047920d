//! Output files of commands: checked before the work begins, complete or absent, and never written over an input.

pub(crate) mod collected;
mod ending;
mod file;
mod part;
mod same;
pub(crate) mod sequential;
mod sync;
pub mod temporary;
pub(crate) mod workers;

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Result};
use event_types::{bail, ensure, error};

pub use ending::Kind;
pub use file::{OutputFile, write, write_private};
use part::{PRIVATE, Part, READABLE};
pub use part::{final_path, remove_parts};
pub use same::{is_one_output, is_same};
pub use sync::{sync, sync_folder};

/// Prefix of the names of files that are still filled by a live source, or that end at damage in their input.
const INCOMPLETE: &str = "incomplete-";

/// Largest number of links followed from a name to its file.
const LINKS_MAX: usize = 40;

/// Checks an output before any work is done.
///
/// # Errors
/// The ending is that of another kind of file; the output is one of the command's inputs; a file of this name
/// exists and `overwrite` is not set; its folder does not exist. The message names the output and what to do.
pub fn check(path: &Path, kind: Kind, overwrite: bool, inputs: &[&Path]) -> Result<()> {
    let name = path.display();
    for input in inputs {
        ensure!(
            !is_same(input, path),
            Refused,
            "{name}: input and output are the same file ({} is read): give the output another name",
            input.display()
        );
    }
    // Stdout has no ending.
    if is_stdout(path) {
        return Ok(());
    }
    kind.check(path)?;
    if is_direct(path) {
        return Ok(());
    }
    ensure!(
        !path.is_dir(),
        Refused,
        "{name}: is a folder: give the name of a file"
    );
    ensure!(
        overwrite || !path.exists(),
        Refused,
        "{name}: already exists: choose another name or use --overwrite"
    );
    let target = target(path)?;
    let folder = folder(&target);
    ensure!(
        folder.is_dir(),
        Refused,
        "{name}: cannot be created: there is no folder {}",
        folder.display()
    );
    Ok(())
}

/// A file that is being written, under another name until [`Output::keep`].
#[derive(Debug)]
pub struct Output {
    name: PathBuf,
    place: Place,
}

#[derive(Debug)]
enum Place {
    /// A device or a pipe.
    Direct,
    /// A temporary file, removed when dropped, and the name that it will get.
    Part(Part, PathBuf),
    /// A file that stays in any case, and the name that it will get.
    Live(PathBuf, PathBuf),
}

impl Output {
    /// Begins a file that becomes `path` when it is complete and is removed otherwise. A device or a pipe is
    /// written directly; if `path` is a link, its target is replaced.
    ///
    /// # Errors
    /// The file cannot be created; the message names it.
    pub fn begin(path: &Path) -> Result<Self> {
        let place = match is_direct(path) {
            true => Place::Direct,
            false => {
                let target = target(path)?;
                let part = Part::create(&target, READABLE)
                    .and_then(|part| like(&target, part.path()).map(|()| part))
                    .with_context(|| format!("{}: cannot be created", path.display()))?;
                Place::Part(part, target)
            }
        };
        Ok(Self {
            name: path.to_owned(),
            place,
        })
    }

    /// Begins a file that only its owner may read, also before it is complete; otherwise like [`Output::begin`].
    ///
    /// # Errors
    /// The file cannot be created; the message names it.
    pub fn begin_private(path: &Path) -> Result<Self> {
        let target = target(path)?;
        let part = Part::create(&target, PRIVATE)
            .with_context(|| format!("{}: cannot be created", path.display()))?;
        Ok(Self {
            name: path.to_owned(),
            place: Place::Part(part, target),
        })
    }

    /// Begins a file that a live source fills: unless it is completed, what has arrived stays in `incomplete-NAME`
    /// beside it. A file that an earlier source left under that name is an error unless `overwrite` is set.
    ///
    /// # Errors
    /// The file cannot be created; the message names it.
    pub fn begin_live(path: &Path, overwrite: bool) -> Result<Self> {
        if is_direct(path) {
            return Self::begin(path);
        }
        let target = target(path)?;
        let part = incomplete(&target);
        let mut options = std::fs::OpenOptions::new();
        options.write(true);
        let options = match overwrite {
            true => options.create(true).truncate(true),
            false => options.create_new(true),
        };
        options.open(&part).map_err(|error| {
            let part = part.display();
            match error.kind() {
                ErrorKind::AlreadyExists => error!(
                    Refused,
                    "{part}: was left by an interrupted capture: move it away or use --overwrite"
                ),
                _ => event_types::stream::Error::other(error)
                    .context(format!("{part}: cannot be created")),
            }
        })?;
        Ok(Self {
            name: path.to_owned(),
            place: Place::Live(part, target),
        })
    }

    /// Returns the path to write to.
    #[must_use]
    pub fn path(&self) -> &Path {
        match &self.place {
            Place::Direct if is_dash(&self.name) => Path::new("/dev/stdout"),
            Place::Direct => &self.name,
            Place::Part(part, _) => part.path(),
            Place::Live(part, _) => part,
        }
    }

    /// Opens the file to write to.
    ///
    /// # Errors
    /// The file cannot be created; the message names it.
    pub fn file(&self) -> Result<File> {
        create_bytes(self.path())
            .with_context(|| format!("{}: cannot be created", self.name.display()))
    }

    /// Returns whether the output is a device or a pipe, so that written bytes cannot be taken back.
    #[must_use]
    pub const fn is_direct(&self) -> bool {
        matches!(self.place, Place::Direct)
    }

    /// Returns the name that the file will have.
    #[must_use]
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// Returns whether nothing has been written to the file so far; of a device or a pipe that is not known.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        let is_empty = || std::fs::metadata(self.path()).is_ok_and(|file| file.len() == 0);
        !self.is_direct() && is_empty()
    }

    /// Ends a file that is not complete. A live file stays, unless it is empty, and its name is returned; any other
    /// is removed.
    #[must_use]
    pub fn leave(self) -> Option<PathBuf> {
        let Place::Live(part, _) = self.place else {
            return None;
        };
        let is_empty = std::fs::metadata(&part).is_ok_and(|metadata| metadata.len() == 0);
        if is_empty && std::fs::remove_file(&part).is_ok() {
            return None;
        }
        Some(part)
    }

    /// Ends a file that holds everything before damage in its input. It gets its name if no file has it, and is
    /// `incomplete-NAME` beside it otherwise. Returns the name.
    ///
    /// # Errors
    /// The file cannot be renamed; the message names it.
    pub fn keep_incomplete(mut self) -> Result<PathBuf> {
        if let Place::Part(_, target) | Place::Live(_, target) = &mut self.place
            && target.exists()
        {
            *target = incomplete(target);
            self.name = incomplete(&self.name);
        }
        let name = self.name.clone();
        self.keep().map(|()| name)
    }

    /// Gives the complete file its name and replaces an existing file. The file is on the disk before it has the name,
    /// and the name is on the disk when this returns, so after a power cut there is the old file or the new one.
    ///
    /// # Errors
    /// The file cannot be written to the disk or renamed; the message names it.
    pub fn keep(self) -> Result<()> {
        let name = self.name.clone();
        let sync_failed = || format!("{}: cannot be written to the disk", name.display());
        if !self.is_direct() {
            sync(self.path()).with_context(sync_failed)?;
        }
        match self.keep_unsynced()? {
            Some(target) => sync_folder(folder(&target)).with_context(sync_failed),
            None => Ok(()),
        }
    }

    /// Gives the complete file its name without waiting for the disk: for the many files of a run that can be made
    /// again. Returns the file, unless it is a device or a pipe.
    ///
    /// # Errors
    /// The file cannot be renamed; the message names it.
    pub fn keep_unsynced(self) -> Result<Option<PathBuf>> {
        let (renamed, target) = match self.place {
            Place::Direct => return Ok(None),
            Place::Part(part, target) => (part.persist(&target), target),
            Place::Live(part, target) => (
                like(&target, &part).and_then(|()| std::fs::rename(part, &target)),
                target,
            ),
        };
        renamed.with_context(|| format!("{}: cannot be replaced", self.name.display()))?;
        Ok(Some(target))
    }
}

/// Removes a file that was only begun, since a partial file must not pass for a whole one.
///
/// Only regular files are removed: a device, a pipe or a link stays.
pub fn remove_partial(path: &Path) {
    if std::fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        // The caller reports the error that led here.
        let _ = std::fs::remove_file(path);
    }
}

/// Returns the name under which an incomplete file `name` is kept.
fn incomplete(name: &Path) -> PathBuf {
    let mut incomplete = std::ffi::OsString::from(INCOMPLETE);
    incomplete.push(name.file_name().unwrap_or_default());
    name.with_file_name(incomplete)
}

/// Gives `part` the permissions of `target`, if that exists.
fn like(target: &Path, part: &Path) -> std::io::Result<()> {
    match std::fs::metadata(target) {
        Ok(metadata) => std::fs::set_permissions(part, metadata.permissions()),
        Err(_) => Ok(()),
    }
}

fn folder(target: &Path) -> &Path {
    let folder = target.parent();
    let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// Follows links to the file, which need not exist.
fn target(path: &Path) -> Result<PathBuf> {
    let mut target = path.to_owned();
    for _ in 0..LINKS_MAX {
        let Ok(link) = std::fs::read_link(&target) else {
            return Ok(target);
        };
        target = folder(&target).join(link);
    }
    bail!(Refused, "{}: too many links", path.display())
}

/// Returns whether a name stands for stdin or stdout.
#[must_use]
pub fn is_dash(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// Returns whether bytes written to `path` go to stdout.
#[must_use]
pub fn is_stdout(path: &Path) -> bool {
    let names = ["-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"];
    names.iter().any(|name| path.as_os_str() == *name)
}

/// Opens a file for writing, truncated; stdout is appended to.
///
/// # Errors
/// The file cannot be created.
pub fn create_bytes(path: &Path) -> std::io::Result<File> {
    if is_stdout(path) {
        return stdout();
    }
    part::create_file(path)
}

#[cfg(unix)]
fn stdout() -> std::io::Result<File> {
    use std::os::fd::AsFd;
    Ok(File::from(std::io::stdout().as_fd().try_clone_to_owned()?))
}

#[cfg(windows)]
fn stdout() -> std::io::Result<File> {
    use std::os::windows::io::AsHandle;
    let stdout = std::io::stdout();
    Ok(File::from(stdout.as_handle().try_clone_to_owned()?))
}

/// Returns whether no file of its own can be created at `path`: a device, a pipe, or an open file of a process.
fn is_direct(path: &Path) -> bool {
    let is_special = || {
        let metadata = std::fs::metadata(path);
        metadata.is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
    };
    let is_descriptor = || {
        let folder = path.parent().and_then(|folder| folder.canonicalize().ok());
        folder.is_some_and(|folder| folder.starts_with("/proc") || folder.starts_with("/dev/fd"))
    };
    is_stdout(path) || path.as_os_str() == "/dev/stderr" || is_special() || is_descriptor()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_when_it_is_complete() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.eecvs");
        std::fs::write(&path, "old").unwrap();
        let output = Output::begin(&path).unwrap();
        assert_eq!(final_path(output.path()), path);
        std::fs::write(output.path(), "ne").unwrap();
        drop(output);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.eecvs"]);
        let output = Output::begin(&path).unwrap();
        std::fs::write(output.path(), "new").unwrap();
        output.keep().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.eecvs"]);
    }

    #[test]
    fn a_file_that_ends_at_a_damage_replaces_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.eecvs");
        let keep = || {
            let output = Output::begin(&path).unwrap();
            std::fs::write(output.path(), "half").unwrap();
            output.keep_incomplete().unwrap()
        };
        assert_eq!(keep(), path);
        assert_eq!(names(folder.path()), ["a.eecvs"]);
        std::fs::write(&path, "whole").unwrap();
        for _ in 0..2 {
            assert_eq!(keep(), folder.path().join("incomplete-a.eecvs"));
        }
        assert_eq!(names(folder.path()), ["a.eecvs", "incomplete-a.eecvs"]);
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
    }

    #[test]
    fn what_is_live_stays_with_a_mark() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.raw");
        drop(Output::begin_live(&path, false).unwrap());
        assert_eq!(names(folder.path()), ["incomplete-a.raw"]);
        let error = Output::begin_live(&path, false).unwrap_err();
        assert!(error.to_string().contains("--overwrite"), "{error}");
        let output = Output::begin_live(&path, true).unwrap();
        std::fs::write(output.path(), "events").unwrap();
        let part = output.leave().unwrap();
        assert!(part.ends_with("incomplete-a.raw"), "{part:?}");
        assert_eq!(names(folder.path()), ["incomplete-a.raw"]);
        let output = Output::begin_live(&path, true).unwrap();
        output.keep().unwrap();
        assert_eq!(names(folder.path()), ["a.raw"]);
        let output = Output::begin_live(&path, true).unwrap();
        assert_eq!(output.leave(), None);
        assert_eq!(names(folder.path()), ["a.raw"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_and_rights_stay() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file.raw"), folder.path().join("l.raw"));
        std::fs::write(&file, "old").unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o640)).unwrap();
        symlink("file.raw", &link).unwrap();
        let output = Output::begin(&link).unwrap();
        std::fs::write(output.path(), "new").unwrap();
        output.keep().unwrap();
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(std::fs::read(&file).unwrap(), b"new");
        let mode = std::fs::metadata(&file).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o640);
        let output = Output::begin(Path::new("/dev/null")).unwrap();
        assert_eq!(output.path(), Path::new("/dev/null"));
        output.keep().unwrap();
    }

    #[test]
    fn refused_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("in.raw"), "events").unwrap();
        std::fs::write(at("old.eecvs"), "frames").unwrap();
        std::fs::hard_link(at("in.raw"), at("hard.eecvs")).unwrap();
        let input = at("in.raw");
        for (name, kind, overwrite, reason) in [
            ("old.eecvs", Kind::Frames, false, "already exists"),
            ("out.raw", Kind::Frames, true, "another kind"),
            ("out.npy", Kind::Frames, true, "another kind"),
            ("out.svg", Kind::Frames, true, "another kind"),
            ("out.eecvs", Kind::Recording, true, "eecvs encode"),
            ("out.jpg", Kind::Recording, true, "no format"),
            ("out.raw", Kind::Volume, true, "another kind"),
            ("hard.eecvs", Kind::Frames, true, "same file"),
            ("./in.raw", Kind::Recording, true, "same file"),
            ("none/a.eecvs", Kind::Frames, true, "no folder"),
        ] {
            let error = check(&at(name), kind, overwrite, &[&input]).unwrap_err();
            assert!(format!("{error:#}").contains(reason), "{name}: {error:#}");
        }
        for (name, kind, overwrite) in [
            ("old.eecvs", Kind::Frames, true),
            ("new.eecvs", Kind::Frames, false),
            ("new", Kind::Frames, false),
            ("new.npz", Kind::Volume, false),
        ] {
            check(&at(name), kind, overwrite, &[&input]).unwrap();
        }
    }
}
