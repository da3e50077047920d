//! A sensor's frames, kept for a while, so that receivers that miss some can have them again.
//!
//! The newest frames are in memory, as many as fit. Frames that leave it go to disk, if there is one, provided that
//! they were made while there was no link, or so shortly before that they may have been lost with it: nothing is
//! written while all is well. Both places are bounded; frames that have to be dropped, the oldest first, are
//! counted, as are those that the disk does not take or has damaged.

pub mod claim;
pub mod disk;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::message::{Range, Stamp, Stored};
use disk::Disk;

/// Margin around an outage: a link may have failed this long before that is noticed, and a receiver's link may come
/// back this long after the sensor's.
pub const GRACE: Duration = Duration::from_secs(8);

/// Number of outages that are remembered.
const OUTAGES_MAX: usize = 64;

/// A frame in the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kept {
    /// The frame's run, number and time.
    pub stamp: Stamp,
    /// The frame's bytes.
    pub frame: Arc<[u8]>,
}

#[derive(Debug)]
struct InMemory {
    kept: Kept,
    made: Instant,
}

/// The frames of a run and, on disk, those of earlier runs.
#[derive(Debug)]
pub struct Store {
    run: u64,
    memory: VecDeque<InMemory>,
    memory_bytes: usize,
    memory_max: usize,
    disk: Option<Disk>,
    /// Periods without a link; the last one may be unfinished.
    outages: VecDeque<(Instant, Option<Instant>)>,
    let_go: u64,
    /// The number after the latest frame.
    next: u64,
}

impl Store {
    /// Creates an empty store for a run, with at most `memory_max` bytes of frames in memory.
    #[must_use]
    pub const fn new(run: u64, memory_max: usize, disk: Option<Disk>) -> Self {
        Self {
            run,
            memory: VecDeque::new(),
            memory_bytes: 0,
            memory_max,
            disk,
            outages: VecDeque::new(),
            let_go: 0,
            next: 0,
        }
    }

    /// Records whether there is a link from now on.
    pub fn link(&mut self, is_there: bool, now: Instant) {
        match self.outages.back_mut() {
            Some((_, until @ None)) if is_there => *until = Some(now),
            Some((_, None)) => {}
            _ if is_there => {}
            _ => {
                self.outages.push_back((now, None));
                if self.outages.len() > OUTAGES_MAX {
                    self.outages.pop_front();
                }
            }
        }
    }

    /// Stores the next frame of the run, whose window ended at `end_us`; returns its number.
    pub fn push(&mut self, frame: Arc<[u8]>, end_us: u64, now: Instant) -> u64 {
        let number = self.next;
        self.next += 1;
        self.memory_bytes += frame.len();
        self.memory.push_back(InMemory {
            kept: Kept {
                stamp: Stamp {
                    run: self.run,
                    number,
                    end_us,
                    up_us: 0,
                },
                frame,
            },
            made: now,
        });
        // The latest frame stays, however large it is, since it is still to be sent.
        while self.memory_bytes > self.memory_max && self.memory.len() > 1 {
            self.spill();
        }
        number
    }

    /// Moves the oldest frame out of the memory.
    fn spill(&mut self) {
        let Some(oldest) = self.memory.pop_front() else {
            return;
        };
        self.memory_bytes -= oldest.kept.frame.len();
        if !self.is_wanted(oldest.made) {
            return;
        }
        match &mut self.disk {
            Some(disk) => disk.append(&oldest.kept),
            None => self.let_go += 1,
        }
    }

    /// Returns whether a receiver may miss a frame made at this time.
    fn is_wanted(&self, made: Instant) -> bool {
        self.outages.iter().any(|(from, until)| {
            made + GRACE >= *from && until.is_none_or(|until| made <= until + GRACE)
        })
    }

    /// Returns a frame, from memory or disk.
    pub fn get(&mut self, run: u64, number: u64) -> Option<Kept> {
        if run == self.run
            && let Some(first) = self.memory.front().map(|oldest| oldest.kept.stamp.number)
            && number >= first
        {
            let at = usize::try_from(number - first).ok()?;
            return self.memory.get(at).map(|there| there.kept.clone());
        }
        self.disk.as_mut()?.get(run, number)
    }

    /// Returns the lowest number, from `from` on, that is held of a run.
    #[must_use]
    pub fn next_held(&self, run: u64, from: u64) -> Option<u64> {
        let on_disk = self
            .disk
            .as_ref()
            .and_then(|disk| disk.next_held(run, from));
        let in_memory = (run == self.run && from < self.next && !self.memory.is_empty())
            .then(|| from.max(self.first_in_memory()));
        match (on_disk, in_memory) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (held, None) | (None, held) => held,
        }
    }

    /// Returns the number after the latest frame: all frames below it were made.
    #[must_use]
    pub const fn next(&self) -> u64 {
        self.next
    }

    /// Returns the lowest number in memory, or the next number if there is none.
    #[must_use]
    pub fn first_in_memory(&self) -> u64 {
        self.memory
            .front()
            .map_or(self.next, |oldest| oldest.kept.stamp.number)
    }

    /// Returns the bytes of the frames in memory from a number on.
    #[must_use]
    pub fn bytes_from(&self, number: u64) -> u64 {
        let first = self.first_in_memory();
        let skip = usize::try_from(number.saturating_sub(first)).unwrap_or(usize::MAX);
        let rest = self.memory.iter().skip(skip);
        rest.map(|there| there.kept.frame.len() as u64).sum()
    }

    /// Returns which earlier runs have frames in the store, at most `most`, each with the range from its first such
    /// frame to its last.
    #[must_use]
    pub fn held(&self, most: usize) -> Vec<(u64, Range)> {
        let disk = self.disk.as_ref();
        disk.map_or_else(Vec::new, |disk| disk.held(self.run, most))
    }

    /// Returns the counts of the store.
    #[must_use]
    pub fn stored(&self) -> Stored {
        let disk = self.disk.as_ref().map(Disk::figures).unwrap_or_default();
        Stored {
            memory_frames: self.memory.len() as u64,
            memory_bytes: self.memory_bytes as u64,
            disk_frames: disk.frames,
            disk_bytes: disk.bytes,
            let_go_frames: self.let_go + disk.let_go,
            disk_failures: disk.failures,
            disk_damaged_frames: disk.damaged,
            disk_damaged_bytes: disk.damaged_bytes,
        }
    }

    /// Ends the run: frames that a receiver may still miss go to disk, from where the next run can send them.
    /// Without a disk they are dropped, which is counted unless all receivers have them as far as is known.
    pub fn end(&mut self, all_have_it: bool) {
        if self.disk.is_none() && all_have_it {
            self.memory.clear();
            self.memory_bytes = 0;
        }
        while !self.memory.is_empty() {
            self.spill();
        }
        if let Some(disk) = &self.disk {
            disk.sync();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use disk::Settings;

    const SETTINGS: Settings = Settings {
        bytes_max: 1 << 20,
        sync_ms: 1000,
    };

    fn frame(number: u64, bytes: usize) -> Arc<[u8]> {
        vec![number as u8; bytes].into()
    }

    /// Pushes frames of 100 bytes, one every 100 ms, up to a number; returns the time of the last.
    fn fill(store: &mut Store, start: Instant, to: u64) -> Instant {
        let mut now = start;
        while store.next() < to {
            now = start + Duration::from_millis(100) * store.next() as u32;
            let number = store.next();
            store.push(frame(number, 100), number, now);
        }
        now
    }

    #[test]
    fn without_an_outage_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let disk = Disk::open(folder.path(), SETTINGS).unwrap();
        let mut store = Store::new(1, 1000, Some(disk));
        fill(&mut store, Instant::now(), 50);
        let stored = store.stored();
        assert_eq!(
            (
                stored.memory_frames,
                stored.disk_frames,
                stored.let_go_frames
            ),
            (10, 0, 0)
        );
        assert_eq!(store.get(1, 39), None);
        for number in 40..50 {
            let kept = store.get(1, number).unwrap();
            assert_eq!(
                (kept.stamp.number, kept.frame),
                (number, frame(number, 100))
            );
        }
        assert_eq!((store.get(1, 50), store.get(2, 45)), (None, None));
        for (from, want) in [(0, Some(40)), (40, Some(40)), (45, Some(45)), (50, None)] {
            assert_eq!(store.next_held(1, from), want);
            assert_eq!(store.next_held(2, from), None);
        }
        assert_eq!(
            (
                store.bytes_from(47),
                store.bytes_from(0),
                store.bytes_from(99)
            ),
            (300, 1000, 0)
        );
        store.end(false);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_an_outage_may_have_lost_is_held_on_disk() {
        let folder = tempfile::tempdir().unwrap();
        let start = Instant::now();
        let disk = Disk::open(folder.path(), SETTINGS).unwrap();
        let mut store = Store::new(7, 1000, Some(disk));
        let mut now = fill(&mut store, start, 200);
        store.link(false, now);
        now = fill(&mut store, start, 300);
        store.link(true, now);
        fill(&mut store, start, 600);
        // From 8 s before the outage, except for what had left the memory by then, to 8 s after it.
        let held: Vec<u64> = (0..600)
            .filter(|number| store.get(7, *number).is_some())
            .collect();
        let want: Vec<u64> = (190..380).chain(590..600).collect();
        assert_eq!(held, want);
        for (from, want) in [(0, 190), (200, 200), (380, 590), (400, 590), (595, 595)] {
            assert_eq!(store.next_held(7, from), Some(want));
        }
        for number in held {
            assert_eq!(
                store.get(7, number).unwrap().frame,
                frame(number, 100),
                "{number}"
            );
        }
        assert_eq!(store.stored().let_go_frames, 0);
        drop(store);
        // The next run can send them.
        let disk = Disk::open(folder.path(), SETTINGS).unwrap();
        let mut store = Store::new(8, 1000, Some(disk));
        assert_eq!(store.held(9), [(7, Range { from: 190, to: 380 })]);
        assert_eq!(store.get(7, 200).unwrap().frame, frame(200, 100));
        assert_eq!(store.get(8, 200), None);
    }

    #[test]
    fn without_a_disk_what_goes_is_counted() {
        let start = Instant::now();
        let mut store = Store::new(1, 1000, None);
        store.link(false, start);
        fill(&mut store, start, 60);
        let stored = store.stored();
        assert_eq!((stored.memory_frames, stored.let_go_frames), (10, 50));
    }

    #[test]
    fn what_is_in_memory_at_the_end_is_there_for_the_next_run() {
        let folder = tempfile::tempdir().unwrap();
        let start = Instant::now();
        let disk = Disk::open(folder.path(), SETTINGS).unwrap();
        let mut store = Store::new(1, 1 << 20, Some(disk));
        store.link(false, start);
        fill(&mut store, start, 30);
        store.end(false);
        drop(store);
        let disk = Disk::open(folder.path(), SETTINGS).unwrap();
        let store = Store::new(2, 1000, Some(disk));
        assert_eq!(store.held(9), [(1, Range { from: 0, to: 30 })]);
    }
}
