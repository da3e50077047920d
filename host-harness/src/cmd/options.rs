//! Flags that several subcommands share.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use eecvs_nostd::{Sensor, Thresholds};

use super::stop::stop_on_signals;
use crate::formats::growing::Follow;
use crate::thresholds_file::ThresholdsFile;

/// Parses a width or a height.
fn side() -> RangedU64ValueParser<u16> {
    RangedU64ValueParser::new().range(1..=u64::from(Sensor::SIDE_MAX))
}

/// Sensor size, for recordings that do not store it.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct SizeOptions {
    /// Sensor width in pixels, for formats that do not store it
    #[arg(long, value_name = "W", requires = "height", value_parser = side())]
    pub width: Option<u16>,

    /// Sensor height in pixels, for formats that do not store it
    #[arg(long, value_name = "H", requires = "width", value_parser = side())]
    pub height: Option<u16>,
}

impl SizeOptions {
    /// The size, where it was given.
    #[must_use]
    pub fn sensor(self) -> Option<Sensor> {
        self.width
            .zip(self.height)
            .and_then(|(width, height)| Sensor::new(width, height))
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
            stop: stop_on_signals()?,
        }))
    }
}

/// What is said, as an error, of a recording that ended before its end; `output` has what was before it.
///
/// # Errors
/// Always where there is damage, but where a recording was followed: then its end was chosen, and is
/// told on stderr alone.
pub fn tell_damage(damage: Option<&str>, output: Option<&Path>, followed: bool) -> Result<()> {
    let Some(damage) = damage else {
        return Ok(());
    };
    let kept = output.map_or_else(String::new, |output| {
        format!(" ({} has everything before)", output.display())
    });
    ensure!(followed, "{damage}{kept}");
    eprintln!("eecvs: {damage}{kept}");
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
    /// The thresholds of the file, or those that come with the program.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn load(&self) -> Result<Thresholds> {
        let file = match &self.thresholds {
            Some(path) => ThresholdsFile::read(path)?,
            None => ThresholdsFile::scenes()?,
        };
        file.thresholds()
    }
}
