//! The representations that the codec is compared with: a window's events as an array, and back.
//!
//! ```text
//! events of a window -> array -> stored type -> events by the best stated method
//!                                    '-> array bytes, packed bytes
//! ```
//!
//! Windows are of T = 32,768 us, on a grid that begins with the recording; one without events has no
//! array. Each representation stands in a file of its own, with its source, its definition and what its
//! decoder can and cannot tell.

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

/// A representation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Baseline {
    /// Complex exponential sums, see [`ces`].
    Ces,
    /// The TORE volume, see [`tore`].
    Tore,
    /// A voxel grid, see [`voxel`].
    Voxel,
    /// Counts of events, see [`event_frame`].
    EventFrame,
    /// Exponential time surfaces, see [`time_surface`].
    TimeSurface,
}

impl Baseline {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Ces,
        Self::Tore,
        Self::Voxel,
        Self::EventFrame,
        Self::TimeSurface,
    ];

    /// As rows have it.
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

/// A recording as arrays, and what is found in them.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// Of the dense arrays, a `.npy` file for each window that has events, in the stored type.
    pub array_bytes: usize,
    /// Of the same numbers of the active pixels alone, see [`packed`]; numbers of events of earlier
    /// windows, which were sent with these, count as none.
    pub packed_bytes: usize,
    /// Spent on the arrays' active pixels, one thread; neither packing nor decoding.
    pub seconds: f64,
    /// What the decoder finds in the stored numbers, in order of time, then of place.
    pub events: Vec<Event>,
    /// Whether the array tells of times; where it does not, those of the events are a guess.
    pub has_times: bool,
}

/// Makes a recording's arrays, stores them and decodes what was stored.
///
/// `channels` is how many numbers or basis functions a pixel has, the paper's M: M complex coefficients
/// of CES, M bins of a voxel grid, the M / 2 newest ages of each polarity of TORE, 1 at least. Frames
/// and surfaces have two channels, whatever it is.
///
/// # Errors
/// `channels` of 0; a recording that is out of order or has events outside of its sensor.
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
