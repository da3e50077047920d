//! AEDAT versions 1 to 4, the formats of jAER, cAER and DV.

pub mod aedat1;
pub mod aedat2;
pub mod aedat3;
#[cfg(feature = "aedat4")]
pub mod aedat4;
#[cfg(feature = "video")]
pub(crate) mod aedat4_frames;
#[cfg(feature = "aedat4")]
pub(crate) mod aedat4_writer;
pub(crate) mod chip;
#[cfg(feature = "aedat4")]
pub(crate) mod lz4_frame;
#[cfg(feature = "aedat4")]
pub(crate) mod packet_table;
