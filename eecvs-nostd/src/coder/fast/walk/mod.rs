//! The fast coder's walk over a window's pixels, for cores of 32 bits. Others use only the loop in
//! [`window_events`](crate::coder::window_events).

#[cfg(eecvs_dsp)]
mod armv7em;
#[cfg(target_pointer_width = "64")]
mod none;
#[cfg(not(any(eecvs_dsp, target_pointer_width = "64")))]
mod portable32;

use crate::machine::IS_64_BIT;

#[cfg(eecvs_dsp)]
pub(crate) use armv7em::walk;
#[cfg(target_pointer_width = "64")]
pub(crate) use none::walk;
#[cfg(not(any(eecvs_dsp, target_pointer_width = "64")))]
pub(crate) use portable32::walk;

/// Whether calling [`walk`] is worth it.
pub(crate) const IS_THERE: bool = !IS_64_BIT;
