//! Events to windows, one after the other.

use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::{Event, Push, Window};

use crate::formats::{EventReader, Pause};

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
    start_us: Option<u64>,
    ended: bool,
}

impl<B: Batches> Cutter<B> {
    /// Before the first event.
    pub fn new(batches: B) -> Self {
        Self {
            batches,
            events: Vec::new(),
            used: 0,
            events_in: 0,
            start_us: None,
            ended: false,
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
    /// As [`EventReader::read`]; then the events have ended.
    pub fn cut(&mut self, window: &mut Window<'_>, busy: &mut Duration) -> Result<bool> {
        window.follow(self.start_us);
        while !self.ended {
            let started = Instant::now();
            let rest = self.events.get(self.used..).unwrap_or_default();
            let closing = rest
                .iter()
                .position(|event| window.push(*event) == Push::Closed);
            self.used += closing.unwrap_or(rest.len());
            *busy += started.elapsed();
            if closing.is_some() {
                break;
            }
            let read = self.batches.next(&mut self.events);
            self.used = 0;
            let pause = match &read {
                Ok(()) if !self.events.is_empty() => None,
                Ok(()) => Some(self.batches.pause()),
                Err(_) => Some(Pause::Ended),
            };
            self.ended = pause == Some(Pause::Ended);
            read?;
            self.events_in += self.events.len() as u64;
            match pause {
                None => {}
                Some(Pause::Ended) => window.flush(),
                Some(Pause::Until(now_us)) => {
                    window.pass(now_us);
                    if window.closed().is_some() {
                        break;
                    }
                }
            }
        }
        self.start_us = window.next_start_us();
        Ok(window.closed().is_some())
    }
}
