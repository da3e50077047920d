#![no_main]
//! Any bytes as an AEDAT 2.0 file.

use drain::{drain, source};
use host_harness::formats::aedat2::Aedat2Reader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(Aedat2Reader::new(source(data), "fuzz")));
