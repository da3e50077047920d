//! What representations have in common: an array for each window that has events, as a file each.

use eecvs_nostd::Event;

use crate::source::{Source, WINDOW_US};

/// Header of a `.npy` file, which every array has.
pub const HEADER_BYTES: usize = 128;

/// A window that has events.
pub struct Window<'e> {
    /// Number of the window on the recording's grid.
    pub number: u64,
    /// Its first time.
    pub start_us: u64,
    /// In order of time.
    pub events: &'e [Event],
}

/// The windows of a recording.
pub fn windows(source: &Source) -> impl Iterator<Item = Window<'_>> {
    let grid = source.grid();
    let chunks = source
        .events
        .chunk_by(move |a, b| grid.window(a.t_us).0 == grid.window(b.t_us).0);
    chunks.map(move |events| {
        let number = events.first().map_or(0, |event| grid.window(event.t_us).0);
        Window {
            number,
            start_us: grid.start_us + number * u64::from(WINDOW_US),
            events,
        }
    })
}

/// Bytes of a window's array of `channels` values of `value_bytes` for every pixel.
#[must_use]
pub fn bytes(source: &Source, channels: usize, value_bytes: usize) -> usize {
    HEADER_BYTES + source.sensor.pixels() as usize * channels * value_bytes
}
