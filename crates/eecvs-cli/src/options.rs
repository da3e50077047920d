//! Flags that several subcommands share.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use eecvs::frame_file::LinkReport;
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_nostd::{Sensor, Thresholds};
use event_files::input::growing::Follow;
use event_files::output::Kind;
use event_files::{BadEvents, Columns, FORMATS, Format, Reading, TimeUnit};

use crate::stop::stop_on_signals;

/// Parses a width or a height.
fn side() -> RangedU64ValueParser<u16> {
    RangedU64ValueParser::new().range(1..=u64::from(Sensor::SIDE_MAX))
}

/// What a recording does not say of itself.
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

    /// Microseconds to add to every time of the recording, such as for times before 0
    #[arg(
        long,
        value_name = "D",
        default_value_t = 0,
        allow_negative_numbers = true
    )]
    pub time_offset_us: i64,

    /// Columns of a table: a letter for each, t, x, y, p and - for one to leave out, as in -xytp; or their
    /// names, as in t=time,x=col,y=row,p=on
    #[arg(long, value_name = "COLUMNS", value_parser = Columns::parse)]
    pub columns: Option<Columns>,

    /// Leave out, and count, events that cannot be ones (outside of the sensor, values missing) instead of
    /// ending with an error at the first
    #[arg(long)]
    pub leave_out_bad_events: bool,
}

/// Whether a file that is there already may be replaced.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct OutputOptions {
    /// Replace a file that is there already, when the new one is complete; of a damaged recording what comes before the
    /// damage is left in incomplete-NAME
    #[arg(long)]
    pub overwrite: bool,
}

impl OutputOptions {
    /// Refuses an output before anything is done, as [`event_files::output::check`].
    ///
    /// # Errors
    /// As there.
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

/// The format of a recording that is written.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct FormatOptions {
    /// Format of the recording that is written, for an output without an extension, such as - for stdout
    #[arg(long, value_name = "NAME", value_parser = written_format)]
    pub format: Option<&'static Format>,
}

/// Parses the name of a format that is written.
fn written_format(name: &str) -> Result<&'static Format, String> {
    let written = || FORMATS.iter().filter(|format| format.create.is_some());
    let ending = format!(".{name}");
    let by_ending = || written().find(|format| format.endings.contains(&ending.as_str()));
    let format = written().find(|format| format.name == name);
    let format = format.or_else(by_ending);
    format.ok_or_else(|| {
        let names: Vec<&str> = written().map(|format| format.name).collect();
        format!("one of {}", names.join(", "))
    })
}

impl FormatOptions {
    /// What the output is, whose name need not tell where a format was asked for.
    #[must_use]
    pub const fn kind(self) -> Kind {
        match self.format {
            Some(_) => Kind::AnyRecording,
            None => Kind::Recording,
        }
    }

    /// The format that was asked for, or that of the output's extension.
    ///
    /// # Errors
    /// An extension of no format or of another one, and no extension where no format was asked for.
    pub fn of(self, output: &Path) -> Result<&'static Format> {
        let by_name = event_files::writable(output).map(|(format, _)| format);
        let Some(format) = self.format else {
            return Ok(by_name?);
        };
        if let Ok(other) = by_name {
            // Such as .raw, of several formats.
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
fn time_unit(text: &str) -> Result<TimeUnit, String> {
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    let unit = units.into_iter().find(|unit| unit.name() == text);
    unit.ok_or_else(|| "one of s, ms, us, ns".to_owned())
}

impl ReadingOptions {
    /// The size, where it was given.
    #[must_use]
    pub fn sensor(&self) -> Option<Sensor> {
        self.width
            .zip(self.height)
            .and_then(|(width, height)| Sensor::new(width, height))
    }

    /// How a recording is read.
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
        }
    }
}

/// Following of a recording that is still being written.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct FollowOptions {
    /// Wait for what is appended to the recording, until Ctrl-C
    #[arg(long)]
    follow: bool,

    /// With --follow: take a recording that has not grown for so many seconds as ended
    #[arg(long, value_name = "S", requires = "follow", value_parser = RangedU64ValueParser::<u32>::new().range(1..))]
    idle_s: Option<u32>,
}

impl FollowOptions {
    /// How long to follow, where that was asked for; from then on a signal ends it.
    ///
    /// # Errors
    /// Signals that cannot be handled.
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

/// What is said, as an error, of a recording that ended before its end; `output` is the file that has what was before
/// it, and `wanted` the one that was to.
///
/// # Errors
/// Always where there is damage, but where a recording was followed: then its end was chosen, and is
/// told on stderr alone.
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
            format!(" ({} has everything before)", output.display())
        }
        Some(output) => format!(
            " ({} has everything before; {} is as it was)",
            output.display(),
            wanted.display()
        ),
        None => String::new(),
    };
    ensure!(followed, "{damage}{kept}");
    eprintln!("eecvs: {damage}{kept}");
    Ok(())
}

/// Says what of frames was damaged or lost: an error where anything is missing, and else a line on stderr.
///
/// # Errors
/// Frames that are missing or damaged, all others of which were used.
pub fn tell_link(name: &str, link: &LinkReport) -> Result<()> {
    if let Some(warning) = link.warning() {
        ensure!(!link.has_loss(), "{name}: {warning}");
        eprintln!("eecvs: {name}: {warning}");
    }
    Ok(())
}

/// Density thresholds.
#[derive(Debug, Clone, Default, Args)]
pub struct ThresholdOptions {
    /// Density thresholds, as `eecvs calibrate` writes them [default: those of the nine scenes]
    #[arg(long, value_name = "FILE")]
    pub thresholds: Option<PathBuf>,
}

impl ThresholdOptions {
    /// The file that it reads, where there is one.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.thresholds.iter().map(PathBuf::as_path)
    }

    /// The thresholds of the file, or those that come with the program.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn load(&self) -> Result<Thresholds> {
        let file = match &self.thresholds {
            Some(path) => ThresholdsFile::read(path)?,
            None => ThresholdsFile::scenes()?,
        };
        Ok(file.thresholds()?)
    }
}
