//! Computes the density and the regime of every window of a recording or a file of frames.

use std::io::Read;
use std::num::NonZeroU32;

use eecvs_nostd::{Density, Regime, Sensor, Thresholds};
use event_types::stream::{Context, Error, EventReader, Result};
use serde::Serialize;

use crate::frame_file::FrameReader;
use crate::window_counts::{CAPACITY, WindowCount, WindowCounter};

/// A window with events and its density; the fields are the JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WindowDensity {
    /// Start of the window in microseconds.
    pub t0_us: u64,
    /// Duration of the window in microseconds.
    pub duration_us: u32,
    /// Number of events.
    pub events: u32,
    /// Events per pixel per second.
    pub density_per_px_s: f64,
    /// Regime by the thresholds of the series.
    #[serde(serialize_with = "regime_name")]
    pub regime: Regime,
    /// Number of windows without events since the previous window.
    pub empty_before: u64,
}

// `serialize_with` of serde passes a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn regime_name<S: serde::Serializer>(regime: &Regime, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(regime.name())
}

/// Computes densities of a stream's windows in order.
#[derive(Debug)]
pub struct DensitySeries {
    sensor: Sensor,
    thresholds: Thresholds,
    window_us: u64,
    next_t0_us: Option<u64>,
}

impl DensitySeries {
    /// Creates a series of windows of `window_us` microseconds on `sensor`.
    #[must_use]
    pub const fn new(sensor: Sensor, window_us: u64, thresholds: Thresholds) -> Self {
        Self {
            sensor,
            thresholds,
            window_us,
            next_t0_us: None,
        }
    }

    /// Returns the density of the next window; windows must be added in order of time.
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

/// Computes the densities of a recording's windows in order, and calls `each` with each of them.
///
/// # Errors
/// Fails if the recording cannot be read, and with the errors of `each`.
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

/// Computes the densities of the windows in a stream of frames, up to its end or to the first frame of another
/// sensor, and calls `each` with each of them.
///
/// # Errors
/// Fails if the frames cannot be read, and with the errors of `each`.
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
