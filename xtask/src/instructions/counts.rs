//! Counts of instructions: read, shown, saved, compared.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display, Write as _};
use std::fs;
use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};

/// Growth of a stage that fails, in percent.
const TOLERANCE_PERCENT: u64 = 3;
/// Growth in instructions per event that is never taken for one.
const NOISE_PER_EVENT: u64 = 1;

/// What the image prints for a cut, a transform and an M: one line of JSON.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    /// `recordings` or `emulator`.
    pub origin: String,
    pub cut: String,
    pub transform: String,
    pub m: u8,
    events: u64,
    pixels: u64,
    windows: u64,
    frames: u64,
    pub bytes: u64,
    /// Of the frames' CRCs: the frames are those of a host.
    pub check: u32,
    /// Instructions from the first word to the last byte, nothing measured in between.
    whole: u64,
    /// Instructions by stage, measured in another run.
    stages: BTreeMap<String, u64>,
}

impl Run {
    /// What makes two runs comparable.
    fn key(&self) -> (&str, &str, &str, u8) {
        (&self.origin, &self.cut, &self.transform, self.m)
    }

    /// Instructions per event, from the first word to the last byte.
    pub fn per_event(&self) -> f64 {
        self.whole as f64 / self.events as f64
    }

    /// Instructions per active pixel, from the first word to the last byte.
    pub fn per_pixel(&self) -> f64 {
        self.whole as f64 / self.pixels as f64
    }

    /// Instructions of a stage per event.
    pub fn stage_per_event(&self, stage: &str) -> f64 {
        self.stages.get(stage).copied().unwrap_or(0) as f64 / self.events as f64
    }

    /// Events per active pixel.
    pub fn events_per_pixel(&self) -> f64 {
        self.events as f64 / self.pixels as f64
    }

    /// The whole and the stages, by name.
    fn figures(&self) -> impl Iterator<Item = (&str, u64)> {
        let stages = self.stages.iter().map(|(name, n)| (name.as_str(), *n));
        std::iter::once(("whole", self.whole)).chain(stages)
    }
}

/// Every run of an image.
#[derive(Debug)]
pub struct Counts(Vec<Run>);

impl Counts {
    /// A file of one run a line.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let name = path.display();
        let text = fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let mut runs = Vec::new();
        for (i, line) in text.lines().enumerate() {
            runs.push(
                serde_json::from_str(line)
                    .with_context(|| format!("{name}: line {}: not instruction counts", i + 1))?,
            );
        }
        anyhow::ensure!(!runs.is_empty(), "{name}: no counts: did the image run?");
        Ok(Self(runs))
    }

    /// As [`Self::read`] takes it.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let mut text = String::new();
        for run in &self.0 {
            text += &serde_json::to_string(run)?;
            text.push('\n');
        }
        Ok(event_files::output::write(path, text)?)
    }

    /// The runs.
    pub fn runs(&self) -> impl Iterator<Item = &Run> {
        self.0.iter()
    }

    fn origins(&self) -> BTreeSet<String> {
        self.0.iter().map(|run| run.origin.clone()).collect()
    }

    /// Takes over the runs of origins that `self` has none of, and names these.
    pub fn keep_unmeasured(&mut self, saved: Self) -> Vec<String> {
        let here = self.origins();
        let kept = saved.origins().difference(&here).cloned().collect();
        self.0.extend(
            saved
                .0
                .into_iter()
                .filter(|run| !here.contains(&run.origin)),
        );
        kept
    }

    /// Instructions per event and stage, one run a line.
    pub fn table(&self) -> String {
        let mut text = String::new();
        let stages = [
            "ingest",
            "group",
            "accumulate",
            "prune",
            "quantise",
            "pack",
            "frame",
        ];
        let _ = write!(
            text,
            "{:10} {:8} {:4} {:>2} {:>6} {:>6}",
            "origin", "cut", "", "M", "events", "pixels"
        );
        for stage in stages {
            let _ = write!(text, " {stage:>10}");
        }
        let _ = writeln!(text, " {:>7} {:>7} {:>7}", "sum", "whole", "per px");
        for run in &self.0 {
            let _ = write!(
                text,
                "{:10} {:8} {:4} {:>2} {:>6} {:>6}",
                run.origin, run.cut, run.transform, run.m, run.events, run.pixels
            );
            for stage in stages {
                let _ = write!(text, " {:>10.1}", run.stage_per_event(stage));
            }
            let _ = writeln!(
                text,
                " {:>7.1} {:>7.1} {:>7.1}",
                run.stages.values().sum::<u64>() as f64 / run.events as f64,
                run.per_event(),
                run.per_pixel()
            );
        }
        text
    }

    /// Instructions per event of the whole, with assembly and in plain Rust, one run a line.
    pub fn beside(&self, plain: &Self) -> anyhow::Result<String> {
        let mut text = format!(
            "{:10} {:8} {:5} {:>2} {:>8} {:>10}\n",
            "origin", "cut", "", "M", "assembly", "plain Rust"
        );
        for run in &self.0 {
            let plain = plain.0.iter().find(|plain| plain.key() == run.key());
            let plain = plain.with_context(|| {
                format!("{:?}: missing from the counts in plain Rust", run.key())
            })?;
            anyhow::ensure!(
                (run.check, run.bytes) == (plain.check, plain.bytes),
                "{:?}: the frames differ",
                run.key()
            );
            let _ = writeln!(
                text,
                "{:10} {:8} {:5} {:>2} {:>8.1} {:>10.1}",
                run.origin,
                run.cut,
                run.transform,
                run.m,
                run.per_event(),
                plain.per_event()
            );
        }
        Ok(text)
    }

    /// What has changed since `saved`.
    pub fn compare(&self, saved: &Self) -> Comparison {
        let mut comparison = Comparison::default();
        for run in &self.0 {
            let name = format!("{} {} {} M={}", run.origin, run.cut, run.transform, run.m);
            let Some(old) = saved.0.iter().find(|old| old.key() == run.key()) else {
                comparison
                    .failures
                    .push(format!("{name}: not in the saved counts: save them"));
                continue;
            };
            if (old.events, old.windows) != (run.events, run.windows) {
                comparison.failures.push(format!(
                    "{name}: another cut: {} events in {} windows, saved {} in {}",
                    run.events, run.windows, old.events, old.windows
                ));
                continue;
            }
            comparison.runs += 1;
            for (stage, n) in run.figures() {
                let before = old.figures().find(|(other, _)| *other == stage);
                let before = before.map_or(0, |(_, n)| n);
                let grown = n.saturating_sub(before);
                if grown * 100 > before * TOLERANCE_PERCENT && grown > NOISE_PER_EVENT * run.events
                {
                    comparison.failures.push(format!(
                        "{name}: {stage}: {:.1} instructions per event, saved {:.1}",
                        n as f64 / run.events as f64,
                        before as f64 / run.events as f64
                    ));
                }
            }
        }
        let here = self.origins();
        for origin in saved.origins() {
            if !here.contains(&origin) {
                comparison.notes.push(format!(
                    "no cuts from {origin} here: their saved counts are not compared"
                ));
            }
        }
        comparison
    }
}

/// Counts against saved ones.
#[derive(Debug, Default)]
pub struct Comparison {
    runs: usize,
    notes: Vec<String>,
    failures: Vec<String>,
}

impl Comparison {
    /// Whether anything has grown, or nothing could be compared.
    pub fn has_failed(&self) -> bool {
        !self.failures.is_empty() || self.runs == 0
    }
}

impl Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for note in &self.notes {
            writeln!(f, "{note}")?;
        }
        for failure in &self.failures {
            writeln!(f, "FAILED {failure}")?;
        }
        writeln!(
            f,
            "{} runs compared, {} failures (a stage may grow by {TOLERANCE_PERCENT} % or \
             {NOISE_PER_EVENT} instruction per event)",
            self.runs,
            self.failures.len()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(origin: &str, pack: u64) -> Run {
        Run {
            origin: origin.into(),
            cut: "dense".into(),
            transform: "dct".into(),
            m: 8,
            events: 100,
            pixels: 50,
            windows: 1,
            frames: 1,
            bytes: 500,
            check: 0,
            whole: 20_000,
            stages: [("pack".to_string(), pack)].into(),
        }
    }

    #[test]
    fn growth_beyond_the_tolerance_fails_and_is_named() {
        let saved = Counts(vec![run("emulator", 10_000)]);
        let compare = |pack| Counts(vec![run("emulator", pack)]).compare(&saved);
        for pack in [9_000, 10_000, 10_300] {
            assert!(!compare(pack).has_failed(), "{pack}");
        }
        let grown = compare(10_301);
        assert!(grown.has_failed());
        let text = grown.to_string();
        assert!(
            text.contains("emulator dense dct M=8: pack: 103.0"),
            "{text}"
        );
    }

    #[test]
    fn a_small_stage_may_grow_by_an_instruction_per_event() {
        let saved = Counts(vec![run("emulator", 50)]);
        let compare = |pack| Counts(vec![run("emulator", pack)]).compare(&saved);
        assert!(!compare(150).has_failed());
        assert!(compare(151).has_failed());
    }

    #[test]
    fn origins_are_kept_apart() {
        let saved = Counts(vec![run("emulator", 100), run("recordings", 1)]);
        let mut here = Counts(vec![run("emulator", 100)]);
        let comparison = here.compare(&saved);
        assert!(!comparison.has_failed());
        assert!(comparison.to_string().contains("no cuts from recordings"));
        assert_eq!(here.keep_unmeasured(saved), ["recordings"]);
        assert_eq!(here.origins().len(), 2);
        let other = Counts(vec![run("recordings", 1)]);
        assert!(
            other
                .compare(&Counts(vec![run("emulator", 1)]))
                .has_failed()
        );
    }
}
