//! The tree coder: the fewest bits of the coders of events, for whole windows.
//!
//! A window is coded in two passes with a range coder (`range`):
//!
//! ```text
//! events -> pyramid of pixels -> places -> times, numbers, polarities -> payload
//! ```
//!
//! First which pixels have events (`places`): a pyramid of bitmaps (`pyramid`), coarse to fine. Then each pixel's
//! events (`times`): a tree over the window's time says in which slots they lie. What is occupied around, in space, in
//! time, and in the windows before, tells how likely each node is. The [`Effort`] says how much is computed for that:
//! effort one asks one or two counters, the others mix the predictions of several (`mix`).
//!
//! The same functions encode and decode. Time per event is bounded; all memory is lent ([`TreeMemory`]).

mod counter;
mod memory;
mod mix;
mod places;
mod pyramid;
mod range;
mod times;

pub use counter::Counter;
pub use memory::{Sizes, TreeMemory};
pub use mix::{Curve, Weights};
pub use times::{Marks, Nodes, Pixel};

use crate::coder::tree::memory::COUNTS;
use crate::coder::tree::mix::{Mixer, MixerMemory};
use crate::coder::tree::pyramid::Pyramid;
use crate::coder::tree::range::{BitCoder, Decoder, Encoder};
use crate::coder::tree::times::{Clock, mixed, single};
use crate::coder::{Scans, Times};
use event_types::Sensor;
use zerocopy::FromZeros;

/// How much the coder computes for fewer bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Effort {
    /// Single contexts: 1.1 to 2.5 times the dense coder's time in windows of 33 ms, with 200 KB of tables.
    One = 1,
    /// Three mixed contexts: some six times the time for 1 to 5 % fewer bits, with 4 MB of tables.
    Two = 2,
    /// All contexts, mixed: some thirteen times the time for another 1 to 3 %, with 10 MB of tables.
    Three = 3,
}

impl Effort {
    /// The efforts, by the time that they take.
    pub const ALL: [Self; 3] = [Self::One, Self::Two, Self::Three];

    /// Returns the effort of a number, 1 to 3.
    #[must_use]
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            1 => Some(Self::One),
            2 => Some(Self::Two),
            3 => Some(Self::Three),
            _ => None,
        }
    }
}

/// Most levels of each of the two trees.
pub const LEVELS_MAX: u32 = 6;
/// Most bits of a time in a window.
pub const TIME_BITS_MAX: u32 = 28;

/// Levels of the two trees by which a window's times are divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Levels {
    /// Of the first tree, 1 to 6.
    pub first: u8,
    /// Of the second tree, 0 to 6.
    pub second: u8,
}

/// How a window's times are divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Shape {
    /// Bits of a time.
    bits: u32,
    /// Levels of the first tree.
    first: u32,
    /// Levels of the second tree.
    second: u32,
    /// Scans of which the upper bits of a time are the number.
    scans: Option<Scans>,
}

impl Shape {
    /// Returns the shape for times that are coded so, with trees of `levels` (the second only if the first has all
    /// six); `None` if these are out of their ranges, or together more than the numbers of cells or scans have bits, or
    /// if the times have more than [`TIME_BITS_MAX`]. A single cell has one bit.
    #[must_use]
    pub const fn new(times: Times, levels: Levels) -> Option<Self> {
        let (first, second) = (levels.first as u32, levels.second as u32);
        let tops = Self::bits_of(times.count());
        let bits = tops + times.fine_bits();
        let is_first = first >= 1 && first <= LEVELS_MAX;
        let is_second = second == 0 || (second <= LEVELS_MAX && first == LEVELS_MAX);
        if is_first && is_second && bits <= TIME_BITS_MAX && first + second <= tops {
            let scans = match times {
                Times::Cells(_) => None,
                Times::Scans(scans) => Some(scans),
            };
            Some(Self {
                bits,
                first,
                second,
                scans,
            })
        } else {
            None
        }
    }

    /// Chooses the shape for a window with times that are coded so, and so many events and active pixels.
    ///
    /// The more events share a pixel, the finer are the slots in which their neighbours tell where they are; where
    /// each pixel has an event of its own, more levels cost time and save nothing. The rule follows the best shapes of
    /// some recordings with windows of 4 to 131 ms. Returns `None` if the times have too many bits.
    #[must_use]
    pub const fn of_window(times: Times, effort: Effort, events: u32, pixels: u32) -> Option<Self> {
        let bits = Self::bits_of(times.count());
        // Eighths of events per active pixel.
        let shared = match (8 * events as u64).checked_div(pixels as u64) {
            Some(shared) => shared,
            None => 0,
        };
        let (first, second) = match effort {
            _ if shared >= 28 => (6, 6),
            Effort::One if shared >= 18 => (6, 2),
            Effort::One if shared >= 14 => (6, 0),
            Effort::One if shared >= 9 => (4, 0),
            Effort::One => (2, 0),
            Effort::Two | Effort::Three if shared >= 20 => (6, 2),
            Effort::Two | Effort::Three if shared >= 9 => (6, 0),
            Effort::Two | Effort::Three => (4, 0),
        };
        let first = if first < bits { first } else { bits };
        let rest = bits.saturating_sub(first);
        let second = if second < rest { second } else { rest };
        Self::new(
            times,
            Levels {
                first: first as u8,
                second: second as u8,
            },
        )
    }

    const fn bits_of(count: u32) -> u32 {
        let bits = 32 - count.saturating_sub(1).leading_zeros();
        if bits == 0 { 1 } else { bits }
    }

    /// Returns the levels of the trees.
    #[must_use]
    pub const fn levels(self) -> Levels {
        Levels {
            first: self.first as u8,
            second: self.second as u8,
        }
    }

    /// Returns the bits of a time in a leaf of the last tree.
    #[inline(always)]
    const fn leaf_bits(self) -> u32 {
        self.bits - self.first - self.second
    }
}

/// An event of a window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, FromZeros)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TreeEvent {
    /// As it is coded: the number of its cell, or of its scan with the distance from it.
    time: u32,
    /// Column, row << 16, and for ON events bit 31.
    at: u32,
}

const ON: u32 = 1 << 31;

impl TreeEvent {
    /// No event; for memory whose content does not count.
    pub const NONE: Self = Self { time: 0, at: 0 };

    /// Returns the event of a coded time ([`Times::of`]) at column and row.
    #[inline]
    #[must_use]
    pub const fn at((x, y): (u16, u16), coded_time: u32, is_on: bool) -> Self {
        Self::new(coded_time, Self::place_of(x as u32, y as u32), is_on)
    }

    /// Returns column and row.
    #[inline]
    #[must_use]
    pub const fn position(self) -> (u16, u16) {
        (self.at as u16, (self.place() >> 16) as u16)
    }

    /// Returns its time as it is coded: see [`Times`].
    #[inline]
    #[must_use]
    pub const fn coded_time(self) -> u32 {
        self.time
    }

    /// Returns whether its polarity is ON.
    #[inline]
    #[must_use]
    pub const fn is_on(self) -> bool {
        self.at & ON != 0
    }

    #[inline(always)]
    const fn new(time: u32, place: u32, is_on: bool) -> Self {
        let on = if is_on { ON } else { 0 };
        Self {
            time,
            at: place | on,
        }
    }

    #[inline(always)]
    const fn place_of(x: u32, y: u32) -> u32 {
        x | y << 16
    }

    #[inline(always)]
    const fn place(self) -> u32 {
        self.at & !ON
    }
}

/// The coder's state, which is kept in the memory from window to window until [`Self::restart`].
#[derive(Debug)]
pub struct Tree<'b> {
    pyramid: Pyramid,
    /// This window's pyramid and that of the window before; which is which changes with every window.
    bitmaps: [&'b mut [u8]; 2],
    current: &'b mut u32,
    /// Number of the window, 1 to 65535.
    number: &'b mut u32,
    state: State<'b>,
}

/// What depends on the effort.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "slices on the stack of one call")]
enum State<'b> {
    Single {
        places: places::single::Learned<'b>,
        times: single::Learned<'b>,
        activities: &'b mut [u8],
        kept: single::Kept<'b>,
    },
    Mixed {
        is_full: bool,
        places: Mixer<'b>,
        times: mixed::Learned<'b>,
        activities: &'b mut [u8],
        windows: &'b mut [u16],
        kept: mixed::Kept<'b>,
    },
}

/// Middle of how often events of an area were ON.
const AREA_EVEN: u8 = 128;

impl<'b> Tree<'b> {
    /// Returns the coder in a memory that was last used for the same sensor, effort, number of events and history, or
    /// `None` if the memory is too small: see [`Sizes::new`].
    ///
    /// If the memory's content is another one, call [`Self::restart`] first.
    #[must_use]
    pub fn new(
        sensor: Sensor,
        effort: Effort,
        events: usize,
        has_history: bool,
        memory: &'b mut TreeMemory<'_>,
    ) -> Option<Self> {
        let sizes = Sizes::new(sensor, effort, events, has_history);
        if !memory.has(&sizes) {
            return None;
        }
        let pyramid = Pyramid::new(sensor);
        let pixels = usize::from(sensor.width) * usize::from(sensor.height);
        let mut counters = memory.counters.get_mut(..sizes.counters)?;
        let mut bytes = memory.bytes.get_mut(..sizes.bytes)?;
        let mut halves = memory.halves.get_mut(..sizes.halves)?;
        let mut words = memory.words.get_mut(..sizes.words)?;
        let rows = times::row_pixels(sensor);
        let mut row_pixels = memory.pixels.get_mut(..sizes.pixels)?;
        let mut seconds = memory.seconds.get_mut(..sizes.seconds)?;
        let mut counts = words.split_off_mut(..COUNTS)?;
        let current = counts.split_off_first_mut()?;
        let number = counts.split_off_first_mut()?;
        let bitmaps = [
            bytes.split_off_mut(..pyramid.bytes)?,
            bytes.split_off_mut(..pyramid.bytes)?,
        ];
        let areas = bytes.split_off_mut(..times::area_count(sensor, 8))?;
        let state = match effort {
            Effort::One => {
                let trees = sizes.seconds / 2;
                State::Single {
                    places: places::single::Learned::new(&mut counters)?,
                    times: single::Learned::new(&mut counters)?,
                    // The rest: none without history.
                    activities: bytes,
                    kept: single::Kept {
                        pixels: split_rows(&mut row_pixels, rows)?,
                        seconds: split_rows(&mut seconds, trees)?,
                        lasts: words,
                        areas,
                    },
                }
            }
            Effort::Two | Effort::Three => {
                let is_full = effort == Effort::Three;
                let trees = sizes.seconds / 3;
                let mut marks = memory.marks.get_mut(..sizes.marks)?;
                let blocks =
                    places::mixed_sizes(is_full).blocks + times::mixed_sizes(is_full).blocks;
                let mut mixers = MixerMemory {
                    counters,
                    weights: memory.weights.get_mut(..sizes.weights)?,
                    curves: memory.curves.get_mut(..sizes.curves)?,
                    words: counts,
                    blocks: bytes.split_off_mut(..blocks)?,
                };
                State::Mixed {
                    is_full,
                    places: mixers.mixer(&places::mixed::sizes(is_full), places::mixed::LIMIT)?,
                    times: mixed::Learned::new(&mut mixers, &mut halves, is_full)?,
                    activities: bytes.split_off_mut(..pyramid.nodes)?,
                    windows: halves,
                    kept: mixed::Kept {
                        pixels: split_rows(&mut row_pixels, rows)?,
                        marks: split_rows(&mut marks, rows)?,
                        seconds: split_rows(&mut seconds, trees)?,
                        second_marks: split_rows(&mut marks, trees)?,
                        lasts: words,
                        intervals: bytes.split_off_mut(..pixels)?,
                        polarities: bytes.split_off_mut(..pixels)?,
                        areas,
                        fine_areas: bytes,
                    },
                }
            }
        };
        Some(Self {
            pyramid,
            bitmaps,
            current,
            number,
            state,
        })
    }

    /// Forgets everything learned and every window before: a key frame follows.
    pub fn restart(&mut self) {
        for bitmap in &mut self.bitmaps {
            bitmap.fill(0);
        }
        (*self.current, *self.number) = (0, 0);
        match &mut self.state {
            State::Single {
                places,
                times,
                activities,
                kept,
            } => {
                places.restart();
                times.restart();
                activities.fill(0);
                for row in &mut kept.pixels {
                    row.fill(Pixel::NONE);
                }
                kept.lasts.fill(0);
                kept.areas.fill(AREA_EVEN);
            }
            State::Mixed {
                places,
                times,
                activities,
                windows,
                kept,
                ..
            } => {
                places.restart();
                times.restart();
                activities.fill(0);
                windows.fill(0);
                for row in &mut kept.pixels {
                    row.fill(Pixel::NONE);
                }
                for row in &mut kept.marks {
                    row.fill(Marks::default());
                }
                kept.lasts.fill(0);
                kept.intervals.fill(0);
                kept.polarities.fill(0);
                kept.areas.fill(AREA_EVEN);
                kept.fine_areas.fill(AREA_EVEN);
            }
        }
    }

    /// Encodes a window that begins at `start` ([`crate::frame::Header::clock`]), and returns the payload's length in
    /// bytes, or `None` if `out` was too short: the next window then has to begin with [`Self::restart`].
    ///
    /// `events` are in raster order, and in a pixel by time; those of equal time keep their order. Their times are
    /// below those of the shape.
    #[must_use]
    pub fn encode(
        &mut self,
        shape: Shape,
        start: u32,
        events: &mut [TreeEvent],
        out: &mut [u8],
    ) -> Option<usize> {
        if events.is_empty() {
            return Some(0);
        }
        let pixels = events.iter().map(|event| event.position());
        let pixels = pixels.map(|(x, y)| (u32::from(x), u32::from(y)));
        let [even, odd] = &mut self.bitmaps;
        let now = if *self.current & 1 == 0 { even } else { odd };
        self.pyramid.set(now, pixels);
        let mut coder = Encoder::new(out);
        let done = self.code(&mut coder, shape, start, events);
        debug_assert_eq!(done, events.len(), "events are out of order");
        coder.finish()
    }

    /// Decodes the window of `events.len()` events that [`Self::encode`] encoded, in the same order. Returns whether
    /// the payload holds exactly these; if not, `events` hold anything on the sensor, and the state is of no use.
    #[must_use]
    pub fn decode(
        &mut self,
        shape: Shape,
        start: u32,
        payload: &[u8],
        events: &mut [TreeEvent],
    ) -> bool {
        if events.is_empty() {
            return payload.is_empty();
        }
        let mut coder = Decoder::new(payload);
        let done = self.code(&mut coder, shape, start, events);
        done == events.len() && coder.is_spent()
    }

    /// Codes a window. Returns the number of its events.
    #[inline(always)]
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        shape: Shape,
        start: u32,
        events: &mut [TreeEvent],
    ) -> usize {
        let Self {
            pyramid,
            bitmaps: [even, odd],
            current,
            number,
            state,
        } = self;
        let (now, before) = if **current & 1 == 0 {
            (even, odd)
        } else {
            (odd, even)
        };
        **current ^= 1;
        **number = if **number >= u32::from(u16::MAX) {
            1
        } else {
            **number + 1
        };
        let clock = Clock::new(shape, start);
        match state {
            State::Single {
                places,
                times,
                activities,
                kept,
            } => {
                places::single::code(coder, places, pyramid, now, before, activities);
                single::code(coder, times, kept, (pyramid.pixels(), now), clock, events)
            }
            State::Mixed {
                is_full,
                places,
                times,
                activities,
                windows,
                kept,
            } => {
                let mut history = places::mixed::History {
                    activities,
                    windows,
                    number: **number as u16,
                };
                let history = &mut history;
                if *is_full {
                    places::mixed::code::<C, true>(coder, places, pyramid, now, before, history);
                    mixed::code::<C, true>(
                        coder,
                        times,
                        kept,
                        (pyramid.pixels(), now),
                        clock,
                        events,
                    )
                } else {
                    places::mixed::code::<C, false>(coder, places, pyramid, now, before, history);
                    mixed::code::<C, false>(
                        coder,
                        times,
                        kept,
                        (pyramid.pixels(), now),
                        clock,
                        events,
                    )
                }
            }
        }
    }
}

/// Takes rows of `len` from the start.
fn split_rows<'b, T, const N: usize>(
    from: &mut &'b mut [T],
    len: usize,
) -> Option<[&'b mut [T]; N]> {
    let mut rows = [const { None }; N];
    for row in &mut rows {
        *row = Some(from.split_off_mut(..len)?);
    }
    let rows = rows.map(Option::unwrap_or_default);
    Some(rows)
}

#[cfg(test)]
mod tests;
