//! The files that tables are written to: their formats by file name, and their creation without overwriting.

use std::fs::File;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use event_files::output::remove_partial;

use super::csv::CsvFile;
use super::mcap::McapFile;
use super::parquet::ParquetFile;
use super::table::{Rows, Table};

/// A file of one or several tables.
pub trait TableFile {
    /// Appends a window's rows to the table with index `table` in this file.
    ///
    /// # Errors
    /// Writing fails; the message names the file.
    fn put(&mut self, table: usize, rows: &Rows<'_>) -> Result<()>;

    /// Completes the file.
    ///
    /// # Errors
    /// Writing fails; the message names the file.
    fn finish(self: Box<Self>) -> Result<()>;
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Csv,
    Parquet,
    Mcap,
}

/// A file to be written, in the format that the extension of its name selects.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogFile {
    path: PathBuf,
    kind: Kind,
}

impl LogFile {
    /// Parses a file name; its extension selects the format.
    ///
    /// # Errors
    /// The extension is unknown; the message lists the known ones.
    pub fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
        let kind = match ending.to_str() {
            Some("csv") => Kind::Csv,
            Some("parquet") => Kind::Parquet,
            Some("mcap") => Kind::Mcap,
            _ => return Err("give a name that ends in .csv, .parquet or .mcap".to_owned()),
        };
        Ok(Self { path, kind })
    }

    /// Returns the file's path, for messages.
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Creates the file, which must not exist yet.
    fn create(&self, tables: &[(Table, String)]) -> Result<Box<dyn TableFile>> {
        let name = self.name();
        let table = match (self.kind, tables) {
            (Kind::Csv | Kind::Parquet, [(table, _)]) => table,
            (Kind::Mcap, [(table, _), ..]) => table,
            _ => bail!(
                "{name}: both tables would go to this file: give two names, or one that ends in .mcap"
            ),
        };
        let file = File::create_new(&self.path).with_context(|| {
            format!("{name}: cannot be created; existing files are not overwritten")
        })?;
        let begun = || -> Result<Box<dyn TableFile>> {
            Ok(match self.kind {
                Kind::Csv => Box::new(CsvFile::new(file, name, table)?),
                Kind::Parquet => Box::new(ParquetFile::new(file, name, table)?),
                Kind::Mcap => Box::new(McapFile::new(file, name, tables)?),
            })
        };
        begun().inspect_err(|_| remove_partial(&self.path))
    }
}

/// The files of a log.
pub struct Files {
    files: Vec<Box<dyn TableFile>>,
    /// For each table, the index of its file and its index in that file.
    places: Vec<Option<(usize, usize)>>,
}

impl Files {
    /// Creates the files of the tables. Each table comes with its file, if it has one, and its topic; tables with
    /// the same file share it.
    ///
    /// # Errors
    /// A file exists or cannot be created; the files created before it are then removed.
    pub fn create(tables: &[(Option<&LogFile>, Table, String)]) -> Result<Self> {
        let mut files: Vec<(&LogFile, Vec<(Table, String)>)> = Vec::new();
        let mut places = Vec::new();
        for (file, table, topic) in tables {
            places.push(file.map(|file| {
                let known = files.iter().position(|(known, _)| *known == file);
                let place = known.unwrap_or(files.len());
                if known.is_none() {
                    files.push((file, Vec::new()));
                }
                let held = files.get_mut(place).map(|(_, tables)| {
                    tables.push((*table, topic.clone()));
                    tables.len() - 1
                });
                (place, held.unwrap_or_default())
            }));
        }
        let mut created = Vec::new();
        for (file, tables) in &files {
            match file.create(tables) {
                Ok(writer) => created.push(writer),
                Err(error) => {
                    drop(created);
                    let before = files.iter().take_while(|(known, _)| known != file);
                    before.for_each(|(file, _)| remove_partial(&file.path));
                    return Err(error);
                }
            }
        }
        Ok(Self {
            files: created,
            places,
        })
    }

    /// Appends a window's rows to the table with index `table`, if that table has a file.
    ///
    /// # Errors
    /// Writing fails; the message names the file.
    pub fn put(&mut self, table: usize, rows: &Rows<'_>) -> Result<()> {
        let Some((file, number)) = self.places.get(table).copied().flatten() else {
            return Ok(());
        };
        self.files
            .get_mut(file)
            .context("a file")?
            .put(number, rows)
    }

    /// Completes all files.
    ///
    /// # Errors
    /// The first error, after all files have been completed as far as possible.
    pub fn finish(self) -> Result<()> {
        let ends: Vec<Result<()>> = self.files.into_iter().map(TableFile::finish).collect();
        ends.into_iter().collect()
    }
}
