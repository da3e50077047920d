//! Runs the core's encoder over a recording.

use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::transform::Oscillators;
use eecvs_nostd::{
    Config, Encoder, Head, OUTPUT_BYTES_MIN, Push, Scratch, Sensor, SetupError, Slot, Transform,
    WindowBuffers, bitmap_words, segments,
};
use serde::Serialize;

use crate::formats::EventReader;

/// Events that the host's window buffer holds.
pub const WINDOW_EVENTS: usize = 1 << 20;

/// Memory of an encoder on the host, whose capacity is chosen at run time.
#[derive(Debug)]
pub struct HostStorage {
    slots: Vec<Slot>,
    heads: Vec<Head>,
    bitmap: Vec<u32>,
    oscillators: Box<Oscillators>,
    sums: Vec<Sum>,
    totals: Vec<WideSum>,
    magnitudes: Vec<u32>,
}

impl HostStorage {
    /// Memory for a sensor and `window_events` events of a window, for any transform and grid.
    #[must_use]
    pub fn new(sensor: Sensor, window_events: usize) -> Self {
        let segments = segments(sensor.width, sensor.height);
        let numbers = 2 * eecvs_nostd::transform::GRID_MAX;
        Self {
            slots: vec![Slot::EMPTY; window_events],
            heads: vec![0; segments],
            bitmap: vec![0; bitmap_words(segments)],
            oscillators: Box::new(Oscillators::new()),
            sums: vec![Sum::ZERO; numbers],
            totals: vec![WideSum::ZERO; numbers],
            magnitudes: vec![0; numbers],
        }
    }

    /// An encoder over this memory, which is cleared.
    ///
    /// # Errors
    /// A window of 0 us or of no events, M or K out of range.
    pub fn encoder(&mut self, config: Config) -> Result<Encoder<'_>> {
        self.heads.fill(0);
        self.bitmap.fill(0);
        let buffers = WindowBuffers {
            slots: &mut self.slots,
            heads: &mut self.heads,
            bitmap: &mut self.bitmap,
        };
        let scratch = Scratch {
            oscillators: &mut self.oscillators,
            sums: &mut self.sums,
            totals: &mut self.totals,
            magnitudes: &mut self.magnitudes,
        };
        match Encoder::set_up(config, buffers, scratch) {
            Ok(encoder) => Ok(encoder),
            Err(SetupError::Window) => bail!(
                "the window needs a duration of at least 1 us, room for 1 to 2^24 - 1 events and a \
                 sensor of 1 to 2048 pixels a side"
            ),
            Err(SetupError::Config(error)) => {
                bail!("M must be 1 to 64 and the grid 1 to 1024 ({error:?} is not)")
            }
        }
    }
}

/// What `eecvs encode` reports; the fields are its JSON keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct EncodeSummary {
    /// Events read.
    pub events_in: u64,
    /// Events in frames.
    pub events_encoded: u64,
    /// Events too old for their window.
    pub events_late: u64,
    /// Events that a filter kept out.
    pub events_filtered: u64,
    /// Events lost.
    pub events_dropped: u64,
    /// Windows with events.
    pub windows: u64,
    /// Windows sent with the DCT.
    pub windows_dct: u64,
    /// Windows sent with the DTFT.
    pub windows_dtft: u64,
    /// Windows sent with the Haar DWT.
    pub windows_dwt: u64,
    /// Windows closed early because the buffer was full.
    pub windows_truncated: u64,
    /// Quantised levels cut to 32 bits.
    pub levels_saturated: u64,
    /// Frames written.
    pub frames: u64,
    /// Bytes written.
    pub bytes_out: u64,
    /// 8 `bytes_out` / `events_in`; 0 without events.
    pub bits_per_event: f64,
    /// Seconds spent encoding; reading and writing excluded.
    pub encode_s: f64,
    /// `events_in` / `encode_s`; 0 without events.
    pub events_per_s: f64,
}

impl EncodeSummary {
    fn add(&mut self, encoded: &eecvs_nostd::Encoded) {
        let header = &encoded.header;
        self.frames += 1;
        self.bytes_out += encoded.range.len() as u64;
        self.events_encoded += u64::from(header.events);
        self.events_late += u64::from(header.late);
        self.events_filtered += u64::from(header.filtered);
        self.events_dropped += u64::from(header.dropped);
        self.levels_saturated += u64::from(header.saturated);
        if header.part == 0 && header.window_events > 0 {
            self.windows += 1;
            self.windows_truncated += u64::from(header.truncated);
            match header.transform {
                Transform::Dct => self.windows_dct += 1,
                Transform::Dtft => self.windows_dtft += 1,
                Transform::Dwt => self.windows_dwt += 1,
            }
        }
    }

    fn finish(&mut self, encoding: Duration) {
        self.encode_s = encoding.as_secs_f64();
        if self.events_in > 0 {
            self.bits_per_event = self.bytes_out as f64 * 8.0 / self.events_in as f64;
            self.events_per_s = self.events_in as f64 / self.encode_s.max(1e-9);
        }
    }
}

/// How a recording is cut into windows and frames.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Events of a window's buffer.
    pub window_events: usize,
    /// Bytes of a frame, [`OUTPUT_BYTES_MIN`] to [`eecvs_nostd::FRAME_BYTES_MAX`].
    pub frame_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            window_events: WINDOW_EVENTS,
            frame_bytes: eecvs_nostd::FRAME_BYTES_MAX,
        }
    }
}

/// Encodes a recording; `progress` gets the events read so far.
///
/// # Errors
/// Reading or writing, a configuration that cannot run, or an event that is not accounted for.
pub fn encode(
    reader: &mut dyn EventReader,
    config: Config,
    limits: Limits,
    out: &mut dyn Write,
    progress: &mut dyn FnMut(u64),
) -> Result<EncodeSummary> {
    ensure!(
        limits.frame_bytes >= OUTPUT_BYTES_MIN,
        "a frame needs room for at least {OUTPUT_BYTES_MIN} bytes"
    );
    let mut storage = HostStorage::new(config.window.sensor, limits.window_events);
    let mut encoder = storage.encoder(config)?;
    let mut frame = vec![0; limits.frame_bytes];
    let mut summary = EncodeSummary::default();
    let mut encoding = Duration::ZERO;
    let mut events = Vec::new();
    let mut frames = Vec::new();
    loop {
        events.clear();
        let read = reader.read(&mut events)?;
        summary.events_in += read as u64;
        let started = Instant::now();
        for event in &events {
            while encoder.push(*event) == Push::Closed {
                take_frames(&mut encoder, &mut frame, &mut frames, &mut summary)?;
            }
        }
        if read == 0 {
            encoder.flush();
            take_frames(&mut encoder, &mut frame, &mut frames, &mut summary)?;
        }
        encoding += started.elapsed();
        out.write_all(&frames).context("writing frames")?;
        frames.clear();
        progress(summary.events_in);
        if read == 0 {
            break;
        }
    }
    summary.finish(encoding);
    let accounted = summary.events_encoded
        + summary.events_late
        + summary.events_filtered
        + summary.events_dropped;
    ensure!(
        accounted == summary.events_in,
        "{} events were read but {accounted} are accounted for: please report this",
        summary.events_in
    );
    Ok(summary)
}

fn take_frames(
    encoder: &mut Encoder<'_>,
    frame: &mut [u8],
    frames: &mut Vec<u8>,
    summary: &mut EncodeSummary,
) -> Result<()> {
    loop {
        match encoder.next_frame(frame) {
            Ok(Some(encoded)) => {
                summary.add(&encoded);
                frames.extend_from_slice(&frame[encoded.range]);
            }
            Ok(None) => return Ok(()),
            Err(_) => bail!("a frame has no room for a pixel"),
        }
    }
}
