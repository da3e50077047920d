//! Folders that commands fill with the files of one run: never with files of two.
//!
//! Each file is written whole or not at all. Where a page shows the others, it is the first to be removed and the last
//! to be written: a folder without its page is not finished.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use event_files::output::is_same;

/// A folder for the files of one run.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
    is_own: fn(&str) -> bool,
    page: Option<&'static str>,
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
            page: None,
        })
    }

    /// Names the page that shows the other files.
    #[must_use]
    pub fn with_page(mut self, page: &'static str) -> Self {
        self.page = Some(page);
        self
    }

    /// Refuses a folder in which one of the command's inputs would be replaced or removed, under whatever name the
    /// command reads it.
    ///
    /// # Errors
    /// Fails if a file of the folder that has a name of the command's own is an input, or if the folder cannot be
    /// listed.
    pub fn refuse_inputs<'p>(&self, inputs: impl IntoIterator<Item = &'p Path>) -> Result<()> {
        let own = match self.path.is_dir() {
            true => self.own()?,
            false => Vec::new(),
        };
        for input in inputs {
            if let Some(file) = own.iter().find(|file| is_same(input, file)) {
                bail!(
                    "{}: input and output are the same file ({} is read): choose another folder",
                    file.display(),
                    input.display()
                );
            }
        }
        Ok(())
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
        self.remove_page()?;
        self.keep(&[])
    }

    /// Removes the page of an earlier run, before the files that it shows are replaced.
    ///
    /// # Errors
    /// Fails if it cannot be removed.
    pub fn remove_page(&self) -> Result<()> {
        let Some(page) = self.page else {
            return Ok(());
        };
        let page = self.path.join(page);
        match fs::remove_file(&page) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{}: cannot be removed", page.display()))
            }
            _ => Ok(()),
        }
    }

    /// Removes the files of an earlier run, except those of the names in `keep`.
    ///
    /// # Errors
    /// Fails if the folder cannot be listed or a file cannot be removed.
    pub fn keep(&self, keep: &[String]) -> Result<()> {
        for path in self.own()? {
            let is_kept = keep.iter().any(|kept| path.ends_with(kept));
            if !is_kept {
                fs::remove_file(&path)
                    .with_context(|| format!("{}: cannot be removed", path.display()))?;
            }
        }
        Ok(())
    }

    /// Returns the files of the folder that have names of the command's own.
    fn own(&self) -> Result<Vec<PathBuf>> {
        let context = || format!("{}: cannot be listed", self.path.display());
        let mut own = Vec::new();
        for entry in fs::read_dir(&self.path).with_context(context)? {
            let entry = entry.with_context(context)?;
            let is_own = entry.file_name().to_str().is_some_and(self.is_own);
            if is_own && !entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                own.push(entry.path());
            }
        }
        Ok(own)
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

    #[test]
    fn an_input_is_never_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("run")).unwrap();
        fs::write(at("run/own.1"), "1").unwrap();
        fs::write(at("run/other"), "2").unwrap();
        fs::hard_link(at("run/own.1"), at("linked")).unwrap();
        let run = RunFolder::check(&at("run"), true, |name| name.starts_with("own")).unwrap();
        run.refuse_inputs([at("run/other").as_path(), &at("none")])
            .unwrap();
        for name in ["linked", "run/own.1", "run/../linked"] {
            let error = run.refuse_inputs([at(name).as_path()]).unwrap_err();
            assert!(error.to_string().contains("same file"), "{error}");
        }
    }

    #[test]
    fn a_page_goes_before_what_it_shows() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("own.1"), "").unwrap();
        fs::write(at("own.html"), "").unwrap();
        let run = RunFolder::check(folder.path(), true, |name| name.starts_with("own"));
        let run = run.unwrap().with_page("own.html");
        run.remove_page().unwrap();
        assert_eq!(names(folder.path()), ["own.1"]);
        run.begin().unwrap();
        assert!(names(folder.path()).is_empty());
    }
}
