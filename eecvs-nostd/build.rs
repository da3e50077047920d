//! Sets the crate's own `cfg`s by target, as stable Rust does not expose the DSP instructions:
//!
//! - `eecvs_dsp` if the core has Arm's DSP instructions, and `eecvs_intake_asm` if it also runs without an
//!   operating system; neither with the feature `portable`.
//! - `eecvs_thumb2` on Cortex-M with Thumb-2, where a product of 64 bits takes one instruction.
//! - `eecvs_small` where flash has no room for the largest table.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-check-cfg=cfg(eecvs_dsp, eecvs_intake_asm, eecvs_thumb2, eecvs_small)");
    let target = std::env::var("TARGET").unwrap_or_default();
    if target.starts_with("thumbv7") || target.starts_with("thumbv8m.main") {
        println!("cargo:rustc-cfg=eecvs_thumb2");
    }
    // Cortex-M0, with up to 256 KiB of flash.
    if target.starts_with("thumbv6m-") {
        println!("cargo:rustc-cfg=eecvs_small");
    }
    if std::env::var_os("CARGO_FEATURE_PORTABLE").is_some() {
        return;
    }
    // Cortex-M4 and M7, in Thumb only: other targets spell the instructions differently. Cortex-M33 and later cores with
    // the DSP extension run what is built for this target, too; their own target leaves the extension out.
    if target.starts_with("thumbv7em-") {
        println!("cargo:rustc-cfg=eecvs_dsp");
        // The assembly expects the slots of a microcontroller.
        if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "none") {
            println!("cargo:rustc-cfg=eecvs_intake_asm");
        }
    }
}
