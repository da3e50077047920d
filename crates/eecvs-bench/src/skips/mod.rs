//! Measures what the encoder saves by skipping: each kind of skipping is compared with the encoder without it.
//!
//! ```text
//! windows of a recording -> encoder ----------------> frames   the same, or the run ends
//!                        \-> plain encoder, skips off -> frames
//! ```
//!
//! Times are those of [`plain`], once with everything skipped and once with one kind of skipping off. Sizes are those
//! of frames if the packer can make the frame without the skipping, and are otherwise counted by a formula. Only the
//! frames with single events sent as levels differ from the encoder's.

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

/// M of the times in the paper.
const PARAMETER_M: u8 = 8;
/// How often a quick run measures what it measures repeatedly. The times of a build with checks mean nothing: once is enough.
const QUICK: usize = if cfg!(debug_assertions) { 1 } else { 2 };
/// Maximum number of windows measured, spread over a recording: in a full run, in a quick run.
const WINDOWS: [usize; 2] = [8, QUICK];
/// Minimum number of repetitions, of which the shortest counts: in a full run, in a quick run.
const REPETITIONS: [usize; 2] = [9, QUICK];
/// Approximate minimum time of all repetitions of one run on a window: in a full run, in a quick run.
const LEAST: [Duration; 2] = [Duration::from_millis(100), Duration::ZERO];
/// Maximum number of repetitions.
const REPETITIONS_MAX: u128 = 1000;

const US: &str = "us/window";
const BITS: &str = "bits/window";
const SINGLES: &str = "single events as cells";

const NO_ROOM: &str = "a frame has no room for its window";

/// How a figure was obtained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum How {
    /// Both variants were run and timed.
    Timed,
    /// The frames of both variants were packed by the core's packer.
    Packed,
    /// The variant without the skipping was not run; a formula gives its size.
    Counted,
}

impl How {
    /// Returns the lower-case name, as in JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Timed => "timed",
            Self::Packed => "packed",
            Self::Counted => "counted",
        }
    }
}

/// What one kind of skipping saves on one recording with one transform; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the recording or scene.
    #[serde(deserialize_with = "name")]
    pub recording: Name,
    /// Name of the transform: `dct`, `dtft` or `dwt`.
    #[serde(deserialize_with = "name")]
    pub transform: Name,
    /// M.
    pub m: u8,
    /// What is skipped. `everything` compares the core's encoder with the plain encoder that skips nothing. `nothing`
    /// compares it with the plain encoder that skips the same, and so shows the effect of the code itself.
    #[serde(deserialize_with = "name")]
    pub skip: Name,
    /// Unit of `with` and `without`: `us/window`, `bits/window`, `coefficients/window` or `bits/recording`.
    #[serde(deserialize_with = "name")]
    pub unit: Name,
    /// The figure with the skipping.
    pub with: f64,
    /// The figure without the skipping.
    pub without: f64,
    /// 100 (1 - `with` / `without`); negative if the skipping costs more than it saves.
    pub saved_percent: f64,
    /// How the figures were obtained.
    pub how: How,
    /// Numbers of events, pixels, segments, levels and others, over all windows measured.
    #[serde(skip_deserializing)]
    pub counts: BTreeMap<&'static str, u64>,
}

/// Measures every kind of skipping with every transform on `sources`.
///
/// `progress` is called after each transform of each source.
///
/// # Errors
/// Fails if a frame of the plain encoder differs from the core's, or if a window does not fit into one frame.
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

/// Returns how many times [`measure`] calls `progress` for `sources` sources.
#[must_use]
pub const fn steps(sources: usize) -> usize {
    sources * Transform::ALL.len()
}

/// A recording, the windows of it that are measured, and a transform.
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

/// The figures with and without a kind of skipping.
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

    /// Returns K.
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
                // Unused, because the transform is fixed.
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

    /// Encodes the windows with the core, with M = `m`.
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

    /// Counts what the windows and their frames contain.
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

    /// Compares the plain encoder with everything skipped, the plain encoder with one kind of skipping off, and the
    /// core.
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
            // These are measured with the transform for which a pixel costs least, as visiting it weighs most there.
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
        // One encoder for all runs, so that the place of its memory favours none of them.
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
                    "{}, {}: not skipping {skip} gives a different frame: please report this",
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

    /// Compares the coding of the active pixels' positions as gaps with one bit for each pixel of the sensor.
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

    /// Compares sending only the nonzero Haar coefficients with sending r for every pixel. A zero would take as many
    /// bits as the pixel's widest level.
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

    /// Compares sending M of the K coefficients with sending all K, both with the core.
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

    /// Compares the frames of the whole recording with those and a frame for each of its empty windows.
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
            // A window without events becomes a frame only if there is something to count.
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

    /// Returns the time of each of `runs` runs in us per window. The shortest time of each window counts, because
    /// other load on the machine can only add to it. The runs take turns.
    ///
    /// `run` receives the number of the run, the index of the window and the window.
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

/// Pushes the events of a window into the core's encoder and encodes its frame.
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

/// Encodes the open window, which must give exactly one frame.
fn finish(encoder: &mut Encoder<'_>, out: &mut [u8]) -> Result<Encoded> {
    encoder.flush();
    let encoded = encoder.next_frame(out).ok().flatten().context(NO_ROOM)?;
    ensure!(encoder.next_frame(out) == Ok(None), NO_ROOM);
    Ok(encoded)
}
