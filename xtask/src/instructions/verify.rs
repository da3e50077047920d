//! The image's frames against those of the same cut on this host: bit for bit the same.

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use eecvs::encode::HostStorage;
use eecvs_bench::cut::EVENTS;
use eecvs_nostd::coder::dense::words;
use eecvs_nostd::evt2::{Evt2Decoder, Word};
use eecvs_nostd::{
    Coder, Config, Encoder, Fidelity, Hybrid, Mode, Push, Sensor, Thresholds, Transform,
    WindowConfig,
};

use super::counts::Run;

/// Output of the image: a larger one would give other frames.
const OUT_BYTES: usize = 8192;

/// Of the image: its memory for the dense coder is for this one without the window before.
const SENSOR_MAX: Sensor = Sensor {
    width: 640,
    height: 480,
};

const DENSE_WORDS: usize = words(SENSOR_MAX, false);

/// What follows a transform's name where pixels of few events are sent as times.
const FEW: &str = " few";

/// What follows a coder's name where decoded times may be off by [`MEAN_US`] on average.
const MEAN: &str = " mean";

/// In microseconds, as in the image.
const MEAN_US: Option<NonZeroU32> = NonZeroU32::new(128);

/// Encodes the run's cut anew.
pub fn verify(run: &Run, cuts: &Path) -> anyhow::Result<()> {
    let path = cuts
        .join(&run.origin)
        .join(&run.cut)
        .with_extension("words");
    let name = path.display();
    let bytes = fs::read(&path).with_context(|| format!("{name}: cannot be read"))?;
    let (words, _) = bytes.as_chunks::<4>();
    let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let [width, height, window_us, _, words @ ..] = &words[..] else {
        bail!("{name}: not a cut");
    };
    let sensor = Sensor::new(u16::try_from(*width)?, u16::try_from(*height)?);
    let sensor = sensor.with_context(|| format!("{name}: not a valid sensor size"))?;
    let hybrid = |coder| {
        let fidelity = Fidelity::Lossless;
        Mode::Hybrid(Hybrid { coder, fidelity })
    };
    let (transform, mode) = match run.transform.as_str() {
        "fast" | "fast mean" => (Some(Transform::Dct), hybrid(Coder::Fast)),
        "dense" => (Some(Transform::Dct), hybrid(Coder::Dense)),
        "quick" => (Some(Transform::Dct), hybrid(Coder::Quick)),
        name => {
            let name = name.trim_end_matches(FEW);
            let transform = Transform::ALL.into_iter().find(|t| t.name() == name);
            (transform, Mode::Transform)
        }
    };
    let mut storage = HostStorage::new(sensor, EVENTS).with_dense_words(DENSE_WORDS);
    let mut encoder = storage.encoder(Config {
        transform: Some(transform.context("an unknown transform")?),
        m: run.m.max(8),
        few_as_times: run.transform.ends_with(FEW),
        max_emd_us: MEAN_US.filter(|_| run.transform.ends_with(MEAN)),
        ..Config::new(
            WindowConfig::new(sensor, *window_us),
            Thresholds::new(0, 0).context("zero is a threshold")?,
            mode,
        )
    })?;
    let mut output = Output::default();
    let mut decoder = Evt2Decoder::new(0);
    for word in words {
        if let Word::Event(event) = decoder.decode(*word) {
            while encoder.push(event) == Push::Closed {
                output.take(&mut encoder);
            }
        }
    }
    encoder.flush();
    output.take(&mut encoder);
    ensure!(
        (output.bytes, output.check) == (run.bytes, run.check),
        "{name}: {} M={}: the image's frames differ from this host's",
        run.transform,
        run.m
    );
    Ok(())
}

#[derive(Debug, Default)]
struct Output {
    bytes: u64,
    /// Of the frames' CRCs, as the image adds them up.
    check: u32,
}

impl Output {
    fn take(&mut self, encoder: &mut Encoder<'_>) {
        let mut out = [0; OUT_BYTES];
        while let Ok(Some(frame)) = encoder.next_frame(&mut out) {
            self.bytes += frame.range.len() as u64;
            let crc = out[frame.range].last_chunk().copied();
            self.check = self.check.rotate_left(1) ^ crc.map_or(0, u32::from_le_bytes);
        }
    }
}
