//! `eecvs view`: shows a recording or frames as moving pictures, original beside decoded.

use std::io::{IsTerminal, stdout};
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use clap::Args;
use eecvs::frame_file::LinkReport;
use eecvs_cli::folder::RunFolder;
use eecvs_cli::memory::look_for;
use eecvs_cli::options::{OutputOptions, ReadingOptions, TimeOptions, tell_confidences, tell_link};
use eecvs_cli::output::{Place, rows};
use eecvs_cli::progress::Progress;
use eecvs_cli::say;
use eecvs_cli::stop::stop_on_signals;
use eecvs_nostd::Sensor;
use event_files::input::piped::{is_stream, name_of};
use event_files::output::{Kind, is_same};
use event_pictures::frame_picture::FrameStyle;
use serde::Serialize;

use crate::view::frames::Frames;
use crate::view::gif::{self, Gif};
use crate::view::input::Input;
use crate::view::keys::Keys;
use crate::view::palette::{Palette, is_dumb};
use crate::view::picture::{Look, default_upscale};
use crate::view::png::{Pngs, is_numbered};
use crate::view::slices::{Grid, Slices};
use crate::view::terminal::{self, Room, Terminal, Text};
use crate::view::{Played, Screen, Scrub, play};

/// Play a recording or frames, original beside decoded
///
/// Each picture shows a slice of time: per pixel the sum of the polarities, positive in blue and negative in
/// orange, darker for larger sums. Two files give three panels: original, decoded, and decoded minus original. Both
/// files are cut into the same slices by their own event times, starting at --from-us or else at the first event of
/// FILE. A stretch without events is shortened to one second of playback.
///
/// In a terminal, space pauses and goes on, a full stop shows the next frame and pauses, the arrows go a second (left,
/// right) or ten seconds (down, up, and the keys for pages) of playback back and on, home goes to the start, and q ends,
/// as does what is beyond the end. Files of frames have an index, so that this takes no time; other recordings are read
/// again up to there.
#[derive(Debug, Args)]
pub struct View {
    /// Recording of any format, or file of frames
    file: PathBuf,

    /// Recording or file of frames to show beside FILE, e.g. what `eecvs encode` made of it
    #[arg(value_name = "DECODED")]
    decoded: Option<PathBuf>,

    /// Write an animated GIF (OUT.gif), the first frame (OUT.png), or every frame as a PNG in a folder
    /// (OUT/) instead of playing in the terminal. The folder must be empty; --overwrite removes the frames of an
    /// earlier run
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,

    /// Seconds of the recording per second of playback [default: 0.1, or 1 for a pipe]
    #[arg(long, value_name = "S", value_parser = speed, conflicts_with = "slice_us")]
    speed: Option<f64>,

    /// Frames per second
    #[arg(long, value_name = "N", default_value = "30",
          value_parser = clap::value_parser!(u32).range(1..=240))]
    fps: u32,

    /// Duration of a slice in microseconds, instead of --speed [default: speed / fps]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u64).range(1..))]
    slice_us: Option<u64>,

    #[command(flatten)]
    times: TimeOptions,

    /// Stop after N frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,

    /// Absolute sum that gets the darkest colour
    #[arg(long, value_name = "N", default_value = "4",
          value_parser = clap::value_parser!(u32).range(1..=100))]
    clip: u32,

    /// Side in picture pixels of the square drawn per sensor pixel [default: the smallest that makes the picture at
    /// least 480 wide]
    #[arg(long, value_name = "N", requires = "output",
          value_parser = clap::value_parser!(u16).range(1..=64))]
    upscale: Option<u16>,

    /// Columns of the terminal to use; if stdout is not a terminal, frames are written as text, one below the other
    #[arg(long, value_name = "N", conflicts_with = "output",
          value_parser = clap::value_parser!(u16).range(1..=4096))]
    terminal_columns: Option<u16>,

    /// Colours of the terminal [default: as its variables NO_COLOR, COLORTERM and TERM request]
    #[arg(long, value_enum, value_name = "HOW", conflicts_with = "output")]
    colours: Option<Palette>,

    #[command(flatten)]
    reading: ReadingOptions,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table of what was written
    #[arg(long, requires = "output")]
    json: bool,
}

/// Summary of what was written; the fields are JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
struct Summary {
    /// Number of frames.
    frames: u64,
    /// Duration of a slice in us.
    slice_us: u64,
    /// Start of slice 0, in us of the recording.
    from_us: u64,
    /// Number of events of FILE in the frames.
    events: u64,
    /// Number of events of DECODED in the frames.
    decoded_events: u64,
    /// Duration of the omitted stretches without events, in us.
    skipped_us: u64,
}

fn speed(text: &str) -> Result<f64> {
    let speed: f64 = text.parse().context("it is not a number")?;
    ensure!(
        (1e-6..=1e6).contains(&speed),
        "it must be from 0.000001 to 1000000"
    );
    Ok(speed)
}

impl View {
    /// Plays to the end, or until Ctrl-C, after which an output file is complete and valid.
    ///
    /// # Errors
    /// Fails if a file cannot be read or has no events, if the output cannot be written, or if there is neither a
    /// terminal nor an output.
    pub fn run(self) -> Result<()> {
        self.times.check("eecvs view");
        let name = self.file.display();
        ensure!(
            self.output.is_some() || self.terminal_columns.is_some() || stdout().is_terminal(),
            "{name}: stdout is not a terminal: give -o OUT.gif, OUT.png or OUT/, or \
             --terminal-columns N"
        );
        if let Some(output) = &self.output {
            self.check(output)?;
        }
        let reading = self.reading.reading();
        let mut original = Input::open(&self.file, &reading)?;
        let mut decoded = match &self.decoded {
            Some(path) => Some(Input::open(path, &reading)?),
            None => None,
        };
        let first_us = original
            .first_us()
            .or_else(|| decoded.as_mut().and_then(Input::first_us));
        let sensor = decoded.as_ref().map_or(original.sensor(), |decoded| {
            larger(original.sensor(), decoded.sensor())
        });
        look_for(sensor, &name.to_string())?;
        let grid = Grid {
            from_us: self.times.from_us.or(first_us).unwrap_or(0),
            to_us: self.times.to_us,
            slice_us: self.slice_us(),
        };
        if let Some(times) = self.times.times() {
            for input in iter::once(&mut original).chain(&mut decoded) {
                input.seek(times.clone())?;
            }
        }
        let stop = stop_on_signals();
        // The screen comes first: an unusable terminal or name must be reported before a long search for events.
        let origin_us = first_us.unwrap_or(grid.from_us);
        let panels = if decoded.is_some() { 3 } else { 1 };
        let screen = self.screen(sensor, panels, origin_us, &stop)?;
        let slices = |input| Slices::new(input, grid, sensor, Arc::clone(&stop));
        let empty_max = u64::from(self.fps);
        let mut frames = Frames::new(grid, empty_max, slices(original), decoded.map(slices));
        let limit = if self.is_one_picture() {
            1
        } else {
            self.frames.unwrap_or(u64::MAX)
        };
        let mut missing = Vec::new();
        let (mut is_scrubbed, mut is_lossy) = (false, false);
        let mut open = |before: &Frames, from_us: u64| -> Result<Frames> {
            is_scrubbed = true;
            is_lossy |= has_loss(before);
            let grid = Grid { from_us, ..grid };
            let times = from_us..grid.to_us.unwrap_or(u64::MAX);
            let slices = |path: &Path| -> Result<Slices> {
                let mut input = Input::open(path, &reading)?;
                input.seek(times.clone())?;
                Ok(Slices::new(input, grid, sensor, Arc::clone(&stop)))
            };
            let decoded = self.decoded.as_deref().map(slices).transpose()?;
            Ok(Frames::new(grid, empty_max, slices(&self.file)?, decoded))
        };
        let scrub = (self.output.is_none() && self.is_seekable()).then_some(Scrub {
            start_us: grid.from_us,
            open: &mut open,
        });
        let progress = Progress::new("frames");
        let played = play(&mut frames, screen, limit, &stop, scrub, &mut |count| {
            // In a terminal, a line of text below the frames shows the progress.
            if self.output.is_some() {
                progress.set(count);
            }
        })?;
        drop(progress);
        self.add_missing(&frames, &mut missing);
        if !is_scrubbed {
            self.warn_of_clocks(&frames, &played);
        }
        if is_lossy && missing.is_empty() {
            missing.push(anyhow!(
                "{name}: something was damaged or left out of what was shown before: `eecvs info` says what"
            ));
        }
        let link = first_of(missing);
        if let Some(failure) = played.failure {
            return Err(failure);
        }
        let is_stopped = stop.load(Ordering::Relaxed);
        ensure!(
            played.frames > 0 || is_stopped,
            "{name}: no events{}",
            if self.times.from_us.is_some() || self.times.to_us.is_some() {
                " at these times: `eecvs info` prints the first and the last"
            } else {
                ""
            }
        );
        let Some(output) = &self.output else {
            return link;
        };
        let summary = Summary {
            frames: played.frames,
            slice_us: grid.slice_us,
            from_us: grid.from_us,
            events: played.events,
            decoded_events: played.decoded_events,
            skipped_us: frames.skipped_us(),
        };
        let place = Place::beside([output.as_path()]);
        place.tell(self.json, &summary, || {
            table(&summary, self.decoded.is_some())
        })?;
        link
    }

    /// Returns whether the inputs can be read again; stdin and pipes cannot.
    fn is_seekable(&self) -> bool {
        let mut inputs = iter::once(&self.file).chain(&self.decoded);
        inputs.all(|path| !is_stream(path))
    }

    /// Refuses an output that would replace an existing file or an input.
    fn check(&self, output: &Path) -> Result<()> {
        let inputs = iter::once(&self.file).chain(&self.decoded);
        if !self.is_folder() {
            let inputs = inputs.map(PathBuf::as_path);
            return self.overwrite.check(output, Kind::Picture, inputs);
        }
        let name = output.display();
        for input in inputs.clone() {
            ensure!(
                !is_same(input, output),
                "{name}: is the same file as the input {}: give the output another name",
                input.display()
            );
        }
        self.pngs(output)?
            .refuse_inputs(inputs.map(PathBuf::as_path))
    }

    fn pngs(&self, folder: &Path) -> Result<RunFolder> {
        RunFolder::check(folder, self.overwrite.overwrite, is_numbered)
    }

    fn slice_us(&self) -> u64 {
        // The ranges of both options keep it at 1e12 or below.
        let usual = if is_stream(&self.file) { 1.0 } else { 0.1 };
        let by_speed = (self.speed.unwrap_or(usual) * 1e6 / f64::from(self.fps)).round() as u64;
        self.slice_us.unwrap_or(by_speed).max(1)
    }

    fn ending(&self) -> String {
        let ending = self.output.as_deref().and_then(Path::extension);
        ending
            .unwrap_or_default()
            .to_string_lossy()
            .to_ascii_lowercase()
    }

    fn is_folder(&self) -> bool {
        self.output.as_deref().is_some_and(|path| {
            let ends_so = path.to_string_lossy().ends_with(std::path::is_separator);
            ends_so || path.is_dir()
        })
    }

    fn is_one_picture(&self) -> bool {
        !self.is_folder() && self.ending() == "png"
    }

    fn screen(
        &self,
        sensor: Sensor,
        panels: usize,
        origin_us: u64,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn Screen>> {
        let Some(output) = &self.output else {
            let look = terminal::Look {
                clip: self.clip,
                origin_us,
                palette: self
                    .colours
                    .unwrap_or_else(|| Palette::of_terminal(|name| std::env::var(name).ok())),
            };
            let columns = self.terminal_columns.map(usize::from);
            // The cursor of a dumb terminal cannot be moved.
            if !stdout().is_terminal() || is_dumb(|name| std::env::var(name).ok()) {
                let columns = columns.unwrap_or(room(None).columns);
                return Ok(Box::new(Text::new(stdout(), look, columns)));
            }
            let room = Box::new(move || room(columns));
            // Stdin may be the recording.
            let keys = if self.is_seekable() {
                Keys::open()
            } else {
                None
            };
            return Ok(Box::new(Terminal::new(
                stdout(),
                self.fps,
                look,
                room,
                keys,
                Arc::clone(stop),
            )));
        };
        let upscale = match self.upscale {
            Some(upscale) => usize::from(upscale),
            None => default_upscale(sensor, panels),
        };
        let look = Look {
            style: FrameStyle {
                clip: self.clip,
                upscale,
            },
            origin_us,
        };
        if self.is_folder() {
            return Ok(Box::new(Pngs::folder(self.pngs(output)?, look)?));
        }
        match self.ending().as_str() {
            "gif" => {
                ensure!(
                    self.fps <= gif::FPS_MAX,
                    "{}: browsers show a GIF at {} frames a second at most: give a smaller --fps",
                    output.display(),
                    gif::FPS_MAX
                );
                Ok(Box::new(Gif::new(output, self.fps, look)))
            }
            "png" => Ok(Box::new(Pngs::file(output, look))),
            _ => bail!(
                "{}: give a name that ends in .gif or .png, or a folder, which ends in /",
                output.display()
            ),
        }
    }

    /// Adds what was not shown of the inputs.
    fn add_missing(&self, frames: &Frames, all: &mut Vec<Error>) {
        let inputs = [
            (Some(&self.file), Some(frames.original())),
            (self.decoded.as_ref(), frames.decoded()),
        ];
        for (path, slices) in inputs {
            let (Some(path), Some(slices)) = (path, slices) else {
                continue;
            };
            let name = name_of(path);
            tell_confidences(&name, &slices.input().confidences());
            let report = slices.input().report();
            if let Some(Err(error)) = report.map(|report| tell_link(&name, report)) {
                all.push(error);
            }
            let counts = [
                (slices.late(), "are too far out of time order to be shown"),
                (slices.outside(), "lie outside the sensor"),
            ];
            for (count, what) in counts.into_iter().filter(|(count, _)| *count > 0) {
                all.push(anyhow!("{name}: {count} events {what}"));
            }
        }
    }

    /// Says so if the two inputs have no time in common.
    fn warn_of_clocks(&self, frames: &Frames, played: &Played) {
        if let Some(decoded) = &self.decoded
            && frames.shared() == 0
            && played.frames > 0
        {
            say!(
                "eecvs: {}: no frame has events of both files: their clocks differ, or they were \
                 recorded at different times",
                decoded.display()
            );
        }
    }
}

/// Returns whether something of the inputs was not shown.
fn has_loss(frames: &Frames) -> bool {
    let inputs = iter::once(frames.original()).chain(frames.decoded());
    inputs.into_iter().any(|slices| {
        let is_damaged = slices.input().report().is_some_and(LinkReport::has_loss);
        is_damaged || slices.late() + slices.outside() > 0
    })
}

/// Reports errors, one line each, but for the first, which is returned.
fn first_of(errors: Vec<Error>) -> Result<()> {
    let mut errors = errors.into_iter();
    let first = errors.next();
    for error in errors {
        say!("eecvs: {error:#}");
    }
    first.map_or(Ok(()), Err)
}

/// Returns the larger width and height of two sensors, which may differ e.g. for text without a header.
fn larger(a: Sensor, b: Sensor) -> Sensor {
    Sensor {
        width: a.width.max(b.width),
        height: a.height.max(b.height),
    }
}

/// Returns the size of the terminal, with `columns` as its width if given.
fn room(columns: Option<usize>) -> Room {
    let (height, width) = console::Term::stdout().size_checked().unwrap_or((24, 80));
    Room {
        columns: columns.unwrap_or(usize::from(width)),
        rows: Some(usize::from(height)),
    }
}

fn table(summary: &Summary, has_decoded: bool) -> String {
    let mut lines = vec![
        ("frames", summary.frames.to_string()),
        ("  each of", format!("{} us", summary.slice_us)),
        ("  from", format!("{} us", summary.from_us)),
        ("events", summary.events.to_string()),
    ];
    if has_decoded {
        lines.push(("events decoded", summary.decoded_events.to_string()));
    }
    let skipped = format!("{} us", summary.skipped_us);
    lines.push(("left out without events", skipped));
    rows(lines)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        view: View,
    }

    fn parse(line: &str) -> Result<View, clap::Error> {
        Command::try_parse_from(line.split(' ')).map(|command| command.view)
    }

    #[test]
    fn a_slice_is_what_a_frame_has_time_for() {
        for (line, slice_us) in [
            ("x a", 3_333),
            ("x a --speed 1 --fps 50", 20_000),
            ("x a --slice-us 7 --fps 50", 7),
            ("x a --speed 0.000001", 1),
        ] {
            assert_eq!(parse(line).unwrap().slice_us(), slice_us, "{line}");
        }
    }

    #[test]
    fn outputs_are_told_by_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let existing = folder.path().join("x.png");
        std::fs::create_dir(&existing).unwrap();
        let line = format!("x a -o {}", existing.display());
        let view = parse(&line).unwrap();
        assert!(view.is_folder() && !view.is_one_picture());
        assert!(parse("x a -o new/").unwrap().is_folder());
        assert!(parse("x a -o new.PNG").unwrap().is_one_picture());
        assert!(!parse("x a -o new.gif").unwrap().is_one_picture());
    }

    #[test]
    fn usage_is_checked() {
        for wrong in [
            "x",
            "x a --speed 0",
            "x a --speed nan",
            "x a --speed 1 --slice-us 5",
            "x a --fps 0",
            "x a --upscale 2",
            "x a --json",
            "x a --terminal-columns 80 -o b.gif",
            "x a --frames 0",
            "x a --clip 101 -o b.gif",
        ] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
