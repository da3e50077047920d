//! Measures rate against distortion of the codec in both modes, and of its peers.
//!
//! ```text
//! recording -> codec | peer -> bytes -> bits per event
//!                                -> decoder -> promise checked -> metrics, box volume -> row
//! ```

pub mod check;
pub mod columns;
pub mod files;
pub mod lossless;
pub mod ours;
pub mod programs;
pub mod squeeze;
pub mod volume;

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use eecvs_bench::record_file::{Name, name};
use eecvs_bench::source::{Memory, Source, WINDOW_US};
use eecvs_nostd::{Coder, Event, Fidelity, Hybrid, Transform};
use event_metrics::{Comparison, compare};
use serde::{Deserialize, Serialize};

use crate::baseline::dense_array::{StoredArray, Window};
use crate::baseline::representation::{self, Made, Representation};
use crate::baseline::stored::Stored;
use crate::baseline::tore::{self, Tore};
use crate::baseline::voxel::Voxel;
use check::{Promise, check};
use volume::{BINS, Volume};

/// How much is measured.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Duration of an emulated scene in us.
    pub scene_us: u64,
    /// Time tolerances, in us.
    pub tolerances_us: &'static [u32],
    /// Numbers B of bins of mode `hybrid`.
    pub bins: &'static [u16],
    /// Numbers M of coefficients of mode `transform`.
    pub m: &'static [u8],
    /// Numbers B of bins of voxel grids.
    pub voxel_bins: &'static [usize],
}

impl Effort {
    /// The effort for published figures.
    pub const FULL: Self = Self {
        scene_us: 1_000_000,
        tolerances_us: &[5, 10, 20, 40, 80, 160, 320, 640, 1280, 2560, 5120],
        bins: &[4, 8, 16, 32],
        m: &[2, 4, 8, 16, 24, 32, 64],
        voxel_bins: &[5, 8],
    };
    /// The effort for a check that everything works.
    pub const QUICK: Self = Self {
        scene_us: 50_000,
        tolerances_us: &[40, 640],
        bins: &[8],
        m: &[8, 32],
        voxel_bins: &[8],
    };

    /// Returns the number of rows per recording, which is how often [`measure`] calls `progress`.
    #[must_use]
    pub fn rows(&self) -> usize {
        let hybrid = CODERS.len() * (1 + self.tolerances_us.len() + self.bins.len());
        // Plain, and with each of the two coders.
        let transform = 3 * Transform::ALL.len() * self.m.len();
        let arrays = Stored::ALL.len() * (1 + self.voxel_bins.len());
        hybrid + LOSSLESS.len() + OWN_WINDOWS.len() + transform + lossless::peers().len() + arrays
    }
}

/// Coders of events that are measured with every fidelity: what `eecvs encode --coder dense` and `fast` use, and what a
/// microcontroller's `fast` is.
const CODERS: [Coder; 3] = [Coder::Dense, Coder::Keys, Coder::Fast];
/// Coders of events that are measured lossless alone.
const LOSSLESS: [Coder; 4] = [
    Coder::Quick,
    Coder::Tree(eecvs_nostd::Effort::One),
    Coder::Tree(eecvs_nostd::Effort::Two),
    Coder::Tree(eecvs_nostd::Effort::Three),
];

/// Coders of events that are measured with windows of the recording's own duration too.
const OWN_WINDOWS: [Coder; 2] = [
    Coder::Tree(eecvs_nostd::Effort::One),
    Coder::Tree(eecvs_nostd::Effort::Three),
];
/// Their setting.
pub const OWN_WINDOWS_SETTING: &str = "lossless, own windows";

/// One point of a curve; the fields are its JSON keys. `None` if a metric does not apply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the recording.
    pub recording: String,
    /// `hybrid-dense`, `hybrid-keys`, `hybrid-fast`, `hybrid-quick`, `hybrid-tree-1` to `-3`, `transform-dct`,
    /// `transform-dct-fast`, `transform-dct-dense`, ..., or a peer's name.
    #[serde(deserialize_with = "name")]
    pub codec: Name,
    /// `lossless`, [`OWN_WINDOWS_SETTING`], `50 us`, `8 bins`, `M = 16`; for an array, its type and bins.
    pub setting: String,
    /// Number of events.
    #[serde(default)]
    pub events: u64,
    /// 8 * bytes of the file / events.
    pub bits_per_event: f64,
    /// As printed by `eecvs compare`.
    pub emd_pixel_us: Option<f64>,
    /// As printed by `eecvs compare`.
    pub mse: Option<f64>,
    /// As printed by `eecvs compare`.
    pub ssim: Option<f64>,
    /// Normalised error of the box volume of the decoded events, or of a voxel grid of 8 bins.
    pub volume_nmse: Option<f64>,
    /// Normalised error of the box volume computed from the coefficients directly; only in mode `transform`.
    pub coefficients_nmse: Option<f64>,
    /// Time spent encoding on one thread, in seconds; for an array, on its active pixels. For what is lossless, the
    /// least of up to three runs; else of one run.
    pub seconds: f64,
    /// Time spent decoding on one thread, in seconds, where it was measured: for what is lossless.
    #[serde(default)]
    pub decode_seconds: Option<f64>,
}

/// Returns the name of a coder's rows in mode `hybrid`.
#[must_use]
pub const fn coder_name(coder: Coder) -> &'static str {
    match coder {
        Coder::Dense => "hybrid-dense",
        Coder::Fast => "hybrid-fast",
        Coder::Keys => "hybrid-keys",
        Coder::Quick => "hybrid-quick",
        Coder::Tree(eecvs_nostd::Effort::One) => "hybrid-tree-1",
        Coder::Tree(eecvs_nostd::Effort::Two) => "hybrid-tree-2",
        Coder::Tree(eecvs_nostd::Effort::Three) => "hybrid-tree-3",
    }
}

/// Returns the name of a transform's rows.
#[must_use]
pub const fn transform_name(transform: Transform) -> &'static str {
    match transform {
        Transform::Dct => "transform-dct",
        Transform::Dtft => "transform-dtft",
        Transform::Dwt => "transform-dwt",
    }
}

/// Returns the name of a transform's rows with an adaptive coder.
#[must_use]
pub const fn coded_name(transform: Transform, coder: Coder) -> &'static str {
    match (transform, coder) {
        (Transform::Dct, Coder::Fast) => "transform-dct-fast",
        (Transform::Dct, _) => "transform-dct-dense",
        (Transform::Dtft, Coder::Fast) => "transform-dtft-fast",
        (Transform::Dtft, _) => "transform-dtft-dense",
        (Transform::Dwt, Coder::Fast) => "transform-dwt-fast",
        (Transform::Dwt, _) => "transform-dwt-dense",
    }
}

/// Measures everything on a recording; calls `progress` after each row.
///
/// # Errors
/// Fails if a codec or a peer breaks its promise; the message names it.
pub fn measure(source: &Source, effort: Effort, progress: &mut dyn FnMut()) -> Result<Vec<Row>> {
    let mut subject = Subject {
        source,
        volume: ours::grid(source).volume(&source.events),
        rows: Vec::new(),
        progress,
    };
    for coder in CODERS {
        subject.hybrid(coder, Fidelity::Lossless)?;
        for tolerance_us in effort.tolerances_us {
            subject.hybrid(coder, Fidelity::ToleranceUs(*tolerance_us))?;
        }
        for bins in effort.bins {
            subject.hybrid(coder, Fidelity::Bins(*bins))?;
        }
    }
    for coder in LOSSLESS {
        subject.hybrid(coder, Fidelity::Lossless)?;
    }
    for coder in OWN_WINDOWS {
        subject.own_windows(coder)?;
    }
    for transform in Transform::ALL {
        for m in effort.m {
            subject.transform(transform, *m)?;
        }
    }
    for peer in lossless::peers() {
        subject.peer(peer)?;
    }
    for stored in Stored::ALL {
        subject.tore(stored)?;
    }
    for bins in effort.voxel_bins {
        for stored in Stored::ALL {
            subject.voxel(*bins, stored)?;
        }
    }
    Ok(subject.rows)
}

/// Measures up to three times, as long as that takes less than a second, and returns the row with the least time of
/// each direction.
fn quickest(measure: &mut dyn FnMut() -> Result<Row>) -> Result<Row> {
    let started = Instant::now();
    let mut best = measure()?;
    for _ in 1..3 {
        if started.elapsed() >= Duration::from_secs(1) {
            break;
        }
        let next = measure()?;
        best.seconds = best.seconds.min(next.seconds);
        let both = best.decode_seconds.into_iter().chain(next.decode_seconds);
        best.decode_seconds = both.reduce(f64::min);
    }
    Ok(best)
}

/// A recording that is being measured.
struct Subject<'s> {
    source: &'s Source,
    volume: Volume,
    rows: Vec<Row>,
    progress: &'s mut dyn FnMut(),
}

impl Subject<'_> {
    fn hybrid(&mut self, coder: Coder, fidelity: Fidelity) -> Result<()> {
        let (promise, setting) = (Promise::of(fidelity), check::setting(fidelity));
        let codec = coder_name(coder);
        let mut once = || -> Result<Row> {
            let decoded = ours::hybrid(self.source, Hybrid { coder, fidelity })?;
            let row = self.row(codec, &setting, decoded.file.len(), decoded.seconds);
            let row = self.promised(row, promise, &decoded.events)?;
            let decode_seconds = (promise == Promise::Lossless).then_some(decoded.decode_seconds);
            Ok(Row {
                decode_seconds,
                ..row
            })
        };
        let row = match promise {
            Promise::Lossless => quickest(&mut once),
            Promise::Within(_) | Promise::Counts => once(),
        };
        let row = row.with_context(|| self.name(codec, &setting))?;
        self.push(row);
        Ok(())
    }

    fn own_windows(&mut self, coder: Coder) -> Result<()> {
        let (codec, setting) = (coder_name(coder), OWN_WINDOWS_SETTING);
        let measured = || -> Result<Row> {
            let decoded = ours::own_windows(self.source, coder)?;
            let row = self.row(codec, setting, decoded.file.len(), decoded.seconds);
            let row = self.promised(row, Promise::Lossless, &decoded.events)?;
            Ok(Row {
                decode_seconds: Some(decoded.decode_seconds),
                ..row
            })
        };
        let row = measured().with_context(|| self.name(codec, setting))?;
        self.push(row);
        Ok(())
    }

    fn transform(&mut self, transform: Transform, m: u8) -> Result<()> {
        let (codec, setting) = (transform_name(transform), format!("M = {m}"));
        let measured = || -> Result<(Row, Vec<u8>)> {
            let decoded = ours::transform(self.source, transform, m)?;
            let row = self.row(codec, &setting, decoded.file.len(), decoded.seconds);
            let row = self.promised(row, Promise::Counts, &decoded.events)?;
            let volume = decoded.coefficients.as_ref();
            let row = Row {
                coefficients_nmse: volume.and_then(|volume| self.volume.nmse(volume)),
                ..row
            };
            Ok((row, decoded.file))
        };
        let (row, plain) = measured().with_context(|| self.name(codec, &setting))?;
        self.push(row.clone());
        for coder in [Coder::Fast, Coder::Dense] {
            let codec = coded_name(transform, coder);
            let coded = ours::coded(self.source, transform, m, coder, &plain);
            let (bytes, seconds) = coded.with_context(|| self.name(codec, &setting))?;
            // The decoded events are those of the plain coefficients.
            let of = self.row(codec, &setting, bytes, seconds);
            self.push(Row {
                codec,
                bits_per_event: of.bits_per_event,
                seconds,
                ..row.clone()
            });
        }
        Ok(())
    }

    fn peer(&mut self, peer: lossless::Peer) -> Result<()> {
        let (codec, setting) = (peer.name(), "lossless");
        let mut measured = || -> Result<Row> {
            let stored = peer.round_trip(self.source)?;
            let row = self.row(codec, setting, stored.bytes, stored.seconds);
            let row = self.promised(row, Promise::Lossless, &stored.events)?;
            Ok(Row {
                decode_seconds: Some(stored.decode_seconds),
                ..row
            })
        };
        let row = quickest(&mut measured).with_context(|| self.name(codec, setting))?;
        self.push(row);
        Ok(())
    }

    fn tore(&mut self, stored: Stored) -> Result<()> {
        let mut tore = Tore::new(self.source.sensor, tore::DEPTH);
        let setting = tore.range().type_name(stored);
        let (made, events) = self.arrays(&mut tore, stored, &mut |_, _| ())?;
        let row = self.row("tore", setting, made.array_bytes, made.seconds);
        let row = self.distorted(row, &events)?;
        self.push(row);
        Ok(())
    }

    /// Measures a voxel grid with the metrics of frames only; adds the volume error if it has as many bins as the
    /// box volume.
    fn voxel(&mut self, bins: usize, stored: Stored) -> Result<()> {
        let mut voxel = Voxel::new(self.source.sensor, bins);
        let setting = format!("{bins} bins, {}", voxel.range().type_name(stored));
        let (grid, sensor) = (ours::grid(self.source), self.source.sensor);
        let mut cells = Vec::new();
        let has_volume = bins == BINS;
        let (made, events) = self.arrays(&mut voxel, stored, &mut |window, array| {
            if !has_volume {
                return;
            }
            for (pixel, codes) in array.pixels.iter().zip(array.codes.chunks(bins)) {
                let (x, y) = sensor.pixel(*pixel).unwrap_or_default();
                let first = grid.cell(window.number, x, y, 0);
                let values = codes.iter().map(|code| array.quantiser.value(*code));
                cells.extend((first..).zip(values));
            }
        })?;
        let row = self.row("voxel", &setting, made.array_bytes, made.seconds);
        let found = self.compare(&events)?;
        let volume = has_volume.then(|| Volume::new(cells));
        self.push(Row {
            mse: Some(found.mse),
            ssim: Some(found.ssim),
            volume_nmse: volume.and_then(|volume| self.volume.nmse(&volume)),
            ..row
        });
        Ok(())
    }

    /// Makes the arrays of a recording and decodes their events.
    fn arrays<R: Representation>(
        &self,
        representation: &mut R,
        stored: Stored,
        visit: &mut dyn FnMut(&Window<'_>, &StoredArray),
    ) -> Result<(Made, Vec<Event>)> {
        let (source, mut events) = (self.source, Vec::new());
        let made = representation::arrays(
            representation,
            source,
            stored,
            &mut |representation, window, array| {
                visit(window, array);
                let sensor = source.sensor;
                events.extend(representation::decode(
                    representation,
                    sensor,
                    window,
                    array,
                ));
                Ok(())
            },
        )?;
        Ok((made, events))
    }

    fn push(&mut self, row: Row) {
        self.rows.push(row);
        (self.progress)();
    }

    fn name(&self, codec: &str, setting: &str) -> String {
        format!("{}, {codec}, {setting}", self.source.name)
    }

    /// Makes a row without metrics.
    fn row(&self, codec: &'static str, setting: &str, bytes: usize, seconds: f64) -> Row {
        Row {
            recording: self.source.name.clone(),
            codec,
            setting: setting.to_owned(),
            events: self.source.events.len() as u64,
            bits_per_event: 8.0 * bytes as f64 / self.source.events.len() as f64,
            emd_pixel_us: None,
            mse: None,
            ssim: None,
            volume_nmse: None,
            coefficients_nmse: None,
            seconds,
            decode_seconds: None,
        }
    }

    /// Checks the promise and adds the metrics of events. The metrics of a lossless result are known, so it is not
    /// compared again.
    fn promised(&self, row: Row, promise: Promise, events: &[Event]) -> Result<Row> {
        check(promise, &self.source.events, events)?;
        if promise == Promise::Lossless {
            return Ok(Row {
                emd_pixel_us: Some(0.0),
                mse: Some(0.0),
                ssim: Some(1.0),
                volume_nmse: Some(0.0),
                ..row
            });
        }
        self.distorted(row, events)
    }

    fn distorted(&self, row: Row, events: &[Event]) -> Result<Row> {
        let found = self.compare(events)?;
        let volume = ours::grid(self.source).volume(events);
        Ok(Row {
            emd_pixel_us: Some(found.emd_pixel_us),
            mse: Some(found.mse),
            ssim: Some(found.ssim),
            volume_nmse: self.volume.nmse(&volume),
            ..row
        })
    }

    fn compare(&self, events: &[Event]) -> Result<Comparison> {
        let (sensor, events) = (self.source.sensor, Arc::from(events));
        Ok(compare(
            &|| Ok(Box::new(self.source.reader())),
            &|| Ok(Box::new(Memory::new(sensor, Arc::clone(&events)))),
            WINDOW_US.into(),
            &mut |_| (),
        )?)
    }
}

#[cfg(test)]
mod tests;
