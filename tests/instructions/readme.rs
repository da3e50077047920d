//! The saved counts as the README's tables, between two marks in it.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::Context;

use crate::counts::{Counts, Run};

const BEGIN: &str = "<!-- instructions: firmware/instructions.sh --save writes what is below -->\n";
const END: &str = "<!-- instructions end -->\n";
/// Cuts, with what stands above their columns.
const CUTS: [&str; 3] = ["davis346", "sparse", "dense"];
/// Stages, what they are called here, and a throw-away prototype's figures on the davis346 cut.
const STAGES: [(&[&str], &str, &str); 5] = [
    (
        &["ingest"],
        "ingest: words to the window",
        "33, assembly 18",
    ),
    (&["group"], "group by pixel", "28"),
    (&["accumulate"], "accumulate", "32, error not bounded"),
    (&["prune", "quantise", "pack"], "prune, quantise, pack", ""),
    (&["frame"], "header and CRC-32", ""),
];
const TRANSFORMS: [(&str, &str); 3] = [("dct", "DCT"), ("dtft", "DTFT"), ("dwt", "Haar DWT")];

/// Writes the tables of `counts` into the README at `path`.
pub fn write(counts: &Counts, path: &Path) -> anyhow::Result<()> {
    let name = path.display();
    let text = fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
    let text = with_tables(&text, counts).with_context(|| format!("{name}: the marks are gone"))?;
    fs::write(path, text).with_context(|| format!("{name}: cannot be written"))
}

fn with_tables(text: &str, counts: &Counts) -> Option<String> {
    let (before, rest) = text.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}{}{END}{after}", tables(counts)?))
}

fn tables(counts: &Counts) -> Option<String> {
    let run = |cut: &str, transform: &str, m: u8| {
        counts.runs().find(|run| {
            (run.origin.as_str(), run.cut.as_str()) == ("recordings", cut)
                && (run.transform.as_str(), run.m) == (transform, m)
        })
    };
    let mut text = String::from("| DCT, M = 8, instructions per event |");
    for cut in CUTS {
        let run = run(cut, "dct", 8)?;
        let _ = write!(
            text,
            " {cut}, {:.2} events a pixel |",
            run.events_per_pixel()
        );
    }
    text += " prototype, davis346 |\n|---|---|---|---|---|\n";
    for (stages, name, prototype) in STAGES {
        let _ = write!(text, "| {name} |");
        for cut in CUTS {
            let run = run(cut, "dct", 8)?;
            let sum: f64 = stages.iter().map(|stage| run.stage_per_event(stage)).sum();
            let _ = write!(text, " {sum:.0} |");
        }
        let _ = writeln!(text, " {prototype} |");
    }
    text += "| whole, not stopped between stages |";
    for cut in CUTS {
        let _ = write!(text, " {:.0} |", run(cut, "dct", 8)?.per_event());
    }
    text += " about 100 |\n\n| whole, instructions per event (per active pixel) | davis346 | sparse | dense |\n|---|---|---|---|\n";
    for (transform, name) in TRANSFORMS {
        for m in [8, 16] {
            let _ = write!(text, "| {name}, M = {m} |");
            for cut in CUTS {
                let run: &Run = run(cut, transform, m)?;
                let _ = write!(text, " {:.0} ({:.0}) |", run.per_event(), run.per_pixel());
            }
            text.push('\n');
        }
    }
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_readme_has_the_saved_counts() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let counts = Counts::read(&root.join("firmware/instructions.json")).unwrap();
        let readme = fs::read_to_string(root.join("README.md")).unwrap();
        let expected = with_tables(&readme, &counts).expect("the marks and every run");
        assert!(
            readme == expected,
            "the README's tables are not those of firmware/instructions.json"
        );
    }
}
