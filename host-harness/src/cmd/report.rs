//! `eecvs report`: reproduces the paper's evaluation as a page with tables and pictures.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs_bench::marks::Marks;
use eecvs_cli::folder::RunFolder;
use eecvs_cli::output::{print, say_lines};
use eecvs_cli::progress::Progress;
use eecvs_cli::say;
use eecvs_nostd::Sensor;
use event_files::output;
use serde::Serialize;

use crate::downstream::segment::classical::Classical;
use crate::downstream::segment::{Frame, Segmenter, open_model};
use crate::recordings::{self, LeftOut};
use crate::report::study::figures::{self, Figure};
use crate::report::study::{page, tables};
use crate::study::effort::Effort;
use crate::study::record::Record;
use crate::study::set::Set;
use crate::study::store::{self, Earlier, Store};
use crate::study::{self, Results, kernels};

/// Folder searched for recordings when `--data` is not given.
const RECORDINGS: &str = "../shared/data";

/// Reproduce the paper's tables on emulated scenes and recordings, as a page with pictures
#[derive(Debug, Args)]
pub struct Report {
    /// Folder to write the results to: `report.html` and what it shows, as CSV, JSON, SVG and PNG. It must be empty, or
    /// hold an interrupted report of the same sources, which resumes from its `rows.jsonl`
    #[arg(short, long, value_name = "DIR", default_value = "eecvs-report")]
    output: PathBuf,

    /// Recordings, or folders of them, searched two levels deep; of files with the same events only one is used
    /// [default: ../shared/data if it exists, else none]
    #[arg(long, value_name = "PATH", num_args = 1..)]
    data: Vec<PathBuf>,

    /// Measure three windows of each emulated scene, and no recordings except those of --data
    #[arg(long)]
    quick: bool,

    /// Segment with this ONNX model instead of the built-in segmenter; docs/segmentation.md says which models fit.
    /// Needs a program built with --features onnx
    #[arg(long, value_name = "FILE")]
    segmenter: Option<PathBuf>,

    /// Remove the results of another report from the folder; other files stay
    #[arg(long)]
    overwrite: bool,

    /// Keep rows measured by another build of the program, e.g. to redraw the page
    #[arg(long)]
    keep_rows: bool,

    /// Also write the answer and a table into a document, docs/paper.md, between the lines that name this command
    #[arg(long, value_name = "FILE", conflicts_with = "quick")]
    save: Option<PathBuf>,
}

/// Markers of the lines in the document between which the results of the report go.
pub const MARKS: Marks = Marks {
    name: "report",
    command: "eecvs report --save docs/paper.md",
};

impl Report {
    /// Measures what has not been measured yet, and writes the page.
    ///
    /// # Errors
    /// Fails if a recording cannot be read, a folder holds other files or cannot be written, a model does not fit, or a codec breaks its
    /// promise.
    pub fn run(self) -> Result<()> {
        if let Some(document) = &self.save {
            MARKS.check(document)?;
        }
        let folder = &self.output;
        let path = folder.join(ROWS);
        // What rows there are of is known only when the sources have been read.
        let run = RunFolder::check(folder, self.overwrite || path.is_file(), is_own)?;
        let run = run.with_page(PAGE);
        let inputs = self.data.iter().chain(&self.segmenter).chain(&self.save);
        run.refuse_inputs(inputs.map(PathBuf::as_path))?;
        run.make()?;
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort::FULL
        };
        // Checks the model before the measurements, which take long.
        let segmenter = segmenter(self.segmenter.as_deref())?;
        let (sets, left_out) = self.sets(&effort)?;
        try_sensors(segmenter.as_ref(), &sets)?;
        let record = Record::new(&sets, &left_out, &effort, segmenter.name());
        self.check_rows(&run, &path, &record)?;
        let (store, known) = Store::open(&path, record, !self.keep_rows)?;
        if known > 0 {
            say!(
                "eecvs: going on after {known} measurements in {}",
                path.display()
            );
        }
        kernels::add_to(
            &store,
            if self.quick {
                eecvs_bench::Effort::QUICK
            } else {
                eecvs_bench::Effort::FULL
            },
        )?;
        let progress = Progress::bar("measurements");
        let show = |done: usize, total: usize| progress.set_of(done as u64, total as u64);
        study::run(&sets, &effort, segmenter.as_ref(), &store, &show)?;
        drop(progress);
        let results = store.results();
        let rows = &results.perception;
        let silent = rows.iter().filter(|row| row.mean_iou() == [None; 2]);
        let silent = silent.count();
        if silent > 0 {
            say!(
                "eecvs: segmenter {}: no IoU in {silent} of {} rows: its masks are all empty, all full or all the same",
                results.record.segmenter,
                rows.len()
            );
        }
        let figures = figures::all(&sets, &results)?;
        run.remove_page()?;
        let mut names = write(folder, &results, &figures)?;
        // Without the page.
        let files = names.len();
        names.push(PAGE.to_owned());
        run.keep(&names)?;
        if let Some(path) = &self.save {
            MARKS.write(path, &tables::document(&results))?;
        }
        let answers = results.answer();
        let answers: Vec<String> = answers.iter().map(page::text).collect();
        print(&format!(
            "{}\n\nsegmenter: {}\nreport: {}\n        and {files} files beside it\n",
            answers.join("\n\n"),
            results.record.segmenter,
            folder.join("report.html").display()
        ))
    }

    /// Makes room for the rows of this study. Its own earlier rows are resumed; those of another build or of another
    /// report are kept or removed only on request.
    fn check_rows(&self, run: &RunFolder, path: &Path, record: &Record) -> Result<()> {
        let (whose, remedy) = match store::earlier(path, record)? {
            Earlier::Nothing => return run.begin(),
            Earlier::Same => return Ok(()),
            Earlier::OtherBuild if self.keep_rows => return Ok(()),
            Earlier::OtherBuild => (
                "another build of the program",
                ", or keep them with --keep-rows",
            ),
            Earlier::Other => ("another report", ""),
        };
        ensure!(
            self.overwrite,
            "{}: holds the rows of {whose}: choose another folder or use --overwrite{remedy}",
            path.display()
        );
        run.begin()
    }

    /// Returns the sets of scenes and recordings, and the files that were left out.
    fn sets(&self, effort: &Effort) -> Result<(Vec<Set>, Vec<LeftOut>)> {
        let mut sets = vec![Set::scenes(effort)?];
        let default = PathBuf::from(RECORDINGS);
        let paths = if self.data.is_empty() && !self.quick && default.is_dir() {
            vec![default]
        } else {
            self.data.clone()
        };
        if paths.is_empty() {
            return Ok((sets, Vec::new()));
        }
        let progress = Progress::new("recordings read");
        let (set, left_out) = Set::recordings(&paths, effort, &|read| progress.set(read as u64))?;
        drop(progress);
        if let Some(notice) = recordings::notice(&left_out) {
            say_lines(&format!("eecvs: {notice}"));
        }
        if set.is_none() {
            let paths: Vec<String> = paths
                .iter()
                .map(|path| path.display().to_string())
                .collect();
            let none = format!(
                "{}: no recordings; docs/datasets.md says where to get some",
                paths.join(", ")
            );
            ensure!(self.data.is_empty(), none);
            say!("eecvs: {none}");
        }
        sets.extend(set);
        Ok((sets, left_out))
    }
}

/// Opens the ONNX model at `model`, or returns the built-in segmenter.
fn segmenter(model: Option<&Path>) -> Result<Box<dyn Segmenter>> {
    match model {
        Some(path) => open_model(path),
        None => Ok(Box::new(Classical)),
    }
}

/// Segments an empty frame of every sensor, since a model may not take every size.
fn try_sensors(segmenter: &dyn Segmenter, sets: &[Set]) -> Result<()> {
    let mut tried: Vec<Sensor> = Vec::new();
    for source in sets.iter().flat_map(|set| &set.sources) {
        if !tried.contains(&source.sensor) {
            tried.push(source.sensor);
            let empty = Frame::new(source.sensor, &[]);
            segmenter
                .segment(&empty)
                .with_context(|| format!("{}: a frame without events", source.name))?;
        }
    }
    Ok(())
}

/// Name of the page.
const PAGE: &str = "report.html";

/// Name of the store of rows.
const ROWS: &str = "rows.jsonl";

/// Names of the results and of the tables of rows.
const TABLES: [&str; 4] = ["results.json", "quality.csv", "speed.csv", "perception.csv"];

/// Returns whether a report writes files of this name.
fn is_own(name: &str) -> bool {
    name == PAGE || name == ROWS || TABLES.contains(&name) || figures::is_file(name)
}

/// Writes the page, the rows and the pictures; returns the names of the files beside the page.
fn write(folder: &Path, results: &Results, figures: &[Figure]) -> Result<Vec<String>> {
    let save = |name: &str, bytes: &[u8]| output::write(&folder.join(name), bytes);
    let mut names = vec![ROWS.to_owned()];
    let tables = [
        (serde_json::to_string_pretty(results)? + "\n").into_bytes(),
        csv(&results.quality)?,
        csv(&results.speed)?,
        csv(&results.perception)?,
    ];
    for (name, bytes) in TABLES.into_iter().zip(tables) {
        save(name, &bytes)?;
        names.push(name.to_owned());
    }
    for figure in figures {
        if let Some(svg) = &figure.svg {
            let name = format!("{}.svg", figure.name);
            save(&name, svg.as_bytes())?;
            names.push(name);
        }
        let name = format!("{}.png", figure.name);
        figure.png.save(&folder.join(&name))?;
        names.push(name);
    }
    save(PAGE, page::html(results, figures)?.as_bytes())?;
    Ok(names)
}

fn csv<R: Serialize>(rows: &[R]) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row)?;
    }
    writer
        .into_inner()
        .map_err(|error| anyhow::anyhow!("rows as CSV: {error}"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        report: Report,
    }

    #[test]
    fn rows_of_another_report_are_never_mixed_with_these() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let run = RunFolder::check(folder.path(), true, is_own).unwrap();
        let report = |flags: &[&str]| Line::parse_from([&["report"], flags].concat()).report;
        let record = Record::new(&[], &[], &Effort::QUICK, "built-in");
        let check =
            |flags: &[&str], record: &Record| report(flags).check_rows(&run, &at(ROWS), record);
        let old = ["density-over-time-recordings.png", "perception.csv"];
        let write = || {
            Store::open(&at(ROWS), record.clone(), true).unwrap();
            for name in old.iter().chain(&["notes.txt", "density-map.png"]) {
                std::fs::write(at(name), "").unwrap();
            }
        };
        write();
        check(&[], &record).unwrap();
        let rebuilt = Record {
            program: "another".to_owned(),
            ..record.clone()
        };
        let error = check(&[], &rebuilt).unwrap_err().to_string();
        assert!(
            error.contains("--keep-rows") && error.contains("--overwrite"),
            "{error}"
        );
        check(&["--keep-rows"], &rebuilt).unwrap();
        let other = Record {
            segmenter: "onnx other".to_owned(),
            ..record.clone()
        };
        for flags in [&[][..], &["--keep-rows"]] {
            let error = check(flags, &other).unwrap_err().to_string();
            assert!(error.contains("another report"), "{error}");
        }
        assert!(old.iter().all(|name| at(name).exists()) && at(ROWS).exists());
        check(&["--overwrite"], &other).unwrap();
        let mut left: Vec<_> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(left, ["density-map.png", "notes.txt"]);
        // A folder of other files is refused at once.
        let line = folder.path().display().to_string();
        let error = report(&["--quick", "-o", &line]).run().unwrap_err();
        assert!(error.to_string().contains("already has files"), "{error}");
    }
}
