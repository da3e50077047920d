//! The saved counts as a document's table, between two marks in it.

use std::fmt::Write as _;
use std::path::Path;

use eecvs_bench::marks::Marks;
use eecvs_bench::mcu::{Count, Part};

const MARKS: Marks = Marks {
    name: "kernels",
    command: "cargo xtask kernels --save",
};
const TRANSFORMS: [(&str, &str); 3] = [("dct", "DCT"), ("dtft", "DTFT"), ("dwt", "Haar DWT")];
const TARGETS: [(&str, &str); 2] = [("cortex-m4", "Cortex-M4"), ("cortex-m7", "Cortex-M7")];
const M: [u8; 2] = [8, 16];

/// Writes the table of `counts` into the document at `path`.
pub fn write(counts: &[Count], path: &Path) -> anyhow::Result<()> {
    MARKS.write(path, &table(counts))
}

/// Over the cuts of recordings, by events.
fn table(counts: &[Count]) -> String {
    let mut text = String::from("| all pixels (crowded ones) |");
    for (_, target) in TARGETS {
        for m in M {
            let _ = write!(text, " {target}, M = {m} |");
        }
    }
    text += "\n|---|---|---|---|---|\n";
    for (transform, name) in TRANSFORMS {
        let mut kernels: Vec<&str> = Vec::new();
        for count in counts.iter().filter(|count| count.transform == transform) {
            if !kernels.contains(&count.kernel.as_str()) {
                kernels.push(&count.kernel);
            }
        }
        for kernel in kernels {
            let _ = write!(text, "| {name}, {kernel} |");
            for (target, _) in TARGETS {
                for m in M {
                    let of = |part: fn(&Count) -> Part| {
                        let mut sum = Part::default();
                        for count in counts {
                            let (t, origin, _, k, tr, count_m) = count.key();
                            if (t, origin, k, tr, count_m)
                                == (target, "recordings", kernel, transform, m)
                            {
                                let part = part(count);
                                sum.events += part.events;
                                sum.instructions += part.instructions;
                            }
                        }
                        thousands(sum.per_event())
                    };
                    let _ = write!(
                        text,
                        " {} ({}) |",
                        of(|count| count.all),
                        of(|count| count.crowded)
                    );
                }
            }
            text.push('\n');
        }
    }
    text
}

/// A whole number, in groups of three digits.
fn thousands(value: f64) -> String {
    let whole = value.round() as u64;
    match whole {
        0..1000 => whole.to_string(),
        _ => format!("{},{:03}", whole / 1000, whole % 1000),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_has_the_saved_counts() {
        let counts = crate::kernels::file::read(&crate::tree::path(crate::kernels::SAVED)).unwrap();
        let document = crate::tree::path(crate::kernels::DOCUMENT);
        let document = std::fs::read_to_string(document).unwrap();
        assert!(
            MARKS.content(&document).unwrap() == table(&counts),
            "the table does not match firmware/kernels.json"
        );
    }

    #[test]
    fn digits_are_grouped() {
        for (value, text) in [
            (0.4, "0"),
            (999.4, "999"),
            (1000.0, "1,000"),
            (35_365.3, "35,365"),
        ] {
            assert_eq!(thousands(value), text);
        }
    }
}
