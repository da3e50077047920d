//! Packs descriptors to bits, and unpacks them.

pub mod bits_lsb_first;
pub mod descriptor;
pub mod packer;
pub mod timed;
pub mod unpack;
