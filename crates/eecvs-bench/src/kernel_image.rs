//! Builds the image that counts the instructions of every kernel (`firmware/src/bin/kernels.rs`), gives it a cut,
//! runs it in QEMU and compares its sums with this host's.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use mcu_link::image;
use mcu_link::qemu::{self, Machine};
use rayon::prelude::*;
use serde::Deserialize;

use super::Origin;
use super::mcu::{Check, Count, Part, TARGETS, checks};
use super::window::Windows;

/// The file that the image reads, in the folder in which QEMU runs.
const FILE: &str = "cut.words";
/// Maximum time that an image may take for a cut.
const PATIENCE: Duration = Duration::from_secs(300);

/// The built images, one for each of [`TARGETS`].
#[derive(Debug)]
pub struct Images(Vec<(&'static str, Machine, PathBuf)>);

/// The line that the image prints for a kernel, a transform and an M.
#[derive(Debug, Deserialize)]
struct Line {
    kernel: String,
    transform: String,
    m: u8,
    /// Number of instructions for the pixels that are not crowded.
    few: u64,
    /// Number of instructions for the crowded pixels.
    crowded: u64,
    check: u32,
}

impl Images {
    /// Builds the image of every target.
    ///
    /// # Errors
    /// Fails if QEMU or the sources of the firmware are not found, or if a build fails.
    pub fn build() -> Result<Self> {
        qemu::find()?;
        let build = |(target, machine)| Ok((target, machine, image::build(machine, "kernels")?));
        TARGETS
            .into_iter()
            .map(build)
            .collect::<Result<_>>()
            .map(Self)
    }

    /// Counts the instructions of every kernel on every target and cut, running several images at a time.
    ///
    /// # Errors
    /// Fails if an image fails, or if its sums differ from this host's.
    pub fn count(&self, windows: &[Windows], origin: Origin) -> Result<Vec<Count>> {
        let checks = checks(windows);
        let runs: Vec<_> = self
            .0
            .iter()
            .flat_map(|image| windows.iter().map(move |windows| (image, windows)))
            .collect();
        let counts = runs
            .into_par_iter()
            .map(|((target, machine, image), windows)| {
                run(*machine, image, windows)
                    .and_then(|lines| counts(&lines, (target, origin), windows, &checks))
                    .with_context(|| format!("{target}, window {}", windows.name))
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(counts.into_iter().flatten().collect())
    }
}

fn run(machine: Machine, image: &Path, windows: &Windows) -> Result<Vec<Line>> {
    let folder = tempfile::tempdir().context("cannot create a folder for the cut")?;
    let words: Vec<u8> = words(windows)?
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .collect();
    fs::write(folder.path().join(FILE), words).context(FILE)?;
    let text = qemu::run(machine, image, folder.path(), PATIENCE)?;
    text.lines()
        .map(|line| serde_json::from_str(line).with_context(|| format!("the image said: {line}")))
        .collect()
}

/// Returns the content of the file as 32-bit words, which are written in little-endian order.
///
/// The file has two parts, first the pixels with few events, then the crowded ones. A part is the number of
/// windows, then for each window its T in us and its number of pixels, and for each of these pixels its number of
/// events and a word `offset << 1 | is_on` for each event.
fn words(windows: &Windows) -> Result<Vec<u32>> {
    let mut words = Vec::new();
    for part in windows.parts() {
        words.push(u32::try_from(part.windows.len())?);
        for window in &part.windows {
            words.extend([window.duration_us, u32::try_from(window.pixels().count())?]);
            for pixel in window.pixels() {
                words.push(u32::try_from(pixel.impulses.len())?);
                for impulse in pixel.impulses {
                    ensure!(
                        impulse.offset_us < 1 << 31,
                        "a window is longer than 2^31 us"
                    );
                    words.push((impulse.offset_us << 1) | u32::from(impulse.is_on));
                }
            }
        }
    }
    Ok(words)
}

fn counts(
    lines: &[Line],
    (target, origin): (&str, Origin),
    windows: &Windows,
    checks: &[Check],
) -> Result<Vec<Count>> {
    let [few, crowded] = windows.parts().map(|part| {
        let (events, pixels) = (part.events as u64, part.pixels().count() as u64);
        (events, pixels)
    });
    let mut counts = Vec::new();
    for check in checks.iter().filter(|check| check.cut == windows.name) {
        let name = format!("{} {} M={}", check.kernel, check.transform, check.m);
        let line = lines.iter().find(|line| {
            (line.kernel.as_str(), line.transform.as_str(), line.m)
                == (check.kernel, check.transform, check.m)
        });
        let Some(line) = line else {
            bail!("{name}: missing from the image's output");
        };
        let count = Count {
            target: target.to_owned(),
            origin: origin.name().to_owned(),
            cut: windows.name.to_owned(),
            kernel: line.kernel.clone(),
            transform: line.transform.clone(),
            m: line.m,
            all: Part {
                events: few.0 + crowded.0,
                pixels: few.1 + crowded.1,
                instructions: line.few + line.crowded,
            },
            crowded: Part {
                events: crowded.0,
                pixels: crowded.1,
                instructions: if crowded.0 > 0 { line.crowded } else { 0 },
            },
            check: line.check,
        };
        ensure!(
            check.is_of(&count),
            "{name}: the image's sums differ from this host's"
        );
        counts.push(count);
    }
    Ok(counts)
}
