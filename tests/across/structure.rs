//! The core's tree shows the data flow, and stays so: few entries, no circles, and the targets' choices in one
//! place of each stage. The crates are of use by themselves: few packages, and none depends on the command.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Entries of the core's source folder.
const ENTRIES_MAX: usize = 26;
/// Files that know of Arm's DSP instructions.
const DSP_FILES_MAX: usize = 14;

fn core() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../eecvs-nostd/src")
}

/// A module by its path: `["transform", "dct"]`; `mod.rs` is its folder, `lib.rs` the empty path.
type Module = Vec<String>;

/// A file's text without its tests and comments.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let text = text.split("#[cfg(test)]\nmod tests").next().unwrap();
    let lines = text.lines().map(|line| line.split("//").next().unwrap());
    lines.collect::<Vec<_>>().join("\n")
}

/// Every file of the core, by its module.
fn files() -> BTreeMap<Module, PathBuf> {
    fn walk(folder: &Path, module: &Module, files: &mut BTreeMap<Module, PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
            let mut child = module.clone();
            if path.is_dir() {
                child.push(stem);
                walk(&path, &child, files);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                if stem != "mod" && stem != "lib" {
                    child.push(stem);
                }
                assert!(files.insert(child, path).is_none());
            }
        }
    }
    let mut files = BTreeMap::new();
    walk(&core(), &Vec::new(), &mut files);
    files
}

/// The paths that a `use` names: `a::{b, c::{d, e}}` names a::b, a::c::d and a::c::e.
fn used(tree: &str, before: &str, paths: &mut Vec<String>) {
    let Some((head, rest)) = tree.split_once('{') else {
        let path = tree.split(" as ").next().unwrap().trim();
        if !path.is_empty() {
            paths.push(format!("{before}{path}"));
        }
        return;
    };
    let before = format!("{before}{}", head.trim());
    let inner = &rest[..rest.rfind('}').unwrap()];
    let (mut depth, mut begin) = (0, 0);
    for (at, c) in inner.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                used(&inner[begin..at], &before, paths);
                begin = at + 1;
            }
            _ => {}
        }
    }
    used(&inner[begin..], &before, paths);
}

/// The modules that a module's file names, in `use` or in place.
fn named(module: &Module, code: &str, files: &BTreeMap<Module, PathBuf>) -> BTreeSet<Module> {
    let mut paths = Vec::new();
    let mut rest = String::new();
    // A `use` that goes on to a line further.
    let mut tree: Option<String> = None;
    for line in code.lines() {
        let words = line.trim_start();
        // `pub`, `pub(crate)`
        let words = match words.split_once(' ') {
            Some((visibility, words)) if visibility.starts_with("pub") => words,
            _ => words,
        };
        match (&mut tree, words.strip_prefix("use ")) {
            (Some(tree), _) => tree.push_str(line.trim()),
            (None, Some(begun)) => tree = Some(begun.to_owned()),
            (None, None) => {
                rest.push_str(line);
                rest.push('\n');
            }
        }
        if let Some(whole) = tree.take_if(|tree| tree.ends_with(';')) {
            used(whole.trim_end_matches(';'), "", &mut paths);
        }
    }
    let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    paths.extend(rest.split(|c| !is_part(c)).map(str::to_owned));
    let mut named = BTreeSet::new();
    for path in paths {
        let mut segments = path.split("::");
        let mut at = match segments.next() {
            Some("crate") => Vec::new(),
            Some("super") => module[..module.len().saturating_sub(1)].to_vec(),
            Some("self") => module.clone(),
            Some(child) => {
                let child = [module.as_slice(), &[child.to_owned()]].concat();
                if !files.contains_key(&child) {
                    continue;
                }
                child
            }
            None => continue,
        };
        for segment in segments {
            let next = if segment == "super" {
                at[..at.len().saturating_sub(1)].to_vec()
            } else {
                [at.as_slice(), &[segment.to_owned()]].concat()
            };
            if !files.contains_key(&next) {
                break;
            }
            at = next;
        }
        named.insert(at);
    }
    named
}

#[test]
fn the_source_folder_has_few_entries() {
    let entries = fs::read_dir(core()).unwrap().count();
    assert!(entries <= ENTRIES_MAX, "{entries} entries");
}

/// A reader finds what a target has in place of the portable code at one place of each stage.
#[test]
fn targets_are_chosen_in_mod_files_alone() {
    let mut dsp = Vec::new();
    for path in files().values() {
        let code = code(path);
        if code.contains("eecvs_dsp") {
            dsp.push(path.clone());
        }
        if path.ends_with("mod.rs") {
            continue;
        }
        for line in code.lines().filter(|line| line.contains("cfg")) {
            let is_target = line.contains("eecvs_") || line.contains("target_");
            assert!(!is_target, "{}: {line}", path.display());
        }
    }
    assert!(dsp.len() <= DSP_FILES_MAX, "{}: {dsp:#?}", dsp.len());
}

/// Each file is understood by those that it names, and by these alone. A folder and its own children are
/// one thing.
#[test]
fn no_imports_run_in_circles() {
    let files = files();
    let is_own = |a: &Module, b: &Module| a.starts_with(b) || b.starts_with(a);
    let edges: BTreeMap<&Module, BTreeSet<Module>> = files
        .iter()
        .map(|(module, path)| {
            let mut named = named(module, &code(path), &files);
            named.retain(|other| !is_own(other, module));
            (module, named)
        })
        .collect();
    assert!(edges.values().map(BTreeSet::len).sum::<usize>() > 200);
    // What cannot be taken away leaf by leaf is a circle, or leads to one.
    let mut left: BTreeSet<&Module> = edges.keys().copied().collect();
    loop {
        let leaves: Vec<&Module> = left
            .iter()
            .copied()
            .filter(|module| !edges[module].iter().any(|other| left.contains(other)))
            .collect();
        if leaves.is_empty() {
            break;
        }
        for leaf in leaves {
            left.remove(leaf);
        }
    }
    let circle: Vec<String> = left
        .iter()
        .map(|module| {
            let others = edges[*module].iter().filter(|other| left.contains(other));
            let others: Vec<String> = others.map(|other| other.join("/")).collect();
            format!("{} -> {}", module.join("/"), others.join(", "))
        })
        .collect();
    assert!(circle.is_empty(), "{circle:#?}");
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// What a program that depends on a crate without its default features builds, itself left out.
fn packages(of: &[&str]) -> BTreeSet<String> {
    let mut tree = Command::new(env!("CARGO"));
    tree.current_dir(root())
        .args([
            "tree",
            "--locked",
            "--no-default-features",
            "--prefix",
            "none",
        ])
        .args(["--edges", "normal,build", "--format", "{p}"])
        .args(of);
    let output = tree.output().expect("cargo runs");
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).expect("names");
    let names = text.lines().map(|line| line.trim_end_matches(" (*)"));
    names
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect()
}

/// A reader of one format and a decoder of frames take few packages.
#[test]
fn the_libraries_are_light() {
    for (of, most) in [
        (&["-p", "event-types", "--features", "std"][..], 1),
        (&["-p", "event-files"], 30),
        (&["-p", "eecvs"], 50),
    ] {
        let packages = packages(of);
        assert!(packages.len() <= most, "{of:?}: {packages:#?}");
        for heavy in ["clap", "indicatif", "anyhow"] {
            let is_there = packages
                .iter()
                .any(|name| name.split(' ').next() == Some(heavy));
            assert!(!is_there, "{of:?}: {heavy}");
        }
    }
}

/// The command is where everything ends: whoever wants a part of it depends on a library.
#[test]
fn no_crate_depends_on_the_command() {
    let mut checked = 0;
    let folders = fs::read_dir(root()).unwrap();
    let crates = fs::read_dir(root().join("crates")).unwrap();
    for entry in folders.chain(crates) {
        let manifest = entry.unwrap().path().join("Cargo.toml");
        let Ok(text) = fs::read_to_string(&manifest) else {
            continue;
        };
        checked += 1;
        let is_own = text.contains("name = \"host-harness\"");
        let names = text.lines().filter(|line| line.starts_with("host-harness"));
        assert!(is_own || names.count() == 0, "{}", manifest.display());
    }
    assert!(checked > 12, "{checked}");
}

/// Lines of the command's own code, at the most.
const COMMAND_LINES_MAX: usize = 30_000;

#[test]
fn the_command_is_thin() {
    fn lines(folder: &Path) -> usize {
        let entries = fs::read_dir(folder).unwrap();
        entries
            .map(|entry| entry.unwrap().path())
            .map(|path| match path.is_dir() {
                true => lines(&path),
                false => fs::read_to_string(&path).unwrap().lines().count(),
            })
            .sum()
    }
    let lines = lines(&root().join("host-harness/src"));
    assert!(lines <= COMMAND_LINES_MAX, "{lines}");
}
