#![no_main]
//! Any bytes as an npz file.

use drain::{drain, size, source};
use host_harness::formats::npz::NpzReader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(NpzReader::new(source(data), "fuzz", size(data))));
