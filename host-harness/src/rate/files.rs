//! Event-file formats as peers: whole files written by the project's writers and read back by its readers.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs_bench::source::Source;
use event_files::evt::evt2::Evt2Writer;
use event_files::evt::evt3::Evt3Writer;
use event_files::{Aedat4Writer, Compression, EventWriter};

use super::lossless::RoundTrip;

/// A format of event files.
#[derive(Debug, Clone, Copy)]
pub enum Format {
    /// EVT 2.0 words.
    Evt2,
    /// EVT 3.0 words.
    Evt3,
    /// AEDAT 4.0 with compressed packets.
    Aedat4(Compression),
}

impl Format {
    /// Writes a recording and reads it again.
    ///
    /// # Errors
    /// Fails on I/O errors, or if the format cannot hold the recording.
    pub fn round_trip(self, source: &Source) -> Result<RoundTrip> {
        let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
        let path = folder.path().join("recording");
        let started = Instant::now();
        let mut writer = self.create(&path, source)?;
        writer.write(&source.events)?;
        writer.finish()?;
        let seconds = started.elapsed().as_secs_f64();
        let bytes = std::fs::metadata(&path)
            .context("cannot read the file's size")?
            .len();
        let started = Instant::now();
        let mut reader = event_files::open(&path, Some(source.sensor))?;
        ensure!(
            reader.sensor() == source.sensor,
            "a different sensor came back"
        );
        let mut events = Vec::with_capacity(source.events.len());
        while reader.read(&mut events)? > 0 {}
        Ok(RoundTrip {
            bytes: usize::try_from(bytes)?,
            seconds,
            decode_seconds: started.elapsed().as_secs_f64(),
            events,
        })
    }

    fn create(self, path: &Path, source: &Source) -> Result<Box<dyn EventWriter>> {
        let sensor = source.sensor;
        Ok(match self {
            Self::Evt2 => Box::new(Evt2Writer::create(path, sensor)?),
            Self::Evt3 => Box::new(Evt3Writer::create(path, sensor)?),
            Self::Aedat4(compression) => {
                Box::new(Aedat4Writer::with_compression(path, sensor, compression)?)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use eecvs_bench::source::scenes;

    use super::*;
    use crate::rate::check::{Promise, check};
    use crate::rate::lossless::ZSTD;

    #[test]
    fn every_format_gives_the_events_back() {
        let source = scenes(30_000).unwrap().remove(0);
        let bytes: Vec<usize> = [
            Format::Evt2,
            Format::Evt3,
            Format::Aedat4(Compression::LZ4),
            Format::Aedat4(ZSTD),
        ]
        .into_iter()
        .map(|format| {
            let stored = format.round_trip(&source).unwrap();
            check(Promise::Lossless, &source.events, &stored.events).unwrap();
            stored.bytes
        })
        .collect();
        // More than 4 bytes per event in EVT 2.0; AEDAT's 16 bytes are compressed, better with Zstandard.
        assert!(bytes[0] > 4 * source.events.len(), "{bytes:?}");
        assert!(bytes[3] < bytes[2], "{bytes:?}");
    }
}
