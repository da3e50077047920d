//! Pack: descriptors to bits, and back.

pub mod bits_lsb_first;
pub mod descriptor;
pub mod packer;
pub mod unpack;
