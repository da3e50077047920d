//! Cuts a stream of events into windows.

use std::time::{Duration, Instant};

use eecvs_nostd::ingest::reorder::Reorder;
use eecvs_nostd::{Event, NextStart, Window};
use event_types::stream::{Context, EventReader, Pause, Result};

use crate::storage::NO_MEMORY;

/// Events held back for reordering: 2 MiB, which is some milliseconds of the fastest cameras.
pub(super) const HELD_EVENTS: usize = 1 << 17;

/// A source of event batches.
pub trait Batches {
    /// Replaces `events` with the next batch; leaves it empty at the end or while a live source pauses.
    ///
    /// # Errors
    /// As [`EventReader::read`].
    fn next(&mut self, events: &mut Vec<Event>) -> Result<()>;

    /// Returns why the last batch was empty.
    fn pause(&self) -> Pause {
        Pause::Ended
    }
}

/// Reads on the calling thread whenever events are needed.
pub struct Direct<'r>(pub &'r mut dyn EventReader);

impl Batches for Direct<'_> {
    fn next(&mut self, events: &mut Vec<Event>) -> Result<()> {
        events.clear();
        self.0.read(events)?;
        Ok(())
    }

    fn pause(&self) -> Pause {
        self.0.pause()
    }
}

/// Fills windows with the events of a recording.
///
/// Each call may pass a different window: only the start of the next window is carried over.
pub struct Cutter<B> {
    batches: B,
    events: Vec<Event>,
    /// Events of the batch that are already in windows.
    used: usize,
    events_in: u64,
    start: NextStart,
    reorder: Reorder<Vec<Event>>,
    ended: bool,
    failed: bool,
}

impl<B: Batches> Cutter<B> {
    /// Creates a cutter before the first event; it holds events back for `reorder_us` microseconds to sort them.
    ///
    /// # Errors
    /// The system refuses the memory.
    pub fn new(batches: B, reorder_us: u32) -> Result<Self> {
        let held = if reorder_us > 0 { HELD_EVENTS } else { 0 };
        let mut memory = Vec::new();
        memory.try_reserve_exact(held).ok().context(NO_MEMORY)?;
        memory.resize(held, Event::UNSET);
        Ok(Self {
            batches,
            events: Vec::new(),
            used: 0,
            events_in: 0,
            start: NextStart::ANY,
            reorder: Reorder::new(memory, reorder_us),
            ended: false,
            failed: false,
        })
    }

    /// Returns the number of events read so far.
    pub const fn events_in(&self) -> u64 {
        self.events_in
    }

    /// Fills an empty window until it closes; returns `false` if the events end before the window has any. Adds the
    /// time taken, without reading, to `busy`.
    ///
    /// # Errors
    /// As [`EventReader::read`]; no window can be cut after that.
    pub fn cut(&mut self, window: &mut Window<'_>, busy: &mut Duration) -> Result<bool> {
        window.follow(self.start);
        while window.closed().is_none() && !self.failed {
            let started = Instant::now();
            if self.ended {
                self.reorder.flush(window);
                *busy += started.elapsed();
                break;
            }
            let rest = self.events.get(self.used..).unwrap_or_default();
            self.used += self.reorder.fill(window, rest);
            *busy += started.elapsed();
            if window.closed().is_some() {
                break;
            }
            let read = self.batches.next(&mut self.events);
            self.used = 0;
            self.failed = read.is_err();
            read?;
            self.events_in += self.events.len() as u64;
            if self.events.is_empty() {
                match self.batches.pause() {
                    Pause::Ended => self.ended = true,
                    Pause::Until(now_us) => self.reorder.pass(window, now_us),
                }
            }
        }
        self.start = window.next_start();
        Ok(window.closed().is_some())
    }
}
