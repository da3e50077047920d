#![no_main]
//! Any bytes as an HDF5 file.

use drain::{drain, size, source};
use host_harness::formats::hdf5::Hdf5Reader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(Hdf5Reader::new(source(data), "fuzz", None, size(data))));
