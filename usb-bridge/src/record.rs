//! Writes a live stream to a file that stays readable however the stream ends.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::num::NonZeroUsize;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, anyhow};
use eecvs::encode::{Codec, EncodeSummary, Limits, encode};
use eecvs::frame_file::{FrameFileWriter, FrameSink};
use eecvs_nostd::Event;
use eecvs_nostd::frame::Header as FrameHeader;
use event_files::{EventReader, Intact, Pause, output};

use crate::device::mcu::messages::{FRAME_BYTES_MAX, Message, Messages};
use crate::link::Loss;
use crate::link::raw_file::{Header, RawWriter};
use crate::pump::Chunk;
use crate::queue::Taken;
use crate::session::Session;

/// What a capture writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The device's own bytes, with their times of arrival.
    Stream,
    /// Frames, encoded by the host or by the MCU.
    Frames,
    /// Events, in the format of a recording.
    Events,
}

impl Kind {
    /// Refuses an unusable output before any work is done, by [`output::check`].
    ///
    /// # Errors
    /// Those of [`output::check`].
    pub fn check(self, path: &Path, overwrite: bool, inputs: &[&Path]) -> Result<()> {
        let kind = match self {
            Self::Stream => output::Kind::Stream,
            Self::Frames => output::Kind::Frames,
            Self::Events => output::Kind::Recording,
        };
        Ok(output::check(path, kind, overwrite, inputs)?)
    }
}

/// Returns what to write to a path, by its extension: a stream for `.stream`, frames for `.eecvs` and for stdout,
/// events otherwise.
///
/// # Errors
/// The format is one whose files cannot be read before they are complete (`.npz`).
pub fn kind_of(path: &Path) -> Result<Kind> {
    let name = path.display();
    if output::is_stdout(path) {
        return Ok(Kind::Frames);
    }
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("stream") => Ok(Kind::Stream),
        Some("eecvs") => Ok(Kind::Frames),
        Some("npz") => anyhow::bail!(
            "{name}: an .npz file cannot be read unless it is complete, and a capture may be cut \
             short: record .raw or .aedat4 and convert that with eecvs convert"
        ),
        _ => Ok(Kind::Events),
    }
}

/// Writes the device's own bytes with their times of arrival until the stream ends or fails.
///
/// # Errors
/// The link failed, or the file cannot be written.
pub fn stream(session: &Session, path: &Path) -> Result<()> {
    let name = path.display();
    let out = create(path)?;
    let started = Instant::now();
    let since_1970 = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let started_ns = u64::try_from(since_1970.as_nanos()).unwrap_or(u64::MAX);
    let header = Header::new(session.model.name(), &session.info, started_ns);
    let failed = |error: io::Error| anyhow!("{name}: cannot be written: {error}");
    let mut writer = RawWriter::new(out, &header).map_err(failed)?;
    let written = each_chunk(session, |chunk| {
        let time = chunk.at.saturating_duration_since(started);
        if chunk.after_loss {
            writer.lost(time, None, Loss::Damaged)?;
        }
        writer.bytes(time, &chunk.bytes)
    });
    let finished = writer.finish().and_then(|mut out| out.flush());
    written.map_err(failed)?;
    finished.map_err(failed)?;
    session.outcome()
}

/// Passes each chunk to `write`, and counts its events, until the stream ends or `write` fails.
fn each_chunk(
    session: &Session,
    mut write: impl FnMut(&Chunk) -> io::Result<()>,
) -> io::Result<()> {
    let (mut follower, mut events) = (session.follower(), Vec::new());
    let written = loop {
        let chunk = match session.pumped.queue.take(Duration::from_millis(50)) {
            Taken::Item(chunk) => chunk,
            Taken::Nothing => {
                follower.tell();
                continue;
            }
            Taken::Closed => break Ok(()),
        };
        follower.count(&chunk, &mut events);
        let written = write(&chunk);
        session.pumped.reuse(chunk.bytes);
        if written.is_err() {
            break written;
        }
    };
    follower.tell();
    written
}

/// Counts of the events written and of the runs that their times form.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Order {
    /// Events received.
    pub events: u64,
    /// Runs: 1, plus 1 for each time that the clock falls back further than the reordering span.
    pub runs: u64,
    /// Events that came too late for their window and are in no frame.
    pub events_late: u64,
}

impl Order {
    /// Counts a frame that is kept as it is.
    fn frame(&mut self, header: &FrameHeader) {
        self.events += u64::from(header.events);
        self.events_late += u64::from(header.late);
        self.runs = self.runs.max(1) + u64::from(header.begins_run && self.runs > 0);
    }

    /// Counts events of a recording; `latest_us` is the latest time before them, and is updated.
    fn events(&mut self, events: &[Event], latest_us: &mut u64, reorder_us: u32) {
        self.events += events.len() as u64;
        for event in events {
            self.runs = self.runs.max(1);
            if event.t_us.saturating_add(reorder_us.into()) < *latest_us {
                self.runs += 1;
                *latest_us = event.t_us;
            }
            *latest_us = event.t_us.max(*latest_us);
        }
    }
}

impl From<&EncodeSummary> for Order {
    fn from(summary: &EncodeSummary) -> Self {
        Self {
            events: summary.events_in,
            runs: summary.runs,
            events_late: summary.events_late,
        }
    }
}

/// Writes events until the stream ends or fails, and adds their counts to `order`. A run begins where the time
/// falls back by more than `reorder_us`. Events before a failure are in the file, which is still closed in order if
/// possible.
///
/// # Errors
/// The link failed, or the file cannot be written; the message names it.
pub fn events(
    reader: &mut dyn EventReader,
    path: &Path,
    reorder_us: u32,
    order: &mut Order,
) -> Result<()> {
    let mut writer = event_files::create_in_place(path, reader.sensor())?;
    let mut batch: Vec<Event> = Vec::with_capacity(event_files::BATCH_EVENTS);
    let mut latest_us = 0;
    let outcome = loop {
        batch.clear();
        let read = reader.read(&mut batch);
        // Events read before an error count too.
        if !batch.is_empty() {
            if let Err(error) = writer.write(&batch) {
                break Err(error);
            }
            order.events(&batch, &mut latest_us, reorder_us);
        }
        match read {
            Err(error) => break Err(error),
            Ok(0) if reader.pause() == Pause::Ended => break Ok(()),
            Ok(_) => {}
        }
    };
    let finished = writer.finish();
    Ok(outcome.and(finished)?)
}

/// What is known of the output, even if the stream failed.
#[derive(Debug, Default)]
pub struct Kept {
    /// Counts of events and runs.
    pub order: Order,
    /// Summary of the encoding; `None` if the frames came from the MCU.
    pub encoding: Option<EncodeSummary>,
}

/// Encodes events into frames until the stream ends or fails. All events before
/// a failure are in frames; `kept` receives their counts.
///
/// # Errors
/// The link failed, the output cannot be written, or the configuration is unusable.
pub fn encode_live(
    reader: Box<dyn EventReader>,
    codec: Codec<'_>,
    limits: Limits,
    out: &mut dyn FrameSink,
    kept: &mut Kept,
) -> Result<()> {
    let mut reader = Intact::new(reader);
    let threads = NonZeroUsize::MIN;
    let summary = encode(&mut reader, codec, limits, threads, out, &mut |_| {})?;
    kept.order = Order::from(&summary);
    kept.encoding = Some(summary);
    reader.damage().map_or(Ok(()), |damage| Err(damage.into()))
}

/// Encodes events into frames in a file; see [`encode_live`].
///
/// # Errors
/// Those of [`encode_live`]; the message names the file.
pub fn frames(
    reader: Box<dyn EventReader>,
    codec: Codec<'_>,
    limits: Limits,
    path: &Path,
    kept: &mut Kept,
) -> Result<()> {
    let mut out = create_frames(path)?;
    let encoded = encode_live(reader, codec, limits, &mut out, kept);
    let flushed = finish(out, path);
    encoded.with_context(|| path.display().to_string())?;
    flushed
}

/// Writes an MCU's frames unchanged until the stream ends or fails, and adds the counts
/// of their headers to `order`.
///
/// # Errors
/// The link failed, or the output cannot be written.
pub fn encoders_frames(
    session: &Session,
    out: &mut dyn FrameSink,
    order: &mut Order,
) -> Result<()> {
    let mut messages = Messages::default();
    each_chunk(session, |chunk| kept(&mut messages, chunk, out, order))
        .context("frames cannot be written")?;
    session.outcome()
}

/// Writes the frames that this chunk completes.
fn kept(
    messages: &mut Messages,
    chunk: &Chunk,
    out: &mut dyn FrameSink,
    order: &mut Order,
) -> io::Result<()> {
    let mut write = |messages: &mut Messages| {
        while let Some(message) = messages.next() {
            if let Message::Frame { bytes, frame, .. } = message {
                out.frame(&frame.header, bytes)?;
                order.frame(&frame.header);
            }
        }
        Ok::<_, io::Error>(())
    };
    while chunk.after_loss && messages.has_begun() {
        messages.give_up();
        write(messages)?;
    }
    for piece in chunk.bytes.chunks(FRAME_BYTES_MAX) {
        messages.push(piece);
        write(messages)?;
    }
    Ok(())
}

/// Creates a buffered file, or opens stdout without a buffer.
///
/// # Errors
/// The file cannot be created; the message names it.
pub fn create(path: &Path) -> Result<BufWriter<File>> {
    let file = output::create_bytes(path)
        .with_context(|| format!("{}: cannot be created", path.display()))?;
    // A reader of stdout gets each frame as soon as it is written.
    let room = if output::is_stdout(path) { 0 } else { 1 << 16 };
    Ok(BufWriter::with_capacity(room, file))
}

/// A file of frames that is being written.
pub type FrameFile = FrameFileWriter<BufWriter<File>>;

/// Begins a file of frames, with marks; stdout, a device or a pipe takes a stream, without them.
///
/// # Errors
/// Those of [`create`].
pub fn create_frames(path: &Path) -> Result<FrameFile> {
    let out = create(path)?;
    let is_file = out.get_ref().metadata().is_ok_and(|about| about.is_file());
    if output::is_stdout(path) || !is_file {
        return Ok(FrameFileWriter::stream(out));
    }
    Ok(FrameFileWriter::new(out))
}

/// Marks the end of a file of frames, and writes out what is buffered.
///
/// # Errors
/// The file cannot be written; the message names it.
pub fn finish(out: FrameFile, path: &Path) -> Result<()> {
    let flushed = out.finish().and_then(|mut out| out.flush());
    flushed.with_context(|| format!("{}: cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use eecvs::decode::WindowReader;
    use eecvs::frame_file::FrameReader;
    use eecvs_cli::codec::CodecOptions;
    use eecvs_nostd::{Polarity, Sensor};
    use event_files::Skipped;

    use super::*;

    #[test]
    fn a_time_that_falls_back_further_than_is_put_in_order_begins_a_run() {
        let at = |t_us| Event {
            t_us,
            x: 0,
            y: 0,
            polarity: Polarity::On,
        };
        let (mut order, mut latest_us) = (Order::default(), 0);
        order.events(&[], &mut latest_us, 10);
        assert_eq!(order.runs, 0);
        order.events(&[at(100), at(90), at(100)], &mut latest_us, 10);
        assert_eq!(order.runs, 1);
        order.events(&[at(89), at(99)], &mut latest_us, 10);
        order.events(&[at(100), at(0)], &mut latest_us, 10);
        assert_eq!((order.runs, order.events), (3, 7));
    }

    /// Returns its events once, then fails.
    struct Failing(Vec<Event>, Skipped);

    impl EventReader for Failing {
        fn format(&self) -> &'static str {
            "failing"
        }

        fn sensor(&self) -> Sensor {
            Sensor {
                width: 8,
                height: 8,
            }
        }

        fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
            match std::mem::take(&mut self.0) {
                given if given.is_empty() => Err(event_types::error!(Other, "unplugged")),
                mut given => {
                    events.append(&mut given);
                    Ok(1)
                }
            }
        }

        fn pause(&self) -> Pause {
            Pause::Until(0)
        }

        fn skipped(&self) -> &Skipped {
            &self.1
        }
    }

    #[derive(Parser)]
    struct Options {
        #[command(flatten)]
        codec: CodecOptions,
    }

    #[test]
    fn what_came_before_a_failure_is_in_frames_and_told() {
        let at = |t_us| Event {
            t_us,
            x: 1,
            y: 2,
            polarity: Polarity::Off,
        };
        let events = vec![at(100_000), at(100_001), at(5), at(6), at(7)];
        let reader = Failing(events, Skipped::default());
        let config = Options::parse_from(["encode"])
            .codec
            .config(reader.sensor());
        let (mut out, mut kept) = (Vec::new(), Kept::default());
        let error = encode_live(
            Box::new(reader),
            Codec::from(config.unwrap()),
            Limits::default(),
            &mut out,
            &mut kept,
        );
        assert_eq!(error.unwrap_err().to_string(), "unplugged");
        assert_eq!((kept.order.events, kept.order.runs), (5, 2));
        assert_eq!(kept.encoding.unwrap().events_encoded, 5);
        let mut windows = WindowReader::new(FrameReader::new(&out[..]));
        let mut events = 0;
        while let Some(window) = windows.next_window().unwrap() {
            events += window.events.len();
        }
        assert_eq!(events, 5);
    }
}
