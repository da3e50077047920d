//! Counts against saved ones.

use std::fmt::{self, Display};

use eecvs_bench::mcu::Count;
use eecvs_nostd::Transform;
use eecvs_nostd::kernel::Kernel;

use super::file::origins;

/// Growth of a count that fails, in percent, of the kernels that the encoder takes.
const TOLERANCE_PERCENT: u64 = 3;
/// The same of those to compare with: the compiler gives their loops other registers from one folder
/// of the project to another, by up to 16 %.
const OTHERS_PERCENT: u64 = 25;

fn tolerance_percent(kernel: &str) -> u64 {
    let mut in_use = Transform::ALL.into_iter().map(Kernel::in_use);
    if in_use.any(|in_use| in_use.name() == kernel) {
        TOLERANCE_PERCENT
    } else {
        OTHERS_PERCENT
    }
}

/// What has changed.
#[derive(Debug, Default)]
pub struct Comparison {
    counts: usize,
    notes: Vec<String>,
    failures: Vec<String>,
}

impl Comparison {
    /// Whether anything has grown, or nothing could be compared.
    pub fn has_failed(&self) -> bool {
        !self.failures.is_empty() || self.counts == 0
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
            "{} kernel counts compared, {} failures (a count may grow by {TOLERANCE_PERCENT} %, \
             that of a kernel not in use by {OTHERS_PERCENT} %)",
            self.counts,
            self.failures.len()
        )
    }
}

/// What has changed since `saved`.
pub fn compare(counts: &[Count], saved: &[Count]) -> Comparison {
    let mut comparison = Comparison::default();
    for count in counts {
        let (target, origin, cut, kernel, transform, m) = count.key();
        let name = format!("{target} {origin} {cut} {kernel} {transform} M={m}");
        let Some(old) = saved.iter().find(|old| old.key() == count.key()) else {
            comparison
                .failures
                .push(format!("{name}: not in the saved counts: save them"));
            continue;
        };
        comparison.counts += 1;
        for (part, new, old) in [
            ("all pixels", count.all, old.all),
            ("crowded pixels", count.crowded, old.crowded),
        ] {
            if (new.events, new.pixels) != (old.events, old.pixels) {
                comparison.failures.push(format!(
                    "{name}: another cut: {part}: {} events in {} pixels, saved {} in {}",
                    new.events, new.pixels, old.events, old.pixels
                ));
            } else if new.instructions.saturating_sub(old.instructions) * 100
                > old.instructions * tolerance_percent(kernel)
            {
                comparison.failures.push(format!(
                    "{name}: {part}: {:.1} instructions per event, saved {:.1}",
                    new.per_event(),
                    old.per_event()
                ));
            }
        }
    }
    let here = origins(counts);
    for origin in origins(saved) {
        if !here.contains(&origin) {
            comparison.notes.push(format!(
                "no cuts from {origin} here: their saved counts are not compared"
            ));
        }
    }
    comparison
}

#[cfg(test)]
mod tests {
    use eecvs_bench::mcu::Part;

    use super::super::file::keep_uncounted;
    use super::*;

    fn count(origin: &str, all: u64, crowded: u64) -> Count {
        let part = |instructions| Part {
            events: 100,
            pixels: 5,
            instructions,
        };
        Count {
            target: "cortex-m4".into(),
            origin: origin.into(),
            cut: "dense".into(),
            kernel: "table".into(),
            transform: "dct".into(),
            m: 8,
            all: part(all),
            crowded: part(crowded),
            check: 0,
        }
    }

    #[test]
    fn growth_beyond_the_tolerance_fails_and_is_named() {
        let saved = [count("emulator", 10_000, 1000)];
        for (all, crowded) in [(9000, 900), (10_000, 1000), (10_300, 1030)] {
            assert!(!compare(&[count("emulator", all, crowded)], &saved).has_failed());
        }
        for (all, crowded, name) in [(10_301, 1000, "all pixels: 103.0"), (1, 1031, "crowded")] {
            let comparison = compare(&[count("emulator", all, crowded)], &saved);
            assert!(comparison.has_failed());
            let text = comparison.to_string();
            assert!(
                text.contains("cortex-m4 emulator dense table dct M=8"),
                "{text}"
            );
            assert!(text.contains(name), "{text}");
        }
    }

    #[test]
    fn kernels_not_in_use_may_grow_more() {
        let recurrence = |all| Count {
            kernel: "recurrence".into(),
            ..count("emulator", all, 1000)
        };
        assert!(!compare(&[recurrence(12_500)], &[recurrence(10_000)]).has_failed());
        assert!(compare(&[recurrence(12_501)], &[recurrence(10_000)]).has_failed());
    }

    #[test]
    fn other_cuts_and_unknown_kernels_fail() {
        let saved = [count("emulator", 10_000, 1000)];
        let mut other = count("emulator", 10_000, 1000);
        other.crowded.pixels += 1;
        assert!(compare(&[other], &saved).has_failed());
        let mut other = count("emulator", 10_000, 1000);
        other.kernel = "new".into();
        assert!(compare(&[other], &saved).has_failed());
    }

    #[test]
    fn origins_are_kept_apart() {
        let saved = vec![count("emulator", 100, 1), count("recordings", 1, 1)];
        let mut here = vec![count("emulator", 100, 1)];
        let comparison = compare(&here, &saved);
        assert!(!comparison.has_failed());
        assert!(comparison.to_string().contains("no cuts from recordings"));
        assert_eq!(keep_uncounted(&mut here, saved), ["recordings"]);
        assert_eq!(here.len(), 2);
        assert!(compare(&[], &here).has_failed(), "nothing is compared");
    }
}
