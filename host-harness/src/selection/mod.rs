//! Measures what a largest mean error of times, or of the smoothed volume, costs, against fixed settings that are no worse.
//!
//! ```text
//! input, cropped -> every fixed setting | tolerances | largest errors       -> file -> bits per event
//!                                                                               -> events -> emd_pixel, V4
//! per error asked for: the fewest bits of each family -> row
//! ```
//!
//! Windows are of 32,768 us everywhere. Bits are those of the whole file, as in the other studies.

pub mod errors;
pub mod few;
pub mod input;
pub mod settings;

use std::num::NonZeroU32;

use anyhow::{Context, Result, ensure};
use eecvs::encode::Codec;
use eecvs::reconstruct::events::Finder;
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_bench::record_file::{Name, name};
use eecvs_bench::source::Source;
use eecvs_nostd::{Coder, Config, Event, Fidelity, Hybrid, Mode, Thresholds, Transform};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::rate::check::{Promise, check, setting};
use crate::round_trip::{Encoded, config, decode};
use errors::{Errors, Original};
use settings::Setting;

/// How much is measured.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Duration of an emulated scene in us.
    pub scene_us: u64,
    /// Most events of an input, unless its first window has more.
    pub events: usize,
    /// Numbers M of coefficients per transform.
    pub m: &'static [(Transform, &'static [u8])],
    /// Numbers M of coefficients where the density chooses the transform (eq. 3).
    pub eq3_m: &'static [u8],
    /// Steps of the quantiser, as powers of two.
    pub steps_log2: &'static [i8],
    /// Mean errors of times that are asked for, in us.
    pub times_us: &'static [u32],
    /// More of them, of which only the volumes are compared.
    pub more_times_us: &'static [u32],
    /// Errors of volumes that are asked for.
    pub volumes: &'static [f64],
    /// Most tolerances that are tried per coder and error asked for, and most mean errors per error of volumes.
    pub tries: usize,
}

impl Effort {
    /// The effort for published figures.
    pub const FULL: Self = Self {
        scene_us: 500_000,
        events: 60_000,
        m: &[
            (Transform::Dct, &[2, 3, 4, 6, 8, 12, 16, 24]),
            (Transform::Dtft, &[4, 8, 16]),
            (Transform::Dwt, &[2, 4, 8, 16, 32]),
        ],
        eq3_m: &[4, 8, 16],
        steps_log2: &[-4, -2, -1, 0, 1],
        times_us: &[32, 128, 512, 1024, 2048, 4096],
        more_times_us: &[8192],
        volumes: &[0.5, 0.1, 0.01],
        tries: 5,
    };
    /// The effort for a check that everything works.
    pub const QUICK: Self = Self {
        scene_us: 50_000,
        events: 10_000,
        m: &[(Transform::Dct, &[2, 8]), (Transform::Dwt, &[8])],
        eq3_m: &[8],
        steps_log2: &[-1],
        times_us: &[512, 2048],
        more_times_us: &[],
        volumes: &[0.5],
        tries: 3,
    };

    /// Returns the number of rows per input.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.times_us.len() + self.volumes.len()
    }
}

/// Coder of events that takes the fewest bits. It has no counterpart for coefficients: these are by the dense coder,
/// which takes the fewest of theirs.
pub const FEWEST: Coder = Coder::Tree(eecvs_nostd::Effort::Three);

/// [`Row::error`] of `emd_pixel`, in us.
pub const TIMES: Name = "times";
/// [`Row::error`] of the volume of [`errors`].
pub const VOLUME: Name = "volume";

/// The fewest bits of every family on an input for an error asked for; the fields are its JSON keys. `None` if no
/// setting of the family has so small an error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the scene or recording.
    pub input: String,
    /// Number of events.
    pub events: u64,
    /// [`TIMES`] or [`VOLUME`].
    #[serde(deserialize_with = "name")]
    pub error: Name,
    /// Largest error that a setting may have.
    pub most: f64,
    /// Fixed transforms by plain codes.
    pub plain: Option<Cheapest>,
    /// Fixed transforms by plain codes or the fast coder.
    pub fast: Option<Cheapest>,
    /// Fixed transforms by the dense coder.
    pub dense: Option<Cheapest>,
    /// The density's transform (eq. 3) by plain codes or the fast coder.
    pub eq3_fast: Option<Cheapest>,
    /// The density's transform (eq. 3) by the dense coder.
    pub eq3_dense: Option<Cheapest>,
    /// Events with a fixed tolerance by the keys coder.
    pub tolerance_keys: Option<Cheapest>,
    /// Events with a fixed tolerance by the dense coder.
    pub tolerance_dense: Option<Cheapest>,
    /// Events with a fixed tolerance by [`FEWEST`].
    pub tolerance_tree: Option<Cheapest>,
    /// Events with a largest mean error by the keys coder.
    pub best_keys: Option<Cheapest>,
    /// Events with a largest mean error by the dense coder.
    pub best_dense: Option<Cheapest>,
    /// Events with a largest mean error by [`FEWEST`].
    pub best_tree: Option<Cheapest>,
}

/// The setting with the fewest bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cheapest {
    /// `DCT, M = 3, step 2^-2, plain`, `255 us`, `128 us on average`.
    pub setting: String,
    /// 8 * bytes of the file / events.
    pub bits_per_event: f64,
    /// Error that the setting has, of the row's kind.
    pub error: f64,
}

/// Measures all inputs on every thread, and returns their rows in the order of the inputs; `progress` is called after
/// each setting.
///
/// # Errors
/// Fails if a file does not decode to what its setting promises; the message names input and setting.
pub fn measure(
    inputs: &[Source],
    effort: Effort,
    progress: &(dyn Fn() + Sync),
) -> Result<Vec<Row>> {
    let rows: Vec<Vec<Row>> = inputs
        .par_iter()
        .with_max_len(1)
        .map(|input| Subject::new(input, progress)?.rows(effort))
        .collect::<Result<_>>()?;
    Ok(rows.concat())
}

/// A measured setting.
#[derive(Debug, Clone)]
struct Point {
    setting: String,
    bits_per_event: f64,
    errors: Errors,
}

/// Returns the point with the fewest bits among those with an error of at most `most`.
fn cheapest<'p>(
    points: impl Iterator<Item = &'p Point>,
    error: fn(&Errors) -> f64,
    most: f64,
) -> Option<Cheapest> {
    points
        .filter(|point| error(&point.errors) <= most)
        .min_by(|a, b| a.bits_per_event.total_cmp(&b.bits_per_event))
        .map(|point| Cheapest {
            setting: point.setting.clone(),
            bits_per_event: point.bits_per_event,
            error: error(&point.errors),
        })
}

/// Points of coefficients by each of the coders.
#[derive(Debug, Default)]
struct Coefficients {
    plain: Vec<Point>,
    fast: Vec<Point>,
    dense: Vec<Point>,
}

/// Points of events by one coder.
#[derive(Debug, Default)]
struct Events {
    tolerances: Vec<Point>,
    /// With the mean error that was asked for, in us.
    best: Vec<(u32, Point)>,
}

/// An input that is being measured.
struct Subject<'s> {
    source: &'s Source,
    original: Original,
    thresholds: Thresholds,
    progress: &'s (dyn Fn() + Sync),
}

impl<'s> Subject<'s> {
    fn new(source: &'s Source, progress: &'s (dyn Fn() + Sync)) -> Result<Self> {
        Ok(Self {
            source,
            original: Original::new(&source.events),
            thresholds: ThresholdsFile::scenes()?.thresholds()?,
            progress,
        })
    }

    fn rows(&self, effort: Effort) -> Result<Vec<Row>> {
        let fixed = self.coefficients(&settings::fixed(&effort))?;
        let eq3 = self.coefficients(&settings::by_density(&effort))?;
        let keys = self.events(Coder::Keys, &effort)?;
        let dense = self.events(Coder::Dense, &effort)?;
        let tree = self.events(FEWEST, &effort)?;
        let row = |error_name, error: fn(&Errors) -> f64, most: f64| {
            let of = |points: &[Point]| cheapest(points.iter(), error, most);
            let fast = |of: &Coefficients| cheapest(of.plain.iter().chain(&of.fast), error, most);
            // Of times, only what was asked for counts: a smaller mean error is another request.
            let best = |events: &Events| {
                let asked = events.best.iter();
                let asked = asked.filter(|(us, _)| error_name == VOLUME || f64::from(*us) == most);
                cheapest(asked.map(|(_, point)| point), error, most)
            };
            Row {
                input: self.source.name.clone(),
                events: self.source.events.len() as u64,
                error: error_name,
                most,
                plain: of(&fixed.plain),
                fast: fast(&fixed),
                dense: of(&fixed.dense),
                eq3_fast: fast(&eq3),
                eq3_dense: of(&eq3.dense),
                tolerance_keys: of(&keys.tolerances),
                tolerance_dense: of(&dense.tolerances),
                tolerance_tree: of(&tree.tolerances),
                best_keys: best(&keys),
                best_dense: best(&dense),
                best_tree: best(&tree),
            }
        };
        let times = effort.times_us.iter();
        let times = times.map(|us| row(TIMES, |errors| errors.emd_pixel_us, f64::from(*us)));
        let volumes = effort.volumes.iter();
        let volumes = volumes.map(|most| row(VOLUME, |errors| errors.volume, *most));
        Ok(times.chain(volumes).collect())
    }

    /// Measures coefficients by every coder; their events are the same, so they are decoded once.
    fn coefficients(&self, settings: &[Setting]) -> Result<Coefficients> {
        let mut points = Coefficients::default();
        for setting in settings {
            let name = setting.name();
            let named = || format!("{}, {name}", self.source.name);
            let file = |mode| -> Result<Vec<u8>> {
                let setup = setting.config(config(
                    self.source,
                    self.thresholds,
                    mode,
                    setting.transform,
                    setting.m,
                ))?;
                Ok(Encoded::new(self.source, setup)?.file)
            };
            let plain = file(Mode::Transform).with_context(named)?;
            let (errors, _) = self.decoded(&plain, Promise::Counts).with_context(named)?;
            let fast = file(Mode::Coefficients(Coder::Fast)).with_context(named)?;
            let dense = file(Mode::Coefficients(Coder::Dense)).with_context(named)?;
            for (of, file, coder) in [
                (&mut points.plain, plain, ", plain"),
                (&mut points.fast, fast, ", fast"),
                (&mut points.dense, dense, ""),
            ] {
                of.push(self.point(format!("{name}{coder}"), file.len(), errors));
            }
            (self.progress)();
        }
        Ok(points)
    }

    /// Measures events by one coder, with tolerances and with mean errors: those that are asked for, and the largest
    /// found with the errors of volumes that are asked for.
    fn events(&self, coder: Coder, effort: &Effort) -> Result<Events> {
        let mut points = Events::default();
        let Events { tolerances, best } = &mut points;
        let mut of_tolerance = |tolerance_us| {
            let point = self.tolerance(coder, tolerance_us)?;
            let errors = point.errors;
            tolerances.push(point);
            Ok(errors)
        };
        let mut of_best = |most_us| {
            let point = self.best(coder, most_us)?;
            let errors = point.errors;
            best.push((most_us, point));
            Ok(errors)
        };
        for most_us in effort.times_us.iter().chain(effort.more_times_us) {
            of_best(*most_us)?;
            let search = settings::Search::of_times(*most_us);
            search.run(effort.tries, &mut of_tolerance)?;
        }
        for most in effort.volumes {
            let mean = settings::Search::of_volume(*most);
            mean.run(effort.tries, &mut of_best)?;
            mean.tolerance().run(effort.tries, &mut of_tolerance)?;
        }
        for most in effort.volumes {
            // For no mean error that is asked for.
            best.push((0, self.within_volume(coder, *most)?));
        }
        Ok(points)
    }

    fn tolerance(&self, coder: Coder, tolerance_us: u32) -> Result<Point> {
        let fidelity = Fidelity::ToleranceUs(tolerance_us);
        let setup = self.hybrid(coder, fidelity);
        self.of_events(setting(fidelity), setup, Promise::of(fidelity))
    }

    fn best(&self, coder: Coder, most_us: u32) -> Result<Point> {
        let setup = Config {
            max_emd_us: NonZeroU32::new(most_us),
            ..self.hybrid(coder, Fidelity::Lossless)
        };
        let name = format!("{most_us} us on average");
        let point = self.of_events(name, setup, Promise::Counts)?;
        ensure!(
            point.errors.emd_pixel_us <= f64::from(most_us),
            "{}, {}: the mean error is {:.3} us; please report this",
            self.source.name,
            point.setting,
            point.errors.emd_pixel_us
        );
        Ok(point)
    }

    fn within_volume(&self, coder: Coder, most: f64) -> Result<Point> {
        let setup = Codec {
            max_nmse: Some(most),
            ..Codec::from(self.hybrid(coder, Fidelity::Lossless))
        };
        let name = format!("volumes within {most}");
        self.of_events(name, setup, Promise::Counts)
    }

    fn hybrid(&self, coder: Coder, fidelity: Fidelity) -> Config {
        let mode = Mode::Hybrid(Hybrid { coder, fidelity });
        config(self.source, self.thresholds, mode, None, 16)
    }

    fn of_events<'h>(
        &self,
        name: String,
        setup: impl Into<Codec<'h>>,
        promise: Promise,
    ) -> Result<Point> {
        let measured = || -> Result<(Errors, usize)> {
            let Encoded { file, .. } = Encoded::new(self.source, setup)?;
            self.decoded(&file, promise)
        };
        let (errors, bytes) =
            measured().with_context(|| format!("{}, {name}", self.source.name))?;
        (self.progress)();
        Ok(self.point(name, bytes, errors))
    }

    /// Decodes a file, checks its promise, and returns its errors and its size in bytes.
    fn decoded(&self, file: &[u8], promise: Promise) -> Result<(Errors, usize)> {
        let events: Vec<Event> = decode(file, Finder::Peaks, &mut |_| Ok(()))?;
        check(promise, &self.source.events, &events)?;
        Ok((self.original.errors(&events), file.len()))
    }

    fn point(&self, setting: String, bytes: usize, errors: Errors) -> Point {
        Point {
            setting,
            bits_per_event: 8.0 * bytes as f64 / self.source.events.len() as f64,
            errors,
        }
    }
}

#[cfg(test)]
mod tests;
