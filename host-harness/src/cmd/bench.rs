//! `eecvs bench`: run time against error of every kernel, and how encoding scales.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};

use super::output::{print, print_json};
use crate::bench::cut::{self, Cut};
use crate::bench::kernel_image::Images;
use crate::bench::mcu::{self, Count, TARGETS};
use crate::bench::window::{CROWDED_EVENTS, Windows};
use crate::bench::{Effort, M, Origin, Row, measure, over_windows, scaling, steps, windows};
use crate::progress::Progress;
use crate::report::kernel_chart;

/// Where recordings are looked for unless a folder is given.
const RECORDINGS: &str = "../shared/data";

/// Where the instructions on microcontrollers come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Mcu {
    /// Counted anew; fails where that is not possible
    Run,
    /// Those saved with the project
    Saved,
}

/// Measure run time against error of every kernel
///
/// Times the accumulate stage of every kernel and of its peers, for every transform, M = 8, 16, 24
/// and 64, on three windows cut from recordings or, where those are absent, from emulated scenes;
/// one thread. Every answer is first compared with the f64 reference. Instructions on a
/// Cortex-M4 and M7 are counted in QEMU where it is installed and this is the project's folder,
/// whose firmware is built for it; else they are those saved with the project, and it says so.
/// Writes a chart to DIR.
#[derive(Debug, Args)]
pub struct Bench {
    /// Folder of the chart
    #[arg(short, long, value_name = "DIR", default_value = "target/bench")]
    output: PathBuf,

    /// Folder of the recordings to cut windows from; fails where one is missing
    /// [default: ../shared/data where it is complete, else emulated scenes]
    #[arg(long, value_name = "DIR", conflicts_with = "scaling")]
    recordings: Option<PathBuf>,

    /// Instructions on microcontrollers: count them, or take those saved with the project
    /// [default: count them where that is possible; with --quick, take the saved ones]
    #[arg(long, value_enum, value_name = "FROM", conflicts_with = "scaling")]
    mcu: Option<Mcu>,

    /// Fewer events and repetitions: a look whether everything works, no figures to quote
    #[arg(long)]
    quick: bool,

    /// Instead: time to encode over the sensor's area and over the number of events
    #[arg(long)]
    scaling: bool,

    /// Print one JSON array of rows instead of the table
    #[arg(long)]
    json: bool,
}

impl Bench {
    /// Measures and prints.
    ///
    /// # Errors
    /// A recording that cannot be read, a folder that cannot be written, a kernel that is not
    /// within its documented error.
    pub fn run(self) -> Result<()> {
        if self.scaling {
            return self.scale();
        }
        fs::create_dir_all(&self.output)
            .with_context(|| format!("{}: cannot create the folder", self.output.display()))?;
        let (cuts, origin) = self.cuts()?;
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
        let files = self.chart(&merged, &cuts)?;
        if self.json {
            eprintln!("eecvs: instructions: {source}");
            return print_json(&rows);
        }
        print(&format!(
            "accumulate stage, windows {} ({})\ninstructions: {source}\n{}\nchart: {}\n",
            names(&cuts),
            origin.name(),
            table(&merged),
            files.map(|file| file.display().to_string()).join(", "),
        ))
    }

    /// What is measured.
    fn cuts(&self) -> Result<(Vec<Cut>, Origin)> {
        if let Some(folder) = &self.recordings {
            ensure!(
                folder.is_dir(),
                "{}: no folder of recordings; leave --recordings out to take emulated scenes",
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

    /// Instructions of the kernels, and where they come from.
    fn counts(&self, windows: &[Windows], origin: Origin) -> Result<(Vec<Count>, String)> {
        let images = match (self.mcu, self.quick) {
            (Some(Mcu::Run), _) => Ok(Images::build()?),
            (Some(Mcu::Saved), _) => Err("as asked for".to_owned()),
            (None, true) => Err("--quick counts none".to_owned()),
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
            // Of the whole windows: no sums of this run are theirs.
            let mut counts = mcu::saved()?;
            counts.retain(|count| count.origin == origin.name());
            let source = format!("saved with the project, of whole windows ({reason})");
            return Ok((counts, source));
        }
        let (counts, other) = mcu::saved_of(windows, origin)?;
        let mut source = format!("saved with the project ({reason})");
        if other > 0 {
            source += &format!("; {other} left out, whose sums are not this program's");
        }
        Ok((counts, source))
    }

    /// Writes the chart of the host and of a microcontroller, all pixels.
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
        let files = ["kernels.svg", "kernels.png"].map(|file| self.output.join(file));
        let [svg, png] = &files;
        fs::write(svg, kernel_chart::svg(&title, &rows)?)
            .with_context(|| format!("{}: cannot be written", svg.display()))?;
        kernel_chart::picture(&title, &rows)?.save(png)?;
        Ok(files)
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

fn names(cuts: &[Cut]) -> String {
    let names: Vec<_> = cuts.iter().map(|cut| cut.name).collect();
    names.join(", ")
}

/// A table for each transform and target, and for crowded pixels: kernels down, M across; `*` is on
/// the front.
fn table(rows: &[Row]) -> String {
    let mut text = String::new();
    let targets = TARGETS.map(|(name, _)| name);
    for target in std::iter::once("host").chain(targets) {
        for is_crowded in [false, true] {
            for transform in ["dct", "dtft", "dwt", "none"] {
                let here: Vec<&Row> = rows
                    .iter()
                    .filter(|row| (row.target, row.is_crowded) == (target, is_crowded))
                    .filter(|row| row.transform == transform)
                    .collect();
                text += &kernels_table(&here);
            }
        }
    }
    text
}

/// Of one transform and target; nothing without rows.
fn kernels_table(rows: &[&Row]) -> String {
    let Some(first) = rows.first() else {
        return String::new();
    };
    let name = match first.transform {
        "none" => "no transform, M bins",
        transform => transform,
    };
    let crowded = if first.is_crowded {
        format!(", pixels of {CROWDED_EVENTS} events and more")
    } else {
        String::new()
    };
    let mut text = format!(
        "\n{name}, {}{crowded}: {}, largest error\n{:<15}",
        first.target, first.unit, ""
    );
    for m in M {
        text += &format!("{:>22}", format!("M = {m}  "));
    }
    text = text.trim_end().to_owned() + "\n";
    let mut kernels: Vec<&str> = Vec::new();
    for row in rows {
        if !kernels.contains(&row.kernel) {
            kernels.push(row.kernel);
        }
    }
    for kernel in kernels {
        let mut line = format!("{kernel:<15}");
        for m in M {
            let row = rows.iter().find(|row| row.kernel == kernel && row.m == m);
            line += &row.map_or_else(|| " ".repeat(22), |row| cell(row));
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

/// Cost, error, and whether it is on the front, in 22 columns.
fn cell(row: &Row) -> String {
    let error = match row.max_error {
        None => "-".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(error) => format!("{error:.1e}"),
    };
    let mark = if row.pareto { '*' } else { ' ' };
    format!("{:>11.1} {error:>8} {mark}", row.cost)
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
