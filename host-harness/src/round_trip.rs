//! A recording in memory through the codec and back, as studies and benches have it.

use std::num::NonZeroUsize;

use anyhow::{Result, ensure};
use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, encode, readout};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::{Config, Event, Mode, Thresholds, Transform, WindowConfig};

/// The codec's defaults, on the windows of every study.
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

/// A file of frames.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// Headers and all.
    pub file: Vec<u8>,
    /// Spent encoding, one thread.
    pub seconds: f64,
    /// Windows by transform: DCT, DTFT, DWT.
    pub windows: [u64; 3],
}

impl Encoded {
    /// Encodes a recording on one thread; how its sensor scans is found out as `eecvs encode` does.
    ///
    /// # Errors
    /// A configuration that cannot run, or an event that is not in any frame.
    pub fn new(source: &Source, config: Config) -> Result<Self> {
        let config = readout::look_at(&source.events, config);
        let mut file = Vec::new();
        let summary = encode(
            &mut source.reader(),
            config,
            Limits::default(),
            NonZeroUsize::MIN,
            &mut file,
            &mut |_| (),
        )?;
        ensure!(
            summary.events_encoded == summary.events_in,
            "{} of {} events are in no frame; please report this",
            summary.events_in - summary.events_encoded,
            summary.events_in
        );
        Ok(Self {
            file,
            seconds: summary.encode_s,
            windows: [
                summary.windows_dct,
                summary.windows_dtft,
                summary.windows_dwt,
            ],
        })
    }
}

/// The events of a file; `each` is shown every window.
///
/// # Errors
/// A frame that does not decode, or what `each` reports.
pub fn decode(
    file: &[u8],
    finder: Finder,
    each: &mut dyn FnMut(&DecodedWindow) -> Result<()>,
) -> Result<Vec<Event>> {
    let mut windows = WindowReader::new(FrameReader::new(file));
    let mut events = Vec::new();
    let mut decoder: Option<EventDecoder> = None;
    while let Some(window) = windows.next_window()? {
        let header = &window.header;
        let decoder = match &mut decoder {
            Some(decoder) if decoder.fits(&window) => decoder,
            _ => decoder.insert(EventDecoder::new(
                header.transform,
                header.grid,
                header.m,
                finder,
            )),
        };
        events.extend(decoder.window(&window));
        each(&window)?;
    }
    ensure!(
        windows.report().is_clean(),
        "frames do not come back; please report this"
    );
    Ok(events)
}
