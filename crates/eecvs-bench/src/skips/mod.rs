//! What the encoder saves by not doing things: each kind of skipping against the same without it.
//!
//! ```text
//! windows of a recording -> encoder ----------------> frames   the same, or the run ends
//!                        \-> plain encoder, skips off -> frames
//! ```
//!
//! Times are of [`plain`], with everything skipped and with one kind of it left out; sizes are of
//! frames, where the packer can make the other frame, and else counted by a formula.

pub mod plain;
pub mod source;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use eecvs::encode::HostStorage;
use eecvs_nostd::pack::bits_lsb_first::exp_golomb;
use eecvs_nostd::transform::{Basis, Dct, Dtft, Dwt};
use eecvs_nostd::window::SEGMENT_PIXELS;
use eecvs_nostd::{
    Coded, Config, Descriptor, Encoded, Encoder, FRAME_BYTES_MAX, Frame, Header, Level, Mode,
    NextStart, Push, Thresholds, Transform, WindowConfig, bitmap_words, segments,
};
use serde::{Deserialize, Serialize};

use crate::record_file::{Name, name};
use plain::{Plain, Skips};
use source::{Source, WINDOW_US, Window};

/// M: that of the paper's times.
const PARAMETER_M: u8 = 8;
/// Windows measured of a recording, spread over it; of a quick run.
const WINDOWS: [usize; 2] = [8, 2];
/// Repetitions at the least, of which the shortest counts; of a quick run.
const REPETITIONS: [usize; 2] = [9, 2];
/// Time of all repetitions of a window at the least; of a quick run.
const LEAST: [Duration; 2] = [Duration::from_millis(100), Duration::ZERO];
/// Repetitions at the most.
const REPETITIONS_MAX: u128 = 1000;

const US: &str = "us/window";
const BITS: &str = "bits/window";
const SINGLES: &str = "single events as cells";

const NO_ROOM: &str = "a frame has no room for its window";

/// How a figure came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum How {
    /// Both were run and timed.
    Timed,
    /// Both were packed by the core.
    Packed,
    /// Counted: of what is not done there is a formula alone.
    Counted,
}

impl How {
    /// Lower-case name, as in JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Timed => "timed",
            Self::Packed => "packed",
            Self::Counted => "counted",
        }
    }
}

/// One kind of skipping; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the recording or scene.
    #[serde(deserialize_with = "name")]
    pub recording: Name,
    /// Transform.
    #[serde(deserialize_with = "name")]
    pub transform: Name,
    /// M.
    pub m: u8,
    /// What is skipped. `everything` is the core's encoder against the plain one that skips nothing,
    /// `nothing` against the one that skips the same: the code itself.
    #[serde(deserialize_with = "name")]
    pub skip: Name,
    /// Of both figures: `us`, `bits` or `coefficients`, per `window` or `recording`.
    #[serde(deserialize_with = "name")]
    pub unit: Name,
    /// With the skipping.
    pub with: f64,
    /// Without.
    pub without: f64,
    /// 100 (1 - `with` / `without`).
    pub saved_percent: f64,
    /// Timed, packed or counted.
    pub how: How,
    /// What was counted on the way, in all windows measured.
    #[serde(skip_deserializing)]
    pub counts: BTreeMap<&'static str, u64>,
}

/// Measures all transforms on `sources`; `progress` is called after each of each.
///
/// # Errors
/// A frame of the plain encoder that is not the core's.
pub fn measure(sources: &[Source], is_quick: bool, progress: &mut dyn FnMut()) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for source in sources {
        for transform in Transform::ALL {
            let point = Point::new(source, transform, is_quick);
            match transform {
                Transform::Dct => point.measure::<Dct>(&mut rows),
                Transform::Dtft => point.measure::<Dtft>(&mut rows),
                Transform::Dwt => point.measure::<Dwt>(&mut rows),
            }?;
            progress();
        }
    }
    Ok(rows)
}

/// Times that [`measure`] calls `progress`.
#[must_use]
pub const fn steps(sources: usize) -> usize {
    sources * Transform::ALL.len()
}

/// A recording, a transform, and some of its windows.
struct Point<'s> {
    source: &'s Source,
    windows: Vec<&'s Window>,
    transform: Transform,
    is_quick: bool,
}

/// The core's frames of the windows.
struct Frames {
    headers: Vec<Header>,
    frames: Vec<Vec<u8>>,
}

impl Frames {
    fn bits(&self) -> u64 {
        self.frames.iter().map(|frame| 8 * frame.len() as u64).sum()
    }

    /// Calls `each` with the descriptors of every frame.
    fn for_each(&self, mut each: impl FnMut(&Header, Descriptor)) -> Result<()> {
        for frame in &self.frames {
            let Ok(frame) = Frame::parse(frame) else {
                bail!("a frame of the encoder does not parse: please report this");
            };
            for descriptor in frame.descriptors() {
                let Ok(descriptor) = descriptor else {
                    bail!("a frame of the encoder does not unpack: please report this");
                };
                each(&frame.header, descriptor);
            }
        }
        Ok(())
    }
}

/// Figures with a kind of skipping, and without.
type Figures = (f64, f64);

impl<'s> Point<'s> {
    fn new(source: &'s Source, transform: Transform, is_quick: bool) -> Self {
        let all = source.windows.len();
        let count = WINDOWS[usize::from(is_quick)].min(all);
        Self {
            source,
            windows: (0..count)
                .map(|i| &source.windows[i * all / count])
                .collect(),
            transform,
            is_quick,
        }
    }

    /// K
    fn grid(&self) -> u16 {
        self.transform.grid_size(PARAMETER_M, None)
    }

    fn config(&self, m: u8) -> Config {
        Config {
            transform: Some(self.transform),
            m,
            grid: Some(self.grid()),
            ..Config::new(
                WindowConfig::new(self.source.sensor, WINDOW_US),
                // Unused, since the transform is given.
                const { Thresholds::new(0, 0).unwrap() },
                Mode::Transform,
            )
        }
    }

    fn storage(&self) -> HostStorage {
        let windows = self.source.windows.iter();
        let most = windows.map(|window| window.events.len()).max();
        HostStorage::new(self.source.sensor, most.unwrap_or(1))
    }

    fn measure<B: Basis>(&self, rows: &mut Vec<Row>) -> Result<()> {
        let frames = self.frames(PARAMETER_M)?;
        let counts = self.counts(&frames)?;
        let mut add = |skip, unit, (with, without): Figures, how| {
            rows.push(Row {
                recording: self.source.name,
                transform: self.transform.name(),
                m: PARAMETER_M,
                skip,
                unit,
                with,
                without,
                saved_percent: 100.0 * (1.0 - with / without),
                how,
                counts: counts.clone(),
            });
        };
        self.walks::<B>(&frames, &mut add)?;
        self.gaps(&frames, &mut add)?;
        if self.transform == Transform::Dwt {
            self.zeros(&frames, &mut add)?;
        }
        if self.grid() > u16::from(PARAMETER_M) {
            self.pruning(&frames, &mut add)?;
        }
        if self.transform == Transform::Dct {
            self.empty_windows(&mut add)?;
        }
        Ok(())
    }

    /// The core's frames with M = `m`.
    fn frames(&self, m: u8) -> Result<Frames> {
        let mut out = vec![0; FRAME_BYTES_MAX];
        let mut storage = self.storage();
        let mut encoder = storage.encoder(self.config(m))?;
        let (mut headers, mut frames) = (Vec::new(), Vec::new());
        for window in &self.windows {
            let encoded = encode(&mut encoder, window, &mut out)?;
            headers.push(encoded.header);
            frames.push(out[encoded.range].to_vec());
        }
        Ok(Frames { headers, frames })
    }

    /// What there is in the windows.
    fn counts(&self, frames: &Frames) -> Result<BTreeMap<&'static str, u64>> {
        let sensor = self.source.sensor;
        let segments = segments(sensor.width, sensor.height);
        let windows = self.windows.len() as u64;
        let mut active_segments = 0;
        for window in &self.windows {
            let mut is_active = vec![false; segments];
            let stride = usize::from(sensor.width.div_ceil(SEGMENT_PIXELS));
            for event in &window.events {
                let segment = usize::from(event.y) * stride + usize::from(event.x / SEGMENT_PIXELS);
                is_active[segment] = true;
            }
            active_segments += is_active.iter().filter(|is_active| **is_active).count() as u64;
        }
        let (mut active_pixels, mut single_pixels) = (0, 0);
        let (mut levels, mut zero_levels, mut trailing_zero_levels) = (0, 0, 0);
        frames.for_each(|_, pixel| {
            active_pixels += 1;
            let Coded::Levels(sent) = &pixel.coded else {
                single_pixels += 1;
                return;
            };
            let sent = sent.iter().filter(|level| level.k > 0);
            let is_zero = |level: &&Level| (level.re, level.im) == (0, 0);
            levels += sent.clone().count() as u64;
            zero_levels += sent.clone().filter(is_zero).count() as u64;
            trailing_zero_levels += sent.rev().take_while(is_zero).count() as u64;
        })?;
        let events = self.windows.iter().map(|window| window.events.len() as u64);
        Ok([
            ("windows", windows),
            ("events", events.sum()),
            ("pixels", windows * u64::from(sensor.pixels())),
            ("active_pixels", active_pixels),
            ("single_pixels", single_pixels),
            ("segments", windows * segments as u64),
            ("active_segments", active_segments),
            ("occupancy_words", windows * bitmap_words(segments) as u64),
            ("levels", levels),
            ("zero_levels", zero_levels),
            ("trailing_zero_levels", trailing_zero_levels),
            ("empty_windows", self.source.empty_windows),
        ]
        .into())
    }

    /// The plain encoder with everything skipped and with one kind left out, and the core.
    fn walks<B: Basis>(
        &self,
        frames: &Frames,
        add: &mut impl FnMut(&'static str, &'static str, Figures, How),
    ) -> Result<()> {
        let all = Skips::ALL;
        let looked_at = Skips {
            segments: false,
            pixels: false,
            ..all
        };
        let mut runs = vec![
            ("nothing", all),
            (
                "inactive pixels, transformed",
                Skips {
                    transforms: false,
                    ..looked_at
                },
            ),
            (
                SINGLES,
                Skips {
                    singles: false,
                    ..all
                },
            ),
            ("everything", Skips::NONE),
        ];
        match self.transform {
            // Where a pixel costs least, going to it costs most.
            Transform::Dct => runs.extend([
                (
                    "empty segments",
                    Skips {
                        segments: false,
                        ..all
                    },
                ),
                ("inactive pixels, looked at", looked_at),
            ]),
            Transform::Dtft => {}
            Transform::Dwt => runs.push((
                "butterflies of few events",
                Skips {
                    butterflies: false,
                    ..all
                },
            )),
        }

        let header = frames.headers.first().context("no windows")?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        // One for all, so that none of them finds its memory nearer than the others do.
        let mut plain: Plain<B> = Plain::new(header);
        let mut general_bits = 0;
        for (skip, skips) in &runs {
            plain.skip(*skips);
            for ((window, header), expected) in self.windows(frames).zip(&frames.frames) {
                let frame = plain.frame(&window.events, *header, &mut out);
                let frame = &out[frame.ok().context(NO_ROOM)?];
                if *skip == SINGLES {
                    general_bits += 8 * frame.len() as u64;
                }
                ensure!(
                    !skips.singles || frame == expected,
                    "{}, {}: not skipping {skip} gives another frame: please report this",
                    self.source.name,
                    self.transform.name()
                );
            }
        }

        let mut storage = self.storage();
        let mut core = storage.encoder(self.config(PARAMETER_M))?;
        let us = self.time(1 + runs.len(), &mut |run, i, window| {
            if let Some((_, skips)) = runs.get(run) {
                plain.skip(*skips);
                let frame = plain.frame(&window.events, frames.headers[i], &mut out);
                frame.ok().context(NO_ROOM)?;
            } else {
                encode(&mut core, window, &mut out)?;
            }
            Ok(())
        })?;
        let core = us[runs.len()];
        for ((skip, _), without) in runs.iter().zip(&us) {
            let with = match *skip {
                "nothing" | "everything" => core,
                _ => us[0],
            };
            add(skip, US, (with, *without), How::Timed);
        }
        add(
            SINGLES,
            BITS,
            (
                self.per_window(frames.bits()),
                self.per_window(general_bits),
            ),
            How::Packed,
        );
        Ok(())
    }

    /// Where the active pixels are: gaps, against a bit for each pixel of the sensor.
    fn gaps(
        &self,
        frames: &Frames,
        add: &mut impl FnMut(&'static str, &'static str, Figures, How),
    ) -> Result<()> {
        let sensor = self.source.sensor;
        let mut gap_bits = 0;
        let (mut frame, mut next) = (None, 0);
        frames.for_each(|header, pixel| {
            if frame.replace(header.t0_us) != Some(header.t0_us) {
                next = 0;
            }
            let index = u32::from(pixel.y) * u32::from(sensor.width) + u32::from(pixel.x);
            let order = (sensor.pixels() / header.window_events.max(1))
                .max(1)
                .ilog2();
            gap_bits += u64::from(exp_golomb(index - next, order).1);
            next = index + 1;
        })?;
        let bits = frames.bits();
        let bitmap_bits = self.windows.len() as u64 * u64::from(sensor.pixels());
        let figures = [bits, bits - gap_bits + bitmap_bits].map(|bits| self.per_window(bits));
        add(
            "inactive pixels, told by gaps",
            BITS,
            figures.into(),
            How::Counted,
        );
        Ok(())
    }

    /// Haar coefficients that are sent, against the r of every pixel; what the zeros among these
    /// would take.
    fn zeros(
        &self,
        frames: &Frames,
        add: &mut impl FnMut(&'static str, &'static str, Figures, How),
    ) -> Result<()> {
        let (mut sent, mut zeros, mut zero_bits) = (0, 0, 0);
        frames.for_each(|header, pixel| {
            let Coded::Levels(levels) = &pixel.coded else {
                return;
            };
            let is_sent = |level: &&Level| level.k > 0;
            sent += levels.iter().filter(is_sent).count() as u64;
            let left_out = (header.packing().kept() - levels.len()) as u64;
            let spread = levels.iter().filter(is_sent).fold(0, |spread, level| {
                let moved = level.re - i32::from(level.re > 0);
                spread | (moved ^ (moved >> 31)).unsigned_abs()
            });
            zeros += left_out;
            zero_bits += left_out * u64::from(u32::BITS - spread.leading_zeros() + 1);
        })?;
        let bits = frames.bits();
        let skip = "zero coefficients";
        let figures = [sent, sent + zeros].map(|count| self.per_window(count));
        add(skip, "coefficients/window", figures.into(), How::Counted);
        let figures = [bits, bits + zero_bits].map(|bits| self.per_window(bits));
        add(skip, BITS, figures.into(), How::Counted);
        Ok(())
    }

    /// M of K coefficients against all: the core both times.
    fn pruning(
        &self,
        frames: &Frames,
        add: &mut impl FnMut(&'static str, &'static str, Figures, How),
    ) -> Result<()> {
        let grid = u8::try_from(self.grid())?;
        let whole = self.frames(grid)?;
        let mut storages = [self.storage(), self.storage()];
        let [pruned, all] = &mut storages;
        let mut encoders = [
            pruned.encoder(self.config(PARAMETER_M))?,
            all.encoder(self.config(grid))?,
        ];
        let mut out = vec![0; FRAME_BYTES_MAX];
        let us = self.time(encoders.len(), &mut |run, _, window| {
            encode(&mut encoders[run], window, &mut out).map(drop)
        })?;
        let skip = "pruned coefficients";
        add(skip, US, (us[0], us[1]), How::Timed);
        let figures = [frames.bits(), whole.bits()].map(|bits| self.per_window(bits));
        add(skip, BITS, figures.into(), How::Packed);
        Ok(())
    }

    /// The whole recording, against a frame for each of its empty windows too.
    fn empty_windows(
        &self,
        add: &mut impl FnMut(&'static str, &'static str, Figures, How),
    ) -> Result<()> {
        let mut storage = self.storage();
        let mut encoder = storage.encoder(self.config(PARAMETER_M))?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        let mut bits = 0;
        for window in &self.source.windows {
            bits += 8 * encode(&mut encoder, window, &mut out)?.range.len() as u64;
        }
        let mut empty_bits = 0;
        for _ in 0..self.source.empty_windows {
            // A window of no events becomes a frame where there is something to count.
            encoder.window().count_filtered(1);
            empty_bits += 8 * finish(&mut encoder, &mut out)?.range.len() as u64;
        }
        let figures = [bits, bits + empty_bits].map(|bits| bits as f64);
        add(
            "empty windows",
            "bits/recording",
            figures.into(),
            How::Packed,
        );
        Ok(())
    }

    fn windows<'f>(
        &'f self,
        frames: &'f Frames,
    ) -> impl Iterator<Item = (&'f Window, &'f Header)> + use<'f, 's> {
        self.windows.iter().copied().zip(&frames.headers)
    }

    fn per_window(&self, figure: u64) -> f64 {
        figure as f64 / self.windows.len().max(1) as f64
    }

    /// Times of `runs` runs over the windows, in us per window: the shortest of each window, since
    /// what else the machine does only adds. The runs take turns.
    fn time(
        &self,
        runs: usize,
        run: &mut dyn FnMut(usize, usize, &Window) -> Result<()>,
    ) -> Result<Vec<f64>> {
        let mut us = vec![0.0; runs];
        for (i, window) in self.windows.iter().enumerate() {
            let mut shortest = vec![Duration::MAX; runs];
            let mut repetitions = 0;
            let mut left = REPETITIONS[usize::from(self.is_quick)];
            while left > 0 {
                let before = Instant::now();
                for (number, shortest) in shortest.iter_mut().enumerate() {
                    let started = Instant::now();
                    run(number, i, window)?;
                    *shortest = started.elapsed().min(*shortest);
                }
                if repetitions == 0 {
                    let least = LEAST[usize::from(self.is_quick)].as_nanos() * runs as u128;
                    let more = least / before.elapsed().as_nanos().max(1);
                    left = left.max(more.min(REPETITIONS_MAX) as usize);
                }
                repetitions += 1;
                left -= 1;
            }
            for (us, shortest) in us.iter_mut().zip(shortest) {
                *us += 1e6 * shortest.as_secs_f64() / self.windows.len() as f64;
            }
        }
        Ok(us)
    }
}

/// Pushes and encodes a window with the core.
fn encode(encoder: &mut Encoder<'_>, window: &Window, out: &mut [u8]) -> Result<Encoded> {
    encoder.window().follow(NextStart::at(window.start_us));
    for event in &window.events {
        ensure!(
            encoder.push(*event) == Push::Stored,
            "an event is not in its window"
        );
    }
    finish(encoder, out)
}

/// The one frame of a window.
fn finish(encoder: &mut Encoder<'_>, out: &mut [u8]) -> Result<Encoded> {
    encoder.flush();
    let encoded = encoder.next_frame(out).ok().flatten().context(NO_ROOM)?;
    ensure!(encoder.next_frame(out) == Ok(None), NO_ROOM);
    Ok(encoded)
}
