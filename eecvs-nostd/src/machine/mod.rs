//! What the target has, for choices between pieces of code that all targets compile.
//!
//! A choice between files is that of the stage's `mod.rs`.

/// Whether the core has Arm's DSP instructions, and the assembly of these is not left out.
pub(crate) const HAS_DSP: bool = cfg!(eecvs_dsp);
/// Whether a product of 64 bits is one instruction of a core of 32.
#[allow(dead_code, reason = "cores of 32 bits alone ask")]
pub(crate) const HAS_LONG_PRODUCT: bool = cfg!(eecvs_thumb2);
/// Whether a register holds 64 bits.
pub(crate) const IS_64_BIT: bool = cfg!(target_pointer_width = "64");
