//! Decodes hybrid frames to events.

use eecvs_nostd::coder::bits_msb_first::BigReader;
use eecvs_nostd::coder::cells::spread_us;
use eecvs_nostd::coder::content::{Content, END, Node};
use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{Dense, DenseMemory, words};
use eecvs_nostd::coder::fast::Fast;
use eecvs_nostd::coder::keys::{self, DecoderMemory};
use eecvs_nostd::coder::quick::{self, Simd};
use eecvs_nostd::coder::range::RangeDecoder;
use eecvs_nostd::coder::tree::{Shape, Tree, TreeEvent};
use eecvs_nostd::{
    Cells, Coder, Config, Effort, Event, Fidelity, Frame, Header, Hybrid, Mode, NextStart,
    Polarity, Push, Sensor, Thresholds, Times, WindowConfig,
};
use event_types::ensure;
use event_types::stream::{Context, Result};
use zerocopy::FromZeros;

use super::{DecodedWindow, Pixel, pixels};
use crate::storage::HostStorage;
use crate::tree_memory::TreeStorage;

/// Reason why a frame was not decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// The payload contradicts the header.
    Malformed,
    /// The frame depends on a frame that did not arrive.
    Dependent,
    /// The window has more events than the [`WindowLimit`](crate::window_limit::WindowLimit).
    Crowded,
    /// The system refused the memory that decoding takes.
    Memory,
}

impl std::fmt::Display for Refused {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Malformed => "the frame's payload contradicts its header",
            Self::Dependent => "the frame depends on a frame that did not arrive",
            Self::Crowded => {
                "the window has more events than a sensor sends or --max-events-per-window allows"
            }
            Self::Memory => "there is no memory to decode the frame",
        })
    }
}

impl std::error::Error for Refused {}

/// Decodes hybrid frames in the order in which they arrive.
#[derive(Debug, Default)]
pub struct HybridDecoder {
    chain: Option<Chain>,
    trees: Option<TreeChain>,
    keys: Option<Box<DecoderMemory>>,
    found: Vec<TreeEvent>,
    nodes: Vec<Node>,
    positions: Vec<(u16, u16)>,
    /// Memory reused for the next frame's events.
    spare: Vec<Event>,
}

/// State of the dense coder after a frame.
#[derive(Debug)]
pub(super) struct Chain {
    pub(super) sensor: Sensor,
    pub(super) model: Box<Model>,
    pub(super) words: Vec<u32>,
    /// Sequence number of the frame that continues from this state.
    pub(super) next: u32,
}

impl Chain {
    pub(super) fn new(sensor: Sensor) -> Self {
        Self {
            sensor,
            model: Box::new(Model::UNSET),
            words: vec![0; words(sensor, true)],
            next: 0,
        }
    }

    /// Returns the state that a frame continues from: `before`, or any state for a key frame.
    ///
    /// # Errors
    /// [`Refused::Dependent`] if `before` is not the state after the frame before this one.
    pub(super) fn of(before: Option<Self>, header: &Header) -> Result<Self, Refused> {
        let before = before.filter(|chain| chain.sensor == header.sensor);
        if header.is_key {
            Ok(before.unwrap_or_else(|| Self::new(header.sensor)))
        } else {
            before
                .filter(|chain| chain.next == header.sequence)
                .ok_or(Refused::Dependent)
        }
    }
}

/// State of the tree coder after a frame.
#[derive(Debug)]
struct TreeChain {
    sensor: Sensor,
    effort: Effort,
    has_history: bool,
    storage: TreeStorage,
    /// Sequence number of the frame that continues from this state; `None` after one that did not decode.
    next: Option<u32>,
}

impl TreeChain {
    /// Returns the state that a frame continues from, in `chain`: as [`Chain::of`]. Memory whose state is of no use
    /// serves the next key frame of the same sensor and effort.
    fn of<'c>(
        chain: &'c mut Option<Self>,
        header: &Header,
        effort: Effort,
    ) -> Result<&'c mut Self, Refused> {
        let (sensor, has_history) = (header.sensor, header.has_previous);
        let mut before = chain.take_if(|chain| {
            (chain.sensor, chain.effort, chain.has_history) == (sensor, effort, has_history)
        });
        let next = before.as_mut().and_then(|chain| chain.next.take());
        let before = match before {
            Some(before) => before,
            None if header.is_key => {
                // What serves another sensor or effort makes room first.
                *chain = None;
                Self {
                    sensor,
                    effort,
                    has_history,
                    storage: TreeStorage::new(sensor, effort, 0).map_err(|_| Refused::Memory)?,
                    next: None,
                }
            }
            None => return Err(Refused::Dependent),
        };
        let state = chain.insert(before);
        if header.is_key || next == Some(header.sequence) {
            Ok(state)
        } else {
            Err(Refused::Dependent)
        }
    }
}

impl HybridDecoder {
    /// Takes back the memory of decoded events for reuse.
    pub fn reuse(&mut self, events: Vec<Event>) {
        if self.spare.capacity() < events.capacity() {
            self.spare = events;
        }
    }

    /// Decodes a frame's events, in raster order, or those of the quick coder in their order of arrival, and of the keys
    /// coder in order of time.
    ///
    /// # Errors
    /// [`Refused`] if the frame does not decode; none of its events is returned then.
    pub fn frame(&mut self, frame: &Frame<'_>, hybrid: Hybrid) -> Result<Vec<Event>, Refused> {
        let header = &frame.header;
        let (payload, _) = frame.sections();
        let times = Times::new(hybrid.fidelity, header.scans, header.duration_us);
        let decoded = match hybrid.coder {
            Coder::Fast => fast(header, payload, times, std::mem::take(&mut self.spare)),
            Coder::Keys => self.keys(header, hybrid.fidelity, payload),
            Coder::Quick => quick(header, payload, std::mem::take(&mut self.spare)),
            // A frame that carries only the arrival order has nothing for the dense coder.
            Coder::Dense if header.order.is_some() && header.events == 0 => {
                self.pass(header, payload)
            }
            Coder::Dense => self.dense(header, payload, times),
            Coder::Tree(effort) => self.tree(header, effort, payload, times),
        };
        let mut events = decoded?;
        if let (Fidelity::SpreadUs(_), Times::Cells(cells)) = (hybrid.fidelity, times) {
            let is_by_time = hybrid.coder == Coder::Keys;
            if is_by_time {
                events.sort_unstable_by_key(|event| (event.y, event.x, event.t_us));
            }
            spread(&mut events, header.t0_us, cells);
            if is_by_time {
                events.sort_by_key(|event| event.t_us);
            }
        }
        Ok(events)
    }

    /// Passes over a frame without events that the next frame depends on.
    fn pass(&mut self, header: &Header, payload: &[u8]) -> Result<Vec<Event>, Refused> {
        let chain = self.chain.take();
        let chain = chain.filter(|chain| chain.next == header.sequence);
        let chain = chain.ok_or(Refused::Dependent)?;
        if !payload.is_empty() {
            return Err(Refused::Malformed);
        }
        let next = header.sequence.wrapping_add(1);
        self.chain = Some(Chain { next, ..chain });
        Ok(Vec::new())
    }

    fn dense(
        &mut self,
        header: &Header,
        payload: &[u8],
        times: Times,
    ) -> Result<Vec<Event>, Refused> {
        let mut chain = Chain::of(self.chain.take(), header)?;
        let mut memory = DenseMemory {
            model: &mut chain.model,
            words: &mut chain.words,
        };
        let mut dense = Dense::with_previous(header.sensor, header.has_previous, &mut memory)
            .ok_or(Refused::Malformed)?;
        if header.is_key {
            dense.restart();
        }
        self.nodes.clear();
        self.positions.clear();
        let mut content = Found {
            nodes: &mut self.nodes,
            positions: &mut self.positions,
            position: (0, 0),
            is_first: true,
            left: header.events,
        };
        let mut reader = RangeDecoder::new(payload);
        let coded = dense.code(&mut reader, &mut content, times);
        // A frame that was cut short for lack of room may have bytes that do not count at its end.
        let is_whole = coded.events == header.events && !reader.is_beyond();
        if !is_whole || (header.last && !reader.is_spent()) {
            return Err(Refused::Malformed);
        }
        chain.next = header.sequence.wrapping_add(1);
        self.chain = Some(chain);
        let mut events = std::mem::take(&mut self.spare);
        events.clear();
        let found = self.positions.iter().zip(&self.nodes);
        events.extend(
            found.map(|(position, node)| event(header, times, *position, node.cell, node.on)),
        );
        Ok(events)
    }
}

impl HybridDecoder {
    fn keys(
        &mut self,
        header: &Header,
        fidelity: Fidelity,
        payload: &[u8],
    ) -> Result<Vec<Event>, Refused> {
        let mut events = unset(header, payload, std::mem::take(&mut self.spare))?;
        let memory = match &mut self.keys {
            Some(memory) => memory,
            none => none.insert(DecoderMemory::new_box_zeroed().map_err(|_| Refused::Memory)?),
        };
        let window = keys::Window::new(header.sensor, header.t0_us, header.duration_us, fidelity);
        match keys::decode(
            keys::Simd::detected(),
            &window,
            payload,
            memory,
            &mut events,
        ) {
            Ok(()) => Ok(events),
            Err(keys::Damaged) => Err(Refused::Malformed),
        }
    }

    fn tree(
        &mut self,
        header: &Header,
        effort: Effort,
        payload: &[u8],
        times: Times,
    ) -> Result<Vec<Event>, Refused> {
        let shape = header.levels.and_then(|levels| Shape::new(times, levels));
        let shape = shape.ok_or(Refused::Malformed)?;
        let chain = TreeChain::of(&mut self.trees, header, effort)?;
        let count = header.events as usize;
        self.found.clear();
        let room = self.found.try_reserve(count);
        room.map_err(|_| Refused::Memory)?;
        self.found.resize(count, TreeEvent::NONE);
        let mut memory = chain.storage.lent();
        let tree = Tree::new(
            header.sensor,
            effort,
            count,
            header.has_previous,
            &mut memory,
        );
        let mut tree = tree.ok_or(Refused::Malformed)?;
        if header.is_key {
            tree.restart();
        }
        let start = header.clock(times);
        let is_whole = tree.decode(shape, start, payload, &mut self.found);
        // A window need not have a power of two of cells or scans.
        let is_inside = |event: &TreeEvent| event.coded_time() >> times.fine_bits() < times.count();
        if !is_whole || !self.found.iter().all(is_inside) {
            return Err(Refused::Malformed);
        }
        chain.next = Some(header.sequence.wrapping_add(1));
        let mut events = std::mem::take(&mut self.spare);
        events.clear();
        let found = self.found.iter();
        events.extend(found.map(|found| {
            event(
                header,
                times,
                found.position(),
                found.coded_time(),
                found.is_on(),
            )
        }));
        Ok(events)
    }
}

fn event(header: &Header, times: Times, (x, y): (u16, u16), told: u32, on: bool) -> Event {
    let offset_us = times.offset_us((x, y), told);
    Event {
        t_us: header.t0_us.saturating_add(u64::from(offset_us)),
        x,
        y,
        polarity: Polarity::from_bool(on),
    }
}

/// Spreads the events of each pixel and polarity over the cells that they were decoded into, and sorts each pixel's
/// anew; a pixel's events lie together.
fn spread(events: &mut [Event], t0_us: u64, cells: Cells) {
    for pixel in events.chunk_by_mut(|a, b| (a.x, a.y) == (b.x, b.y)) {
        pixel.sort_by_key(|event| (event.polarity, event.t_us));
        for run in pixel.chunk_by_mut(|a, b| (a.polarity, a.t_us) == (b.polarity, b.t_us)) {
            spread_run(run, t0_us, cells);
        }
        pixel.sort_by_key(|event| event.t_us);
    }
}

/// Spreads events of one cell over it.
fn spread_run(run: &mut [Event], t0_us: u64, cells: Cells) {
    let first_us = run.first().map_or(t0_us, |event| event.t_us);
    let cell = cells.of((first_us - t0_us) as u32);
    let Some((start_us, width_us)) = cells.span_us(cell) else {
        return;
    };
    let count = run.len() as u32;
    for (i, event) in (0_u32..).zip(run) {
        event.t_us =
            t0_us.saturating_add(u64::from(start_us) + u64::from(spread_us(width_us, i, count)));
    }
}

/// Returns as many events as the header says, whose content means nothing, in the memory of `events`.
///
/// # Errors
/// [`Refused::Malformed`] if the payload has fewer bits: an event takes at least one, which limits the memory reserved
/// before anything is decoded.
fn unset(header: &Header, payload: &[u8], mut events: Vec<Event>) -> Result<Vec<Event>, Refused> {
    let count = header.events as usize;
    if count > payload.len().saturating_mul(8) {
        return Err(Refused::Malformed);
    }
    events.resize(count, Event::UNSET);
    Ok(events)
}

/// Decodes a payload of the quick coder, into the memory of `events`.
fn quick(header: &Header, payload: &[u8], events: Vec<Event>) -> Result<Vec<Event>, Refused> {
    let mut events = unset(header, payload, events)?;
    let window = quick::Window::new(header.sensor, header.t0_us, header.duration_us);
    match quick::decode(Simd::detected(), window, payload, &mut events) {
        Ok(()) => Ok(events),
        Err(quick::Damaged) => Err(Refused::Malformed),
    }
}

/// Decodes a payload of the fast coder, into the memory of `events`.
fn fast(
    header: &Header,
    payload: &[u8],
    times: Times,
    events: Vec<Event>,
) -> Result<Vec<Event>, Refused> {
    if times.are_plain() {
        fast_at(header, payload, times, events, |_, cell| cell)
    } else {
        let offset_us = |at, cell| times.offset_us(at, cell);
        fast_at(header, payload, times, events, offset_us)
    }
}

/// As [`fast`], with the time offset of each event from `offset_us`.
fn fast_at(
    header: &Header,
    payload: &[u8],
    times: Times,
    events: Vec<Event>,
    offset_us: impl Fn((u16, u16), u32) -> u32,
) -> Result<Vec<Event>, Refused> {
    let mut events = unset(header, payload, events)?;
    let coder = Fast::new(header.sensor, header.window_events, times.count());
    let t0_us = header.t0_us;
    let mut reader = BigReader::new(payload);
    // The reader hands on as many events as the header says, or ends with an error. The rest of the memory moves into
    // the closure, so that where the next event goes stays in a register.
    let mut rest = events.iter_mut();
    let each = move |(x, y), cell, on| {
        if let Some(event) = rest.next() {
            let offset_us = offset_us((x, y), cell);
            *event = Event {
                t_us: t0_us.saturating_add(u64::from(offset_us)),
                x,
                y,
                polarity: Polarity::from_bool(on),
            };
        }
    };
    match coder.read(header.events, &mut reader, each) {
        Ok(()) if reader.is_spent() => Ok(events),
        _ => Err(Refused::Malformed),
    }
}

/// Collects the dense coder's events as they are decoded.
struct Found<'d> {
    nodes: &'d mut Vec<Node>,
    positions: &'d mut Vec<(u16, u16)>,
    position: (u16, u16),
    is_first: bool,
    left: u32,
}

impl Content for Found<'_> {
    fn has_row(&mut self, _: u16) -> bool {
        false
    }

    fn has_segment(&mut self, _segment: u16, _y: u16) -> bool {
        false
    }

    fn columns(&mut self) -> u32 {
        0
    }

    fn enter(&mut self, position: (u16, u16)) -> u32 {
        self.position = position;
        self.is_first = true;
        self.nodes.len() as u32
    }

    fn is_more(&self) -> bool {
        false
    }

    fn peek(&self) -> (u32, bool) {
        (0, false)
    }

    fn take(&mut self, cell: u32, on: bool) {
        let next = self.nodes.len() as u32;
        if !self.is_first
            && let Some(before) = self.nodes.last_mut()
        {
            before.next = next;
        }
        self.is_first = false;
        self.nodes.push(Node {
            cell,
            on,
            next: END,
        });
        self.positions.push(self.position);
        self.left -= 1;
    }

    fn is_over(&self) -> bool {
        self.left == 0
    }

    fn at(&self, list: u32) -> Option<Node> {
        self.nodes.get(list as usize).copied()
    }
}

impl DecodedWindow {
    /// Returns the window as kept coefficients: those of its frames or, if events were sent, exactly those that the
    /// encoder would have sent for them, bit for bit.
    ///
    /// # Errors
    /// Fails if the encoder does not accept the window's configuration or one of its events.
    pub fn with_pixels(&self) -> Result<Self> {
        if self.header.mode.is_transform() {
            return Ok(self.clone());
        }
        let header = &self.header;
        let config = Config {
            transform: Some(header.transform),
            m: header.m,
            grid: Some(header.grid),
            quantiser: header.quantiser,
            key_windows: 1,
            ..Config::new(
                WindowConfig::new(header.sensor, header.duration_us),
                Thresholds::new(0, 0).context("thresholds of 0")?,
                Mode::Transform,
            )
        };
        let mut storage = HostStorage::new(header.sensor, self.events.len().max(1));
        let mut encoder = storage.encoder(config)?;
        encoder.window().follow(NextStart::at(header.t0_us));
        for event in &self.events {
            let push = encoder.push(*event);
            ensure!(
                push == Push::Stored,
                Refused,
                "an event is outside of its window"
            );
        }
        encoder.flush();
        let mut out = vec![0; eecvs_nostd::FRAME_BYTES_MAX];
        let mut found: Vec<Pixel> = Vec::new();
        while let Some(encoded) = encoder.next_frame(&mut out).ok().flatten() {
            let frame = Frame::parse(&out[encoded.range]).context("a frame made here")?;
            found.extend(pixels(&frame).context("a frame made here")?);
        }
        Ok(Self {
            header: Header {
                mode: Mode::Transform,
                ..*header
            },
            pixels: found,
            events: Vec::new(),
        })
    }
}
