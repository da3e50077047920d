//! Windows of events as EVT 2.0 words, for an image that has no files.
//!
//! A cut is 32-bit little-endian words: width, height, `window_us`, number of events, then the
//! EVT 2.0 words with the `TIME_HIGH`s that they need. Its windows are those of the encoder:
//! aligned to the first event. Which events a cut has, [`eecvs_bench::cut`] says.

use std::fs;
use std::path::Path;

use anyhow::Context;
use eecvs_bench::cut::{self, Cut};
use eecvs_nostd::evt2::Evt2Encoder;

/// Writes `folder/recordings/NAME.words` and `folder/emulator/NAME.words`; a cut of a recording
/// that is not there is an empty file.
pub fn write(folder: &Path, recordings: Option<&Path>) -> anyhow::Result<()> {
    for (name, file) in cut::recordings() {
        let to = folder.join("recordings").join(name);
        match recordings.filter(|recordings| recordings.join(file).exists()) {
            Some(recordings) => write_cut(&to, &cut::of_recording(recordings, name)?)?,
            None => {
                println!("{file}: missing, so no cut of it");
                write_words(&to, &[])?;
            }
        }
    }
    for cut in cut::of_scenes()? {
        write_cut(&folder.join("emulator").join(cut.name), &cut)?;
    }
    Ok(())
}

fn write_cut(to: &Path, cut: &Cut) -> anyhow::Result<()> {
    let first = cut.events.first().context("the cut has no events")?.t_us;
    let mut words = vec![
        u32::from(cut.sensor.width),
        u32::from(cut.sensor.height),
        cut.window_us,
        u32::try_from(cut.events.len())?,
    ];
    // 64 us is a whole TIME_HIGH, which a base must not cut.
    let mut encoder = Evt2Encoder::new(first & !63);
    for event in &cut.events {
        let (time, word) = encoder
            .encode(*event)
            .context("the cut has an event that EVT 2.0 cannot hold")?;
        words.extend(time);
        words.push(word);
    }
    write_words(to, &words)
}

fn write_words(to: &Path, words: &[u32]) -> anyhow::Result<()> {
    let to = to.with_extension("words");
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    let bytes = words
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .collect::<Vec<_>>();
    // An unchanged file keeps its time, so that nothing is built anew for it.
    if fs::read(&to).is_ok_and(|old| old == bytes) {
        return Ok(());
    }
    Ok(event_files::output::write(&to, bytes)?)
}
