//! A file of records of one run.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use super::Kept;
use super::record::{self, Head, Part, Parts, RECORD_BYTES_MAX};

/// Ending of the names of segments, and of those in which something is damaged.
const SOUND: &str = "kept";
const DAMAGED: &str = "damaged";

/// Ending of the names of segments of an earlier format.
pub(super) const EARLIER: &str = "frames";

/// Maximum size of a segment before its last record. It bounds the memory for reading one.
pub(super) const SEGMENT_BYTES_MAX: u64 = 1 << 24;

/// File systems store whole blocks of this many bytes.
pub(super) const BLOCK_BYTES: u64 = 1 << 12;

/// A segment, and where its undamaged records are.
#[derive(Debug)]
pub(super) struct Segment {
    pub(super) path: PathBuf,
    pub(super) run: u64,
    /// Number of the first undamaged record.
    first: u64,
    records: Vec<Place>,
    /// Bytes of the file.
    pub(super) bytes: u64,
    /// Those of them that are damaged.
    pub(super) damaged_bytes: u64,
}

/// Where a record is. Twelve bytes for each frame: a full disk of small frames has many.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Number of the frame, from the segment's first.
    offset: u32,
    place: u32,
    frame_bytes: u32,
}

/// Counts the records of a folder that are damaged or missing, from the ordinals of the others.
#[derive(Debug, Default)]
pub(super) struct Tally {
    /// The run, and the ordinal that comes next in it.
    pub(super) next: Option<(u64, u64)>,
    /// Whether there are damaged bytes since, of an unknown number of records.
    is_unknown: bool,
    pub(super) lost: u64,
}

impl Tally {
    /// Counts on from the beginning of a segment.
    fn begin(&mut self, run: u64, ordinal: u64) {
        match self.next {
            Some((of, _)) if of == run => self.reach(ordinal),
            _ => self.end(),
        }
        self.next = Some((run, ordinal));
    }

    /// Counts what is missing before the record of an ordinal.
    fn reach(&mut self, ordinal: u64) {
        if let Some((_, next)) = &mut self.next {
            self.lost = self.lost.saturating_add(ordinal.saturating_sub(*next));
            *next = ordinal.max(*next);
        }
        self.is_unknown = false;
    }

    /// Counts the record of an ordinal.
    fn record(&mut self, ordinal: u64, is_sound: bool) {
        self.reach(ordinal);
        if let Some((_, next)) = &mut self.next {
            *next = next.saturating_add(1);
        }
        self.lost = self.lost.saturating_add(u64::from(!is_sound));
    }

    /// Counts what is damaged at the end of a run: one record or more, which no later ordinal tells.
    pub(super) fn end(&mut self) {
        self.lost = self.lost.saturating_add(u64::from(self.is_unknown));
        self.is_unknown = false;
    }
}

/// Parses the run and the first ordinal from a segment's file name.
pub(super) fn name_of(path: &Path) -> Option<(u64, u64)> {
    let ending = path.extension()?;
    if ending != SOUND && ending != DAMAGED {
        return None;
    }
    let (run, ordinal) = path.file_stem()?.to_str()?.split_once('-')?;
    Some((run.parse().ok()?, ordinal.parse().ok()?))
}

impl Segment {
    /// Returns a segment without records, whose file is still to be created.
    pub(super) fn new(folder: &Path, run: u64, ordinal: u64) -> Self {
        Self {
            path: folder.join(format!("{run:020}-{ordinal:020}.{SOUND}")),
            run,
            first: 0,
            records: Vec::new(),
            bytes: 0,
            damaged_bytes: 0,
        }
    }

    /// Reads where the undamaged records of a file are, and counts the others.
    pub(super) fn read(path: PathBuf, (run, ordinal): (u64, u64), tally: &mut Tally) -> Self {
        let mut segment = Self {
            path,
            run,
            first: 0,
            records: Vec::new(),
            bytes: 0,
            damaged_bytes: 0,
        };
        tally.begin(run, ordinal);
        let bytes = segment.bytes_of_file().unwrap_or_default();
        // What is longer than any segment is damaged, as is what cannot be read.
        segment.damaged_bytes = segment.bytes.saturating_sub(bytes.len() as u64);
        tally.is_unknown |= segment.damaged_bytes > 0;
        for part in Parts::new(&bytes, run) {
            match part {
                Part::Record { place, head } => {
                    let is_next = tally.next.is_none_or(|(_, next)| head.ordinal >= next);
                    let Head {
                        stamp, frame_bytes, ..
                    } = head;
                    if is_next && segment.push(stamp.number, frame_bytes, place as u64) {
                        tally.record(head.ordinal, true);
                    } else {
                        // It is sound, and not in its place: it repeats a number, or runs back.
                        segment.damaged_bytes += head.record_bytes() as u64;
                        tally.is_unknown = true;
                    }
                }
                Part::DamagedFrame { head } => {
                    segment.damaged_bytes += head.record_bytes() as u64;
                    match tally.next.is_none_or(|(_, next)| head.ordinal >= next) {
                        true => tally.record(head.ordinal, false),
                        false => tally.is_unknown = true,
                    }
                }
                Part::Damaged { bytes } => {
                    segment.damaged_bytes += bytes as u64;
                    tally.is_unknown = true;
                }
            }
        }
        segment.records.shrink_to_fit();
        segment
    }

    /// Reads the file as far as a segment may be long; blocks that cannot be read are zeros, which are damage.
    fn bytes_of_file(&mut self) -> io::Result<Vec<u8>> {
        self.bytes = fs::symlink_metadata(&self.path)?.len();
        let file = File::open(&self.path)?;
        let most = SEGMENT_BYTES_MAX + RECORD_BYTES_MAX as u64;
        let mut bytes = vec![0; self.bytes.min(most) as usize];
        if file.read_exact_at(&mut bytes, 0).is_err() {
            for (index, block) in bytes.chunks_mut(BLOCK_BYTES as usize).enumerate() {
                if file
                    .read_exact_at(block, index as u64 * BLOCK_BYTES)
                    .is_err()
                {
                    block.fill(0);
                }
            }
        }
        Ok(bytes)
    }

    /// Takes note of the record at a place; returns whether its number can follow.
    pub(super) fn push(&mut self, number: u64, frame_bytes: u32, place: u64) -> bool {
        if self.records.is_empty() {
            self.first = number;
        }
        let offset = number.checked_sub(self.first);
        let offset = offset.and_then(|offset| u32::try_from(offset).ok());
        let (Some(offset), Ok(place)) = (offset, u32::try_from(place)) else {
            return false;
        };
        if self
            .records
            .last()
            .is_some_and(|last| last.offset >= offset)
        {
            return false;
        }
        self.records.push(Place {
            offset,
            place,
            frame_bytes,
        });
        true
    }

    /// Returns whether a record may follow the last one.
    pub(super) fn takes(&self, run: u64, number: u64, record_bytes: u64, most: u64) -> bool {
        let is_in_reach = number.wrapping_sub(self.first) <= u64::from(u32::MAX);
        let has_room = self.bytes + record_bytes <= most;
        self.run == run && (self.bytes == 0 || has_room && is_in_reach)
    }

    pub(super) fn frames(&self) -> u64 {
        self.records.len() as u64
    }

    /// Returns the lowest number, and the highest.
    pub(super) fn ends(&self) -> Option<(u64, u64)> {
        let (first, last) = (self.records.first()?, self.records.last()?);
        Some((self.number(first), self.number(last)))
    }

    const fn number(&self, record: &Place) -> u64 {
        self.first + record.offset as u64
    }

    /// Returns the lowest number from `from` on.
    pub(super) fn next_from(&self, from: u64) -> Option<u64> {
        let before = |record: &Place| self.number(record) < from;
        let at = self.records.partition_point(before);
        self.records.get(at).map(|record| self.number(record))
    }

    /// Returns whether the frame of a number is here.
    pub(super) fn has(&self, number: u64) -> bool {
        self.next_from(number) == Some(number)
    }

    /// Reads the frame of a number: `None` if its record is damaged, or the disk does not give it.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub(super) fn get(&self, number: u64) -> io::Result<Option<Kept>> {
        let found = self.find(number).map(|at| self.records[at]);
        let Some(Place {
            place, frame_bytes, ..
        }) = found
        else {
            return Ok(None);
        };
        let file = File::open(&self.path)?;
        let mut bytes = vec![0; record::HEAD + frame_bytes as usize + record::TAIL];
        let read = file.read_exact_at(&mut bytes, place.into());
        let kept = read
            .ok()
            .and_then(|()| record::parse(&bytes, self.run))
            .filter(|kept| kept.stamp.number == number);
        Ok(kept)
    }

    fn find(&self, number: u64) -> Option<usize> {
        let found = self
            .records
            .binary_search_by_key(&number, |record| self.number(record));
        found.ok()
    }

    /// Takes a damaged record out.
    pub(super) fn remove(&mut self, number: u64) {
        if let Some(at) = self.find(number) {
            let record = self.records.remove(at);
            self.damaged_bytes += (record::HEAD + record::TAIL) as u64;
            self.damaged_bytes += u64::from(record.frame_bytes);
        }
    }

    /// Marks the file as damaged by its name, under which it stays in use.
    pub(super) fn set_aside(&mut self) {
        let path = self.path.with_extension(DAMAGED);
        // The name is for people: where it cannot be changed, the figures still say what is damaged.
        if !path.exists() && fs::rename(&self.path, &path).is_ok() {
            self.path = path;
        }
    }

    /// Returns the bytes that the file takes on disk.
    pub(super) const fn bytes_on_disk(&self) -> u64 {
        on_disk(self.bytes)
    }
}

/// Returns the bytes that a file of some bytes takes on disk.
pub(super) const fn on_disk(bytes: u64) -> u64 {
    bytes.next_multiple_of(BLOCK_BYTES)
}
