//! Stores the rows of a study on disk, so that an interrupted study can resume.
//!
//! `rows.jsonl` holds a line on what is measured ([`Record`]), then one line per finished task with its rows. The
//! task of an incomplete line, left by a study that was killed, is measured again.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::Results;
use super::density::Densities;
use super::kernels::KernelRow;
use super::perception::Perception;
use super::quality::Quality;
use super::record::{Build, Record};
use super::speed::Speed;
use super::times::Times;

/// A row of any table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Row {
    /// Row of Tables I and II.
    Quality(Quality),
    /// Row of Table III.
    Speed(Speed),
    /// Row of Tables IV and V.
    Perception(Perception),
    /// Errors of times.
    Times(Times),
    /// Densities of a set.
    Density(Densities),
    /// Run time against error of a kernel.
    Kernel(KernelRow),
}

#[derive(Debug, Serialize, Deserialize)]
struct Finished {
    task: String,
    /// SHA-256 of the program that measured it; `None` if it is the record's program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    program: Option<String>,
    rows: Vec<Row>,
}

/// The file of rows, open for appending.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    record: Record,
    /// SHA-256 of this program, if it is not the record's.
    program: Option<String>,
    inside: Mutex<Inside>,
}

#[derive(Debug)]
struct Inside {
    file: File,
    tasks: BTreeSet<String>,
    rows: Vec<(String, Row)>,
    /// Number of rows per program.
    builds: BTreeMap<String, usize>,
}

impl Inside {
    fn add(&mut self, finished: Finished, first_program: &str) {
        let Finished {
            task,
            program,
            rows,
        } = finished;
        let program = program.unwrap_or_else(|| first_program.to_owned());
        if !rows.is_empty() {
            *self.builds.entry(program).or_default() += rows.len();
        }
        let named = rows.into_iter().map(|row| (task.clone(), row));
        self.rows.extend(named);
        self.tasks.insert(task);
    }
}

/// What a store of an earlier run holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Earlier {
    /// No store, or an empty one.
    Nothing,
    /// Rows of the same study.
    Same,
    /// Rows of the same study, which another build of the program started.
    OtherBuild,
    /// Rows of another study, or something else.
    Other,
}

/// Returns what the store at `path` holds for the study of `record`.
///
/// # Errors
/// Fails if the file cannot be read; the message names it.
pub fn earlier(path: &Path, record: &Record) -> Result<Earlier> {
    let text = text(path)?;
    if text.is_empty() {
        return Ok(Earlier::Nothing);
    }
    Ok(match first(&text) {
        Some(known) if known.is_same_study(record, true) => Earlier::Same,
        Some(known) if known.is_same_study(record, false) => Earlier::OtherBuild,
        _ => Earlier::Other,
    })
}

/// Reads a store; one that does not exist is empty.
fn text(path: &Path) -> Result<String> {
    match std::fs::read(path) {
        Ok(bytes) => {
            let text = String::from_utf8_lossy(&bytes);
            // Some editors put a byte-order mark in front.
            Ok(text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned())
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(String::new()),
        Err(error) => Err(error).with_context(|| format!("{}: cannot be opened", path.display())),
    }
}

/// Returns the record in the first line of a store.
fn first(text: &str) -> Option<Record> {
    let first = text.split_inclusive('\n').next()?;
    let whole = first.strip_suffix('\n')?;
    serde_json::from_str(whole).ok()
}

impl Store {
    /// Opens the store of a study; returns it with the number of tasks finished.
    ///
    /// Starts a new store if there is none, if it belongs to another study, or, with `same_program`, if another
    /// build started it.
    ///
    /// # Errors
    /// Fails if the file cannot be read or written; the message names it.
    pub fn open(path: &Path, record: Record, same_program: bool) -> Result<(Self, usize)> {
        let name = || format!("{}: cannot be opened", path.display());
        let text = text(path)?;
        let known = first(&text).filter(|known| known.is_same_study(&record, same_program));
        let lines = text.split_inclusive('\n').skip(1);
        let mut whole = String::new();
        let mut finished: Vec<Finished> = Vec::new();
        let mut tasks = BTreeSet::new();
        if known.is_some() {
            for line in lines.filter(|line| line.ends_with('\n')) {
                let Ok(task) = serde_json::from_str::<Finished>(line) else {
                    continue;
                };
                if tasks.insert(task.task.clone()) {
                    whole += line;
                    finished.push(task);
                }
            }
        }
        let program = record.program.clone();
        // The files left out are not part of the study, and may differ today.
        let record = Record {
            left_out: record.left_out.clone(),
            ..known.unwrap_or(record)
        };
        let head = serde_json::to_string(&record)? + "\n" + &whole;
        // The rows took hours to measure: a full disk must not cost them.
        event_files::output::write(path, head)?;
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .with_context(name)?;
        let count = finished.len();
        let mut inside = Inside {
            file,
            tasks: BTreeSet::new(),
            rows: Vec::new(),
            builds: BTreeMap::new(),
        };
        for finished in finished {
            inside.add(finished, &record.program);
        }
        let store = Self {
            path: path.to_owned(),
            program: Some(program).filter(|program| *program != record.program),
            record,
            inside: Mutex::new(inside),
        };
        Ok((store, count))
    }

    /// Returns whether a task is finished.
    #[must_use]
    pub fn has(&self, task: &str) -> bool {
        self.inside
            .lock()
            .is_ok_and(|inside| inside.tasks.contains(task))
    }

    /// Adds the rows of a task and marks it as finished.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn add(&self, task: &str, rows: impl IntoIterator<Item = Row>) -> Result<()> {
        let finished = Finished {
            task: task.to_owned(),
            program: self.program.clone(),
            rows: rows.into_iter().collect(),
        };
        let line = serde_json::to_string(&finished)? + "\n";
        // A thread that panicked while holding the lock cannot have left a row half added.
        let mut inside = self
            .inside
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        inside
            .file
            .write_all(line.as_bytes())
            .with_context(|| format!("{}: cannot be written", self.path.display()))?;
        inside.add(finished, &self.record.program);
        Ok(())
    }

    /// Returns all results so far, in the order of the tasks' names.
    #[must_use]
    pub fn results(&self) -> Results {
        let inside = self
            .inside
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut rows: Vec<&(String, Row)> = inside.rows.iter().collect();
        rows.sort_by(|a, b| a.0.cmp(&b.0));
        let builds = inside.builds.iter().map(|(program, rows)| Build {
            program: program.clone(),
            rows: *rows,
        });
        let mut results = Results {
            record: Record {
                builds: builds.collect(),
                ..self.record.clone()
            },
            quality: Vec::new(),
            speed: Vec::new(),
            perception: Vec::new(),
            times: Vec::new(),
            density: Vec::new(),
            kernels: Vec::new(),
        };
        for (_, row) in rows {
            match row.clone() {
                Row::Quality(row) => results.quality.push(row),
                Row::Speed(row) => results.speed.push(row),
                Row::Perception(row) => results.perception.push(row),
                Row::Times(row) => results.times.push(row),
                Row::Density(row) => results.density.push(row),
                Row::Kernel(row) => results.kernels.push(row),
            }
        }
        results
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::effort::Effort;

    fn row() -> Row {
        Row::Speed(Speed {
            target: "t".to_owned(),
            method: "dct".to_owned(),
            m: 8,
            events_per_window: 3200.0,
            us_per_window: 0.1 + 0.2,
            spread_us: 0.0,
            kev_per_s: 1.0,
            relative: 1.0,
            instructions_per_event: None,
            bits_per_event: Some(9.0),
            emd_pixel_us: Some(0.1),
        })
    }

    #[test]
    fn what_was_ended_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.jsonl");
        let record = Record::new(&[], &[], &Effort::QUICK, "built-in");
        let (store, count) = Store::open(&path, record.clone(), true).unwrap();
        assert_eq!(count, 0);
        store.add("one", [row()]).unwrap();
        store.add("two", [row(), row()]).unwrap();
        drop(store);
        // Simulates a study killed while it wrote a line.
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"task\":\"three\",\"rows\":[").unwrap();
        let (store, count) = Store::open(&path, record.clone(), true).unwrap();
        assert_eq!(count, 2);
        assert!(store.has("two") && !store.has("three"));
        store.add("three", []).unwrap();
        assert_eq!(store.results().speed.len(), 3);
        assert_eq!(Row::Speed(store.results().speed[0].clone()), row());
        // On another day it is the same study; with other sources or another seed it is not.
        let later = Record {
            date: "2030-01-01".to_owned(),
            ..record.clone()
        };
        let (store, count) = Store::open(&path, later, true).unwrap();
        let of = |program: &str, rows| Build {
            program: program.to_owned(),
            rows,
        };
        let first = of(&record.program, 3);
        let built = |builds: &[Build]| Record {
            builds: builds.to_vec(),
            ..record.clone()
        };
        assert_eq!(count, 3);
        assert_eq!(store.results().record, built(std::slice::from_ref(&first)));
        let rebuilt = Record {
            program: "another".to_owned(),
            ..record.clone()
        };
        // Rows of another build are attributed to it.
        let (store, count) = Store::open(&path, rebuilt.clone(), false).unwrap();
        assert_eq!(count, 3);
        store.add("four", [row(), row()]).unwrap();
        let mut both = [first, of("another", 2)];
        both.sort_by(|a, b| a.program.cmp(&b.program));
        assert_eq!(store.results().record, built(&both));
        let (store, count) = Store::open(&path, record.clone(), true).unwrap();
        assert_eq!((count, store.results().record), (4, built(&both)));
        let other = Record {
            seed: 7,
            ..record.clone()
        };
        assert_eq!(earlier(&path, &record).unwrap(), Earlier::Same);
        assert_eq!(earlier(&path, &rebuilt).unwrap(), Earlier::OtherBuild);
        assert_eq!(earlier(&path, &other).unwrap(), Earlier::Other);
        let absent = folder.path().join("none.jsonl");
        assert_eq!(earlier(&absent, &record).unwrap(), Earlier::Nothing);
        assert_eq!(Store::open(&path, rebuilt, true).unwrap().1, 0);
        assert_eq!(Store::open(&path, other, false).unwrap().1, 0);
    }

    #[test]
    fn a_file_of_something_else_is_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.jsonl");
        for bytes in [&b"\xff\xfe\n{}"[..], b"{}\n{}\n", b"\n\n"] {
            std::fs::write(&path, bytes).unwrap();
            let record = Record::new(&[], &[], &Effort::QUICK, "built-in");
            assert_eq!(earlier(&path, &record).unwrap(), Earlier::Other);
            let (store, count) = Store::open(&path, record, true).unwrap();
            assert_eq!(count, 0);
            store.add("one", [row()]).unwrap();
            assert_eq!(store.results().speed.len(), 1);
        }
    }
}
