//! Frames on disk, in segments of records; the oldest segment is deleted when there are too many bytes.
//!
//! ```text
//! RUN-NUMBER.frames     run and first number, in 20 digits each; a segment has frames of one run
//!
//! record: length u32 | number u64 | end_us u64 | frame | CRC-32 of all before    little-endian
//! ```
//!
//! A truncated or damaged segment contributes the records before the damage. Frames that cannot be written are
//! counted, without further consequences: the link matters more than the disk.

use std::collections::VecDeque;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use crc::{CRC_32_ISO_HDLC, Crc};

use super::Kept;
use crate::message::{Range, Stamp};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Bytes in a record before the frame, and after it.
const HEAD: usize = 20;
const TAIL: usize = 4;

/// Approximate number of segments in a full store.
const SEGMENTS: u64 = 16;

/// Smallest allowed size of a store on disk, in bytes.
pub const BYTES_LEAST: u64 = 1 << 16;

const ENDING: &str = "frames";

/// Counts of a store on disk.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Figures {
    /// Frames on disk.
    pub frames: u64,
    /// Bytes of the records of these frames.
    pub bytes: u64,
    /// Frames that were deleted to make room.
    pub let_go: u64,
    /// Frames that could not be written.
    pub failures: u64,
}

/// A store of frames in a folder of segments.
#[derive(Debug)]
pub struct Disk {
    folder: PathBuf,
    bytes_max: u64,
    segments: VecDeque<Segment>,
    /// Whether the last segment is still written to.
    is_open: bool,
    figures: Figures,
}

#[derive(Debug)]
struct Segment {
    path: PathBuf,
    file: File,
    run: u64,
    /// Number, position and frame length of each record, sorted by number.
    records: Vec<(u64, u64, u32)>,
    bytes: u64,
}

impl Disk {
    /// Opens the frames in a folder, and creates the folder if needed. Of damaged segments, the records before the
    /// damage are used.
    ///
    /// # Errors
    /// The folder cannot be read or written, or the bound is below [`BYTES_LEAST`].
    pub fn open(folder: &Path, bytes_max: u64) -> Result<Self> {
        ensure!(
            bytes_max >= BYTES_LEAST,
            "a store of {bytes_max} bytes is too small: give at least {BYTES_LEAST}"
        );
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
            let path = entry.with_context(|| folder.display().to_string())?.path();
            if let Some(name) = name_of(&path) {
                paths.push((name, path));
            }
        }
        paths.sort_unstable();
        let mut disk = Self {
            folder: folder.to_owned(),
            bytes_max,
            segments: VecDeque::new(),
            is_open: false,
            figures: Figures::default(),
        };
        for ((run, _), path) in paths {
            match Segment::read(&path, run, bytes_max) {
                Ok(segment) if segment.records.is_empty() => {
                    let _ = fs::remove_file(&path);
                }
                Ok(segment) => {
                    disk.figures.frames += segment.records.len() as u64;
                    disk.figures.bytes += segment.bytes;
                    disk.segments.push_back(segment);
                }
                Err(_) => disk.figures.failures += 1,
            }
        }
        disk.bound();
        Ok(disk)
    }

    /// Appends a frame; a failure is counted only.
    pub fn append(&mut self, kept: &Kept) {
        match self.try_append(kept) {
            Ok(()) => self.bound(),
            Err(_) => {
                self.figures.failures += 1;
                // The part that was written is not a record, so the next frame starts a new segment.
                self.is_open = false;
            }
        }
    }

    fn try_append(&mut self, kept: &Kept) -> io::Result<()> {
        let record = record(kept)?;
        let Stamp { run, number, .. } = kept.stamp;
        let segment_max = self.bytes_max / SEGMENTS;
        let goes_on = self.is_open
            && self.segments.back().is_some_and(|last| {
                last.run == run
                    && last.bytes + record.len() as u64 <= segment_max
                    && last
                        .records
                        .last()
                        .is_none_or(|(before, ..)| *before < number)
            });
        if !goes_on {
            self.segments
                .push_back(Segment::create(&self.folder, run, number)?);
            self.is_open = true;
        }
        let Some(last) = self.segments.back_mut() else {
            return Err(io::Error::other("no segment"));
        };
        last.file.write_all(&record)?;
        last.records
            .push((number, last.bytes, kept.frame.len() as u32));
        last.bytes += record.len() as u64;
        self.figures.frames += 1;
        self.figures.bytes += record.len() as u64;
        Ok(())
    }

    /// Deletes the oldest segments while the store is too large; the last one stays.
    fn bound(&mut self) {
        while self.figures.bytes > self.bytes_max && self.segments.len() > 1 {
            let Some(oldest) = self.segments.pop_front() else {
                return;
            };
            self.figures.frames -= oldest.records.len() as u64;
            self.figures.bytes -= oldest.bytes;
            self.figures.let_go += oldest.records.len() as u64;
            if fs::remove_file(&oldest.path).is_err() {
                self.figures.failures += 1;
            }
        }
    }

    /// Returns a frame, if it is held and undamaged.
    pub fn get(&mut self, run: u64, number: u64) -> Option<Kept> {
        let mut of_run = self.segments.iter().filter(|segment| segment.run == run);
        let (segment, at) = of_run.find_map(|segment| {
            let found = segment
                .records
                .binary_search_by_key(&number, |record| record.0);
            found.ok().map(|at| (segment, at))
        })?;
        let &(_, place, length) = segment.records.get(at)?;
        let mut record = vec![0; HEAD + length as usize + TAIL];
        segment.file.read_exact_at(&mut record, place).ok()?;
        parse(&record, run).filter(|kept| kept.stamp.number == number)
    }

    /// Returns the lowest number, from `from` on, that is held of a run.
    #[must_use]
    pub fn next_held(&self, run: u64, from: u64) -> Option<u64> {
        let of_run = self.segments.iter().filter(|segment| segment.run == run);
        let numbers = of_run.filter_map(|segment| {
            let at = segment.records.partition_point(|record| record.0 < from);
            segment.records.get(at).map(|record| record.0)
        });
        numbers.min()
    }

    /// Returns which runs other than `but` have frames here, the newest `most`, each with the range from its first
    /// such frame to its last.
    #[must_use]
    pub fn held(&self, but: u64, most: usize) -> Vec<(u64, Range)> {
        let mut held: Vec<(u64, Range)> = Vec::new();
        for segment in self.segments.iter().filter(|segment| segment.run != but) {
            // Numbers ascend within a segment.
            let (Some(&(from, ..)), Some(&(last, ..))) =
                (segment.records.first(), segment.records.last())
            else {
                continue;
            };
            let to = last + 1;
            match held.last_mut() {
                Some((run, range)) if *run == segment.run => {
                    range.from = range.from.min(from);
                    range.to = range.to.max(to);
                }
                _ => held.push((segment.run, Range { from, to })),
            }
        }
        held.split_off(held.len().saturating_sub(most))
    }

    /// Returns the newest run that has frames here.
    #[must_use]
    pub fn newest_run(&self) -> Option<u64> {
        self.segments.iter().map(|segment| segment.run).max()
    }

    /// Returns the counts of the store.
    #[must_use]
    pub const fn figures(&self) -> Figures {
        self.figures
    }
}

impl Segment {
    fn create(folder: &Path, run: u64, number: u64) -> io::Result<Self> {
        let path = folder.join(format!("{run:020}-{number:020}.{ENDING}"));
        let mut options = OpenOptions::new();
        // An existing file of this name is left over from a failed write.
        let file = options
            .read(true)
            .write(true)
            .create(true)
            .truncate(true)
            .open(&path)?;
        Ok(Self {
            path,
            file,
            run,
            records: Vec::new(),
            bytes: 0,
        })
    }

    /// Reads the records of a segment up to its end or the first damage.
    fn read(path: &Path, run: u64, bytes_max: u64) -> io::Result<Self> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut records: Vec<(u64, u64, u32)> = Vec::new();
        let mut place = 0;
        let mut record = Vec::new();
        loop {
            let mut head = [0; 4];
            if file.read_exact_at(&mut head, place).is_err() {
                break;
            }
            let bytes = u64::from(u32::from_le_bytes(head)) + (HEAD + TAIL) as u64;
            // A damaged length must not allocate more memory than the file has bytes.
            if bytes > (length - place).min(bytes_max) {
                break;
            }
            record.resize(bytes as usize, 0);
            if file.read_exact_at(&mut record, place).is_err() {
                break;
            }
            let Some(kept) = parse(&record, run) else {
                break;
            };
            let number = kept.stamp.number;
            if records.last().is_some_and(|(before, ..)| *before >= number) {
                break;
            }
            records.push((number, place, kept.frame.len() as u32));
            place += bytes;
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            run,
            records,
            bytes: place,
        })
    }
}

fn record(kept: &Kept) -> io::Result<Vec<u8>> {
    let length = u32::try_from(kept.frame.len()).map_err(io::Error::other)?;
    let mut record = Vec::with_capacity(HEAD + kept.frame.len() + TAIL);
    record.extend_from_slice(&length.to_le_bytes());
    record.extend_from_slice(&kept.stamp.number.to_le_bytes());
    record.extend_from_slice(&kept.stamp.end_us.to_le_bytes());
    record.extend_from_slice(&kept.frame);
    record.extend_from_slice(&CRC.checksum(&record).to_le_bytes());
    Ok(record)
}

fn parse(record: &[u8], run: u64) -> Option<Kept> {
    let (rest, crc) = record.split_last_chunk::<TAIL>()?;
    if CRC.checksum(rest) != u32::from_le_bytes(*crc) {
        return None;
    }
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let (number, rest) = rest.split_first_chunk::<8>()?;
    let (end_us, frame) = rest.split_first_chunk::<8>()?;
    let kept = Kept {
        stamp: Stamp {
            run,
            number: u64::from_le_bytes(*number),
            end_us: u64::from_le_bytes(*end_us),
            up_us: 0,
        },
        frame: frame.into(),
    };
    // The number after the highest one must fit into 64 bits too.
    let is_whole = u32::from_le_bytes(*length) as usize == kept.frame.len();
    (is_whole && kept.stamp.number < u64::MAX).then_some(kept)
}

/// Parses the run and the first number from a segment's file name.
fn name_of(path: &Path) -> Option<(u64, u64)> {
    if path.extension()? != ENDING {
        return None;
    }
    let (run, number) = path.file_stem()?.to_str()?.split_once('-')?;
    Some((run.parse().ok()?, number.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(run: u64, number: u64, bytes: usize) -> Kept {
        Kept {
            stamp: Stamp {
                run,
                number,
                end_us: number * 3,
                up_us: 0,
            },
            frame: vec![number as u8; bytes].into(),
        }
    }

    fn segments(folder: &Path) -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).unwrap();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort_unstable();
        paths
    }

    #[test]
    fn the_oldest_goes_and_is_counted() {
        let folder = tempfile::tempdir().unwrap();
        let mut disk = Disk::open(folder.path(), BYTES_LEAST).unwrap();
        for number in 0..1000 {
            disk.append(&kept(1, number, 976));
        }
        let figures = disk.figures();
        assert_eq!(figures.frames + figures.let_go, 1000);
        assert!(
            figures.bytes <= BYTES_LEAST && figures.bytes > BYTES_LEAST * 7 / 8,
            "{figures:?}"
        );
        let on_disk: u64 = segments(folder.path())
            .iter()
            .map(|path| path.metadata().unwrap().len())
            .sum();
        assert_eq!(on_disk, figures.bytes);
        for number in 0..1000 {
            let want = (number >= figures.let_go).then(|| kept(1, number, 976));
            assert_eq!(disk.get(1, number), want, "{number}");
        }
        drop(disk);
        let mut disk = Disk::open(folder.path(), BYTES_LEAST).unwrap();
        assert_eq!(disk.figures().frames, figures.frames);
        assert_eq!(disk.get(1, 999), Some(kept(1, 999, 976)));
        let held = disk.held(2, 9);
        assert_eq!(
            held,
            [(
                1,
                Range {
                    from: figures.let_go,
                    to: 1000
                }
            )]
        );
    }

    #[test]
    fn a_damaged_segment_has_what_stands_before() {
        for damage in 0..4 {
            let folder = tempfile::tempdir().unwrap();
            let mut disk = Disk::open(folder.path(), 1 << 20).unwrap();
            for number in 5..15 {
                disk.append(&kept(3, number, 100));
            }
            drop(disk);
            let path = &segments(folder.path())[0];
            let mut bytes = fs::read(path).unwrap();
            assert_eq!(bytes.len(), 10 * 124);
            match damage {
                0 => bytes.truncate(7 * 124 + 30),
                1 => bytes[7 * 124 + 60] ^= 1,
                // A length beyond the end of the file.
                2 => bytes[7 * 124..7 * 124 + 4].fill(255),
                // The previous number is repeated.
                _ => bytes.copy_within(6 * 124..7 * 124, 7 * 124),
            }
            fs::write(path, &bytes).unwrap();
            let mut disk = Disk::open(folder.path(), 1 << 20).unwrap();
            assert_eq!(
                disk.held(0, 9),
                [(3, Range { from: 5, to: 12 })],
                "{damage}"
            );
            assert_eq!(disk.get(3, 11), Some(kept(3, 11, 100)));
            // Writing continues in another segment.
            disk.append(&kept(4, 0, 10));
            assert_eq!(disk.get(4, 0), Some(kept(4, 0, 10)));
            assert_eq!(segments(folder.path()).len(), 2);
        }
    }

    #[test]
    fn other_files_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["notes.txt", "x-1.frames", "5.frames"] {
            fs::write(folder.path().join(name), "something").unwrap();
        }
        fs::write(
            folder
                .path()
                .join("00000000000000000001-00000000000000000000.frames"),
            "",
        )
        .unwrap();
        let disk = Disk::open(folder.path(), 1 << 20).unwrap();
        assert_eq!(disk.figures(), Figures::default());
        assert_eq!(segments(folder.path()).len(), 3);
        assert!(Disk::open(folder.path(), 10).is_err());
    }

    #[test]
    fn what_cannot_be_written_is_counted() {
        let folder = tempfile::tempdir().unwrap();
        let inside = folder.path().join("store");
        let mut disk = Disk::open(&inside, 1 << 20).unwrap();
        fs::remove_dir_all(&inside).unwrap();
        disk.append(&kept(1, 0, 10));
        assert_eq!(
            disk.figures(),
            Figures {
                failures: 1,
                ..Figures::default()
            }
        );
        fs::create_dir(&inside).unwrap();
        disk.append(&kept(1, 1, 10));
        assert_eq!(disk.get(1, 1), Some(kept(1, 1, 10)));
    }
}
