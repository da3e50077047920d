//! A table as Parquet, in row groups of 131,072 rows. The file cannot be read without its footer, which
//! [`TableFile::finish`] writes.

use std::fs::File;

use anyhow::Result;
use event_files::parquet::table::{self, Cells, GROUP_ROWS, Kind, Values};

use super::file::TableFile;
use super::table::{Cell, Rows, Table};

/// A Parquet file being written, with the row group that is being filled.
pub struct ParquetFile {
    table: table::Table,
    columns: Vec<Filled>,
    rows: usize,
}

/// A column of the row group.
struct Filled {
    values: Owned,
    /// Whether each row has a value.
    present: Vec<bool>,
}

enum Owned {
    Whole(Vec<i64>),
    Floats(Vec<f64>),
    Texts(Vec<&'static str>),
}

impl ParquetFile {
    /// Starts a file of one table.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(file: File, name: String, table: &Table) -> Result<Self> {
        let columns = || table.shared.iter().chain(table.own);
        let schema: Vec<table::Column> = columns()
            .map(|(name, kind)| table::Column {
                name,
                kind: *kind,
                is_optional: true,
            })
            .collect();
        let columns = columns().map(|(_, kind)| Filled {
            values: match kind {
                Kind::Bool | Kind::U16 | Kind::I64 => Owned::Whole(Vec::new()),
                Kind::F64 => Owned::Floats(Vec::new()),
                Kind::Text => Owned::Texts(Vec::new()),
            },
            present: Vec::new(),
        });
        Ok(Self {
            columns: columns.collect(),
            table: table::Table::new(file, name, &schema)?,
            rows: 0,
        })
    }

    fn write_group(&mut self) -> Result<()> {
        let cells: Vec<Cells<'_>> = self
            .columns
            .iter()
            .map(|column| Cells {
                values: match &column.values {
                    Owned::Whole(values) => Values::Whole(values),
                    Owned::Floats(values) => Values::Floats(values),
                    Owned::Texts(values) => Values::Texts(values),
                },
                present: Some(&column.present),
            })
            .collect();
        self.table.group(self.rows, &cells)?;
        self.columns.iter_mut().for_each(Filled::clear);
        self.rows = 0;
        Ok(())
    }
}

impl Filled {
    fn clear(&mut self) {
        self.present.clear();
        match &mut self.values {
            Owned::Whole(values) => values.clear(),
            Owned::Floats(values) => values.clear(),
            Owned::Texts(values) => values.clear(),
        }
    }

    /// Appends a cell of the column's kind; any other cell counts as missing.
    fn push(&mut self, cell: Cell) {
        let is_there = match (&mut self.values, cell) {
            (Owned::Whole(values), Cell::Whole(number)) => {
                values.push(number);
                true
            }
            (Owned::Floats(values), Cell::Float(number)) => {
                values.push(number);
                true
            }
            (Owned::Texts(values), Cell::Text(text)) => {
                values.push(text);
                true
            }
            (_, cell) => {
                debug_assert!(cell == Cell::Missing, "{cell:?}");
                false
            }
        };
        self.present.push(is_there);
    }
}

impl TableFile for ParquetFile {
    fn put(&mut self, _: usize, rows: &Rows<'_>) -> Result<()> {
        rows.each(&mut |own| {
            let row = rows.shared.iter().chain(own);
            for (column, cell) in self.columns.iter_mut().zip(row) {
                column.push(*cell);
            }
            self.rows += 1;
            if self.rows == GROUP_ROWS {
                self.write_group()?;
            }
            Ok(())
        })
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.write_group()?;
        Ok(self.table.finish(&[])?)
    }
}
