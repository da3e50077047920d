//! `eecvs bench`: measures run time and error of every kernel, how encoding scales, what skipping saves, rate
//! against distortion, what a largest mean error costs, and how fast
//! recordings are read and converted.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use eecvs_bench::cut::{self, Cut};
use eecvs_bench::kernel_image::Images;
use eecvs_bench::marks::Marks;
use eecvs_bench::mcu::{self, Count};
use eecvs_bench::window::Windows;
use eecvs_bench::{
    Effort, Origin, Row, errors, measure, over_windows, record_file, scaling, skips, steps, windows,
};
use eecvs_cli::folder::RunFolder;
use eecvs_cli::output::{print, print_json};
use eecvs_cli::progress::Progress;
use eecvs_cli::say;
use event_files::output;
use serde::Serialize;

use super::bench_pipelines;
use super::bench_rate::{self, Rate};
use super::bench_read;
use super::bench_selection::Selection;
use crate::report::{
    error_chart, few_table, kernel_chart, kernel_table, rate_table, selection_table, skip_table,
};

/// Folder searched for recordings when none is given.
const RECORDINGS: &str = "../shared/data";

/// Folder of the charts when none is given.
const CHARTS: &str = "target/bench";

/// Files of the chart of kernels.
const KERNELS: [&str; 2] = ["kernels.svg", "kernels.png"];

/// Files of the curves of errors.
const ERRORS: [&str; 2] = ["errors.svg", "errors.png"];

fn is_kernels(name: &str) -> bool {
    KERNELS.contains(&name)
}

fn is_errors(name: &str) -> bool {
    ERRORS.contains(&name)
}

fn is_rate(name: &str) -> bool {
    bench_rate::CHARTS.contains(&name)
}

/// Source of the instruction counts on microcontrollers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Mcu {
    /// Count them now; fail where that is not possible
    Run,
    /// Take the counts saved with the project
    Saved,
}

/// Measure run time against error of every kernel
///
/// Times the accumulate stage of every kernel and of its peers, for every transform and M = 8, 16, 24 and 64, on
/// three windows cut from recordings or, if those are absent, from emulated scenes. Runs on one thread. Compares
/// every result with the f64 reference first. Counts instructions on a Cortex-M4 and M7 in QEMU if it is installed
/// and the current folder is the project's, whose firmware it builds; otherwise takes the counts saved with the
/// project, and says so. Writes a chart to DIR.
#[derive(Debug, Args)]
pub struct Bench {
    /// Folder to write the chart to, which must be empty [default: target/bench, whose charts are replaced]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,

    /// Remove the chart of an earlier run from the folder; other files stay
    #[arg(long)]
    overwrite: bool,

    /// Folder of recordings to cut windows from; fails if one is missing, or with --skips if all are [default:
    /// ../shared/data if it is complete, else emulated scenes]
    #[arg(long, value_name = "DIR", conflicts_with = "scaling")]
    recordings: Option<PathBuf>,

    /// Instructions on microcontrollers: count them, or take the counts saved with the project [default: count them
    /// if possible; with --quick, take the saved counts]
    #[arg(long, value_enum, value_name = "FROM", conflicts_with = "scaling")]
    mcu: Option<Mcu>,

    /// Use fewer events and repetitions: checks that everything works, gives no figures to quote
    #[arg(long)]
    quick: bool,

    /// Instead: measure encoding time over the sensor's area and over the number of events
    #[arg(long)]
    scaling: bool,

    /// Instead: measure the largest error per event of every kernel over k = 1 to 1,023, over 1 to 65,535 events in
    /// a pixel, and over windows from 1 us to more than an hour; fails if an error exceeds its documented bound
    #[arg(long, conflicts_with_all = ["scaling", "recordings", "skips"])]
    errors: bool,

    /// Instead: measure what each kind of skipping saves, by encoding with and without it
    #[arg(long, conflicts_with = "scaling")]
    skips: bool,

    /// Instead: measure bits per event against distortion of both modes and of their peers (event files, xz and
    /// zstd, TORE volumes, voxel grids), and draw a chart; fails if a lossless codec does not return its input. The
    /// zstd rows need a program built with --features zstd
    #[arg(long, group = "of_data", conflicts_with_all = [
        "scaling", "recordings", "skips", "errors", "mcu",
    ])]
    rate: bool,

    /// Instead: measure bits per event of `--max-emd-us` against fixed transforms and tolerances that are no worse,
    /// on the nine emulated scenes and on recordings, all cropped; takes some minutes
    #[arg(long, group = "of_data", conflicts_with_all = [
        "scaling", "recordings", "skips", "errors", "mcu", "output", "overwrite",
    ])]
    selection: bool,

    /// Instead: measure what `--few-as-times` saves with every transform, M = 8, 16 and 32 and a step of 2^-6, by every
    /// coder, on the nine emulated scenes and on recordings, whole; takes a minute
    #[arg(long, group = "of_data", conflicts_with_all = [
        "scaling", "recordings", "skips", "errors", "mcu", "output", "overwrite",
    ])]
    few_as_times: bool,

    /// Instead: measure events per second when reading each of these recordings on one thread; the fastest of
    /// several runs counts
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = [
        "scaling", "recordings", "skips", "errors", "rate", "selection", "few_as_times", "mcu", "save",
        "record",
    ])]
    read: Vec<PathBuf>,

    /// Instead: measure events per second when converting each of these recordings to every format, in a temporary folder
    /// (TMPDIR), as `eecvs convert` does; the fastest of several runs counts
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = [
        "scaling", "recordings", "skips", "errors", "rate", "selection", "few_as_times", "mcu", "save",
        "record", "read",
    ])]
    pipelines: Vec<PathBuf>,

    /// Formats to convert to for --pipelines, by their names in `eecvs info` [default: all that are written]
    #[arg(long, value_name = "FORMAT", num_args = 1.., requires = "pipelines", conflicts_with = "of_data")]
    to: Vec<String>,

    /// Recordings for --rate, --selection or --few-as-times, or folders of them, searched two levels deep; the last two
    /// measure the emulated scenes as well [default: ../shared/data if it exists, else emulated scenes]
    #[arg(long, value_name = "PATH", num_args = 1.., requires = "of_data")]
    data: Vec<PathBuf>,

    /// Also write the table into a document, between the lines that name this command: docs/results.md, METHODOLOGY.md
    /// with --skips, --selection or --few-as-times, README.md or METHODOLOGY.md or both with --rate. Needs recordings,
    /// except with the last three
    #[arg(long, value_name = "FILE", conflicts_with_all = ["quick", "scaling", "errors"])]
    save: Vec<PathBuf>,

    /// Also write the rows into this folder as a record to commit, from which the table can be made again
    #[arg(long, value_name = "DIR", conflicts_with_all = ["quick", "scaling", "errors"])]
    record: Option<PathBuf>,

    /// Print one JSON array of rows instead of the table
    #[arg(long)]
    json: bool,
}

impl Bench {
    /// Runs the measurements that were asked for and prints their results.
    ///
    /// # Errors
    /// Fails if a recording cannot be read, a folder cannot be written, or a kernel exceeds its documented error.
    pub fn run(self) -> Result<()> {
        if !self.read.is_empty() {
            return bench_read::run(&self.read, self.quick, self.json);
        }
        if !self.pipelines.is_empty() {
            return bench_pipelines::run(&self.pipelines, &self.to, self.quick, self.json);
        }
        // Before anything is measured, which takes minutes.
        if let Some(folder) = &self.record {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("{}: cannot create the folder", folder.display()))?;
        }
        for document in &self.save {
            self.marks(document).check(document)?;
        }
        if self.scaling {
            return self.scale();
        }
        if self.skips {
            return self.skip();
        }
        if self.rate {
            return self.rate()?.run();
        }
        if self.selection {
            return self.selection().run();
        }
        if self.few_as_times {
            return self.selection().run_few();
        }
        if self.errors {
            return self.errors();
        }
        let folder = self.folder(is_kernels)?;
        let (cuts, origin) = self.cuts()?;
        self.can_save(origin == Origin::Recordings)?;
        let effort = if self.quick {
            Effort::QUICK
        } else {
            Effort::FULL
        };
        let windows = windows(&cuts, effort)?;
        let (counts, source) = self.counts(&windows, origin)?;
        let progress = Progress::new(&format!("of {} points", steps(cuts.len())));
        let rows = measure(&windows, &counts, effort, &mut || progress.advance(1));
        drop(progress);
        let rows = rows?;
        let merged = over_windows(&rows);
        folder.begin()?;
        let files = self.chart(&merged, &cuts)?;
        self.save(kernel_table::document(&merged))?;
        self.record("kernels", &merged)?;
        if self.json {
            say!("eecvs: instructions: {source}");
            return print_json(&rows);
        }
        print(&format!(
            "accumulate stage, windows {} ({})\ninstructions: {source}\n{}\nchart: {}\n",
            names(&cuts),
            origin.name(),
            kernel_table::table(&merged),
            files.map(|file| file.display().to_string()).join(", "),
        ))
    }

    fn rate(&self) -> Result<Rate<'_>> {
        Ok(Rate {
            data: &self.data,
            default_folder: Path::new(RECORDINGS),
            folder: self.folder(is_rate)?,
            quick: self.quick,
            json: self.json,
            save: &self.save,
            record: self.record.as_deref(),
        })
    }

    fn selection(&self) -> Selection<'_> {
        Selection {
            data: &self.data,
            default_folder: Path::new(RECORDINGS),
            quick: self.quick,
            json: self.json,
            save: &self.save,
            record: self.record.as_deref(),
        }
    }

    fn output(&self) -> &Path {
        self.output.as_deref().unwrap_or(Path::new(CHARTS))
    }

    /// Checks the folder of the charts; those in the default folder are replaced without --overwrite.
    fn folder(&self, is_own: fn(&str) -> bool) -> Result<RunFolder> {
        let overwrite = self.overwrite || self.output.is_none();
        let folder = RunFolder::check(self.output(), overwrite, is_own)?;
        let inputs = self.read.iter().chain(&self.data).chain(&self.save);
        folder.refuse_inputs(inputs.map(PathBuf::as_path))?;
        Ok(folder)
    }

    fn skip(&self) -> Result<()> {
        let folder = self.recordings.as_deref();
        let mut sources = skips::source::recordings(folder.unwrap_or(Path::new(RECORDINGS)))?;
        if sources.is_empty() {
            ensure!(
                folder.is_none(),
                "{}: holds none of the recordings; omit --recordings to use emulated scenes",
                folder.unwrap_or(Path::new(RECORDINGS)).display()
            );
            sources = skips::source::scenes()?;
        }
        let is_there = |name: &str| sources.iter().any(|source| source.name == name);
        self.can_save(skip_table::COLUMNS.iter().all(|(name, _)| is_there(name)))?;
        let steps = skips::steps(sources.len());
        let progress = Progress::new(&format!("of {steps} points"));
        let rows = skips::measure(&sources, self.quick, &mut || progress.advance(1));
        drop(progress);
        let rows = rows?;
        self.save(skip_table::document(&rows))?;
        self.record("skips", &rows)?;
        if self.json {
            print_json(&rows)
        } else {
            print(&skip_table::table(&rows))
        }
    }

    /// Markers of the lines in `document` between which the table goes.
    fn marks(&self, document: &Path) -> Marks {
        if self.rate {
            rate_table::of(document).0
        } else if self.selection {
            selection_table::MARKS
        } else if self.few_as_times {
            few_table::MARKS
        } else if self.skips {
            skip_table::MARKS
        } else {
            kernel_table::MARKS
        }
    }

    /// Refuses to save, before anything is measured, if the table would not be measured on recordings.
    fn can_save(&self, has_recordings: bool) -> Result<()> {
        let place = self.save.first().or(self.record.as_ref());
        if let Some(document) = place {
            ensure!(
                has_recordings,
                "{}: its table is of recordings, and not all of them are in {}: name their folder \
                 with --recordings",
                document.display(),
                self.recordings
                    .as_deref()
                    .unwrap_or(Path::new(RECORDINGS))
                    .display()
            );
        }
        Ok(())
    }

    /// Writes the table into every document of `--save`.
    fn save(&self, table: Option<String>) -> Result<()> {
        if self.save.is_empty() {
            return Ok(());
        }
        let table = table.context("a row of the table was not measured: please report this")?;
        for document in &self.save {
            self.marks(document).write(document, &table)?;
        }
        Ok(())
    }

    /// Writes the rows as a record, if `--record` names a folder.
    fn record<R: Serialize>(&self, name: &str, rows: &[R]) -> Result<()> {
        match &self.record {
            Some(folder) => record_file::write(folder, name, rows),
            None => Ok(()),
        }
    }

    /// Returns the windows to measure on, and whether they come from recordings or scenes.
    fn cuts(&self) -> Result<(Vec<Cut>, Origin)> {
        if let Some(folder) = &self.recordings {
            ensure!(
                folder.is_dir(),
                "{}: not a folder; omit --recordings to use emulated scenes",
                folder.display()
            );
            return Ok((cut::of_recordings(folder)?, Origin::Recordings));
        }
        let folder = Path::new(RECORDINGS);
        if cut::recordings().all(|(_, file)| folder.join(file).exists()) {
            return Ok((cut::of_recordings(folder)?, Origin::Recordings));
        }
        Ok((cut::of_scenes()?, Origin::Emulator))
    }

    /// Returns the instruction counts of the kernels, and a note on where they come from.
    fn counts(&self, windows: &[Windows], origin: Origin) -> Result<(Vec<Count>, String)> {
        let images = match (self.mcu, self.quick) {
            (Some(Mcu::Run), _) => Ok(Images::build()?),
            (Some(Mcu::Saved), _) => Err("as requested".to_owned()),
            (None, true) => Err("--quick does not count".to_owned()),
            (None, false) => Images::build().map_err(|error| format!("{error:#}")),
        };
        let reason = match images {
            Ok(images) => {
                let counts = images.count(windows, origin)?;
                return Ok((counts, "counted now, in QEMU".to_owned()));
            }
            Err(reason) => reason,
        };
        if self.quick {
            // Saved counts are of whole windows, so the sums of this run's shortened windows cannot match theirs.
            let mut counts = mcu::saved()?;
            counts.retain(|count| count.origin == origin.name());
            let source = format!("saved with the project, of whole windows ({reason})");
            return Ok((counts, source));
        }
        let (counts, other) = mcu::saved_of(windows, origin)?;
        let mut source = format!("saved with the project ({reason})");
        if other > 0 {
            source += &format!("; {other} left out, whose sums differ from this program's");
        }
        Ok((counts, source))
    }

    /// Draws all pixels of the windows for the host and the Cortex-M4; returns the SVG and the PNG.
    fn chart(&self, merged: &[Row], cuts: &[Cut]) -> Result<[PathBuf; 2]> {
        let rows: Vec<Row> = merged
            .iter()
            .filter(|row| ["host", "cortex-m4"].contains(&row.target) && !row.is_crowded)
            .cloned()
            .collect();
        let title = format!(
            "Accumulate stage: run time against error at M = 8, 16, 24, 64; windows {}",
            names(cuts)
        );
        let files = KERNELS.map(|file| self.output().join(file));
        let [svg, png] = &files;
        write(svg, &kernel_chart::svg(&title, &rows)?)?;
        kernel_chart::picture(&title, &rows)?.save(png)?;
        Ok(files)
    }

    /// Draws and prints the curves first, then fails if any is beyond its bound.
    fn errors(&self) -> Result<()> {
        let folder = self.folder(is_errors)?;
        let effort = if self.quick {
            errors::Effort::QUICK
        } else {
            errors::Effort::FULL
        };
        let progress = Progress::new(&format!("of {} steps", errors::steps()));
        let rows = errors::measure(effort, &mut || progress.advance(1));
        drop(progress);
        folder.begin()?;
        let files = ERRORS.map(|file| self.output().join(file));
        let [svg, png] = &files;
        write(svg, &error_chart::svg(&rows)?)?;
        error_chart::picture(&rows)?.save(png)?;
        if self.json {
            print_json(&rows)?;
        } else {
            print(&format!(
                "{}\nchart: {}\n",
                error_table(&rows),
                files.map(|file| file.display().to_string()).join(", ")
            ))?;
        }
        errors::check(&rows)
    }

    fn scale(&self) -> Result<()> {
        let progress = Progress::new("events encoded");
        let rows = scaling::measure(self.quick, &mut |events| progress.set(events));
        drop(progress);
        let rows = rows?;
        if self.json {
            print_json(&rows)
        } else {
            print(&scaling_table(&rows))
        }
    }
}

pub(super) fn write(path: &Path, text: &str) -> Result<()> {
    Ok(output::write(path, text)?)
}

/// Formats the largest error of each curve and its position as powers of two.
fn error_table(rows: &[errors::Row]) -> String {
    let power = |error: f64| {
        if error > 0.0 {
            format!("2^{:.2}", error.log2())
        } else {
            "0".to_owned()
        }
    };
    let mut text = format!("{:<6}{:<12}{:>9}", "", "kernel", "bound");
    for axis in errors::AXES {
        text += &format!("{:>26}", format!("most over {axis}"));
    }
    text.push('\n');
    let curves =
        |a: &errors::Row, b: &errors::Row| (a.transform, a.kernel) == (b.transform, b.kernel);
    let mut sorted: Vec<errors::Row> = rows.to_vec();
    sorted.sort_by_key(|row| (row.transform, row.kernel));
    for curves in sorted.chunk_by(curves) {
        let Some(first) = curves.first() else {
            continue;
        };
        text += &format!(
            "{:<6}{:<12}{:>9}",
            first.transform,
            first.kernel,
            power(first.bound)
        );
        for axis in errors::AXES {
            let here = curves.iter().filter(|row| row.axis == axis);
            let most = here.max_by(|a, b| a.max_error_per_event.total_cmp(&b.max_error_per_event));
            let cell = most.map_or_else(String::new, |most| {
                format!("{} at {}", power(most.max_error_per_event), most.value)
            });
            text += &format!("{cell:>26}");
        }
        text.push('\n');
    }
    text
}

fn names(cuts: &[Cut]) -> String {
    let names: Vec<_> = cuts.iter().map(|cut| cut.name).collect();
    names.join(", ")
}

fn scaling_table(rows: &[scaling::Row]) -> String {
    let mut text = "whole encoder, DCT, M = 8, one thread\n".to_owned();
    for (axis, heading) in [
        ("sensor", "the same events spread over the sensor"),
        ("events", "events on one sensor"),
    ] {
        text += &format!(
            "\n{heading}\n{:<12}{:>10}{:>9}{:>12}{:>24}{:>11}\n",
            "sensor", "events", "windows", "ms", "quartiles", "ns/event"
        );
        for row in rows.iter().filter(|row| row.axis == axis) {
            let sensor = format!("{}x{}", row.width, row.height);
            let quartiles = format!(
                "{:.3} to {:.3}",
                row.encode_s_low * 1e3,
                row.encode_s_high * 1e3
            );
            text += &format!(
                "{sensor:<12}{:>10}{:>9}{:>12.3}{quartiles:>24}{:>11.1}\n",
                row.events,
                row.windows,
                row.encode_s * 1e3,
                row.ns_per_event
            );
        }
    }
    text
}
