//! `eecvs emulate`: writes the events of a seeded scene, or of a video, to a recording.

mod input;
mod parameters;
mod pixel;
mod readout;
#[cfg(test)]
mod tests;
mod truth;
mod video;
mod write;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use eecvs_cli::options::{FormatOptions, OutputOptions};
use eecvs_cli::output::{Place, print, print_json, rows};
use eecvs_cli::values::model;
use eecvs_nostd::Sensor;
use event_emulator::{
    Camera, Cause, Exposure, Model, PRESETS, PixelParameters, Preset, Readout, ReadoutParameters,
    SceneConfig,
};
use event_files::input::piped::name_of;
use event_files::{EventReader, file_of};
use input::{Input, InputParser};
use pixel::PixelOptions;
use rayon::{ThreadPool, ThreadPoolBuilder};
use readout::ReadoutOptions;
use serde::Serialize;
use truth::{TruthCounts, TruthOptions};
use video::{VideoOptions, tell_motion};
use write::{Written, finish, write_events};

/// Emulate a seeded scene, or what a camera sees of a video, and write the events to a recording
#[derive(Debug, Clone, clap::Args)]
pub struct Emulate {
    /// Scene type, or a video: a Y4M file, a folder of PNG files, .npy or .npz of frames x rows x columns, a recording
    /// with frames (AEDAT 4, a ROS bag), or - for Y4M or .npy on stdin, and gray pixels with --size
    #[arg(value_parser = InputParser, value_name = "SCENE|VIDEO", required_unless_present_any = ["list", "print_pixel", "print_readout"])]
    input: Option<Input>,

    /// List the scenes, one per line with a description, and exit; with --json, as an array of objects
    #[arg(long, conflicts_with_all = ["input", "output"])]
    list: bool,

    /// Print the pixel of model 2 as the flags make it, as a file for --pixel, and exit
    #[arg(long, conflicts_with_all = ["input", "output", "list", "json"])]
    print_pixel: bool,

    /// Print the readout as the flags make it, as a file for --readout, and exit
    #[arg(long, conflicts_with_all = ["input", "output", "list", "print_pixel", "json"])]
    print_readout: bool,

    /// Recording to write; the extension names the format
    #[arg(short, long, value_name = "FILE", required_unless_present_any = ["list", "print_pixel", "print_readout"])]
    output: Option<PathBuf>,

    #[command(flatten)]
    format: FormatOptions,

    /// Seed of the scene; the same seed gives the same events on every machine
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Columns of a scene's sensor [default: 346, or the camera's]
    #[arg(long, requires = "height", value_parser = clap::value_parser!(u16).range(1..=2048))]
    width: Option<u16>,

    /// Rows of a scene's sensor [default: 260, or the camera's]
    #[arg(long, requires = "width", value_parser = clap::value_parser!(u16).range(1..=2048))]
    height: Option<u16>,

    /// Duration in microseconds [default: 1000000 of a scene, all of a video]
    #[arg(long, value_name = "D")]
    duration_us: Option<u64>,

    /// Time at which the scene or the video starts, in microseconds [default: 0 of a scene, the first frame's of a video]
    #[arg(long, value_name = "T")]
    start_us: Option<u64>,

    /// Model of the pixel; videos have 2 alone [default: 2]
    #[arg(long, value_parser = model())]
    model: Option<Model>,

    /// Number of threads of model 2; the events do not depend on it [default: the number of cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    #[command(flatten)]
    pixel: PixelOptions,

    #[command(flatten)]
    readout: ReadoutOptions,

    #[command(flatten)]
    truth: TruthOptions,

    #[command(flatten)]
    video: VideoOptions,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print JSON instead of the table or the list
    #[arg(long)]
    json: bool,
}

/// A scene of the list; the fields are JSON keys.
#[derive(Debug, Serialize)]
struct Listed {
    /// Name of the scene.
    scene: &'static str,
    /// Its description.
    about: &'static str,
    /// Columns and rows of the sensor, unless others are given.
    width: u16,
    height: u16,
    /// Duration in microseconds, unless another is given.
    duration_us: u64,
}

impl Emulate {
    /// Emulates the scene or the video, writes the events and prints the result on stdout.
    ///
    /// # Errors
    /// Fails if the scene cannot exist (its end is beyond 2^64 us), the video or the pixel's file cannot be read or has a
    /// value out of range, a flag does not belong to the model or to the kind of input, the extension is unknown, the file
    /// cannot be written, or the format cannot hold an event.
    pub fn run(self) -> anyhow::Result<()> {
        if self.list {
            return match self.json {
                true => print_json(&listed()),
                false => print(&scenes()),
            };
        }
        let pixel = self.pixel.parameters()?;
        if self.print_pixel {
            return print(&pixel::file(&pixel));
        }
        if self.print_readout {
            return print(&readout::file(self.readout.readout()?));
        }
        let (input, output) = self
            .input
            .as_ref()
            .zip(self.output.as_ref())
            .with_context(|| {
                format!(
                    "give a scene or a video, and -o FILE; the scenes are\n{}",
                    scenes().trim_end()
                )
            })?;
        match input {
            Input::Scene(preset) => self.run_scene(*preset, &pixel, output),
            Input::Video(path) => self.run_video(path, &pixel, output),
        }
    }

    fn run_scene(
        &self,
        preset: Preset,
        pixel: &PixelParameters,
        output: &Path,
    ) -> anyhow::Result<()> {
        self.overwrite.check(output, self.format.kind(), [])?;
        self.truth.check(output, false, self.overwrite, [])?;
        let format = self.format.of(output)?;
        ensure!(
            self.video.is_default(),
            "{} is a scene: flags of videos do not apply to it",
            preset.name()
        );
        let mut config = SceneConfig::new(preset, self.seed);
        let camera = self.readout.readout()?;
        if let Some((width, height)) = self.width.zip(self.height) {
            config.sensor = Sensor { width, height };
        } else if let Some((Some(camera), _)) = camera {
            config.sensor = camera.sensor;
        }
        let mut readout = Stage::new(config.sensor, camera)?;
        config.duration_us = self.duration_us.unwrap_or(config.duration_us);
        config.start_us = self.start_us.unwrap_or(0);
        config.model = self.model.unwrap_or_default();
        if config.model == Model::Steps {
            ensure!(
                self.pixel.is_default() && self.threads.is_none(),
                "the pixel's flags and --threads are of model 2: leave out --model 1"
            );
        }
        let mut emulator = event_emulator::emulate_with(config, pixel)?;
        let mut truth = self
            .truth
            .of_scene(&config, config.model == Model::Physical)?;
        let mut writer = event_files::create_as(output, format, config.sensor)?;
        let begun = Instant::now();
        let pool = self.pool(config.model)?;
        emulator = emulator.parallel(pool.is_some());
        let written = write_events(
            &mut emulator,
            readout.as_mut(),
            writer.as_mut(),
            truth.as_mut(),
            pool.as_ref(),
        )?;
        let truth = finish(writer, truth)?;
        let emulated = Emulated {
            readout,
            truth,
            source: Source::Scene(preset),
            sensor: config.sensor,
            start_us: config.start_us,
            duration_us: config.duration_us,
            model: config.model,
            samples: emulator.samples(),
            written,
            seconds: begun.elapsed().as_secs_f64(),
        };
        self.print_report(output, &emulated, pixel)
    }

    fn run_video(&self, path: &Path, pixel: &PixelParameters, output: &Path) -> anyhow::Result<()> {
        let inputs = || [file_of(path)].into_iter().chain(self.video.files());
        self.overwrite.check(output, self.format.kind(), inputs())?;
        self.truth.check(output, true, self.overwrite, inputs())?;
        let format = self.format.of(output)?;
        let name = name_of(path);
        if self.model == Some(Model::Steps) {
            bail!("{name}: model 1 has scenes only: leave out --model 1 for a video");
        }
        ensure!(
            self.width.is_none(),
            "{name}: a video has a size of its own: --width and --height are of scenes; scale the video, or give --size WxH \
             for gray pixels without a header"
        );
        let begun = Instant::now();
        let span_us = (self.start_us, self.duration_us);
        let (emulator, exposure) = self.video.emulate(path, span_us, self.seed, pixel)?;
        let mut readout = Stage::new(emulator.sensor(), self.readout.readout()?)?;
        let mut truth = self.truth.of_video()?;
        let mut writer = event_files::create_as(output, format, emulator.sensor())?;
        let pool = self.pool(Model::Physical)?;
        let mut emulator = emulator.parallel(pool.is_some());
        let written = write_events(
            &mut emulator,
            readout.as_mut(),
            writer.as_mut(),
            truth.as_mut(),
            pool.as_ref(),
        )?;
        let truth = finish(writer, truth)?;
        tell_motion(&name, emulator.motion(), emulator.elapsed_us());
        let emulated = Emulated {
            readout,
            truth,
            source: Source::Video {
                name,
                format: emulator.format(),
                frames: emulator.frames(),
                exposure,
            },
            sensor: emulator.sensor(),
            start_us: emulator.start_us(),
            duration_us: emulator.elapsed_us(),
            model: Model::Physical,
            samples: Some(emulator.samples()),
            written,
            seconds: begun.elapsed().as_secs_f64(),
        };
        self.print_report(output, &emulated, pixel)
    }

    /// Returns the threads that the tiles of model 2 are shared by; `None` if this thread does all.
    fn pool(&self, model: Model) -> anyhow::Result<Option<ThreadPool>> {
        if model == Model::Steps || self.threads == Some(1) {
            return Ok(None);
        }
        // 0 threads are as many as there are cores.
        let threads = self.threads.map_or(0, usize::from);
        let pool = ThreadPoolBuilder::new().num_threads(threads).build();
        Ok(Some(pool.context("the threads cannot be started")?))
    }

    fn print_report(
        &self,
        output: &Path,
        emulated: &Emulated,
        pixel: &PixelParameters,
    ) -> anyhow::Result<()> {
        let report = if self.json {
            emulated.json(output, self.seed, pixel).to_string()
        } else {
            emulated.table(output, self.seed)
        };
        Place::beside([output]).print(&format!("{}\n", report.trim_end()))
    }
}

/// What was emulated, for the report.
#[derive(Debug, Clone)]
struct Emulated {
    source: Source,
    readout: Option<Stage>,
    truth: Option<TruthCounts>,
    sensor: Sensor,
    start_us: u64,
    duration_us: u64,
    model: Model,
    /// Samples of the light, of model 2.
    samples: Option<u64>,
    written: Written,
    /// Time that it took.
    seconds: f64,
}

/// The readout that events go through.
#[derive(Debug, Clone)]
struct Stage {
    camera: Option<&'static Camera>,
    parameters: ReadoutParameters,
    readout: Readout,
}

impl Stage {
    /// Begins the readout of a sensor, if one was asked for.
    fn new(
        sensor: Sensor,
        of: Option<(Option<&'static Camera>, ReadoutParameters)>,
    ) -> anyhow::Result<Option<Self>> {
        let Some((camera, parameters)) = of else {
            return Ok(None);
        };
        Ok(Some(Self {
            camera,
            parameters,
            readout: Readout::new(sensor, &parameters)?,
        }))
    }
}

/// Where light came from.
#[derive(Debug, Clone)]
enum Source {
    Scene(Preset),
    Video {
        name: String,
        format: &'static str,
        frames: u64,
        exposure: Exposure,
    },
}

impl Emulated {
    /// Returns a count per pixel and second; 0 of nothing.
    fn per_px_s(&self, count: u64) -> f64 {
        let exposure = f64::from(self.sensor.pixels()) * self.duration_us as f64 * 1e-6;
        // The density of an empty scene is 0, not 0 / 0.
        if exposure > 0.0 {
            count as f64 / exposure
        } else {
            0.0
        }
    }

    fn json(&self, output: &Path, seed: u64, pixel: &PixelParameters) -> serde_json::Value {
        let written = self.written;
        let mut report = serde_json::json!({
            "file": output.display().to_string(),
            "seed": seed,
            "width": self.sensor.width,
            "height": self.sensor.height,
            "start_us": self.start_us,
            "duration_us": self.duration_us,
            "events": written.events,
            "on": written.on,
            "off": written.events - written.on,
            "density_per_px_s": self.per_px_s(written.events),
            "emulate_s": self.seconds,
            "model": self.model.name(),
        });
        match &self.source {
            Source::Scene(preset) => report["scene"] = preset.name().into(),
            Source::Video {
                name,
                format,
                frames,
                exposure,
            } => {
                report["video"] = name.as_str().into();
                report["video_format"] = (*format).into();
                report["frames"] = (*frames).into();
                report["response"] = exposure.response.name().into();
                report["white_lux"] = exposure.white_lux.into();
                report["flare"] = exposure.flare.into();
            }
        }
        if let Some(stage) = &self.readout {
            let lost = stage.readout.losses();
            report["camera"] = stage.camera.map(|camera| camera.name).into();
            report["readout"] = readout::json(&stage.parameters);
            report["lost_unread"] = lost.unread.into();
            report["lost_link"] = lost.link.into();
        }
        if let Some(truth) = &self.truth {
            report["truth"] = truth.path.display().to_string().into();
            report["truth_frames"] = truth.frames.into();
            let causes = |counts| serde_json::Value::from_iter(by_cause(counts));
            report["causes"] = truth.causes.map(causes).into();
        }
        if let Some(samples) = self.samples {
            report["samples_per_px_s"] = self.per_px_s(samples).into();
            report["pixel"] = pixel::json(pixel);
        }
        report
    }

    fn table(&self, output: &Path, seed: u64) -> String {
        let Written { events, on } = self.written;
        let model = self.model.name();
        let mut table = match &self.source {
            Source::Scene(preset) => vec![(
                "scene",
                format!("{}, seed {seed}, model {model}", preset.name()),
            )],
            Source::Video {
                name,
                format,
                frames,
                exposure,
            } => vec![
                (
                    "video",
                    format!("{name} ({format}), seed {seed}, model {model}"),
                ),
                ("frames", frames.to_string()),
                (
                    "light",
                    format!(
                        "{}, white at {} lx, flare {}",
                        exposure.response.name(),
                        exposure.white_lux,
                        exposure.flare
                    ),
                ),
            ],
        };
        let Sensor { width, height } = self.sensor;
        table.extend([
            ("file", output.display().to_string()),
            ("sensor", format!("{width} x {height}")),
            ("duration", format!("{} s", self.duration_us as f64 * 1e-6)),
            ("events", format!("{events} ({on} on, {} off)", events - on)),
            (
                "density",
                format!("{:.3} events/px/s", self.per_px_s(events)),
            ),
        ]);
        if let Some(stage) = &self.readout {
            let camera = stage
                .camera
                .map_or("by its parameters", |camera| camera.name);
            let lost = stage.readout.losses();
            table.push(("readout", camera.to_owned()));
            table.push((
                "lost",
                format!("{} unread, {} at the link", lost.unread, lost.link),
            ));
        }
        if let Some(truth) = &self.truth {
            table.push(("truth", truth.path.display().to_string()));
            if let Some(frames) = truth.frames {
                table.push(("frames", format!("{frames} of the truth")));
            }
            let causes = match truth.causes {
                Some(counts) => {
                    let causes: Vec<String> = by_cause(counts)
                        .map(|(name, count)| format!("{count} {name}"))
                        .collect();
                    causes.join(", ")
                }
                None => "not known to model 1".to_owned(),
            };
            table.push(("causes", causes));
        }
        if let Some(samples) = self.samples {
            table.push((
                "sampled",
                format!("{:.0} times/px/s", self.per_px_s(samples)),
            ));
        }
        table.push(("took", format!("{:.2} s", self.seconds)));
        rows(table)
    }
}

/// Lists the scenes with what they have by default.
fn listed() -> Vec<Listed> {
    let listed = |preset: &Preset| {
        let config = SceneConfig::new(*preset, 1);
        Listed {
            scene: preset.name(),
            about: preset.about(),
            width: config.sensor.width,
            height: config.sensor.height,
            duration_us: config.duration_us,
        }
    };
    PRESETS.iter().map(listed).collect()
}

/// Lists the scenes, one line each: name and description.
fn scenes() -> String {
    PRESETS
        .iter()
        .map(|preset| format!("{:<24}{}\n", preset.name(), preset.about()))
        .collect()
}

/// Returns the names of causes with the numbers of their events.
fn by_cause(counts: [u64; Cause::ALL.len()]) -> impl Iterator<Item = (&'static str, u64)> {
    Cause::ALL.map(Cause::name).into_iter().zip(counts)
}
