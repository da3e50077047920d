//! Counts of instructions: shown, saved, compared.

use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::fs;
use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};

/// How much a case may grow. The compiler cuts a crate into units by where it lies: with another path the
/// same reader has been seen to take 7 % more.
pub const TOLERANCE_PERCENT: u64 = 10;

/// One case.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// Events that it worked on.
    pub events: usize,
    /// Instructions of the program's own code: these are compared.
    pub instructions: u64,
    /// Those of the C library, which copies memory with what the processor offers: shown alone.
    #[serde(skip)]
    pub elsewhere: u64,
}

impl Count {
    fn per_event(&self) -> f64 {
        self.instructions as f64 / self.events.max(1) as f64
    }

    fn elsewhere_per_event(&self) -> f64 {
        self.elsewhere as f64 / self.events.max(1) as f64
    }
}

/// Every case, and what its counts depend on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// The compiler.
    pub rustc: String,
    /// What it made code for.
    pub target: String,
    /// By name.
    pub cases: BTreeMap<String, Count>,
}

impl Counts {
    /// As [`Self::write`] writes it.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let name = path.display();
        let text = fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        serde_json::from_str(text)
            .with_context(|| format!("{name}: not instruction counts: save them again"))
    }

    /// JSON.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        Ok(event_files::output::write(path, text)?)
    }

    /// Why these counts and `saved` cannot be compared, where they cannot.
    pub fn difference(&self, saved: &Self) -> Option<String> {
        let differs = |what, here: &str, saved: &str| {
            (here != saved).then(|| format!("counts of {what} {saved} are saved, this is {here}"))
        };
        differs("the compiler", &self.rustc, &saved.rustc)
            .or_else(|| differs("the target", &self.target, &saved.target))
    }

    /// What has grown since `saved`, and what is in one of them alone.
    pub fn failures(&self, saved: &Self) -> Vec<String> {
        let mut failures = Vec::new();
        for (name, count) in &self.cases {
            match saved.cases.get(name) {
                None => failures.push(format!("{name}: not in the saved counts: save them")),
                Some(old) if old.events != count.events => failures.push(format!(
                    "{name}: {} events, saved {}: save them",
                    count.events, old.events
                )),
                Some(old)
                    if count.instructions * 100 > old.instructions * (100 + TOLERANCE_PERCENT) =>
                {
                    failures.push(format!(
                        "{name}: {:.1} instructions per event, saved {:.1}",
                        count.per_event(),
                        old.per_event()
                    ));
                }
                Some(_) => {}
            }
        }
        for name in saved.cases.keys() {
            if !self.cases.contains_key(name) {
                failures.push(format!(
                    "{name}: saved, but not counted any more: save them"
                ));
            }
        }
        failures
    }
}

impl Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}, {}", self.rustc, self.target)?;
        writeln!(
            f,
            "{:16} {:>8} {:>19} {:>15}",
            "case", "events", "instructions/event", "in the C library"
        )?;
        for (name, count) in &self.cases {
            writeln!(
                f,
                "{name:16} {:>8} {:>19.1} {:>15.1}",
                count.events,
                count.per_event(),
                count.elsewhere_per_event()
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(instructions: u64) -> Counts {
        let count = Count {
            events: 100,
            instructions,
            elsewhere: 7,
        };
        Counts {
            rustc: "rustc 1.93.0".into(),
            target: "x86_64 linux".into(),
            cases: [("encode dct 8".to_owned(), count)].into(),
        }
    }

    #[test]
    fn growth_beyond_the_tolerance_fails_and_is_named() {
        let saved = counts(10_000);
        for less in [1, 10_000, 11_000] {
            assert!(counts(less).failures(&saved).is_empty(), "{less}");
        }
        let [failure] = &counts(11_001).failures(&saved)[..] else {
            panic!("one failure");
        };
        assert!(failure.contains("encode dct 8: 110.0"), "{failure}");
    }

    #[test]
    fn cases_come_and_go_with_a_save_alone() {
        let mut fewer = counts(1);
        fewer.cases.clear();
        assert_eq!(fewer.failures(&counts(1)).len(), 1);
        assert_eq!(counts(1).failures(&fewer).len(), 1);
    }

    #[test]
    fn another_compiler_does_not_compare() {
        let mut other = counts(1);
        assert_eq!(other.difference(&counts(2)), None);
        other.rustc = "rustc 1.94.0".into();
        let difference = other.difference(&counts(2)).unwrap();
        assert!(difference.contains("1.93.0"), "{difference}");
    }
}
