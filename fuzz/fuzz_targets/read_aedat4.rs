#![no_main]
//! Any bytes as an AEDAT 4.0 file.

use drain::{drain, size, source};
use host_harness::formats::aedat4::Aedat4Reader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(Aedat4Reader::new(source(data), "fuzz", size(data))));
