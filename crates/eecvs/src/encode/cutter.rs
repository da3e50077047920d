//! Events to windows, one after the other.

use std::time::{Duration, Instant};

use eecvs_nostd::ingest::reorder::{EMPTY, Reorder};
use eecvs_nostd::{Event, NextStart, Window};
use event_types::stream::{EventReader, Pause, Result};

/// Events that are held for the sake of order: 2 MiB, some milliseconds of the fastest cameras.
const HELD_EVENTS: usize = 1 << 17;

/// Where events come from.
pub trait Batches {
    /// Replaces `events` by those that follow; by none at the end.
    ///
    /// # Errors
    /// As [`EventReader::read`].
    fn next(&mut self, events: &mut Vec<Event>) -> Result<()>;

    /// What it means that there were none.
    fn pause(&self) -> Pause {
        Pause::Ended
    }
}

/// Reads when events are needed.
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
/// Any window may come next: what passes from one to the next is where it starts.
pub struct Cutter<B> {
    batches: B,
    events: Vec<Event>,
    /// Events of the batch that are in windows.
    used: usize,
    events_in: u64,
    start: NextStart,
    reorder: Reorder<Vec<Event>>,
    ended: bool,
    failed: bool,
}

impl<B: Batches> Cutter<B> {
    /// Before the first event; waits `reorder_us` for events that come out of order.
    pub fn new(batches: B, reorder_us: u32) -> Self {
        let held = if reorder_us > 0 { HELD_EVENTS } else { 0 };
        Self {
            batches,
            events: Vec::new(),
            used: 0,
            events_in: 0,
            start: NextStart::ANY,
            reorder: Reorder::new(vec![EMPTY; held], reorder_us),
            ended: false,
            failed: false,
        }
    }

    /// Events read so far.
    pub const fn events_in(&self) -> u64 {
        self.events_in
    }

    /// Fills an empty window until it is closed; `false` where the events end before it has any.
    /// `busy` grows by the time that took, reading excluded.
    ///
    /// # Errors
    /// As [`EventReader::read`]; then there is no further window.
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
