//! `eecvs bench --rate`: rate against distortion of the codec and its peers.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use eecvs_bench::record_file;
use eecvs_bench::source::{self, Source};
use eecvs_cli::folder::RunFolder;
use eecvs_cli::output::{print, print_json, say_lines};
use eecvs_cli::progress::Progress;
use eecvs_cli::say;

use crate::rate::{Effort, Row, lossless, measure};
use crate::recordings;
use crate::report::{rate_chart, rate_table, speed_chart};

/// Files of the charts.
pub const CHARTS: [&str; 4] = ["rate.svg", "rate.png", "speed.svg", "speed.png"];

/// Arguments of `eecvs bench --rate`.
pub struct Rate<'o> {
    /// Recordings and folders of them. If empty: the recordings of `default_folder`, or else emulated scenes.
    pub data: &'o [PathBuf],
    /// Folder searched when `data` is empty.
    pub default_folder: &'o Path,
    /// Folder to write the chart to, which was checked.
    pub folder: RunFolder,
    /// Whether to measure less of everything.
    pub quick: bool,
    /// Whether to print the rows as JSON instead of the table.
    pub json: bool,
    /// Documents to write the table into; their marks have been checked already.
    pub save: &'o [PathBuf],
    /// Folder to write the record to, if any.
    pub record: Option<&'o Path>,
}

impl Rate<'_> {
    /// Measures, draws the charts, and prints and saves the results.
    ///
    /// # Errors
    /// Fails if a recording cannot be read, a codec breaks its promise, or a folder cannot be written; also if a
    /// table or a record is to be saved by a build that lacks some of the peers.
    pub fn run(&self) -> Result<()> {
        let place = self.save.first().map(PathBuf::as_path).or(self.record);
        if let (Some(document), Some(missing)) = (place, lossless::missing()) {
            anyhow::bail!("{}: its table would have {missing}", document.display());
        }
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort::FULL
        };
        let rows = self.rows(effort)?;
        self.folder.begin()?;
        let files = self.charts(&rows)?;
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
            say!("eecvs: {missing}");
        }
        if self.json {
            return print_json(&rows);
        }
        print(&format!(
            "{}charts: {}\n",
            rate_table::table(&rows),
            files.map(|file| file.display().to_string()).join(", ")
        ))
    }

    /// Measures one recording after the other, so that only one is in memory.
    fn rows(&self, effort: Effort) -> Result<Vec<Row>> {
        let files = files(self.data, self.default_folder)?;
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

    fn charts(&self, rows: &[Row]) -> Result<[PathBuf; 4]> {
        let files = CHARTS.map(|file| self.folder.path().join(file));
        let [svg, png, speed_svg, speed_png] = &files;
        let title = "Rate against distortion, windows of 32,768 us: events, coefficients, peers";
        super::bench::write(svg, &rate_chart::svg(title, rows)?)?;
        rate_chart::picture(title, rows)?.save(png)?;
        let title = "Bits against speed on one thread, lossless, windows of 32,768 us: ours blue, peers brown";
        let speed = speed_chart::sheet(title, rows)?;
        super::bench::write(speed_svg, &speed.svg)?;
        speed.png.save(speed_png)?;
        Ok(files)
    }
}

/// Returns names and files of the recordings in `data`, or of those in `default_folder` if `data` is empty; none if
/// that is no folder.
///
/// # Errors
/// Fails if a path of `data` does not exist or cannot be read, or if none holds a recording.
pub fn files(data: &[PathBuf], default_folder: &Path) -> Result<Vec<(String, PathBuf)>> {
    let Some(first) = data.first() else {
        if !default_folder.is_dir() {
            return Ok(Vec::new());
        }
        return distinct(&[default_folder.to_owned()]);
    };
    for path in data {
        let name = path.display();
        ensure!(path.exists(), "{name}: no such recording or folder");
    }
    let files = distinct(data)?;
    ensure!(
        !files.is_empty(),
        "{}: holds no recording: name others, or leave out --data",
        first.display()
    );
    Ok(files)
}

/// Returns names and files of the distinct recordings in `paths`; reports on stderr what was left out.
fn distinct(paths: &[PathBuf]) -> Result<Vec<(String, PathBuf)>> {
    let progress = Progress::new("recordings read");
    let found = recordings::read(paths, &|read| progress.set(read as u64), &mut |_| ())?;
    drop(progress);
    if let Some(notice) = recordings::notice(&found.left_out) {
        say_lines(&format!("eecvs: {notice}"));
    }
    let taken = found.taken.into_iter();
    Ok(taken.map(|taken| (taken.name, taken.path)).collect())
}
