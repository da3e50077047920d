//! A live stream to a file that stays readable, whatever ends it.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::num::NonZeroUsize;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::Event;
use host_harness::encode::{Codec, EncodeSummary, Limits, encode};
use host_harness::formats::{self, EventReader, Pause};

/// What a capture writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The device's own bytes.
    Stream,
    /// Frames.
    Frames,
    /// Events in a format of recordings.
    Events,
}

/// By extension: `.stream`, `.eecvs`, or a recording's.
///
/// # Errors
/// A format whose files cannot be read before they are complete.
pub fn kind_of(path: &Path) -> Result<Kind> {
    let name = path.display();
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("stream") => Ok(Kind::Stream),
        Some("eecvs") => Ok(Kind::Frames),
        Some("npz") => anyhow::bail!(
            "{name}: an .npz cannot be read before it is complete, and a capture may be cut short: \
             record .raw or .aedat4 and convert it with eecvs convert"
        ),
        _ => Ok(Kind::Events),
    }
}

/// Writes events until the stream ends or fails. What came before a failure is in the file, which is
/// closed in order where that is still possible.
///
/// # Errors
/// The link, the file; the message names it.
pub fn events(reader: &mut dyn EventReader, path: &Path) -> Result<u64> {
    let mut writer = formats::create(path, reader.sensor())?;
    let mut batch: Vec<Event> = Vec::with_capacity(formats::BATCH_EVENTS);
    let mut written = 0;
    let outcome = loop {
        batch.clear();
        let read = reader.read(&mut batch);
        // Those before an error count too.
        if !batch.is_empty() {
            if let Err(error) = writer.write(&batch) {
                break Err(error);
            }
            written += batch.len() as u64;
        }
        match read {
            Err(error) => break Err(error),
            Ok(0) if reader.pause() == Pause::Ended => break Ok(()),
            Ok(_) => {}
        }
    };
    let finished = writer.finish();
    outcome.and(finished)?;
    Ok(written)
}

/// Writes frames until the stream ends or fails; those before a failure are in the file.
///
/// # Errors
/// The link, the file, a configuration that cannot run.
pub fn frames(
    reader: &mut dyn EventReader,
    codec: Codec<'_>,
    limits: Limits,
    path: &Path,
) -> Result<EncodeSummary> {
    let name = path.display();
    let file = File::create(path).with_context(|| format!("{name}: cannot be created"))?;
    let mut out = BufWriter::with_capacity(1 << 16, file);
    let encoded = encode(
        reader,
        codec,
        limits,
        NonZeroUsize::MIN,
        &mut out,
        &mut |_| {},
    );
    let flushed = out.flush();
    let summary = encoded.with_context(|| name.to_string())?;
    flushed.with_context(|| format!("{name}: cannot be written"))?;
    Ok(summary)
}

/// Refuses an output that is there already, unless it may be written anew.
///
/// # Errors
/// It is there.
pub fn refuse_existing(path: &Path, overwrite: bool) -> Result<()> {
    ensure!(
        overwrite || !path.is_file(),
        "{}: is there already: choose another name or --overwrite",
        path.display()
    );
    Ok(())
}
