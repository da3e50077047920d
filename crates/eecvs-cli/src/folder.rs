//! Folders that commands fill with the files of one run: never with files of two.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// A folder for the files of one run.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
    is_own: fn(&str) -> bool,
}

impl RunFolder {
    /// Checks a folder before any work is done; `is_own` returns whether the command writes files of a name.
    ///
    /// # Errors
    /// Fails if `path` is not a folder, or holds any file while `overwrite` is not set. The message names the folder
    /// and what to do.
    pub fn check(path: &Path, overwrite: bool, is_own: fn(&str) -> bool) -> Result<Self> {
        let name = path.display();
        ensure!(
            !path.exists() || path.is_dir(),
            "{name}: is not a folder: name a folder"
        );
        let is_used = fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some());
        ensure!(
            overwrite || !is_used,
            "{name}: already has files: choose another folder or use --overwrite"
        );
        Ok(Self {
            path: path.to_owned(),
            is_own,
        })
    }

    /// Returns the folder's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the folder if it does not exist.
    ///
    /// # Errors
    /// Fails if the folder cannot be made.
    pub fn make(&self) -> Result<()> {
        let context = || format!("{}: cannot create the folder", self.path.display());
        fs::create_dir_all(&self.path).with_context(context)
    }

    /// Makes the folder, and removes the files of an earlier run from it; those of other names stay.
    ///
    /// # Errors
    /// Fails if the folder cannot be made or a file cannot be removed.
    pub fn begin(&self) -> Result<()> {
        self.make()?;
        self.keep(&[])
    }

    /// Removes the files of an earlier run, except those of the names in `keep`.
    ///
    /// # Errors
    /// Fails if the folder cannot be listed or a file cannot be removed.
    pub fn keep(&self, keep: &[String]) -> Result<()> {
        let context = || format!("{}: cannot be listed", self.path.display());
        for entry in fs::read_dir(&self.path).with_context(context)? {
            let entry = entry.with_context(context)?;
            let name = entry.file_name();
            let is_old = name
                .to_str()
                .is_some_and(|name| (self.is_own)(name) && !keep.iter().any(|kept| kept == name));
            if is_old && !entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                let path = entry.path();
                fs::remove_file(&path)
                    .with_context(|| format!("{}: cannot be removed", path.display()))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn files_of_two_runs_never_lie_in_one_folder() {
        let folder = tempfile::tempdir().unwrap();
        let is_own = |name: &str| name.starts_with("own");
        let at = |name: &str| folder.path().join("new").join(name);
        let check = |overwrite| RunFolder::check(&at(""), overwrite, is_own);
        // A folder that is not there, and one that is empty.
        check(false).unwrap().begin().unwrap();
        check(false).unwrap().begin().unwrap();
        for name in ["own.1", "own.2", "other"] {
            fs::write(at(name), "").unwrap();
        }
        fs::create_dir(at("own folder")).unwrap();
        let error = check(false).unwrap_err().to_string();
        assert!(
            error.contains("new") && error.contains("--overwrite"),
            "{error}"
        );
        assert_eq!(names(&at("")).len(), 4);
        check(true).unwrap().keep(&["own.2".to_owned()]).unwrap();
        assert_eq!(names(&at("")), ["other", "own folder", "own.2"]);
        check(true).unwrap().begin().unwrap();
        assert_eq!(names(&at("")), ["other", "own folder"]);
        let error = RunFolder::check(&at("other"), true, is_own).unwrap_err();
        assert!(error.to_string().contains("is not a folder"), "{error}");
    }
}
