//! Counts as a file: one a line.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use anyhow::{Context, ensure};
use eecvs_bench::mcu::{Count, parse};

/// The counts of a file.
pub fn read(path: &Path) -> anyhow::Result<Vec<Count>> {
    let name = path.display();
    let text = fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
    let counts = parse(&text).with_context(|| format!("{name}"))?;
    ensure!(!counts.is_empty(), "{name}: no counts: did the image run?");
    Ok(counts)
}

/// As [`read`] takes them.
pub fn write(counts: &[Count], path: &Path) -> anyhow::Result<()> {
    let mut text = String::new();
    for count in counts {
        text += &serde_json::to_string(count)?;
        text.push('\n');
    }
    Ok(event_files::output::write(path, text)?)
}

/// Where the cuts of some counts come from.
pub fn origins(counts: &[Count]) -> BTreeSet<String> {
    counts.iter().map(|count| count.origin.clone()).collect()
}

/// Takes over the counts of origins that `counts` has none of, and names these.
pub fn keep_uncounted(counts: &mut Vec<Count>, saved: Vec<Count>) -> Vec<String> {
    let here = origins(counts);
    let kept = origins(&saved).difference(&here).cloned().collect();
    counts.extend(
        saved
            .into_iter()
            .filter(|count| !here.contains(&count.origin)),
    );
    kept
}
