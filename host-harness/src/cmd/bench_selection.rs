//! `eecvs bench --selection` and `--few-as-times`: what a largest mean error costs against fixed settings, and what few
//! events as times save where the setting is fixed.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use eecvs_bench::record_file;
use eecvs_bench::source::Source;
use eecvs_cli::output::{print, print_json};
use eecvs_cli::progress::Progress;

use super::bench_rate;
use crate::recordings;
use crate::report::{few_table, selection_table};
use crate::selection::{Effort, few, input, measure};

/// Arguments of `eecvs bench --selection` and `--few-as-times`.
pub struct Selection<'o> {
    /// Recordings and folders of them. If empty: the recordings of `default_folder`, if there are any.
    pub data: &'o [PathBuf],
    /// Folder searched when `data` is empty.
    pub default_folder: &'o Path,
    /// Whether to measure less of everything.
    pub quick: bool,
    /// Whether to print the rows as JSON instead of the tables.
    pub json: bool,
    /// Documents to write the table into; their marks have been checked already.
    pub save: &'o [PathBuf],
    /// Folder to write the record to, if any.
    pub record: Option<&'o Path>,
}

impl Selection<'_> {
    /// Measures the nine emulated scenes and the recordings, and prints and saves the results.
    ///
    /// # Errors
    /// Fails if a recording cannot be read, a codec breaks its promise, or a file cannot be written.
    pub fn run(&self) -> Result<()> {
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort::FULL
        };
        let inputs = self.inputs(effort)?;
        let progress = Progress::new("settings");
        let rows = measure(&inputs, effort, &|| progress.advance(1));
        drop(progress);
        let rows = rows?;
        for document in self.save {
            let table = selection_table::document(&rows);
            let table = table.context("a row of the table was not measured: please report this")?;
            selection_table::MARKS.write(document, &table)?;
        }
        if let Some(folder) = self.record {
            record_file::write(folder, "selection", &rows)?;
        }
        if self.json {
            return print_json(&rows);
        }
        print(&selection_table::table(&rows))
    }

    /// Emulates the scenes and reads the recordings, cropped.
    fn inputs(&self, effort: Effort) -> Result<Vec<Source>> {
        let files = bench_rate::files(self.data, self.default_folder)?;
        let mut inputs = input::scenes(effort)?;
        for (name, path) in &files {
            let recording = recordings::recording(name, path)?;
            inputs.push(input::crop(recording, effort.events));
        }
        Ok(inputs)
    }

    /// Measures few events as times on whole scenes and recordings, and prints and saves the results.
    ///
    /// # Errors
    /// Fails if a recording cannot be read, an event is in no frame, or a file cannot be written.
    pub fn run_few(&self) -> Result<()> {
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort {
                events: usize::MAX,
                ..Effort::FULL
            }
        };
        let inputs = self.inputs(effort)?;
        let progress = Progress::new("files");
        let rows = few::measure(&inputs, &|| progress.advance(1));
        drop(progress);
        let rows = rows?;
        let table =
            few_table::document(&rows).context("nothing was measured: please report this")?;
        for document in self.save {
            few_table::MARKS.write(document, &table)?;
        }
        if let Some(folder) = self.record {
            record_file::write(folder, "few-as-times", &rows)?;
        }
        if self.json {
            return print_json(&rows);
        }
        print(&table)
    }
}
