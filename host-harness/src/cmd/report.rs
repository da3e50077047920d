//! `eecvs report`: reproduces the paper's evaluation as a page with tables and pictures.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use eecvs_bench::marks::Marks;
use eecvs_cli::output::print;
use eecvs_cli::progress::Progress;
use event_files::output;
use serde::Serialize;

use crate::downstream::segment::classical::Classical;
use crate::downstream::segment::{Segmenter, open_model};
use crate::recordings::{self, LeftOut};
use crate::report::study::figures::{self, Figure};
use crate::report::study::{page, tables};
use crate::study::effort::Effort;
use crate::study::record::Record;
use crate::study::set::Set;
use crate::study::store::Store;
use crate::study::{self, Results, kernels};

/// Folder searched for recordings when `--data` is not given.
const RECORDINGS: &str = "../shared/data";

/// Reproduce the paper's tables on emulated scenes and recordings, as a page with pictures
#[derive(Debug, Args)]
pub struct Report {
    /// Folder to write the results to: `report.html` and what it shows, as CSV, JSON, SVG and PNG. An interrupted
    /// report resumes from its `rows.jsonl`
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
    /// Fails if a recording cannot be read, a folder cannot be written, a model does not fit, or a codec breaks its
    /// promise.
    pub fn run(self) -> Result<()> {
        if let Some(document) = &self.save {
            MARKS.check(document)?;
        }
        let folder = &self.output;
        fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot create the folder", folder.display()))?;
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort::FULL
        };
        let model = self.segmenter.as_deref();
        // Checks the model before the measurements, which take long.
        let segmenter = segmenter(model)?.name().to_owned();
        let (sets, left_out) = self.sets(&effort)?;
        let path = folder.join("rows.jsonl");
        let (store, known) = Store::open(
            &path,
            Record::new(&sets, &left_out, &effort, &segmenter),
            !self.keep_rows,
        )?;
        if known > 0 {
            eprintln!(
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
        study::run(&sets, &effort, &|| self::segmenter(model), &store, &show)?;
        drop(progress);
        let results = store.results();
        let figures = figures::all(&sets, &results)?;
        let files = write(folder, &results, &figures)?;
        if let Some(path) = &self.save {
            MARKS.write(path, &tables::document(&results))?;
        }
        let answers = results.answer();
        let answers: Vec<String> = answers.iter().map(page::text).collect();
        print(&format!(
            "{}\n\nreport: {}\n        and {files} files beside it\n",
            answers.join("\n\n"),
            folder.join("report.html").display()
        ))
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
            eprintln!("eecvs: {notice}");
        }
        if set.is_none() {
            let paths: Vec<String> = paths
                .iter()
                .map(|path| path.display().to_string())
                .collect();
            eprintln!(
                "eecvs: {}: no recordings; docs/datasets.md says where there are some",
                paths.join(", ")
            );
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

/// Writes the page, the rows and the pictures; returns the number of files written beside the page.
fn write(folder: &Path, results: &Results, figures: &[Figure]) -> Result<usize> {
    let save = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        output::write(&path, bytes)
    };
    save("report.html", page::html(results, figures)?.as_bytes())?;
    save(
        "results.json",
        (serde_json::to_string_pretty(results)? + "\n").as_bytes(),
    )?;
    save("quality.csv", &csv(&results.quality)?)?;
    save("speed.csv", &csv(&results.speed)?)?;
    save("perception.csv", &csv(&results.perception)?)?;
    let mut files = 5;
    for figure in figures {
        if let Some(svg) = &figure.svg {
            save(&format!("{}.svg", figure.name), svg.as_bytes())?;
            files += 1;
        }
        figure
            .png
            .save(&folder.join(format!("{}.png", figure.name)))?;
        files += 1;
    }
    Ok(files)
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
