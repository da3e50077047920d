//! Measures what few events as times save a receiver who fixes the transform, M and the step.
//!
//! ```text
//! input, whole -> transform, M, coder -> levels alone | few events as times -> bytes of the file
//! ```
//!
//! In both files every kept coefficient is within half a step of that of the events, which
//! `the_link_keeps_the_oracles_coefficients` in `tests/across/fixed_vs_float.rs` checks on the decoder's side.

use anyhow::{Context, Result};
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_bench::source::Source;
use eecvs_nostd::{Coder, Config, Mode, Quantiser, Transform};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::round_trip::{Encoded, config};

/// Numbers M of coefficients.
pub const M: [u8; 3] = [8, 16, 32];
/// log2 of the quantiser's step.
pub const STEP_LOG2: i8 = -6;
/// Coders by their names, the default first.
pub const CODERS: [(&str, Mode); 3] = [
    ("plain", Mode::Transform),
    ("fast", Mode::Coefficients(Coder::Fast)),
    ("dense", Mode::Coefficients(Coder::Dense)),
];

/// Bytes of an input's file in both ways; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the scene or recording.
    pub input: String,
    /// Number of events.
    pub events: u64,
    /// Name of the transform.
    pub transform: String,
    /// Number of coefficients M.
    pub m: u8,
    /// Name of the coder.
    pub coder: String,
    /// Bytes with all pixels as levels.
    pub levels_bytes: u64,
    /// Bytes with pixels of few events as times.
    pub best_bytes: u64,
}

/// Measures all inputs on every thread, and returns their rows in the order of the inputs; `progress` is called after
/// each row.
///
/// # Errors
/// Fails if an event is in no frame.
pub fn measure(inputs: &[Source], progress: &(dyn Fn() + Sync)) -> Result<Vec<Row>> {
    let settings: Vec<_> = Transform::ALL
        .into_iter()
        .flat_map(|transform| M.map(|m| (transform, m)))
        .flat_map(|(transform, m)| CODERS.map(|coder| (transform, m, coder)))
        .collect();
    let jobs: Vec<_> = inputs
        .iter()
        .flat_map(|input| settings.iter().map(move |setting| (input, setting)))
        .collect();
    jobs.par_iter()
        .with_max_len(1)
        .map(|(input, (transform, m, (coder, mode)))| {
            let thresholds = ThresholdsFile::scenes()?.thresholds()?;
            let bytes = |few_as_times| -> Result<u64> {
                let config = Config {
                    few_as_times,
                    quantiser: Quantiser::new(STEP_LOG2).context("a step out of range")?,
                    ..config(input, thresholds, *mode, Some(*transform), *m)
                };
                Ok(Encoded::new(input, config)?.file.len() as u64)
            };
            let row = Row {
                input: input.name.clone(),
                events: input.events.len() as u64,
                transform: transform.name().to_owned(),
                m: *m,
                coder: (*coder).to_owned(),
                levels_bytes: bytes(false)?,
                best_bytes: bytes(true)?,
            };
            progress();
            Ok(row)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use event_emulator::Preset;

    use super::*;

    #[test]
    fn every_setting_has_a_row_and_none_takes_more_but_its_headers() {
        let scene = Source::scene(Preset::IndoorDarkBlur, 1, 40_000).unwrap();
        let rows = measure(&[scene], &|| ()).unwrap();
        assert_eq!(rows.len(), 27);
        // Two windows, whose headers say it in up to two bytes.
        for row in &rows {
            assert!(row.best_bytes <= row.levels_bytes + 4, "{row:?}");
        }
        let plain = rows.iter().filter(|row| row.coder == "plain");
        assert!(
            plain.clone().count() == 9
                && plain
                    .into_iter()
                    .all(|row| row.best_bytes < row.levels_bytes)
        );
    }
}
