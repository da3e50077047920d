//! Encodes a recording with the codec to a file in memory, and decodes it.

use std::num::NonZeroUsize;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, duration, readout};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::Finder;
use eecvs::reconstruct::volume::inverse::Inverse;
use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::{Coder, Config, Event, Fidelity, Hybrid, Mode, Thresholds, Transform};

use super::volume::{BINS, Grid, Volume};
use crate::round_trip::{Encoded, config, decode};

/// Windows from key frame to key frame in [`own_windows`].
pub const KEY_WINDOWS: u16 = 256;

/// Result of encoding and decoding a recording.
pub struct Decoded {
    /// Bytes of the whole file, headers included.
    pub file: Vec<u8>,
    /// Time spent encoding on one thread, in seconds.
    pub seconds: f64,
    /// Time spent decoding on one thread, in seconds: in mode `transform`, with what the volume takes.
    pub decode_seconds: f64,
    /// Events decoded.
    pub events: Vec<Event>,
    /// Box volume computed from the coefficients directly: the decoder's integral over each bin; `None` in mode
    /// `hybrid`.
    pub coefficients: Option<Volume>,
}

/// Encodes and decodes in mode `hybrid`.
///
/// # Errors
/// Fails if a frame does not decode, or an event is in no frame.
pub fn hybrid(source: &Source, hybrid: Hybrid) -> Result<Decoded> {
    round_trip(source, Mode::Hybrid(hybrid), None, 16)
}

/// Encodes and decodes, lossless, in windows of the duration that suits the recording, with a key frame every
/// [`KEY_WINDOWS`] of them: as `eecvs encode --auto-window` does. The choice is not part of the time.
///
/// # Errors
/// Fails if a frame does not decode, or an event is in no frame.
pub fn own_windows(source: &Source, coder: Coder) -> Result<Decoded> {
    let fidelity = Fidelity::Lossless;
    let mode = Mode::Hybrid(Hybrid { coder, fidelity });
    let config = Config {
        key_windows: KEY_WINDOWS,
        ..config(source, thresholds()?, mode, None, 16)
    };
    let config = readout::look_at(&source.events, config);
    let (_, config) = duration::look(
        Box::new(source.reader()),
        config.into(),
        Limits::default(),
        NonZeroUsize::MIN,
    )?;
    let Encoded { file, seconds, .. } = Encoded::new(source, config)?;
    let started = Instant::now();
    let events = decode(&file, Finder::Peaks, &mut |_| Ok(()))?;
    Ok(Decoded {
        file,
        seconds,
        decode_seconds: started.elapsed().as_secs_f64(),
        events,
        coefficients: None,
    })
}

/// Encodes and decodes in mode `transform`, with the default grid and quantiser.
///
/// # Errors
/// Fails if a frame does not decode, or an event is in no frame.
pub fn transform(source: &Source, transform: Transform, m: u8) -> Result<Decoded> {
    round_trip(source, Mode::Transform, Some(transform), m)
}

/// Encodes the same coefficients with an adaptive coder; returns the file's bytes and the seconds spent encoding on
/// one thread. `plain` is the file with plain codes.
///
/// # Errors
/// Fails if a frame does not decode, or a coefficient differs from the plain file's.
pub fn coded(
    source: &Source,
    transform: Transform,
    m: u8,
    coder: Coder,
    plain: &[u8],
) -> Result<(usize, f64)> {
    let mode = Mode::Coefficients(coder);
    let Encoded { file, seconds, .. } = encoded(source, mode, Some(transform), m)?;
    let mut windows = [plain, &file].map(|file| WindowReader::new(FrameReader::new(file)));
    let [plain, coded] = &mut windows;
    loop {
        let (plain, coded) = (plain.next_window()?, coded.next_window()?);
        let pixels = [&plain, &coded].map(|window| window.as_ref().map(|window| &window.pixels));
        ensure!(
            pixels[0] == pixels[1],
            "its coefficients differ from those of plain codes; please report this"
        );
        if plain.is_none() {
            return Ok((file.len(), seconds));
        }
    }
}

/// Encodes and decodes a recording.
///
/// # Errors
/// Fails if a frame does not decode, or an event is in no frame.
fn round_trip(source: &Source, mode: Mode, transform: Option<Transform>, m: u8) -> Result<Decoded> {
    let Encoded { file, seconds, .. } = encoded(source, mode, transform, m)?;
    let grid = grid(source);
    let is_transform = mode.is_transform();
    let mut cells = Vec::new();
    // Tables of one transform, grid and M, which all windows share here.
    let mut bins = None;
    let started = Instant::now();
    let events = decode(&file, Finder::Peaks, &mut |window| {
        let header = &window.header;
        if !is_transform {
            return Ok(());
        }
        let (number, since_us) = grid.window(header.t0_us);
        ensure!(
            since_us == 0 && header.duration_us == WINDOW_US,
            "a window was closed early, so its volume matches no other: make the window shorter"
        );
        let bins = bins.get_or_insert_with(|| Inverse::new(header.transform, header.grid, BINS));
        for pixel in &window.pixels {
            cells.extend((0..BINS).map(|bin| {
                let cell = grid.cell(number, pixel.x, pixel.y, bin);
                (cell, bins.value(pixel, bin))
            }));
        }
        Ok(())
    })?;
    Ok(Decoded {
        file,
        seconds,
        decode_seconds: started.elapsed().as_secs_f64(),
        events,
        coefficients: is_transform.then(|| Volume::new(cells)),
    })
}

/// Encodes on one thread.
fn encoded(source: &Source, mode: Mode, transform: Option<Transform>, m: u8) -> Result<Encoded> {
    Encoded::new(source, config(source, thresholds()?, mode, transform, m))
}

fn thresholds() -> Result<Thresholds> {
    Thresholds::new(0, 0).context("thresholds of 0")
}

/// Returns the grid on which the recording's volumes are computed.
#[must_use]
pub fn grid(source: &Source) -> Grid {
    Grid {
        start_us: source.start_us(),
        sensor: source.sensor,
    }
}
