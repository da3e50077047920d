//! Measures run time against error for every kernel of the accumulate stage and for its peers.
//!
//! ```text
//! cut -> window -> kernel | peers -> error against the oracle -> time -> row -> front
//!               -> image in QEMU -> sums against the host's -> instructions -> row
//! ```
//!
//! All coefficients are compared with the f64 reference before anything is timed. Only the accumulate stage is
//! timed: on one thread, over all pixels of a window, from impulses grouped by pixel in memory to coefficients.
//!
//! The crate also holds the other studies: [`errors`] (error curves of the kernels), [`scaling`] (time over the
//! sensor's area and the number of events), [`skips`] (what skipping saves), [`stream`] (a long one, encoded and
//! decoded at once) and [`seek`] (single milliseconds of a long file); and what all records of measurements share: [`record_file`] (JSON files of rows) and [`marks`]
//! (tables in documents).

pub mod cut;
pub mod errors;
pub mod front;
pub mod kernel;
pub mod kernel_image;
pub mod machine;
pub mod marks;
pub mod mcu;
pub mod moderate;
pub mod peers;
pub mod record_file;
pub mod repeated;
pub mod scaling;
pub mod seek;
pub mod skips;
pub mod source;
pub mod stream;
pub mod table;
pub mod window;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use eecvs_nostd::{Kernel, Transform};
use eecvs_oracle::transform as oracle;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::record_file::{Name, name};
use cut::Cut;
use window::{Pixel, Windows};

/// The values of M that are measured.
pub const M: [u8; 4] = [8, 16, 24, 64];

/// A kernel or a peer that takes part in the measurement.
pub trait Contender {
    /// Returns the name used in rows and charts.
    fn name(&self) -> &'static str;

    /// Returns the core's kernel, whose documented error bound is checked; `None` for a peer, which has no bound.
    fn kernel(&self) -> Option<Kernel> {
        None
    }

    /// Runs the accumulate stage over every pixel of `windows`. This is what is timed.
    fn pass(&mut self, windows: &Windows);

    /// Returns the checksum of the sums of all chunks, computed as the firmware image computes it, or `None` for a
    /// contender that is not in the image. The image receives the pixels as the two [`Windows::parts`].
    fn checksum(&mut self, parts: &[Windows]) -> Option<u32> {
        let _ = parts;
        None
    }

    /// Returns c_0 to c_(K-1) of a pixel as [`Self::pass`] computes them, or `None` for a contender that computes
    /// no coefficients.
    fn coefficients(&mut self, pixel: Pixel<'_>) -> Option<Vec<Complex64>>;
}

/// The kind of source from which windows are cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Recordings of real sensors.
    Recordings,
    /// Emulated scenes.
    Emulator,
}

impl Origin {
    /// Returns the name used in the saved counts.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Recordings => "recordings",
            Self::Emulator => "emulator",
        }
    }
}

/// How much is measured.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Maximum number of events taken from a cut.
    pub events: usize,
    /// Number of repetitions, 1 or more. Their median and quartiles are reported.
    pub repetitions: usize,
    /// Minimum time of a repetition: the pass is repeated to fill it, up to 10,000 times.
    pub least: Duration,
}

impl Effort {
    /// The effort for published figures.
    pub const FULL: Self = Self {
        events: usize::MAX,
        repetitions: 15,
        least: Duration::from_millis(3),
    };
    /// The effort that suffices to see whether everything works.
    pub const QUICK: Self = Self {
        events: 1024,
        repetitions: 3,
        least: Duration::ZERO,
    };
}

/// Cost and error of one contender at one M on one window; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// `table`, `recurrence`, `precise`, `micromath`, `libm`, `haar`, or a peer's name.
    #[serde(deserialize_with = "name")]
    pub kernel: Name,
    /// `dct`, `dtft` or `dwt`; `none` for a voxel grid.
    #[serde(deserialize_with = "name")]
    pub transform: Name,
    /// M, or the number of bins of a voxel grid.
    pub m: u8,
    /// `host`, `cortex-m4` or `cortex-m7`.
    #[serde(deserialize_with = "name")]
    pub target: Name,
    /// Name of the cut, or `all`. The suffix `-crowded` means that only the pixels with at least
    /// [`window::CROWDED_EVENTS`] events were measured.
    pub window: Cow<'static, str>,
    /// Median cost, in [`Self::unit`].
    pub cost: f64,
    /// `ns/event` or `instructions/event`.
    #[serde(deserialize_with = "name")]
    pub unit: Name,
    /// First quartile of the cost; an instruction count is exact and is given as all three.
    pub cost_low: f64,
    /// Third quartile of the cost.
    pub cost_high: f64,
    /// Largest |c_k - c_ref| over all pixels and all k >= 1; `None` if there are no coefficients.
    pub max_error: Option<f64>,
    /// Root mean square of |c_k - c_ref| over all pixels and all k >= 1.
    pub rms_error: Option<f64>,
    /// Whether the row is on the Pareto front: no other row of the same transform, M, target and window is at least
    /// as good in cost and maximum error and better in one of them.
    pub pareto: bool,
    /// Whether only crowded pixels were measured.
    #[serde(skip)]
    pub is_crowded: bool,
    /// Number of events measured.
    #[serde(skip)]
    pub events: usize,
    /// Number of coefficients compared.
    #[serde(skip)]
    pub coefficients: usize,
}

/// Returns the oracle's value for a transform of the core.
#[must_use]
pub const fn oracle_of(transform: Transform) -> oracle::Transform {
    match transform {
        Transform::Dct => oracle::Transform::Dct,
        Transform::Dtft => oracle::Transform::Dtft,
        Transform::Dwt => oracle::Transform::Dwt,
    }
}

/// Returns the windows of each cut, limited to the events of `effort`.
///
/// # Errors
/// As for [`Windows::new`].
pub fn windows(cuts: &[Cut], effort: Effort) -> Result<Vec<Windows>> {
    let of = |cut| Windows::new(cut, effort.events);
    cuts.iter().map(of).collect()
}

/// Measures all kernels and peers on `windows`, and calls `progress` after each of [`steps`].
///
/// Returns the host's rows, ordered by transform, M and window, then those of the voxel grid, then the
/// microcontrollers' rows made from `counts`.
///
/// # Errors
/// Fails if a kernel exceeds its documented error, which the message names.
pub fn measure(
    windows: &[Windows],
    counts: &[mcu::Count],
    effort: Effort,
    progress: &mut dyn FnMut(),
) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for transform in Transform::ALL {
        for m in M {
            let grid = usize::from(transform.grid_size(m, None));
            for windows in windows {
                let mut contenders = kernel::kernels(transform, grid);
                contenders.extend(peers::peers(transform, grid));
                let point = Point {
                    transform: Some(transform),
                    m,
                    windows,
                    effort,
                };
                rows.extend(point.measure(&mut contenders)?);
                progress();
            }
        }
    }
    for m in M {
        for windows in windows {
            let point = Point {
                transform: None,
                m,
                windows,
                effort,
            };
            rows.extend(point.measure(&mut [peers::voxel(m.into())])?);
        }
    }
    rows.extend(mcu::rows(&rows, windows, counts)?);
    front::mark(&mut rows);
    Ok(rows)
}

/// Returns how many times [`measure`] calls `progress` if it is given `windows` windows.
#[must_use]
pub fn steps(windows: usize) -> usize {
    Transform::ALL.len() * M.len() * windows
}

/// The transform, M and windows at which contenders are measured.
struct Point<'w> {
    /// `None` for contenders without coefficients.
    transform: Option<Transform>,
    m: u8,
    windows: &'w Windows,
    effort: Effort,
}

/// Error of a contender over all pixels and all k >= 1.
#[derive(Debug, Clone, Copy)]
struct Error {
    max: f64,
    rms: f64,
    coefficients: usize,
}

impl<'w> Point<'w> {
    /// Returns a point at which only errors are measured.
    fn of(transform: Transform, m: u8, windows: &'w Windows) -> Self {
        Self {
            transform: Some(transform),
            m,
            windows,
            effort: Effort::QUICK,
        }
    }

    /// Returns the error of each contender, or `None` for one without coefficients.
    fn errors(&self, contenders: &mut [Box<dyn Contender>]) -> Result<Vec<Option<Error>>> {
        let expected = self.expected();
        contenders
            .iter_mut()
            .map(|contender| self.verify(contender.as_mut(), &expected))
            .collect()
    }

    fn measure(&self, contenders: &mut [Box<dyn Contender>]) -> Result<Vec<Row>> {
        let errors = self.errors(contenders)?;
        let costs = self.time(contenders);
        Ok(contenders
            .iter()
            .zip(errors)
            .zip(costs)
            .map(|((contender, error), [cost_low, cost, cost_high])| Row {
                kernel: contender.name(),
                transform: self.transform.map_or("none", Transform::name),
                m: self.m,
                target: "host",
                window: self.windows.name.into(),
                cost,
                unit: "ns/event",
                cost_low,
                cost_high,
                max_error: error.map(|error| error.max),
                rms_error: error.map(|error| error.rms),
                pareto: false,
                is_crowded: false,
                events: self.windows.events,
                coefficients: error.map_or(0, |error| error.coefficients),
            })
            .collect())
    }

    /// Returns the oracle's coefficients of each pixel.
    fn expected(&self) -> Vec<Vec<Complex64>> {
        let Some(transform) = self.transform else {
            return Vec::new();
        };
        let grid = usize::from(transform.grid_size(self.m, None));
        let of = |pixel: Pixel<'_>| {
            let duration_us = pixel.window.duration_us;
            oracle_of(transform).coefficients(pixel.oracles, duration_us, grid)
        };
        self.windows.pixels().map(of).collect()
    }

    /// Compares every pixel with the oracle. A kernel's bound on the error of a coefficient is its documented error
    /// per event times the number of events in the pixel.
    fn verify(
        &self,
        contender: &mut dyn Contender,
        expected: &[Vec<Complex64>],
    ) -> Result<Option<Error>> {
        let bound = contender.kernel().map(|kernel| {
            let log2 = kernel.error_log2();
            log2.map_or(0.0, |log2| f64::from(log2).exp2())
        });
        let (mut max, mut square_sum, mut count) = (0.0_f64, 0.0, 0_usize);
        for (pixel, expected) in self.windows.pixels().zip(expected) {
            let Some(found) = contender.coefficients(pixel) else {
                return Ok(None);
            };
            ensure!(
                found.len() == expected.len(),
                "{}: {} coefficients instead of {}; please report this",
                contender.name(),
                found.len(),
                expected.len()
            );
            for (k, (found, expected)) in found.iter().zip(expected).enumerate().skip(1) {
                let error = (found - expected).norm();
                let most = bound.map(|bound| bound * pixel.impulses.len() as f64);
                ensure!(
                    most.is_none_or(|most| error <= most),
                    "{}, M = {}, window {}: c_{k} is off by {error:e}, more than documented; please \
                     report this",
                    contender.name(),
                    self.m,
                    self.windows.name
                );
                max = max.max(error);
                square_sum += error * error;
                count += 1;
            }
        }
        let rms = (square_sum / count.max(1) as f64).sqrt();
        Ok(self.transform.map(|_| Error {
            max,
            rms,
            coefficients: count,
        }))
    }

    /// Returns the first quartile, median and third quartile of each contender's time, in ns per event. The
    /// contenders take turns, so that any other load on the machine affects all of them.
    fn time(&self, contenders: &mut [Box<dyn Contender>]) -> Vec<[f64; 3]> {
        let events = self.windows.events.max(1) as f64;
        let passes: Vec<u32> = contenders
            .iter_mut()
            .map(|contender| {
                let once = time(contender.as_mut(), self.windows, 1).as_secs_f64();
                let passes = self.effort.least.as_secs_f64() / once.max(1e-9);
                passes.ceil().clamp(1.0, 10_000.0) as u32
            })
            .collect();
        let mut costs = vec![Vec::new(); contenders.len()];
        for _ in 0..self.effort.repetitions {
            for ((contender, passes), costs) in contenders.iter_mut().zip(&passes).zip(&mut costs) {
                let elapsed = time(contender.as_mut(), self.windows, *passes);
                costs.push(elapsed.as_secs_f64() * 1e9 / (f64::from(*passes) * events));
            }
        }
        costs.iter_mut().map(|costs| quartiles(costs)).collect()
    }
}

fn time(contender: &mut dyn Contender, windows: &Windows, passes: u32) -> Duration {
    let started = Instant::now();
    for _ in 0..passes {
        contender.pass(windows);
    }
    started.elapsed()
}

/// Returns the first quartile, the median and the third quartile as order statistics, without interpolation.
fn quartiles(values: &mut [f64]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    [last / 4, last / 2, last - last / 4].map(|i| values.get(i).copied().unwrap_or(f64::NAN))
}

/// Merges the rows of all windows into one for each kernel, transform, M and target, and one for their crowded
/// pixels. Costs are averaged, weighted by events; the errors are the largest error and the root mean square over
/// all coefficients.
#[must_use]
pub fn over_windows(rows: &[Row]) -> Vec<Row> {
    let mut merged: Vec<Row> = Vec::new();
    for row in rows {
        let same = merged.iter_mut().find(|all| {
            (all.kernel, all.transform, all.m, all.target)
                == (row.kernel, row.transform, row.m, row.target)
                && all.is_crowded == row.is_crowded
        });
        match same {
            Some(all) => add(all, row),
            None => merged.push(Row {
                window: if row.is_crowded { "all-crowded" } else { "all" }.into(),
                ..row.clone()
            }),
        }
    }
    front::mark(&mut merged);
    merged
}

fn add(all: &mut Row, row: &Row) {
    let share = row.events as f64 / (all.events + row.events).max(1) as f64;
    let mean = |a: f64, b: f64, share: f64| a + (b - a) * share;
    all.cost = mean(all.cost, row.cost, share);
    all.cost_low = mean(all.cost_low, row.cost_low, share);
    all.cost_high = mean(all.cost_high, row.cost_high, share);
    all.max_error = all.max_error.zip(row.max_error).map(|(a, b)| a.max(b));
    let share = row.coefficients as f64 / (all.coefficients + row.coefficients).max(1) as f64;
    let rms = all.rms_error.zip(row.rms_error);
    all.rms_error = rms.map(|(a, b)| mean(a * a, b * b, share).sqrt());
    all.events += row.events;
    all.coefficients += row.coefficients;
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROW: Row = Row {
        kernel: "table",
        transform: "dct",
        m: 8,
        target: "host",
        window: Cow::Borrowed("a"),
        cost: 10.0,
        unit: "ns/event",
        cost_low: 9.0,
        cost_high: 12.0,
        max_error: Some(1.0),
        rms_error: Some(0.5),
        pareto: false,
        is_crowded: false,
        events: 100,
        coefficients: 10,
    };

    #[test]
    fn quartiles_are_order_statistics() {
        assert_eq!(quartiles(&mut [3.0]), [3.0; 3]);
        assert_eq!(quartiles(&mut [2.0, 1.0]), [1.0, 1.0, 2.0]);
        assert_eq!(quartiles(&mut [5.0, 1.0, 4.0, 2.0, 3.0]), [2.0, 3.0, 4.0]);
        assert!(quartiles(&mut [])[1].is_nan());
    }

    #[test]
    fn windows_are_merged_by_their_events_and_coefficients() {
        let other = Row {
            window: Cow::Borrowed("b"),
            cost: 20.0,
            max_error: Some(3.0),
            rms_error: Some(1.0),
            events: 300,
            coefficients: 30,
            ..ROW
        };
        let [all] = &over_windows(&[ROW, other])[..] else {
            panic!("one row");
        };
        assert_eq!((&*all.window, all.events), ("all", 400));
        assert!((all.cost - 17.5).abs() < 1e-12);
        assert_eq!(all.max_error, Some(3.0));
        let rms = ((0.25 * 10.0 + 30.0) / 40.0_f64).sqrt();
        assert!((all.rms_error.unwrap() - rms).abs() < 1e-12);
        assert!(all.pareto);
    }

    #[test]
    fn json_has_the_documented_keys_alone() {
        let json = serde_json::to_value(ROW).unwrap();
        let keys: Vec<_> = json.as_object().unwrap().keys().collect();
        let mut expected = [
            "kernel",
            "transform",
            "m",
            "target",
            "window",
            "cost",
            "unit",
            "cost_low",
            "cost_high",
            "max_error",
            "rms_error",
            "pareto",
        ];
        expected.sort_unstable();
        assert_eq!(keys, expected);
    }
}
