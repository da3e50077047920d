//! Of what a study is made, by what, and when.

use eecvs_bench::machine::{SEED, date, machine};
use eecvs_bench::source::{Source, WINDOW_US};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::effort::Effort;
use super::set::Set;
use crate::recordings::LeftOut;

/// A source, so that another one of its name is told from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceRecord {
    /// `scenes` or `recordings`.
    pub set: String,
    /// Of the set.
    pub source: String,
    /// Pixels in a row, and rows.
    pub sensor: [u16; 2],
    /// In what is measured of it.
    pub events: u64,
    /// From the first event to the last.
    pub duration_s: f64,
    /// SHA-256 of its events: t, x, y and polarity as little-endian u64, u16, u16 and u8.
    pub sha256: String,
}

/// Rows that a build of the program has measured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// SHA-256 of the program's file.
    pub program: String,
    /// How many.
    pub rows: usize,
}

/// What results depend on, and the machine and the day, which only times of a clock depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Of this program.
    pub version: String,
    /// SHA-256 of the file of the program that measured first: rows of another build are measured again
    /// unless they are to be kept.
    pub program: String,
    /// Every build that measured something; in results alone, and not in those of before it was kept.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub builds: Vec<Build>,
    /// `full` or `quick`.
    pub effort: String,
    /// Of the scenes.
    pub seed: u64,
    /// T.
    pub window_us: u32,
    /// Every one.
    pub sources: Vec<SourceRecord>,
    /// Files that were found and are not among them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// The model of `--segmenter`, or the one that is built in.
    pub segmenter: String,
    /// Processor and its threads.
    pub machine: String,
    /// Day of the first row, UTC.
    pub date: String,
}

impl Record {
    /// Of a study that begins now.
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

    /// Whether rows of one study are rows of the other: all but machine, day and what is left out
    /// agree, and, if asked, the program.
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

/// Nothing where the system does not tell, in which case the version has to do.
fn program() -> String {
    let bytes = std::env::current_exe().and_then(std::fs::read);
    bytes.map_or_else(|_| String::new(), |bytes| hex(&Sha256::digest(bytes)))
}
