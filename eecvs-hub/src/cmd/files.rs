//! The files into which `eecvs-hub receive` writes frames: one for each sensor, which no other sensor and no other
//! process writes to.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use eecvs::frame_file::mark::{BEGIN, Segment};
use eecvs_cli::output::io_causes;
use eecvs_cli::say;
use eecvs_nostd::Frame;
use event_files::output;
use serde::Serialize;

use crate::key::Name;
use crate::store::claim::lock;

/// Maximum number of files open at once.
const OPEN_MAX: usize = 256;

/// Maximum number of files whose names begin with one sensor's name.
const NUMBERS_MAX: u32 = 10_000;

/// A file that was written; the fields are the JSON keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Written {
    /// Name of the sensor.
    pub(super) sensor: String,
    /// Path of the file.
    pub(super) file: String,
    /// Frames that were written to it.
    pub(super) frames: u64,
}

/// A sensor, and which one of this name.
type Who = (Name, usize);

/// One file per sensor.
pub(super) struct Files {
    folder: PathBuf,
    open: BTreeMap<Who, BufWriter<File>>,
    /// All files so far, with the frames that were written to each.
    paths: BTreeMap<Who, (PathBuf, Segment)>,
}

impl Files {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            open: BTreeMap::new(),
            paths: BTreeMap::new(),
        }
    }

    /// Writes a frame to the file of its sensor, whose segment it begins if it is the first.
    ///
    /// # Errors
    /// The file cannot be written, another process writes to it, or `frame` is no frame.
    pub(super) fn write(&mut self, name: &Name, lane: usize, frame: &[u8]) -> Result<()> {
        let header = Frame::parse(frame).context("not a frame")?.header;
        let who = (name.clone(), lane);
        if !self.open.contains_key(&who) {
            if self.open.len() >= OPEN_MAX
                && let Some((who, mut first)) = self.open.pop_first()
            {
                let path = self.paths.get(&who).map(|(path, _)| path);
                let path = path.unwrap_or(&self.folder);
                first.flush().with_context(|| path.display().to_string())?;
            }
            let file = match self.paths.get(&who) {
                Some((path, _)) => BufWriter::new(append(path, false)?),
                None => {
                    let (path, file) = self.create(name, lane)?;
                    let mut file = BufWriter::new(file);
                    let begun = file.write_all(&BEGIN);
                    begun.with_context(|| path.display().to_string())?;
                    self.paths.insert(who.clone(), (path, Segment::default()));
                    file
                }
            };
            self.open.insert(who.clone(), file);
        }
        if let (Some(file), Some((path, segment))) =
            (self.open.get_mut(&who), self.paths.get_mut(&who))
        {
            file.write_all(frame)
                .with_context(|| path.display().to_string())?;
            segment.add(&header, frame);
        }
        Ok(())
    }

    /// Opens the file of a sensor that has none yet.
    ///
    /// The first sensor of a name has `NAME.eecvs`, which is appended to if it is there. A further one of the same
    /// name has a new file with a number, and so has a sensor whose file name is another file's to the file system.
    fn create(&self, name: &Name, lane: usize) -> Result<(PathBuf, File)> {
        // Names contain no dots and no tildes, so file names are distinct.
        let stem = name.as_str().replace('/', ".");
        let plain = format!("{stem}.eecvs");
        let path = self.folder.join(&plain);
        if lane == 0 {
            match self.alias(&plain)? {
                None => {
                    let file = append(&path, false)?;
                    if file.metadata().is_ok_and(|data| data.len() > 0) {
                        say!(
                            "eecvs-hub: {} exists: frames are appended to it",
                            path.display()
                        );
                    }
                    return Ok((path, file));
                }
                Some(other) => say!(
                    "eecvs-hub: {} and {other} are the same file on this file system: the file of \
                     {name} gets a number",
                    path.display()
                ),
            }
        }
        for number in 2..NUMBERS_MAX {
            let path = self.folder.join(format!("{stem}~{number}.eecvs"));
            match append(&path, true) {
                Ok(file) => return Ok((path, file)),
                Err(error) if is_there(&error) => {}
                Err(error) => return Err(error),
            }
        }
        bail!(
            "{}: too many files for {name}: give another folder",
            self.folder.display()
        )
    }

    /// Returns the name of the file that the file system takes for the one of this name, if it has another name.
    fn alias(&self, file_name: &str) -> Result<Option<String>> {
        let at = || self.folder.display().to_string();
        match fs::symlink_metadata(self.folder.join(file_name)) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            there => there.with_context(at)?,
        };
        let mut names = Vec::new();
        for entry in fs::read_dir(&self.folder).with_context(at)? {
            let name = entry.with_context(at)?.file_name();
            names.push(name.to_string_lossy().into_owned());
        }
        Ok(alias_among(&names, file_name))
    }

    /// Marks the ends of all segments, writes all that is left to the disk, and returns what was written.
    ///
    /// # Errors
    /// The first error, after all files have been written as far as possible.
    pub(super) fn finish(&mut self) -> Result<Vec<Written>> {
        let mut outcome = Ok(());
        for (who, (path, segment)) in &self.paths {
            let ended = end(self.open.remove(who), path, segment);
            outcome = outcome.and(ended.and_then(|()| sync(path)));
        }
        let at = || self.folder.display().to_string();
        outcome.and(output::sync_folder(&self.folder).with_context(at))?;
        let paths = self.paths.iter();
        Ok(paths
            .map(|((name, _), (path, segment))| Written {
                sensor: name.to_string(),
                file: path.display().to_string(),
                frames: segment.totals().frames,
            })
            .collect())
    }
}

/// Returns which of the names in a folder is that of a file that is there under `file_name`: another one, if the file
/// system does not tell upper from lower case.
fn alias_among(names: &[String], file_name: &str) -> Option<String> {
    if names.iter().any(|name| name == file_name) {
        return None;
    }
    let mut names = names.iter();
    let other = names.find(|name| name.eq_ignore_ascii_case(file_name));
    Some(other.map_or("another name", String::as_str).to_owned())
}

/// Writes what is buffered, and marks the end of the segment.
fn end(open: Option<BufWriter<File>>, path: &Path, segment: &Segment) -> Result<()> {
    let mut file = match open {
        Some(file) => file,
        None => BufWriter::new(append(path, false)?),
    };
    file.write_all(&segment.end().to_bytes())
        .and_then(|()| file.flush())
        .with_context(|| path.display().to_string())
}

/// Writes what the system still holds of a file to the disk.
fn sync(path: &Path) -> Result<()> {
    output::sync(path).with_context(|| format!("{}: cannot be written to the disk", path.display()))
}

/// Opens a file to append to it, for this process alone; with `is_new` only if it is not there.
fn append(path: &Path, is_new: bool) -> Result<File> {
    let mut options = OpenOptions::new();
    options.append(true).create(true).create_new(is_new);
    let file = options.open(path);
    let file = file.with_context(|| path.display().to_string())?;
    lock(&file, path)?;
    Ok(file)
}

fn is_there(error: &anyhow::Error) -> bool {
    io_causes(error).any(|io| io.kind() == ErrorKind::AlreadyExists)
}

#[cfg(test)]
mod tests {
    use eecvs::frame_file::{FrameReader, LinkReport};
    use eecvs_nostd::frame::{Header, seal};
    use eecvs_nostd::{Mode, Quantiser, Regime, Sensor, Transform};

    use super::*;

    /// A frame that only its number distinguishes.
    fn frame(number: u8) -> Vec<u8> {
        let header = Header {
            truncated: false,
            begins_run: false,
            last: true,
            regime: Regime::Sparse,
            mode: Mode::Transform,
            is_key: true,
            has_previous: false,
            levels: None,
            scans: None,
            order: None,
            sequence: number.into(),
            part: 0,
            sensor: Sensor {
                width: 8,
                height: 8,
            },
            t0_us: 0,
            duration_us: 1000,
            window_events: 0,
            events: 0,
            pixels: 0,
            late: 0,
            filtered: 0,
            dropped: 0,
            thinned: 0,
            saturated: 0,
            transform: Transform::Dwt,
            m: 8,
            grid: 16,
            quantiser: Quantiser::DEFAULT,
            timed_max: 0,
        };
        let mut out = [0; 200];
        let range = seal(&header, 0, &mut out).unwrap();
        out[range].to_vec()
    }

    /// Returns the numbers of the frames in a file, and its report.
    fn read(path: impl AsRef<Path>) -> (Vec<u8>, LinkReport) {
        let mut reader = FrameReader::new(File::open(path).unwrap());
        let mut numbers = Vec::new();
        while let Some(located) = reader.next_frame().unwrap() {
            numbers.push(located.frame.header.sequence as u8);
        }
        (numbers, reader.report().clone())
    }

    fn names<const N: usize>(names: [&str; N]) -> [Name; N] {
        names.map(|name| name.parse().unwrap())
    }

    #[test]
    fn every_sensor_has_a_file_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let [door, upper, part, dashed] = names(["hall/door", "hall/DOOR", "hall", "hall-door"]);
        let mut files = Files::new(folder.path());
        for round in 0..3_u8 {
            for (index, (name, lane)) in [
                (&door, 0),
                (&door, 1),
                (&upper, 0),
                (&part, 0),
                (&dashed, 0),
                (&door, 2),
            ]
            .into_iter()
            .enumerate()
            {
                let number = 3 * index as u8 + round;
                files.write(name, lane, &frame(number)).unwrap();
            }
        }
        let written = files.finish().unwrap();
        assert_eq!(written.len(), 6);
        let mut seen = std::collections::BTreeSet::new();
        for file in &written {
            let (numbers, report) = read(&file.file);
            let first = numbers[0];
            assert_eq!(numbers, [first, first + 1, first + 2], "{file:?}");
            assert_eq!(report.segments_ended, 1, "{file:?}");
            assert_eq!(file.frames, 3);
            assert!(seen.insert(first));
        }
        let names: Vec<&str> = written
            .iter()
            .filter(|file| file.sensor == "hall/door")
            .map(|file| file.file.rsplit('/').next().unwrap())
            .collect();
        assert_eq!(
            names,
            ["hall.door.eecvs", "hall.door~2.eecvs", "hall.door~3.eecvs"]
        );
    }

    /// A file that is there is appended to; one with a number is never another session's.
    #[test]
    fn what_is_there_stays() {
        let folder = tempfile::tempdir().unwrap();
        let [door] = names(["door"]);
        for session in 0..2_u8 {
            let mut files = Files::new(folder.path());
            files.write(&door, 0, &frame(session)).unwrap();
            files.write(&door, 1, &frame(session)).unwrap();
            files.finish().unwrap();
        }
        for (file, want) in [
            ("door.eecvs", &[0, 1][..]),
            ("door~2.eecvs", &[0]),
            ("door~3.eecvs", &[1]),
        ] {
            let (numbers, report) = read(folder.path().join(file));
            assert_eq!(numbers, want, "{file}");
            assert_eq!(report.segments_ended, want.len() as u64, "{file}");
        }
    }

    #[test]
    fn a_file_is_written_by_one_process() {
        let folder = tempfile::tempdir().unwrap();
        let [door] = names(["door"]);
        let mut first = Files::new(folder.path());
        first.write(&door, 0, &frame(1)).unwrap();
        let mut second = Files::new(folder.path());
        let said = second.write(&door, 0, &frame(2)).unwrap_err().to_string();
        assert!(
            said.contains("door.eecvs: another process uses it"),
            "{said}"
        );
        // Two names of one file, as on a file system that does not tell upper from lower case.
        #[cfg(unix)]
        {
            let [gate] = names(["gate"]);
            let link = folder.path().join("gate.eecvs");
            std::os::unix::fs::symlink("door.eecvs", link).unwrap();
            assert!(first.write(&gate, 0, &frame(3)).is_err());
        }
        first.finish().unwrap();
        assert_eq!(read(folder.path().join("door.eecvs")).0, [1]);
    }

    #[test]
    fn names_that_differ_only_by_case_are_noticed() {
        let there = ["Door.eecvs", "gate.eecvs"].map(str::to_owned);
        for (name, want) in [
            ("gate.eecvs", None),
            ("door.eecvs", Some("Door.eecvs")),
            ("stair.eecvs", Some("another name")),
        ] {
            assert_eq!(alias_among(&there, name).as_deref(), want);
        }
    }

    #[test]
    fn more_sensors_than_open_files() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = Files::new(folder.path());
        let many = OPEN_MAX + 20;
        for round in 0..2_u8 {
            for number in 0..many {
                let name: Name = format!("s{number}").parse().unwrap();
                files.write(&name, number % 2, &frame(round)).unwrap();
            }
        }
        let written = files.finish().unwrap();
        assert_eq!(written.len(), many);
        for file in written {
            let (numbers, report) = read(&file.file);
            assert_eq!(
                (numbers, report.segments_ended),
                (vec![0, 1], 1),
                "{file:?}"
            );
        }
    }
}
