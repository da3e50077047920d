//! The codec itself: a recording to a file in memory, and back.

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{
    Config, Event, Filter, Hybrid, KEY_WINDOWS, Mode, Quantiser, Thresholds, Transform,
    WindowConfig,
};
use std::num::NonZeroUsize;

use super::WINDOW_US;
use super::source::Source;
use super::volume::{BINS, Grid, Volume};
use crate::decode::WindowReader;
use crate::encode::{Limits, encode, readout};
use crate::frame_file::FrameReader;
use crate::reconstruct::bins::Bins;
use crate::reconstruct::events::{EventDecoder, Finder};

/// A recording encoded and decoded.
pub struct Decoded {
    /// Of the file, headers and all.
    pub bytes: usize,
    /// Spent encoding, one thread.
    pub seconds: f64,
    /// What came back.
    pub events: Vec<Event>,
    /// The box volume straight from the coefficients, the decoder's integral over each bin; `None` in
    /// mode `hybrid`.
    pub coefficients: Option<Volume>,
}

/// In mode `hybrid`.
///
/// # Errors
/// A frame that does not decode, or an event that is not in any.
pub fn hybrid(source: &Source, hybrid: Hybrid) -> Result<Decoded> {
    round_trip(source, Mode::Hybrid(hybrid), None, 16)
}

/// In mode `transform`, with the default grid and quantiser.
///
/// # Errors
/// A frame that does not decode, or an event that is not in any.
pub fn transform(source: &Source, transform: Transform, m: u8) -> Result<Decoded> {
    round_trip(source, Mode::Transform, Some(transform), m)
}

/// # Errors
/// A frame that does not decode, or an event that is not in any.
fn round_trip(source: &Source, mode: Mode, transform: Option<Transform>, m: u8) -> Result<Decoded> {
    let config = Config {
        window: WindowConfig {
            sensor: source.sensor,
            window_us: WINDOW_US,
        },
        thresholds: Thresholds::new(0, 0).context("thresholds of 0")?,
        transform,
        m,
        grid: None,
        quantiser: Quantiser::DEFAULT,
        mode,
        key_windows: KEY_WINDOWS,
        readout: None,
        filter: Filter::NONE,
        bytes_per_second: None,
    };
    let config = readout::look_at(&source.events, config);
    let (mut bytes, mut reader) = (Vec::new(), source.reader());
    let (limits, threads) = (Limits::default(), NonZeroUsize::MIN);
    let summary = encode(
        &mut reader,
        config,
        limits,
        threads,
        &mut bytes,
        &mut |_| (),
    )?;
    ensure!(
        summary.events_encoded == summary.events_in,
        "{} of {} events are in no frame; please report this",
        summary.events_in - summary.events_encoded,
        summary.events_in
    );
    let grid = source.grid();
    let is_transform = mode.is_transform();
    let mut windows = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut events = Vec::with_capacity(source.events.len());
    let mut cells = Vec::new();
    let mut decoder: Option<(EventDecoder, Bins)> = None;
    while let Some(window) = windows.next_window()? {
        let header = &window.header;
        let (decoder, bins) = match &mut decoder {
            Some(decoder) if decoder.0.fits(&window) => decoder,
            _ => decoder.insert((
                EventDecoder::new(header.transform, header.grid, header.m, Finder::Peaks),
                Bins::new(header.transform, header.grid, BINS),
            )),
        };
        events.extend(decoder.window(&window));
        if is_transform {
            let (number, since_us) = grid.window(header.t0_us);
            ensure!(
                since_us == 0 && header.duration_us == WINDOW_US,
                "a window was closed early, and its volume is no other's: make the window shorter"
            );
            for pixel in &window.pixels {
                cells.extend((0..BINS).map(|bin| {
                    let cell = grid.cell(number, pixel.x, pixel.y, bin);
                    (cell, bins.value(pixel, bin))
                }));
            }
        }
    }
    let report = windows.report();
    ensure!(
        report.is_clean(),
        "frames do not come back; please report this"
    );
    Ok(Decoded {
        bytes: bytes.len(),
        seconds: summary.encode_s,
        events,
        coefficients: is_transform.then(|| Volume::new(cells)),
    })
}

impl Source {
    /// Where its volumes lie.
    #[must_use]
    pub fn grid(&self) -> Grid {
        Grid {
            start_us: self.start_us(),
            sensor: self.sensor,
        }
    }
}
