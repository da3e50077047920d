//! Finds the recordings in files and folders, each one once.
//!
//! ```text
//! paths -> files -> events -> taken
//!                          -> left out: the same events as a file that is taken, or no recording
//! ```
//!
//! Files are compared by their events, not by their paths, because data sets hold the same events in several
//! formats.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use eecvs_bench::source::Source;
use eecvs_nostd::{Event, Polarity};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Extensions that a folder is searched for. Of files with the same events, the one whose extension comes first
/// here is taken: files written by sensors come before archives of them. Arrays and text count only if they are
/// named, since their extensions do not imply that they hold events.
const ENDINGS: [&str; 6] = ["aedat4", "aedat", "raw", "evt2", "h5", "hdf5"];

/// A recording that is taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recording<T> {
    /// Name, distinct from that of every other recording taken.
    pub name: String,
    /// Path of the file.
    pub path: PathBuf,
    /// What the caller's `keep` returned for it.
    pub kept: T,
}

/// Reason why a file is left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Why {
    /// A file that is taken has the same events: the same times counted from the first event, positions and
    /// polarities; events of equal time may be in another order.
    SameEventsAs(String),
    /// The file was found in a folder, and cannot be read or has no events.
    NotRead(String),
    /// This many files with this extension were found in a folder, but folders are not searched for that extension.
    PassedBy(u64),
    /// This many files with this extension were found in a folder below those that are searched.
    TooDeep(u64),
}

/// A file, or a pattern of files, that is left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Path of the file.
    pub file: String,
    /// Why it is left out.
    pub why: Why,
}

/// Recordings found in some paths.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recordings<T> {
    /// Recordings taken, in the order of their paths; those of a folder are sorted.
    pub taken: Vec<Recording<T>>,
    /// Files left out.
    pub left_out: Vec<LeftOut>,
}

/// A file that may be a recording.
#[derive(Debug, Clone)]
struct File {
    path: PathBuf,
    /// Position of its extension in [`ENDINGS`], counted from 1; 0 if the file was named.
    rank: usize,
    /// Whether it lies in a folder inside a folder that was named.
    is_below: bool,
}

/// Reads every recording in `paths`, which are files or folders.
///
/// `keep` is called with each recording whose events have not been seen yet, one at a time; `progress` is called
/// with the number read so far. A folder stands for the recordings in it and in its direct subfolders.
///
/// # Errors
/// Fails if a folder cannot be listed or a named file cannot be read; the message names it.
pub fn read<T>(
    paths: &[PathBuf],
    progress: &dyn Fn(usize),
    keep: &mut dyn FnMut(Source) -> T,
) -> Result<Recordings<T>> {
    let Found { files, passed_by } = files(paths)?;
    let mut by_rank: Vec<(usize, &File)> = files.iter().enumerate().collect();
    by_rank.sort_by_key(|(_, file)| file.rank);
    let mut taken = Vec::new();
    let mut left_out = Vec::new();
    let mut known: BTreeMap<[u8; 32], &Path> = BTreeMap::new();
    for (read, (place, file)) in by_rank.into_iter().enumerate() {
        progress(read);
        let source = match recording("", &file.path) {
            Ok(source) => source,
            Err(error) if file.rank == 0 => return Err(error),
            Err(error) => {
                let why = Why::NotRead(format!("{error:#}"));
                left_out.push((place, why));
                continue;
            }
        };
        match known.entry(fingerprint(&source)) {
            Entry::Occupied(same) => {
                let why = Why::SameEventsAs(same.get().display().to_string());
                left_out.push((place, why));
            }
            Entry::Vacant(new) => {
                new.insert(&file.path);
                taken.push((place, file, keep(source)));
            }
        }
    }
    taken.sort_by_key(|(place, ..)| *place);
    left_out.sort_by_key(|(place, _)| *place);
    let names = names(&taken.iter().map(|(_, file, _)| *file).collect::<Vec<_>>());
    let recordings = names.into_iter().zip(taken);
    let left_out = left_out.into_iter().filter_map(|(place, why)| {
        let file = files.get(place)?.path.display().to_string();
        Some(LeftOut { file, why })
    });
    let left_out = left_out.chain(passed_by.into_iter().map(|(pattern, why)| LeftOut {
        file: pattern.display().to_string(),
        why,
    }));
    Ok(Recordings {
        taken: recordings
            .map(|(name, (_, file, kept))| Recording {
                name,
                path: file.path.clone(),
                kept,
            })
            .collect(),
        left_out: left_out.collect(),
    })
}

/// Reads the recording at `path`, in any format that is recognised.
///
/// # Errors
/// Fails if the file cannot be opened, or for the reasons given at [`Source::new`]; the message names the file.
pub fn recording(name: &str, path: &Path) -> Result<Source> {
    let mut reader = event_files::open(path, None)?;
    Source::new(name, reader.as_mut()).with_context(|| path.display().to_string())
}

/// Lists what is left out and why, for people; `None` if nothing is.
#[must_use]
pub fn notice(left_out: &[LeftOut]) -> Option<String> {
    let lines = left_out.iter().map(|LeftOut { file, why }| match why {
        Why::SameEventsAs(taken) => format!("\n  {file}: the same events as {taken}"),
        // The error message starts with the name of the file.
        Why::NotRead(error) => format!("\n  {error}"),
        Why::PassedBy(files) => format!(
            "\n  {file}: {}, and folders are not searched for this extension: name {them} to use {them}",
            counted(*files),
            them = them(*files)
        ),
        Why::TooDeep(files) => format!(
            "\n  {file}: {}, and folders are searched two levels deep: name the folder to use {}",
            counted(*files),
            them(*files)
        ),
    });
    let count = left_out.iter().map(|LeftOut { why, .. }| match why {
        Why::PassedBy(files) | Why::TooDeep(files) => *files,
        Why::SameEventsAs(_) | Why::NotRead(_) => 1,
    });
    let count: u64 = count.sum();
    let lines: String = lines.collect();
    (count > 0).then(|| format!("{} left out:{lines}", counted(count)))
}

fn counted(files: u64) -> String {
    format!("{files} {}", if files == 1 { "file" } else { "files" })
}

const fn them(files: u64) -> &'static str {
    if files == 1 { "it" } else { "them" }
}

/// Returns the SHA-256 of the events, with times counted from the first event; events of equal time are sorted.
fn fingerprint(source: &Source) -> [u8; 32] {
    let mut hash = Sha256::new();
    let mut equal: Vec<(u16, u16, Polarity)> = Vec::new();
    let is_equal = |a: &Event, b: &Event| a.t_us == b.t_us;
    for events in source.events.chunk_by(is_equal) {
        equal.clear();
        equal.extend(
            events
                .iter()
                .map(|event| (event.y, event.x, event.polarity)),
        );
        equal.sort_unstable_by_key(|(y, x, polarity)| (*y, *x, *polarity == Polarity::On));
        let t_us = events.first().map_or(0, |event| event.t_us) - source.start_us();
        for (y, x, polarity) in &equal {
            hash.update(t_us.to_le_bytes());
            hash.update(y.to_le_bytes());
            hash.update(x.to_le_bytes());
            hash.update([u8::from(*polarity == Polarity::On)]);
        }
    }
    hash.finalize().into()
}

/// Files found in paths.
struct Found {
    /// Every file that may be a recording, once.
    files: Vec<File>,
    /// Number of files that are passed by, and why, per pattern `FOLDER/*.ENDING`; their extension is that of a known
    /// format.
    passed_by: BTreeMap<PathBuf, Why>,
}

/// Returns every file in `paths`, once.
fn files(paths: &[PathBuf]) -> Result<Found> {
    let mut found: Vec<File> = Vec::new();
    let mut passed_by = Vec::new();
    let mut too_deep = Vec::new();
    let mut in_folder = |path: PathBuf, is_below: bool| {
        let file = File::in_folder(&path, is_below);
        if file.is_none() {
            passed_by.push(path);
        }
        file
    };
    for path in paths {
        if !path.is_dir() {
            found.push(File {
                path: path.clone(),
                rank: 0,
                is_below: false,
            });
            continue;
        }
        for entry in entries(path)? {
            if entry.is_dir() {
                for path in entries(&entry)? {
                    if path.is_dir() {
                        deeper(&path, DEPTH_MAX, &mut too_deep);
                    } else {
                        found.extend(in_folder(path, true));
                    }
                }
            } else {
                found.extend(in_folder(entry, false));
            }
        }
    }
    // A file that was named twice, or that lies in a folder that was named as well, counts once.
    let mut known: BTreeMap<PathBuf, usize> = BTreeMap::new();
    let mut once: Vec<File> = Vec::new();
    for file in found {
        let path = file.path.canonicalize().unwrap_or(file.path.clone());
        match known.get(&path).and_then(|place| once.get_mut(*place)) {
            Some(same) => same.rank = same.rank.min(file.rank),
            None => {
                known.insert(path, once.len());
                once.push(file);
            }
        }
    }
    let mut patterns = BTreeMap::new();
    // A folder that is searched from one path and too deep for another counts as searched.
    let mut add = |paths: Vec<PathBuf>, why: fn(u64) -> Why| {
        let mut counts: BTreeMap<PathBuf, u64> = BTreeMap::new();
        for path in paths {
            let is_named = path
                .canonicalize()
                .is_ok_and(|path| known.contains_key(&path));
            if let (false, Some(pattern)) = (is_named, passed_by_pattern(&path)) {
                *counts.entry(pattern).or_default() += 1;
            }
        }
        patterns.extend(
            counts
                .into_iter()
                .map(|(pattern, files)| (pattern, why(files))),
        );
    };
    add(too_deep, Why::TooDeep);
    add(passed_by, Why::PassedBy);
    Ok(Found {
        files: once,
        passed_by: patterns,
    })
}

/// Levels of folders, below those that are searched, in which files are counted.
const DEPTH_MAX: usize = 8;

/// Adds the files in a folder and below; what cannot be listed is left out, since none of it would be used.
fn deeper(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) {
    for path in entries(folder).unwrap_or_default() {
        if !path.is_dir() {
            files.push(path);
        } else if depth > 0 && !path.is_symlink() {
            deeper(&path, depth - 1, files);
        }
    }
}

/// Returns `FOLDER/*.ENDING` for a file whose extension belongs to a known format.
fn passed_by_pattern(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?.to_ascii_lowercase();
    let mut endings = event_files::FORMATS
        .iter()
        .flat_map(|format| format.endings);
    let ending = endings.find(|ending| name.ends_with(*ending))?;
    (!path.is_dir()).then(|| path.with_file_name(format!("*{ending}")))
}

impl File {
    fn in_folder(path: &Path, is_below: bool) -> Option<Self> {
        let ending = path.extension()?.to_ascii_lowercase();
        let place = ENDINGS.iter().position(|known| ending == *known)?;
        (!path.is_dir()).then(|| Self {
            path: path.to_owned(),
            rank: place + 1,
            is_below,
        })
    }

    /// Returns the subfolder of a named folder that the file lies in, if it does.
    fn folder(&self) -> Option<&Path> {
        self.path.parent().filter(|_| self.is_below)
    }
}

/// Names the recordings: one that is alone in its subfolder takes the subfolder's name; paths replace names that
/// would be equal.
fn names(files: &[&File]) -> Vec<String> {
    let mut names: Vec<String> = files
        .iter()
        .map(|file| {
            let Some(folder) = file.folder() else {
                return stem(&file.path);
            };
            let name = folder.file_name().unwrap_or_default().to_string_lossy();
            let beside = files.iter().filter(|other| other.folder() == Some(folder));
            if beside.count() == 1 {
                name.into_owned()
            } else {
                format!("{name}/{}", stem(&file.path))
            }
        })
        .collect();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for name in &names {
        *counts.entry(name.clone()).or_default() += 1;
    }
    for (name, file) in names.iter_mut().zip(files) {
        if counts.get(name).is_some_and(|count| *count > 1) {
            *name = file.path.display().to_string();
        }
    }
    names
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let listed = || -> std::io::Result<Vec<PathBuf>> {
        let mut entries: Vec<_> = std::fs::read_dir(folder)?
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<Result<_, _>>()?;
        entries.sort();
        Ok(entries)
    };
    listed().with_context(|| format!("{}: cannot be listed", folder.display()))
}

fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use event_files::EventWriter;
    use event_files::evt::evt2::Evt2Writer;
    use event_files::evt::evt3::Evt3Writer;
    use event_types::test_events::{SENSOR, event};

    use super::*;

    /// A temporary folder to fill with files.
    struct Folder(tempfile::TempDir);

    impl Folder {
        fn new() -> Self {
            let folder = Self(tempfile::tempdir().unwrap());
            for name in ["one", "two", "one/deeper"] {
                std::fs::create_dir(folder.at(name)).unwrap();
            }
            folder
        }

        fn at(&self, name: &str) -> PathBuf {
            self.0.path().join(name)
        }

        /// Writes events from `start_us` on. `x` distinguishes them from other recordings; `start_us` decides the
        /// order of two events of equal time.
        fn write(&self, name: &str, x: u16, start_us: u64) {
            let path = self.at(name);
            let mut events = [(0, 2), (0, 1), (900, 2)]
                .map(|(since_us, y)| event(start_us + since_us, x, y, y == 1));
            if start_us > 0 {
                events.swap(0, 1);
            }
            let mut writer: Box<dyn EventWriter> = if name.contains("evt2") {
                Box::new(Evt2Writer::create(&path, SENSOR).unwrap())
            } else {
                Box::new(Evt3Writer::create(&path, SENSOR).unwrap())
            };
            writer.write(&events).unwrap();
            writer.finish().unwrap();
        }

        fn read(&self, names: &[&str]) -> Result<(Vec<String>, Vec<LeftOut>)> {
            let paths: Vec<PathBuf> = names.iter().map(|name| self.at(name)).collect();
            let found = read(&paths, &|_| (), &mut |source| {
                assert_eq!(source.events.len(), 3);
            })?;
            let names = found.taken.into_iter().map(|taken| taken.name);
            Ok((names.collect(), found.left_out))
        }
    }

    #[test]
    fn folders_are_searched_two_levels_deep() {
        let folder = Folder::new();
        let names = [
            "b.raw",
            "one/x.raw",
            "one/deeper/y.raw",
            "two/p.evt2",
            "two/q.evt2.raw",
            "two/notes.txt",
            "arrays.npz",
        ];
        for (x, name) in (0..).zip(names) {
            folder.write(name, x, 0);
        }
        let (taken, left_out) = folder.read(&[""]).unwrap();
        assert_eq!(taken, ["b", "one", "two/p", "two/q"]);
        let patterns: Vec<&str> = left_out
            .iter()
            .map(|left_out| left_out.file.as_str())
            .collect();
        let pattern = |name: &str| folder.at(name).display().to_string();
        assert_eq!(
            patterns,
            [
                pattern("*.npz"),
                pattern("one/deeper/*.raw"),
                pattern("two/*.txt")
            ]
        );
        assert_eq!(left_out[1].why, Why::TooDeep(1));
        let text = notice(&left_out).unwrap();
        assert!(text.starts_with("3 files left out:"), "{text}");
        assert!(text.contains("deeper/*.raw: 1 file, and folders are searched two levels"));
        // Named files count whatever their extension; nothing is read twice.
        let (taken, left_out) = folder
            .read(&["two", "two/q.evt2.raw", "two/notes.txt"])
            .unwrap();
        assert_eq!(
            (taken, left_out),
            (
                vec!["p", "q", "notes"]
                    .into_iter()
                    .map(str::to_owned)
                    .collect(),
                Vec::new()
            )
        );
    }

    #[test]
    fn the_same_events_count_once() {
        let folder = Folder::new();
        // The extension that comes first in the list is taken, not the first path.
        folder.write("one/a.evt2", 7, 0);
        folder.write("two/b.raw", 7, 5000);
        folder.write("two/c.raw", 8, 0);
        let (taken, left_out) = folder.read(&[""]).unwrap();
        assert_eq!(taken, ["two/b", "two/c"]);
        let left = |file: &str, same: &str| LeftOut {
            file: folder.at(file).display().to_string(),
            why: Why::SameEventsAs(folder.at(same).display().to_string()),
        };
        assert_eq!(left_out, [left("one/a.evt2", "two/b.raw")]);
        let text = notice(&left_out).unwrap();
        assert!(
            text.starts_with("1 file left out:") && text.contains("a.evt2: the same events as")
        );
        assert_eq!(notice(&[]), None);
        // Named files take precedence.
        let (taken, left_out) = folder.read(&["", "one/a.evt2"]).unwrap();
        assert_eq!(taken, ["one", "two"]);
        assert_eq!(left_out, [left("two/b.raw", "one/a.evt2")]);
    }

    #[test]
    fn recordings_of_one_name_are_told_apart() {
        let folder = Folder::new();
        for (x, name) in (0..).zip(["one/a.raw", "two/a.raw", "two/c.raw"]) {
            folder.write(name, x, 0);
        }
        let (taken, _) = folder.read(&["one", "two"]).unwrap();
        let path = |name: &str| folder.at(name).display().to_string();
        assert_eq!(
            taken,
            [path("one/a.raw"), path("two/a.raw"), "c".to_owned()]
        );
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let folder = Folder::new();
        folder.write("one/a.raw", 0, 0);
        std::fs::write(folder.at("one/depth.hdf5"), "no HDF5").unwrap();
        let (taken, left_out) = folder.read(&[""]).unwrap();
        assert_eq!(taken, ["one"]);
        let Why::NotRead(error) = &left_out[0].why else {
            panic!("{left_out:?}");
        };
        assert!(error.contains("depth.hdf5"), "{error}");
        assert!(notice(&left_out).unwrap().contains(error));
        // A file that the user names must be readable.
        for name in ["one/depth.hdf5", "nothing.raw"] {
            let error = folder.read(&["", name]).unwrap_err();
            assert!(format!("{error:#}").contains(name), "{error:#}");
        }
    }

    #[test]
    fn what_is_passed_by_is_said() {
        let folder = Folder::new();
        folder.write("one/a.raw", 0, 0);
        for name in ["one/b.dat", "one/c.DAT", "one/notes", "two/d.npz"] {
            std::fs::write(folder.at(name), "").unwrap();
        }
        let (taken, left_out) = folder.read(&[""]).unwrap();
        assert_eq!(taken, ["one"]);
        let passed_by = |pattern: &str, files| LeftOut {
            file: folder.at(pattern).display().to_string(),
            why: Why::PassedBy(files),
        };
        assert_eq!(
            left_out,
            [passed_by("one/*.dat", 2), passed_by("two/*.npz", 1)]
        );
        let text = notice(&left_out).unwrap();
        assert!(text.starts_with("3 files left out:"), "{text}");
        let why = "*.dat: 2 files, and folders are not searched for this extension: name them";
        assert!(text.contains(why), "{text}");
    }

    #[test]
    fn the_shared_recordings_are_those_of_the_record() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
        if !folder.is_dir() {
            eprintln!("skipped: {} is not there", folder.display());
            return;
        }
        let found = read(&[folder.to_owned()], &|_| (), &mut |_| ()).unwrap();
        let names: Vec<&str> = found
            .taken
            .iter()
            .map(|taken| taken.name.as_str())
            .collect();
        assert_eq!(
            names,
            [
                "davis240_boxes_moderate",
                "davis346_building_dense",
                "davis346_static_sparse",
                "dvs128_standup",
                "dvs128_walking_moderate",
                "dvs128_walking_sparse",
                "dvxl_person_moderate",
                "gen3_vga_dense_evt2",
                "imx636_sparse_evt3",
            ]
        );
        let same = |left_out: &LeftOut| match &left_out.why {
            Why::SameEventsAs(taken) => {
                taken.ends_with("davis346_building_dense/davis.aedat4")
                    && left_out.file.contains("derived_layouts")
            }
            Why::NotRead(_) | Why::PassedBy(_) | Why::TooDeep(_) => false,
        };
        let passed_by = |left_out: &LeftOut| matches!(left_out.why, Why::PassedBy(_));
        let mut left_out = found.left_out;
        left_out.retain(|left_out| !passed_by(left_out));
        assert_eq!(left_out.len(), 2);
        assert!(left_out.iter().all(same), "{left_out:?}");
    }
}
