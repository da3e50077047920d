//! Table III: time per window and events per second, on a host and on a microcontroller.
//!
//! The host encodes a window with as many events as the paper's, repeatedly, on one thread. The microcontroller's
//! rows are instructions per event of its image in QEMU, as saved by `cargo xtask instructions`. Its events per
//! second assume 168 million *instructions* per second; a real Cortex-M4 at 168 MHz is somewhat slower, as some
//! instructions take several cycles.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs::encode::{HostStorage, WINDOW_EVENTS};
use eecvs_bench::moderate::{EVENTS, SENSOR, config, encode, scene, window};
use eecvs_nostd::{Coder, Config, FRAME_BYTES_MAX, Fidelity, Hybrid, Mode, Scan, Transform, scan};
use serde::{Deserialize, Serialize};

use super::effort::{Effort, M_SPEED};
use super::paper::EVENTS_PER_WINDOW;

const SAVED: &str = include_str!("../../../firmware/instructions.json");
/// Instructions per second of a Cortex-M4 if each took one of its 168 million cycles.
const INSTRUCTIONS_PER_S: f64 = 168e6;
/// Encodings of the window between two readings of the clock.
const BATCH: usize = 16;

/// Target name in the host's rows.
pub const HOST: &str = "host, one thread";
/// Target name in the microcontroller's rows.
pub const MCU: &str = "Cortex-M4 in QEMU, 168 million instructions/s";

/// Speed of one method on one target; the fields are the columns of `speed.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Speed {
    /// [`HOST`] or [`MCU`].
    pub target: String,
    /// `dct`, `dtft`, `dwt`, `hybrid-fast`, `hybrid-dense`.
    pub method: String,
    /// Number of coefficients; 0 if events are sent.
    pub m: u8,
    /// Events of the window that is encoded, or of a window of the paper's size, for which the time is computed
    /// from instructions per event.
    pub events_per_window: f64,
    /// Median time per window, in us.
    pub us_per_window: f64,
    /// Half the interquartile range of `us_per_window`; 0 if instructions are counted.
    pub spread_us: f64,
    /// Thousand events per second.
    pub kev_per_s: f64,
    /// `kev_per_s` over that of the slowest transform on the same target.
    pub relative: f64,
    /// Instructions counted per event; `None` on the host.
    pub instructions_per_event: Option<f64>,
}

/// The fields used here of a line of the saved counts.
#[derive(Debug, Deserialize)]
struct Saved {
    origin: String,
    cut: String,
    transform: String,
    m: u8,
    events: u64,
    whole: u64,
}

/// Measures the host's times and reads the microcontroller's saved counts.
///
/// # Errors
/// Fails if an encoder does not encode every event or the saved counts cannot be read.
pub fn measure(effort: &Effort) -> Result<Vec<Speed>> {
    let mut rows = host(effort)?;
    rows.extend(mcu()?);
    Ok(rows)
}

fn host(effort: &Effort) -> Result<Vec<Speed>> {
    let scene = scene()?;
    let events = window(&scene)?;
    let hybrid = |coder| Config {
        mode: Mode::Hybrid(Hybrid {
            coder,
            fidelity: Fidelity::Lossless,
        }),
        transform: None,
        ..config(Transform::Dct, M_SPEED)
    };
    let mut methods: Vec<(&str, u8, Config)> = Transform::ALL
        .into_iter()
        .map(|transform| (transform.name(), M_SPEED, config(transform, M_SPEED)))
        .collect();
    methods.push(("hybrid-fast", 0, hybrid(Coder::Fast)));
    methods.push(("hybrid-dense", 0, hybrid(Coder::Dense)));
    let mut rows = Vec::new();
    for (method, m, config) in methods {
        let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
        let mut encoder = storage.encoder(config)?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        // Check the result first: a frame that decodes to every event.
        let Scan::Frame(frame) = scan(encode(&mut encoder, events, &mut out)) else {
            anyhow::bail!("{method}: not a frame; please report this");
        };
        ensure!(
            frame.header.events as usize == EVENTS,
            "{method}: a frame without all events; please report this"
        );
        let mut times_us = Vec::new();
        let started = Instant::now();
        while started.elapsed().as_secs_f64() < effort.speed_s {
            let batch = Instant::now();
            for _ in 0..BATCH {
                black_box(encode(&mut encoder, black_box(events), &mut out));
            }
            times_us.push(batch.elapsed().as_secs_f64() * 1e6 / BATCH as f64);
        }
        times_us.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = (times_us.len().saturating_sub(1)) as f64 * share;
            times_us.get(place.round() as usize).copied().unwrap_or(0.0)
        };
        rows.push(Speed {
            target: HOST.to_owned(),
            method: method.to_owned(),
            m,
            events_per_window: EVENTS as f64,
            us_per_window: at(0.5),
            spread_us: (at(0.75) - at(0.25)) / 2.0,
            kev_per_s: EVENTS as f64 * 1e3 / at(0.5),
            relative: 0.0,
            instructions_per_event: None,
        });
    }
    Ok(relative(rows))
}

/// Reads the counts on the cut of davis346_building_dense, whose events per pixel are like those of most
/// recordings.
fn mcu() -> Result<Vec<Speed>> {
    let mut rows = Vec::new();
    for line in SAVED.lines() {
        let saved: Saved =
            serde_json::from_str(line).context("firmware/instructions.json: save it again")?;
        let (method, m) = match saved.transform.as_str() {
            "fast" => ("hybrid-fast", 0),
            "dense" => ("hybrid-dense", 0),
            transform => (transform, saved.m),
        };
        let is_events = m == 0;
        if saved.origin != "recordings"
            || saved.cut != "davis346"
            || !(is_events || m == M_SPEED)
            || saved.events == 0
        {
            continue;
        }
        let per_event = saved.whole as f64 / saved.events as f64;
        rows.push(Speed {
            target: MCU.to_owned(),
            method: method.to_owned(),
            m,
            events_per_window: EVENTS_PER_WINDOW,
            us_per_window: per_event * EVENTS_PER_WINDOW / INSTRUCTIONS_PER_S * 1e6,
            spread_us: 0.0,
            kev_per_s: INSTRUCTIONS_PER_S / per_event / 1e3,
            relative: 0.0,
            instructions_per_event: Some(per_event),
        });
    }
    Ok(relative(rows))
}

fn relative(mut rows: Vec<Speed>) -> Vec<Speed> {
    let slowest = rows
        .iter()
        .filter(|row| row.m > 0)
        .map(|row| row.kev_per_s)
        .fold(f64::INFINITY, f64::min);
    for row in &mut rows {
        row.relative = row.kev_per_s / slowest;
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_targets_have_every_row() {
        let effort = Effort {
            speed_s: 0.01,
            ..Effort::QUICK
        };
        let rows = measure(&effort).unwrap();
        for target in [HOST, MCU] {
            let rows: Vec<_> = rows.iter().filter(|row| row.target == target).collect();
            let mut methods: Vec<&str> = rows.iter().map(|row| row.method.as_str()).collect();
            methods.sort_unstable();
            assert_eq!(
                methods,
                ["dct", "dtft", "dwt", "hybrid-dense", "hybrid-fast"]
            );
            assert!(
                rows.iter()
                    .all(|row| row.kev_per_s > 1.0 && row.kev_per_s.is_finite())
            );
            assert!(rows.iter().any(|row| row.relative == 1.0));
        }
    }
}
