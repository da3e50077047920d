//! Reads and writes NumPy arrays: `.npy` and `.npz`.

#[cfg(feature = "npz")]
pub mod byte_list;
#[cfg(feature = "npz")]
pub(crate) mod layout;
pub(crate) mod npy_header;
#[cfg(feature = "npz")]
pub(crate) mod npy_writer;
#[cfg(feature = "npz")]
pub mod npz;
#[cfg(feature = "npz")]
pub(crate) mod npz_writer;
#[cfg(feature = "video")]
pub(crate) mod stack;
