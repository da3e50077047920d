//! Reads and writes records: measured rows in committed JSON files, from which the documents' tables are made.
//!
//! A file is one object with one row per line, which keeps its diffs readable:
//!
//! ```text
//! {"version":"0.1.0","machine":"...","date":"2026-11-22","rows":[
//! {...},
//! {...}
//! ]}
//! ```

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};
use event_files::output;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};

use crate::machine::{SEED, date, machine};

/// Rows, with the version, seed, machine and date of their measurement.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct RecordFile<R> {
    /// Version of the program that measured the rows.
    pub version: String,
    /// Seed of the emulated scenes, [`SEED`]; `None` if the file does not contain it.
    pub seed: Option<u64>,
    /// Processor, number of threads and operating system, on which measured times depend.
    pub machine: String,
    /// Date of the measurement (UTC), as `2026-11-22`.
    pub date: String,
    /// The rows, in the order in which they were written.
    pub rows: Vec<R>,
}

/// Returns the path of the record `name` in a folder of records.
#[must_use]
pub fn path(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.json"))
}

/// Writes rows that were measured just now as the record `name`, and creates the folder if necessary.
///
/// The record gets the version of this program, [`SEED`], this machine and today's date.
///
/// # Errors
/// Fails if the folder or the file cannot be written; the message names it.
pub fn write<R: Serialize>(folder: &Path, name: &str, rows: &[R]) -> Result<()> {
    fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot create the folder", folder.display()))?;
    let path = path(folder, name);
    Ok(output::write(&path, text(rows)?)?)
}

/// Reads the record `name` from a folder of records.
///
/// # Errors
/// Fails if the file cannot be read or is not a record of rows of the type `R`; the message names the file.
pub fn read<R: DeserializeOwned>(folder: &Path, name: &str) -> Result<RecordFile<R>> {
    let path = path(folder, name);
    let text =
        fs::read_to_string(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
    // Some editors put a byte-order mark in front.
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    serde_json::from_str(text)
        .with_context(|| format!("{}: is not a record of these rows", path.display()))
}

fn text<R: Serialize>(rows: &[R]) -> Result<String> {
    let head = serde_json::json!({
        "version": env!("CARGO_PKG_VERSION"),
        "seed": SEED,
        "machine": machine(),
        "date": date(),
    })
    .to_string();
    let rows: Vec<String> = rows
        .iter()
        .map(serde_json::to_string)
        .collect::<Result<_, _>>()?;
    // The object stays open for its rows.
    let head = head.trim_end_matches('}');
    Ok(format!("{head},\"rows\":[\n{}\n]}}\n", rows.join(",\n")))
}

/// A name in a row, for example of a kernel, a codec or a transform.
pub type Name = &'static str;

/// Deserialises a [`Name`]. Each different name is leaked once and kept until the program ends; there are few.
///
/// # Errors
/// Fails if the value is not a string.
pub fn name<'de, D: Deserializer<'de>>(input: D) -> Result<Name, D::Error> {
    static KNOWN: Mutex<BTreeSet<Name>> = Mutex::new(BTreeSet::new());
    let text = String::deserialize(input)?;
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(name) = known.get(text.as_str()) {
        return Ok(name);
    }
    let name: Name = text.leak();
    known.insert(name);
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    struct Row {
        #[serde(deserialize_with = "name")]
        name: Name,
        value: Option<f64>,
    }

    #[test]
    fn rows_come_back_and_a_foreign_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new");
        let row = |name, value| Row { name, value };
        for rows in [
            vec![],
            vec![row("a", Some(0.1)), row("b", None), row("a", None)],
        ] {
            write(&folder, "some", &rows).unwrap();
            let record: RecordFile<Row> = read(&folder, "some").unwrap();
            assert_eq!(record.rows, rows);
            assert_eq!(record.version, env!("CARGO_PKG_VERSION"));
            let path = path(&folder, "some");
            let marked = format!("\u{feff}{}", fs::read_to_string(&path).unwrap());
            fs::write(&path, marked).unwrap();
            let record: RecordFile<Row> = read(&folder, "some").unwrap();
            assert_eq!(record.rows, rows);
        }
        let said = |name| format!("{:#}", read::<Row>(&folder, name).unwrap_err());
        assert!(said("none").contains("none.json: cannot be read"));
        fs::write(path(&folder, "other"), "{\"rows\":3}").unwrap();
        assert!(said("other").contains("other.json: is not a record"));
    }
}
