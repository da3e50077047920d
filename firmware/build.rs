//! Puts the machine's memory regions where the linker looks for them, and the golden vectors where `bin/golden.rs`
//! looks.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

use serde::Deserialize;

const GOLDEN: &str = "../tests/golden";

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    println!("cargo:rustc-check-cfg=cfg(armv6m)");
    if env::var("TARGET")?.starts_with("thumbv6m") {
        println!("cargo:rustc-cfg=armv6m");
    }
    memory(&out)?;
    fs::write(out.join("golden.rs"), golden()?)?;
    println!("cargo:rerun-if-changed=build.rs");
    Ok(())
}

fn memory(out: &Path) -> Result<(), Box<dyn Error>> {
    let machines = [
        ("STM32F405", "../memory.x"),
        ("MPS2", "memory/mps2.x"),
        ("MICROBIT", "memory/microbit.x"),
    ];
    let mut chosen = machines
        .iter()
        .filter(|(feature, _)| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some());
    let (Some((_, script)), None) = (chosen.next(), chosen.next()) else {
        return Err("choose one machine: build with firmware/build.sh MACHINE".into());
    };
    let has = |feature: &str| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    let script = match *script {
        _ if has("CUTS") => "memory/instructions.x",
        _ if has("AN505") => "memory/an505.x",
        _ if has("AN547") => "memory/an547.x",
        "../memory.x" if !has("FULL") => "memory/small.x",
        script => script,
    };
    fs::copy(script, out.join("memory.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed={script}");
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
    Ok(())
}

/// The part of a vector that `bin/golden.rs` needs; `tests/frames/golden.rs` writes and describes vectors.
#[derive(Deserialize)]
struct Golden {
    width: u16,
    height: u16,
    transform: String,
    m: u8,
    #[serde(default)]
    mode: u8,
    #[serde(default)]
    fidelity: u32,
    #[serde(default)]
    scans: Option<(u32, i32)>,
    #[serde(default)]
    few_as_times: bool,
    events: Vec<(u64, u16, u16, u8)>,
    frames: Vec<String>,
}

/// Returns the vectors as Rust constants.
fn golden() -> Result<String, Box<dyn Error>> {
    println!("cargo:rerun-if-changed={GOLDEN}");
    let mut paths = fs::read_dir(GOLDEN)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()?;
    paths.sort();
    let mut text = String::from("static GOLDEN: &[Golden] = &[\n");
    for path in paths {
        // Images have neither the tree nor the keys coder.
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let has_quick = env::var_os("CARGO_FEATURE_QUICK").is_some();
        if name.starts_with("v4") && !(has_quick && name.starts_with("v4_quick")) {
            continue;
        }
        let golden: Golden = serde_json::from_str(&fs::read_to_string(&path)?)?;
        let Golden {
            width,
            height,
            transform,
            m,
            mode,
            fidelity,
            scans,
            few_as_times,
            events,
            frames,
        } = golden;
        let frames = frames
            .iter()
            .map(|frame| bytes(frame))
            .collect::<Result<Vec<_>, _>>()?;
        writeln!(
            text,
            "Golden {{ width: {width}, height: {height}, transform: {transform:?}, m: {m}, \
             mode: {mode}, fidelity: {fidelity}, scans: {scans:?}, \
             few_as_times: {few_as_times}, events: &{events:?}, frames: &["
        )?;
        for frame in frames {
            writeln!(text, "&{frame:?},")?;
        }
        text.push_str("] },\n");
    }
    text.push_str("];\n");
    Ok(text)
}

fn bytes(hex: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    (0..hex.len())
        .step_by(2)
        .map(|at| {
            let digits = hex.get(at..at + 2).ok_or("an odd number of digits")?;
            Ok(u8::from_str_radix(digits, 16)?)
        })
        .collect()
}
