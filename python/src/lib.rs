//! The module of the Python package `eecvs`: `event-files` and `eecvs` for NumPy.
//!
//! ```text
//! recording, given, write   files and arrays
//! layout, memory            arrays of events, without a copy where that can be
//! columns, arrow            the same as columns
//! options, codec, window    encoding and decoding
//! represent                 arrays for networks
//! capture                   live devices
//! emulate                   scenes, as recordings
//! compare, picture          distortion; what is seen
//! chunk                     chunks of others' containers
//! number                    whole numbers that callers state
//! errors, work              exceptions; work without the interpreter's lock
//! ```
//!
//! It has no logic of its own: what it needs is in the libraries.

#[cfg(target_endian = "big")]
compile_error!("arrays have the layout of a little-endian machine");

mod arrow;
#[cfg(target_os = "linux")]
mod capture;
mod chunk;
mod codec;
mod columns;
mod compare;
mod emulate;
mod errors;
mod given;
mod layout;
mod memory;
mod number;
mod options;
mod picture;
mod recording;
mod represent;
mod window;
mod work;
mod write;

use pyo3::prelude::*;

/// Panics: for a test of how panics end.
#[pyfunction]
fn _panic() {
    panic!("as asked for");
}

/// The parts of `eecvs` that are made of Rust.
#[pymodule]
mod _eecvs {
    use pyo3::prelude::*;

    /// Looks up what the crate of arrays else looks up at the first array, where it takes an interrupt for a panic.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let _array = numpy::PyArray1::<u64>::zeros(module.py(), 0, false);
        Ok(())
    }

    #[pymodule_export]
    use super::_panic;
    #[cfg(target_os = "linux")]
    #[pymodule_export]
    use super::capture::{Capture, capture};
    #[pymodule_export]
    use super::chunk::{_pack, _unpack};
    #[pymodule_export]
    use super::codec::{Encoder, encode};
    #[pymodule_export]
    use super::columns::Columns;
    #[pymodule_export]
    use super::compare::compare;
    #[pymodule_export]
    use super::emulate::{_scenes, emulate};
    #[pymodule_export]
    use super::given::_names;
    #[pymodule_export]
    use super::number::_whole;
    #[pymodule_export]
    use super::picture::{Picture, picture};
    #[pymodule_export]
    use super::recording::{_reopen, Recording, Slices, Times, open};
    #[pymodule_export]
    use super::represent::{counts, time_surface, tore, voxel};
    #[pymodule_export]
    use super::window::{Decoder, Window};
    #[pymodule_export]
    use super::write::write;
}
