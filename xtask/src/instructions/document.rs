//! The saved counts as a document's tables, between two marks in it.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::Context;
use eecvs_bench::marks::Marks;

use super::counts::{Counts, Run};

const MARKS: Marks = Marks {
    name: "instructions",
    command: "cargo xtask instructions --save",
};
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
const TRANSFORMS: [(&str, &str); 6] = [
    ("dct", "DCT"),
    ("dct few", "DCT, few as times"),
    ("dtft", "DTFT"),
    ("dtft few", "DTFT, few as times"),
    ("dwt", "Haar DWT"),
    ("dwt few", "Haar DWT, few as times"),
];

const CODERS: [(&str, &str); 4] = [
    ("fast", "events, fast coder"),
    ("fast mean", "events, fast coder, a mean error of 128 us"),
    ("quick", "events, quick coder"),
    ("dense", "events, dense coder"),
];

/// Writes the tables of `counts` into the document at `path`.
pub fn write(counts: &Counts, path: &Path) -> anyhow::Result<()> {
    let tables = tables(counts).context("a run of the tables is not among the counts")?;
    MARKS.write(path, &tables)
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
    let transforms = TRANSFORMS
        .iter()
        .flat_map(|(transform, name)| [8, 16].map(|m| (*transform, m, format!("{name}, M = {m}"))));
    let coders = CODERS.map(|(coder, name)| (coder, 0, name.to_owned()));
    for (way, m, name) in transforms.chain(coders) {
        let _ = write!(text, "| {name} |");
        for cut in CUTS {
            let run: &Run = run(cut, way, m)?;
            let _ = write!(text, " {:.0} ({:.0}) |", run.per_event(), run.per_pixel());
        }
        text.push('\n');
    }
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_has_the_saved_counts() {
        let counts = Counts::read(&crate::tree::path(crate::instructions::SAVED)).unwrap();
        let document = crate::tree::path(crate::instructions::DOCUMENT);
        let document = std::fs::read_to_string(document).unwrap();
        assert!(
            MARKS.content(&document).unwrap() == tables(&counts).expect("every run"),
            "the tables do not match firmware/instructions.json"
        );
    }
}
