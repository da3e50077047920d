//! Runs a recording in memory through the codec and back, for studies and benches.

use std::num::NonZeroUsize;

use anyhow::{Result, ensure};
use eecvs::decode::WindowReader;
use eecvs::encode::{Codec, Limits, encode, readout};
use eecvs::frame_file::{FrameFileWriter, FrameReader};
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::work_limit::WorkLimit;
use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::{Config, Event, Mode, Thresholds, Transform, WindowConfig};

/// Returns the codec's default configuration for windows of [`WINDOW_US`], as every study uses it.
#[must_use]
pub fn config(
    source: &Source,
    thresholds: Thresholds,
    mode: Mode,
    transform: Option<Transform>,
    m: u8,
) -> Config {
    Config {
        transform,
        m,
        ..Config::new(
            WindowConfig::new(source.sensor, WINDOW_US),
            thresholds,
            mode,
        )
    }
}

/// An encoded recording.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The whole file: frames, short ones where they follow each other, and its marks.
    pub file: Vec<u8>,
    /// Encoding time in seconds on one thread.
    pub seconds: f64,
    /// Number of windows per transform: DCT, DTFT, DWT.
    pub windows: [u64; 3],
}

impl Encoded {
    /// Encodes a recording on one thread to a file as `eecvs encode` writes it; detects how its sensor scans.
    ///
    /// # Errors
    /// Fails if the configuration cannot run, or if an event is in no frame.
    pub fn new<'h>(source: &Source, codec: impl Into<Codec<'h>>) -> Result<Self> {
        let codec = codec.into();
        let codec = Codec {
            config: readout::look_at(&source.events, codec.config),
            ..codec
        };
        let mut out = FrameFileWriter::new(Vec::new());
        let summary = encode(
            &mut source.reader(),
            codec,
            Limits::default(),
            NonZeroUsize::MIN,
            &mut out,
            &mut |_| (),
        )?;
        ensure!(
            summary.events_encoded == summary.events_in,
            "{} of {} events are in no frame; please report this",
            summary.events_in - summary.events_encoded,
            summary.events_in
        );
        Ok(Self {
            file: out.finish()?,
            seconds: summary.encode_s,
            windows: [
                summary.windows_dct,
                summary.windows_dtft,
                summary.windows_dwt,
            ],
        })
    }
}

/// Decodes a file of frames to events; calls `each` with every window.
///
/// # Errors
/// Fails if a frame does not decode, or with the error of `each`.
pub fn decode(
    file: &[u8],
    finder: Finder,
    each: &mut dyn FnMut(&DecodedWindow) -> Result<()>,
) -> Result<Vec<Event>> {
    let mut windows = WindowReader::new(FrameReader::new(file));
    let mut events = Vec::new();
    // A study is of all pixels, whatever that takes.
    let mut decoder = EventDecoder::new(finder).with_work_limit(WorkLimit::NONE);
    while let Some(mut window) = windows.next_window()? {
        each(&window)?;
        decoder.fill(&mut window);
        events.append(&mut window.events);
        windows.reuse(window);
    }
    ensure!(
        windows.report().is_clean(),
        "frames were lost or damaged in the round trip; please report this"
    );
    Ok(events)
}
