//! The stages composed: a closed window in, its frames out.

use core::num::NonZeroU32;
use core::ops::Range;

use crate::coder::arrival_order;
#[cfg(feature = "coefficients")]
use crate::coder::coefficients::{dense, pixel::Common};
use crate::coder::dense::{Dense, DenseMemory, EVENT_BYTES_MAX};
use crate::coder::key_frames::Chain;
#[cfg(feature = "coefficients")]
use crate::coder::window_coefficients::{CoefficientEncoder, Numbers, TakenCoefficients};
use crate::coder::window_events::EventEncoder;
use crate::coder::{Cells, Coder, Fidelity, Hybrid, Scans, Times};
use crate::encoder::config::{Config, ConfigError, HAS_ORDER, HotError, Scratch};
use crate::encoder::rate::Rate;
use crate::frame::{
    CRC_BYTES, FRAME_BYTES_MAX, HEADER_BYTES_MAX, Header, Mode, NoRoom, OrderSection, seal,
};
use crate::fused::{PixelEncoder, is_few, is_lanes, is_waves};
use crate::group::Group;
use crate::kernel::{Accumulate, WithKernel};
use crate::pack::bits_lsb_first::BitWriter;
use crate::prune::Kept;
use crate::regime::density::Density;
use crate::stage::{Stage, Trace};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::PIXEL_BYTES_MAX;
use crate::transform::{Basis, Dct, Dtft, Dwt, Transform};
use crate::window::hot_pixels::HotPixels;
use crate::window::{Closed, Window, WindowConfig};

/// Smallest output that always takes a frame with at least one pixel.
pub const OUTPUT_BYTES_MIN: usize = HEADER_BYTES_MAX + PIXEL_BYTES_MAX + CRC_BYTES + 8;

/// The rate control of a configuration, at its start.
const fn rate(config: &Config) -> Option<Rate> {
    match config.bytes_per_second {
        Some(budget) => Some(Rate::new(budget, config.window.window_us)),
        None => None,
    }
}

/// A budget that has less left sends no event: the longest header, an event, and what is told before it.
const FRAME_BYTES_LEAST: usize = HEADER_BYTES_MAX + CRC_BYTES + EVENT_BYTES_MAX + 24;

/// The window being encoded.
#[derive(Debug, Clone, Copy)]
struct Task {
    header: Header,
    scale: PhaseScale,
    /// Events of the window in no frame yet.
    left: u32,
    /// The next pixel is the rest of one that is partly in a frame.
    is_rest: bool,
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
    hot: HotPixels<'b>,
    kept: Kept,
    group: Group,
    task: Option<Task>,
    sequence: u32,
    chain: Chain,
    /// Whatever the chain says, the next frame begins anew.
    breaks: bool,
    rate: Option<Rate>,
    /// How much of the window's order is told, where it is to be.
    order: Option<arrival_order::Progress>,
}

impl<'b> WindowEncoder<'b> {
    /// An encoder over lent scratch memory.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub const fn new(config: Config, scratch: Scratch<'b>) -> Result<Self, ConfigError> {
        if let Err(error) = config.check(&scratch) {
            return Err(error);
        }
        let Scratch {
            sums,
            totals,
            magnitudes,
            dense,
            coefficients,
            hot,
            order,
        } = scratch;
        Ok(Self {
            config,
            scratch: Scratch {
                sums,
                totals,
                magnitudes,
                dense,
                coefficients,
                hot: &mut [],
                order,
            },
            hot: HotPixels::new(hot),
            kept: Kept::NONE,
            group: Group::new(),
            task: None,
            sequence: 0,
            chain: Chain::START,
            breaks: false,
            rate: rate(&config),
            order: None,
        })
    }

    /// Starts anew with another configuration; on an error the one before stays. A window that was
    /// being encoded is forgotten, and so are the pixels of [`Self::add_hot`].
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn set_up(&mut self, config: Config) -> Result<(), ConfigError> {
        config.check(&self.scratch)?;
        self.config = config;
        self.hot.clear();
        self.task = None;
        self.sequence = 0;
        self.rate = rate(&config);
        self.restart();
        Ok(())
    }

    /// Begins a chain of the dense coder's frames anew with the next window.
    pub const fn restart(&mut self) {
        self.chain = Chain::START;
        self.breaks = false;
    }

    /// Goes on with another [`Config::bytes_per_second`], or without, from the next window on. A budget that the
    /// windows' headers alone would exceed is raised to what they take. What was learned of the scene stays, and a second
    /// in which the budget changes takes no more than the larger of both.
    ///
    /// # Errors
    /// [`ConfigError::Rate`] of a mode that has no budget; the one before stays.
    pub fn set_budget(&mut self, budget: Option<NonZeroU32>) -> Result<(), ConfigError> {
        let Some(budget) = budget else {
            self.config.bytes_per_second = None;
            self.rate = None;
            return Ok(());
        };
        if self.config.mode.is_transform() {
            return Err(ConfigError::Rate);
        }
        let least = self.config.budget_min().min(u64::from(u32::MAX)) as u32;
        let budget = NonZeroU32::new(least).map_or(budget, |least| budget.max(least));
        let window_us = self.config.window.window_us;
        self.config.bytes_per_second = Some(budget);
        match &mut self.rate {
            Some(rate) => rate.set_budget(budget, window_us),
            None => self.rate = Some(Rate::new(budget, window_us)),
        }
        Ok(())
    }

    /// Lends other memory for the dense coder, or none: before a [`Self::set_up`], as what was learned
    /// lies in the one before.
    pub const fn lend_dense(&mut self, memory: Option<DenseMemory<'b>>) {
        self.scratch.dense = memory;
    }

    /// Keeps a pixel, column and row, out of every window from the next one on that is encoded; returns
    /// how many there are.
    ///
    /// # Errors
    /// [`HotError`]; those before it stay.
    pub fn add_hot(&mut self, (x, y): (u16, u16)) -> Result<usize, HotError> {
        let sensor = self.config.window.sensor;
        if !sensor.contains(x, y) {
            return Err(HotError::Outside);
        }
        match self.hot.add((x, y), sensor.width) {
            Ok(()) => Ok(self.hot.count()),
            Err(_) => Err(HotError::NoRoom),
        }
    }

    /// How many pixels are kept out.
    #[must_use]
    pub const fn hot_count(&self) -> usize {
        self.hot.count()
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
        self.next_frame_of::<Dct, Dtft, T>(window, out, trace)
    }

    /// As [`Self::next_frame`], with the coefficients of another kernel than the encoder's own; a
    /// single event still travels as the cell of its time. For a host: see [`WithKernel`].
    ///
    /// # Errors
    /// [`NoRoom`], as there.
    pub fn next_frame_with<A: Accumulate<Dct> + Accumulate<Dtft>>(
        &mut self,
        window: &mut Window<'_>,
        out: &mut [u8],
    ) -> Result<Option<Encoded>, NoRoom> {
        self.next_frame_of::<WithKernel<Dct, A>, WithKernel<Dtft, A>, ()>(window, out, &mut ())
    }

    /// With `C` for the DCT and `F` for the DTFT.
    #[inline(always)]
    fn next_frame_of<C: Basis, F: Basis, T: Trace>(
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
            None => self.plan(closed, window),
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
        header.order = None;

        let (end, is_spent) = self.payload_end(out.len());
        // There is that much.
        let payload = out.get_mut(HEADER_BYTES_MAX..end).unwrap_or_default();
        let mut payload_bytes = if is_spent {
            self.leave_out(window, &mut task)
        } else {
            self.encode_payload::<C, F, T>(window, &mut task, payload, trace)
        };
        if HAS_ORDER && task.header.last && self.order.is_some() && !is_spent {
            let room = payload.get_mut(payload_bytes..).unwrap_or_default();
            payload_bytes += self.encode_order(&mut task.header, payload_bytes, room);
        }
        trace.enter(Stage::Frame);
        let encoded = self.seal_frame(&mut task, payload_bytes, out)?;
        self.task = Some(task);
        Ok(Some(encoded))
    }

    /// Where a frame's payload ends at the latest in an output of so many bytes, and whether the budget has
    /// no room for a frame.
    #[inline(always)]
    fn payload_end(&self, out_bytes: usize) -> (usize, bool) {
        let end = out_bytes.min(FRAME_BYTES_MAX) - CRC_BYTES;
        match &self.rate {
            Some(rate) => {
                // The header lies where it is longest: what it does not take the payload may.
                let room = rate.room().saturating_sub(HEADER_BYTES_MAX + CRC_BYTES);
                let is_spent = rate.room() < FRAME_BYTES_LEAST;
                (end.min(HEADER_BYTES_MAX + room), is_spent)
            }
            None => (end, false),
        }
    }

    /// Codes what is left of the window, or as much of it as there is room for; returns the bytes that it
    /// took.
    #[inline(always)]
    fn encode_payload<C: Basis, F: Basis, T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        task: &mut Task,
        payload: &mut [u8],
        trace: &mut T,
    ) -> usize {
        let header = &mut task.header;
        match header.mode {
            #[cfg(feature = "coefficients")]
            Mode::Coefficients(coder) => {
                let taken = match header.transform {
                    Transform::Dct => self.encode_coefficients::<C>(window, coder, task, payload),
                    Transform::Dtft => self.encode_coefficients::<F>(window, coder, task, payload),
                    Transform::Dwt => self.encode_coefficients::<Dwt>(window, coder, task, payload),
                };
                match taken {
                    Some(bytes) => bytes,
                    None => self.encode_plain::<C, F, T>(window, task, payload, trace),
                }
            }
            // What there is left to code is the order.
            Mode::Hybrid(_) if HAS_ORDER && task.left == 0 && header.part > 0 => {
                header.events = 0;
                header.last = true;
                0
            }
            Mode::Hybrid(hybrid) => self.encode_events(window, hybrid, task, payload, trace),
            _ => self.encode_plain::<C, F, T>(window, task, payload, trace),
        }
    }

    /// Leaves out, and counts, what the budget has no room for: what was estimated was too low, or there was
    /// no room for a single event. Returns the payload's bytes.
    #[inline(always)]
    fn leave_out(&mut self, window: &mut Window<'_>, task: &mut Task) -> usize {
        let header = &mut task.header;
        header.events = 0;
        header.last = true;
        header.thinned = header.thinned.saturating_add(task.left);
        while self.group.next(window).is_some() {}
        // Nothing is learned from it, and nothing goes on from it.
        if let Mode::Hybrid(hybrid) = &mut header.mode {
            hybrid.coder = Coder::Fast;
        }
        header.scans = None;
        header.is_key = true;
        self.breaks = true;
        0
    }

    /// Makes a frame of its payload in `out`; the task is then the next frame's.
    #[inline(always)]
    fn seal_frame(
        &mut self,
        task: &mut Task,
        payload_bytes: usize,
        out: &mut [u8],
    ) -> Result<Encoded, NoRoom> {
        let header = &mut task.header;
        let range = seal(header, payload_bytes, out)?;
        if let Some(rate) = &mut self.rate {
            let order_bytes = header.order.map_or(0, |order| order.bytes as usize);
            rate.spend(range.len(), order_bytes, header.events);
        }
        self.sequence = self.sequence.wrapping_add(1);
        let encoded = Encoded {
            header: *header,
            range,
        };
        header.part += 1;
        header.thinned = 0;
        header.is_key &= !header.mode.is_dense();
        if header.mode.is_transform() {
            task.left = task.left.saturating_sub(header.events);
            // Whatever this frame had room for.
            header.mode = self.config.mode;
        }
        Ok(encoded)
    }

    /// What a closed window's frames have in common: its filter, regime, transform and mode, and what its
    /// budget leaves of it.
    fn plan(&mut self, closed: Closed, window: &mut Window<'_>) -> Task {
        let WindowConfig { sensor, .. } = window.config();
        let used = window.events();
        let filtered = self.config.filter.apply(&self.hot, window);
        window.count_filtered(filtered);
        let density = Density {
            events: window.events(),
            pixels: sensor.pixels(),
            duration_us: closed.duration_us,
        };
        let regime = self.config.thresholds.regime(density);
        let transform = self.config.transform.unwrap_or(regime.transform());
        self.group.restart();
        let memory = &self.scratch.dense;
        let is_dense_here = memory.as_ref().is_some_and(|memory| memory.serves(sensor));
        let mut mode = self.config.mode;
        let mut thinned = 0;
        if let (Some(rate), Mode::Hybrid(hybrid)) = (&mut self.rate, &mut mode) {
            let plan = rate.plan(hybrid.fidelity, closed, window);
            hybrid.fidelity = plan.fidelity;
            thinned = plan.thinned;
        }
        let scans = self
            .config
            .readout
            .filter(|readout| is_dense_here && readout.serves(mode));
        let scans = scans.and_then(|readout| Scans::fit(readout, window));
        let mode = match (mode, scans) {
            // Exact times then cost less than those within a tolerance.
            (Mode::Hybrid(hybrid), Some(_)) => Mode::Hybrid(Hybrid {
                fidelity: Fidelity::Lossless,
                ..hybrid
            }),
            (mode, _) => mode,
        };
        self.order = match mode {
            Mode::Hybrid(hybrid) if HAS_ORDER && self.config.keep_order && window.events() > 0 => {
                let cells = Cells::new(hybrid.fidelity, closed.duration_us);
                arrival_order::note(self.scratch.order, window, used, cells)
            }
            _ => None,
        };
        Task {
            header: Header {
                truncated: closed.truncated,
                begins_run: closed.begins_run,
                last: false,
                regime,
                mode,
                is_key: !self.config.mode.is_dense()
                    || self.chain.next(window.events(), self.config.key_windows),
                has_previous: false,
                scans,
                order: None,
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
                thinned,
                saturated: 0,
                transform,
                m: self.config.m,
                grid: transform.grid_size(self.config.m, self.config.grid),
                quantiser: self.config.quantiser,
            },
            scale: PhaseScale::new(closed.duration_us),
            left: window.events(),
            is_rest: false,
        }
    }

    /// Codes the window's pixels with plain codes up to the last, or as far as there is room; returns
    /// the bytes they took.
    #[inline(always)]
    fn encode_plain<C: Basis, F: Basis, T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        task: &mut Task,
        payload: &mut [u8],
        trace: &mut T,
    ) -> usize {
        let mut writer = BitWriter::new(payload);
        let (header, scale) = (&mut task.header, task.scale);
        header.last = match header.transform {
            Transform::Dct => self.encode_pixels::<C, _>(window, scale, header, &mut writer, trace),
            Transform::Dtft => {
                self.encode_pixels::<F, _>(window, scale, header, &mut writer, trace)
            }
            Transform::Dwt => {
                self.encode_pixels::<Dwt, _>(window, scale, header, &mut writer, trace)
            }
        };
        writer.finish()
    }

    /// Codes the window's coefficients up to the last pixel, or as far as there is room; returns the
    /// bytes they took. `None` where there is no room for a pixel, or no memory for the sensor: then
    /// the frame is to be packed plain, and says so.
    #[cfg(feature = "coefficients")]
    #[inline(never)]
    fn encode_coefficients<B: Basis>(
        &mut self,
        window: &mut Window<'_>,
        coder: Coder,
        task: &mut Task,
        payload: &mut [u8],
    ) -> Option<usize> {
        let header = &mut task.header;
        let sensor = header.sensor;
        let Scratch {
            sums,
            totals,
            magnitudes,
            dense: dense_memory,
            coefficients,
            ..
        } = &mut self.scratch;
        let common = Common::new(header.packing(), header.duration_us);
        let mut encoder = CoefficientEncoder {
            group: &mut self.group,
            window,
            numbers: Numbers {
                sums,
                totals,
                magnitudes,
                kept: &mut self.kept,
            },
            common,
            left: task.left,
        };
        let mut code = || -> Option<TakenCoefficients> {
            let memory = coefficients.as_mut()?;
            if coder == Coder::Fast {
                header.is_key = true;
                return Some(encoder.fast::<B>(memory, payload));
            }
            // What is told before the first pixel takes some bytes too.
            let least = dense::pixel_bytes_max(&common) + FRAME_BYTES_LEAST;
            let dense_memory = dense_memory.as_mut().filter(|_| payload.len() >= least)?;
            header.has_previous = dense_memory.has_previous(sensor);
            let mut dense = Dense::new(sensor, dense_memory)?;
            header.is_key |= core::mem::take(&mut self.breaks);
            if header.is_key {
                dense.restart();
                memory.restart();
            }
            Some(encoder.dense::<B>(&mut dense, memory, payload))
        };
        let is_empty = task.left == 0;
        let taken = code().filter(|taken| taken.pixels > 0 || is_empty);
        let Some(taken) = taken else {
            header.mode = Mode::Transform;
            (header.is_key, header.has_previous) = (true, false);
            self.breaks = true;
            return None;
        };
        (header.events, header.pixels) = (taken.events, taken.pixels);
        header.saturated = taken.saturated;
        header.last = taken.is_last;
        self.breaks = taken.overran;
        Some(taken.payload_bytes)
    }

    /// Codes the window's events up to the last, or as far as there is room; returns the bytes they
    /// took.
    #[inline(never)]
    fn encode_events<T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        hybrid: Hybrid,
        task: &mut Task,
        payload: &mut [u8],
        trace: &mut T,
    ) -> usize {
        let header = &mut task.header;
        let times = Times::new(hybrid.fidelity, header.scans, header.duration_us);
        let mut encoder = EventEncoder::new(&mut self.group, window, times, &mut task.is_rest);
        let memory = self.scratch.dense.as_mut();
        let is_dense = hybrid.coder == Coder::Dense;
        let has_previous = memory
            .as_ref()
            .is_some_and(|memory| memory.has_previous(header.sensor));
        let dense = memory
            .filter(|_| is_dense)
            .and_then(|memory| Dense::new(header.sensor, memory));
        let taken = match dense {
            Some(mut dense) => {
                header.is_key |= core::mem::take(&mut self.breaks);
                header.has_previous = has_previous;
                if header.is_key {
                    dense.restart();
                }
                encoder.dense(&mut dense, task.left, payload, trace)
            }
            None => {
                // Also where the memory, enough for the configured sensor, is not for this window's.
                let coder = Coder::Fast;
                header.mode = Mode::Hybrid(Hybrid { coder, ..hybrid });
                header.is_key = true;
                encoder.fast(header, payload, trace)
            }
        };
        header.events = taken.events;
        header.last = taken.is_last;
        task.left -= taken.events;
        self.breaks = taken.overran;
        taken.payload_bytes
    }

    /// Tells the window's order, or as much of it as there is room for, behind a payload of so many bytes;
    /// returns the bytes it took.
    #[inline(never)]
    fn encode_order(
        &mut self,
        header: &mut Header,
        payload_bytes: usize,
        room: &mut [u8],
    ) -> usize {
        let Some(progress) = &mut self.order else {
            return 0;
        };
        let room = match &self.rate {
            Some(rate) => {
                let most = rate.order_room(payload_bytes).min(room.len());
                room.get_mut(..most).unwrap_or_default()
            }
            None => room,
        };
        let told = arrival_order::tell(self.scratch.order, progress, room);
        let is_complete = progress.is_complete();
        if !is_complete && self.rate.is_some() {
            // Not worth a frame of its own.
            self.order = None;
            return 0;
        }
        header.last = is_complete;
        if told.events == 0 && !is_complete {
            return 0;
        }
        header.order = Some(OrderSection {
            bytes: told.bytes as u32,
            events: if is_complete { 0 } else { told.events },
        });
        told.bytes
    }

    /// Encodes pixels up to the last, or up to the first that finds no room; returns whether that
    /// was the last.
    #[inline(never)]
    fn encode_pixels<B: Basis, T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        scale: PhaseScale,
        header: &mut Header,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) -> bool {
        let packing = header.packing();
        let mut encoder = PixelEncoder::new(&packing, scale, &mut self.scratch, &mut self.kept);
        let (mut events, mut pixels, mut saturated) = (0, 0, 0);
        let is_dct = B::HAS_WALKS && B::TRANSFORM as u8 == Transform::Dct as u8;
        if is_dct && is_few(&packing) {
            (events, pixels, saturated) =
                encoder.encode_few(&mut self.group, window, writer, trace);
        }
        if B::TRANSFORM as u8 == Transform::Dwt as u8 && is_lanes(&packing, scale) {
            (events, pixels, saturated) =
                encoder.encode_lanes(&mut self.group, window, writer, trace);
        }
        if B::HAS_WALKS && B::TRANSFORM as u8 == Transform::Dtft as u8 && is_waves(&packing) {
            (events, pixels, saturated) =
                encoder.encode_waves(&mut self.group, window, writer, trace);
        }
        let mut is_last = true;
        while let Some(pixel) = self.group.next(window) {
            let position = writer.position();
            let saturates = encoder.encode::<B, T>(pixel, window.slots(), writer, trace);
            if writer.is_full() {
                writer.rewind(position);
                self.group.put_back(pixel);
                is_last = false;
                break;
            }
            events += pixel.on + pixel.off;
            pixels += 1;
            saturated = saturated.saturating_add(saturates);
            trace.enter(Stage::Group);
        }
        (header.events, header.pixels, header.saturated) = (events, pixels, saturated);
        is_last
    }

    /// Numbers the next frame `sequence`, for encoders that take turns at the windows of one
    /// stream.
    pub const fn follow(&mut self, sequence: u32) {
        self.sequence = sequence;
    }
}
