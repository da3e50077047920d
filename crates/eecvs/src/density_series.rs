//! Density and regime of every window of a recording or of a file of frames.

use std::io::Read;
use std::num::NonZeroU32;

use eecvs_nostd::{Density, Regime, Sensor, Thresholds};
use event_types::stream::{Context, Error, EventReader, Result};
use serde::Serialize;

use crate::frame_file::FrameReader;
use crate::window_counts::{CAPACITY, WindowCount, WindowCounter};

/// One window with events; the fields are the JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WindowDensity {
    /// Start.
    pub t0_us: u64,
    /// Duration.
    pub duration_us: u32,
    /// Events.
    pub events: u32,
    /// Events per pixel per second.
    pub density_per_px_s: f64,
    /// Regime by the thresholds in force.
    #[serde(serialize_with = "regime_name")]
    pub regime: Regime,
    /// Windows without events since the previous one.
    pub empty_before: u64,
}

// serde's `serialize_with` passes a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn regime_name<S: serde::Serializer>(regime: &Regime, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(regime.name())
}

/// Takes the windows of a stream in order.
#[derive(Debug)]
pub struct DensitySeries {
    sensor: Sensor,
    thresholds: Thresholds,
    window_us: u64,
    next_t0_us: Option<u64>,
}

impl DensitySeries {
    /// Windows of `window_us` on `sensor`.
    #[must_use]
    pub const fn new(sensor: Sensor, window_us: u64, thresholds: Thresholds) -> Self {
        Self {
            sensor,
            thresholds,
            window_us,
            next_t0_us: None,
        }
    }

    /// The next window.
    pub fn add(&mut self, t0_us: u64, duration_us: u32, events: u32) -> WindowDensity {
        let density = Density {
            events,
            pixels: self.sensor.pixels(),
            duration_us,
        };
        let gap_us = self.next_t0_us.map_or(0, |next| t0_us.saturating_sub(next));
        self.next_t0_us = Some(t0_us.saturating_add(u64::from(duration_us)));
        WindowDensity {
            t0_us,
            duration_us,
            events,
            density_per_px_s: density.per_pixel_s(),
            regime: self.thresholds.regime(density),
            empty_before: gap_us / self.window_us.max(1),
        }
    }
}

/// Densities of a recording's windows, in order; `each` gets every one.
///
/// # Errors
/// A recording that cannot be read.
pub fn of_recording<E: From<Error>>(
    reader: &mut dyn EventReader,
    window_us: NonZeroU32,
    thresholds: Thresholds,
    each: &mut dyn FnMut(WindowDensity) -> Result<(), E>,
) -> Result<(), E> {
    let mut series = DensitySeries::new(reader.sensor(), u64::from(window_us.get()), thresholds);
    let mut counter = WindowCounter::new(window_us, CAPACITY);
    let mut take =
        |window: WindowCount| each(series.add(window.t0_us, window.duration_us, window.events));
    let mut events = Vec::new();
    while reader.read(&mut events)? > 0 {
        for event in events.drain(..) {
            if let Some(window) = counter.push(&event) {
                take(window)?;
            }
        }
    }
    counter.flush().map_or(Ok(()), take)
}

/// Densities of the windows of frames, up to the end or the first frame of another sensor.
///
/// # Errors
/// Frames that cannot be read.
pub fn of_frames<E: From<Error>>(
    reader: &mut FrameReader<impl Read>,
    thresholds: Thresholds,
    each: &mut dyn FnMut(WindowDensity) -> Result<(), E>,
) -> Result<(), E> {
    let mut series = None;
    while let Some(located) = reader.next_frame().context("cannot be read")? {
        let header = located.frame.header;
        if header.part > 0 || header.window_events == 0 {
            continue;
        }
        let series = series.get_or_insert_with(|| {
            DensitySeries::new(header.sensor, u64::from(header.duration_us), thresholds)
        });
        each(series.add(header.t0_us, header.duration_us, header.window_events))?;
    }
    Ok(())
}
