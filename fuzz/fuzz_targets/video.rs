#![no_main]
//! See [`targets::video`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::video::run(data));
