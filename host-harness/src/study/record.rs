//! Of what a study is made, by what, and when.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::effort::Effort;
use super::set::{SEED, Set};
use crate::recordings::LeftOut;
use crate::source::{Source, WINDOW_US};

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

/// Processor and threads, as the system tells them.
#[must_use]
pub fn machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = text
        .lines()
        .find(|line| line.starts_with("model name"))
        .and_then(|line| line.split_once(':'))
        .map_or(std::env::consts::ARCH, |(_, model)| model.trim());
    format!("{model}, {threads} threads, {}", std::env::consts::OS)
}

/// Today's, as `2026-11-22`.
#[must_use]
pub fn date() -> String {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let (year, month, day) = civil(since.as_secs() / 86_400);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Year, month and day of a day since 1970-01-01, year by year.
fn civil(days: u64) -> (u64, u64, u64) {
    let mut rest = days;
    let mut year = 1970;
    loop {
        let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
        let length = if is_leap { 366 } else { 365 };
        if rest < length {
            let february = if is_leap { 29 } else { 28 };
            let months = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
            let mut month = 1;
            for length in months {
                if rest < length {
                    break;
                }
                rest -= length;
                month += 1;
            }
            return (year, month, rest + 1);
        }
        rest -= length;
        year += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_have_their_dates() {
        assert_eq!(civil(0), (1970, 1, 1));
        assert_eq!(civil(11_016), (2000, 2, 29));
        assert_eq!(civil(11_017), (2000, 3, 1));
        assert_eq!(civil(20_779), (2026, 11, 22));
        assert_eq!(civil(20_818), (2026, 12, 31));
    }
}
