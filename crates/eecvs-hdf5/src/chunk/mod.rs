//! A chunk of rows in packed form, and back.
//!
//! A packed chunk is a byte [`VERSION`], pieces, one after the other, and the CRC-32 of all bytes before it (u32,
//! little-endian). A piece begins with its kind (1 byte) and its
//! number of rows (u32, little-endian, at least 1):
//!
//! | kind | rows | what follows |
//! |---|---|---|
//! | 0 | any | the rows as they are |
//! | 1 | equal | one of the rows |
//! | 2 | events, OFF as 0 | the number of bytes of the frames (u32, little-endian), the frames |
//! | 3 | events, OFF as -1 | the same |
//!
//! The events of a piece are in order of time. Rows behind the end of a dataset, which HDF5 fills in, are equal; a clock
//! that falls back, rows that are no events and rows whose unused bytes are not 0 only begin other pieces.

#[cfg(feature = "pack")]
mod pack;
mod unpack;

#[cfg(feature = "pack")]
pub use pack::pack;
pub use unpack::unpack;

/// First byte of a packed chunk.
const VERSION: u8 = 1;

const AS_THEY_ARE: u8 = 0;
const EQUAL: u8 = 1;
const EVENTS: u8 = 2;
const EVENTS_SIGNED: u8 = 3;

/// Most bytes of a chunk's equal rows: else a few bytes could ask for any amount of memory. More are stored as they are.
const EQUAL_BYTES_MAX: usize = 64 << 20;

/// Size of the CRC-32 behind the pieces, in bytes.
const CHECKSUM_BYTES: usize = 4;
