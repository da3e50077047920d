//! Properties of the target, for choices between pieces of code that compile on every target.
//!
//! Choices between files are made in each stage's `mod.rs`.

/// Whether the core has Arm's DSP instructions and the assembly that uses them is compiled in.
pub(crate) const HAS_DSP: bool = cfg!(eecvs_dsp);
/// Whether a 32-bit core multiplies to 64 bits in one instruction.
#[allow(dead_code, reason = "cores of 32 bits alone ask")]
pub(crate) const HAS_LONG_PRODUCT: bool = cfg!(eecvs_thumb2);
/// Whether a register holds 64 bits.
pub(crate) const IS_64_BIT: bool = cfg!(target_pointer_width = "64");
