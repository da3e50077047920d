#![no_main]
//! Reads any bytes as a recording of the format that EECVS_FORMAT names. One program serves all readers, since
//! programs take longer to link than to fuzz.

use std::sync::LazyLock;

use drain::{drain, size, source};
use event_files::{FORMATS, Format, Opening};
use libfuzzer_sys::fuzz_target;

static FORMAT: LazyLock<Format> = LazyLock::new(|| {
    let name = std::env::var("EECVS_FORMAT").unwrap_or_default();
    let format = FORMATS.iter().find(|format| format.name == name);
    *format.unwrap_or_else(|| panic!("EECVS_FORMAT: no format is named {name:?}"))
});

fuzz_target!(|data: &[u8]| {
    let open = || {
        (FORMAT.open)(Opening {
            source: source(data),
            name: "fuzz",
            path: None,
            place: None,
            reading: size(data).into(),
        })
    };
    let last_us = drain(open(), None);
    // Indexes are no more trustworthy than events, so seeking is tested as well.
    if let Some(t_us) = last_us {
        drain(
            open(),
            Some(t_us / 2 + u64::from(data[data.len() / 2]) * (t_us / 512)),
        );
    }
});
