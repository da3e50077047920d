//! Flags shared by several subcommands.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use clap::error::ErrorKind;
use eecvs::frame_file::LinkReport;
use eecvs::reconstruct::recover::Confidences;
use eecvs::thresholds_file::ThresholdsFile;
use eecvs::window_limit::WindowLimit;
use eecvs::work_limit::WorkLimit;
use eecvs_nostd::{Sensor, Thresholds};
use event_files::input::growing::Follow;
use event_files::output::Kind;
use event_files::{BadEvents, Columns, FORMATS, Format, Reading, TimeUnit};

use crate::say;
use crate::stop::stop_on_signals;

/// Returns the parser of a sensor width or height.
fn side() -> RangedU64ValueParser<u16> {
    RangedU64ValueParser::new().range(1..=u64::from(Sensor::SIDE_MAX))
}

/// Properties of a recording that its file may not state.
#[derive(Debug, Clone, Default, Args)]
pub struct ReadingOptions {
    /// Sensor width in pixels, for formats that do not store it
    #[arg(long, value_name = "W", requires = "height", value_parser = side())]
    pub width: Option<u16>,

    /// Sensor height in pixels, for formats that do not store it
    #[arg(long, value_name = "H", requires = "width", value_parser = side())]
    pub height: Option<u16>,

    /// Unit of the recording's times, for formats that do not state it
    #[arg(long, value_name = "UNIT", value_parser = time_unit)]
    pub time_unit: Option<TimeUnit>,

    /// Microseconds to add to every time of the recording, for example if it has times before 0
    #[arg(
        long,
        value_name = "D",
        default_value_t = 0,
        allow_negative_numbers = true
    )]
    pub time_offset_us: i64,

    /// Columns of a table: one letter each (t, x, y, p, or - to skip a column), as in -xytp; or their names, as in
    /// t=time,x=col,y=row,p=on
    #[arg(long, value_name = "COLUMNS", value_parser = Columns::parse)]
    pub columns: Option<Columns>,

    /// Leave out and count invalid events (outside the sensor, values missing) instead of ending with an error at the
    /// first one
    #[arg(long)]
    pub leave_out_bad_events: bool,

    /// The largest windows of frames.
    #[command(flatten)]
    pub window_limit: WindowLimitOptions,

    /// The most work that their event times may cost.
    #[command(flatten)]
    pub work_limit: WorkLimitOptions,
}

/// How many events a window of frames may have.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct WindowLimitOptions {
    /// Largest number of events in a window of .eecvs frames; frames of windows with more are left out and counted
    /// [default: what a sensor can send in the window's time: 1048576, or 1100 per microsecond if that is more, and
    /// from one pixel 65536 and 1 more every 10 us]
    #[arg(long, value_name = "N",
          value_parser = clap::value_parser!(u32).range(1..=eecvs_nostd::window::EVENTS_MAX as i64))]
    max_events_per_window: Option<u32>,
}

impl WindowLimitOptions {
    /// Returns the limit.
    #[must_use]
    pub fn limit(self) -> WindowLimit {
        self.max_events_per_window.into()
    }
}

/// How much work the event times of a window of coefficients may cost.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct WorkLimitOptions {
    /// Most work that finding the event times of a window of coefficients may cost, in millions of steps, which are
    /// counted, not timed: about six a millisecond of one core. Pixels beyond it get rough times at once and are
    /// counted [default: 50000]
    #[arg(long, value_name = "N")]
    max_work_per_window: Option<u32>,
}

impl WorkLimitOptions {
    /// Returns the limit.
    #[must_use]
    pub fn limit(self) -> WorkLimit {
        self.max_work_per_window.into()
    }
}

/// Whether an existing file may be replaced.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct OutputOptions {
    /// Replace an existing file once the new one is complete; if the recording is damaged, the part before the damage
    /// goes to incomplete-NAME instead
    #[arg(long)]
    pub overwrite: bool,
}

impl OutputOptions {
    /// Checks an output before any work is done, see [`event_files::output::check`].
    ///
    /// # Errors
    /// As for [`event_files::output::check`].
    pub fn check<'p>(
        self,
        output: &Path,
        kind: Kind,
        inputs: impl IntoIterator<Item = &'p Path>,
    ) -> Result<()> {
        let inputs: Vec<&Path> = inputs.into_iter().collect();
        Ok(event_files::output::check(
            output,
            kind,
            self.overwrite,
            &inputs,
        )?)
    }
}

/// Format of the recording to write.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct FormatOptions {
    /// Format of the recording to write, for an output without an extension, such as - for stdout
    #[arg(long, value_name = "NAME", value_parser = written_format)]
    pub format: Option<&'static Format>,
}

/// Parses the name, or the extension without its dot, of a format that can be written.
fn written_format(name: &str) -> Result<&'static Format, String> {
    let written = || FORMATS.iter().filter(|format| format.create.is_some());
    let ending = format!(".{name}");
    let by_ending = || written().find(|format| format.endings.contains(&ending.as_str()));
    let format = written().find(|format| format.name == name);
    let format = format.or_else(by_ending);
    format.ok_or_else(|| {
        let names: Vec<&str> = written().map(|format| format.name).collect();
        format!("expected one of {}", names.join(", "))
    })
}

impl FormatOptions {
    /// Returns the kind of the output; if a format was given, the file name need not imply one.
    #[must_use]
    pub const fn kind(self) -> Kind {
        match self.format {
            Some(_) => Kind::AnyRecording,
            None => Kind::Recording,
        }
    }

    /// Returns the format that was given, or else that of the output's extension.
    ///
    /// # Errors
    /// An extension of another format than the one given; with no format given, an extension that is missing or
    /// unknown.
    pub fn of(self, output: &Path) -> Result<&'static Format> {
        let by_name = event_files::writable(output).map(|(format, _)| format);
        let Some(format) = self.format else {
            return Ok(by_name?);
        };
        if let Ok(other) = by_name {
            // Several formats may share an extension, such as .raw.
            let ending = output.extension().unwrap_or_default().to_string_lossy();
            let ending = format!(".{}", ending.to_ascii_lowercase());
            let shares = format.endings.iter().any(|long| long.ends_with(&ending));
            ensure!(
                shares,
                "{}: the extension is that of {}, not of {}: choose another name",
                output.display(),
                other.title,
                format.title
            );
        }
        Ok(format)
    }
}

/// Parses a unit of time.
///
/// # Errors
/// Another text than a unit's name; the message lists them.
pub fn time_unit(text: &str) -> Result<TimeUnit, String> {
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    let unit = units.into_iter().find(|unit| unit.name() == text);
    unit.ok_or_else(|| "expected one of s, ms, us, ns".to_owned())
}

impl ReadingOptions {
    /// Returns the sensor size, if it was given.
    #[must_use]
    pub fn sensor(&self) -> Option<Sensor> {
        self.width
            .zip(self.height)
            .and_then(|(width, height)| Sensor::new(width, height))
    }

    /// Returns how the recording is to be read.
    #[must_use]
    pub fn reading(&self) -> Reading {
        Reading {
            size: self.sensor(),
            time_unit: self.time_unit,
            time_offset_us: self.time_offset_us,
            columns: self.columns.clone(),
            bad_events: if self.leave_out_bad_events {
                BadEvents::LeaveOut
            } else {
                BadEvents::Refuse
            },
            window_events_max: self.window_limit.max_events_per_window,
            window_work_max: self.work_limit.max_work_per_window,
        }
    }
}

/// Following a recording that is still being written.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct FollowOptions {
    /// Wait for data appended to the recording, until Ctrl-C
    #[arg(long)]
    follow: bool,

    /// With --follow: consider a recording ended if it has not grown for S seconds
    #[arg(long, value_name = "S", requires = "follow", value_parser = RangedU64ValueParser::<u32>::new().range(1..))]
    idle_s: Option<u32>,
}

impl FollowOptions {
    /// Returns how long to follow the recording, or `None` if --follow was not given. After the call, the first
    /// signal ends the following instead of the process.
    ///
    /// # Errors
    /// None at present.
    pub fn follow(self) -> Result<Option<Follow>> {
        if !self.follow {
            return Ok(None);
        }
        Ok(Some(Follow {
            idle: self.idle_s.map(|s| Duration::from_secs(s.into())),
            stop: stop_on_signals(),
        }))
    }
}

/// Reports a recording that ended early because of damage.
///
/// `output` is the file that holds the data before the damage, and `wanted` the output that was requested.
///
/// # Errors
/// Always if there is damage, except for a recording that was followed: its end was chosen by the user, so the damage
/// is only reported on stderr.
pub fn tell_damage(
    damage: Option<&str>,
    output: Option<&Path>,
    wanted: &Path,
    followed: bool,
) -> Result<()> {
    let Some(damage) = damage else {
        return Ok(());
    };
    let kept = match output {
        Some(output) if output == wanted => {
            format!(" ({} has everything before the damage)", output.display())
        }
        Some(output) => format!(
            " ({} has everything before the damage; {} is unchanged)",
            output.display(),
            wanted.display()
        ),
        None => String::new(),
    };
    ensure!(followed, "{damage}{kept}");
    say!("eecvs: {damage}{kept}");
    Ok(())
}

/// Reports damaged or lost frames: as an error if any data is missing, otherwise as a line on stderr.
///
/// # Errors
/// Frames are missing or damaged; all other frames were used.
pub fn tell_link(name: &str, link: &LinkReport) -> Result<()> {
    if let Some(warning) = link.warning() {
        ensure!(!link.has_loss(), "{name}: {warning}");
        say!("eecvs: {name}: {warning}");
    }
    Ok(())
}

/// The times whose events are wanted.
#[derive(Debug, Clone, Default, Args)]
pub struct TimeOptions {
    /// Only events at or after this time of the recording, in microseconds
    #[arg(long, value_name = "T")]
    pub from_us: Option<u64>,

    /// Only events before this time of the recording, in microseconds
    #[arg(long, value_name = "T")]
    pub to_us: Option<u64>,
}

impl TimeOptions {
    /// Ends the process with a word on the usage of `command` if the first time is after the last one.
    pub fn check(&self, command: &'static str) {
        if let (Some(from), Some(to)) = (self.from_us, self.to_us)
            && from > to
        {
            let message = format!("--from-us {from} is after --to-us {to}\n");
            clap::Command::new(command)
                .error(ErrorKind::ValueValidation, message)
                .exit();
        }
    }

    /// Returns the times from the first to before the last; `None` for all.
    #[must_use]
    pub fn times(&self) -> Option<Range<u64>> {
        let is_all = self.from_us.is_none() && self.to_us.is_none();
        (!is_all).then(|| self.from_us.unwrap_or(0)..self.to_us.unwrap_or(u64::MAX))
    }
}

/// Reports pixels whose event times were not sought, as a line on stderr: no event is missing.
pub fn tell_confidences(name: &str, confidences: &Confidences) {
    if let Some(warning) = confidences.warning() {
        say!("eecvs: {name}: {warning}");
    }
}

/// Density thresholds.
#[derive(Debug, Clone, Default, Args)]
pub struct ThresholdOptions {
    /// Density thresholds, as written by `eecvs calibrate` [default: those of the nine scenes]
    #[arg(long, value_name = "FILE")]
    pub thresholds: Option<PathBuf>,
}

impl ThresholdOptions {
    /// Returns the thresholds file to be read, if one was given.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.thresholds.iter().map(PathBuf::as_path)
    }

    /// Loads the thresholds from the file, or the built-in thresholds if no file was given.
    ///
    /// # Errors
    /// A file that cannot be read, or whose thresholds are invalid.
    pub fn load(&self) -> Result<Thresholds> {
        let file = match &self.thresholds {
            Some(path) => ThresholdsFile::read(path)?,
            None => ThresholdsFile::scenes()?,
        };
        Ok(file.thresholds()?)
    }
}
