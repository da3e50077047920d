//! Encodes a recording as frames, with the encoder of `eecvs_nostd`.

mod codec;
mod cutter;
pub mod duration;
pub mod options;
mod parallel;
pub mod push;
pub mod readout;
pub mod step;
pub mod volume_error;

use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use eecvs_nostd::{Header, OUTPUT_BYTES_MIN, Transform};
use event_types::stream::{Context, EventReader, Pause, Result};
use event_types::{bail, ensure};
use serde::{Deserialize, Serialize};

use crate::frame_file::FrameSink;
pub use crate::storage::{HostStorage, Limits, WINDOW_EVENTS};
use crate::storage::{frame_room, touch};
pub use codec::{Budget, Codec};
use cutter::{Cutter, Direct};

/// Default time in microseconds for which events of a recording are held back to be sorted. Packets of cameras and
/// their drivers overlap by less.
pub const REORDER_US: u32 = 5_000;

/// Default time in microseconds for which events of a live source are held back to be sorted; its windows are
/// delayed by this much. A sensor's own readout is out of order by less.
pub const REORDER_LIVE_US: u32 = 1_000;

/// Returns the number of cores that this process may use, or 1 if it is not known.
#[must_use]
pub fn all_cores() -> NonZeroUsize {
    std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

/// Returns the most threads that encode. Each has a whole encoder's memory, and more of them than cores gain nothing.
fn most_threads() -> NonZeroUsize {
    const LEAST: NonZeroUsize = NonZeroUsize::new(16).unwrap();
    const PER_CORE: NonZeroUsize = NonZeroUsize::new(4).unwrap();
    all_cores().saturating_mul(PER_CORE).max(LEAST)
}

/// Counts and times of an encoding run, as `eecvs encode` reports them; the fields are the JSON keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct EncodeSummary {
    /// Events read.
    pub events_in: u64,
    /// Events sent in frames.
    pub events_encoded: u64,
    /// Events that were too old for their window; they are in no frame.
    pub events_late: u64,
    /// Runs of windows: 1, plus 1 for each time the clock fell back by more than the reordering time.
    #[serde(default)]
    pub runs: u64,
    /// Events removed by a filter.
    pub events_filtered: u64,
    /// Events lost before or in the encoder.
    pub events_dropped: u64,
    /// Events left out by the rate control.
    pub events_thinned: u64,
    /// Encoded events whose times are not exact; in mode transform, all of them.
    pub events_approximate: u64,
    /// Windows with events.
    pub windows: u64,
    /// Windows whose volume uses the DCT.
    pub windows_dct: u64,
    /// Windows whose volume uses the DTFT.
    pub windows_dtft: u64,
    /// Windows whose volume uses the Haar DWT.
    pub windows_dwt: u64,
    /// Windows closed early because their buffer was full.
    pub windows_truncated: u64,
    /// Windows whose events of equal time decode in the order in which they arrived.
    pub windows_in_order: u64,
    /// Windows sent as coefficients. Windows sent as events are also counted under the transform of their volume.
    #[serde(default)]
    pub windows_as_coefficients: u64,
    /// Bytes spent on the arrival order.
    pub bytes_order: u64,
    /// Quantised levels clipped to 32 bits.
    pub levels_saturated: u64,
    /// Frames written.
    pub frames: u64,
    /// Bytes written: those of all frames, or the size of the file once that is set.
    pub bytes_out: u64,
    /// 8 `bytes_out` / `events_in`; 0 without events.
    pub bits_per_event: f64,
    /// Number of encoding threads.
    pub threads: usize,
    /// Seconds spent encoding events to frames, without reading and writing. With several threads, the mean per
    /// thread without the time that each of them waited.
    pub encode_s: f64,
    /// `events_in` / `encode_s`; 0 without events.
    pub events_per_s: f64,
    /// Seconds from the first event read to the last byte written.
    pub wall_s: f64,
}

impl EncodeSummary {
    /// Adds a frame of `bytes` bytes to the counts.
    fn add(&mut self, header: &Header, bytes: usize) {
        self.frames += 1;
        self.bytes_out += bytes as u64;
        self.events_encoded += u64::from(header.events);
        self.events_late += u64::from(header.late);
        self.events_filtered += u64::from(header.filtered);
        self.events_dropped += u64::from(header.dropped);
        self.events_thinned += u64::from(header.thinned);
        if !header.mode.is_lossless() {
            self.events_approximate += u64::from(header.events);
        }
        self.levels_saturated += u64::from(header.saturated);
        self.windows_in_order += u64::from(header.ends_arrival());
        if let Some(order) = header.order {
            self.windows_in_order += u64::from(header.last);
            self.bytes_order += u64::from(order.bytes);
        }
        if header.part == 0 && (header.begins_run || self.runs == 0) {
            self.runs += 1;
        }
        if header.part == 0 && header.window_events > 0 {
            self.windows += 1;
            self.windows_truncated += u64::from(header.truncated);
            self.windows_as_coefficients += u64::from(header.mode.is_transform());
            match header.transform {
                Transform::Dct => self.windows_dct += 1,
                Transform::Dtft => self.windows_dtft += 1,
                Transform::Dwt => self.windows_dwt += 1,
            }
        }
    }

    /// Returns the bits per event spent on the arrival order: 8 `bytes_order` / `events_in`, or 0 without events.
    #[must_use]
    pub fn order_bits_per_event(&self) -> f64 {
        self.bytes_order as f64 * 8.0 / self.events_in.max(1) as f64
    }

    /// Returns the bits per encoded event: 8 `bytes_out` / `events_encoded`, or 0 without events. Events that a
    /// filter removed do not count.
    #[must_use]
    pub fn bits_per_encoded_event(&self) -> f64 {
        self.bytes_out as f64 * 8.0 / self.events_encoded.max(1) as f64
    }

    /// Returns the number of encoded events whose times are exact.
    #[must_use]
    pub const fn events_exact(&self) -> u64 {
        self.events_encoded.saturating_sub(self.events_approximate)
    }

    /// Sets the bytes written to those of a file, with its marks and short frames.
    pub fn set_bytes_out(&mut self, bytes: u64) {
        self.bytes_out = bytes;
        if self.events_in > 0 {
            self.bits_per_event = self.bytes_out as f64 * 8.0 / self.events_in as f64;
        }
    }

    /// Returns an error unless every event read is encoded or counted as left out.
    fn check_accounted(&self) -> Result<()> {
        let accounted = self.events_encoded
            + self.events_late
            + self.events_filtered
            + self.events_dropped
            + self.events_thinned;
        ensure!(
            accounted == self.events_in,
            Refused,
            "{} events were read but {accounted} are accounted for: please report this",
            self.events_in
        );
        Ok(())
    }

    fn finish(&mut self, encoding: Duration, wall: Duration) {
        self.encode_s = encoding.as_secs_f64() / self.threads.max(1) as f64;
        self.wall_s = wall.as_secs_f64();
        self.set_bytes_out(self.bytes_out);
        if self.events_in > 0 {
            self.events_per_s = self.events_in as f64 / self.encode_s.max(1e-9);
        }
    }
}

/// A summary without its times, and the total time that the threads spent encoding.
type Outcome = (EncodeSummary, Duration);

/// Encodes a recording and writes its frames to `out`: a stream, or a file by a
/// [`FrameFileWriter`](crate::frame_file::FrameFileWriter). `progress` is called with the number of events read so far.
///
/// The frames do not depend on `threads`, of which no more are started than 16, or four for each core. A live source or a byte budget uses one thread. With one thread
/// everything runs on the calling thread; with more, a separate thread reads ahead and the calling thread writes. A
/// window of a live source is written as soon as its time has passed, even if no event follows. Memory does not
/// grow with the recording: each thread holds the events of at most 32 windows (of `key_windows` windows with the
/// dense coder), the lists of one, a frame, and the frames of such windows that wait to be written.
///
/// # Errors
/// Fails if reading or writing fails, if the configuration is invalid, or if the counts do not account for every
/// event. After a reading error, the frames of the windows before it have been written.
pub fn encode<'h>(
    reader: &mut dyn EventReader,
    codec: impl Into<Codec<'h>>,
    limits: Limits,
    threads: NonZeroUsize,
    out: &mut dyn FrameSink,
    progress: &mut dyn FnMut(u64),
) -> Result<EncodeSummary> {
    let codec = codec.into();
    ensure!(
        limits.frame_bytes >= OUTPUT_BYTES_MIN,
        Refused,
        "a frame needs room for at least {OUTPUT_BYTES_MIN} bytes"
    );
    let started = Instant::now();
    // The byte allowance of a window depends on the windows before it, and the windows of a live source must not
    // wait for others.
    let is_live = reader.pause() != Pause::Ended;
    let usual_us = if is_live { REORDER_LIVE_US } else { REORDER_US };
    let reorder_us = limits.reorder_us.unwrap_or(usual_us);
    let limits = Limits {
        reorder_us: Some(reorder_us),
        ..limits
    };
    let threads = if is_live || codec.config.bytes_per_second.is_some() || codec.budget.is_some() {
        NonZeroUsize::MIN
    } else {
        threads.min(most_threads())
    };
    let run = if threads == NonZeroUsize::MIN {
        encode_here(reader, codec, limits, out, progress)
    } else {
        parallel::encode(reader, codec, limits, threads, out, progress)
    };
    let (mut summary, encoding) = run?;
    summary.threads = threads.get();
    summary.finish(encoding, started.elapsed());
    summary.check_accounted()?;
    Ok(summary)
}

/// Writes the frame of a window without events that begins at 0 us, and adds it to `summary`.
///
/// A recording without events has no other frame: this one states its sensor's size, so that it is decoded to a
/// recording without events.
///
/// # Errors
/// Fails if writing fails, or as [`encode`] does for an invalid configuration.
pub fn encode_nothing<'h>(
    codec: impl Into<Codec<'h>>,
    limits: Limits,
    out: &mut dyn FrameSink,
    summary: &mut EncodeSummary,
) -> Result<()> {
    let mut codec = codec.into();
    codec.config.window.every_window = true;
    let limits = Limits {
        window_events: 1,
        ..limits
    };
    let mut storage = HostStorage::with_limits(codec.config.window.sensor, limits)?;
    let (mut window, mut encoder) = storage.parts(codec.config, codec.hot)?;
    // The first call opens the window, the second closes it.
    window.pass(0);
    window.pass(window.duration_us().into());
    let mut frame = frame_room(limits.frame_bytes)?;
    loop {
        match codec.next_frame(&mut encoder, &mut window, &mut frame) {
            Ok(Some(encoded)) => {
                summary.add(&encoded.header, encoded.range.len());
                write_frame(out, &encoded.header, &frame[encoded.range])?;
            }
            Ok(None) => return Ok(()),
            Err(_) => bail!(Refused, "{}", NO_ROOM),
        }
    }
}

/// Encodes on the calling thread.
fn encode_here(
    reader: &mut dyn EventReader,
    codec: Codec<'_>,
    limits: Limits,
    out: &mut dyn FrameSink,
    progress: &mut dyn FnMut(u64),
) -> Result<Outcome> {
    let mut storage = HostStorage::with_limits(codec.config.window.sensor, limits)?;
    let (mut window, mut encoder) = storage.parts(codec.config, codec.hot)?;
    let mut cutter = Cutter::new(Direct(reader), limits.reorder_us.unwrap_or(REORDER_US))?;
    let mut frame = frame_room(limits.frame_bytes)?;
    touch(&mut frame);
    let mut summary = EncodeSummary::default();
    let mut encoding = Duration::ZERO;
    let mut chooser = codec.chooser();
    while cutter.cut(&mut window, &mut encoding)? {
        if let Some(budget) = codec.budget {
            // A mode without a budget ignores this one too.
            let _ = encoder.set_budget(budget.get());
        }
        chooser.choose(&mut encoder, &mut window, &mut encoding)?;
        loop {
            let started = Instant::now();
            let encoded = codec.next_frame(&mut encoder, &mut window, &mut frame);
            encoding += started.elapsed();
            match encoded {
                Ok(Some(encoded)) => {
                    summary.add(&encoded.header, encoded.range.len());
                    write_frame(out, &encoded.header, &frame[encoded.range])?;
                }
                Ok(None) => break,
                Err(_) => bail!(Refused, "{}", NO_ROOM),
            }
        }
        progress(cutter.events_in());
    }
    summary.events_in = cutter.events_in();
    progress(summary.events_in);
    Ok((summary, encoding))
}

/// Message for an error that cannot occur: [`encode`] checks that a frame has room for [`OUTPUT_BYTES_MIN`] bytes.
const NO_ROOM: &str = "a frame has no room for a pixel";

fn write_frame(out: &mut dyn FrameSink, header: &Header, frame: &[u8]) -> Result<()> {
    out.frame(header, frame).context("writing frames")
}
