//! Flags that several subcommands share.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use clap::builder::RangedU64ValueParser;
use eecvs_nostd::{Sensor, Thresholds};

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
