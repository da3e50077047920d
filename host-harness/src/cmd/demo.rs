//! `eecvs demo`: runs the whole codec on an emulated scene and writes a page with pictures.

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs::calibrate::Calibration;
use eecvs::decode::{WindowReader, decode};
use eecvs::density_series::{WindowDensity, of_recording};
use eecvs::encode::{Limits, encode};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_bench::record_file;
use eecvs_cli::folder::RunFolder;
use eecvs_cli::output::{frame_file, print};
use eecvs_cli::progress::Progress;
use eecvs_cli::values::preset;
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Hybrid, Mode, Quantiser, Regime, Sensor, Thresholds, Transform,
    WindowConfig,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use event_files::input::piped::open_bytes;
use event_files::output;
use event_pictures::frame_picture::{FrameStyle, FrameSums, comparison_strip};

use super::monitor::{chart_thresholds, points};
use crate::report::chart;
use crate::report::demo::{MARKS, Page, Row, document, table};

const WINDOW_US: NonZeroU32 = NonZeroU32::new(32_768).unwrap();
const M: u8 = 16;

/// File name of the recording.
const SCENE: &str = "scene.raw";

/// File name of the thresholds.
const THRESHOLDS: &str = "thresholds.toml";

/// The ways to encode, each with a file of frames and a decoded recording.
const WAYS: [(&str, Mode, Option<Transform>); 7] = [
    ("fast", hybrid(Coder::Keys, Fidelity::Lossless), None),
    ("dense", hybrid(Coder::Dense, Fidelity::Lossless), None),
    (
        "dense50us",
        hybrid(Coder::Dense, Fidelity::ToleranceUs(50)),
        None,
    ),
    ("auto", Mode::Transform, None),
    ("dct", Mode::Transform, Some(Transform::Dct)),
    ("dtft", Mode::Transform, Some(Transform::Dtft)),
    ("dwt", Mode::Transform, Some(Transform::Dwt)),
];

const fn hybrid(coder: Coder, fidelity: Fidelity) -> Mode {
    Mode::Hybrid(Hybrid { coder, fidelity })
}

/// File names of the charts.
const CHARTS: [&str; 2] = ["density.svg", "histogram.svg"];

/// File name of the page, which is written last.
const REPORT: &str = "report.html";

/// Returns whether a demo writes files of this name.
fn is_own(name: &str) -> bool {
    let mut of_ways = WAYS
        .iter()
        .flat_map(|(way, ..)| [frames_name(way), decoded_name(way)]);
    [SCENE, THRESHOLDS, REPORT].contains(&name)
        || CHARTS.contains(&name)
        || of_ways.any(|own| own == name)
        || Regime::ALL.iter().any(|regime| name == strip_name(*regime))
}

fn frames_name(way: &str) -> String {
    format!("{way}.eecvs")
}

fn decoded_name(way: &str) -> String {
    format!("decoded-{way}.raw")
}

fn strip_name(regime: Regime) -> String {
    format!("{}.png", regime.name())
}

/// Emulate a scene, calibrate, encode, decode, compare, and write a page with pictures
#[derive(Debug, Args)]
pub struct Demo {
    /// Folder to write the results to, which must be empty
    #[arg(short, long, value_name = "DIR", default_value = "eecvs-demo")]
    output: PathBuf,

    /// Scene to emulate
    #[arg(long, value_parser = preset(), default_value = "outdoor-well-lit-blur")]
    scene: Preset,

    /// Seed of the scene
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Remove the results of an earlier run from the folder; other files stay
    #[arg(long)]
    overwrite: bool,

    /// Also write the table into a document, README.md, between the lines that name this command
    #[arg(long, value_name = "FILE", conflicts_with_all = ["scene", "seed"])]
    save: Option<PathBuf>,

    /// Also write the rows into this folder as a record to commit, from which the table can be made again
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scene", "seed"])]
    record: Option<PathBuf>,
}

/// Files and settings of the run.
struct Run {
    folder: PathBuf,
    scene: PathBuf,
    sensor: Sensor,
    thresholds: Thresholds,
}

impl Demo {
    /// Runs the whole codec and prints where the results are.
    ///
    /// # Errors
    /// Fails if the folder holds files already (unless `overwrite`) or cannot be written, or if a step of the codec
    /// fails.
    pub fn run(self) -> Result<()> {
        if let Some(document) = &self.save {
            MARKS.check(document)?;
        }
        RunFolder::check(&self.output, self.overwrite, is_own)?
            .with_page(REPORT)
            .begin()?;
        let config = SceneConfig::new(self.scene, self.seed);
        let scene = self.output.join(SCENE);
        say(&format!(
            "emulate    {}, seed {}",
            self.scene.name(),
            self.seed
        ))?;
        let events = write_scene(config, &scene)?;
        say(&format!(
            "           {events} events in {}",
            scene.display()
        ))?;

        let thresholds = calibrate(&scene, &self.output.join(THRESHOLDS))?;
        let run = Run {
            folder: self.output.clone(),
            scene,
            sensor: config.sensor,
            thresholds: thresholds.thresholds()?,
        };
        let marks = chart_thresholds(run.thresholds);
        say(&format!(
            "calibrate  tau_low {:.3}, tau_high {:.3} events/pixel/s",
            marks.tau_low, marks.tau_high
        ))?;

        let mut rows = Vec::new();
        for (name, mode, transform) in WAYS {
            say(&format!("{name:<10} encode, decode, compare"))?;
            rows.push(run.row(name, mode, transform)?);
        }

        if let Some(path) = &self.save {
            MARKS.write(path, &document(&rows))?;
        }
        if let Some(folder) = &self.record {
            record_file::write(folder, "demo", &rows)?;
        }

        let pictures = run.pictures()?;
        let scene_text = format!("{}, seed {}", self.scene.name(), self.seed);
        let setting = format!(
            "{events} events of {} x {} pixels, windows of {WINDOW_US} us, M = {M}, step 2^{}.",
            run.sensor.width,
            run.sensor.height,
            Quantiser::DEFAULT.step_log2(),
        );
        let page = Page {
            scene: &scene_text,
            setting: &setting,
            pictures: &pictures,
            rows: &rows,
        };
        let report = self.output.join(REPORT);
        output::write(&report, page.html())?;
        let files: Vec<_> = pictures
            .iter()
            .map(|(file, caption)| format!("  {}  {caption}\n", run.folder.join(file).display()))
            .collect();
        print(&format!(
            "\n{}\npictures of the original and the decoded scene:\n{}report: {}\n",
            table(&rows),
            files.concat(),
            report.display()
        ))
    }
}

fn say(line: &str) -> Result<()> {
    print(&format!("{line}\n"))
}

fn write_scene(config: SceneConfig, path: &Path) -> Result<u64> {
    let mut emulator = emulate(config)?;
    let mut writer = event_files::create(path, config.sensor)?;
    let progress = Progress::new("events emulated");
    let mut events = Vec::new();
    let mut count = 0;
    while emulator.read(&mut events)? > 0 {
        writer.write(&events)?;
        count += events.len() as u64;
        progress.set(count);
        events.clear();
    }
    writer.finish()?;
    ensure!(count > 0, "the scene has no events");
    Ok(count)
}

fn calibrate(scene: &Path, path: &Path) -> Result<ThresholdsFile> {
    let mut calibration = Calibration::new(WINDOW_US);
    calibration.add(event_files::open(scene, None)?.as_mut(), &mut |_| ())?;
    let file = ThresholdsFile::new(
        &calibration.thresholds()?,
        vec![scene.display().to_string()],
    );
    output::write(path, file.to_toml())?;
    Ok(file)
}

impl Run {
    fn decoded(&self, name: &str) -> PathBuf {
        self.folder.join(decoded_name(name))
    }

    /// Encodes the scene to a file, decodes that to another file and compares the result with the scene.
    fn row(&self, name: &'static str, mode: Mode, transform: Option<Transform>) -> Result<Row> {
        let frames = self.folder.join(frames_name(name));
        let mut out = frame_file(&frames)?;
        let config = Config {
            transform,
            m: M,
            ..Config::new(
                WindowConfig::new(self.sensor, WINDOW_US.get()),
                self.thresholds,
                mode,
            )
        };
        let mut reader = event_files::open(&self.scene, None)?;
        let progress = Progress::new("events");
        let mut show = |events| progress.set(events);
        // As everywhere unless stated otherwise, the rate in the table is that of one thread.
        let encoded = encode(
            reader.as_mut(),
            config,
            Limits::default(),
            NonZeroUsize::MIN,
            &mut out,
            &mut show,
        )?;
        out.finish()?.finish()?;

        let decoded = self.decoded(name);
        decode(
            &mut WindowReader::new(FrameReader::new(open_bytes(&frames)?)),
            EventDecoder::new(Finder::Exact),
            &mut |sensor| event_files::create(&decoded, sensor).map(Some),
            &mut |_, _| Ok(()),
            &mut show,
        )?;
        let compared = event_metrics::compare(
            &|| event_files::open(&self.scene, None),
            &|| event_files::open(&decoded, None),
            u64::from(WINDOW_US.get()),
            &mut show,
        )?;
        Ok(Row {
            name,
            is_transform: mode.is_transform(),
            encoded,
            compared,
        })
    }

    /// Draws a strip for one window of each regime, and the charts of the density.
    fn pictures(&self) -> Result<Vec<(String, String)>> {
        let mut windows = Vec::new();
        of_recording(
            event_files::open(&self.scene, None)?.as_mut(),
            WINDOW_US,
            self.thresholds,
            &mut |window| {
                windows.push(window);
                Ok::<_, anyhow::Error>(())
            },
        )?;
        let mut pictures = Vec::new();
        for regime in Regime::ALL {
            let of_regime: Vec<_> = windows.iter().filter(|w| w.regime == regime).collect();
            let Some(window) = of_regime.get(of_regime.len() / 2) else {
                continue;
            };
            let file = strip_name(regime);
            let caption = format!(
                "{} window at {:.3} s, {} events, {}: first 4 ms, original and decoded",
                regime.name(),
                window.t0_us as f64 * 1e-6,
                window.events,
                regime.transform().name(),
            );
            self.strip(window, &self.folder.join(&file))?;
            pictures.push((file, caption));
        }
        let marks = chart_thresholds(self.thresholds);
        let densities: Vec<f64> = windows.iter().map(|w| w.density_per_px_s).collect();
        let [over_time, histogram] = CHARTS;
        for (file, caption, svg) in [
            (
                over_time,
                "density and regime of every window",
                chart::density_over_time("Event density", &points(&windows), marks)?.svg,
            ),
            (
                histogram,
                "densities with the two thresholds",
                chart::density_histogram("Event density", &densities, marks)?.svg,
            ),
        ] {
            let path = self.folder.join(file);
            output::write(&path, svg)?;
            pictures.push((file.to_owned(), caption.to_owned()));
        }
        Ok(pictures)
    }

    /// Draws the start of a window: original, decoded and difference.
    ///
    /// The counts of a whole window are exact, so that its pictures would look alike; a slice of it shows how the
    /// coefficients change the times.
    fn strip(&self, window: &WindowDensity, path: &Path) -> Result<()> {
        let until_us = window.t0_us + 4096;
        let sums = |path: &Path| -> Result<FrameSums> {
            let mut reader = event_files::open(path, None)?;
            let mut slice: Vec<Event> = Vec::new();
            let mut events = Vec::new();
            while reader.read(&mut events)? > 0 {
                let inside = |e: &Event| (window.t0_us..until_us).contains(&e.t_us);
                slice.extend(events.drain(..).filter(inside));
            }
            Ok(FrameSums::new(self.sensor, &slice))
        };
        let (original, decoded) = (sums(&self.scene)?, sums(&self.decoded("auto"))?);
        comparison_strip(&original, &decoded, FrameStyle::for_sensor(self.sensor))
            .save(path)
            .with_context(|| format!("{}", path.display()))
    }
}
