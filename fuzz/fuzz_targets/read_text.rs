#![no_main]
//! Any bytes as lines of text.

use drain::{drain, size, source};
use host_harness::formats::text::TextReader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| drain(TextReader::new(source(data), "fuzz", size(data))));
