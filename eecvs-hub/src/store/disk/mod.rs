//! Frames on disk, in segments of records; the oldest segment is deleted when there are too many bytes.
//!
//! ```text
//! RUN-ORDINAL.kept       run and first ordinal, in 20 digits each; a segment has records of one run
//! RUN-ORDINAL.damaged    the same, with damaged records among others
//! ```
//!
//! What is written is synced at an interval. A damaged record costs no other; its bytes stay where they are until the
//! segment is the oldest, and the segment's name says that it has some. Frames that cannot be written are counted,
//! without further consequences: the link matters more than the disk.
//!
//! One segment is open for writing, and one for a moment while it is read; some more may wait for their sync.

mod medium;
mod record;
mod segment;
mod sync;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::fs;
use std::io::{
    self,
    ErrorKind::{QuotaExceeded, StorageFull},
};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};

use super::Kept;
use crate::message::{Range, Stamp};
use medium::{Files, Medium, Writable};
use segment::{BLOCK_BYTES, EARLIER, SEGMENT_BYTES_MAX, Segment, Tally, name_of, on_disk};
use sync::Syncer;

/// Number of segments in a full store, if they are not larger than allowed.
const SEGMENTS: u64 = 16;

/// Smallest allowed size of a store on disk, in bytes.
pub const BYTES_LEAST: u64 = SEGMENTS * BLOCK_BYTES;

/// Settings of a store on disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Maximum bytes on disk.
    pub bytes_max: u64,
    /// Interval between syncs in milliseconds: a power cut costs the frames of one. 0 syncs every frame when it is
    /// written.
    pub sync_ms: u32,
}

/// Counts of a store on disk.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Figures {
    /// Undamaged frames on disk.
    pub frames: u64,
    /// Bytes on disk, in whole blocks, including those of damaged records.
    pub bytes: u64,
    /// Frames that were deleted to make room.
    pub let_go: u64,
    /// Frames that could not be written or synced.
    pub failures: u64,
    /// Frames that had been written, and are damaged or missing: found when the store was opened, or since.
    pub damaged: u64,
    /// Bytes of damaged records that are on disk.
    pub damaged_bytes: u64,
    /// Frames that were written and not synced yet.
    pub unsynced: u64,
}

/// A store of frames in a folder of segments.
#[derive(Debug)]
pub struct Disk {
    folder: PathBuf,
    bytes_max: u64,
    medium: Arc<dyn Medium>,
    segments: VecDeque<Segment>,
    /// The file of the last segment, while it is written to.
    file: Option<Arc<dyn Writable>>,
    /// Run and ordinal of the next record.
    next: (u64, u64),
    figures: Figures,
    syncer: Syncer,
}

impl Disk {
    /// Opens the frames in a folder, and creates the folder if needed. Every record is read: those that are damaged
    /// are counted, and their segments renamed.
    ///
    /// # Errors
    /// The folder cannot be read or written, or has frames in an earlier format, or the bound is below
    /// [`BYTES_LEAST`].
    pub fn open(folder: &Path, settings: Settings) -> Result<Self> {
        Self::open_on(folder, settings, Arc::new(Files))
    }

    fn open_on(folder: &Path, settings: Settings, medium: Arc<dyn Medium>) -> Result<Self> {
        let Settings { bytes_max, sync_ms } = settings;
        ensure!(
            bytes_max >= BYTES_LEAST,
            "a store of {bytes_max} bytes is too small: give at least {BYTES_LEAST}"
        );
        let at = || folder.display().to_string();
        fs::create_dir_all(folder).with_context(at)?;
        // A folder that was just created outlasts a power cut, as far as those above it may be read.
        for above in fs::canonicalize(folder)
            .with_context(at)?
            .ancestors()
            .skip(1)
        {
            let _ = medium.sync_folder(above);
        }
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder).with_context(at)? {
            let entry = entry.with_context(at)?;
            let path = entry.path();
            if !entry.file_type().with_context(at)?.is_file() {
                continue;
            }
            ensure!(
                !is_earlier(&path),
                "{}: an earlier version of this program wrote it, and this one cannot read it: give another folder, \
                 or let the earlier version send what it has kept",
                path.display()
            );
            if let Some(name) = name_of(&path) {
                paths.push((name, path));
            }
        }
        paths.sort_unstable();
        let every = Duration::from_millis(sync_ms.into());
        let mut disk = Self {
            folder: folder.to_owned(),
            bytes_max,
            medium: Arc::clone(&medium),
            segments: VecDeque::new(),
            file: None,
            next: (0, 0),
            figures: Figures::default(),
            syncer: Syncer::start(folder, medium, every)?,
        };
        let mut tally = Tally::default();
        for (name, path) in paths {
            let mut segment = Segment::read(path, name, &mut tally);
            if segment.bytes == 0 {
                // Nothing was written before the process ended, or nothing is left: the ordinals tell which.
                let _ = fs::remove_file(&segment.path);
                continue;
            }
            if segment.damaged_bytes > 0 {
                segment.set_aside();
            }
            disk.figures.frames += segment.frames();
            // Sparse files may claim to be of any length.
            disk.figures.bytes = disk.figures.bytes.saturating_add(segment.bytes_on_disk());
            let damaged_bytes = &mut disk.figures.damaged_bytes;
            *damaged_bytes = damaged_bytes.saturating_add(segment.damaged_bytes);
            disk.segments.push_back(segment);
        }
        tally.end();
        disk.figures.damaged = tally.lost;
        disk.next = tally.next.unwrap_or_default();
        // What cannot be deleted now is tried again, and counted, with the next frame.
        let _ = disk.make_room(0, 0);
        Ok(disk)
    }

    /// Appends a frame, whose run and number are above all that are held; a failure is counted only.
    pub fn append(&mut self, kept: &Kept) {
        if self.syncer.take_failed() {
            // Whether what was written there is on disk is not known: what follows is kept elsewhere.
            self.close();
        }
        if self.try_append(kept).is_err() {
            self.figures.failures += 1;
        }
    }

    fn try_append(&mut self, kept: &Kept) -> io::Result<()> {
        let Stamp { run, number, .. } = kept.stamp;
        let ordinal = match self.next {
            (of, ordinal) if of == run => ordinal,
            _ => 0,
        };
        let is_next = self
            .segments
            .iter()
            .rev()
            .find_map(|segment| Some((segment.run, segment.ends()?.1)))
            .is_none_or(|last| last < (run, number));
        // What follows the highest number, or ordinal, must fit into 64 bits too.
        let is_next = is_next && number < u64::MAX && ordinal < u64::MAX;
        let record = record::to_bytes(kept, ordinal).filter(|_| is_next);
        let record = record.ok_or(io::ErrorKind::InvalidInput)?;
        let record_bytes = record.len() as u64;
        let segment_max = (self.bytes_max / SEGMENTS).min(SEGMENT_BYTES_MAX);
        let last = self.segments.back().filter(|_| self.file.is_some());
        let goes_on = last.is_some_and(|last| last.takes(run, number, record_bytes, segment_max));
        if !goes_on {
            self.close();
        }
        let more = match self.segments.back().filter(|_| goes_on) {
            Some(last) => on_disk(last.bytes + record_bytes) - last.bytes_on_disk(),
            None => on_disk(record_bytes),
        };
        self.make_room(more, usize::from(goes_on))?;
        let file = match &self.file {
            Some(file) => Arc::clone(file),
            None => {
                let segment = Segment::new(&self.folder, run, ordinal);
                let file = self.medium.create(&segment.path)?;
                self.syncer.created();
                self.segments.push_back(segment);
                self.file.insert(file).clone()
            }
        };
        let Some(last) = self.segments.back_mut() else {
            return Err(io::ErrorKind::NotFound.into());
        };
        let (place, before) = (last.bytes, last.bytes_on_disk());
        if let Err(error) = file.write(&record, place) {
            // A part may be written: it is cut off, or else overwritten by what is written next.
            let _ = file.cut(place);
            if !matches!(error.kind(), StorageFull | QuotaExceeded) {
                // The place itself may be what is wrong.
                self.close();
            }
            return Err(error);
        }
        last.push(number, kept.frame.len() as u32, place);
        last.bytes += record_bytes;
        self.figures.bytes += last.bytes_on_disk() - before;
        self.figures.frames += 1;
        self.next = (run, ordinal + 1);
        self.syncer.wrote(&file);
        Ok(())
    }

    /// Ends the segment that is written to.
    fn close(&mut self) {
        self.file = None;
        if let Some(last) = self.segments.back()
            && last.bytes == 0
        {
            match fs::remove_file(&last.path) {
                // It is tried again with the next frame: another segment of this name cannot be created beside it.
                Err(error) if error.kind() != io::ErrorKind::NotFound => {}
                _ => drop(self.segments.pop_back()),
            }
        }
    }

    /// Deletes the oldest segments until there is room for some bytes more, but for the last `stay`.
    fn make_room(&mut self, more: u64, stay: usize) -> io::Result<()> {
        if more > self.bytes_max {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        while self.figures.bytes > self.bytes_max - more && self.segments.len() > stay {
            let Some(oldest) = self.segments.front() else {
                break;
            };
            match fs::remove_file(&oldest.path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
            self.figures.frames -= oldest.frames();
            let Figures {
                bytes,
                damaged_bytes,
                ..
            } = &mut self.figures;
            *bytes = bytes.saturating_sub(oldest.bytes_on_disk());
            *damaged_bytes = damaged_bytes.saturating_sub(oldest.damaged_bytes);
            self.figures.let_go += oldest.frames();
            self.segments.pop_front();
        }
        Ok(())
    }

    /// Returns a frame, if it is held and undamaged.
    pub fn get(&mut self, run: u64, number: u64) -> Option<Kept> {
        let mut segments = self.segments.iter_mut();
        let segment = segments.find(|segment| segment.run == run && segment.has(number))?;
        let kept = segment.get(number).ok()?;
        if kept.is_none() {
            let before = segment.damaged_bytes;
            segment.remove(number);
            segment.set_aside();
            self.figures.damaged_bytes += segment.damaged_bytes - before;
            self.figures.damaged += 1;
            self.figures.frames -= 1;
        }
        kept
    }

    /// Returns the lowest number, from `from` on, that is held of a run.
    #[must_use]
    pub fn next_held(&self, run: u64, from: u64) -> Option<u64> {
        let of_run = self.segments.iter().filter(|segment| segment.run == run);
        of_run.filter_map(|segment| segment.next_from(from)).min()
    }

    /// Returns which runs other than `but` have frames here, the newest `most`, each with the range from its first
    /// such frame to its last.
    #[must_use]
    pub fn held(&self, but: u64, most: usize) -> Vec<(u64, Range)> {
        let mut held: Vec<(u64, Range)> = Vec::new();
        for segment in self.segments.iter().filter(|segment| segment.run != but) {
            let Some((from, last)) = segment.ends() else {
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

    /// Returns the newest run that has segments here.
    #[must_use]
    pub fn newest_run(&self) -> Option<u64> {
        self.segments.iter().map(|segment| segment.run).max()
    }

    /// Syncs what was written: afterwards a power cut costs none of it, unless that failed, which is counted.
    pub fn sync(&self) {
        self.syncer.sync();
    }

    /// Returns the counts of the store.
    #[must_use]
    pub fn figures(&self) -> Figures {
        let (unsynced, unsynced_for_good) = self.syncer.figures();
        Figures {
            failures: self.figures.failures + unsynced_for_good,
            unsynced,
            ..self.figures
        }
    }
}

/// Returns whether a file is a segment in an earlier format.
fn is_earlier(path: &Path) -> bool {
    let stem = path.file_stem().and_then(|stem| stem.to_str());
    let is_number = |text: &str| text.len() == 20 && text.bytes().all(|c| c.is_ascii_digit());
    path.extension().is_some_and(|ending| ending == EARLIER)
        && stem
            .and_then(|stem| stem.split_once('-'))
            .is_some_and(|(run, number)| is_number(run) && is_number(number))
}
