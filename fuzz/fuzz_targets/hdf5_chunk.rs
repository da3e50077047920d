#![no_main]
//! See [`targets::hdf5_chunk`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::hdf5_chunk::run(data));
