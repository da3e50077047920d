//! Runs the fuzz targets on their seeds, whole and cut, and on random inputs.

#[path = "../../fuzz/targets/lib.rs"]
mod targets;

use std::fs;
use std::path::{Path, PathBuf};

use event_files::FORMATS;
use proptest::collection::vec;
use proptest::prelude::{ProptestConfig, any, proptest};
use targets::{encode, event_link, frames, hdf5_chunk, ingest, read, sealed, unpack, video};

/// Longest input, as `cargo xtask fuzz` has it.
const BYTES_MAX: usize = 8192;

/// The files of `fuzz/seeds/NAME`, in the order of their names.
fn seeds(name: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../fuzz/seeds")
        .join(name);
    let Ok(files) = fs::read_dir(&folder) else {
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = files.map(|file| file.expect("a seed").path()).collect();
    paths.sort();
    paths
        .iter()
        .map(|path| fs::read(path).expect("a seed"))
        .collect()
}

/// Runs a seed whole, without its last byte, and without its second half.
fn run(seed: &[u8], target: impl Fn(&[u8])) {
    for len in [seed.len(), seed.len().saturating_sub(1), seed.len() / 2] {
        target(&seed[..len]);
    }
}

#[test]
fn readers_hold_on_seeds() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds");
    let mut with_seeds = 0;
    for entry in fs::read_dir(folder).expect("seeds") {
        let entry = entry.expect("seeds");
        let name = entry.file_name().into_string().expect("a name");
        let Some(format) = name.strip_prefix("read_") else {
            continue;
        };
        // Beside them are the scripts that wrote some.
        if !entry.path().is_dir() {
            continue;
        }
        let known = FORMATS.iter().find(|known| known.name == format);
        let format = known.unwrap_or_else(|| panic!("{name}: no format has this name"));
        for seed in seeds(&name) {
            run(&seed, |data| read::run(format, data));
        }
        with_seeds += 1;
    }
    assert!(with_seeds >= 18, "seeds of {with_seeds} formats");
}

#[test]
fn frames_hold_on_seeds() {
    let seeds = seeds("frames");
    assert!(!seeds.is_empty());
    for seed in seeds {
        run(&seed, frames::run);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn targets_hold_on_random_bytes(data in vec(any::<u8>(), 0..BYTES_MAX)) {
        for target in [
            encode::run,
            event_link::run,
            frames::run,
            hdf5_chunk::run,
            ingest::run,
            sealed::run,
            unpack::run,
            video::run,
        ] {
            target(&data);
        }
        for format in FORMATS {
            read::run(format, &data);
        }
    }
}
