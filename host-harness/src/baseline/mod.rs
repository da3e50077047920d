//! Baseline representations that the codec is compared with: the events of a window as an array, and back.
//!
//! ```text
//! events of a window -> array -> stored type -> events by the best stated method
//!                                    '-> array bytes, packed bytes
//! ```
//!
//! Windows last T = 32,768 us, on a grid that starts at the recording's first event; a window without events has no
//! array. Each representation has a file of its own, with its source, its definition and what its decoder can and
//! cannot recover.

pub mod ces;
pub mod dense_array;
pub mod event_frame;
pub mod packed;
pub mod pursuit;
pub mod recent;
pub mod representation;
pub mod stored;
pub mod time_surface;
pub mod tore;
pub mod voxel;

use anyhow::{Result, ensure};
use eecvs_bench::source::Source;
use eecvs_nostd::Event;

use ces::{Ces, Law};
use event_frame::EventFrame;
use packed::Packer;
use representation::{Representation, arrays, decode};
pub use stored::Stored;
use time_surface::TimeSurface;
use tore::Tore;
use voxel::Voxel;

/// A baseline representation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Baseline {
    /// Complex exponential sums, see [`ces`].
    Ces,
    /// TORE volumes, see [`tore`].
    Tore,
    /// Voxel grids, see [`voxel`].
    Voxel,
    /// Counts of events, see [`event_frame`].
    EventFrame,
    /// Exponential time surfaces, see [`time_surface`].
    TimeSurface,
}

impl Baseline {
    /// All baselines.
    pub const ALL: [Self; 5] = [
        Self::Ces,
        Self::Tore,
        Self::Voxel,
        Self::EventFrame,
        Self::TimeSurface,
    ];

    /// Returns the name used in the rows of results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ces => "ces",
            Self::Tore => "tore",
            Self::Voxel => "voxel",
            Self::EventFrame => "event-frame",
            Self::TimeSurface => "time-surface",
        }
    }
}

/// Sizes of a recording's arrays, and the events decoded from them.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// Bytes of the dense arrays: one `.npy` file in the stored type per window that has events.
    pub array_bytes: usize,
    /// Bytes of the same numbers for the active pixels only, see [`packed`]. Numbers of events of earlier windows
    /// count as empty, since they were sent with those windows.
    pub packed_bytes: usize,
    /// Time to compute the arrays' active pixels on one thread, in seconds; excludes packing and decoding.
    pub seconds: f64,
    /// Events decoded from the stored numbers, in order of time, then of position.
    pub events: Vec<Event>,
    /// Whether the array carries times; if not, the times of `events` are a guess.
    pub has_times: bool,
}

/// Makes the arrays of a recording, stores them and decodes the stored numbers.
///
/// `channels` is the paper's M, the number of values or basis functions per pixel: M complex coefficients of CES, M
/// bins of a voxel grid, the M / 2 newest ages per polarity of TORE, at least 1. Frames and surfaces always have
/// two channels.
///
/// # Errors
/// Fails if `channels` is 0, or if the recording is out of order or has events outside of its sensor.
pub fn round_trip(
    baseline: Baseline,
    source: &Source,
    channels: u8,
    stored: Stored,
) -> Result<Decoded> {
    ensure!(channels > 0, "no channels; give 1 or more");
    let (sensor, m) = (source.sensor, usize::from(channels));
    match baseline {
        Baseline::Ces => with(&mut Ces::new(sensor, m, Law::LowFrequency), source, stored),
        Baseline::Tore => with(&mut Tore::new(sensor, m / 2), source, stored),
        Baseline::Voxel => with(&mut Voxel::new(sensor, m), source, stored),
        Baseline::EventFrame => with(&mut EventFrame::new(sensor), source, stored),
        Baseline::TimeSurface => with(&mut TimeSurface::new(sensor), source, stored),
    }
}

fn with<R: Representation>(
    representation: &mut R,
    source: &Source,
    stored: Stored,
) -> Result<Decoded> {
    let mut packer = Packer::counting(source.sensor)?;
    let mut events = Vec::new();
    let made = arrays(
        representation,
        source,
        stored,
        &mut |representation, window, array| {
            let (found, packed) = rayon::join(
                || decode(representation, source.sensor, window, array),
                || packer.push(window.number, array),
            );
            events.extend(found);
            packed
        },
    )?;
    Ok(Decoded {
        array_bytes: made.array_bytes,
        packed_bytes: packer.packed_bytes()?,
        seconds: made.seconds,
        events,
        has_times: representation.has_times(),
    })
}

#[cfg(test)]
mod tests;
