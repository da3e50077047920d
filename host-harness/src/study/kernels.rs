//! Run time against error of every kernel of the accumulate stage, stored as rows of a study.
//!
//! The host's times are measured on windows of emulated scenes; the microcontroller's instruction counts are those
//! saved with the project.

use anyhow::{Context, Result};
use eecvs_bench::{Effort, Origin, cut, mcu};
use serde::{Deserialize, Serialize};

use super::store::{Row, Store};

/// Name of the task in the store.
const TASK: &str = "kernels";

/// All names in the columns of an [`eecvs_bench::Row`].
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

/// Cost and error of a kernel over all windows; the fields are those of [`eecvs_bench::Row`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KernelRow {
    /// Name of the kernel or the peer.
    pub kernel: String,
    /// Name of the transform; `none` for a voxel grid.
    pub transform: String,
    /// M, or the number of bins of a voxel grid.
    pub m: u8,
    /// `host` or `cortex-m4`.
    pub target: String,
    /// Median cost.
    pub cost: f64,
    /// `ns/event` or `instructions/event`.
    pub unit: String,
    /// First quartile of the cost.
    pub cost_low: f64,
    /// Third quartile of the cost.
    pub cost_high: f64,
    /// Largest error of any coefficient; `None` if no coefficients were compared.
    pub max_error: Option<f64>,
    /// Root mean square of the errors.
    pub rms_error: Option<f64>,
    /// Whether no other row of the same transform, M and target is at least as good in cost and error and better in
    /// one.
    pub pareto: bool,
    /// Number of events measured.
    pub events: usize,
    /// Number of coefficients compared.
    pub coefficients: usize,
}

/// Adds the kernels' rows to a store that has none. It measures times, so nothing else should run meanwhile.
///
/// # Errors
/// Fails as [`measure`] does, or if the store cannot be written.
pub fn add_to(store: &Store, effort: Effort) -> Result<()> {
    if store.has(TASK) {
        return Ok(());
    }
    let rows = measure(effort)?.into_iter();
    store.add(TASK, rows.map(Row::Kernel))
}

/// Measures the host's times and reads the microcontroller's saved counts.
///
/// # Errors
/// Fails if a kernel exceeds its documented error or the saved counts cannot be read.
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

    /// Converts the row to the type that charts take.
    ///
    /// # Errors
    /// Fails if a name is none of this build's.
    pub fn of_bench(&self) -> Result<eecvs_bench::Row> {
        let known = |name: &str| {
            let found = NAMES.into_iter().find(|known| *known == name);
            found.with_context(|| {
                format!("kernels: {name} is unknown; measure again, without --keep-rows")
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
