//! Sets `eecvs_dsp` where the core has Arm's DSP instructions; stable Rust does not tell.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-check-cfg=cfg(eecvs_dsp)");
    println!("cargo:rustc-check-cfg=cfg(eecvs_intake_asm)");
    let target = std::env::var("TARGET").unwrap_or_default();
    // Cortex-M4 and M7. Thumb alone: the instructions' spelling is not that of other targets.
    if target.starts_with("thumbv7em-") {
        println!("cargo:rustc-cfg=eecvs_dsp");
        println!("cargo:rustc-cfg=eecvs_intake_asm");
    }
}
