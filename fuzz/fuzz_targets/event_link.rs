#![no_main]
//! See [`targets::event_link`].

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::event_link::run(data));
