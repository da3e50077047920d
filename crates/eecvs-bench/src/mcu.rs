//! Instruction counts of every kernel on microcontrollers, saved or newly made, and the rows made from them.
//!
//! [`super::kernel_image`] counts the instructions in QEMU; `cargo xtask kernels` saves the counts with the project.

use anyhow::{Context, Result};
use eecvs_nostd::Transform;
use mcu_link::qemu::Machine;
use serde::{Deserialize, Serialize};

use super::kernel::kernels;
use super::window::Windows;
use super::{Origin, Point, Row};

const SAVED: &str = include_str!("../../../firmware/kernels.json");

/// Names of the processor cores as in [`Row::target`], each with the QEMU machine that emulates it.
pub const TARGETS: [(&str, Machine); 2] = [
    ("cortex-m4", Machine::NetduinoPlus2),
    ("cortex-m7", Machine::Mps2An500),
];

/// Number of instructions for a group of pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// Number of events in the pixels.
    pub events: u64,
    /// Number of pixels.
    pub pixels: u64,
    /// Number of instructions for all of the pixels.
    pub instructions: u64,
}

/// Instructions of a kernel at one M, on one cut and one processor core. Saved as a line of JSON with these keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// Name of the processor core, one of [`TARGETS`].
    pub target: String,
    /// `recordings` or `emulator`.
    pub origin: String,
    /// Name of the cut.
    pub cut: String,
    /// Name of the kernel.
    pub kernel: String,
    /// Lower-case name of the transform.
    pub transform: String,
    /// M.
    pub m: u8,
    /// All pixels.
    pub all: Part,
    /// The pixels with at least [`super::window::CROWDED_EVENTS`] events.
    pub crowded: Part,
    /// Checksum of all sums, which must equal the host's.
    pub check: u32,
}

impl Part {
    /// Returns the number of instructions per event; no events are counted as one.
    #[must_use]
    pub fn per_event(&self) -> f64 {
        self.instructions as f64 / self.events.max(1) as f64
    }
}

impl Count {
    /// Returns the target, origin, cut, kernel, transform and M. Two counts are comparable if these are equal.
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

/// Parses a text with one count per line.
///
/// # Errors
/// Fails at a line that is not a count; the message names its number.
pub fn parse(text: &str) -> Result<Vec<Count>> {
    // Some editors put a byte-order mark in front.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    text.lines()
        .enumerate()
        .map(|(i, line)| {
            serde_json::from_str(line)
                .with_context(|| format!("line {}: not instruction counts", i + 1))
        })
        .collect()
}

/// Returns the counts saved with the project.
///
/// # Errors
/// Fails if the saved file is not in the format of this version.
pub fn saved() -> Result<Vec<Count>> {
    parse(SAVED).context("firmware/kernels.json: save it again")
}

/// Returns the saved counts of `windows`, and the number of counts left out because their checksums differ from
/// those of this program.
///
/// # Errors
/// As for [`saved`].
pub fn saved_of(windows: &[Windows], origin: Origin) -> Result<(Vec<Count>, usize)> {
    let checks = checks(windows);
    let counts = saved()?.into_iter().filter(|count| {
        count.origin == origin.name() && windows.iter().any(|windows| windows.name == count.cut)
    });
    let (kept, other): (Vec<_>, Vec<_>) =
        counts.partition(|count| checks.iter().any(|check| check.is_of(count)));
    Ok((kept, other.len()))
}

/// The checksum that the count of a kernel at one M on one cut must have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Check {
    /// Name of the cut.
    pub cut: &'static str,
    /// Name of the kernel.
    pub kernel: &'static str,
    /// Lower-case name of the transform.
    pub transform: &'static str,
    /// M.
    pub m: u8,
    /// Checksum of the sums computed on this host.
    pub check: u32,
}

impl Check {
    /// Returns whether `count` is of the same cut, kernel, transform and M and has this checksum.
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

/// Computes the checksum of every kernel's sums on this host, for every cut, transform and M.
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

/// Makes rows from counts. As the sums are the host's bit by bit, so are the errors: those over all pixels are taken
/// from `host`, and those over the crowded pixels are measured here on the host.
///
/// # Errors
/// Fails if a kernel exceeds its documented error.
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
