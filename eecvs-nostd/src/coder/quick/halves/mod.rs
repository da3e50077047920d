//! Two halves of 16 bits in a word, on one event at a time.

#[cfg(eecvs_dsp)]
mod armv7em;
#[cfg_attr(eecvs_dsp, allow(dead_code))]
mod portable;

#[cfg(eecvs_dsp)]
pub use armv7em::{dot, dot_add, widen};
#[cfg(not(eecvs_dsp))]
pub use portable::{dot, dot_add, widen};
