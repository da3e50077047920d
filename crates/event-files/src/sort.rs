//! Sorts a recording by time with an external merge sort.
//!
//! Memory is bounded by [`CHUNK_EVENTS`] events, however long the recording is: chunks are sorted, written to
//! unnamed temporary files, and merged. Events of equal time keep their order.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, Write};

use event_types::stream::{Context, Result};
use event_types::{Event, Polarity, Sensor};

use crate::{Assumption, BATCH_EVENTS, EventReader, Skipped};

/// Number of events that are sorted in memory: 64 MiB.
pub const CHUNK_EVENTS: usize = 1 << 22;
/// Number of temporary files that are merged at a time; all of them are open at once.
const FILES: usize = 128;
/// Bytes of an event in a temporary file: t, x, y, polarity.
const EVENT_BYTES: usize = 13;
/// Size in bytes of a temporary file's buffer.
const BUFFER_BYTES: usize = 1 << 16;

/// A reader that returns another reader's events in order of time.
pub struct Sorted {
    reader: Box<dyn EventReader>,
    merge: Merge,
    /// The error that ended reading; it is returned after the events before it.
    damage: Option<event_types::stream::Error>,
}

impl Sorted {
    /// Reads all of `reader` and sorts its events; `progress` gets the number of events read since its last call.
    ///
    /// # Errors
    /// A temporary file cannot be written. An error of `reader` is instead returned after the sorted events.
    pub fn new(reader: Box<dyn EventReader>, progress: &mut dyn FnMut(u64)) -> Result<Self> {
        Self::with_chunks(reader, CHUNK_EVENTS, progress)
    }

    fn with_chunks(
        mut reader: Box<dyn EventReader>,
        chunk_events: usize,
        progress: &mut dyn FnMut(u64),
    ) -> Result<Self> {
        let mut runs = Vec::new();
        let mut chunk = Vec::new();
        let mut damage = None;
        loop {
            match reader.read(&mut chunk) {
                Ok(0) => break,
                Ok(read) => progress(read as u64),
                Err(error) => {
                    damage = Some(error);
                    break;
                }
            }
            if chunk.len() >= chunk_events {
                chunk.sort_by_key(|event| event.t_us);
                runs.push(Run::spill(&mut chunk.drain(..).map(Ok))?);
            }
            if runs.len() >= FILES {
                // The merged run holds the earlier events and comes before the later runs, so that the sort stays
                // stable.
                let merge = Merge::new(std::mem::take(&mut runs))?;
                runs.push(Run::spill(&mut merge.into_events())?);
            }
        }
        chunk.sort_by_key(|event| event.t_us);
        runs.push(Run::Memory(chunk.into_iter()));
        Ok(Self {
            reader,
            merge: Merge::new(runs)?,
            damage,
        })
    }
}

impl EventReader for Sorted {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.reader.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.reader.assumptions()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let before = events.len();
        while events.len() - before < BATCH_EVENTS
            && let Some(event) = self.merge.next()?
        {
            events.push(event);
        }
        match self.damage.take_if(|_| events.len() == before) {
            Some(damage) => Err(damage),
            None => Ok(events.len() - before),
        }
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

/// Events that are in order of time.
enum Run {
    Memory(std::vec::IntoIter<Event>),
    File { file: BufReader<File>, left: u64 },
}

impl Run {
    /// Writes events to a temporary file, to be read again from its start.
    fn spill(events: &mut dyn Iterator<Item = Result<Event>>) -> Result<Self> {
        const WHY: &str = "a temporary file for sorting cannot be written (TMPDIR names its \
                           folder)";
        let file = tempfile::tempfile().context(WHY)?;
        let mut out = BufWriter::with_capacity(BUFFER_BYTES, file);
        let mut left = 0;
        for event in events {
            out.write_all(&bytes(event?)).context(WHY)?;
            left += 1;
        }
        let mut file = out
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error)
            .context(WHY)?;
        file.rewind().context(WHY)?;
        let file = BufReader::with_capacity(BUFFER_BYTES, file);
        Ok(Self::File { file, left })
    }

    fn next(&mut self) -> Result<Option<Event>> {
        match self {
            Self::Memory(events) => Ok(events.next()),
            Self::File { left: 0, .. } => Ok(None),
            Self::File { file, left } => {
                let mut bytes = [0; EVENT_BYTES];
                file.read_exact(&mut bytes)
                    .context("a temporary file for sorting cannot be read")?;
                *left -= 1;
                Ok(Some(event(bytes)))
            }
        }
    }
}

fn bytes(event: Event) -> [u8; EVENT_BYTES] {
    let mut bytes = [0; EVENT_BYTES];
    bytes[..8].copy_from_slice(&event.t_us.to_le_bytes());
    bytes[8..10].copy_from_slice(&event.x.to_le_bytes());
    bytes[10..12].copy_from_slice(&event.y.to_le_bytes());
    bytes[12] = event.polarity as u8;
    bytes
}

fn event(bytes: [u8; EVENT_BYTES]) -> Event {
    let [t @ .., _, _, _, _, _] = bytes;
    let [.., x0, x1, y0, y1, p] = bytes;
    Event {
        t_us: u64::from_le_bytes(t),
        x: u16::from_le_bytes([x0, x1]),
        y: u16::from_le_bytes([y0, y1]),
        polarity: Polarity::from_bool(p == 1),
    }
}

/// A merge of sorted runs.
struct Merge {
    runs: Vec<Run>,
    /// The next event of each run, the earliest first; at equal times that of the earlier run.
    next: BinaryHeap<Reverse<(u64, usize, Event)>>,
}

impl Merge {
    fn new(mut runs: Vec<Run>) -> Result<Self> {
        let mut next = BinaryHeap::new();
        for (at, run) in runs.iter_mut().enumerate() {
            next.extend(run.next()?.map(|event| Reverse((event.t_us, at, event))));
        }
        Ok(Self { runs, next })
    }

    fn next(&mut self) -> Result<Option<Event>> {
        let Some(mut top) = self.next.peek_mut() else {
            return Ok(None);
        };
        let Reverse((_, at, event)) = *top;
        let following = match self.runs.get_mut(at) {
            Some(run) => run.next()?,
            None => None,
        };
        match following {
            Some(following) => *top = Reverse((following.t_us, at, following)),
            None => {
                std::collections::binary_heap::PeekMut::pop(top);
            }
        }
        Ok(Some(event))
    }

    fn into_events(mut self) -> impl Iterator<Item = Result<Event>> {
        std::iter::from_fn(move || self.next().transpose())
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{event, reader};

    use super::*;

    #[test]
    fn events_come_in_order_of_time_and_equal_ones_in_their_own() {
        let mut state = 1_u64;
        let events: Vec<_> = (0..3000_u16)
            .map(|i| {
                state = state.wrapping_mul(6_364_136_223_846_793_005) + 1;
                event((state >> 33) % 700, i % 64, i / 64, i % 3 == 0)
            })
            .collect();
        let mut expected = events.clone();
        expected.sort_by_key(|event| event.t_us);
        // A single chunk, a few chunks, and more chunks than are merged at a time.
        for chunk in [4000, 500, 10] {
            let reader = Box::new(reader(&events, 10));
            let mut sorted = Sorted::with_chunks(reader, chunk, &mut |_| {}).unwrap();
            let mut found = Vec::new();
            while sorted.read(&mut found).unwrap() > 0 {}
            assert_eq!(found, expected, "chunks of {chunk}");
        }
    }
}
