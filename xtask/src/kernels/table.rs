//! Counts as a table for the eye.

use std::fmt::Write as _;

use eecvs_bench::M;
use eecvs_bench::mcu::Count;

/// Instructions per event of all pixels, and of the crowded ones: a kernel a line, M across.
pub fn table(counts: &[Count]) -> String {
    let mut text = format!(
        "{:10} {:10} {:8} {:4} {:10}",
        "target", "origin", "cut", "", "kernel"
    );
    for m in M {
        let _ = write!(text, " {:>17}", format!("M = {m}, crowded"));
    }
    text.push('\n');
    for first in counts.iter().filter(|count| count.m == M[0]) {
        let (target, origin, cut, kernel, transform, _) = first.key();
        let _ = write!(
            text,
            "{target:10} {origin:10} {cut:8} {transform:4} {kernel:10}"
        );
        for m in M {
            let key = (target, origin, cut, kernel, transform, m);
            let count = counts.iter().find(|count| count.key() == key);
            let cell = count.map_or_else(String::new, |count| {
                let crowded = match count.crowded.events {
                    0 => "-".to_owned(),
                    _ => format!("{:.1}", count.crowded.per_event()),
                };
                format!("{:.1} {crowded:>8}", count.all.per_event())
            });
            let _ = write!(text, " {cell:>17}");
        }
        text.push('\n');
    }
    text
}
