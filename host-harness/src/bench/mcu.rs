//! Instructions of the accumulate stage on a microcontroller, as they were saved.
//!
//! `firmware/instructions.sh` counts them in QEMU on the cuts of [`super::cut`] and saves them with
//! the project; nothing runs here.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use serde::Deserialize;

const SAVED: &str = include_str!("../../../firmware/instructions.json");

/// What is read of a line.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Count {
    /// `recordings` or `emulator`.
    pub origin: String,
    /// Name of the cut.
    pub cut: String,
    /// Lower-case name.
    pub transform: String,
    /// M.
    pub m: u8,
    /// Events of the cut.
    pub events: u64,
    stages: BTreeMap<String, u64>,
}

impl Count {
    /// Instructions per event of the accumulate stage.
    #[must_use]
    pub fn accumulate(&self) -> Option<f64> {
        let count = *self.stages.get("accumulate")?;
        (self.events > 0).then(|| count as f64 / self.events as f64)
    }
}

/// The saved counts.
///
/// # Errors
/// A file that this program does not understand.
pub fn saved() -> Result<Vec<Count>> {
    SAVED
        .lines()
        .map(|line| serde_json::from_str(line).context("firmware/instructions.json: save it anew"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_saved_run_has_an_accumulate_stage() {
        let counts = saved().unwrap();
        assert!(counts.len() >= 6);
        assert!(counts.iter().all(|count| count.accumulate().is_some()));
    }
}
