#![no_main]
//! See [`targets::frames`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::frames::run(data));
