//! Measures how well a method keeps a source, and at how many bits: Tables I and II, and the curves.

use std::sync::Arc;

use anyhow::Result;
use eecvs_bench::source::{Memory, Source, WINDOW_US};
use eecvs_nostd::Event;
use event_metrics::compare;
use serde::{Deserialize, Serialize};

use super::method::{Method, Trip};
use super::set::Set;
use crate::selection::errors::Original;

/// Results for one method and source; the fields are the columns of `quality.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// `scenes` or `recordings`.
    pub set: String,
    /// Name of the source in the set.
    pub source: String,
    /// Name of the method, see [`Method::name`].
    pub method: String,
    /// Number of coefficients or channels; 0 if events are sent.
    pub m: u8,
    /// Setting of the method, see [`Method::setting`].
    pub setting: String,
    /// Number of events of the source.
    pub events: u64,
    /// Events per pixel per second of the source, over its windows.
    pub density_per_px_s: f64,
    /// 8 * bytes / events as sent: frames, or dense arrays.
    pub bits_per_event: f64,
    /// 8 * bytes / events when packed best.
    pub packed_bits_per_event: f64,
    /// As printed by `eecvs compare`.
    pub mse: f64,
    /// As printed by `eecvs compare`.
    pub ssim: f64,
    /// As printed by `eecvs compare`.
    pub emd_time_ms: f64,
    /// As printed by `eecvs compare`.
    pub emd_pixel_us: f64,
    /// Normalised error of the volume that is smoothed in time by a Gaussian of 4 ms: [`crate::selection::errors`].
    pub volume_error: f64,
    /// As printed by `eecvs compare`.
    pub exact_fraction: f64,
    /// Number of events decoded.
    pub events_decoded: u64,
    /// Whether the decoded times are more than a guess.
    pub has_times: bool,
    /// Number of windows coded with the DCT; 0 without a transform.
    pub windows_dct: u64,
    /// Number of windows coded with the DTFT.
    pub windows_dtft: u64,
    /// Number of windows coded with the DWT.
    pub windows_dwt: u64,
}

/// Compares the decoded events with the source.
///
/// # Errors
/// Fails with the error of [`compare`].
pub fn measure(set: &Set, source: &Source, method: Method, trip: &Trip) -> Result<Quality> {
    let events: Arc<[Event]> = trip.events.as_slice().into();
    let sensor = source.sensor;
    let found = compare(
        &|| Ok(Box::new(source.reader())),
        &|| Ok(Box::new(Memory::new(sensor, Arc::clone(&events)))),
        WINDOW_US.into(),
        &mut |_| (),
    )?;
    let per_event = |bytes: usize| 8.0 * bytes as f64 / source.events.len() as f64;
    let [windows_dct, windows_dtft, windows_dwt] = trip.windows;
    Ok(Quality {
        set: set.name.to_owned(),
        source: source.name.clone(),
        method: method.name().to_owned(),
        m: method.m(),
        setting: method.setting(),
        events: found.events_a,
        density_per_px_s: density_per_px_s(source),
        bits_per_event: per_event(trip.bytes),
        packed_bits_per_event: per_event(trip.packed_bytes),
        mse: found.mse,
        ssim: found.ssim,
        emd_time_ms: found.emd_time_ms,
        emd_pixel_us: found.emd_pixel_us,
        volume_error: Original::new(&source.events).volume(&trip.events),
        exact_fraction: found.exact_fraction,
        events_decoded: found.events_b,
        has_times: trip.has_times,
        windows_dct,
        windows_dtft,
        windows_dwt,
    })
}

/// Returns the events per pixel per second of a source, over all windows from the first event's to the last
/// event's.
#[must_use]
pub fn density_per_px_s(source: &Source) -> f64 {
    let last_us = source.events.last().map_or(0, |event| event.t_us);
    let windows = (last_us - source.start_us()) / u64::from(WINDOW_US) + 1;
    let seconds = windows as f64 * f64::from(WINDOW_US) * 1e-6;
    source.events.len() as f64 / f64::from(source.sensor.pixels()) / seconds
}
