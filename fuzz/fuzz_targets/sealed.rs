#![no_main]
//! See [`targets::sealed`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::sealed::run(data));
