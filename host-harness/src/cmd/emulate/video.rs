//! A video on the command line: how it is read, and what light its numbers stand for.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use eecvs_cli::options::time_unit;
use eecvs_cli::say;
use event_emulator::{
    Exposure, Motion, PixelParameters, VideoConfig, VideoEmulator, emulate_video,
};
use event_files::input::piped::name_of;
use event_files::reading::TimeUnit;
use event_files::video::{Fps, RawGray, VideoReading, open_video};
use event_types::Sensor;
use event_types::stream::{ErrorKind, Response};

/// Heading of the flags in the help.
const HEADING: &str = "Video";

/// The flags of a video.
#[derive(Debug, Clone, Default, PartialEq, Args)]
#[command(next_help_heading = HEADING)]
pub struct VideoOptions {
    /// Frames per second of a video without times, or in place of its own: 30, 29.97, 30000/1001
    #[arg(long, value_name = "F", conflicts_with = "times")]
    fps: Option<Fps>,

    /// File with the time of each frame, one number per line, in place of the video's own times
    #[arg(long, value_name = "FILE", requires = "time_unit")]
    times: Option<PathBuf>,

    /// Unit of the times in --times, or in an array of times that does not state it: s, ms, us or ns
    #[arg(long, value_name = "UNIT", value_parser = time_unit)]
    time_unit: Option<TimeUnit>,

    /// The input is gray pixels without a header, in frames of this size
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<Sensor>,

    /// Layout of gray pixels without a header, by ffmpeg's names
    #[arg(long, value_name = "NAME", requires = "size", default_value = "gray")]
    pixel_format: PixelFormat,

    /// Range of the luma of Y4M, in place of what its header says [default: that of the header, else limited, and full
    /// for gray]
    #[arg(long, value_name = "RANGE")]
    luma_range: Option<LumaRange>,

    /// The number that is white [default: the largest one of an integer type, 1 for floats]
    #[arg(long, value_name = "N")]
    white: Option<f64>,

    /// How numbers follow the light [default: srgb; linear for floats and recordings]
    #[arg(long, value_name = "CURVE", value_parser = response)]
    response: Option<Response>,

    /// Illuminance of white, in lux [default: 300]
    #[arg(long, value_name = "LX")]
    white_lux: Option<f64>,

    /// Light that the lens spreads over the picture, as a share of white [default: 0.01]
    #[arg(long, value_name = "SHARE")]
    flare: Option<f64>,
}

/// Layouts of gray pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum PixelFormat {
    #[default]
    Gray,
    Gray16Le,
}

impl ValueEnum for PixelFormat {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::Gray, Self::Gray16Le]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self {
            Self::Gray => PossibleValue::new("gray").help("8 bits"),
            Self::Gray16Le => PossibleValue::new("gray16le").help("16 bits, the low byte first"),
        })
    }
}

/// Ranges of a luma.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum LumaRange {
    /// Black at 16 and white at 235 of 255
    Limited,
    /// Black at 0 and white at 255
    Full,
}

/// Parses a size.
fn size(text: &str) -> Result<Sensor, String> {
    let sides = text.split_once(['x', 'X']);
    let sides = sides.and_then(|(width, height)| width.parse().ok().zip(height.parse().ok()));
    let size = sides.and_then(|(width, height)| Sensor::new(width, height));
    size.ok_or_else(|| format!("expected WIDTHxHEIGHT, each 1 to {}", Sensor::SIDE_MAX))
}

/// Parses the name of a response.
fn response(name: &str) -> Result<Response, String> {
    let found = Response::ALL
        .into_iter()
        .find(|response| response.name() == name);
    found.ok_or_else(|| "expected srgb or linear".to_owned())
}

impl VideoOptions {
    /// Returns whether no flag is given.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the files that are read beside the video.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.times.iter().map(PathBuf::as_path)
    }

    /// Opens the video `path` and starts its emulation; says on stderr what was assumed.
    ///
    /// # Errors
    /// The video cannot be read, or has fewer than two frames; a flag is out of its range.
    pub fn emulate(
        &self,
        path: &Path,
        (start_us, duration_us): (Option<u64>, Option<u64>),
        seed: u64,
        pixel: &PixelParameters,
    ) -> Result<(VideoEmulator, Exposure)> {
        let name = name_of(path);
        let reader = open_video(path, &self.reading())?;
        for assumption in reader.assumptions() {
            say!(
                "eecvs: {name}: {} taken as {}: {}",
                assumption.what,
                assumption.taken,
                assumption.why
            );
        }
        let response = self.response.unwrap_or(reader.response());
        let usual = Exposure::of(response);
        let exposure = Exposure {
            response,
            white_lux: self.white_lux.unwrap_or(usual.white_lux),
            flare: self.flare.unwrap_or(usual.flare),
        };
        let config = VideoConfig {
            exposure,
            start_us,
            duration_us,
            seed,
        };
        let emulator = emulate_video(reader, config, pixel);
        // What the reader says names the file.
        let emulator = emulator.map_err(|error| match error.kind() {
            ErrorKind::Refused => error.context(&name),
            _ => error,
        })?;
        Ok((emulator, exposure))
    }

    fn reading(&self) -> VideoReading {
        VideoReading {
            fps: self.fps,
            times: self.times.clone(),
            time_unit: self.time_unit,
            white: self.white,
            raw: self.size.map(|sensor| RawGray {
                sensor,
                wide: self.pixel_format == PixelFormat::Gray16Le,
            }),
            full_range: self.luma_range.map(|range| range == LumaRange::Full),
        }
    }
}

/// Says on stderr where a video moves too far from frame to frame, and what to do.
pub fn tell_motion(name: &str, motion: &Motion, elapsed_us: u64) {
    if let Some(warning) = motion_warning(motion, elapsed_us) {
        say!("eecvs: {name}: {warning}");
    }
}

fn motion_warning(motion: &Motion, elapsed_us: u64) -> Option<String> {
    let first = motion.first_frame?;
    let fps = motion.pairs as f64 * 1e6 / elapsed_us.max(1) as f64;
    let enough = (fps * f64::from(motion.most_px)).ceil();
    Some(format!(
        "between {} of {} pairs of frames, first between frames {first} and {}, the picture moves by more than a pixel, up \
         to some {:.0}: light then fades from place to place, and does not move. Give frames at a higher rate, some \
         {enough:.0} per second, or interpolate them before, as by ffmpeg -vf minterpolate=fps={enough:.0}",
        motion.pairs_beyond,
        motion.pairs,
        first + 1,
        motion.most_px,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_responses_are_parsed() {
        let sensor = Sensor {
            width: 346,
            height: 260,
        };
        assert_eq!(size("346x260"), Ok(sensor));
        for bad in [
            "",
            "346",
            "0x1",
            "1x0",
            "2049x1",
            "1x1x1",
            "-1x1",
            "1000000000x1000000000",
        ] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert_eq!(response("linear"), Ok(Response::Linear));
        assert!(response("gamma").is_err());
    }

    #[test]
    fn the_warning_says_where_and_what_to_do() {
        let mut motion = Motion {
            pairs: 30,
            ..Motion::default()
        };
        assert_eq!(motion_warning(&motion, 1_000_000), None);
        motion.pairs_beyond = 4;
        motion.first_frame = Some(7);
        motion.most_px = 5.5;
        let warning = motion_warning(&motion, 1_000_000).unwrap();
        for part in [
            "4 of 30",
            "frames 7 and 8",
            "some 6",
            "minterpolate=fps=165",
        ] {
            assert!(warning.contains(part), "{part}: {warning}");
        }
        assert!(motion_warning(&motion, 0).is_some());
    }
}
