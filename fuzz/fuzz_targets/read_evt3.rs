#![no_main]
//! Any bytes as a RAW file of EVT 3.0.

use drain::{drain, size, source};
use host_harness::formats::evt3::Evt3Reader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(Evt3Reader::new(source(data), "fuzz", size(data))));
