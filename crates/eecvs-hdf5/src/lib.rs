//! Packs the chunks of an HDF5 dataset whose rows are events, a compound of t, x, y and p: bit for bit, in the order of
//! the rows, with the codec of EECVS.
//!
//! ```text
//! rows of a chunk -> pieces: events in order of time, repeated rows, other rows -> frames -> packed chunk
//! ```
//!
//! Chunks are packed and unpacked without HDF5's library. For that library, this is a filter by the crate
//! `eecvs-hdf5-plugin`: h5py, MATLAB or `h5dump` then read and write such datasets like any others.
//!
//! ```
//! # #[cfg(feature = "pack")]
//! # fn main() -> Result<(), eecvs_hdf5::Error> {
//! use eecvs_hdf5::{Layout, pack, unpack};
//!
//! // Rows of 13 bytes: t (8 bytes from byte 0 on), x (2 from 8), y (2 from 10), p (1 from 12).
//! let layout = Layout::from_values(&[13, 0, 8, 8, 2, 10, 2, 12, 1])?;
//! let rows: Vec<u8> = (0..10_000_u64)
//!     .flat_map(|i| [&(i * 3).to_le_bytes()[..], &[(i % 99) as u8, 0, 7, 0, (i % 2) as u8]].concat())
//!     .collect();
//! let packed = pack(&rows, &layout)?;
//! assert!(packed.len() * 3 < rows.len());
//! assert_eq!(unpack(&packed, &layout, 1 << 20)?, rows);
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "pack"))]
//! # fn main() {}
//! ```

mod chunk;
mod layout;

#[cfg(feature = "pack")]
pub use chunk::pack;
pub use chunk::unpack;
pub use layout::{Effort, Layout};

/// Number of the filter in HDF5 files: one of those that HDF5 leaves to testing, 256 to 511.
pub const NUMBER: u16 = 494;

/// Why a chunk cannot be packed or unpacked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The filter's values are not a layout.
    #[error(
        "the filter's values are not: size of a row, offset and size of t, of x, of y, of p, effort of 0 to 3, rows of a \
         chunk"
    )]
    Layout,
    /// The chunk has another number of rows than the filter's values state.
    #[error("the chunk has another number of rows than the filter's values state")]
    Rows,
    /// The chunk has a part of a row.
    #[error("the chunk does not consist of whole rows of the layout's size")]
    PartOfRow,
    /// The packed chunk is damaged, or of a later version of this filter.
    #[error("the packed chunk is damaged, or of a later version of this filter")]
    Damaged,
    /// The rows take more memory than is allowed or there is.
    #[error("the rows of the chunk take more memory than is allowed or there is")]
    TooLarge,
}
