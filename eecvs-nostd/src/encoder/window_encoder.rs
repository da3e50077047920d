//! Composes the stages: takes a closed window, returns its frames.

use core::num::NonZeroU32;
use core::ops::Range;

use crate::coder::arrival_order;
#[cfg(feature = "coefficients")]
use crate::coder::coefficients::{dense, pixel::Common};
use crate::coder::dense::{Dense, DenseMemory, EVENT_BYTES_MAX};
use crate::coder::key_frames::Chain;
use crate::coder::keys;
use crate::coder::quick::{self, Simd};
use crate::coder::tree::{Shape, TIME_BITS_MAX, Tree};
#[cfg(feature = "coefficients")]
use crate::coder::window_coefficients::{CoefficientEncoder, Numbers, TakenCoefficients};
use crate::coder::window_events::{EventEncoder, dense_gathered};
use crate::coder::{Cells, Coder, Effort, Fidelity, Hybrid, Scans, Times};
use crate::encoder::config::{
    Config, ConfigError, HAS_BUDGET, HAS_DENSE, HAS_KEYS, HAS_MEAN_ERROR, HAS_ORDER, HAS_TRANSFORM,
    HAS_TREE, HotError, Scratch,
};
use crate::encoder::keys::encode_keys;
use crate::encoder::mean_error::MeanError;
use crate::encoder::rate::Rate;
use crate::frame::{
    CRC_BYTES, FRAME_BYTES_MAX, HEADER_BYTES_MAX, Header, Mode, NoRoom, OrderSection, seal,
};
use crate::fused::{PixelEncoder, has_ways, is_few, is_lanes, is_waves};
use crate::group::Group;
use crate::kernel::{Accumulate, WithKernel};
use crate::pack::bits_lsb_first::BitWriter;
use crate::pack::timed::LevelCoder;
use crate::prune::Kept;
use crate::regime::density::Density;
use crate::stage::{Stage, Trace};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::PIXEL_BYTES_MAX;
use crate::transform::{Basis, Dct, Dtft, Dwt, Transform};
use crate::window::hot_pixels::HotPixels;
use crate::window::{Closed, HAS_QUICK, Window, WindowConfig};
use event_types::Sensor;

/// Size in bytes of the smallest output in which any frame has room for at least one pixel.
pub const OUTPUT_BYTES_MIN: usize = HEADER_BYTES_MAX + PIXEL_BYTES_MAX + CRC_BYTES + 8;

/// No coder takes more bytes for an event of a whole window, on average.
const SPREAD_BYTES_MAX: usize = 24;

/// Returns the rate control of a configuration, in its initial state.
const fn rate(config: &Config) -> Option<Rate> {
    match config.bytes_per_second {
        Some(budget) if HAS_BUDGET => Some(Rate::new(budget, config.window.window_us)),
        _ => None,
    }
}

/// With fewer bytes left, a budget sends no event: the longest header, an event, and what is coded before it.
const FRAME_BYTES_LEAST: usize = HEADER_BYTES_MAX + CRC_BYTES + EVENT_BYTES_MAX + 24;

/// State of the window being encoded.
#[derive(Debug, Clone, Copy)]
struct Task {
    header: Header,
    scale: PhaseScale,
    /// Events of the window that are in no frame yet.
    left: u32,
    /// The next pixel was put back, and its times are coded already.
    is_rest: bool,
    /// The window's events lie in the tree coder's memory, and as many of them are in frames.
    gathered: Option<u32>,
}

/// Room for a payload in the smallest output.
const PAYLOAD_BYTES_MIN: usize = OUTPUT_BYTES_MIN - HEADER_BYTES_MAX - CRC_BYTES;
const _: () = assert!(
    PAYLOAD_BYTES_MIN >= quick::EVENT_BYTES_MAX && PAYLOAD_BYTES_MIN >= keys::EVENT_BYTES_MAX
);

/// Codes what is left of a window that keeps the order of arrival, or as much as there is room for. Returns the
/// payload's bytes.
#[inline(never)]
fn encode_quick(window: &Window<'_>, task: &mut Task, payload: &mut [u8]) -> usize {
    let header = &mut task.header;
    let done = header.window_events.saturating_sub(task.left);
    let left = window.in_order().get(done as usize..).unwrap_or_default();
    let of = quick::Window::new(header.sensor, header.t0_us, header.duration_us);
    let coded = quick::encode(Simd::detected(), of, left, payload);
    debug_assert!(coded.is_ok(), "the window checked its events");
    match coded {
        Ok(coded) => {
            header.events = coded.events as u32;
            task.left = task.left.saturating_sub(header.events);
            header.last = task.left == 0;
            coded.bytes
        }
        Err(quick::Outside) => {
            header.events = 0;
            header.dropped = header.dropped.saturating_add(task.left);
            header.last = true;
            0
        }
    }
}

/// An encoded frame in the output.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Encoded {
    /// The frame's header.
    pub header: Header,
    /// The frame's range in the output.
    pub range: Range<usize>,
}

/// Encodes closed windows into frames. It is separate from [`Window`], so that one window can be filled while
/// another is encoded.
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
    /// The next frame is a key frame, whatever the chain says.
    breaks: bool,
    /// Coder of the last frame of events that later ones may depend on.
    chained: Option<Coder>,
    rate: Option<Rate>,
    /// What the windows of the chain have left of [`Config::max_emd_us`].
    mean_error: MeanError,
    /// Progress of the order section, in windows that have one.
    order: Option<arrival_order::Progress>,
}

impl<'b> WindowEncoder<'b> {
    /// Returns an encoder in lent memory.
    ///
    /// # Errors
    /// [`ConfigError`] if the configuration is invalid or the memory does not suffice for it.
    pub const fn new(config: Config, scratch: Scratch<'b>) -> Result<Self, ConfigError> {
        if let Err(error) = config.check(&scratch) {
            return Err(error);
        }
        let Scratch {
            sums,
            totals,
            magnitudes,
            dense,
            tree,
            keys,
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
                tree,
                keys,
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
            chained: None,
            rate: rate(&config),
            mean_error: MeanError::START,
            order: None,
        })
    }

    /// Starts anew with another configuration. A window that was being encoded is discarded, and so are the pixels
    /// of [`Self::add_hot`].
    ///
    /// # Errors
    /// [`ConfigError`] if the configuration is refused; the one before then stays in force.
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

    /// Makes the dense coder begin the next window with a key frame.
    pub const fn restart(&mut self) {
        self.chain = Chain::START;
        self.breaks = false;
        self.chained = None;
    }

    /// Changes [`Config::bytes_per_second`], from the next window on; `None` for no budget.
    ///
    /// A budget that the windows' headers alone would exceed is raised to what they take. What was learned of the
    /// scene stays, and a second in which the budget changes takes no more than the larger of both budgets.
    ///
    /// # Errors
    /// [`ConfigError::Rate`] in a mode or of a coder that has no budget; the one before then stays in force.
    pub fn set_budget(&mut self, budget: Option<NonZeroU32>) -> Result<(), ConfigError> {
        let Some(budget) = budget else {
            self.config.bytes_per_second = None;
            self.rate = None;
            return Ok(());
        };
        if !HAS_BUDGET || self.config.mode.is_transform() || self.config.mode.takes_arrival() {
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

    /// Changes the tolerance of times in mode hybrid, from the next window on; 0 for exact times.
    ///
    /// # Errors
    /// [`ConfigError::Quick`] of the quick coder, [`ConfigError::MeanError`] in another mode or where
    /// [`Config::max_emd_us`] chooses; the one before then stays in force.
    pub const fn set_tolerance(&mut self, tolerance_us: u32) -> Result<(), ConfigError> {
        let Mode::Hybrid(hybrid) = &mut self.config.mode else {
            return Err(ConfigError::MeanError);
        };
        if self.config.max_emd_us.is_some() {
            return Err(ConfigError::MeanError);
        }
        if matches!(hybrid.coder, Coder::Quick) {
            return Err(ConfigError::Quick);
        }
        hybrid.fidelity = match tolerance_us {
            0 => Fidelity::Lossless,
            tolerance_us => Fidelity::ToleranceUs(tolerance_us),
        };
        Ok(())
    }

    /// Removes from a closed window, before its first frame, the events that [`Config::filter`] and the hot pixels keep
    /// out, and counts them. [`Self::next_frame`] does so too: only who looks at the window in between needs this.
    pub fn filter(&self, window: &mut Window<'_>) {
        let filtered = self.config.filter.apply(&self.hot, window);
        window.count_filtered(filtered);
    }

    /// Replaces the memory lent to the dense coder. Call [`Self::set_up`] afterwards, as what was learned is in the
    /// memory before.
    pub const fn lend_dense(&mut self, memory: Option<DenseMemory<'b>>) {
        self.scratch.dense = memory;
    }

    /// Keeps a pixel (column, row) out of every window that is encoded from now on. Returns how many pixels are
    /// kept out.
    ///
    /// # Errors
    /// [`HotError`] if the pixel is not on the sensor, or there is no room for it; pixels added before stay.
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

    /// Returns how many pixels are kept out.
    #[must_use]
    pub const fn hot_count(&self) -> usize {
        self.hot.count()
    }

    /// Returns the configuration with which the encoder runs.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// Encodes the next frame of a closed window into `out`. Returns `None` if no frame is left, which opens the
    /// window again.
    ///
    /// A window takes one frame if `out` has room for it, else as many as needed. Each of these decodes by itself,
    /// except for those of the dense coder. Cost grows with the number of events in the window.
    ///
    /// # Errors
    /// [`NoRoom`] if `out` is shorter than [`OUTPUT_BYTES_MIN`]; nothing is lost.
    pub fn next_frame(
        &mut self,
        window: &mut Window<'_>,
        out: &mut [u8],
    ) -> Result<Option<Encoded>, NoRoom> {
        self.next_frame_traced(window, out, &mut ())
    }

    /// As [`Self::next_frame`], reporting to `trace` which stage is at work.
    ///
    /// # Errors
    /// [`NoRoom`], as for [`Self::next_frame`].
    pub fn next_frame_traced<T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        out: &mut [u8],
        trace: &mut T,
    ) -> Result<Option<Encoded>, NoRoom> {
        self.next_frame_of::<Dct, Dtft, T>(window, out, trace)
    }

    /// As [`Self::next_frame`], with coefficients from another kernel than the encoder's own; a single event is
    /// still coded by the cell of its time. For a host: see [`WithKernel`].
    ///
    /// # Errors
    /// [`NoRoom`], as for [`Self::next_frame`].
    pub fn next_frame_with<A: Accumulate<Dct> + Accumulate<Dtft>>(
        &mut self,
        window: &mut Window<'_>,
        out: &mut [u8],
    ) -> Result<Option<Encoded>, NoRoom> {
        self.next_frame_of::<WithKernel<Dct, A>, WithKernel<Dtft, A>, ()>(window, out, &mut ())
    }

    /// Does what [`Self::next_frame`] does, with `C` for the DCT and `F` for the DTFT.
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
            None => self.plan(closed, window, out.len()),
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
        // `out` is at least that long.
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

    /// Returns where a frame's payload has to end in an output of `out_bytes`, and whether the budget has no room
    /// for a frame.
    #[inline(always)]
    fn payload_end(&self, out_bytes: usize) -> (usize, bool) {
        let end = out_bytes.min(FRAME_BYTES_MAX) - CRC_BYTES;
        match &self.rate {
            Some(rate) if HAS_BUDGET => {
                // The header has room for the longest one: what it does not take, the payload may.
                let room = rate.room().saturating_sub(HEADER_BYTES_MAX + CRC_BYTES);
                let is_spent = rate.room() < FRAME_BYTES_LEAST;
                (end.min(HEADER_BYTES_MAX + room), is_spent)
            }
            _ => (end, false),
        }
    }

    /// Codes what is left of the window, or as much as there is room for. Returns the payload's bytes.
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
            Mode::Hybrid(hybrid) if HAS_QUICK && header.mode.takes_arrival() => {
                trace.enter(Stage::Pack);
                match &mut self.scratch.keys {
                    Some(memory) if HAS_KEYS && hybrid.coder == Coder::Keys => {
                        let left = &mut task.left;
                        encode_keys(memory, window, hybrid.fidelity, header, left, payload)
                    }
                    _ => encode_quick(window, task, payload),
                }
            }
            // Only the order is left to code.
            Mode::Hybrid(_) if HAS_ORDER && task.left == 0 && header.part > 0 => {
                header.events = 0;
                header.last = true;
                0
            }
            Mode::Hybrid(hybrid) => self.encode_events(window, hybrid, task, payload, trace),
            _ if HAS_TRANSFORM => self.encode_plain::<C, F, T>(window, task, payload, trace),
            // Never reached, as the configuration is refused: were it, all would be counted.
            _ => self.leave_out(window, task),
        }
    }

    /// Leaves out, and counts, what the budget has no room for: the estimate was too low, or there was no room for
    /// a single event. Returns the payload's bytes.
    #[inline(always)]
    fn leave_out(&mut self, window: &mut Window<'_>, task: &mut Task) -> usize {
        let header = &mut task.header;
        header.events = 0;
        header.last = true;
        header.thinned = header.thinned.saturating_add(task.left);
        while self.group.next(window).is_some() {}
        // The frame neither depends on others nor is learned from.
        if let Mode::Hybrid(hybrid) = &mut header.mode {
            hybrid.coder = Coder::Fast;
        }
        (header.scans, header.levels) = (None, None);
        header.is_key = true;
        self.breaks = true;
        0
    }

    /// Completes a frame around its payload in `out`, and prepares the task for the next frame.
    #[inline(always)]
    fn seal_frame(
        &mut self,
        task: &mut Task,
        payload_bytes: usize,
        out: &mut [u8],
    ) -> Result<Encoded, NoRoom> {
        let header = &mut task.header;
        let range = seal(header, payload_bytes, out)?;
        if HAS_BUDGET && let Some(rate) = &mut self.rate {
            let order_bytes = header.order.map_or(0, |order| order.bytes as usize);
            rate.spend(range.len(), order_bytes, header.events);
        }
        self.sequence = self.sequence.wrapping_add(1);
        let encoded = Encoded {
            header: *header,
            range,
        };
        if header.is_key {
            self.mean_error.note_key(header.part);
        }
        header.part += 1;
        header.thinned = 0;
        header.is_key &= !header.mode.is_dense();
        if header.mode.is_transform() {
            task.left = task.left.saturating_sub(header.events);
            // The next frame tries the configured mode again, whatever this one had room for.
            header.mode = self.config.mode;
        }
        Ok(encoded)
    }

    /// Decides what a closed window's frames have in common: applies the filter, chooses regime, transform and
    /// mode, and removes what the budget has no room for.
    fn plan(&mut self, closed: Closed, window: &mut Window<'_>, room: usize) -> Task {
        let WindowConfig { sensor, .. } = window.config();
        self.filter(window);
        let used = window.slots_used();
        let density = Density {
            events: window.events(),
            pixels: sensor.pixels(),
            duration_us: closed.duration_us,
        };
        let regime = self.config.thresholds.regime(density);
        let transform = self.config.transform.unwrap_or(regime.transform());
        self.group.restart();
        let memory = &self.scratch.dense;
        let is_dense_here =
            HAS_DENSE && memory.as_ref().is_some_and(|memory| memory.serves(sensor));
        let mut mode = self.config.mode;
        let mut thinned = 0;
        if let Mode::Hybrid(hybrid) = &mut mode
            && let Coder::Tree(effort) = hybrid.coder
            && !(HAS_TREE && self.has_tree(sensor, effort, window))
        {
            hybrid.coder = Coder::Dense;
        }
        if HAS_MEAN_ERROR
            && let (Some(max_us), Mode::Hybrid(hybrid)) = (self.config.max_emd_us, &mut mode)
        {
            // Frames that depend on none before them do without what windows before left.
            if !self.config.mode.is_dense() || self.chain.ends(self.config.key_windows) {
                self.mean_error = MeanError::START;
            }
            // Scans are exact, for fewer bits than such cells.
            let cells = Mode::Hybrid(Hybrid {
                fidelity: Fidelity::ToleranceUs(max_us.get().saturating_mul(2)),
                ..*hybrid
            });
            let scans = is_dense_here && self.config.readout.is_some_and(|it| it.serves(cells));
            // What a decoder spreads has to be in one frame.
            let most = (window.events() as usize).saturating_mul(SPREAD_BYTES_MAX);
            let is_whole = most.saturating_add(HEADER_BYTES_MAX + CRC_BYTES) <= room;
            let spreads = is_whole && !self.config.keep_order && !scans;
            // The tree coder hands over to another where it has no room, or times of too many bits.
            let may_hand_over = matches!(hybrid.coder, Coder::Tree(_))
                && (!is_whole || closed.duration_us >> TIME_BITS_MAX > 0);
            let may_be_key = self.breaks || self.chained != Some(hybrid.coder) || may_hand_over;
            let state = &mut self.mean_error;
            let may = (spreads, may_be_key);
            hybrid.fidelity = state.coarsest(max_us, closed.duration_us, may, window);
        }
        if HAS_BUDGET && let (Some(rate), Mode::Hybrid(hybrid)) = (&mut self.rate, &mut mode) {
            let plan = rate.plan(hybrid.fidelity, closed, window);
            hybrid.fidelity = plan.fidelity;
            thinned = plan.thinned;
        }
        if window.keeps_arrival() {
            if !(HAS_KEYS && mode.has_keys() && self.scratch.keys.is_some()) {
                mode = Mode::Hybrid(Hybrid {
                    coder: Coder::Quick,
                    fidelity: Fidelity::Lossless,
                });
            }
        } else if let Mode::Hybrid(hybrid) = &mut mode
            && matches!(hybrid.coder, Coder::Keys | Coder::Quick)
        {
            // A window that was created for another coder.
            hybrid.coder = Coder::Fast;
        }
        let scans = self
            .config
            .readout
            .filter(|readout| is_dense_here && readout.serves(mode));
        let scans = scans.and_then(|readout| Scans::fit(readout, window));
        let mode = match (mode, scans) {
            // Exact times then cost less than times within a tolerance.
            (Mode::Hybrid(hybrid), Some(_)) => Mode::Hybrid(Hybrid {
                fidelity: Fidelity::Lossless,
                ..hybrid
            }),
            (mode, _) => mode,
        };
        let keeps_order = HAS_ORDER && self.config.keep_order && window.events() > 0;
        self.order = match mode {
            Mode::Hybrid(hybrid) if keeps_order && !mode.takes_arrival() => {
                let cells = Cells::new(hybrid.fidelity, closed.duration_us);
                arrival_order::note(self.scratch.order, window, used, cells)
            }
            _ => None,
        };
        let mut header = Header {
            truncated: closed.truncated,
            begins_run: closed.begins_run,
            last: false,
            regime,
            mode,
            is_key: !mode.is_dense() || self.chain.next(window.events(), self.config.key_windows),
            has_previous: false,
            levels: None,
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
            timed_max: 0,
        };
        if HAS_TRANSFORM && self.config.few_as_times && mode.is_transform() {
            let coder = match mode {
                Mode::Coefficients(Coder::Dense) => LevelCoder::Dense,
                Mode::Coefficients(_) => LevelCoder::Fast,
                _ => LevelCoder::Plain,
            };
            let few = header.packing().few(closed.duration_us, coder);
            header.timed_max = few.events_max();
        }
        Task {
            header,
            scale: PhaseScale::new(closed.duration_us),
            left: window.events(),
            is_rest: false,
            gathered: None,
        }
    }

    /// Returns whether the tree coder has memory for a window.
    fn has_tree(&self, sensor: Sensor, effort: Effort, window: &Window<'_>) -> bool {
        let memory = self.scratch.tree.as_ref().filter(|memory| {
            window.events() as usize <= memory.events.len() && memory.serves(sensor, effort)
        });
        memory.is_some()
    }

    /// Codes the window's pixels with plain codes, up to the last or as far as there is room. Returns the payload's
    /// bytes.
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

    /// Codes the window's coefficients with an adaptive coder, up to the last pixel or as far as there is room.
    /// Returns the payload's bytes; `None` if there is no room for a pixel or no memory for the sensor. The frame
    /// then has to be packed plain, and its header says so.
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
            // What is coded before the first pixel takes some bytes too.
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

    /// Codes the window's events, up to the last or as far as there is room. Returns the payload's bytes.
    #[inline(never)]
    fn encode_events<T: Trace>(
        &mut self,
        window: &mut Window<'_>,
        hybrid: Hybrid,
        task: &mut Task,
        payload: &mut [u8],
        trace: &mut T,
    ) -> usize {
        if HAS_TREE
            && let Coder::Tree(effort) = hybrid.coder
            && let Some(bytes) = self.encode_tree(window, hybrid, effort, task, payload)
        {
            return bytes;
        }
        let header = &mut task.header;
        let times = Times::new(hybrid.fidelity, header.scans, header.duration_us);
        let memory = self.scratch.dense.as_mut();
        let is_dense = HAS_DENSE && hybrid.coder != Coder::Fast;
        let has_previous = memory
            .as_ref()
            .is_some_and(|memory| memory.has_previous(header.sensor));
        let dense = memory
            .filter(|_| is_dense)
            .and_then(|memory| Dense::new(header.sensor, memory));
        let mut encoder = EventEncoder::new(&mut self.group, window, times, &mut task.is_rest);
        let taken = match dense {
            Some(mut dense) => {
                let coder = Coder::Dense;
                header.mode = Mode::Hybrid(Hybrid { coder, ..hybrid });
                header.is_key |= core::mem::take(&mut self.breaks);
                header.is_key |= self.chained.replace(coder) != Some(coder);
                header.has_previous = has_previous;
                if header.is_key {
                    dense.restart();
                }
                let memory = self.scratch.tree.as_ref().filter(|_| HAS_TREE);
                match (memory, task.gathered) {
                    (Some(memory), Some(done)) => {
                        let events = memory.events.get(..(done + task.left) as usize);
                        let rest = events.and_then(|events| events.get(done as usize..));
                        dense_gathered(&mut dense, rest.unwrap_or_default(), times, payload)
                    }
                    _ => encoder.dense(&mut dense, task.left, payload, trace),
                }
            }
            None => {
                // Also reached if the memory suffices for the configured sensor but not for this window's.
                let coder = Coder::Fast;
                header.mode = Mode::Hybrid(Hybrid { coder, ..hybrid });
                header.is_key = true;
                encoder.fast(header, payload, trace)
            }
        };
        header.events = taken.events;
        header.last = taken.is_last;
        task.left -= taken.events;
        if let Some(done) = &mut task.gathered {
            *done += taken.events;
        }
        self.breaks = taken.overran;
        taken.payload_bytes
    }

    /// Codes the whole window with the tree coder. Returns the payload's bytes, or `None` if there is no room; the dense
    /// coder then codes what was gathered, and its frames say so.
    #[inline(never)]
    fn encode_tree(
        &mut self,
        window: &mut Window<'_>,
        hybrid: Hybrid,
        effort: Effort,
        task: &mut Task,
        payload: &mut [u8],
    ) -> Option<usize> {
        let header = &mut task.header;
        let times = Times::new(hybrid.fidelity, header.scans, header.duration_us);
        let memory = self.scratch.tree.as_mut()?;
        // No dense frame can code what was gathered if its memory is too small.
        let dense = self.scratch.dense.as_ref();
        dense.filter(|memory| memory.serves(header.sensor))?;
        // Times of too many bits.
        Shape::of_window(times, effort, 0, 0)?;
        let mut encoder = EventEncoder::new(&mut self.group, window, times, &mut task.is_rest);
        let (count, pixels) = encoder.gather(memory.events);
        task.gathered = Some(0);
        let shape = Shape::of_window(times, effort, count as u32, pixels)?;
        let start = header.clock(times);
        // The coder takes all memory but that of the events.
        let events = core::mem::take(&mut memory.events);
        let coded =
            Tree::new(header.sensor, effort, events.len(), true, memory).and_then(|mut tree| {
                let coder = hybrid.coder;
                header.is_key |= core::mem::take(&mut self.breaks);
                header.is_key |= self.chained.replace(coder) != Some(coder);
                if header.is_key {
                    tree.restart();
                }
                tree.encode(shape, start, events.get_mut(..count)?, payload)
            });
        memory.events = events;
        if coded.is_none() {
            // What it learned is not in any frame.
            self.chained = None;
            return None;
        }
        header.has_previous = true;
        header.levels = Some(shape.levels());
        header.events = task.left;
        header.last = true;
        task.left = 0;
        coded
    }

    /// Codes the window's order, or as much of it as there is room for, after a payload of `payload_bytes`. Returns
    /// the bytes that it took.
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
            // It is not worth a frame of its own.
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

    /// Encodes pixels up to the last, or up to the first for which there is no room. Returns whether all were
    /// encoded.
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
        let has_ways = has_ways(&packing);
        if has_ways && is_dct && is_few(&packing) {
            (events, pixels, saturated) =
                encoder.encode_few(&mut self.group, window, writer, trace);
        }
        if has_ways && B::TRANSFORM as u8 == Transform::Dwt as u8 && is_lanes(&packing, scale) {
            (events, pixels, saturated) =
                encoder.encode_lanes(&mut self.group, window, writer, trace);
        }
        if has_ways
            && B::HAS_WALKS
            && B::TRANSFORM as u8 == Transform::Dtft as u8
            && is_waves(&packing)
        {
            (events, pixels, saturated) =
                encoder.encode_waves(&mut self.group, window, writer, trace);
        }
        let mut is_last = true;
        let is_haar = B::TRANSFORM as u8 == Transform::Dwt as u8;
        // A trace wants to know each stage, which a walk mixes.
        let walks_times = !has_ways && B::HAS_WALKS && !is_haar && !T::LISTENS;
        loop {
            if walks_times {
                let (some, places) = encoder.encode_times(&mut self.group, window, writer);
                (events, pixels) = (events + some, pixels + places);
            }
            let Some(pixel) = self.group.next(window) else {
                break;
            };
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

    /// Gives the next frame the number `sequence`, for encoders that take turns at the windows of one stream.
    pub const fn follow(&mut self, sequence: u32) {
        self.sequence = sequence;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coder::dense;
    use crate::coder::dense::model::Model;
    use crate::coder::tree::{Counter, Marks, Nodes, Pixel, Sizes, TreeEvent, TreeMemory};
    use crate::frame::Frame;
    use crate::window::{Slot, WindowBuffers, bitmap_words, segments};
    use event_types::{Event, Polarity};
    use std::{boxed::Box, vec, vec::Vec};

    const SENSOR: Sensor = Sensor {
        width: 50,
        height: 20,
    };

    /// Lends what a [`TreeMemory`] needs to `with`.
    fn with_tree<R>(effort: Effort, events: usize, with: impl FnOnce(TreeMemory<'_>) -> R) -> R {
        let sizes = Sizes::new(SENSOR, effort, usize::MAX, true);
        with(TreeMemory {
            counters: &mut vec![Counter::UNSET; sizes.counters],
            weights: &mut vec![[0; _]; sizes.weights],
            curves: &mut vec![[0; _]; sizes.curves],
            bytes: &mut vec![0; sizes.bytes],
            halves: &mut vec![0; sizes.halves],
            words: &mut vec![0; sizes.words],
            pixels: &mut vec![Pixel::NONE; sizes.pixels],
            seconds: &mut vec![Nodes::default(); sizes.seconds],
            marks: &mut vec![Marks::default(); sizes.marks],
            events: &mut vec![TreeEvent::NONE; events],
        })
    }

    fn events(window: u64) -> Vec<Event> {
        let mut random = window.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut events: Vec<_> = (0..700)
            .map(|_| {
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                Event {
                    t_us: 1000 * window + random % 1000,
                    x: (random >> 20) as u16 % 9 * 5,
                    y: (random >> 40) as u16 % 20,
                    polarity: Polarity::from_bool(random >> 60 & 1 == 1),
                }
            })
            .collect();
        events.sort_by_key(|event| event.t_us);
        events
    }

    /// Whole windows are frames of the tree coder, and come back; others are frames of the dense coder, of which the
    /// first is a key, as is the next tree.
    #[test]
    fn windows_without_room_are_dense_frames_and_the_chain_begins_anew() {
        let effort = Effort::One;
        let hybrid = Hybrid {
            coder: Coder::Tree(effort),
            fidelity: Fidelity::Lossless,
        };
        let thresholds = crate::Thresholds::new(0, 0).unwrap();
        let config = Config::new(
            WindowConfig::new(SENSOR, 1000),
            thresholds,
            Mode::Hybrid(hybrid),
        );
        let count = segments(SENSOR.width, SENSOR.height);
        let (mut slots, mut heads) = (vec![Slot::EMPTY; 700], vec![0; count]);
        let mut bitmap = vec![0; bitmap_words(count)];
        let buffers = WindowBuffers {
            slots: &mut slots,
            heads: &mut heads,
            bitmap: &mut bitmap,
        };
        let mut window = Window::new(config.window, buffers).unwrap();
        let mut model = Box::new(Model::UNSET);
        let mut words = vec![0; dense::words(SENSOR, true)];
        let coders = with_tree(effort, 700, |tree| {
            let scratch = Scratch {
                sums: &mut [],
                totals: &mut [],
                magnitudes: &mut [],
                dense: Some(DenseMemory {
                    model: &mut model,
                    words: &mut words,
                }),
                tree: Some(tree),
                keys: None,
                coefficients: None,
                hot: &mut [],
                order: &mut [],
            };
            let mut encoder = WindowEncoder::new(config, scratch).unwrap();
            with_tree(effort, 0, |mut memory| {
                let mut tree = Tree::new(SENSOR, effort, 700, true, &mut memory).unwrap();
                let mut coders = vec![];
                for number in 0..5 {
                    let sent = events(number);
                    for event in &sent {
                        window.push(*event);
                    }
                    window.flush();
                    let room = if number == 2 {
                        OUTPUT_BYTES_MIN
                    } else {
                        1 << 16
                    };
                    let mut out = vec![0; room];
                    let mut told = 0;
                    while let Some(encoded) = encoder.next_frame(&mut window, &mut out).unwrap() {
                        let frame = Frame::parse(&out[encoded.range]).unwrap();
                        let header = frame.header;
                        assert_eq!(header, encoded.header);
                        let Mode::Hybrid(hybrid) = header.mode else {
                            panic!("{:?}", header.mode);
                        };
                        coders.push((hybrid.coder.name(), header.is_key, header.part));
                        told += header.events;
                        let Some(levels) = header.levels else {
                            continue;
                        };
                        let times = Times::new(Fidelity::Lossless, None, header.duration_us);
                        let shape = Shape::new(times, levels).unwrap();
                        let mut found = vec![TreeEvent::NONE; header.events as usize];
                        if header.is_key {
                            tree.restart();
                        }
                        let start = header.clock(times);
                        assert!(tree.decode(shape, start, frame.payload, &mut found));
                        let mut sent = sent.clone();
                        sent.sort_by_key(|event| (event.y, event.x, event.t_us));
                        assert_eq!(found.len(), sent.len());
                        for (found, sent) in found.iter().zip(&sent) {
                            let t_us = header.t0_us + u64::from(found.coded_time());
                            assert_eq!((found.position(), t_us), ((sent.x, sent.y), sent.t_us));
                        }
                    }
                    assert_eq!(told as usize, sent.len());
                }
                coders
            })
        });
        let of_tree: Vec<_> = coders.iter().filter(|coder| coder.0 == "tree-1").collect();
        let of_dense: Vec<_> = coders.iter().filter(|coder| coder.0 == "dense").collect();
        let keys: Vec<_> = of_tree.iter().map(|coder| coder.1).collect();
        assert_eq!(keys, [true, false, true, false]);
        assert!(of_dense.len() > 1);
        for (part, coder) in (0..).zip(of_dense) {
            assert_eq!((coder.1, coder.2), (part == 0, part));
        }
    }
}
