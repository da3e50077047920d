//! `eecvs emulate`: writes the events of a seeded scene, or of a video, to a recording.

mod input;
mod pixel;
mod readout;
mod video;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use eecvs_cli::options::{FormatOptions, OutputOptions};
use eecvs_cli::output::{Place, print, print_json, rows};
use eecvs_cli::progress::Progress;
use eecvs_cli::values::model;
use eecvs_nostd::{Event, Polarity, Sensor};
use event_emulator::{
    Camera, Emulator, Exposure, Model, PRESETS, PixelParameters, Preset, Readout,
    ReadoutParameters, SceneConfig, VideoEmulator,
};
use event_files::input::piped::name_of;
use event_files::{EventReader, EventWriter, file_of};
use input::{Input, InputParser};
use pixel::PixelOptions;
use rayon::{ThreadPool, ThreadPoolBuilder};
use readout::ReadoutOptions;
use serde::Serialize;
use video::{VideoOptions, tell_motion};

/// Emulate a seeded scene, or what a camera sees of a video, and write the events to a recording
#[derive(Debug, Clone, clap::Args)]
pub struct Emulate {
    /// Scene type, or a video: a Y4M file, a folder of PNG files, .npy or .npz of frames x rows x columns, a recording
    /// with frames (AEDAT 4, a ROS bag), or - for Y4M or .npy on stdin, and gray pixels with --size
    #[arg(value_parser = InputParser, value_name = "SCENE|VIDEO", required_unless_present_any = ["list", "print_pixel"])]
    input: Option<Input>,

    /// List the scenes, one per line with a description, and exit; with --json, as an array of objects
    #[arg(long, conflicts_with_all = ["input", "output"])]
    list: bool,

    /// Print the pixel of model 2 as the flags make it, as a file for --pixel, and exit
    #[arg(long, conflicts_with_all = ["input", "output", "list", "json"])]
    print_pixel: bool,

    /// Recording to write; the extension names the format
    #[arg(short, long, value_name = "FILE", required_unless_present_any = ["list", "print_pixel"])]
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

    /// Model of the pixel [default: 1 for scenes, 2 for videos, which have no other]
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

/// Counts of the events written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Written {
    events: u64,
    on: u64,
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
        config.model = self.model.unwrap_or(Model::Steps);
        if config.model == Model::Steps {
            ensure!(
                self.pixel.is_default() && self.threads.is_none(),
                "the pixel's flags and --threads are of model 2: give --model 2"
            );
        }
        let mut emulator = event_emulator::emulate_with(config, pixel)?;
        let mut writer = event_files::create_as(output, format, config.sensor)?;
        let begun = Instant::now();
        let pool = self.pool(config.model)?;
        emulator = emulator.parallel(pool.is_some());
        let elapsed_us = Emulator::elapsed_us;
        let written = write_events(
            &mut emulator,
            elapsed_us,
            readout.as_mut(),
            writer.as_mut(),
            pool.as_ref(),
        )?;
        writer.finish()?;
        let emulated = Emulated {
            readout,
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
        let inputs = [file_of(path)].into_iter().chain(self.video.files());
        self.overwrite.check(output, self.format.kind(), inputs)?;
        let format = self.format.of(output)?;
        let name = name_of(path);
        if self.model == Some(Model::Steps) {
            bail!("{name}: model 1 has scenes only: give --model 2 for a video");
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
        let mut writer = event_files::create_as(output, format, emulator.sensor())?;
        let pool = self.pool(Model::Physical)?;
        let mut emulator = emulator.parallel(pool.is_some());
        let elapsed_us = VideoEmulator::elapsed_us;
        let written = write_events(
            &mut emulator,
            elapsed_us,
            readout.as_mut(),
            writer.as_mut(),
            pool.as_ref(),
        )?;
        writer.finish()?;
        tell_motion(&name, emulator.motion(), emulator.elapsed_us());
        let emulated = Emulated {
            readout,
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

/// Writes every event of an emulation, batch by batch and through the readout if there is one, and counts them. The threads
/// of `pool` read, this one writes.
fn write_events<R: EventReader>(
    emulator: &mut R,
    elapsed_us: impl Fn(&R) -> u64,
    mut stage: Option<&mut Stage>,
    writer: &mut dyn EventWriter,
    pool: Option<&ThreadPool>,
) -> anyhow::Result<Written> {
    let progress = Progress::new("ms emulated");
    let mut written = Written::default();
    let mut events: Vec<Event> = Vec::with_capacity(event_files::BATCH_EVENTS);
    let mut fired: Vec<Event> = Vec::new();
    loop {
        let read = match pool {
            Some(pool) => pool.install(|| emulator.read(&mut events))?,
            None => emulator.read(&mut events)?,
        };
        if let Some(stage) = &mut stage {
            std::mem::swap(&mut events, &mut fired);
            stage.readout.push(&fired, None, &mut events, None);
            fired.clear();
            if read == 0 {
                stage.readout.finish(&mut events, None);
            }
        }
        writer.write(&events)?;
        written.events += events.len() as u64;
        let on = events.iter().filter(|e| e.polarity == Polarity::On);
        written.on += on.count() as u64;
        events.clear();
        if read == 0 {
            break;
        }
        progress.set(elapsed_us(emulator) / 1_000);
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};
    use event_types::stream::Response;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        emulate: Emulate,
    }

    fn parse(line: &str) -> Result<Emulate, clap::Error> {
        let words = std::iter::once("emulate").chain(line.split_whitespace());
        Line::try_parse_from(words).map(|line| line.emulate)
    }

    /// A recording in memory; writing fails once it holds more than `room` events.
    struct Memory {
        events: Vec<Event>,
        room: usize,
    }

    impl EventWriter for Memory {
        fn write(&mut self, events: &[Event]) -> event_types::stream::Result<()> {
            self.events.extend_from_slice(events);
            event_types::ensure!(self.events.len() <= self.room, CannotHold, "full");
            Ok(())
        }

        fn finish(self: Box<Self>) -> event_types::stream::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn flags_are_checked() {
        Line::command().debug_assert();
        let ok = "indoor-flying -o a.csv --seed 9 --width 2048 --height 1 --duration-us 0 --json";
        let parsed = parse(ok).unwrap();
        assert_eq!(parsed.input, Some(Input::Scene(Preset::IndoorFlying)));
        assert_eq!((parsed.width, parsed.height), (Some(2048), Some(1)));
        assert!(parse("--list").unwrap().list);
        for bad in [
            "",
            "indoor-flying",
            "-o a.csv",
            "indoor-flying -o a.csv --width 10",
            "indoor-flying -o a.csv --width 0 --height 1",
            "indoor-flying -o a.csv --width 1 --height 2049",
            "indoor-flying -o a.csv --duration-us -1",
        ] {
            assert!(parse(bad).is_err(), "{bad}");
        }
        let message = parse("moon -o a.csv").unwrap_err().to_string();
        assert!(
            PRESETS.iter().all(|p| message.contains(p.name())),
            "{message}"
        );
    }

    #[test]
    fn list_has_a_line_about_every_scene() {
        let list = scenes();
        assert_eq!(list.lines().count(), PRESETS.len());
        for (line, preset) in list.lines().zip(PRESETS) {
            let about = line.strip_prefix(preset.name()).unwrap();
            assert!(about.trim().len() > 10, "{line}");
        }
        let json = serde_json::to_value(listed()).unwrap();
        let scenes = json.as_array().unwrap();
        assert_eq!(scenes.len(), PRESETS.len());
        for (scene, preset) in scenes.iter().zip(PRESETS) {
            let expected = serde_json::json!({
                "scene": preset.name(),
                "about": preset.about(),
                "width": 346,
                "height": 260,
                "duration_us": 1_000_000,
            });
            assert_eq!(*scene, expected);
        }
    }

    #[test]
    fn every_event_is_written_and_counted() {
        let mut config = SceneConfig::new(Preset::Motorcycle, 4);
        config.duration_us = 30_000;
        let mut writer = Memory {
            events: Vec::new(),
            room: usize::MAX,
        };
        let mut emulator = event_emulator::emulate(config).unwrap();
        let written =
            write_events(&mut emulator, Emulator::elapsed_us, None, &mut writer, None).unwrap();
        assert_eq!(written.events, writer.events.len() as u64);
        assert!(written.on > 0 && written.on < written.events);

        let mut again = event_emulator::emulate(config).unwrap();
        let mut expected = Vec::new();
        while again.read(&mut expected).unwrap() > 0 {}
        assert_eq!(writer.events, expected);

        writer.events.clear();
        writer.room = 10;
        let mut emulator = event_emulator::emulate(config).unwrap();
        assert!(
            write_events(&mut emulator, Emulator::elapsed_us, None, &mut writer, None).is_err()
        );
    }

    /// A night of 2 events per pixel and second.
    fn night() -> Emulated {
        Emulated {
            source: Source::Scene(Preset::OutdoorDark),
            readout: None,
            sensor: Preset::OutdoorDark.sensor(),
            start_us: 0,
            duration_us: 1_000_000,
            model: Model::Steps,
            samples: None,
            written: Written {
                events: 179_920,
                on: 89_000,
            },
            seconds: 0.5,
        }
    }

    #[test]
    fn report_is_one_json_object_or_a_table() {
        let (file, pixel) = (Path::new("x/night.csv"), PixelParameters::default());
        let mut night = night();
        let value = night.json(file, 7, &pixel);
        assert_eq!(value["scene"], "outdoor-dark");
        assert_eq!(value["off"], 90_920);
        assert_eq!(value["density_per_px_s"], 2.0);
        assert!(value.get("pixel").is_none());
        assert!(night.table(file, 7).contains("file      x/night.csv\n"));
        night.duration_us = 0;
        assert_eq!(night.json(file, 7, &pixel)["density_per_px_s"], 0.0);
        night.source = Source::Video {
            name: "a.y4m".to_owned(),
            format: "y4m",
            frames: 31,
            exposure: Exposure::of(Response::Srgb),
        };
        let value = night.json(file, 7, &pixel);
        assert_eq!(
            (&value["video"], &value["frames"]),
            (&"a.y4m".into(), &31.into())
        );
        assert_eq!(
            (&value["response"], &value["white_lux"]),
            (&"srgb".into(), &300.0.into())
        );
        assert!(
            night
                .table(file, 7)
                .contains("light     srgb, white at 300 lx")
        );
    }

    #[test]
    fn model_2_gives_the_same_file_with_any_number_of_threads() {
        let dir = tempfile::tempdir().unwrap();
        let run = |name: &str, flags: &str| {
            let file = dir.path().join(name);
            let line = format!(
                "motorcycle -o {} --width 70 --height 50 --duration-us 30000 --json {flags}",
                file.display()
            );
            parse(&line)
                .unwrap()
                .run()
                .map(|()| std::fs::read(file).unwrap())
        };
        let one = run("1.csv", "--model 2 --threads 1").unwrap();
        assert!(one.len() > 1_000);
        assert_eq!(run("2.csv", "--model 2 --threads 2").unwrap(), one);
        assert_eq!(run("3.csv", "--model 2").unwrap(), one);
        assert_ne!(run("4.csv", "--model 2 --threshold-on 0.5").unwrap(), one);
        assert_ne!(run("5.csv", "--model 1").unwrap(), one);
        for flags in ["--threads 2", "--no-noise", "--model 1 --leak-hz 1"] {
            let error = run("6.csv", flags).unwrap_err().to_string();
            assert!(error.contains("--model 2"), "{error}");
            assert!(!dir.path().join("6.csv").exists());
        }
        let error = run("7.csv", "--model 2 --threshold-on 0").unwrap_err();
        assert!(error.to_string().contains("give 0.01 to 10"), "{error}");
        assert!(!dir.path().join("7.csv").exists());
    }

    #[test]
    fn the_report_of_model_2_has_the_pixel() {
        let night = Emulated {
            model: Model::Physical,
            samples: Some(89_960_000),
            ..night()
        };
        let (file, pixel) = (Path::new("x.csv"), PixelParameters::default());
        let value = night.json(file, 7, &pixel);
        assert_eq!(value["samples_per_px_s"], 1_000.0);
        assert_eq!(value["pixel"]["refractory_us"], 300.0);
        let text = night.table(file, 7);
        assert!(text.contains("sampled   1000 times/px/s"), "{text}");
    }

    #[test]
    fn a_camera_has_its_size_and_loses_what_its_link_does_not_take() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let run = |flags: &str| {
            let line = format!(
                "indoor-flying -o {} --overwrite --duration-us 20000 {flags}",
                path.display()
            );
            parse(&line).unwrap().run().unwrap();
            std::fs::read_to_string(&path).unwrap().lines().count()
        };
        let all = run("--width 128 --height 128");
        let read = run("--camera dvs128 --buffer-events 1000000");
        assert_eq!(read, all);
        let part = run("--camera dvs128 --link-per-us 0.001 --buffer-events 50");
        // A header, what the buffer holds, and what goes over the link in 20 ms.
        assert!((50..=90).contains(&part) && part < all, "{part} of {all}");
        let line = format!(
            "indoor-flying -o {} --overwrite --row-ns -1",
            path.display()
        );
        assert!(parse(&line).unwrap().run().is_err());
    }

    #[test]
    fn a_video_is_a_path_that_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.y4m");
        let line = |rest: &str| {
            format!(
                "{} -o {}/b.csv {rest}",
                path.display(),
                folder.path().display()
            )
        };
        assert!(parse(&line("")).is_err());
        let mut video = b"YUV4MPEG2 W16 H2 F100:1 Ip Cmono\n".to_vec();
        for frame in 0..3_u8 {
            video.extend_from_slice(b"FRAME\n");
            video.extend((0..32).map(|i| 20 + 3 * i * frame));
        }
        std::fs::write(&path, &video).unwrap();
        parse(&line("--no-noise --threads 1"))
            .unwrap()
            .run()
            .unwrap();
        let text = std::fs::read_to_string(folder.path().join("b.csv")).unwrap();
        assert!(text.lines().count() > 50, "{text}");
        let said = |rest: &str| {
            let line = line(&format!("--overwrite {rest}"));
            format!("{:#}", parse(&line).unwrap().run().unwrap_err())
        };
        for (flags, what) in [
            ("--model 1", "model 1 has scenes only"),
            ("--width 16 --height 2", "a size of its own"),
            ("--flare 0", "flare is 0"),
            ("--white 0", "white is 0"),
            ("--leak-hz -1", "give 0 to 1000"),
            (
                "--times nowhere.txt --time-unit s",
                "nowhere.txt: cannot be opened",
            ),
        ] {
            assert!(said(flags).contains(what), "{flags}: {}", said(flags));
        }
        // What was there is still there.
        assert_eq!(
            std::fs::read_to_string(folder.path().join("b.csv")).unwrap(),
            text
        );
        video.pop();
        std::fs::write(&path, &video).unwrap();
        let cut = said("");
        assert!(cut.contains("frame 2 ends after 31 of 32 bytes"), "{cut}");
        assert_eq!(cut.matches("a.y4m").count(), 1, "{cut}");
        let absent = parse("nowhere.y4m -o a.csv").unwrap_err().to_string();
        assert!(absent.contains("'nowhere.y4m' is neither"), "{absent}");
        assert_eq!(
            std::fs::read_to_string(folder.path().join("b.csv")).unwrap(),
            text
        );
        let scene = format!("outdoor-dark -o {}/c.csv --fps 30", folder.path().display());
        let error = parse(&scene).unwrap().run().unwrap_err();
        assert!(error.to_string().contains("flags of videos"), "{error}");
        assert!(parse("- --fps 0 -o a.csv").is_err());
        assert!(parse("- --times a.txt -o a.csv").is_err());
    }

    /// Videos of ffmpeg's test picture, in 8 and 10 bits, become events, and these frames that decode to the same events.
    #[test]
    fn videos_of_ffmpeg_become_events_and_frames() {
        #[derive(Debug, Parser)]
        struct EncodeLine {
            #[command(flatten)]
            encode: crate::cmd::encode::Encode,
        }

        if std::process::Command::new("ffmpeg")
            .arg("-version")
            .output()
            .is_err()
        {
            eprintln!("skipped: ffmpeg is not there");
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let events_of = |name: &str| {
            let mut reader = event_files::open(&folder.path().join(name), None).unwrap();
            assert_eq!((reader.sensor().width, reader.sensor().height), (96, 64));
            let mut events = Vec::new();
            while reader.read(&mut events).unwrap() > 0 {}
            events
        };
        let mut counts = Vec::new();
        for format in ["yuv420p", "yuv444p", "yuvj422p", "yuv420p10le", "gray"] {
            let made = std::process::Command::new("ffmpeg")
                .args(["-v", "error", "-f", "lavfi"])
                .args(["-i", "testsrc=size=96x64:rate=120:duration=0.5"])
                .args([
                    "-pix_fmt",
                    format,
                    "-strict",
                    "-1",
                    "-f",
                    "yuv4mpegpipe",
                    "-y",
                ])
                .arg(path("in.y4m"))
                .status()
                .unwrap();
            assert!(made.success(), "{format}");
            let line = format!(
                "{} -o {} --no-noise --overwrite",
                path("in.y4m"),
                path("out.raw")
            );
            parse(&line).unwrap().run().unwrap();
            counts.push(events_of("out.raw").len());
        }
        // The same picture, but for what its chroma loses and its bits round.
        let most = counts.iter().max().copied().unwrap();
        assert!(
            counts
                .iter()
                .all(|count| *count > 500 && 10 * count > 9 * most),
            "{counts:?}"
        );
        let line = format!("encode {} -o {}", path("out.raw"), path("out.eecvs"));
        let line = EncodeLine::try_parse_from(line.split_whitespace()).unwrap();
        line.encode.run().unwrap();
        assert_eq!(events_of("out.raw"), events_of("out.eecvs"));
    }

    #[test]
    fn run_names_what_cannot_be() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("scene.unknown");
        let line = format!("outdoor-dark -o {}", file.display());
        let error = parse(&line).unwrap().run().unwrap_err();
        assert!(format!("{error:#}").contains("scene.unknown"), "{error:#}");
        assert!(!file.exists());
        let file = dir.path().join("scene.raw");
        let late = format!("outdoor-dark -o {} --start-us {}", file.display(), u64::MAX);
        let error = parse(&late).unwrap().run().unwrap_err();
        assert!(format!("{error:#}").contains("earlier start"), "{error:#}");
    }
}
