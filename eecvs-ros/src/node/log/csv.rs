//! A table as CSV: a line of column names, then a line per row; missing values are empty.

use std::fs::File;

use anyhow::{Context as _, Result};

use super::file::TableFile;
use super::table::{Cell, Rows, Table};

/// A CSV file being written.
pub struct CsvFile {
    name: String,
    writer: csv::Writer<File>,
}

impl CsvFile {
    /// Starts the file with the names of the table's columns.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(file: File, name: String, table: &Table) -> Result<Self> {
        let mut writer = csv::WriterBuilder::new()
            .buffer_capacity(1 << 16)
            .from_writer(file);
        let columns = table.shared.iter().chain(table.own);
        writer
            .write_record(columns.map(|(name, _)| name))
            .map_err(anyhow::Error::from)
            .and_then(|()| Ok(writer.flush()?))
            .with_context(|| format!("{name}: cannot be written"))?;
        Ok(Self { name, writer })
    }
}

impl TableFile for CsvFile {
    fn put(&mut self, _: usize, rows: &Rows<'_>) -> Result<()> {
        let mut row: Vec<Cell> = rows.shared.clone();
        let put = rows.each(&mut |own| {
            row.truncate(rows.shared.len());
            row.extend_from_slice(own);
            Ok(self.writer.serialize(&row)?)
        });
        // Flush, so that a reader of the file finds only whole windows.
        put.and_then(|()| Ok(self.writer.flush()?))
            .with_context(|| format!("{}: cannot be written", self.name))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let Self { name, mut writer } = *self;
        writer
            .flush()
            .with_context(|| format!("{name}: cannot be written"))
    }
}
