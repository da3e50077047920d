//! The lossless peers of the codec, and their round trips.

use std::time::Instant;

use anyhow::Result;
use eecvs_bench::source::Source;
use eecvs_nostd::Event;
use event_files::Compression;

use super::files::Format;
use super::programs::Program;
use super::{columns, squeeze};

/// Zstandard for AEDAT 4.0, at its default level.
#[cfg(any(feature = "zstd", test))]
pub const ZSTD: Compression = Compression {
    code: 3,
    name: "ZSTD",
    compress: |bytes| squeeze::zstd(bytes, 3).map_err(event_types::stream::Error::other),
};

/// A lossless way to store events.
#[derive(Debug, Clone, Copy)]
pub enum Peer {
    /// A format of event files.
    File(&'static str, Format),
    /// The structure of arrays of [`columns`], with a general compressor and its decompressor.
    Columns(&'static str, Way, Way),
    /// A program of others.
    Program(Program),
}

/// A recording that was stored and restored.
#[derive(Debug)]
pub struct RoundTrip {
    /// Bytes of the file.
    pub bytes: usize,
    /// Time spent making it, in seconds.
    pub seconds: f64,
    /// Time spent restoring, in seconds.
    pub decode_seconds: f64,
    /// The events restored.
    pub events: Vec<Event>,
}

/// Converts bytes to other bytes.
type Way = fn(&[u8]) -> Result<Vec<u8>>;

/// Peers that need no C library.
const ALWAYS: [Peer; 4] = [
    Peer::File("evt2", Format::Evt2),
    Peer::File("evt3", Format::Evt3),
    Peer::File("aedat4-lz4", Format::Aedat4(Compression::LZ4)),
    Peer::Columns("xz-9", squeeze::xz, squeeze::unxz),
];

/// Peers that need the feature `zstd`.
#[cfg(feature = "zstd")]
const WITH_ZSTD: [Peer; 2] = [
    Peer::File("aedat4-zstd", Format::Aedat4(ZSTD)),
    Peer::Columns("zstd-19", |bytes| squeeze::zstd(bytes, 19), squeeze::unzstd),
];
#[cfg(not(feature = "zstd"))]
const WITH_ZSTD: [Peer; 0] = [];

/// Returns every peer of this build and machine.
#[must_use]
pub fn peers() -> Vec<Peer> {
    let (programs, _) = Program::installed();
    let built = ALWAYS.into_iter().chain(WITH_ZSTD);
    built
        .chain(programs.iter().copied().map(Peer::Program))
        .collect()
}

/// Says what this build and machine lack; `None` if they have all peers.
#[must_use]
pub fn missing() -> Option<String> {
    let mut missing = Vec::new();
    if !cfg!(feature = "zstd") {
        missing.push("zstd-19 and aedat4-zstd: build with --features zstd".to_owned());
    }
    for program in &Program::installed().1 {
        missing.push(format!("{}: install {}", program.name(), program.needs()));
    }
    (!missing.is_empty()).then(|| format!("no rows for {}", missing.join("; for ")))
}

impl Peer {
    /// Returns the name used in the rows of results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::File(name, _) | Self::Columns(name, ..) => name,
            Self::Program(program) => program.name(),
        }
    }

    /// Stores and restores a recording.
    ///
    /// # Errors
    /// Fails on I/O errors, or if the peer cannot hold the recording.
    pub fn round_trip(self, source: &Source) -> Result<RoundTrip> {
        match self {
            Self::File(_, format) => format.round_trip(source),
            Self::Program(program) => program.round_trip(source),
            Self::Columns(_, squeeze, open) => {
                let started = Instant::now();
                let bytes = squeeze(&columns::write(source.sensor, &source.events)?)?;
                let seconds = started.elapsed().as_secs_f64();
                let started = Instant::now();
                let (_, events) = columns::read(&open(&bytes)?)?;
                Ok(RoundTrip {
                    bytes: bytes.len(),
                    seconds,
                    decode_seconds: started.elapsed().as_secs_f64(),
                    events,
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use eecvs_bench::source::scenes;

    use super::*;
    use crate::rate::check::{Promise, check};

    #[test]
    fn every_peer_gives_the_events_back() {
        let source = scenes(30_000).unwrap().remove(0);
        if let Some(missing) = missing() {
            eprintln!("skipped: {missing}");
        }
        for peer in peers() {
            let RoundTrip { bytes, events, .. } = peer.round_trip(&source).unwrap();
            check(Promise::Lossless, &source.events, &events).unwrap();
            assert!(bytes > source.events.len() / 8, "{}: {bytes}", peer.name());
        }
    }
}
