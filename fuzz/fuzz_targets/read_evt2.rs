#![no_main]
//! Any bytes as a RAW file of EVT 2.0.

use drain::{drain, size, source};
use host_harness::formats::evt2::Evt2Reader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(Evt2Reader::new(source(data), "fuzz", size(data))));
