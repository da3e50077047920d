//! Reads any bytes as a recording of a format, and from a time on.

use super::drain::{drain, size, source};
use event_files::{Format, Opening};

/// Runs one input in a format's reader.
pub fn run(format: &Format, data: &[u8]) {
    let open = || {
        (format.open)(Opening {
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
}
