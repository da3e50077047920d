//! The stages composed: events in, frames out.

use core::ops::Range;

use crate::bits::BitWriter;
use crate::density::Density;
use crate::descriptor::Descriptor;
use crate::event::Event;
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, Sum, WideSum};
use crate::frame::{CRC_BYTES, FRAME_BYTES_MAX, HEADER_BYTES_MAX, Header, Mode, NoRoom, seal};
use crate::group::{Chunks, Group, Pixel};
use crate::pack::PIXEL_BYTES_MAX;
use crate::phase::PhaseScale;
use crate::prune::{Kept, largest, low_frequency};
use crate::quantise::Quantiser;
use crate::regime::Thresholds;
use crate::trace::{Stage, Trace};
use crate::transform::{Basis, Dct, Dtft, Dwt, GRID_MAX, Impulse, M_MAX, Rule, Transform};
use crate::window::{Closed, Push, Window, WindowBuffers, WindowConfig};

/// Smallest output that always takes a frame with at least one pixel.
pub const OUTPUT_BYTES_MIN: usize = HEADER_BYTES_MAX + PIXEL_BYTES_MAX + CRC_BYTES + 8;

/// What the encoder is asked to do. Fixed while it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Sensor and T.
    pub window: WindowConfig,
    /// Densities between the regimes.
    pub thresholds: Thresholds,
    /// One transform for every window, or `None` for the regime's (eq. 3).
    pub transform: Option<Transform>,
    /// M, 1 to 64.
    pub m: u8,
    /// K, 1 to 1024, or `None` for the transform's default.
    pub grid: Option<u16>,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
}

/// Why a configuration cannot run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// M is not in 1..=64.
    M,
    /// K is not in 1..=1024.
    Grid,
    /// [`Scratch`] is smaller than the largest grid needs.
    Scratch,
}

/// Why an encoder cannot be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetupError {
    /// [`Window::new`] refuses: the event buffers are empty or too small for the sensor, the sensor
    /// is out of range, or T is 0.
    Window,
    /// The rest of the configuration.
    Config(ConfigError),
}

impl Config {
    /// Whether it can run with scratch memory for `numbers` numbers.
    const fn check(&self, numbers: usize) -> Result<(), ConfigError> {
        if self.m == 0 || self.m as usize > M_MAX {
            return Err(ConfigError::M);
        }
        if let Some(grid) = self.grid
            && (grid == 0 || grid as usize > GRID_MAX)
        {
            return Err(ConfigError::Grid);
        }
        if numbers < 2 * self.grid_max() {
            return Err(ConfigError::Scratch);
        }
        Ok(())
    }

    /// Largest K of any window.
    const fn grid_max(&self) -> usize {
        let mut most = 0;
        let mut i = 0;
        while i < Transform::ALL.len() {
            let transform = Transform::ALL[i];
            let used = match self.transform {
                Some(only) => only as u8 == transform as u8,
                None => true,
            };
            let grid = transform.grid_size(self.m, self.grid) as usize;
            if used && grid > most {
                most = grid;
            }
            i += 1;
        }
        most
    }
}

/// Memory lent for one pixel, zeroed or not: a chunk of its events, and 2K of each number of its
/// coefficients.
#[derive(Debug)]
pub struct Scratch<'b> {
    /// Events of a chunk.
    pub impulses: &'b mut [Impulse; CHUNK_EVENTS],
    /// Sums of a chunk.
    pub sums: &'b mut [Sum],
    /// Sums of a pixel of several chunks.
    pub totals: &'b mut [WideSum],
    /// Magnitudes and their copy.
    pub magnitudes: &'b mut [u64],
}

impl Scratch<'_> {
    /// Numbers that every part has room for.
    const fn numbers(&self) -> usize {
        let mut least = self.sums.len();
        if self.totals.len() < least {
            least = self.totals.len();
        }
        if self.magnitudes.len() < least {
            least = self.magnitudes.len();
        }
        least
    }
}

/// The window being encoded.
#[derive(Debug, Clone, Copy)]
struct Task {
    header: Header,
    scale: PhaseScale,
}

/// A frame in the output.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Encoded {
    /// Its header.
    pub header: Header,
    /// Where it lies in the output.
    pub range: Range<usize>,
}

/// Turns closed windows into frames. Apart from [`Window`], so that one window can be received
/// while another is encoded.
#[derive(Debug)]
pub struct WindowEncoder<'b> {
    config: Config,
    scratch: Scratch<'b>,
    group: Group,
    task: Option<Task>,
    sequence: u32,
}

impl<'b> WindowEncoder<'b> {
    /// An encoder over lent scratch memory.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub const fn new(config: Config, scratch: Scratch<'b>) -> Result<Self, ConfigError> {
        if let Err(error) = config.check(scratch.numbers()) {
            return Err(error);
        }
        Ok(Self {
            config,
            scratch,
            group: Group::new(),
            task: None,
            sequence: 0,
        })
    }

    /// Starts anew with another configuration; on an error the one before stays. A window that was
    /// being encoded is forgotten.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn set_up(&mut self, config: Config) -> Result<(), ConfigError> {
        config.check(self.scratch.numbers())?;
        self.config = config;
        self.task = None;
        self.sequence = 0;
        Ok(())
    }

    /// The configuration.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// Encodes the next frame of a closed window into `out`, or returns `None` when there is none
    /// left, which opens the window again.
    ///
    /// A window takes one frame where `out` has room for it, and else as many as it takes, each of
    /// which decodes by itself. Cost follows the window's events.
    ///
    /// # Errors
    /// [`NoRoom`] where `out` is shorter than [`OUTPUT_BYTES_MIN`]; nothing is lost.
    pub fn next_frame(
        &mut self,
        window: &mut Window<'_>,
        out: &mut [u8],
    ) -> Result<Option<Encoded>, NoRoom> {
        self.next_frame_traced(window, out, &mut ())
    }

    /// As [`Self::next_frame`], telling `trace` which stage is at work.
    ///
    /// # Errors
    /// [`NoRoom`], as there.
    pub fn next_frame_traced<T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        out: &mut [u8],
        trace: &mut T,
    ) -> Result<Option<Encoded>, NoRoom> {
        trace.enter(Stage::Group);
        let Some(closed) = window.closed() else {
            return Ok(None);
        };
        if out.len() < OUTPUT_BYTES_MIN {
            return Err(NoRoom);
        }
        let mut task = match self.task {
            Some(task) => task,
            None => self.begin(closed, window),
        };
        if task.header.last {
            self.task = None;
            window.reopen();
            return Ok(None);
        }
        let header = &mut task.header;
        let counts = window.take_counts();
        header.sequence = self.sequence;
        header.late = counts.late;
        header.filtered = counts.filtered;
        header.dropped = counts.dropped;
        (header.events, header.pixels, header.saturated) = (0, 0, 0);

        let end = out.len().min(FRAME_BYTES_MAX) - CRC_BYTES;
        let mut writer = BitWriter::new(&mut out[HEADER_BYTES_MAX..end]);
        let packing = header.packing();
        let mut next_index = 0;
        header.last = loop {
            let Some(pixel) = self.group.next(window) else {
                break true;
            };
            let (descriptor, saturated) = self.describe(pixel, header, window, task.scale, trace);
            trace.enter(Stage::Pack);
            let position = writer.position();
            if packing
                .pack(&descriptor, &mut next_index, &mut writer)
                .is_err()
            {
                writer.rewind(position);
                self.group.put_back(pixel);
                break false;
            }
            header.events += descriptor.events();
            header.pixels += 1;
            header.saturated = header.saturated.saturating_add(saturated);
            trace.enter(Stage::Group);
        };
        trace.enter(Stage::Frame);
        let payload_bytes = writer.finish();
        let range = seal(header, payload_bytes, out)?;
        self.sequence = self.sequence.wrapping_add(1);
        let encoded = Encoded {
            header: *header,
            range,
        };
        header.part += 1;
        self.task = Some(task);
        Ok(Some(encoded))
    }

    fn begin(&mut self, closed: Closed, window: &Window<'_>) -> Task {
        let WindowConfig { sensor, .. } = window.config();
        let density = Density {
            events: window.events(),
            pixels: sensor.pixels(),
            duration_us: closed.duration_us,
        };
        let regime = self.config.thresholds.regime(density);
        let transform = self.config.transform.unwrap_or(regime.transform());
        self.group.restart();
        Task {
            header: Header {
                truncated: closed.truncated,
                last: false,
                regime,
                mode: Mode::Transform,
                sequence: 0,
                part: 0,
                sensor,
                t0_us: closed.t0_us,
                duration_us: closed.duration_us,
                window_events: window.events(),
                events: 0,
                pixels: 0,
                late: 0,
                filtered: 0,
                dropped: 0,
                saturated: 0,
                transform,
                m: self.config.m,
                grid: transform.grid_size(self.config.m, self.config.grid),
                quantiser: self.config.quantiser,
            },
            scale: PhaseScale::new(closed.duration_us),
        }
    }

    fn describe<T: Trace>(
        &mut self,
        pixel: Pixel,
        header: &Header,
        window: &mut Window<'_>,
        scale: PhaseScale,
        trace: &mut T,
    ) -> (Descriptor, u32) {
        let chunks = Chunks::new(pixel, window.slots(), scale);
        match header.transform {
            Transform::Dct => self.describe_in::<Dct, _>(pixel, header, chunks, trace),
            Transform::Dtft => self.describe_in::<Dtft, _>(pixel, header, chunks, trace),
            Transform::Dwt => self.describe_in::<Dwt, _>(pixel, header, chunks, trace),
        }
    }

    /// Accumulate, prune and quantise one pixel; also returns how many levels saturated.
    fn describe_in<B: Basis, T: Trace>(
        &mut self,
        pixel: Pixel,
        header: &Header,
        mut chunks: Chunks<'_>,
        trace: &mut T,
    ) -> (Descriptor, u32) {
        trace.enter(Stage::Accumulate);
        let grid = usize::from(header.grid);
        let Scratch {
            impulses,
            sums,
            totals,
            magnitudes,
        } = &mut self.scratch;
        B::accumulate(chunks.fill(impulses), grid, sums);
        if pixel.on + pixel.off <= CHUNK_EVENTS as u32 {
            return select_levels::<B, _>(pixel, header, sums, magnitudes, trace);
        }
        let values = B::values(grid);
        for (total, sum) in totals[..values].iter_mut().zip(sums.iter()) {
            *total = sum.wide();
        }
        loop {
            let chunk = chunks.fill(impulses);
            if chunk.is_empty() {
                return select_levels::<B, _>(pixel, header, totals, magnitudes, trace);
            }
            B::accumulate(chunk, grid, sums);
            for (total, sum) in totals[..values].iter_mut().zip(sums.iter()) {
                // Fewer than 2^24 events of at most 1 each: far from the 2^40 that a total holds.
                *total = total.wrapping_add(sum.wide());
            }
        }
    }
}

/// Prune and quantise.
fn select_levels<B: Basis, C: Coefficient>(
    pixel: Pixel,
    header: &Header,
    sums: &[C],
    magnitudes: &mut [u64],
    trace: &mut impl Trace,
) -> (Descriptor, u32) {
    trace.enter(Stage::Prune);
    let grid = usize::from(header.grid);
    let r = header.packing().kept();
    let mut kept = Kept::new();
    // All coefficients of a single event have the magnitude 1 in the DTFT: all tie.
    let all_tie = B::TRANSFORM as u8 == Transform::Dtft as u8 && pixel.on + pixel.off == 1;
    match B::RULE {
        Rule::Magnitude if !all_tie && r < grid => {
            let (magnitudes, work) = magnitudes[..2 * grid].split_at_mut(grid);
            for (k, magnitude) in magnitudes.iter_mut().enumerate() {
                *magnitude = B::magnitude(sums, grid, k);
            }
            largest(magnitudes, r, work, &mut kept);
        }
        Rule::Magnitude | Rule::LowFrequency => low_frequency(r, &mut kept),
    }
    trace.enter(Stage::Quantise);
    let mut descriptor = Descriptor {
        x: pixel.x,
        y: pixel.y,
        on: pixel.on,
        off: pixel.off,
        ..Descriptor::EMPTY
    };
    let mut saturated = 0;
    for k in kept {
        let (level, cut) = B::level(sums, grid, usize::from(k), header.quantiser);
        saturated += u32::from(cut);
        if (level.re, level.im) != (0, 0) {
            // Never full: at most M_MAX are kept.
            let _ = descriptor.levels.push(level);
        }
    }
    (descriptor, saturated)
}

/// A window and its encoder: pushes events, returns frames.
///
/// ```
/// # use eecvs_nostd::*;
/// let mut storage: Storage<64, { segments(8, 4) }, { bitmap_words(segments(8, 4)) }, 128> =
///     Storage::new();
/// let config = Config {
///     window: WindowConfig { sensor: Sensor::new(8, 4).unwrap(), window_us: 1000 },
///     thresholds: Thresholds::new(0, 0).unwrap(),
///     transform: None,
///     m: 8,
///     grid: None,
///     quantiser: Quantiser::DEFAULT,
/// };
/// let mut encoder = storage.encoder(config).unwrap();
/// let mut out = [0; 2048];
/// let mut frames = 0;
/// for t_us in [5, 700, 1200] {
///     let event = Event { t_us, x: 3, y: 2, polarity: Polarity::On };
///     while encoder.push(event) == Push::Closed {
///         while let Some(frame) = encoder.next_frame(&mut out).unwrap() {
///             frames += 1; // send &out[frame.range]
///         }
///     }
/// }
/// encoder.flush();
/// while encoder.next_frame(&mut out).unwrap().is_some() {
///     frames += 1;
/// }
/// assert_eq!(frames, 2);
/// ```
#[derive(Debug)]
pub struct Encoder<'b> {
    window: Window<'b>,
    encoder: WindowEncoder<'b>,
}

impl<'b> Encoder<'b> {
    /// Composes a window with an encoder of the same sensor.
    #[must_use]
    pub const fn new(window: Window<'b>, encoder: WindowEncoder<'b>) -> Self {
        Self { window, encoder }
    }

    /// An encoder over lent memory, zeroed.
    ///
    /// # Errors
    /// [`SetupError`].
    pub const fn set_up(
        config: Config,
        buffers: WindowBuffers<'b>,
        scratch: Scratch<'b>,
    ) -> Result<Self, SetupError> {
        let Some(window) = Window::new(config.window, buffers) else {
            return Err(SetupError::Window);
        };
        match WindowEncoder::new(config, scratch) {
            Ok(encoder) => Ok(Self::new(window, encoder)),
            Err(error) => Err(SetupError::Config(error)),
        }
    }

    /// Adds an event; on [`Push::Closed`] take every frame and push it again.
    #[inline]
    pub fn push(&mut self, event: Event) -> Push {
        self.window.push(event)
    }

    /// Closes the open window.
    pub fn flush(&mut self) {
        self.window.flush();
    }

    /// The next frame of the closed window: see [`WindowEncoder::next_frame`].
    ///
    /// # Errors
    /// [`NoRoom`].
    pub fn next_frame(&mut self, out: &mut [u8]) -> Result<Option<Encoded>, NoRoom> {
        self.encoder.next_frame(&mut self.window, out)
    }

    /// As [`Self::next_frame`]: see [`WindowEncoder::next_frame_traced`].
    ///
    /// # Errors
    /// [`NoRoom`].
    pub fn next_frame_traced(
        &mut self,
        out: &mut [u8],
        trace: &mut impl Trace,
    ) -> Result<Option<Encoded>, NoRoom> {
        self.encoder.next_frame_traced(&mut self.window, out, trace)
    }

    /// The window, to count drops or to look at.
    pub const fn window(&mut self) -> &mut Window<'b> {
        &mut self.window
    }
}
