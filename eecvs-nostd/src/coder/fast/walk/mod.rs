//! The fast coder's walk over a window's pixels, on cores of 32 bits.

#[cfg(eecvs_dsp)]
pub(crate) mod armv7em;
#[cfg(not(any(eecvs_dsp, target_pointer_width = "64")))]
pub(crate) mod portable32;
