//! `--save`: tables written into documents, between the lines that name the command.

use crate::support::Folder;

/// A page with the two lines of a table, and text around them.
fn page(name: &str, command: &str, table: &str) -> String {
    format!(
        "# Page\n\n<!-- {name}: {command} writes what is below -->\n{table}<!-- {name} end -->\nEnd\n"
    )
}

const KERNELS: [&str; 2] = ["host kernels", "eecvs bench --save docs/results.md"];
const SKIPS: [&str; 2] = ["skips", "eecvs bench --skips --save METHODOLOGY.md"];
const RATES: [&str; 2] = [
    "rate and distortion",
    "eecvs bench --rate --save METHODOLOGY.md",
];
const DEMO: [&str; 2] = ["demo", "eecvs demo --save README.md"];

#[test]
fn a_document_without_its_place_is_refused_before_anything_runs() {
    let folder = Folder::new();
    folder.write("none.md", "# Page\n");
    for ([name, command], line) in [
        (KERNELS, "bench"),
        (SKIPS, "bench --skips"),
        (RATES, "bench --rate"),
        (DEMO, "demo"),
    ] {
        folder
            .eecvs(&format!("{line} --save missing.md"))
            .fails(&["missing.md", "read"]);
        folder
            .eecvs(&format!("{line} --save none.md"))
            .fails(&["none.md", command]);
        let half = page(name, command, "").replace(" end -->", " over -->");
        folder.write("half.md", half);
        let said = folder.eecvs(&format!("{line} --save half.md"));
        said.fails(&["half.md", &format!("<!-- {name} over -->")]);
    }
    let entries = std::fs::read_dir(folder.path(".")).unwrap();
    assert_eq!(entries.count(), 2, "nothing else was written");
}

#[test]
fn only_recordings_and_whole_runs_are_saved() {
    let folder = Folder::new();
    for ([name, command], line) in [(KERNELS, "bench -o charts"), (SKIPS, "bench --skips")] {
        let text = page(name, command, "old\n");
        folder.write("page.md", &text);
        folder
            .eecvs(&format!("{line} --save page.md"))
            .fails(&["page.md", "--recordings"]);
        assert_eq!(folder.bytes("page.md"), text.as_bytes());
        folder
            .eecvs(&format!("{line} --record records"))
            .fails(&["records", "--recordings"]);
    }
    for line in [
        "bench --quick",
        "bench --skips --quick",
        "bench --rate --quick",
        "bench --scaling",
        "bench --errors",
        "demo --scene outdoor-dark",
        "demo --seed 2",
    ] {
        for place in ["--save page.md", "--record records"] {
            let outcome = folder.eecvs(&format!("{line} {place}"));
            assert_eq!(outcome.status, Some(2), "{outcome}");
        }
    }
}

#[test]
#[cfg(not(feature = "zstd"))]
fn rates_are_saved_with_every_peer_alone() {
    let folder = Folder::new();
    let [name, command] = RATES;
    let text = page(name, command, "old\n");
    folder.write("page.md", &text);
    folder
        .eecvs("bench --rate --save page.md")
        .fails(&["page.md", "--features zstd"]);
    assert_eq!(folder.bytes("page.md"), text.as_bytes());
}
