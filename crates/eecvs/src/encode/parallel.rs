//! Encodes on several threads; the output has the same bytes as that of one thread.
//!
//! ```text
//! reader -> events -> cutter -> windows -> encoders -> chunks of frames -> writer
//! ```
//!
//! One thread reads ahead, N threads encode, and the calling thread writes. No thread is dedicated to cutting: an
//! encoding thread that is idle locks the cutter, fills its own windows and, before it releases the lock, queues
//! the receiving end of a channel for their frames. The queue is therefore in the order of the recording, whichever
//! thread finishes first. Windows are cut in their order of arrival, which takes no memory but that of their events;
//! an encoder that wants them by pixel lists each in the one window that it encodes, whose lists stay in the cache.
//!
//! A frame carries its sequence number, which is known only once all frames before it are made. An encoder predicts
//! it, since nearly every window is one frame; where the prediction was wrong, the writer seals the frame again.
//!
//! There is no deadlock: the encoder of the oldest window holds no lock, and the writer waits for that encoder
//! alone. A thread that ends, for whatever reason, drops its ends of the channels, which ends the others.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::{Builder, scope};
use std::time::{Duration, Instant};

use eecvs_nostd::coder::key_frames::Chain;
use eecvs_nostd::frame::{CRC_BYTES, HEADER_BYTES_MAX, seal};
use eecvs_nostd::{Encoded, Event, Header, Sensor, Window, WindowConfig, WindowEncoder};
use event_types::stream::{Context, EventReader, Result};
use event_types::{bail, error};

use super::codec::Chooser;
use super::cutter::{Batches, Cutter};
use super::{Codec, EncodeSummary, HostStorage, Limits, NO_ROOM, Outcome, REORDER_US, write_frame};
use crate::frame_file::FrameSink;
use crate::storage::{NO_MEMORY, NO_WINDOW, WindowMemory, frame_room};

/// Batches of events read ahead.
const BATCHES_AHEAD: usize = 4;
/// Largest number of windows that a thread cuts in one turn: a handover costs some microseconds, as much as
/// encoding a few hundred events.
const WINDOWS: usize = 32;
/// Number of events after which a turn cuts no further window.
const EVENTS: u32 = 1 << 15;
/// Bytes of frames after which a chunk is sent to the writer.
const CHUNK_BYTES: usize = 1 << 18;

/// Frames on their way to the writer.
struct Chunk {
    /// The frames, each behind room for the longest header. Many chunks may wait for the writer, so they take no more.
    bytes: Vec<u8>,
    frames: Vec<Made>,
    /// Whether this is the last chunk of a turn.
    is_last: bool,
}

/// A frame in a chunk.
struct Made {
    header: Header,
    /// Start of the room for the frame and its longest header.
    at: usize,
    /// Bytes of the frame, relative to `at`.
    range: Range<usize>,
}

impl Made {
    /// Sets the frame's sequence number and seals it again; `out` is that room.
    fn number(&mut self, sequence: u32, out: &mut [u8]) -> Result<()> {
        self.header.sequence = sequence;
        let payload_bytes = self.range.end - CRC_BYTES - HEADER_BYTES_MAX;
        match seal(&self.header, payload_bytes, out) {
            Ok(range) => self.range = range,
            Err(_) => bail!(Refused, "{}", NO_ROOM),
        }
        Ok(())
    }
}

/// The windows cut in one turn, as the writer receives them: the channel of their chunks, or an error.
type Cut = Result<Receiver<Result<Chunk>>>;

/// Memory of an encoding thread.
struct Storage {
    arrived: Vec<WindowMemory>,
    encoder: HostStorage,
}

impl Storage {
    /// Allocates memory for `windows` windows of a turn.
    fn new(windows: usize, sensor: Sensor, limits: Limits) -> Result<Self> {
        let memory = (0..windows).map(|_| WindowMemory::new(0, limits.window_events));
        let memory = memory.collect::<std::result::Result<_, _>>();
        Ok(Self {
            arrived: memory.ok().context(NO_MEMORY)?,
            encoder: HostStorage::with_limits(sensor, limits)?,
        })
    }

    /// Creates the windows of a turn, the window that is encoded, and the encoder.
    fn parts(
        &mut self,
        codec: Codec<'_>,
    ) -> Result<(Vec<Window<'_>>, Window<'_>, WindowEncoder<'_>)> {
        let config = WindowConfig {
            keeps_arrival: true,
            ..codec.config.window
        };
        let arrived = self.arrived.iter_mut().map(|memory| memory.window(config));
        let arrived = arrived.collect::<Option<_>>().context(NO_WINDOW)?;
        let (window, encoder) = self.encoder.parts(codec.config, codec.hot)?;
        Ok((arrived, window, encoder))
    }
}

/// State that only one encoding thread holds at a time.
struct Front {
    cutter: Cutter<ReadAhead>,
    /// Windows cut so far; wraps, as the sequence numbers do.
    windows: u32,
    /// With the dense coder, the number of windows between restarts of its frames. A turn ends there.
    chained: Option<u16>,
    cuts: SyncSender<Cut>,
}

/// State that all threads share.
struct Shared {
    events_in: AtomicU64,
    /// Frames in excess of one per window in everything written so far; wraps.
    extra_frames: AtomicU32,
    /// Chunks for reuse.
    spare: Mutex<Vec<Chunk>>,
}

/// As [`super::encode`], on `threads` encoding threads besides a reading thread and this one, which writes.
pub fn encode(
    reader: &mut dyn EventReader,
    codec: Codec<'_>,
    limits: Limits,
    threads: NonZeroUsize,
    out: &mut dyn FrameSink,
    progress: &mut dyn FnMut(u64),
) -> Result<Outcome> {
    let sensor = codec.config.window.sensor;
    let chained = codec.chained();
    let windows = chained.map_or(WINDOWS, |key_windows| usize::from(key_windows).max(1));
    let mut storages: Vec<_> = (0..threads.get())
        .map(|_| Storage::new(windows, sensor, limits))
        .collect::<Result<_>>()?;
    let encoders: Vec<_> = storages
        .iter_mut()
        .map(|storage| Ok((storage.parts(codec)?, frame_room(limits.frame_bytes)?)))
        .collect::<Result<_>>()?;
    let shared = Shared {
        events_in: AtomicU64::new(0),
        extra_frames: AtomicU32::new(0),
        spare: Mutex::new(Vec::new()),
    };
    let (filled_in, filled) = sync_channel(BATCHES_AHEAD);
    let (used_in, used) = channel();
    // Twice the number being encoded, so that one slow turn does not hold up the others.
    let (cuts_in, cuts) = sync_channel(2 * threads.get());
    let front = Arc::new(Mutex::new(Front {
        cutter: Cutter::new(
            ReadAhead {
                filled,
                used: used_in,
            },
            limits.reorder_us.unwrap_or(REORDER_US),
        )?,
        windows: 0,
        chained,
        cuts: cuts_in,
    }));
    scope(|scope| {
        // Both are moved into this closure and dropped with it, also on an error: that ends the threads.
        let (front, cuts) = (front, cuts);
        let start = |name: &str| Builder::new().name(name.to_owned());
        let unstarted = "cannot start a thread: use fewer with --threads";
        start("read")
            .spawn_scoped(scope, move || read(reader, &filled_in, &used))
            .context(unstarted)?;
        let mut running = Vec::new();
        for ((arrived, window, encoder), room) in encoders {
            let (front, shared) = (Arc::clone(&front), &shared);
            let thread = start("encode").spawn_scoped(scope, move || {
                let mut thread = Thread {
                    shared,
                    codec,
                    arrived,
                    window,
                    encoder,
                    chooser: codec.chooser(),
                    busy: Duration::ZERO,
                    room,
                };
                // The errors have been sent to the writer.
                while thread.turn(&front).is_some() {}
                thread.busy
            });
            running.push(thread.context(unstarted)?);
        }
        drop(front);
        let written = write(cuts, &shared, out, progress);
        let mut encoding = Duration::ZERO;
        for thread in running {
            encoding += thread.join().unwrap_or_else(|panic| resume_unwind(panic));
        }
        let mut summary = written?;
        summary.events_in = shared.events_in.load(Ordering::Relaxed);
        progress(summary.events_in);
        Ok((summary, encoding))
    })
}

/// Reads ahead until the recording ends, an error occurs or the receiver is gone.
fn read(
    reader: &mut dyn EventReader,
    filled: &SyncSender<Result<Vec<Event>>>,
    used: &Receiver<Vec<Event>>,
) {
    loop {
        let mut events = used.try_recv().unwrap_or_default();
        events.clear();
        let read = reader.read(&mut events).map(|_| events);
        let ends = read.as_ref().map_or(true, Vec::is_empty);
        if filled.send(read).is_err() || ends {
            return;
        }
    }
}

/// Receiving side of [`read`].
struct ReadAhead {
    filled: Receiver<Result<Vec<Event>>>,
    used: Sender<Vec<Event>>,
}

impl Batches for ReadAhead {
    fn next(&mut self, events: &mut Vec<Event>) -> Result<()> {
        let filled = self.filled.recv().context("the reading thread stopped")??;
        // If the reading thread is gone, it needs no buffers back.
        let _ = self.used.send(std::mem::replace(events, filled));
        Ok(())
    }
}

impl Front {
    /// Cuts windows and queues their place in the output. Returns their number, the number of the first and the
    /// sender for their chunks; `None` if there are no more windows or the writer has stopped.
    fn cut(
        &mut self,
        windows: &mut [Window<'_>],
        busy: &mut Duration,
    ) -> Option<(usize, u32, Sender<Result<Chunk>>)> {
        let (mut count, mut events) = (0, 0);
        let mut chain = Chain::START;
        let mut failed = None;
        for window in windows {
            match self.cutter.cut(window, busy) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    failed = Some(error);
                    break;
                }
            }
            count += 1;
            events += window.events();
            let ends = match self.chained {
                Some(key_windows) => {
                    chain.next(window.events(), key_windows);
                    chain.ends(key_windows)
                }
                None => events >= EVENTS,
            };
            if ends {
                break;
            }
        }
        let first = self.windows;
        self.windows = first.wrapping_add(count as u32);
        // Without a bound: a turn makes no more than the frames of its windows, and at most as many turns wait as
        // `cuts` has room for. A bound would stop a turn until the writer has come to it.
        let (chunks_in, chunks) = channel();
        if count > 0 {
            self.cuts.send(Ok(chunks)).ok()?;
        }
        if let Some(error) = failed {
            self.cuts.send(Err(error)).ok()?;
        }
        (count > 0).then_some((count, first, chunks_in))
    }
}

/// An encoding thread.
struct Thread<'s, 'b> {
    shared: &'s Shared,
    codec: Codec<'s>,
    /// The windows of a turn, in their order of arrival.
    arrived: Vec<Window<'b>>,
    /// The window that is encoded, where the encoder wants events by pixel.
    window: Window<'b>,
    encoder: WindowEncoder<'b>,
    chooser: Chooser,
    busy: Duration,
    /// Room for a frame.
    room: Vec<u8>,
}

impl Thread<'_, '_> {
    /// Cuts and encodes some windows; returns `None` when there is no more to do.
    fn turn(&mut self, front: &Mutex<Front>) -> Option<()> {
        // A poisoned lock means that another thread panicked; the caller of `encode` passes that panic on.
        let mut front = front.lock().ok()?;
        let cut = front.cut(&mut self.arrived, &mut self.busy);
        let events_in = front.cutter.events_in();
        drop(front);
        self.shared
            .events_in
            .fetch_max(events_in, Ordering::Relaxed);
        let (count, first, chunks) = cut?;
        let extra = self.shared.extra_frames.load(Ordering::Relaxed);
        self.encoder.follow(first.wrapping_add(extra));
        // Each turn is a chain of its own.
        self.encoder.restart();
        self.encode(count, &chunks)
    }

    /// Encodes the first `count` windows; returns `None` if the writer has stopped.
    fn encode(&mut self, count: usize, chunks: &Sender<Result<Chunk>>) -> Option<()> {
        let mut chunk = self.shared.chunk();
        for arrived in self.arrived.iter_mut().take(count) {
            let started = Instant::now();
            let is_listed = self.window.list(arrived);
            self.busy += started.elapsed();
            let window = if is_listed { &mut self.window } else { arrived };
            let chosen = self
                .chooser
                .choose(&mut self.encoder, window, &mut self.busy);
            if let Err(error) = chosen {
                return chunks.send(Err(error)).ok();
            }
            loop {
                let started = Instant::now();
                let encoded = self
                    .codec
                    .next_frame(&mut self.encoder, window, &mut self.room);
                self.busy += started.elapsed();
                let Ok(encoded) = encoded else {
                    return chunks.send(Err(error!(Refused, "{}", NO_ROOM))).ok();
                };
                let Some(Encoded { header, range }) = encoded else {
                    break;
                };
                let at = chunk.bytes.len();
                if chunk.bytes.try_reserve(range.end).is_err() {
                    return chunks.send(Err(error!(Refused, "{}", NO_MEMORY))).ok();
                }
                chunk.bytes.extend_from_slice(self.room.get(..range.end)?);
                chunk.frames.push(Made { header, at, range });
                if chunk.bytes.len() >= CHUNK_BYTES {
                    chunks.send(Ok(chunk)).ok()?;
                    chunk = self.shared.chunk();
                }
            }
        }
        chunk.is_last = true;
        chunks.send(Ok(chunk)).ok()
    }
}

impl Shared {
    /// Returns a chunk without frames, reused if possible.
    fn chunk(&self) -> Chunk {
        let spare = self.spare.lock().ok().and_then(|mut spare| spare.pop());
        spare.unwrap_or_else(|| Chunk {
            bytes: Vec::new(),
            frames: Vec::new(),
            is_last: false,
        })
    }

    /// Takes back a written chunk for reuse.
    fn reuse(&self, mut chunk: Chunk) {
        chunk.frames.clear();
        chunk.bytes.clear();
        chunk.is_last = false;
        if let Ok(mut spare) = self.spare.lock() {
            spare.push(chunk);
        }
    }
}

/// Writes the frames in the order in which their windows were cut.
fn write(
    cuts: Receiver<Cut>,
    shared: &Shared,
    out: &mut dyn FrameSink,
    progress: &mut dyn FnMut(u64),
) -> Result<EncodeSummary> {
    let mut summary = EncodeSummary::default();
    let mut sequence = 0_u32;
    let mut extra_frames = 0_u32;
    // `cuts` is taken by value: after an error here, threads that still encode find their channels closed.
    for chunks in cuts {
        let chunks = chunks?;
        loop {
            let mut chunk = chunks.recv().context("an encoding thread stopped")??;
            for made in &mut chunk.frames {
                let room = chunk.bytes.get_mut(made.at..).unwrap_or_default();
                if made.header.sequence != sequence {
                    made.number(sequence, room)?;
                }
                sequence = sequence.wrapping_add(1);
                extra_frames = extra_frames.wrapping_add(u32::from(!made.header.last));
                let frame = room.get(made.range.clone()).unwrap_or_default();
                write_frame(out, &made.header, frame)?;
                summary.add(&made.header, made.range.len());
            }
            let is_last = chunk.is_last;
            shared.reuse(chunk);
            if is_last {
                break;
            }
        }
        shared.extra_frames.store(extra_frames, Ordering::Relaxed);
        progress(shared.events_in.load(Ordering::Relaxed));
    }
    Ok(summary)
}
