//! A sensor's readout on the command line: a camera by its name, a flag for each parameter, and a file of them.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, ArgMatches, Command, value_parser};
use event_emulator::{CAMERAS, Camera, READOUT_PARAMETERS, ReadoutParameters};

use super::parameters::{flag, number, table};

/// Name of the key of a file that names a camera.
const CAMERA: &str = "camera";

/// Heading of the flags in the help.
const HEADING: &str = "Readout";

/// The flags of the readout; those of parameters are made of [`READOUT_PARAMETERS`].
#[derive(Debug, Clone, Default)]
pub struct ReadoutOptions {
    camera: Option<&'static Camera>,
    file: Option<PathBuf>,
    values: Vec<(&'static str, f64)>,
}

impl ReadoutOptions {
    /// Returns the camera and the parameters: those of the camera of `--camera` or of the file, changed by the file, then
    /// by the flags; `None` if no flag is given, as events then come out as pixels fire.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML, or has an unknown key; a value is out of its range.
    pub fn readout(&self) -> Result<Option<(Option<&'static Camera>, ReadoutParameters)>> {
        if self.camera.is_none() && self.file.is_none() && self.values.is_empty() {
            return Ok(None);
        }
        let file = self.file.as_deref();
        let table = file.map(table).transpose()?.unwrap_or_default();
        let in_file = |path: &Path| path.display().to_string();
        let of_file = table.get(CAMERA).map(|name| {
            let camera = name.as_str().and_then(Camera::from_name);
            camera.with_context(|| {
                let names: Vec<&str> = CAMERAS.iter().map(|camera| camera.name).collect();
                format!(
                    "there is no camera {name}; the cameras are {}",
                    names.join(", ")
                )
            })
        });
        let of_file = of_file.transpose();
        let of_file = of_file.with_context(|| file.map_or(String::new(), in_file))?;
        let camera = self.camera.or(of_file);
        let mut parameters =
            camera.map_or_else(ReadoutParameters::default, |camera| camera.readout);
        for (name, value) in table.iter().filter(|(name, _)| *name != CAMERA) {
            let set = number(name, value).and_then(|value| Ok(parameters.set(name, value)?));
            set.with_context(|| file.map_or(String::new(), in_file))?;
        }
        for (name, value) in &self.values {
            parameters.set(name, *value)?;
        }
        parameters.check()?;
        Ok(Some((camera, parameters)))
    }
}

/// Returns a camera and the parameters as a file for `--readout`.
pub fn file(readout: Option<(Option<&Camera>, ReadoutParameters)>) -> String {
    let (camera, parameters) = readout.unwrap_or_default();
    let camera =
        camera.map(|camera| format!("# {}\n{CAMERA} = \"{}\"\n\n", camera.about, camera.name));
    let mut text = camera.unwrap_or_default();
    for parameter in READOUT_PARAMETERS {
        let (value, least, most) = (parameter.of(&parameters), parameter.least, parameter.most);
        let line = writeln!(
            text,
            "# {}\n# {least} to {most} {}.\n{} = {value:?}\n",
            parameter.about, parameter.unit, parameter.name
        );
        line.expect("a string");
    }
    text
}

/// Returns the readout's parameters by their names.
pub fn json(parameters: &ReadoutParameters) -> serde_json::Value {
    let pairs = READOUT_PARAMETERS.iter();
    pairs
        .map(|parameter| (parameter.name.to_owned(), parameter.of(parameters).into()))
        .collect::<serde_json::Map<String, serde_json::Value>>()
        .into()
}

impl clap::Args for ReadoutOptions {
    fn augment_args(command: Command) -> Command {
        let cameras = CAMERAS.iter();
        let cameras = cameras.map(|camera| PossibleValue::new(camera.name).help(camera.about));
        let parser = PossibleValuesParser::new(cameras)
            .try_map(|name| Camera::from_name(&name).ok_or("unknown name"));
        let mut command = command
            .arg(
                Arg::new(CAMERA)
                    .long(CAMERA)
                    .value_name("NAME")
                    .value_parser(parser)
                    .help_heading(HEADING)
                    .help("Camera whose readout events go through; a scene has its size"),
            )
            .arg(
                Arg::new("readout")
                    .long("readout")
                    .value_name("FILE.toml")
                    .value_parser(value_parser!(PathBuf))
                    .help_heading(HEADING)
                    .help("File with values of the parameters below, and the name of a camera"),
            );
        for parameter in READOUT_PARAMETERS {
            let default = parameter.of(&ReadoutParameters::default());
            let range = [parameter.least, parameter.most];
            let (name, about, unit) = (parameter.name, parameter.about, parameter.unit);
            command = command.arg(flag(HEADING, name, about, unit, range, default));
        }
        command
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl clap::FromArgMatches for ReadoutOptions {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut options = Self::default();
        options.update_from_arg_matches(matches)?;
        Ok(options)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.camera = matches.get_one::<&'static Camera>(CAMERA).copied();
        self.file = matches.get_one::<PathBuf>("readout").cloned();
        let values = READOUT_PARAMETERS.iter().filter_map(|parameter| {
            let value = matches.get_one::<f64>(parameter.name)?;
            Some((parameter.name, *value))
        });
        self.values = values.collect();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        readout: ReadoutOptions,
    }

    fn parse(line: &str) -> Result<Option<ReadoutParameters>> {
        let words = std::iter::once("readout").chain(line.split_whitespace());
        let readout = Line::try_parse_from(words)?.readout.readout()?;
        Ok(readout.map(|(_, parameters)| parameters))
    }

    #[test]
    fn every_camera_and_parameter_has_a_flag() {
        Line::command().debug_assert();
        assert_eq!(parse("").unwrap(), None);
        for camera in CAMERAS {
            let line = format!("--camera {}", camera.name);
            assert_eq!(parse(&line).unwrap(), Some(camera.readout));
        }
        for parameter in READOUT_PARAMETERS {
            let flag = parameter.name.replace('_', "-");
            let line = format!("--camera davis346 --{flag} {}", parameter.most);
            assert_eq!(
                parameter.of(&parse(&line).unwrap().unwrap()),
                parameter.most
            );
        }
        for bad in [
            "--camera moon",
            "--row-ns -1",
            "--tick-us 1.5",
            "--link-per-us nan",
        ] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_printed_file_gives_the_same_readout() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("readout.toml");
        for line in ["", "--camera gen41", "--camera davis346 --row-ns 7.25"] {
            let words = std::iter::once("readout").chain(line.split_whitespace());
            let asked = Line::try_parse_from(words).unwrap().readout.readout();
            let asked = asked.unwrap();
            std::fs::write(&path, file(asked)).unwrap();
            let words = ["readout", "--readout", path.to_str().unwrap()];
            let got = Line::try_parse_from(words).unwrap().readout.readout();
            let name = |camera: Option<&Camera>| camera.map(|camera| camera.name);
            let (camera, parameters) = got.unwrap().unwrap();
            assert_eq!(name(camera), name(asked.and_then(|(camera, _)| camera)));
            let asked = asked.map_or_else(ReadoutParameters::default, |(_, asked)| asked);
            assert_eq!(parameters, asked, "{line}");
        }
    }

    #[test]
    fn a_file_names_a_camera_and_changes_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("readout.toml");
        let with = |text: &str, flags: &str| {
            std::fs::write(&path, text).unwrap();
            parse(&format!("--readout {} {flags}", path.display()))
        };
        let text = "camera = \"dvs128\"\nlink_per_us = 0.5\nbuffer_events = 9\n";
        let read = with(text, "--buffer-events 7").unwrap().unwrap();
        assert_eq!(
            (read.event_ns, read.link_per_us, read.buffer_events),
            (500.0, 0.5, 7.0)
        );
        assert_eq!(
            with(text, "--camera gen41").unwrap().unwrap().group_columns,
            32.0
        );
        for (text, said) in [
            ("moon = 1", "no parameter moon"),
            ("camera = \"moon\"", "no camera"),
            ("camera = 3", "no camera"),
            ("row_ns = \"x\"", "not a number"),
            ("row_ns = -1", "give 0 to"),
            ("row_ns = ", "readout.toml"),
        ] {
            let error = format!("{:#}", with(text, "").unwrap_err());
            assert!(
                error.contains(said) && error.contains("readout.toml"),
                "{error}"
            );
        }
    }
}
