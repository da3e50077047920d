//! Tables in the project's documents that a command writes, between two marks:
//!
//! ```text
//! <!-- NAME: COMMAND writes what is below -->
//! | a table |
//! <!-- NAME end -->
//! ```

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use event_files::output;

/// The two lines around a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Marks {
    /// What it is a table of, different for every table.
    pub name: &'static str,
    /// The command that writes it.
    pub command: &'static str,
}

impl Marks {
    fn begin(&self) -> String {
        format!(
            "<!-- {}: {} writes what is below -->",
            self.name, self.command
        )
    }

    fn end(&self) -> String {
        format!("<!-- {} end -->", self.name)
    }

    /// What is between the marks, whole lines.
    ///
    /// # Errors
    /// A mark that is missing or there twice, marks in the wrong order, or another comment between
    /// them, which may be a mark of another table.
    pub fn content<'t>(&self, text: &'t str) -> Result<&'t str> {
        let range = self.range(text)?;
        Ok(text.get(range).unwrap_or_default())
    }

    /// `text` with `table` between the marks.
    ///
    /// # Errors
    /// As [`Self::content`].
    pub fn replace(&self, text: &str, table: &str) -> Result<String> {
        let range = self.range(text)?;
        let (before, after) = (text.get(..range.start), text.get(range.end..));
        let line_end = if table.is_empty() || table.ends_with('\n') {
            ""
        } else {
            "\n"
        };
        let parts = [before.unwrap_or_default(), table, line_end];
        Ok(parts.concat() + after.unwrap_or_default())
    }

    /// Whether [`Self::write`] finds its place in a file: to be asked before what takes long.
    ///
    /// # Errors
    /// A file that cannot be read, or as [`Self::content`]; the message names the file.
    pub fn check(&self, path: &Path) -> Result<()> {
        self.content(&read(path)?)
            .with_context(|| path.display().to_string())?;
        Ok(())
    }

    /// Writes `table` between the marks of a file.
    ///
    /// # Errors
    /// As [`Self::check`], or a file that cannot be written.
    pub fn write(&self, path: &Path, table: &str) -> Result<()> {
        let name = path.display();
        let text = self
            .replace(&read(path)?, table)
            .with_context(|| name.to_string())?;
        Ok(output::write(path, text)?)
    }

    /// Where the lines between the marks are.
    fn range(&self, text: &str) -> Result<Range<usize>> {
        let (begin, end) = (self.begin(), self.end());
        let (mut from, mut to) = (None, None);
        let mut at = 0;
        for (index, line) in text.split_inclusive('\n').enumerate() {
            let number = index + 1;
            let next = at + line.len();
            let content = line.trim();
            if content == begin {
                ensure!(from.is_none(), "line {number}: there is {begin} twice");
                from = Some(next);
            } else if content == end {
                ensure!(to.is_none(), "line {number}: there is {end} twice");
                ensure!(from.is_some(), "line {number}: {end} is before {begin}");
                to = Some(at);
            } else if from.is_some() && to.is_none() && content.starts_with("<!--") {
                bail!("line {number}: {content} is between {begin} and {end}");
            }
            at = next;
        }
        let place = "put it where the table belongs";
        let from = from.with_context(|| format!("there is no line {begin}: {place}"))?;
        let to = to.with_context(|| format!("there is no line {end}: {place}"))?;
        Ok(from..to)
    }
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))
}

/// Where a document of this repository is: of use in its tests and records alone.
#[must_use]
pub fn path_of_project(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(name)
}

/// A document of this repository, for tests.
///
/// # Panics
/// It cannot be read.
#[must_use]
pub fn of_project(name: &str) -> String {
    read(&path_of_project(name)).expect("a document of the project")
}

#[cfg(test)]
mod tests {
    use super::*;

    const MARKS: Marks = Marks {
        name: "a",
        command: "do a",
    };
    const OTHER: Marks = Marks {
        name: "b",
        command: "do b",
    };
    const A: &str = "<!-- a: do a writes what is below -->\n";
    const A_END: &str = "<!-- a end -->\n";
    const B: &str = "<!-- b: do b writes what is below -->\n";
    const B_END: &str = "<!-- b end -->\n";

    #[test]
    fn what_is_between_the_marks_is_replaced_and_nothing_else() {
        let text = [
            "one\n",
            B,
            "b\n",
            B_END,
            "two\n",
            A,
            "old\nold\n",
            A_END,
            "three",
        ]
        .concat();
        assert_eq!(MARKS.content(&text).unwrap(), "old\nold\n");
        assert_eq!(OTHER.content(&text).unwrap(), "b\n");
        let new = MARKS.replace(&text, "new\n").unwrap();
        let expected = [
            "one\n", B, "b\n", B_END, "two\n", A, "new\n", A_END, "three",
        ]
        .concat();
        assert_eq!(new, expected);
        // Again, with and without the end of a line, and with what was there.
        assert_eq!(MARKS.replace(&new, "new").unwrap(), expected);
        assert_eq!(MARKS.replace(&new, "old\nold").unwrap(), text);
        let empty = MARKS.replace(&text, "").unwrap();
        assert_eq!(MARKS.content(&empty).unwrap(), "");
        assert_eq!(MARKS.replace(&empty, "old\nold\n").unwrap(), text);
        // At the ends of the text.
        let text = [A, A_END].concat();
        assert_eq!(
            MARKS.replace(&text, "x").unwrap(),
            [A, "x\n", A_END].concat()
        );
    }

    #[test]
    fn lines_may_end_as_on_windows() {
        let text = [A, "old\n", A_END].concat().replace('\n', "\r\n");
        let new = MARKS.replace(&text, "new\r\n").unwrap();
        assert_eq!(new, text.replace("old", "new"));
    }

    #[test]
    fn marks_that_leave_a_doubt_are_refused() {
        for (parts, said) in [
            (&["text\n"][..], "no line <!-- a: do a"),
            (&[A, "old\n"], "no line <!-- a end -->"),
            (&["old\n", A_END], "line 2: <!-- a end --> is before"),
            (&[A_END, A], "line 1: <!-- a end --> is before"),
            (&[A, A, A_END], "line 2: there is <!-- a: do a"),
            (&[A, A_END, "x\n", A], "line 4: there is <!-- a: do a"),
            (&[A, A_END, A_END], "line 3: there is <!-- a end --> twice"),
            // One table inside of another, or half of it.
            (&[A, "x\n", B, "y\n", B_END, A_END], "line 3: <!-- b: do b"),
            (&[B, A, B_END, A_END], "line 3: <!-- b end --> is between"),
            // Not a line of its own.
            (&["x ", A, A_END], "line 2: <!-- a end --> is before"),
            // A mark that names another command, as an older one did.
            (&["<!-- a: from a -->\n", A_END], "line 2: <!-- a end -->"),
        ] {
            let text = parts.concat();
            let error = MARKS.replace(&text, "new\n").unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
            assert_eq!(MARKS.content(&text).unwrap_err().to_string(), error);
        }
    }

    #[test]
    fn a_file_is_named_and_left_alone_on_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.md");
        let said = |result: Result<()>| format!("{:#}", result.unwrap_err());
        assert!(said(MARKS.check(&path)).contains("page.md: cannot be read"));
        std::fs::write(&path, A).unwrap();
        for error in [said(MARKS.check(&path)), said(MARKS.write(&path, "x"))] {
            assert!(error.contains("page.md: there is no line"), "{error}");
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap(), A);
        std::fs::write(&path, [A, A_END].concat()).unwrap();
        MARKS.check(&path).unwrap();
        MARKS.write(&path, "x").unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, [A, "x\n", A_END].concat());
    }
}
