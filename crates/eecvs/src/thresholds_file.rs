//! Reads and writes the file of density thresholds: TOML that `eecvs calibrate` writes and people edit.
//!
//! ```toml
//! tau_low = 0.371000000000
//! tau_high = 2.890000000000
//! window_us = 32768
//! windows = 4211
//! sources = ["a.raw", "b.aedat4"]
//! ```
//!
//! `tau_low` and `tau_high` are required; the other keys record where they come from. The thresholds are TOML
//! numbers with twelve decimals. They are parsed exactly from the *text* of the number, because an f64 would lose
//! the last decimals above 9,007 events per pixel per second.

use std::fs::File;
use std::io::Read;
use std::num::NonZeroU32;
use std::path::Path;

use eecvs_nostd::Thresholds;
use event_types::stream::{Context, Result};
use event_types::{bail, error};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::calibrate::CalibratedThresholds;
use crate::exact_density::{decimal, pico_from_decimal};

/// Largest file accepted, in bytes.
const FILE_BYTES_MAX: u64 = 16 << 20;

/// Contents of a file of density thresholds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThresholdsFile {
    /// Windows below this density are sparse; in units of 1e-12 events per pixel per second.
    pub tau_low_pico: u64,
    /// Windows of at least this density are dense; in units of 1e-12 events per pixel per second, at least
    /// `tau_low_pico`.
    pub tau_high_pico: u64,
    /// Duration in microseconds of the windows from which the thresholds were computed.
    pub window_us: Option<NonZeroU32>,
    /// Number of those windows, including empty ones.
    pub windows: Option<u64>,
    /// Recordings from which the thresholds were computed.
    pub sources: Vec<String>,
}

impl ThresholdsFile {
    /// Creates the contents for a calibration on the recordings `sources`.
    #[must_use]
    pub fn new(thresholds: &CalibratedThresholds, sources: Vec<String>) -> Self {
        Self {
            tau_low_pico: thresholds.tau_low_pico,
            tau_high_pico: thresholds.tau_high_pico,
            window_us: Some(thresholds.window_us),
            windows: Some(thresholds.windows),
            sources,
        }
    }

    /// Returns the text of the file, which [`ThresholdsFile::parse`] reads back exactly.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = format!(
            "\
# Density thresholds of the EECVS encoder (`eecvs encode --thresholds`). Edit freely.
# The density of a window is its events / (pixels x seconds).

# Below tau_low a window is sparse and encoded with the Haar wavelet transform.
# 25th percentile of the calibration set, in events per pixel per second, up to 12 decimals.
tau_low = {}

# From tau_high on a window is dense and encoded with the DCT, between the two with the DTFT.
# 75th percentile of the calibration set; not below tau_low.
tau_high = {}
",
            decimal(self.tau_low_pico),
            decimal(self.tau_high_pico)
        );
        if let Some(window_us) = self.window_us {
            text += "\n# Duration of the calibration's windows in microseconds.\n";
            text += &format!("window_us = {window_us}\n");
        }
        if let Some(windows) = self.windows {
            text += "\n# Windows of the calibration set, empty ones included.\n";
            text += &format!("windows = {windows}\n");
        }
        if !self.sources.is_empty() {
            text += "\n# Recordings of the calibration set.\nsources = [\n";
            for source in &self.sources {
                text += &format!("    {},\n", toml::Value::String(source.clone()));
            }
            text += "]\n";
        }
        text
    }

    /// Returns the built-in thresholds, computed from the nine emulated scenes by `eecvs calibrate --scenes`.
    ///
    /// # Errors
    /// None in a tested build: a test parses the same text.
    pub fn scenes() -> Result<Self> {
        Self::parse(include_str!("../thresholds.toml"), "thresholds.toml")
    }

    /// Returns the thresholds in the encoder's form.
    ///
    /// # Errors
    /// Fails if `tau_low` is above `tau_high`.
    pub fn thresholds(&self) -> Result<Thresholds> {
        Thresholds::new(self.tau_low_pico, self.tau_high_pico)
            .context("tau_low is above tau_high: swap or edit them")
    }

    /// Reads and validates a file of thresholds.
    ///
    /// # Errors
    /// Fails if the file cannot be read, is larger than 16 MiB or is not UTF-8, and with the errors of
    /// [`ThresholdsFile::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display();
        let mut bytes = Vec::new();
        File::open(path)
            .and_then(|file| file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes))
            .with_context(|| {
                format!("{name}: cannot read the thresholds; `eecvs calibrate` writes such a file")
            })?;
        if bytes.len() as u64 > FILE_BYTES_MAX {
            bail!(
                Damaged,
                "{name}: larger than {FILE_BYTES_MAX} bytes: this is not a thresholds file"
            );
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let offset = error.utf8_error().valid_up_to();
            error!(
                Damaged,
                "{name}: byte {offset} is not UTF-8 text: save the file as UTF-8 TOML"
            )
        })?;
        Self::parse(&text, &name.to_string())
    }

    /// Parses and validates the text of the file `name`; decimals after the twelfth are cut off.
    ///
    /// # Errors
    /// Fails if the text is not TOML; if a key is missing, unknown or of the wrong type; if a threshold is not a
    /// finite number in 0..=18446744; or if `tau_low` is above `tau_high`. The message names file, line and key,
    /// and says what to write instead.
    pub fn parse(text: &str, name: &str) -> Result<Self> {
        // Some editors put a byte-order mark in front.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let table = DeTable::parse(text).map_err(|error| {
            let line = error.span().map_or(1, |span| line_at(text, span.start));
            let message = error.message().replace('\n', ", ");
            error!(
                Damaged,
                "{name}: line {line}: not valid TOML ({message}): correct this line"
            )
        })?;
        let mut tau_low = None;
        let mut tau_high = None;
        let mut window_us = None;
        let mut windows = None;
        let mut sources = Vec::new();
        for (key, value) in table.get_ref() {
            let line = line_at(text, key.span().start);
            let here = || format!("{name}: line {line}: {}", key.get_ref());
            match key.get_ref().as_ref() {
                "tau_low" => tau_low = Some(threshold(value).with_context(here)?),
                "tau_high" => tau_high = Some((threshold(value).with_context(here)?, line)),
                "window_us" => {
                    let duration = integer(value).and_then(|v| u32::try_from(v).ok());
                    window_us = Some(duration.and_then(NonZeroU32::new).with_context(|| {
                        format!(
                            "{}: must be an integer in 1..={} (microseconds)",
                            here(),
                            u32::MAX
                        )
                    })?);
                }
                "windows" => {
                    windows =
                        Some(integer(value).with_context(|| {
                            format!("{}: must be an integer, 0 or above", here())
                        })?);
                }
                "sources" => {
                    sources = strings(value).with_context(|| {
                        format!("{}: must be an array of file names in quotes", here())
                    })?;
                }
                _ => bail!(
                    Damaged,
                    "{}: unknown key: remove it; the keys are tau_low, tau_high, window_us, \
                     windows and sources",
                    here()
                ),
            }
        }
        let missing = |key: &str| {
            format!("{name}: {key} is missing: add a line such as `{key} = 0.4` at the top")
        };
        let tau_low_pico = tau_low.with_context(|| missing("tau_low"))?;
        let (tau_high_pico, line) = tau_high.with_context(|| missing("tau_high"))?;
        if tau_low_pico > tau_high_pico {
            bail!(
                Damaged,
                "{name}: line {line}: tau_high = {} is below tau_low = {}: raise it or lower \
                 tau_low",
                decimal(tau_high_pico),
                decimal(tau_low_pico)
            );
        }
        Ok(Self {
            tau_low_pico,
            tau_high_pico,
            window_us,
            windows,
            sources,
        })
    }
}

fn threshold(value: &Spanned<DeValue<'_>>) -> Result<u64> {
    match value.get_ref() {
        DeValue::Float(float) => pico_from_decimal(float.as_str()),
        DeValue::Integer(integer) if integer.radix() == 10 => pico_from_decimal(integer.as_str()),
        other => bail!(
            Damaged,
            "must be a decimal number without quotes such as 0.4, not a {}",
            other.type_str()
        ),
    }
}

fn integer(value: &Spanned<DeValue<'_>>) -> Option<u64> {
    let integer = value.get_ref().as_integer()?;
    u64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn strings(value: &Spanned<DeValue<'_>>) -> Option<Vec<String>> {
    let array = value.get_ref().as_array()?;
    array
        .iter()
        .map(|item| item.get_ref().as_str().map(str::to_owned))
        .collect()
}

/// Returns the number of the line that contains byte `offset`; the first line is 1.
fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&b| b == b'\n').count()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parse(text: &str) -> Result<ThresholdsFile> {
        ThresholdsFile::parse(text, "t.toml")
    }

    /// Returns the whole error message, as the command prints it.
    fn error(text: &str) -> String {
        format!("{:#}", parse(text).unwrap_err())
    }

    fn example() -> ThresholdsFile {
        ThresholdsFile {
            tau_low_pico: 371_000_000_000,
            tau_high_pico: u64::MAX,
            window_us: NonZeroU32::new(32_768),
            windows: Some(4_211),
            sources: vec!["a b.raw".into(), "C:\\d\"\n#é.h5".into()],
        }
    }

    #[test]
    fn written_file_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("thresholds.toml");
        std::fs::write(&path, example().to_toml()).unwrap();
        assert_eq!(ThresholdsFile::read(&path).unwrap(), example());
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\ntau_low = 0.371000000000\n"), "{text}");
        assert!(
            text.contains("\ntau_high = 18446744.073709551615\n"),
            "{text}"
        );
        // With the mark that some editors put in front; an error's line is that of the file.
        std::fs::write(&path, format!("\u{feff}{text}")).unwrap();
        assert_eq!(ThresholdsFile::read(&path).unwrap(), example());
        std::fs::write(&path, "\u{feff}tau_low = 1\ntau_high = x\n").unwrap();
        let error = ThresholdsFile::read(&path).unwrap_err().to_string();
        assert!(error.contains("line 2"), "{error}");
        // Other TOML parsers read it too.
        let value: toml::Value = toml::from_str(&text).unwrap();
        assert_eq!(value["tau_low"].as_float(), Some(0.371));
        // Every key has a comment on the line before it.
        let lines: Vec<&str> = text.lines().collect();
        for key in ["tau_low", "tau_high", "window_us", "windows", "sources"] {
            let at = lines
                .iter()
                .position(|l| l.starts_with(&format!("{key} =")))
                .unwrap();
            assert!(lines[at - 1].starts_with('#'), "{key}");
        }
    }

    #[test]
    fn a_person_may_write_two_lines() {
        let file = parse("tau_low = 0.4\ntau_high = 2\n").unwrap();
        assert_eq!(
            file,
            ThresholdsFile {
                tau_low_pico: 400_000_000_000,
                tau_high_pico: 2_000_000_000_000,
                window_us: None,
                windows: None,
                sources: vec![],
            }
        );
        assert_eq!(parse(&file.to_toml()).unwrap(), file);
        let edited = "# mine\r\n  tau_high=1_000.5 # dense\r\ntau_low = 1_0\r\n";
        assert_eq!(parse(edited).unwrap().tau_high_pico, 1_000_500_000_000_000);
        assert_eq!(parse(edited).unwrap().tau_low_pico, 10_000_000_000_000);
        assert!(parse("tau_low = 1.5\ntau_high = 1.5").is_ok());
    }

    #[test]
    fn errors_name_file_line_and_key() {
        for (text, parts) in [
            (
                "tau_low = 0.4\n",
                vec!["t.toml: tau_high is missing", "tau_high = "],
            ),
            ("", vec!["t.toml: tau_low is missing"]),
            (
                "tau_low = -0.1\ntau_high = 1.0",
                vec!["t.toml: line 1: tau_low", "negative"],
            ),
            (
                "tau_low = 0.1\n\ntau_high = inf",
                vec!["t.toml: line 3: tau_high", "finite"],
            ),
            (
                "tau_low = nan\ntau_high = 1.0",
                vec!["line 1: tau_low", "finite"],
            ),
            (
                "tau_low = 0.1\ntau_high = 1e9",
                vec!["line 2: tau_high", "too large"],
            ),
            (
                "tau_low = '0.1'\ntau_high = 1.0",
                vec!["line 1: tau_low", "without quotes"],
            ),
            (
                "tau_low = 0x1\ntau_high = 1.0",
                vec!["line 1: tau_low", "decimal"],
            ),
            (
                "tau_low = 3.0\ntau_high = 2.5",
                vec!["line 2: tau_high = 2.5", "tau_low = 3.0"],
            ),
            (
                "tau_low = 3,0\ntau_high = 9.5",
                vec!["t.toml: line 1", "TOML"],
            ),
            ("tau_low = .4\ntau_high = 9.5", vec!["t.toml: line 1"]),
            (
                "tau_low = 1.0\ntau_low = 2.0",
                vec!["t.toml: line 2", "TOML"],
            ),
            (
                "tau_low = 1.0\ntau_hi = 2.0",
                vec!["line 2: tau_hi", "unknown key"],
            ),
            (
                "tau_low = 1.0\ntau_high = 2.0\nwindow_us = 0",
                vec!["line 3: window_us", "1..="],
            ),
            (
                "tau_low = 1.0\ntau_high = 2.0\nwindow_us = 1.5",
                vec!["line 3: window_us"],
            ),
            (
                "tau_low = 1.0\ntau_high = 2.0\nwindows = -1",
                vec!["line 3: windows"],
            ),
            (
                "tau_low = 1.0\ntau_high = 2.0\nsources = [1]",
                vec!["line 3: sources", "quotes"],
            ),
        ] {
            let message = error(text);
            assert!(
                parts.iter().all(|part| message.contains(part)),
                "{text:?}: {message}"
            );
            assert!(!message.contains('\n'), "{message:?}");
        }
    }

    #[test]
    fn unreadable_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none.toml");
        let message = format!("{:#}", ThresholdsFile::read(&path).unwrap_err());
        assert!(
            message.contains("none.toml") && message.contains("eecvs calibrate"),
            "{message}"
        );
        std::fs::write(&path, b"tau_low = 1\n\xFF").unwrap();
        let message = format!("{:#}", ThresholdsFile::read(&path).unwrap_err());
        assert!(message.contains("none.toml: byte 12"), "{message}");
        File::create(&path)
            .unwrap()
            .set_len(FILE_BYTES_MAX + 1)
            .unwrap();
        assert!(
            ThresholdsFile::read(&path)
                .unwrap_err()
                .to_string()
                .contains("larger")
        );
    }

    proptest! {
        #[test]
        fn every_threshold_reads_back(a in any::<u64>(), b in any::<u64>(), small in any::<u16>()) {
            for (a, b) in [(a, b), (u64::from(small), b)] {
                let file = ThresholdsFile {
                    tau_low_pico: a.min(b), tau_high_pico: a.max(b), ..example()
                };
                prop_assert_eq!(parse(&file.to_toml()).unwrap(), file);
            }
        }

        #[test]
        fn sources_of_any_name_read_back(sources in prop::collection::vec(".*", 0..4)) {
            let file = ThresholdsFile { sources, ..example() };
            prop_assert_eq!(parse(&file.to_toml()).unwrap(), file);
        }

        #[test]
        fn no_text_panics(text in "(tau_low|tau_high|windows|[ =\n.e+0-9_\\[\\]\"'-]){0,40}") {
            let _ = parse(&text);
        }
    }
}
