//! Table III: time per window and events per second, on a host and on a microcontroller.
//!
//! The host encodes a window with as many events as the paper's, repeatedly, on one thread. The microcontroller's
//! rows are instructions per event of its image in QEMU, as saved by `cargo xtask instructions`. Its events per
//! second assume 168 million *instructions* per second; a real Cortex-M4 at 168 MHz is somewhat slower, as some
//! instructions take several cycles.

use std::hint::black_box;
use std::num::NonZeroU32;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs::encode::{HostStorage, WINDOW_EVENTS};
use eecvs::reconstruct::events::Finder;
use eecvs_bench::moderate::{SENSOR, config, encode, scene, window};
use eecvs_nostd::{Coder, Config, Event, FRAME_BYTES_MAX, Fidelity, Hybrid, Mode, Transform};
use serde::{Deserialize, Serialize};

use super::effort::{Effort, M_SPEED};
use super::paper::EVENTS_PER_WINDOW;
use crate::round_trip::decode;
use crate::selection::errors::{Errors, Original};
use crate::selection::{self, settings};

const SAVED: &str = include_str!("../../../firmware/instructions.json");
/// Instructions per second of a Cortex-M4 if each took one of its 168 million cycles.
const INSTRUCTIONS_PER_S: f64 = 168e6;
/// Encodings of the window between two readings of the clock.
const BATCH: usize = 16;

/// Target name in the host's rows.
pub const HOST: &str = "host, one thread";
/// Mean error of times at which methods are compared, in us.
pub const EQUAL_US: u32 = 512;
/// Target name in the host's rows at equal errors: of each transform the setting of fewest bits within 512 us on average.
pub const HOST_EQUAL: &str = "host, one thread, emd_pixel of at most 512 us";
/// Target name in the microcontroller's rows.
pub const MCU: &str = "Cortex-M4 in QEMU, 168 million instructions/s";

/// Speed of one method on one target; the fields are the columns of `speed.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Speed {
    /// [`HOST`], [`HOST_EQUAL`] or [`MCU`].
    pub target: String,
    /// `dct`, `dtft`, `dwt`, `dct-few` (pixels of few events as times), `hybrid-fast`, `hybrid-dense`, `best`,
    /// `best-fast` (times within a mean error, by the fast coder).
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
    /// 8 * bytes of the frame / events; `None` on the microcontroller.
    pub bits_per_event: Option<f64>,
    /// Error of the decoded times; `None` on the microcontroller.
    pub emd_pixel_us: Option<f64>,
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
    let window = Window::new(window(&scene)?);
    let hybrid = |coder, max_emd_us| Config {
        mode: Mode::Hybrid(Hybrid {
            coder,
            fidelity: Fidelity::Lossless,
        }),
        transform: None,
        max_emd_us: NonZeroU32::new(max_emd_us),
        ..config(Transform::Dct, M_SPEED)
    };
    let mut methods = Vec::new();
    for transform in Transform::ALL {
        let plain = config(transform, M_SPEED);
        methods.push(Timed::new(transform.name(), plain));
        let few_as_times = true;
        let name = few(transform);
        methods.push(Timed::new(
            name,
            Config {
                few_as_times,
                ..plain
            },
        ));
    }
    methods.push(Timed::new("hybrid-fast", hybrid(Coder::Fast, 0)));
    methods.push(Timed::new("hybrid-dense", hybrid(Coder::Dense, 0)));
    let rows: Vec<Speed> = methods
        .iter()
        .map(|method| window.speed(HOST, method, effort))
        .collect::<Result<_>>()?;

    let mut equal = Vec::new();
    for transform in Transform::ALL {
        equal.extend(window.cheapest(transform)?);
    }
    for (name, coder) in [("best-fast", Coder::Keys), ("best", Coder::Dense)] {
        equal.push(Timed::new(name, hybrid(coder, EQUAL_US)));
    }
    let equal: Vec<Speed> = equal
        .iter()
        .map(|method| window.speed(HOST_EQUAL, method, effort))
        .collect::<Result<_>>()?;
    Ok([relative(rows), relative(equal)].concat())
}

/// Returns the name of a transform whose pixels of few events are sent as times.
const fn few(transform: Transform) -> &'static str {
    match transform {
        Transform::Dct => "dct-few",
        Transform::Dtft => "dtft-few",
        Transform::Dwt => "dwt-few",
    }
}

/// A method whose speed is measured.
#[derive(Debug, Clone, Copy)]
struct Timed {
    name: &'static str,
    config: Config,
}

impl Timed {
    const fn new(name: &'static str, config: Config) -> Self {
        Self { name, config }
    }
}

/// The window that is encoded.
#[derive(Debug)]
struct Window<'w> {
    events: &'w [Event],
    original: Original,
}

impl<'w> Window<'w> {
    fn new(events: &'w [Event]) -> Self {
        Self {
            events,
            original: Original::new(events),
        }
    }

    /// Returns the fewest bytes' setting of a transform among those of [`Effort::FULL`](selection::Effort::FULL) that are
    /// within [`EQUAL_US`], by plain codes or the fast coder; `None` if no setting is.
    fn cheapest(&self, transform: Transform) -> Result<Option<Timed>> {
        let settings = settings::fixed(&selection::Effort::FULL);
        let settings = settings.iter().filter(|of| of.transform == Some(transform));
        let mut cheapest = None;
        for setting in settings {
            for mode in [Mode::Transform, Mode::Coefficients(Coder::Fast)] {
                let config = Config {
                    mode,
                    ..setting.config(config(transform, setting.m))?
                };
                let method = Timed::new(transform.name(), config);
                let (bytes, errors) = self.measure(&method, Finder::Peaks)?;
                let is_cheaper = cheapest.is_none_or(|(least, _)| bytes < least);
                if errors.emd_pixel_us <= f64::from(EQUAL_US) && is_cheaper {
                    cheapest = Some((bytes, method));
                }
            }
        }
        Ok(cheapest.map(|(_, method)| method))
    }

    /// Returns the frame's bytes and the errors of what it decodes to.
    ///
    /// # Errors
    /// Fails if the frame does not decode to every event.
    fn measure(&self, method: &Timed, finder: Finder) -> Result<(usize, Errors)> {
        let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
        let mut encoder = storage.encoder(method.config)?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        let frame = encode(&mut encoder, self.events, &mut out);
        let decoded = decode(frame, finder, &mut |_| Ok(()))?;
        ensure!(
            decoded.len() == self.events.len(),
            "{}: a frame without all events; please report this",
            method.name
        );
        Ok((frame.len(), self.original.errors(&decoded)))
    }

    fn speed(&self, target: &str, method: &Timed, effort: &Effort) -> Result<Speed> {
        let finder = if target == HOST_EQUAL {
            Finder::Peaks
        } else {
            Finder::Exact
        };
        let (bytes, errors) = self.measure(method, finder)?;
        let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
        let mut encoder = storage.encoder(method.config)?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        let mut times_us = Vec::new();
        let started = Instant::now();
        while started.elapsed().as_secs_f64() < effort.speed_s {
            let batch = Instant::now();
            for _ in 0..BATCH {
                black_box(encode(&mut encoder, black_box(self.events), &mut out));
            }
            times_us.push(batch.elapsed().as_secs_f64() * 1e6 / BATCH as f64);
        }
        times_us.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = (times_us.len().saturating_sub(1)) as f64 * share;
            times_us.get(place.round() as usize).copied().unwrap_or(0.0)
        };
        let is_transform = method.config.mode.is_transform();
        let m = if is_transform { method.config.m } else { 0 };
        let events = self.events.len() as f64;
        Ok(Speed {
            target: target.to_owned(),
            method: method.name.to_owned(),
            m,
            events_per_window: events,
            us_per_window: at(0.5),
            spread_us: (at(0.75) - at(0.25)) / 2.0,
            kev_per_s: events * 1e3 / at(0.5),
            relative: 0.0,
            instructions_per_event: None,
            bits_per_event: Some(8.0 * bytes as f64 / events),
            emd_pixel_us: Some(errors.emd_pixel_us),
        })
    }
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
            // The table is of transforms and what stands for them with exact times, not of the order of arrival.
            "quick" | "fast mean" => continue,
            "dct few" => ("dct-few", saved.m),
            "dtft few" => ("dtft-few", saved.m),
            "dwt few" => ("dwt-few", saved.m),
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
            bits_per_event: None,
            emd_pixel_us: None,
        });
    }
    Ok(relative(rows))
}

fn relative(mut rows: Vec<Speed>) -> Vec<Speed> {
    let slowest = rows
        .iter()
        .filter(|row| row.m > 0 && !row.method.ends_with("-few"))
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
                [
                    "dct",
                    "dct-few",
                    "dtft",
                    "dtft-few",
                    "dwt",
                    "dwt-few",
                    "hybrid-dense",
                    "hybrid-fast"
                ]
            );
            assert!(
                rows.iter()
                    .all(|row| row.kev_per_s > 1.0 && row.kev_per_s.is_finite())
            );
            assert!(rows.iter().any(|row| row.relative == 1.0));
        }
        // At equal errors, no row is beyond them.
        let equal: Vec<_> = rows.iter().filter(|row| row.target == HOST_EQUAL).collect();
        let found = |method: &str| equal.iter().any(|row| row.method == method);
        assert!(found("best") && found("best-fast") && found("dwt"));
        let is_within =
            |row: &&&Speed| row.emd_pixel_us.is_some_and(|us| us <= f64::from(EQUAL_US));
        assert!(HOST_EQUAL.contains(&format!("{EQUAL_US} us")));
        assert_eq!(equal.iter().filter(is_within).count(), equal.len());
    }
}
