//! Sets `eecvs_dsp` where the core has Arm's DSP instructions, and `eecvs_intake_asm` where it also
//! runs without an operating system; stable Rust does not tell the first. With the feature `portable` neither.
//! `eecvs_thumb2` on Cortex-M with Thumb-2, whose products of 64 bits are one instruction; `eecvs_small`
//! where flash has no room for the largest table.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-check-cfg=cfg(eecvs_dsp, eecvs_intake_asm, eecvs_thumb2, eecvs_small)");
    let target = std::env::var("TARGET").unwrap_or_default();
    if target.starts_with("thumbv7") {
        println!("cargo:rustc-cfg=eecvs_thumb2");
    }
    // Cortex-M0: up to 256 KiB.
    if target.starts_with("thumbv6m-") {
        println!("cargo:rustc-cfg=eecvs_small");
    }
    if std::env::var_os("CARGO_FEATURE_PORTABLE").is_some() {
        return;
    }
    // Cortex-M4 and M7. Thumb alone: the instructions' spelling is not that of other targets.
    if target.starts_with("thumbv7em-") {
        println!("cargo:rustc-cfg=eecvs_dsp");
        // Its slots are those of a microcontroller.
        if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "none") {
            println!("cargo:rustc-cfg=eecvs_intake_asm");
        }
    }
}
