//! The pixel of model 2 on the command line: a flag for each parameter and for each effect, and a file of them.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Arg, ArgAction, ArgMatches, Command, value_parser};
use event_emulator::{Effect, PARAMETERS, PixelParameters};

use super::parameters::{self, number};

/// Name of the key of a file that lists the effects that are switched off.
const WITHOUT: &str = "without";

/// What `--no-noise` switches off.
const NOISE: [Effect; 4] = [
    Effect::Leak,
    Effect::ShotNoise,
    Effect::Jitter,
    Effect::Defects,
];

/// Heading of the flags in the help.
const HEADING: &str = "Pixel of model 2";

/// The flags of the pixel; those of parameters are made of [`PARAMETERS`].
#[derive(Debug, Clone, Default)]
pub struct PixelOptions {
    file: Option<PathBuf>,
    without: Vec<Effect>,
    values: Vec<(&'static str, f64)>,
}

impl PixelOptions {
    /// Returns whether no flag is given.
    pub fn is_default(&self) -> bool {
        self.file.is_none() && self.without.is_empty() && self.values.is_empty()
    }

    /// Returns the parameters: the defaults, changed by the file, then by `--no-...`, then by the parameters' flags.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML, or has an unknown key; a value is out of its range.
    pub fn parameters(&self) -> anyhow::Result<PixelParameters> {
        let mut parameters = PixelParameters::default();
        if let Some(path) = &self.file {
            read(path, &mut parameters).with_context(|| path.display().to_string())?;
        }
        for effect in &self.without {
            parameters.switch_off(*effect);
        }
        for (name, value) in &self.values {
            parameters.set(name, *value)?;
        }
        parameters.check()?;
        Ok(parameters)
    }
}

/// Changes parameters by a file: first the effects that it switches off, then its values.
fn read(path: &Path, parameters: &mut PixelParameters) -> anyhow::Result<()> {
    let table = parameters::read(path)?;
    if let Some(without) = table.get(WITHOUT) {
        let names = without
            .as_array()
            .with_context(|| format!("{WITHOUT} is not a list of effects"))?;
        for name in names {
            let effect = Effect::ALL
                .into_iter()
                .find(|e| Some(e.name()) == name.as_str());
            let effect = effect.with_context(|| {
                let names = Effect::ALL.map(Effect::name).join(", ");
                format!("{WITHOUT}: there is no effect {name}; the effects are {names}")
            })?;
            parameters.switch_off(effect);
        }
    }
    for (name, value) in table.iter().filter(|(name, _)| *name != WITHOUT) {
        parameters.set(name, number(name, value)?)?;
    }
    Ok(())
}

/// Returns the parameters as a file for `--pixel`.
pub fn file(parameters: &PixelParameters) -> String {
    let mut text = String::new();
    for parameter in PARAMETERS {
        let (value, least, most) = (parameter.of(parameters), parameter.least, parameter.most);
        let line = writeln!(
            text,
            "# {}\n# {least} to {most} {}. {}.\n{} = {value:?}\n",
            parameter.about, parameter.unit, parameter.source, parameter.name
        );
        line.expect("a string");
    }
    text
}

/// Returns the parameters by their names.
pub fn json(parameters: &PixelParameters) -> serde_json::Value {
    let pairs = PARAMETERS.iter();
    pairs
        .map(|parameter| (parameter.name.to_owned(), parameter.of(parameters).into()))
        .collect::<serde_json::Map<String, serde_json::Value>>()
        .into()
}

impl clap::Args for PixelOptions {
    fn augment_args(command: Command) -> Command {
        let mut command = command.arg(
            Arg::new("pixel")
                .long("pixel")
                .value_name("FILE.toml")
                .value_parser(value_parser!(PathBuf))
                .help_heading(HEADING)
                .help(
                    "File with values of the parameters below, and effects that are switched off",
                ),
        );
        let noise = "Without shot noise, leakage, jitter, and hot, dead or stuck pixels";
        let effects = Effect::ALL.map(|effect| (effect.name(), effect.without()));
        for (name, about) in [("noise", noise)].into_iter().chain(effects) {
            let flag = format!("no-{name}");
            command = command.arg(
                Arg::new(flag.clone())
                    .long(flag)
                    .action(ArgAction::SetTrue)
                    .help_heading(HEADING)
                    .help(about),
            );
        }
        for parameter in PARAMETERS {
            let default = parameter.of(&PixelParameters::default());
            let range = [parameter.least, parameter.most];
            let (name, about, unit) = (parameter.name, parameter.about, parameter.unit);
            command = command.arg(parameters::flag(HEADING, name, about, unit, range, default));
        }
        command
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl clap::FromArgMatches for PixelOptions {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut options = Self::default();
        options.update_from_arg_matches(matches)?;
        Ok(options)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.file = matches.get_one::<PathBuf>("pixel").cloned();
        self.without.clear();
        if matches.get_flag("no-noise") {
            self.without.extend(NOISE);
        }
        let effects = Effect::ALL.into_iter();
        self.without
            .extend(effects.filter(|effect| matches.get_flag(&format!("no-{}", effect.name()))));
        let values = PARAMETERS.iter().filter_map(|parameter| {
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
        pixel: PixelOptions,
    }

    fn parse(line: &str) -> anyhow::Result<PixelParameters> {
        let words = std::iter::once("pixel").chain(line.split_whitespace());
        Line::try_parse_from(words)?.pixel.parameters()
    }

    #[test]
    fn every_parameter_and_effect_has_a_flag() {
        Line::command().debug_assert();
        assert_eq!(parse("").unwrap(), PixelParameters::default());
        for parameter in PARAMETERS
            .iter()
            .filter(|parameter| parameter.name != "jitter_us")
        {
            for value in [parameter.least, parameter.most] {
                let flag = parameter.name.replace('_', "-");
                // No jitter before the crossing, and one share at a time.
                let line = format!("--no-jitter --no-defects --{flag} {value}");
                assert_eq!(parameter.of(&parse(&line).unwrap()), value, "{line}");
            }
        }
        for effect in Effect::ALL {
            let mut expected = PixelParameters::default();
            expected.switch_off(effect);
            assert_eq!(parse(&format!("--no-{}", effect.name())).unwrap(), expected);
        }
        let quiet = parse("--no-noise").unwrap();
        assert_eq!(
            (quiet.shot_noise, quiet.leak_hz, quiet.hot_share),
            (0.0, 0.0, 0.0)
        );
        // A parameter's flag wins.
        assert_eq!(parse("--no-noise --leak-hz 3").unwrap().leak_hz, 3.0);
        for bad in [
            "--leak-hz -1",
            "--leak-hz nan",
            "--leak-hz x",
            "--jitter-us 100",
            "--no-moon",
        ] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_file_has_parameters_and_effects_and_flags_change_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pixel.toml");
        let with = |text: &str, flags: &str| {
            std::fs::write(&path, text).unwrap();
            parse(&format!("--pixel {} {flags}", path.display()))
        };
        let pixel = with("without = [\"spread\", \"leak\"]\nleak_hz = 2\n", "").unwrap();
        assert_eq!((pixel.threshold_spread, pixel.leak_hz), (0.0, 2.0));
        assert_eq!(pixel.parasitic_hz_per_klux, 0.0);
        let pixel = with(
            "leak_hz = 2.5\nhot_share = 0.5",
            "--no-leak --hot-share 0.25",
        )
        .unwrap();
        assert_eq!((pixel.leak_hz, pixel.hot_share), (0.0, 0.25));
        // What is printed is read.
        let mut other = PixelParameters::default();
        other.set("shot_noise", 0.1234).unwrap();
        assert_eq!(with(&file(&other), "").unwrap(), other);
        for (text, said) in [
            ("moon = 1", "no parameter moon"),
            ("leak_hz = \"many\"", "not a number"),
            ("leak_hz = -1", "give 0 to 1000"),
            ("without = 3", "not a list"),
            ("without = [\"moon\"]", "no effect"),
            ("leak_hz = ", "pixel.toml"),
        ] {
            let error = format!("{:#}", with(text, "").unwrap_err());
            assert!(
                error.contains(said) && error.contains("pixel.toml"),
                "{error}"
            );
        }
        let error = parse("--pixel /nowhere/pixel.toml").unwrap_err();
        assert!(
            format!("{error:#}").contains("cannot be opened"),
            "{error:#}"
        );
    }
}
