//! What is emulated: a scene by its name, or a video by its path.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, Command};
use eecvs_cli::values::preset;
use event_emulator::{PRESETS, Preset};
use event_files::file_of;
use event_files::input::piped::is_stream;

/// What is emulated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Input {
    /// A scene.
    Scene(Preset),
    /// A file or folder, or `-`.
    Video(PathBuf),
}

/// Parser of [`Input`]: the name of a scene, or else a path that is there.
#[derive(Debug, Clone, Copy)]
pub struct InputParser;

impl TypedValueParser for InputParser {
    type Value = Input;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> Result<Input, clap::Error> {
        let path = Path::new(value);
        let is_scene = value
            .to_str()
            .is_some_and(|name| Preset::from_name(name).is_some());
        if !is_scene && (is_stream(path) || file_of(path).exists()) {
            return Ok(Input::Video(path.to_owned()));
        }
        if is_scene {
            return preset().parse_ref(command, arg, value).map(Input::Scene);
        }
        let scenes: Vec<&str> = PRESETS.iter().map(|preset| preset.name()).collect();
        let message = format!(
            "'{}' is neither a scene nor a file that is there; the scenes are {}\n",
            value.to_string_lossy(),
            scenes.join(", ")
        );
        Err(clap::Error::raw(ErrorKind::InvalidValue, message).with_cmd(command))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let scenes = PRESETS.iter();
        let scenes = scenes.map(|preset| PossibleValue::new(preset.name()).help(preset.about()));
        let video =
            "A video: Y4M or - for stdin, a folder of PNG, .npy, .npz, a recording with frames";
        Some(Box::new(
            scenes.chain([PossibleValue::new("FILE").help(video)]),
        ))
    }
}
