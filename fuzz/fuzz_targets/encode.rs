#![no_main]
//! See [`targets::encode`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::encode::run(data));
