//! The documents: their commands run, the files that they name exist, and the README stays short.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, DirEntry};
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn text(name: &str) -> String {
    let text = fs::read_to_string(root().join(name));
    text.unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Lines of the README, at the most.
const README_LINES_MAX: usize = 160;

#[test]
fn the_readme_is_short() {
    let lines = text("README.md").lines().count();
    assert!(lines <= README_LINES_MAX, "{lines}");
}

/// The lines of a document that are commands: indented, and of one of these programs.
fn commands(document: &str) -> Vec<String> {
    let lines = text(document);
    let lines = lines.lines().filter_map(|line| line.strip_prefix("    "));
    let lines = lines.map(str::trim);
    lines
        .filter(|line| {
            ["cargo ", "./test.sh"]
                .iter()
                .any(|begin| line.starts_with(begin))
        })
        .map(str::to_owned)
        .collect()
}

/// Every command for contributors is run: here, or by `test.sh`, whose stages have it.
#[test]
fn commands_for_contributors_run() {
    let script = text("test.sh");
    // What the vectors would become goes elsewhere.
    let golden = tempfile::tempdir().expect("a folder");
    let vectors = vectors(&root().join("tests/golden"));
    for (name, vector) in &vectors {
        fs::write(golden.path().join(name), vector).expect("a file");
    }
    let mut run = 0;
    let all = [commands("CONTRIBUTING.md"), commands("ARCHITECTURE.md")].concat();
    assert!(all.len() > 10, "{all:?}");
    for line in &all {
        if script.lines().any(|of_script| of_script.contains(line)) {
            continue;
        }
        let mut words = line.split_whitespace();
        let program = words.next().expect("a command");
        let arguments: Vec<&str> = words.collect();
        if program == "./test.sh" {
            for stage in arguments {
                let function = format!("{stage}() {{");
                assert!(
                    script.contains(&function),
                    "{line}: test.sh has no stage {stage}"
                );
            }
            continue;
        }
        let mut command = Command::new(env!("CARGO"));
        command.current_dir(root()).args(&arguments);
        command.env("EECVS_GOLDEN", golden.path());
        // Of this package: build scripts that watch them would run again, and all that depends on them.
        for (name, _) in std::env::vars_os() {
            let of_package = [
                "CARGO_PKG_",
                "CARGO_MANIFEST_",
                "CARGO_BIN_",
                "CARGO_CRATE_",
            ];
            let name = name.to_string_lossy();
            if of_package.iter().any(|begin| name.starts_with(begin)) {
                command.env_remove(&*name);
            }
        }
        let output = command.output().expect("cargo runs");
        assert!(
            output.status.success(),
            "{line}: {}\n{}{}",
            output.status,
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr)
        );
        run += 1;
    }
    assert!(run > 5, "{all:?}");
    assert!(vectors.len() > 5 && vectors == self::vectors(golden.path()));
}

/// Golden vectors by their names.
fn vectors(folder: &Path) -> BTreeMap<OsString, Vec<u8>> {
    let files = fs::read_dir(folder).expect("a folder");
    let files = files.map(|file| file.expect("a file"));
    let read = |file: DirEntry| (file.file_name(), fs::read(file.path()).expect("a file"));
    files.map(read).collect()
}

/// What stands between backquotes and looks like a file of the project is one.
#[test]
fn files_that_documents_name_exist() {
    let core = root().join("eecvs-nostd/src");
    let mut checked = 0;
    for document in [
        "README.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
        "docs/results.md",
        "docs/paper.md",
    ] {
        let text = text(document);
        for (i, name) in text.split('`').enumerate() {
            let is_path = name.contains('/') && !name.contains([' ', '<', '*', '~', '{', '\n']);
            if i % 2 == 0 || !is_path || name.starts_with("../shared") || name.starts_with("./") {
                continue;
            }
            // Made when a command runs.
            if name.starts_with("eecvs-demo")
                || name.starts_with("eecvs-report")
                || name.contains("NAME")
            {
                continue;
            }
            let places = [
                root().join(name),
                core.join(name),
                root().join("crates").join(name),
            ];
            assert!(
                places.iter().any(|place| place.exists()) || is_inside(name),
                "{document}: there is no {name}"
            );
            checked += 1;
        }
        for link in text.split("](").skip(1) {
            let link = link.split(')').next().unwrap_or_default();
            if link.starts_with("http") || link.starts_with('#') {
                continue;
            }
            let folder = root().join(document);
            let folder = folder.parent().expect("a folder");
            assert!(folder.join(link).exists(), "{document}: there is no {link}");
            checked += 1;
        }
    }
    assert!(checked > 80, "{checked}");
}

/// Names that a document gives from a folder on that it has just named.
fn is_inside(name: &str) -> bool {
    [
        "crates/event-files/src",
        "crates/eecvs/src/reconstruct",
        "crates/event-files/tests/formats",
    ]
    .iter()
    .any(|folder| root().join(folder).join(name).exists())
}
