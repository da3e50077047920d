//! Run time against error of every kernel of the accumulate stage, kept as the rows of a study are.
//!
//! The host's times are taken on windows of emulated scenes; the microcontroller's instructions are
//! those saved with the project.

use anyhow::{Context, Result};
use eecvs_bench::{Effort, Origin, cut, mcu};
use serde::{Deserialize, Serialize};

use super::store::{Row, Store};

/// What the store calls it.
const TASK: &str = "kernels";

/// What rows of [`bench`] are called, in any of their columns.
const NAMES: [&str; 17] = [
    "table",
    "recurrence",
    "precise",
    "micromath",
    "libm",
    "haar",
    "oracle-f64",
    "binning-fft",
    "voxel-bilinear",
    "dct",
    "dtft",
    "dwt",
    "none",
    "host",
    "cortex-m4",
    "ns/event",
    "instructions/event",
];

/// A kernel over all windows; the fields are those of [`eecvs_bench::Row`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KernelRow {
    /// Of the kernel or the peer.
    pub kernel: String,
    /// `none` for a voxel grid.
    pub transform: String,
    /// M; the number of bins of a voxel grid.
    pub m: u8,
    /// `host` or `cortex-m4`.
    pub target: String,
    /// Median.
    pub cost: f64,
    /// `ns/event` or `instructions/event`.
    pub unit: String,
    /// First quartile.
    pub cost_low: f64,
    /// Third quartile.
    pub cost_high: f64,
    /// Largest error of any coefficient; `None` where there are none.
    pub max_error: Option<f64>,
    /// Root of the mean square of the errors.
    pub rms_error: Option<f64>,
    /// Whether no other of its transform, M and target is as good in both and better in one.
    pub pareto: bool,
    /// Measured.
    pub events: usize,
    /// Compared.
    pub coefficients: usize,
}

/// Adds the kernels' rows to a store that has none: times of a clock, to be taken while nothing else runs.
///
/// # Errors
/// As [`measure`]; a store that cannot be written.
pub fn add_to(store: &Store, effort: Effort) -> Result<()> {
    if store.has(TASK) {
        return Ok(());
    }
    let rows = measure(effort)?.into_iter();
    store.add(TASK, rows.map(Row::Kernel))
}

/// Takes the host's times and reads the microcontroller's counts.
///
/// # Errors
/// A kernel that is not within its documented error, or saved counts that cannot be read.
pub fn measure(effort: Effort) -> Result<Vec<KernelRow>> {
    let windows = eecvs_bench::windows(&cut::of_scenes()?, effort)?;
    let mut counts = mcu::saved()?;
    counts.retain(|count| count.origin == Origin::Emulator.name());
    let rows = eecvs_bench::measure(&windows, &counts, effort, &mut || ())?;
    let mut rows = eecvs_bench::over_windows(&rows);
    rows.retain(|row| ["host", "cortex-m4"].contains(&row.target) && !row.is_crowded);
    Ok(rows.iter().map(KernelRow::new).collect())
}

impl KernelRow {
    fn new(row: &eecvs_bench::Row) -> Self {
        Self {
            kernel: row.kernel.to_owned(),
            transform: row.transform.to_owned(),
            m: row.m,
            target: row.target.to_owned(),
            cost: row.cost,
            unit: row.unit.to_owned(),
            cost_low: row.cost_low,
            cost_high: row.cost_high,
            max_error: row.max_error,
            rms_error: row.rms_error,
            pareto: row.pareto,
            events: row.events,
            coefficients: row.coefficients,
        }
    }

    /// As charts take it.
    ///
    /// # Errors
    /// A name that no row of this build has.
    pub fn of_bench(&self) -> Result<eecvs_bench::Row> {
        let known = |name: &str| {
            let found = NAMES.into_iter().find(|known| *known == name);
            found.with_context(|| {
                format!("kernels: {name} is unknown; measure anew, without --keep-rows")
            })
        };
        Ok(eecvs_bench::Row {
            kernel: known(&self.kernel)?,
            transform: known(&self.transform)?,
            m: self.m,
            target: known(&self.target)?,
            window: "all".into(),
            cost: self.cost,
            unit: known(&self.unit)?,
            cost_low: self.cost_low,
            cost_high: self.cost_high,
            max_error: self.max_error,
            rms_error: self.rms_error,
            pareto: self.pareto,
            is_crowded: false,
            events: self.events,
            coefficients: self.coefficients,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_kept_whole() {
        let rows = measure(Effort::QUICK).unwrap();
        for target in ["host", "cortex-m4"] {
            assert!(rows.iter().any(|row| row.target == target), "{target}");
        }
        for row in &rows {
            let text = serde_json::to_string(row).unwrap();
            let read: KernelRow = serde_json::from_str(&text).unwrap();
            assert_eq!(read, *row);
            assert_eq!(KernelRow::new(&read.of_bench().unwrap()), *row);
        }
        let mut other = rows[0].clone();
        other.kernel = "other".to_owned();
        assert!(other.of_bench().unwrap_err().to_string().contains("other"));
    }
}
