//! `eecvs emulate`: writes a seeded scene to a recording.

mod pixel;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, ensure};
use eecvs_cli::options::{FormatOptions, OutputOptions};
use eecvs_cli::output::{Place, print, print_json};
use eecvs_cli::progress::Progress;
use eecvs_cli::values::{model, preset};
use eecvs_nostd::{Event, Polarity, Sensor};
use event_emulator::{Emulator, Model, PRESETS, PixelParameters, Preset, SceneConfig};
use event_files::{EventReader, EventWriter};
use pixel::PixelOptions;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;

/// Emulate a seeded scene and write its events to a recording
#[derive(Debug, Clone, clap::Args)]
pub struct Emulate {
    /// Scene type
    #[arg(value_parser = preset(), value_name = "SCENE", required_unless_present_any = ["list", "print_pixel"])]
    scene: Option<Preset>,

    /// List the scenes, one per line with a description, and exit; with --json, as an array of objects
    #[arg(long, conflicts_with_all = ["scene", "output"])]
    list: bool,

    /// Print the pixel of model 2 as the flags make it, as a file for --pixel, and exit
    #[arg(long, conflicts_with_all = ["scene", "output", "list", "json"])]
    print_pixel: bool,

    /// Recording to write; the extension names the format
    #[arg(short, long, value_name = "FILE", required_unless_present_any = ["list", "print_pixel"])]
    output: Option<PathBuf>,

    #[command(flatten)]
    format: FormatOptions,

    /// Seed of the scene; the same seed gives the same events on every machine
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Columns of the sensor [default: 346]
    #[arg(long, requires = "height", value_parser = clap::value_parser!(u16).range(1..=2048))]
    width: Option<u16>,

    /// Rows of the sensor [default: 260]
    #[arg(long, requires = "width", value_parser = clap::value_parser!(u16).range(1..=2048))]
    height: Option<u16>,

    /// Duration in microseconds [default: 1000000]
    #[arg(long, value_name = "D")]
    duration_us: Option<u64>,

    /// Time at which the scene starts, in microseconds
    #[arg(long, value_name = "T", default_value_t = 0)]
    start_us: u64,

    /// Model of the pixel
    #[arg(long, value_parser = model(), default_value = "1")]
    model: Model,

    /// Number of threads of model 2; the events do not depend on it [default: the number of cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    #[command(flatten)]
    pixel: PixelOptions,

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
    /// Emulates the scene, writes it and prints the result on stdout.
    ///
    /// # Errors
    /// Fails if the scene cannot exist (its end is beyond 2^64 us), the pixel's file cannot be read or has a value out of
    /// range, a flag of model 2 is given with model 1, the extension is unknown, the file cannot be written, or the
    /// format cannot hold an event.
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
        let (preset, output) = self.scene.zip(self.output.as_ref()).with_context(|| {
            format!(
                "give a scene and -o FILE; the scenes are\n{}",
                scenes().trim_end()
            )
        })?;
        self.overwrite.check(output, self.format.kind(), [])?;
        let format = self.format.of(output)?;
        let mut config = SceneConfig::new(preset, self.seed);
        if let Some((width, height)) = self.width.zip(self.height) {
            config.sensor = Sensor { width, height };
        }
        config.duration_us = self.duration_us.unwrap_or(config.duration_us);
        config.start_us = self.start_us;
        config.model = self.model;
        if config.model == Model::Steps {
            ensure!(
                self.pixel.is_default() && self.threads.is_none(),
                "the pixel's flags and --threads are of model 2: give --model 2"
            );
        }

        let mut emulator = event_emulator::emulate_with(config, &pixel)?;
        let mut writer = event_files::create_as(output, format, config.sensor)?;
        let begun = Instant::now();
        let pool = self.pool()?;
        emulator = emulator.parallel(pool.is_some());
        let written = write_scene(&mut emulator, writer.as_mut(), pool.as_ref())?;
        writer.finish()?;
        let seconds = begun.elapsed().as_secs_f64();
        let samples = emulator.samples();
        let place = Place::beside([output.as_path()]);
        let pixel = samples.map(|samples| (pixel, samples));
        place.print(&format!(
            "{}\n",
            self.report(&config, pixel, written, seconds)
        ))
    }

    /// Returns the threads that the tiles of model 2 are shared by; `None` if this thread does all.
    fn pool(&self) -> anyhow::Result<Option<ThreadPool>> {
        if self.model == Model::Steps || self.threads == Some(1) {
            return Ok(None);
        }
        // 0 threads are as many as there are cores.
        let threads = self.threads.map_or(0, usize::from);
        let pool = ThreadPoolBuilder::new().num_threads(threads).build();
        Ok(Some(pool.context("the threads cannot be started")?))
    }

    /// Formats the result as a table or as JSON; `pixel` has the parameters and the samples of model 2.
    fn report(
        &self,
        config: &SceneConfig,
        pixel: Option<(PixelParameters, u64)>,
        written: Written,
        seconds: f64,
    ) -> String {
        let scene_s = config.duration_us as f64 * 1e-6;
        let exposure = f64::from(config.sensor.pixels()) * scene_s;
        // The density of an empty scene is 0, not 0 / 0.
        let density = if exposure > 0.0 {
            written.events as f64 / exposure
        } else {
            0.0
        };
        let output = self.output.as_deref().unwrap_or_else(|| "".as_ref());
        let samples_hz = |samples: u64| {
            if exposure > 0.0 {
                samples as f64 / exposure
            } else {
                0.0
            }
        };
        if self.json {
            let mut report = serde_json::json!({
                "scene": config.preset.name(),
                "file": output.display().to_string(),
                "seed": config.seed,
                "width": config.sensor.width,
                "height": config.sensor.height,
                "start_us": config.start_us,
                "duration_us": config.duration_us,
                "events": written.events,
                "on": written.on,
                "off": written.events - written.on,
                "density_per_px_s": density,
                "emulate_s": seconds,
                "model": config.model.name(),
            });
            if let Some((pixel, samples)) = pixel {
                report["samples_per_px_s"] = samples_hz(samples).into();
                report["pixel"] = pixel::json(&pixel);
            }
            return report.to_string();
        }
        let sampled = pixel.map_or(String::new(), |(_, samples)| {
            format!("sampled   {:.0} times/px/s\n", samples_hz(samples))
        });
        format!(
            "scene     {}, seed {}, model {}\nfile      {}\nsensor    {} x {}\nduration  {scene_s} s\n\
             events    {} ({} on, {} off)\ndensity   {density:.3} events/px/s\n{sampled}\
             took      {seconds:.2} s",
            config.preset.name(),
            config.seed,
            config.model.name(),
            output.display(),
            config.sensor.width,
            config.sensor.height,
            written.events,
            written.on,
            written.events - written.on,
        )
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

/// Writes every event of a scene, batch by batch, and counts them. The threads of `pool` read, this one writes.
fn write_scene(
    emulator: &mut Emulator,
    writer: &mut dyn EventWriter,
    pool: Option<&ThreadPool>,
) -> anyhow::Result<Written> {
    let progress = Progress::new("ms of scene");
    let mut written = Written::default();
    let mut events: Vec<Event> = Vec::with_capacity(event_files::BATCH_EVENTS);
    loop {
        let read = match pool {
            Some(pool) => pool.install(|| emulator.read(&mut events))?,
            None => emulator.read(&mut events)?,
        };
        if read == 0 {
            break;
        }
        writer.write(&events)?;
        written.events += events.len() as u64;
        let on = events.iter().filter(|e| e.polarity == Polarity::On);
        written.on += on.count() as u64;
        events.clear();
        progress.set(emulator.elapsed_us() / 1_000);
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};

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
        assert_eq!(parsed.scene, Some(Preset::IndoorFlying));
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
        let written = write_scene(&mut emulator, &mut writer, None).unwrap();
        assert_eq!(written.events, writer.events.len() as u64);
        assert!(written.on > 0 && written.on < written.events);

        let mut again = event_emulator::emulate(config).unwrap();
        let mut expected = Vec::new();
        while again.read(&mut expected).unwrap() > 0 {}
        assert_eq!(writer.events, expected);

        writer.events.clear();
        writer.room = 10;
        let mut emulator = event_emulator::emulate(config).unwrap();
        assert!(write_scene(&mut emulator, &mut writer, None).is_err());
    }

    #[test]
    fn report_is_one_json_object_or_a_table() {
        let mut config = SceneConfig::new(Preset::OutdoorDark, 7);
        let mut command = parse("outdoor-dark -o x/night.csv --json").unwrap();
        let written = Written {
            events: 179_920,
            on: 89_000,
        };
        let text = command.report(&config, None, written, 0.5);
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["scene"], "outdoor-dark");
        assert_eq!(value["off"], 90_920);
        assert_eq!(value["density_per_px_s"], 2.0);
        config.duration_us = 0;
        let none = Written::default();
        let value: serde_json::Value =
            serde_json::from_str(&command.report(&config, None, none, 0.0)).unwrap();
        assert_eq!(value["density_per_px_s"], 0.0);
        command.json = false;
        assert!(
            command
                .report(&config, None, none, 0.0)
                .contains("night.csv")
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
        let mut command = parse("outdoor-dark -o x.csv --json --model 2").unwrap();
        let config = SceneConfig::new(Preset::OutdoorDark, 7);
        let pixel = Some((PixelParameters::default(), 89_960_000));
        let written = Written::default();
        let text = command.report(&config, pixel, written, 0.5);
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["samples_per_px_s"], 1_000.0);
        assert_eq!(value["pixel"]["refractory_us"], 300.0);
        command.json = false;
        let text = command.report(&config, pixel, written, 0.5);
        assert!(text.contains("sampled   1000 times/px/s"), "{text}");
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
