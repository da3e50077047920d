#![no_main]
//! See [`targets::unpack`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::unpack::run(data));
