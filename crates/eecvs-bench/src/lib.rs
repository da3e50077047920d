//! Run time against error: every kernel of the accumulate stage, and its peers.
//!
//! ```text
//! cut -> window -> kernel | peers -> error against the oracle -> time -> row -> front
//!               -> image in QEMU -> sums against the host's -> instructions -> row
//! ```
//!
//! Each answer is compared with the f64 reference before anything is timed. What is timed is the
//! accumulate stage alone, over all pixels of a window, from impulses that lie grouped in memory to
//! coefficients, on one thread.

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
pub mod scaling;
pub mod skips;
pub mod source;
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

/// M of the measurements.
pub const M: [u8; 4] = [8, 16, 24, 64];

/// What takes part in the measurement.
pub trait Contender {
    /// Its name in rows and charts.
    fn name(&self) -> &'static str;

    /// The core's kernel that it is, whose documented error is checked.
    fn kernel(&self) -> Option<Kernel> {
        None
    }

    /// The stage over every pixel: what is timed.
    fn pass(&mut self, windows: &Windows);

    /// Of the sums of all chunks, as an image makes it; `None` for what is in no image.
    fn checksum(&mut self, parts: &[Windows]) -> Option<u32> {
        let _ = parts;
        None
    }

    /// c_0 to c_(K-1) of a pixel as [`Self::pass`] computes them; `None` where it has no such
    /// thing.
    fn coefficients(&mut self, pixel: Pixel<'_>) -> Option<Vec<Complex64>>;
}

/// Where windows come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Recordings of real sensors.
    Recordings,
    /// Emulated scenes.
    Emulator,
}

impl Origin {
    /// As the saved counts have it.
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
    /// Events of a window at the most.
    pub events: usize,
    /// Repetitions, of which median and quartiles are reported; 1 or more.
    pub repetitions: usize,
    /// Time of a repetition at the least: as many passes as it takes.
    pub least: Duration,
}

impl Effort {
    /// For figures.
    pub const FULL: Self = Self {
        events: usize::MAX,
        repetitions: 15,
        least: Duration::from_millis(3),
    };
    /// For a look whether everything works.
    pub const QUICK: Self = Self {
        events: 1024,
        repetitions: 3,
        least: Duration::ZERO,
    };
}

/// One point; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// `table`, `recurrence`, `precise`, `micromath`, `libm`, `haar`, or a peer's name.
    #[serde(deserialize_with = "name")]
    pub kernel: Name,
    /// `dct`, `dtft`, `dwt`; `none` for a voxel grid.
    #[serde(deserialize_with = "name")]
    pub transform: Name,
    /// M; the number of bins of a voxel grid.
    pub m: u8,
    /// `host`, `cortex-m4` or `cortex-m7`.
    #[serde(deserialize_with = "name")]
    pub target: Name,
    /// Name of the cut, or `all`; with `-crowded` after it, the pixels of
    /// [`window::CROWDED_EVENTS`] and more events alone.
    pub window: Cow<'static, str>,
    /// Median.
    pub cost: f64,
    /// `ns/event` or `instructions/event`.
    #[serde(deserialize_with = "name")]
    pub unit: Name,
    /// First quartile.
    pub cost_low: f64,
    /// Third quartile.
    pub cost_high: f64,
    /// Largest |c_k - c_ref| of any pixel and k; `None` where there are no coefficients.
    pub max_error: Option<f64>,
    /// Root of the mean square over all k >= 1 of all pixels.
    pub rms_error: Option<f64>,
    /// No other row of this transform, M, target and window is as good in both and better in one.
    pub pareto: bool,
    /// Whether only crowded pixels were measured.
    #[serde(skip)]
    pub is_crowded: bool,
    /// Events measured.
    #[serde(skip)]
    pub events: usize,
    /// Coefficients compared.
    #[serde(skip)]
    pub coefficients: usize,
}

/// The oracle's name of a transform.
#[must_use]
pub const fn oracle_of(transform: Transform) -> oracle::Transform {
    match transform {
        Transform::Dct => oracle::Transform::Dct,
        Transform::Dtft => oracle::Transform::Dtft,
        Transform::Dwt => oracle::Transform::Dwt,
    }
}

/// What is measured of the cuts.
///
/// # Errors
/// As [`Windows::new`].
pub fn windows(cuts: &[Cut], effort: Effort) -> Result<Vec<Windows>> {
    let of = |cut| Windows::new(cut, effort.events);
    cuts.iter().map(of).collect()
}

/// Measures everything on `windows`; `progress` is called after each of [`steps`]. Rows of the host
/// by transform, M and window, then a voxel grid's, then those of `counts`.
///
/// # Errors
/// A kernel that is not within its documented error; the message names it.
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

/// Times that [`measure`] calls `progress` for so many windows.
#[must_use]
pub fn steps(windows: usize) -> usize {
    Transform::ALL.len() * M.len() * windows
}

/// What some contenders are measured at.
struct Point<'w> {
    /// `None` for what knows no coefficients.
    transform: Option<Transform>,
    m: u8,
    windows: &'w Windows,
    effort: Effort,
}

/// Error of a contender.
#[derive(Debug, Clone, Copy)]
struct Error {
    max: f64,
    rms: f64,
    coefficients: usize,
}

impl<'w> Point<'w> {
    /// For errors alone.
    fn of(transform: Transform, m: u8, windows: &'w Windows) -> Self {
        Self {
            transform: Some(transform),
            m,
            windows,
            effort: Effort::QUICK,
        }
    }

    /// Of each contender; `None` where it knows no coefficients.
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

    /// The oracle's coefficients by pixel.
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

    /// Compares every pixel with the oracle.
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

    /// First quartile, median and third quartile of each in ns per event. They take turns, so that
    /// what else the machine does hits all of them.
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

/// First quartile, median, third quartile: order statistics, no interpolation.
fn quartiles(values: &mut [f64]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    [last / 4, last / 2, last - last / 4].map(|i| values.get(i).copied().unwrap_or(f64::NAN))
}

/// One row over all windows for each kernel, transform, M and target, and one over their crowded
/// pixels: costs weighted by events, the largest error, and the mean square over all coefficients.
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
