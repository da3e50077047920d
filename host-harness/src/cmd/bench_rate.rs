//! `eecvs bench --rate`: rate against distortion of the codec and its peers.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use eecvs_bench::record_file;
use eecvs_bench::source::{self, Source};
use eecvs_cli::output::{print, print_json};
use eecvs_cli::progress::Progress;

use crate::rate::{Effort, Row, lossless, measure};
use crate::recordings;
use crate::report::{rate_chart, rate_table};

/// What is asked of it.
pub struct Rate<'o> {
    /// Recordings and folders of them; none: those of `default_folder`, or scenes.
    pub data: &'o [PathBuf],
    /// Looked into where no data is given.
    pub default_folder: &'o Path,
    /// Folder of the chart.
    pub output: &'o Path,
    /// Less of everything.
    pub quick: bool,
    /// Rows in place of the table.
    pub json: bool,
    /// Documents with the marks, which were checked.
    pub save: &'o [PathBuf],
    /// Folder of records, where one is asked for.
    pub record: Option<&'o Path>,
}

impl Rate<'_> {
    /// Measures, draws and prints.
    ///
    /// # Errors
    /// A recording that cannot be read, a codec that does not give back what it promises, a folder
    /// that cannot be written, `save` without every peer.
    pub fn run(&self) -> Result<()> {
        let place = self.save.first().map(PathBuf::as_path).or(self.record);
        if let (Some(document), Some(missing)) = (place, lossless::missing()) {
            anyhow::bail!("{}: its table has {missing}", document.display());
        }
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort::FULL
        };
        let rows = self.rows(effort)?;
        fs::create_dir_all(self.output)
            .with_context(|| format!("{}: cannot create the folder", self.output.display()))?;
        let files = self.chart(&rows)?;
        for document in self.save {
            let (marks, table) = rate_table::of(document);
            let table = table(&rows);
            let table = table.context("a row of the table was not measured: please report this")?;
            marks.write(document, &table)?;
        }
        if let Some(folder) = self.record {
            record_file::write(folder, "rates", &rows)?;
        }
        if let Some(missing) = lossless::missing() {
            eprintln!("eecvs: {missing}");
        }
        if self.json {
            return print_json(&rows);
        }
        print(&format!(
            "{}chart: {}\n",
            rate_table::table(&rows),
            files.map(|file| file.display().to_string()).join(", ")
        ))
    }

    /// One recording after the other: only one is in memory.
    fn rows(&self, effort: Effort) -> Result<Vec<Row>> {
        let files = self.files()?;
        let recordings = if files.is_empty() { 3 } else { files.len() };
        let progress = Progress::new(&format!("of {} points", recordings * effort.rows()));
        let mut rows = Vec::new();
        let mut add = |source: &Source| -> Result<()> {
            rows.extend(measure(source, effort, &mut || progress.advance(1))?);
            Ok(())
        };
        if files.is_empty() {
            for source in source::scenes(effort.scene_us)? {
                add(&source)?;
            }
        }
        for (name, path) in &files {
            add(&recordings::recording(name, path)?)?;
        }
        Ok(rows)
    }

    /// The recordings; none for scenes.
    fn files(&self) -> Result<Vec<(String, PathBuf)>> {
        if self.data.is_empty() {
            let folder = self.default_folder;
            if !folder.is_dir() {
                return Ok(Vec::new());
            }
            return distinct(&[folder.to_owned()]);
        }
        for path in self.data {
            let name = path.display();
            ensure!(path.exists(), "{name}: no such recording or folder");
        }
        let files = distinct(self.data)?;
        ensure!(
            !files.is_empty(),
            "{}: no recording in it; leave --data out to take emulated scenes",
            self.data[0].display()
        );
        Ok(files)
    }

    fn chart(&self, rows: &[Row]) -> Result<[PathBuf; 2]> {
        let title = "Rate against distortion, windows of 32,768 us: events, coefficients, peers";
        let files = ["rate.svg", "rate.png"].map(|file| self.output.join(file));
        let [svg, png] = &files;
        super::bench::write(svg, &rate_chart::svg(title, rows)?)?;
        rate_chart::picture(title, rows)?.save(png)?;
        Ok(files)
    }
}

/// Names and files of the recordings of some paths; what is left out is said.
fn distinct(paths: &[PathBuf]) -> Result<Vec<(String, PathBuf)>> {
    let progress = Progress::new("recordings read");
    let found = recordings::read(paths, &|read| progress.set(read as u64), &mut |_| ())?;
    drop(progress);
    if let Some(notice) = recordings::notice(&found.left_out) {
        eprintln!("eecvs: {notice}");
    }
    let taken = found.taken.into_iter();
    Ok(taken.map(|taken| (taken.name, taken.path)).collect())
}
