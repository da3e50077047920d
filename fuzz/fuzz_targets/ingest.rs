#![no_main]
//! See [`targets::ingest`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::ingest::run(data));
