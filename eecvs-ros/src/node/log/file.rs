//! The files that tables are written to: what they are called, and that none is written over.

use std::fs::File;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use event_files::output::remove_partial;

use super::csv::CsvFile;
use super::mcap::McapFile;
use super::parquet::ParquetFile;
use super::table::{Rows, Table};

/// A file of one table or several.
pub trait TableFile {
    /// Takes the rows that a window has in table number `table` of this file.
    ///
    /// # Errors
    /// I/O; the message names the file.
    fn put(&mut self, table: usize, rows: &Rows<'_>) -> Result<()>;

    /// Writes what ends the file.
    ///
    /// # Errors
    /// I/O; the message names the file.
    fn finish(self: Box<Self>) -> Result<()>;
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Csv,
    Parquet,
    Mcap,
}

/// A file that is to be written, of a kind that its ending names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogFile {
    path: PathBuf,
    kind: Kind,
}

impl LogFile {
    /// Looks at the ending.
    ///
    /// # Errors
    /// Which endings there are.
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

    /// Its name.
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Creates the file, which must not be there.
    fn create(&self, tables: &[(Table, String)]) -> Result<Box<dyn TableFile>> {
        let name = self.name();
        let table = match (self.kind, tables) {
            (Kind::Csv | Kind::Parquet, [(table, _)]) => table,
            (Kind::Mcap, [(table, _), ..]) => table,
            _ => bail!("{name}: both tables have one file: give two names, or one of .mcap"),
        };
        let file = File::create_new(&self.path)
            .with_context(|| format!("{name}: cannot be created; no file is written over"))?;
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
    /// For each table, its file and its number there.
    places: Vec<Option<(usize, usize)>>,
}

impl Files {
    /// Creates the files of tables, each of which has a topic and may have none; tables of one name share it.
    ///
    /// # Errors
    /// A file that is there, or that cannot be created: then there is none.
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

    /// Takes the rows that a window has in table number `table`, where that has a file.
    ///
    /// # Errors
    /// I/O; the message names the file.
    pub fn put(&mut self, table: usize, rows: &Rows<'_>) -> Result<()> {
        let Some((file, number)) = self.places.get(table).copied().flatten() else {
            return Ok(());
        };
        self.files
            .get_mut(file)
            .context("a file")?
            .put(number, rows)
    }

    /// Writes what ends each file.
    ///
    /// # Errors
    /// The first that fails; the others are ended all the same.
    pub fn finish(self) -> Result<()> {
        let ends: Vec<Result<()>> = self.files.into_iter().map(TableFile::finish).collect();
        ends.into_iter().collect()
    }
}
