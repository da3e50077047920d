//! Puts the machine's memory regions where the linker looks for them.

use std::path::Path;
use std::{env, fs};

fn main() {
    let machines = [
        ("STM32F405", "../memory.x"),
        ("MPS2", "memory/mps2.x"),
        ("MICROBIT", "memory/microbit.x"),
    ];
    let mut chosen = machines
        .iter()
        .filter(|(feature, _)| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some());
    let (Some((_, script)), None) = (chosen.next(), chosen.next()) else {
        panic!("choose one machine: build with firmware/build.sh MACHINE");
    };
    let out = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    fs::copy(script, Path::new(&out).join("memory.x")).expect("the memory regions are there");
    println!("cargo:rustc-link-search={out}");
    println!("cargo:rerun-if-changed={script}");
    println!("cargo:rerun-if-changed=build.rs");
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}
