//! The dense event coder: adaptive contexts from pixels already coded, for the fewest bits.
//!
//! A frame's pixels go by in raster order. What is coded of them, each decision with a probability
//! learned in its context ([`super::range`]):
//!
//! * which rows, segments of 32 columns and pixels have events, from the pixels around, those of the
//!   window before among them;
//! * the polarity and the cell ([`super::cells`]) of a pixel's first event, and of each further one
//!   whether there is one, its polarity and its distance, from the pixel's events so far and from
//!   those of its western and northern neighbours.
//!
//! One function codes both ways. Time per event is bounded; memory is what was lent.

use super::content::{Content, END};
use super::range::{Binary, Probability};
use super::scan::{fine_of, fine_parts};
use super::times::Times;
use crate::event::Sensor;

/// Learned probabilities, by what they are of.
const ROW: usize = 0;
const SEGMENT: usize = ROW + 4;
const PIXEL: usize = SEGMENT + 256;
const POLARITY: usize = PIXEL + 512;
const MORE: usize = POLARITY + 243;
const FLIP: usize = MORE + 3 * 8 * 6 * 4 * 2;
const LONG: usize = FLIP + 16 * 2 * 3 * 3;
const LENGTH: usize = LONG + 1;
const LENGTH_NEAR: usize = LENGTH + 12 * 6 * 2 * 16;
const LONGER: usize = LENGTH_NEAR + 12 * 9 * 2 * 16;
const FIRST: usize = LONGER + 32;
const PREFIX: usize = FIRST + 64;
const FINE: usize = PREFIX + 17 * PREFIX_CONTEXTS;
/// How many there are, of 2 bytes each.
pub const PROBABILITIES: usize = FINE + 2 + FINE_LEARNED as usize;
/// Of a length: 15 places with either bit of the candidate, 3 after the first difference with its
/// direction, and a tree of 3 where there is no candidate.
const PREFIX_CONTEXTS: usize = 30 + 12 + 8;
/// The first times' set of them: beyond those of the lengths.
const PREFIX_FIRST: usize = 16;

/// Magnitudes of a distance from a scan that are learned; the others are plain.
const FINE_LEARNED: u32 = 4;
/// Bits of the first time that are learned where no neighbour has one.
const FIRST_BITS: u32 = 6;
/// Bytes that an event takes at the most: 66 decisions of up to 7.7 bits, and 32 plain ones.
pub const EVENT_BYTES_MAX: usize = 72;
/// Events of a neighbour looked at for one of the same polarity.
const LOOK_AHEAD: usize = 4;

/// Rows of bits that are kept: all with those of the window before, and without them this one, two
/// above, and one more, so that a row's place is cheap to find.
const fn rows(sensor: Sensor, has_previous: bool) -> usize {
    let height = sensor.height as usize;
    if has_previous || height < RING_ROWS {
        height
    } else {
        RING_ROWS
    }
}

const RING_ROWS: usize = 4;

/// Memory lent to a [`Dense`] coder.
#[derive(Debug)]
pub struct DenseMemory<'b> {
    /// [`PROBABILITIES`] of them.
    pub probabilities: &'b mut [Probability],
    /// [`words`] of them.
    pub words: &'b mut [u32],
}

impl DenseMemory<'_> {
    /// Whether it is enough for a sensor.
    #[must_use]
    pub const fn serves(&self, sensor: Sensor) -> bool {
        self.probabilities.len() >= PROBABILITIES && self.words.len() >= words(sensor, false)
    }

    /// Whether it also holds the window before.
    #[must_use]
    pub const fn has_previous(&self, sensor: Sensor) -> bool {
        self.words.len() >= words(sensor, true)
    }
}

/// Words that a sensor takes; without the window before, which costs bits in sparse scenes, far
/// fewer.
#[must_use]
pub const fn words(sensor: Sensor, has_previous: bool) -> usize {
    let stride = sensor.width.div_ceil(32) as usize;
    let rows = rows(sensor, has_previous);
    2 * stride * rows + 2 * stride + sensor.width as usize
}

/// What was coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Coded {
    /// Events.
    pub events: u32,
    /// Pixels with events.
    pub pixels: u32,
    /// More was learned than a decoder reads: the next frame has to begin anew.
    pub overran: bool,
}

/// The coder's state, which goes on from frame to frame until [`Self::restart`].
#[derive(Debug)]
pub struct Dense<'b> {
    probabilities: &'b mut [Probability; PROBABILITIES],
    /// A bit per pixel: of this window up to the pixel at hand, of the one before after it.
    occupied: &'b mut [u32],
    /// The same for the polarity of its last event.
    last_on: &'b mut [u32],
    /// The polarity of the first event, in this row and the one above.
    first_on: &'b mut [u32],
    /// The events of the latest pixel of each column.
    lists: &'b mut [u32],
    sensor: Sensor,
    stride: usize,
    has_previous: bool,
}

impl<'b> Dense<'b> {
    /// The coder in a memory that was last used for the same sensor, or of which nothing is known:
    /// then [`Self::restart`] comes first. `None` where it is too small.
    #[must_use]
    pub fn new(sensor: Sensor, memory: &'b mut DenseMemory<'_>) -> Option<Self> {
        let has_previous = memory.has_previous(sensor);
        Self::with_previous(sensor, has_previous, memory)
    }

    /// As [`Self::new`], for a decoder, which is told whether the encoder held the window before.
    #[must_use]
    pub fn with_previous(
        sensor: Sensor,
        has_previous: bool,
        memory: &'b mut DenseMemory<'_>,
    ) -> Option<Self> {
        let DenseMemory {
            probabilities,
            words,
        } = memory;
        let (probabilities, _) = probabilities.split_first_chunk_mut()?;
        let stride = usize::from(sensor.width.div_ceil(32));
        let rows = rows(sensor, has_previous);
        let (occupied, rest) = words.split_at_mut_checked(stride * rows)?;
        let (last_on, rest) = rest.split_at_mut_checked(stride * rows)?;
        let (first_on, rest) = rest.split_at_mut_checked(2 * stride)?;
        let (lists, _) = rest.split_at_mut_checked(usize::from(sensor.width))?;
        Some(Self {
            probabilities,
            occupied,
            last_on,
            first_on,
            lists,
            sensor,
            stride,
            has_previous,
        })
    }

    /// Forgets everything: the next frame decodes by itself.
    pub fn restart(&mut self) {
        self.probabilities.fill(Probability::EVEN);
        self.occupied.fill(0);
        self.last_on.fill(0);
    }

    /// Codes a frame, whose times are told so, up to the end of its content or of the coder's room.
    pub fn code<C: Binary, T: Content>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        times: Times,
    ) -> Coded {
        let cells = times.count();
        let mut pixels = Pixels {
            state: PixelState {
                cells,
                time_bits: 32 - (cells - 1).leading_zeros(),
                fine_bits: times.fine_bits(),
                last_length: 0,
            },
            coded: Coded {
                events: 0,
                pixels: 0,
                overran: false,
            },
        };
        let height = usize::from(self.sensor.height);
        let mut y = 0;
        let mut above_is_active = false;
        while y < height {
            if content.is_over() {
                break;
            }
            let row = self.row(y);
            let was_active = self.has_previous
                && words_at(self.occupied, row, self.stride)
                    .iter()
                    .any(|word| *word != 0);
            let context = ROW + usize::from(above_is_active) + 2 * usize::from(was_active);
            let is_active = coder.bit(
                learned_at(self.probabilities, context),
                content.has_row(y as u16),
            );
            above_is_active = is_active;
            if is_active {
                if !self.code_row(coder, content, y, &mut pixels) {
                    y += 1;
                    break;
                }
            } else if was_active || !self.has_previous {
                words_at(self.occupied, row, self.stride).fill(0);
            }
            y += 1;
        }
        // What is below has no events in this frame.
        if self.has_previous {
            words_at(self.occupied, y * self.stride, usize::MAX).fill(0);
        }
        pixels.coded
    }

    #[inline(always)]
    fn row(&self, y: usize) -> usize {
        if self.has_previous {
            y * self.stride
        } else {
            (y % RING_ROWS) * self.stride
        }
    }

    #[inline(always)]
    fn list(&self, x: usize) -> u32 {
        self.lists.get(x).copied().unwrap_or(END)
    }

    /// Whether there may be more after this row.
    fn code_row<C: Binary, T: Content>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        y: usize,
        pixels: &mut Pixels,
    ) -> bool {
        let stride = self.stride;
        let row = self.row(y);
        let above = |rows: usize| (y >= rows).then(|| self.row(y - rows));
        let (north, far_north) = (above(1), above(2));
        let south =
            (self.has_previous && y + 1 < usize::from(self.sensor.height)).then(|| self.row(y + 1));
        let first_here = (y % 2) * stride;
        let first_north = stride - first_here;
        let mut segment = 0;
        let mut goes_on = true;
        while segment < stride {
            let word = |of: &[u32], row: Option<usize>, at: usize| match row {
                Some(row) if at < stride => of.get(row + at).copied().unwrap_or(0),
                _ => 0,
            };
            let occupied = &*self.occupied;
            let before = segment.wrapping_sub(1);
            let old = if self.has_previous {
                word(occupied, Some(row), segment)
            } else {
                0
            };
            let old_next = if self.has_previous {
                word(occupied, Some(row), segment + 1)
            } else {
                0
            };
            let around = Around {
                west: word(occupied, Some(row), before),
                north: [
                    word(occupied, north, before),
                    word(occupied, north, segment),
                    word(occupied, north, segment + 1),
                ],
                far_north: word(occupied, far_north, segment),
                old: [old, old_next],
                south: [
                    word(occupied, south, before),
                    word(occupied, south, segment),
                    word(occupied, south, segment + 1),
                ],
                old_last_on: word(self.last_on, Some(row), segment),
                first_west: word(self.first_on, Some(first_here), before),
                first_north: [
                    word(self.first_on, Some(first_north), before),
                    word(self.first_on, Some(first_north), segment),
                    word(self.first_on, Some(first_north), segment + 1),
                ],
            };
            let flag = learned_at(self.probabilities, SEGMENT + around.segment_context());
            let mut made = Made::default();
            if coder.bit(flag, content.has_segment(segment as u16)) {
                goes_on =
                    self.code_segment(coder, content, (segment, y), &around, &mut made, pixels);
            }
            set(self.occupied, row + segment, made.occupied);
            set(self.last_on, row + segment, made.last_on);
            set(self.first_on, first_here + segment, made.first_on);
            segment += 1;
            if !goes_on || content.is_over() {
                goes_on = false;
                break;
            }
        }
        words_at(self.occupied, row + segment, stride - segment).fill(0);
        goes_on
    }

    /// Whether there may be more after this segment.
    #[inline(always)]
    fn code_segment<C: Binary, T: Content>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        (segment, y): (usize, usize),
        around: &Around,
        made: &mut Made,
        pixels: &mut Pixels,
    ) -> bool {
        let mut wide = around.widen();
        let columns = (usize::from(self.sensor.width) - 32 * segment).min(32);
        let mut left = content.columns();
        let mut west_list = if around.west >> 31 == 1 && segment > 0 {
            self.list(32 * segment - 1)
        } else {
            END
        };
        for i in 0..columns {
            let flag = learned_at(self.probabilities, PIXEL + wide.pixel_context());
            let is_active = coder.bit(flag, left & 1 == 1);
            left >>= 1;
            if !is_active {
                west_list = END;
                wide.go_on(false, false);
                continue;
            }
            let x = 32 * segment + i;
            let list = content.enter((x as u16, y as u16));
            let north_list = if wide.has_north() { self.list(x) } else { END };
            let polarity = POLARITY + wide.polarity_context();
            if !coder.has_room(EVENT_BYTES_MAX) {
                pixels.coded.overran = true;
                return false;
            }
            let learned = &mut *self.probabilities;
            let state = &mut pixels.state;
            let (first_on, last_on, events, goes_on) =
                state.code(learned, coder, content, polarity, (west_list, north_list));
            pixels.coded.pixels += 1;
            pixels.coded.events += events;
            set(self.lists, x, list);
            west_list = list;
            made.occupied |= 1 << i;
            made.first_on |= u32::from(first_on) << i;
            made.last_on |= u32::from(last_on) << i;
            if !goes_on {
                return false;
            }
            wide.go_on(true, first_on);
        }
        true
    }
}

#[inline(always)]
fn set(words: &mut [u32], at: usize, word: u32) {
    if let Some(place) = words.get_mut(at) {
        *place = word;
    }
}

/// Up to `count` words from `at` on.
#[inline(always)]
fn words_at(words: &mut [u32], at: usize, count: usize) -> &mut [u32] {
    let rest = words.get_mut(at..).unwrap_or_default();
    let count = rest.len().min(count);
    rest.get_mut(..count).unwrap_or_default()
}

/// What a segment was made of.
#[derive(Debug, Default)]
struct Made {
    occupied: u32,
    first_on: u32,
    last_on: u32,
}

/// What is around a segment; [_; 3] are the words to the west, at it, and to the east.
#[derive(Debug)]
struct Around {
    west: u32,
    north: [u32; 3],
    far_north: u32,
    /// Of the window before, here and to the east.
    old: [u32; 2],
    /// Of the window before, in the row below.
    south: [u32; 3],
    old_last_on: u32,
    first_west: u32,
    first_north: [u32; 3],
}

impl Around {
    #[inline(always)]
    fn segment_context(&self) -> usize {
        let few = |word: u32| {
            word.count_ones()
                .min(7)
                .checked_ilog2()
                .map_or(0, |log| log + 1)
        };
        let [_, north, north_east] = self.north;
        let context =
            few(self.west) << 6 | few(north) << 4 | few(self.old[0]) << 2 | few(north_east);
        context as usize
    }

    #[inline(always)]
    fn widen(&self) -> Wide {
        let wide = |[west, here, east]: [u32; 3]| {
            u64::from(west >> 31) | u64::from(here) << 1 | u64::from(east & 1) << 33
        };
        Wide {
            west: self.west >> 30,
            first_west: self.first_west >> 31,
            north: wide(self.north),
            far_north: self.far_north,
            old: u64::from(self.old[0]) | u64::from(self.old[1] & 1) << 32,
            south: wide(self.south),
            old_last_on: self.old_last_on,
            first_north: wide(self.first_north),
        }
    }
}

/// The same with its neighbours' bits beside, as seen from a column, which moves on: its own bit is
/// the lowest but in `north`, `south` and `first_north`, where it is the second.
#[derive(Debug)]
struct Wide {
    /// The two columns to the west, the nearer one at bit 1.
    west: u32,
    first_west: u32,
    north: u64,
    far_north: u32,
    old: u64,
    south: u64,
    old_last_on: u32,
    first_north: u64,
}

/// How many bits a number of four has, 3 for more, two bits for each number.
const COUNTS: u32 = {
    let (mut counts, mut number) = (0, 0_u32);
    while number < 16 {
        let ones = number.count_ones();
        counts |= (if ones < 3 { ones } else { 3 }) << (2 * number);
        number += 1;
    }
    counts
};

impl Wide {
    #[inline(always)]
    fn pixel_context(&self) -> usize {
        let (north, old) = (self.north as u32 & 7, self.old as u32);
        // East, and the three to the south.
        let later = self.south as u32 & 7 | (old & 2) << 2;
        let count = COUNTS >> (2 * later) & 3;
        (self.west | north << 2 | (self.far_north & 1) << 5 | (old & 1) << 6 | count << 7) as usize
    }

    #[inline(always)]
    fn has_north(&self) -> bool {
        self.north & 2 != 0
    }

    #[inline(always)]
    fn polarity_context(&self) -> usize {
        // None, OFF or ON.
        let of = |occupied: u32, on: u32| (occupied & 1) * (1 + (on & 1));
        let (north, first) = (self.north as u32, self.first_north as u32);
        let mut context = of(self.west >> 1, self.first_west);
        for at in [1, 0, 2] {
            context = 3 * context + of(north >> at, first >> at);
        }
        (3 * context + of(self.old as u32, self.old_last_on)) as usize
    }

    /// To the next column; this one has events, of which the first is ON.
    #[inline(always)]
    fn go_on(&mut self, is_active: bool, first_on: bool) {
        self.west = self.west >> 1 | u32::from(is_active) << 1;
        self.first_west = u32::from(first_on);
        self.north >>= 1;
        self.far_north >>= 1;
        self.old >>= 1;
        self.south >>= 1;
        self.old_last_on >>= 1;
        self.first_north >>= 1;
    }
}

struct Pixels {
    state: PixelState,
    coded: Coded,
}

/// What goes on from pixel to pixel.
struct PixelState {
    cells: u32,
    /// Bits of a cell's number.
    time_bits: u32,
    /// Bits that are told beside it.
    fine_bits: u32,
    /// Bits of the last distance between two events of a pixel, up to 15.
    last_length: u32,
}

/// Contexts of a last length.
const OF_LENGTH: [u8; 16] = [0, 1, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 11, 11];
/// The same for whether there is more.
const OF_LENGTH_MORE: [u8; 16] = [0, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5];
/// Contexts of the bits of a neighbour's distance.
const OF_NEAR: [u8; 17] = [0, 1, 1, 1, 1, 1, 2, 3, 4, 5, 6, 7, 7, 7, 8, 8, 8];

const fn length_of(value: u32) -> u32 {
    u32::BITS - value.leading_zeros()
}

type Learned = [Probability; PROBABILITIES];

/// Contexts are sums of bounded parts; the bound here is for the compiler.
#[inline(always)]
fn learned_at(learned: &mut Learned, context: usize) -> &mut Probability {
    &mut learned[context.min(PROBABILITIES - 1)]
}

impl PixelState {
    /// A pixel: the polarities of its first and last event, how many it has, and whether the frame
    /// goes on after it.
    #[inline(always)]
    fn code<C: Binary, T: Content>(
        &mut self,
        learned: &mut Learned,
        coder: &mut C,
        content: &mut T,
        polarity: usize,
        (mut west, mut north): (u32, u32),
    ) -> (bool, bool, u32, bool) {
        let (told, on) = content.peek();
        let cell = told >> self.fine_bits;
        let first_on = coder.bit(learned_at(learned, polarity), on);
        let fine_bits = self.fine_bits;
        let like = |list: u32, content: &T| {
            content
                .at(list)
                .filter(|node| node.on == first_on)
                .map(|node| node.cell >> fine_bits)
        };
        let candidate = like(west, content).or_else(|| like(north, content));
        // Here and below, only what no encoder writes goes beyond the last cell.
        let mut cell = match candidate {
            Some(candidate) => {
                let told = (cell, self.time_bits);
                let cell = prefix(learned, coder, PREFIX_FIRST, told, Some(candidate));
                cell.min(self.cells - 1)
            }
            None => self.first(learned, coder, cell),
        };
        content.take(self.fine(learned, coder, cell, told), first_on);
        let (mut on, mut before, mut events) = (first_on, 2, 1);
        loop {
            if content.is_over() || !coder.has_room(EVENT_BYTES_MAX) {
                return (first_on, on, events, false);
            }
            let west_next = after(content, &mut west, cell, fine_bits);
            let north_next = after(content, &mut north, cell, fine_bits);
            let later = self.later(cell);
            let next = usize::from(west_next.is_some()) | usize::from(north_next.is_some()) << 1;
            let length = if events == 1 { 0 } else { self.last_length };
            let turn = (events as usize - 1).min(2);
            let of_length = usize::from(OF_LENGTH_MORE[length as usize & 15]);
            let context = ((turn * 8 + later.eighth) * 6 + of_length) * 4 + next;
            let flag = learned_at(learned, MORE + 2 * context + usize::from(on));
            if !coder.bit(flag, content.is_more()) {
                break;
            }
            let (told, next_on) = content.peek();
            let near_on = west_next
                .or(north_next)
                .map_or(0, |(_, on)| 1 + usize::from(on));
            let context = (self.last_length as usize * 2 + usize::from(on)) * 3 + before;
            let flag = learned_at(learned, FLIP + 3 * context + near_on);
            let next_on = coder.bit(flag, next_on);
            let flips = next_on != on;
            before = usize::from(on);
            let near = match (west_next, north_next) {
                (Some((west, _)), Some((north, _))) => west.min(north),
                (Some((one, _)), None) | (None, Some((one, _))) => one,
                (None, None) => 0,
            };
            let mut distance = (told >> fine_bits).wrapping_sub(cell);
            let length = length_of(distance);
            let length = self.length(learned, coder, length, (later.rest, near, flips));
            if length > 1 {
                let like = |list: u32, content: &T| {
                    same_length(content, list, (cell, next_on, length), fine_bits)
                };
                let candidate = like(west, content).or_else(|| like(north, content));
                let set = (length as usize).min(15);
                // The highest bit is 1.
                let low = prefix(learned, coder, set, (distance, length - 1), candidate);
                distance = 1 << (length - 1) | low;
            } else {
                distance = length;
            }
            cell = cell.saturating_add(distance).min(self.cells - 1);
            on = next_on;
            self.last_length = length.min(15);
            content.take(self.fine(learned, coder, cell, told), on);
            events += 1;
        }
        (first_on, on, events, true)
    }

    /// What is told beside a cell, where there is anything.
    #[inline(always)]
    fn fine<C: Binary>(&self, learned: &mut Learned, coder: &mut C, cell: u32, told: u32) -> u32 {
        if self.fine_bits == 0 {
            return cell;
        }
        let mask = (1 << self.fine_bits) - 1;
        let (magnitude, is_before) = fine_parts(told & mask);
        let mut made = 0;
        while made < FINE_LEARNED
            && coder.bit(learned_at(learned, FINE + made as usize), magnitude > made)
        {
            made += 1;
        }
        if made == FINE_LEARNED {
            made += coder.plain(magnitude.saturating_sub(made), self.fine_bits - 1);
        }
        let sign = FINE + FINE_LEARNED as usize + usize::from(made > 1);
        let is_before = made > 0 && coder.bit(learned_at(learned, sign), is_before);
        cell << self.fine_bits | fine_of(made, is_before)
    }

    /// The first time of a pixel whose neighbours tell nothing.
    #[inline(always)]
    fn first<C: Binary>(&self, learned: &mut Learned, coder: &mut C, cell: u32) -> u32 {
        let high = self.time_bits.min(FIRST_BITS);
        let low = self.time_bits - high;
        let mut node = 1_usize;
        for i in (0..high).rev() {
            let bit = coder.bit(
                learned_at(learned, FIRST + node % 64),
                cell >> (low + i) & 1 == 1,
            );
            node = 2 * node + usize::from(bit);
        }
        let top = node as u32 - (1 << high);
        let rest = coder.plain(cell & ((1 << low) - 1), low);
        (top << low | rest).min(self.cells - 1)
    }

    /// What is left of the window after a cell.
    #[inline(always)]
    fn later(&self, cell: u32) -> Later {
        let left = self.cells - cell;
        let short = self.time_bits.saturating_sub(length_of(left));
        let rest = 5 - short.min(5) as usize;
        let eighth = if short > 0 {
            rest.saturating_sub(1)
        } else {
            match (u64::from(left) << 3 >> self.time_bits) & 3 {
                0 => 5,
                3 => 7,
                _ => 6,
            }
        };
        Later { eighth, rest }
    }

    /// The bits of a distance.
    #[inline(always)]
    fn length<C: Binary>(
        &self,
        learned: &mut Learned,
        coder: &mut C,
        length: u32,
        (rest, near, flips): (usize, u32, bool),
    ) -> u32 {
        if self.time_bits > 15 && coder.bit(learned_at(learned, LONG), length > 15) {
            let mut node = 1_usize;
            for i in (0..5).rev() {
                let bit = coder.bit(learned_at(learned, LONGER + node), length >> i & 1 == 1);
                node = 2 * node + usize::from(bit);
            }
            // 16 to 32 as 16 to 31 and 0.
            let read = node as u32 & 31;
            return if read < 16 { 32 } else { read };
        }
        let last = usize::from(OF_LENGTH[self.last_length as usize & 15]);
        let of_near = if near == 0 {
            0
        } else {
            length_of(near).min(16) as usize
        };
        let one = LENGTH + ((last * 6 + rest) * 2 + usize::from(flips)) * 16;
        let two = LENGTH_NEAR
            + ((last * 9 + usize::from(OF_NEAR[of_near])) * 2 + usize::from(flips)) * 16;
        let mut node = 1_usize;
        for i in (0..4).rev() {
            let bit = length >> i & 1 == 1;
            let (low, high) = learned.split_at_mut(LENGTH_NEAR);
            let (Some(a), Some(b)) = (
                low.get_mut(one + node),
                high.get_mut(two - LENGTH_NEAR + node),
            ) else {
                // Both are in their tables.
                break;
            };
            let bit = coder.bit_of_two(a, b, bit);
            node = 2 * node + usize::from(bit);
        }
        node as u32 & 15
    }
}

/// What is left of a window: its eighth, finer in its first half, and its power of two.
struct Later {
    eighth: usize,
    rest: usize,
}

/// Moves a neighbour's list behind `cell`; how far its next event is from there, and its polarity.
#[inline(always)]
fn after<T: Content>(
    content: &T,
    list: &mut u32,
    cell: u32,
    fine_bits: u32,
) -> Option<(u32, bool)> {
    loop {
        let node = content.at(*list)?;
        let its = node.cell >> fine_bits;
        if its > cell {
            return Some((its - cell, node.on));
        }
        *list = node.next;
    }
}

/// The distance from `cell` of the next of a neighbour's events of one polarity, where it has so many
/// bits.
#[inline(always)]
fn same_length<T: Content>(
    content: &T,
    mut list: u32,
    (cell, on, length): (u32, bool, u32),
    fine_bits: u32,
) -> Option<u32> {
    for _ in 0..LOOK_AHEAD {
        let node = content.at(list)?;
        if node.on == on {
            let distance = (node.cell >> fine_bits).wrapping_sub(cell);
            return (length_of(distance) == length).then_some(distance);
        }
        list = node.next;
    }
    None
}

/// The low `bits` bits of a value, of which a candidate may have the upper ones.
#[inline(always)]
fn prefix<C: Binary>(
    learned: &mut Learned,
    coder: &mut C,
    set: usize,
    (value, bits): (u32, u32),
    candidate: Option<u32>,
) -> u32 {
    let contexts = PREFIX + set * PREFIX_CONTEXTS;
    let mut made = 0;
    let mut left = bits;
    let mut code = |context: usize, left: &mut u32| {
        *left -= 1;
        let bit = coder.bit(
            learned_at(learned, contexts + context),
            value >> *left & 1 == 1,
        );
        made = made << 1 | u32::from(bit);
        bit
    };
    match candidate {
        Some(candidate) => {
            // As long as it is right.
            let mut differs = None;
            while left > 0 && differs.is_none() {
                let expected = candidate >> (left - 1) & 1 == 1;
                let place = (left - 1).min(14) as usize;
                let bit = code(2 * place + usize::from(expected), &mut left);
                differs = (bit != expected).then_some(bit);
            }
            // Near it: just above, zeros follow, or just below, ones.
            if let Some(up) = differs {
                for i in 0..3 {
                    if left == 0 {
                        break;
                    }
                    let expected = candidate >> (left - 1) & 1 == 1;
                    let context = 30 + 4 * i + 2 * usize::from(up) + usize::from(expected);
                    if code(context, &mut left) == up {
                        break;
                    }
                }
            }
        }
        None => {
            let mut node = 1;
            for _ in 0..3 {
                if left == 0 {
                    break;
                }
                node = 2 * node + usize::from(code(42 + node, &mut left));
            }
        }
    }
    let rest = coder.plain(value & low_mask(left), left);
    let high = if left < 32 { made << left } else { 0 };
    high | rest
}

const fn low_mask(bits: u32) -> u32 {
    if bits < 32 { (1 << bits) - 1 } else { u32::MAX }
}

#[cfg(test)]
mod tests {
    use super::super::cells::Fidelity;
    use super::super::content::Node;
    use super::super::range::{RangeDecoder, RangeEncoder};
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;
    use std::vec;
    use std::vec::Vec;

    type Pixel = ((u16, u16), Vec<(u32, bool)>);

    /// Pixels in raster order, y first, with their events in order of time.
    fn pixels(events: &[(u16, u16, u32, bool)]) -> Vec<Pixel> {
        let mut pixels = BTreeMap::<_, Vec<_>>::new();
        for (x, y, cell, on) in events {
            pixels.entry((*y, *x)).or_default().push((*cell, *on));
        }
        pixels
            .into_iter()
            .map(|((y, x), mut events)| {
                events.sort_by_key(|(cell, _)| *cell);
                ((x, y), events)
            })
            .collect()
    }

    /// A frame on either side, as one list of events.
    struct Listed {
        pixels: Vec<Pixel>,
        nodes: Vec<Node>,
        at: (usize, usize),
        place: (u16, u16),
        found: Vec<Pixel>,
        left: u32,
    }

    impl Listed {
        fn new(pixels: Vec<Pixel>, left: u32) -> Self {
            Self {
                pixels,
                nodes: vec![],
                at: (0, 0),
                place: (0, 0),
                found: vec![],
                left,
            }
        }
    }

    impl Content for Listed {
        fn has_row(&mut self, y: u16) -> bool {
            self.place.1 = y;
            self.pixels
                .get(self.at.0)
                .is_some_and(|pixel| pixel.0.1 == y)
        }
        fn has_segment(&mut self, segment: u16) -> bool {
            self.place.0 = segment;
            self.pixels
                .get(self.at.0)
                .is_some_and(|pixel| (pixel.0.0 / 32, pixel.0.1) == self.place)
        }
        fn columns(&mut self) -> u32 {
            let of_segment = self.pixels.get(self.at.0..).unwrap_or_default().iter();
            of_segment
                .take_while(|pixel| (pixel.0.0 / 32, pixel.0.1) == self.place)
                .fold(0, |columns, pixel| columns | 1 << (pixel.0.0 % 32))
        }
        fn enter(&mut self, position: (u16, u16)) -> u32 {
            self.found.push((position, vec![]));
            self.nodes.len() as u32
        }
        fn is_more(&self) -> bool {
            self.pixels.get(self.at.0).is_some_and(|pixel| {
                pixel.0 == self.found.last().unwrap().0 && self.at.1 < pixel.1.len()
            })
        }
        fn peek(&self) -> (u32, bool) {
            self.pixels
                .get(self.at.0)
                .map_or((0, false), |pixel| pixel.1[self.at.1])
        }
        fn take(&mut self, cell: u32, on: bool) {
            let len = self.nodes.len();
            let pixel = self.found.last_mut().unwrap();
            if let Some(node) = self.nodes.last_mut()
                && !pixel.1.is_empty()
            {
                node.next = len as u32;
            }
            self.nodes.push(Node {
                cell,
                on,
                next: END,
            });
            pixel.1.push((cell, on));
            self.left -= 1;
            self.at.1 += 1;
            if self
                .pixels
                .get(self.at.0)
                .is_some_and(|pixel| pixel.1.len() == self.at.1)
            {
                self.at = (self.at.0 + 1, 0);
            }
        }
        fn is_over(&self) -> bool {
            self.left == 0
        }
        fn at(&self, list: u32) -> Option<Node> {
            self.nodes.get(list as usize).copied()
        }
    }

    struct Memory(Vec<Probability>, Vec<u32>);

    impl Memory {
        fn new(sensor: Sensor, has_previous: bool) -> Self {
            let words = words(sensor, has_previous);
            Self(vec![Probability::EVEN; PROBABILITIES], vec![7; words])
        }
        fn lent(&mut self) -> DenseMemory<'_> {
            DenseMemory {
                probabilities: &mut self.0,
                words: &mut self.1,
            }
        }
    }

    /// Encodes a window into as many frames as it takes and decodes them; their bytes.
    fn there_and_back(
        (encoder, decoder): (&mut Dense<'_>, &mut Dense<'_>),
        pixels: &[Pixel],
        cells: u32,
        out_bytes: usize,
    ) -> Vec<usize> {
        let times = Times::new(Fidelity::Lossless, None, cells);
        let count = |pixels: &[Pixel]| pixels.iter().map(|pixel| pixel.1.len() as u32).sum::<u32>();
        let mut frames = vec![];
        let mut content = Listed::new(pixels.to_vec(), count(pixels));
        let mut decoded = BTreeMap::<_, Vec<_>>::new();
        while !content.is_over() {
            let mut out = vec![0; out_bytes];
            let mut coder = RangeEncoder::new(&mut out);
            let coded = encoder.code(&mut coder, &mut content, times);
            assert!(coded.events > 0);
            let bytes = coder.finish();
            let mut reader = RangeDecoder::new(&out[..bytes]);
            let mut read = Listed::new(vec![], coded.events);
            let again = decoder.code(&mut reader, &mut read, times);
            assert_eq!((again.events, again.pixels), (coded.events, coded.pixels));
            assert!(coded.overran || reader.is_spent());
            if coded.overran {
                encoder.restart();
                decoder.restart();
            }
            for ((x, y), events) in read.found {
                decoded.entry((y, x)).or_default().extend(events);
            }
            frames.push(bytes);
        }
        let expected: BTreeMap<_, _> = pixels
            .iter()
            .map(|((x, y), events)| ((*y, *x), events.clone()))
            .collect();
        assert_eq!(decoded, expected);
        frames
    }

    fn events(
        width: u16,
        height: u16,
        cells: u32,
    ) -> impl Strategy<Value = Vec<(u16, u16, u32, bool)>> {
        let near = (
            0..width.min(3),
            0..height.min(3),
            0..cells.min(40),
            any::<bool>(),
        );
        let any = (0..width, 0..height, 0..cells, any::<bool>());
        proptest::collection::vec(prop_oneof![any, near], 0..200)
    }

    proptest! {
        #[test]
        fn windows_come_back(
            (width, height, cells, windows) in (1_u16..100, 1_u16..20, prop_oneof![1_u32..70, 1_u32..])
                .prop_flat_map(|(width, height, cells)| {
                    let window = events(width, height, cells);
                    (Just(width), Just(height), Just(cells), proptest::collection::vec(window, 1..4))
                }),
            has_previous: bool,
            out_bytes in prop_oneof![Just(20_000_usize), 200_usize..800],
        ) {
            let sensor = Sensor::new(width, height).unwrap();
            let mut memory = (Memory::new(sensor, has_previous), Memory::new(sensor, has_previous));
            let (mut encoder, mut decoder) = (memory.0.lent(), memory.1.lent());
            // What is enough for a few rows is enough for both windows.
            let has_previous = encoder.has_previous(sensor);
            let mut encoder = Dense::new(sensor, &mut encoder).unwrap();
            let mut decoder = Dense::with_previous(sensor, has_previous, &mut decoder).unwrap();
            encoder.restart();
            decoder.restart();
            for window in windows {
                there_and_back((&mut encoder, &mut decoder), &pixels(&window), cells, out_bytes);
            }
        }

        /// Any bytes are events, or an end; what is decoded stays on the sensor and in the window.
        #[test]
        fn any_bytes_decode_without_a_panic(
            bytes in any::<Vec<u8>>(), width in 1_u16..100, height in 1_u16..20,
            cells in 1_u32.., left in 0_u32..10_000, has_previous: bool,
        ) {
            let sensor = Sensor::new(width, height).unwrap();
            let mut memory = Memory::new(sensor, has_previous);
            let mut lent = memory.lent();
            let mut decoder = Dense::with_previous(sensor, has_previous, &mut lent).unwrap();
            decoder.restart();
            let mut reader = RangeDecoder::new(&bytes);
            let mut read = Listed::new(vec![], left);
            let times = Times::new(Fidelity::Lossless, None, cells);
            let coded = decoder.code(&mut reader, &mut read, times);
            prop_assert_eq!(coded.events, left - read.left);
            for ((x, y), events) in read.found {
                prop_assert!(x < width && y < height);
                prop_assert!(events.iter().all(|event| event.0 < cells));
                prop_assert!(events.windows(2).all(|two| two[0].0 <= two[1].0));
            }
        }
    }
}
