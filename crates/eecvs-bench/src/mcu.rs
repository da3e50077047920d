//! Instructions of every kernel on microcontrollers: counts, saved or made anew, and their rows.
//!
//! [`super::kernel_image`] counts them in QEMU; `cargo xtask kernels` saves them with the project.

use anyhow::{Context, Result};
use eecvs_nostd::Transform;
use mcu_link::qemu::Machine;
use serde::{Deserialize, Serialize};

use super::kernel::kernels;
use super::window::Windows;
use super::{Origin, Point, Row};

const SAVED: &str = include_str!("../../../firmware/kernels.json");

/// Names of the cores, as rows have them, and the machines that stand for them.
pub const TARGETS: [(&str, Machine); 2] = [
    ("cortex-m4", Machine::NetduinoPlus2),
    ("cortex-m7", Machine::Mps2An500),
];

/// What some pixels took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// Events in them.
    pub events: u64,
    /// How many there are.
    pub pixels: u64,
    /// Instructions for all of them.
    pub instructions: u64,
}

/// A kernel at an M on a cut and a core: a line of JSON, whose keys the fields are.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// Of [`TARGETS`].
    pub target: String,
    /// `recordings` or `emulator`.
    pub origin: String,
    /// Name of the cut.
    pub cut: String,
    /// Name of the kernel.
    pub kernel: String,
    /// Lower-case name.
    pub transform: String,
    /// M.
    pub m: u8,
    /// Every pixel.
    pub all: Part,
    /// Those of [`super::window::CROWDED_EVENTS`] and more.
    pub crowded: Part,
    /// Checksum of all sums: those of a host.
    pub check: u32,
}

impl Part {
    /// Instructions per event; 0 without any.
    #[must_use]
    pub fn per_event(&self) -> f64 {
        self.instructions as f64 / self.events.max(1) as f64
    }
}

impl Count {
    /// What makes two counts comparable.
    #[must_use]
    pub fn key(&self) -> (&str, &str, &str, &str, &str, u8) {
        let Self {
            target,
            origin,
            cut,
            kernel,
            transform,
            m,
            ..
        } = self;
        (target, origin, cut, kernel, transform, *m)
    }
}

/// Counts of a text of one a line.
///
/// # Errors
/// A line that is none.
pub fn parse(text: &str) -> Result<Vec<Count>> {
    text.lines()
        .enumerate()
        .map(|(i, line)| {
            serde_json::from_str(line).with_context(|| format!("line {}: no counts", i + 1))
        })
        .collect()
}

/// The counts saved with the project.
///
/// # Errors
/// A file that this program does not understand.
pub fn saved() -> Result<Vec<Count>> {
    parse(SAVED).context("firmware/kernels.json: save it anew")
}

/// The saved counts of some windows, and how many were left out because their sums are not those
/// of this program.
///
/// # Errors
/// As [`saved`].
pub fn saved_of(windows: &[Windows], origin: Origin) -> Result<(Vec<Count>, usize)> {
    let checks = checks(windows);
    let counts = saved()?.into_iter().filter(|count| {
        count.origin == origin.name() && windows.iter().any(|windows| windows.name == count.cut)
    });
    let (kept, other): (Vec<_>, Vec<_>) =
        counts.partition(|count| checks.iter().any(|check| check.is_of(count)));
    Ok((kept, other.len()))
}

/// The checksum that a count of these sums has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Check {
    /// Name of the cut.
    pub cut: &'static str,
    /// Name of the kernel.
    pub kernel: &'static str,
    /// Lower-case name.
    pub transform: &'static str,
    /// M.
    pub m: u8,
    /// Of the sums on this host.
    pub check: u32,
}

impl Check {
    /// Whether the sums of a count are these.
    #[must_use]
    pub fn is_of(&self, count: &Count) -> bool {
        (self.cut, self.kernel, self.transform, self.m, self.check)
            == (
                count.cut.as_str(),
                count.kernel.as_str(),
                count.transform.as_str(),
                count.m,
                count.check,
            )
    }
}

/// The checksums of every kernel's sums, by cut, transform and M.
#[must_use]
pub fn checks(windows: &[Windows]) -> Vec<Check> {
    let mut checks = Vec::new();
    for windows in windows {
        let parts = windows.parts();
        for transform in Transform::ALL {
            for m in super::M {
                for mut kernel in kernels(transform, transform.grid_size(m, None).into()) {
                    let Some(check) = kernel.checksum(&parts) else {
                        continue;
                    };
                    checks.push(Check {
                        cut: windows.name,
                        kernel: kernel.name(),
                        transform: transform.name(),
                        m,
                        check,
                    });
                }
            }
        }
    }
    checks
}

/// The rows of counts. Their error is that of the same bits on the host: all pixels have it in
/// `host`, the crowded ones are compared with the oracle here.
///
/// # Errors
/// A kernel that is not within its documented error.
pub(super) fn rows(host: &[Row], windows: &[Windows], counts: &[Count]) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for windows in windows {
        let [_, crowded] = windows.parts();
        for transform in Transform::ALL {
            for m in super::M {
                let mut kernels = kernels(transform, transform.grid_size(m, None).into());
                let errors = Point::of(transform, m, &crowded).errors(&mut kernels)?;
                for (kernel, error) in kernels.iter().zip(errors) {
                    let name = (kernel.name(), transform.name(), m);
                    let same = host.iter().find(|row| {
                        (row.kernel, row.transform, row.m) == name && row.window == windows.name
                    });
                    let Some(same) = same else {
                        continue;
                    };
                    for (target, _) in TARGETS {
                        let count = counts.iter().find(|count| {
                            (count.kernel.as_str(), count.transform.as_str(), count.m) == name
                                && (count.target.as_str(), count.cut.as_str())
                                    == (target, windows.name)
                        });
                        let Some(count) = count else {
                            continue;
                        };
                        let row = |part: Part, row: &Row| Row {
                            target,
                            cost: part.per_event(),
                            unit: "instructions/event",
                            cost_low: part.per_event(),
                            cost_high: part.per_event(),
                            events: part.events as usize,
                            ..row.clone()
                        };
                        rows.push(row(count.all, same));
                        if count.crowded.events > 0 {
                            let same = Row {
                                window: format!("{}-crowded", windows.name).into(),
                                is_crowded: true,
                                max_error: error.map(|error| error.max),
                                rms_error: error.map(|error| error.rms),
                                coefficients: error.map_or(0, |error| error.coefficients),
                                ..same.clone()
                            };
                            rows.push(row(count.crowded, &same));
                        }
                    }
                }
            }
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kernel_is_saved_for_every_target_and_m() {
        let counts = saved().unwrap();
        for (target, _) in TARGETS {
            for transform in Transform::ALL {
                for m in super::super::M {
                    for kernel in kernels(transform, transform.grid_size(m, None).into()) {
                        let cuts = counts.iter().filter(|count| {
                            (count.target.as_str(), count.kernel.as_str(), count.m)
                                == (target, kernel.name(), m)
                                && count.transform == transform.name()
                                && count.all.instructions >= count.all.events
                                && count.crowded.instructions <= count.all.instructions
                        });
                        let name = kernel.name();
                        assert_eq!(cuts.count(), 6, "{target} {name} {m}");
                    }
                }
            }
        }
    }
}
