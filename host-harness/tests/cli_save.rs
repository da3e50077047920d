//! `--save`: tables written into documents, between the lines that name the command.

mod cli_support;

use cli_support::Folder;
use host_harness::report::demo::MARKS as DEMO_MARKS;

/// A page with the two lines of a table, and text around them.
fn page(name: &str, command: &str, table: &str) -> String {
    format!(
        "# Page\n\n<!-- {name}: {command} writes what is below -->\n{table}<!-- {name} end -->\nEnd\n"
    )
}

const KERNELS: [&str; 2] = ["host kernels", "eecvs bench --save README.md"];
const SKIPS: [&str; 2] = ["skips", "eecvs bench --skips --save METHODOLOGY.md"];
const RATES: [&str; 2] = [
    "rate and distortion",
    "eecvs bench --rate --save METHODOLOGY.md",
];
const DEMO: [&str; 2] = ["demo", "eecvs demo --save README.md"];

#[test]
fn the_demo_writes_its_table_and_nothing_else() {
    let folder = Folder::new();
    let [name, command] = DEMO;
    folder.write("page.md", page(name, command, "old\n"));
    let said = folder.eecvs("demo --save page.md").ok().stdout;
    let text = String::from_utf8(folder.bytes("page.md")).unwrap();
    let rows: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
    assert_eq!(rows.len(), 9, "{text}");
    let table = rows.concat().replace("||", "|\n|") + "\n";
    assert_eq!(text, page(name, command, &table));
    // The README's are these, but for the rate, which is the machine's.
    let readme = concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md");
    let readme = std::fs::read_to_string(readme).unwrap();
    let of_readme = DEMO_MARKS.content(&readme).unwrap();
    let without_rate = |line: &str| {
        let mut cells: Vec<_> = line.split('|').map(str::to_owned).collect();
        cells.remove(4);
        cells
    };
    assert!(
        of_readme
            .lines()
            .map(without_rate)
            .eq(rows.iter().map(|row| without_rate(row))),
        "the README's table is another: run {command}\n{table}"
    );
    // The figures are those of the terminal, of which the page has fewer digits.
    for (row, name) in
        rows[2..]
            .iter()
            .zip(["fast", "dense", "dense50us", "auto", "dct", "dtft", "dwt"])
    {
        let mut lines = said.lines().map(str::trim_start);
        let line =
            lines.find(|line| line.starts_with(&format!("{name}  ")) && !line.contains("encode"));
        let of_terminal: Vec<&str> = line.expect("a row").split_whitespace().collect();
        let of_page: Vec<&str> = row.split('|').map(str::trim).collect();
        assert_eq!(of_page[2], of_terminal[1], "windows");
        assert_eq!(of_page[3], of_terminal[2], "bits per event");
        let number = |text: &str| text.parse::<f64>().expect("a number");
        for (page, terminal, digit) in [(4, 3, 0.1), (5, 6, 0.001), (6, 7, 1.0)] {
            let difference = number(of_page[page]) - number(of_terminal[terminal]);
            assert!(difference.abs() <= 0.6 * digit, "{row} {of_terminal:?}");
        }
    }
}

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
        let outcome = folder.eecvs(&format!("{line} --save page.md"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
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
