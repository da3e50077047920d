#![no_main]
//! [`targets::read`] of the format that EECVS_FORMAT names. One program serves all readers, since programs take longer
//! to link than to fuzz.

use std::sync::LazyLock;

use event_files::{FORMATS, Format};

static FORMAT: LazyLock<Format> = LazyLock::new(|| {
    let name = std::env::var("EECVS_FORMAT").unwrap_or_default();
    let format = FORMATS.iter().find(|format| format.name == name);
    *format.unwrap_or_else(|| panic!("EECVS_FORMAT: no format is named {name:?}"))
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::read::run(&FORMAT, data));
