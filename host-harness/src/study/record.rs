//! Records what a study measured, with which program, and when.

use eecvs_bench::machine::{SEED, date, machine};
use eecvs_bench::source::{Source, WINDOW_US};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::effort::Effort;
use super::set::Set;
use crate::recordings::LeftOut;

/// Identifies a source beyond its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceRecord {
    /// `scenes` or `recordings`.
    pub set: String,
    /// Name of the source in the set.
    pub source: String,
    /// Columns and rows of the sensor.
    pub sensor: [u16; 2],
    /// Number of events in the part that is measured.
    pub events: u64,
    /// Time from the first event to the last, in seconds.
    pub duration_s: f64,
    /// SHA-256 of the events: t, x, y and polarity as little-endian u64, u16, u16 and u8.
    pub sha256: String,
}

/// Number of rows that one build of the program measured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// SHA-256 of the program's file.
    pub program: String,
    /// Number of rows.
    pub rows: usize,
}

/// What the results depend on; also the machine and the day, on which only measured times depend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Version of this program.
    pub version: String,
    /// SHA-256 of the program file that started the study. Rows of another build are measured again unless they are
    /// to be kept.
    pub program: String,
    /// Every build that measured rows; only in results, and empty in results from versions that did not record it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub builds: Vec<Build>,
    /// `full` or `quick`.
    pub effort: String,
    /// Seed of the scenes.
    pub seed: u64,
    /// Duration T of a window in us.
    pub window_us: u32,
    /// Every source.
    pub sources: Vec<SourceRecord>,
    /// Files that were found but left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// The model of `--segmenter`, or the built-in segmenter.
    pub segmenter: String,
    /// Processor and number of its threads.
    pub machine: String,
    /// Day of the first row, UTC.
    pub date: String,
}

impl Record {
    /// Makes the record of a study that starts now.
    #[must_use]
    pub fn new(sets: &[Set], left_out: &[LeftOut], effort: &Effort, segmenter: &str) -> Self {
        let of_set = |set: &Set| {
            let name = set.name;
            set.sources
                .iter()
                .map(|source| SourceRecord::new(name, source))
                .collect::<Vec<_>>()
        };
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            program: program(),
            builds: Vec::new(),
            effort: effort.name.to_owned(),
            seed: SEED,
            window_us: WINDOW_US,
            sources: sets.iter().flat_map(of_set).collect(),
            left_out: left_out.to_vec(),
            segmenter: segmenter.to_owned(),
            machine: machine(),
            date: date(),
        }
    }

    /// Returns whether rows of one study are valid for the other: everything agrees except the machine, the day,
    /// the files left out and, unless `same_program`, the program.
    #[must_use]
    pub fn is_same_study(&self, other: &Self, same_program: bool) -> bool {
        let program = if same_program { other } else { self };
        let alike = Self {
            program: program.program.clone(),
            machine: self.machine.clone(),
            date: self.date.clone(),
            left_out: self.left_out.clone(),
            ..other.clone()
        };
        *self == alike
    }
}

impl SourceRecord {
    fn new(set: &str, source: &Source) -> Self {
        let mut hash = Sha256::new();
        for event in source.events.iter() {
            hash.update(event.t_us.to_le_bytes());
            hash.update(event.x.to_le_bytes());
            hash.update(event.y.to_le_bytes());
            hash.update([u8::from(event.polarity == eecvs_nostd::Polarity::On)]);
        }
        let last_us = source.events.last().map_or(0, |event| event.t_us);
        Self {
            set: set.to_owned(),
            source: source.name.clone(),
            sensor: [source.sensor.width, source.sensor.height],
            events: source.events.len() as u64,
            duration_s: (last_us - source.start_us()) as f64 * 1e-6,
            sha256: hex(&hash.finalize()),
        }
    }
}

fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the SHA-256 of this program's file; empty if the system does not name it, when the version must suffice.
fn program() -> String {
    let bytes = std::env::current_exe().and_then(std::fs::read);
    bytes.map_or_else(|_| String::new(), |bytes| hex(&Sha256::digest(bytes)))
}
