//! The dense event coder: contexts that adapt to pixels already coded, for the fewest bits.
//!
//! A frame's pixels are coded in raster order. Each of the following is coded with probabilities learned in its
//! context ([`super::range`]):
//!
//! * which rows, segments of 32 columns and pixels have events: by the pixels around, including those of the window
//!   before; columns without neighbours are coded in runs (`neighbourhood`);
//! * the polarity of a pixel's first event, and the times and further polarities of its events (`times`).
//!
//! The same function encodes and decodes. Time per event is bounded; all memory is lent.

#[cfg(eecvs_dsp)]
pub(crate) mod armv7em;
pub mod model;
mod neighbourhood;
pub(crate) mod times;

use super::content::Content;
use super::range::Binary;
use super::times::Times;
#[cfg(eecvs_dsp)]
use crate::coder::dense::armv7em::state::Walk;
use crate::coder::dense::model::Model;
use crate::coder::dense::neighbourhood::Around;
pub(crate) use crate::coder::dense::times::EVENT_BYTES_MAX;
use crate::coder::dense::times::{Clock, CodedPixel, Following, LearnedTimes, Neighbour};
#[cfg(eecvs_dsp)]
use core::cell::Cell;
use event_types::Sensor;

/// Returns how many rows of bits are kept. If the window before is kept, all of them; else the current row, the two
/// above it, and a fourth, which makes a row's index cheap to compute.
pub(super) const fn rows(sensor: Sensor, has_previous: bool) -> usize {
    let height = sensor.height as usize;
    if has_previous || height < RING_ROWS {
        height
    } else {
        RING_ROWS
    }
}

const RING_ROWS: usize = 4;

/// Returns the index of row `y` among the rows kept.
#[inline(always)]
pub(super) const fn row_of(y: usize, has_previous: bool) -> usize {
    if has_previous { y } else { y % RING_ROWS }
}

/// Memory lent to a [`Dense`] coder.
#[derive(Debug)]
pub struct DenseMemory<'b> {
    /// What is learned, of the same size for every sensor.
    pub model: &'b mut Model,
    /// At least [`words`] words.
    pub words: &'b mut [u32],
}

impl DenseMemory<'_> {
    /// Returns whether the memory is large enough for a sensor.
    #[must_use]
    pub const fn serves(&self, sensor: Sensor) -> bool {
        self.words.len() >= words(sensor, false)
    }

    /// Returns whether it is also large enough to keep the window before.
    #[must_use]
    pub const fn has_previous(&self, sensor: Sensor) -> bool {
        self.words.len() >= words(sensor, true)
    }
}

/// Returns how many words the coder needs for a sensor.
///
/// Without the window before these are far fewer, but sparse scenes then cost more bits.
#[must_use]
pub const fn words(sensor: Sensor, has_previous: bool) -> usize {
    let stride = sensor.width.div_ceil(32) as usize;
    let rows = rows(sensor, has_previous);
    2 * stride * rows + 2 * stride + 2 * sensor.width as usize
}

/// How much of a frame was coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CodedEvents {
    /// Number of events.
    pub events: u32,
    /// Number of pixels with events.
    pub pixels: u32,
    /// The encoder learned from more than a decoder will read, so the next frame has to be a key frame.
    pub overran: bool,
}

/// The coder's state, which is kept from frame to frame until [`Self::restart`].
#[derive(Debug)]
pub struct Dense<'b> {
    model: &'b mut Model,
    /// Which pixels have events, a bit each: up to the current pixel those of this window, after it those of the
    /// window before.
    occupied: &'b mut [u32],
    /// The polarity of each pixel's last event, of the same windows.
    last_on: &'b mut [u32],
    /// The polarity of each pixel's first event, in this row and the one above.
    first_on: &'b mut [u32],
    /// For each column the latest pixel with events: the handle of its events, and the last of them.
    lists: &'b mut [u32],
    lasts: &'b mut [u32],
    sensor: Sensor,
    stride: usize,
    has_previous: bool,
}

impl<'b> Dense<'b> {
    /// Returns the coder in a memory that was last used for the same sensor, or `None` if the memory is too small.
    ///
    /// If the memory's content is unknown, call [`Self::restart`] first.
    #[must_use]
    pub fn new(sensor: Sensor, memory: &'b mut DenseMemory<'_>) -> Option<Self> {
        let has_previous = memory.has_previous(sensor);
        Self::with_previous(sensor, has_previous, memory)
    }

    /// As [`Self::new`], for a decoder: `has_previous`, from the frame's header, says whether the encoder kept the
    /// window before.
    #[must_use]
    pub fn with_previous(
        sensor: Sensor,
        has_previous: bool,
        memory: &'b mut DenseMemory<'_>,
    ) -> Option<Self> {
        let DenseMemory { model, words } = memory;
        let stride = usize::from(sensor.width.div_ceil(32));
        let rows = rows(sensor, has_previous);
        let (occupied, rest) = words.split_at_mut_checked(stride * rows)?;
        let (last_on, rest) = rest.split_at_mut_checked(stride * rows)?;
        let (first_on, rest) = rest.split_at_mut_checked(2 * stride)?;
        let (lists, rest) = rest.split_at_mut_checked(usize::from(sensor.width))?;
        let (lasts, _) = rest.split_at_mut_checked(usize::from(sensor.width))?;
        Some(Self {
            model,
            occupied,
            last_on,
            first_on,
            lists,
            lasts,
            sensor,
            stride,
            has_previous,
        })
    }

    /// Forgets everything learned, so that the next frame decodes by itself.
    pub fn restart(&mut self) {
        self.model.restart();
        self.occupied.fill(0);
        self.last_on.fill(0);
    }

    /// Codes a frame with times in the form `times`, until its content ends or the coder is full.
    pub fn code<C: Binary, T: Content>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        times: Times,
    ) -> CodedEvents {
        let clock = Clock::new(times.count(), times.fine_bits());
        self.code_with(coder, content, clock)
    }

    /// As [`Self::code`], where `step` codes what follows a pixel's place and first polarity.
    #[inline(always)]
    pub(super) fn code_with<C: Binary, T: Content, S: Step<T>>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        #[cfg_attr(not(eecvs_dsp), allow(unused_mut))] mut step: S,
    ) -> CodedEvents {
        let mut frame = Frame {
            #[cfg(eecvs_dsp)]
            walk: step
                .clock()
                .filter(|clock| armv7em::serves(clock))
                .map(|clock| Walk::new(clock)),
            step,
            coded: CodedEvents {
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
            #[cfg(not(eecvs_dsp))]
            let begun = None;
            #[cfg(eecvs_dsp)]
            let mut begun = None;
            #[cfg(eecvs_dsp)]
            if frame.walk.is_some()
                && let Some(walked) = self.walk_rows(
                    (&mut *coder, &mut *content),
                    (y, above_is_active),
                    &mut frame,
                )
            {
                (y, above_is_active) = (walked.y, walked.above_is_active);
                if y >= height {
                    break;
                }
                begun = walked.begun;
            }
            let row = self.row(y);
            let was_active = self.has_previous
                && words_at(self.occupied, row, self.stride)
                    .iter()
                    .any(|word| *word != 0);
            let context = usize::from(above_is_active) + 2 * usize::from(was_active);
            let flag = &mut self.model.rows[context];
            let is_active = begun.is_some() || coder.bit(flag, content.has_row(y as u16));
            above_is_active = is_active;
            if is_active {
                if !self.code_row(coder, content, y, begun, &mut frame) {
                    y += 1;
                    break;
                }
            } else if was_active || !self.has_previous {
                words_at(self.occupied, row, self.stride).fill(0);
            }
            y += 1;
        }
        // Rows below have no events in this frame.
        if self.has_previous {
            words_at(self.occupied, y * self.stride, usize::MAX).fill(0);
        }
        frame.coded
    }

    #[inline(always)]
    fn row(&self, y: usize) -> usize {
        row_of(y, self.has_previous) * self.stride
    }

    /// Codes a row. Returns whether more may follow.
    #[inline(always)]
    fn code_row<C: Binary, T: Content, S: Step<T>>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        y: usize,
        row_begun: Option<Begun>,
        frame: &mut Frame<S>,
    ) -> bool {
        let stride = self.stride;
        let row = self.row(y);
        let rows = self.rows_around(y);
        let mut following = self.model.times.following(y);
        let mut segment = 0;
        let mut goes_on = true;
        let mut begun = None;
        if let Some(Begun {
            segment: at,
            column,
            made,
            goes_on: is_more,
            following: follows,
        }) = row_begun
        {
            (segment, goes_on, following) = (at, is_more, follows);
            if goes_on {
                begun = column.map(|column| (column, made));
            } else {
                set(self.occupied, row + segment, made.occupied);
                set(self.last_on, row + segment, made.last_on);
                set(self.first_on, rows.first_here + segment, made.first_on);
                segment += 1;
            }
        }
        let mut around = self.around(&rows, row, segment);
        while goes_on && segment < stride {
            let is_begun = begun.is_some();
            let (from, mut made) = begun.take().unwrap_or_default();
            if is_begun || {
                let flag = &mut self.model.segments[around.segment_context()];
                coder.bit(flag, content.has_segment(segment as u16, y as u16))
            } {
                let (place, made) = ((segment, y, following), (from, &mut made));
                goes_on = self.code_segment(coder, content, place, &around, made, frame);
            }
            set(self.occupied, row + segment, made.occupied);
            set(self.last_on, row + segment, made.last_on);
            set(self.first_on, rows.first_here + segment, made.first_on);
            segment += 1;
            if !goes_on || content.is_over() {
                goes_on = false;
                break;
            }
            let east = self.east(&rows, segment, true);
            around.go_on((made.occupied, made.first_on), &east);
        }
        words_at(self.occupied, row + segment, stride - segment).fill(0);
        goes_on
    }

    /// Gathers the surroundings of a segment; the segments before it have been coded.
    #[cfg_attr(eecvs_dsp, cold)]
    #[cfg_attr(not(eecvs_dsp), inline(always))]
    fn around(&self, rows: &Rows, row: usize, segment: usize) -> Around {
        let word = |words: &[u32], at: usize| words.get(at).copied().unwrap_or(0);
        let mut around = Around::default();
        around.go_on((0, 0), &self.east(rows, 0, false));
        around.go_on((0, 0), &self.east(rows, 0, true));
        for before in 0..segment {
            let made = word(self.occupied, row + before);
            let made_on = word(self.first_on, rows.first_here + before);
            around.go_on((made, made_on), &self.east(rows, before + 1, true));
        }
        around
    }

    /// Codes an encoder's rows by the walk of [`armv7em`], as far as it goes.
    #[cfg(eecvs_dsp)]
    #[inline(never)]
    fn walk_rows<C: Binary, T: Content, S: Step<T>>(
        &mut self,
        (coder, content): (&mut C, &mut T),
        (y, above_is_active): (usize, bool),
        frame: &mut Frame<S>,
    ) -> Option<armv7em::Walked> {
        let words = armv7em::Words {
            occupied: Cell::from_mut(&mut *self.occupied).as_slice_of_cells(),
            last_on: Cell::from_mut(&mut *self.last_on).as_slice_of_cells(),
            first_on: Cell::from_mut(&mut *self.first_on).as_slice_of_cells(),
        };
        let Frame { step, walk, coded } = frame;
        let walked = content.with_parts(armv7em::RowsWalk {
            walk: walk.as_mut()?,
            coder: coder.parts()?,
            model: &mut *self.model,
            clock: step.clock()?,
            lists: &mut *self.lists,
            lasts: &mut *self.lasts,
            words,
            sensor: self.sensor,
            y,
            above_is_active,
            has_previous: self.has_previous,
        })?;
        coded.pixels += walked.pixels;
        coded.events += walked.events;
        Some(walked)
    }

    /// Returns where this row and the rows around it begin.
    #[inline(always)]
    fn rows_around(&self, y: usize) -> Rows {
        let first_here = (y % 2) * self.stride;
        let above = |rows: usize| {
            if y >= rows {
                self.row(y - rows)
            } else {
                NO_ROW
            }
        };
        let (here, south) = match self.has_previous {
            true if y + 1 < usize::from(self.sensor.height) => (self.row(y), self.row(y + 1)),
            true => (self.row(y), NO_ROW),
            false => (NO_ROW, NO_ROW),
        };
        Rows {
            here,
            south,
            north: above(1),
            far_north: above(2),
            first_here,
            first_north: self.stride - first_here,
        }
    }

    /// Returns the words that come into view on moving to `segment`, or with `is_next` false to the one west of it.
    #[inline(always)]
    fn east(&self, rows: &Rows, segment: usize, is_next: bool) -> Around {
        let word = |words: &[u32], at: usize| words.get(at).copied().unwrap_or(0);
        // The segment to the east; words beyond the row are 0.
        let east = segment + usize::from(is_next);
        let far = |words: &[u32], row: usize| {
            let word = if east < self.stride {
                word(words, row.wrapping_add(east))
            } else {
                0
            };
            [0, 0, word]
        };
        let mut around = Around {
            north: far(self.occupied, rows.north),
            north_on: far(self.first_on, rows.first_north),
            far_north: word(self.occupied, rows.far_north.wrapping_add(segment)),
            ..Around::default()
        };
        if self.has_previous {
            around.old = [0, far(self.occupied, rows.here)[2]];
            around.south = far(self.occupied, rows.south);
            around.old_on = word(self.last_on, rows.here.wrapping_add(segment));
        }
        around
    }

    /// Codes a segment. Returns whether more may follow.
    #[inline(always)]
    fn code_segment<C: Binary, T: Content, S: Step<T>>(
        &mut self,
        coder: &mut C,
        content: &mut T,
        (segment, y, following): (usize, usize, Following),
        around: &Around,
        (from, made): (u32, &mut Made),
        frame: &mut Frame<S>,
    ) -> bool {
        let seen = around.columns(self.has_previous);
        let columns = (usize::from(self.sensor.width) - 32 * segment).min(32) as u32;
        let told = content.columns();
        let mut i = from;
        while i < columns {
            // A segment that is coded has events: if none came before its last run or column, they are there and no
            // flag is coded.
            let quiet = seen.quiet(made.occupied, i, columns);
            if quiet > 0 {
                let run = told >> i & low_mask(quiet);
                let is_sure = made.occupied == 0 && i + quiet == columns;
                let flag = &mut self.model.runs[seen.run_context(quiet)];
                if !is_sure && !coder.bit(flag, run != 0) {
                    i += quiet;
                    continue;
                }
                i += coder.one_of(run.trailing_zeros(), quiet);
            } else {
                let is_sure = made.occupied == 0 && i + 1 == columns;
                let flag = &mut self.model.pixels[seen.pixel_context(made.occupied, i)];
                if !is_sure && !coder.bit(flag, told >> i & 1 == 1) {
                    i += 1;
                    continue;
                }
            }
            let x = 32 * segment + i as usize;
            let list = content.enter((x as u16, y as u16));
            if !coder.has_room(EVENT_BYTES_MAX) {
                frame.coded.overran = true;
                return false;
            }
            let context = seen.polarity_context(made.occupied, made.first_on, i);
            let first_on = coder.bit(&mut self.model.polarities[context], content.peek().1);
            let west = seen
                .has_west(made.occupied, i)
                .then(|| self.latest(x.wrapping_sub(1)));
            let north = seen.has_north(i).then(|| self.latest(x));
            let neighbours = (
                west.unwrap_or(Neighbour::NONE),
                north.unwrap_or(Neighbour::NONE),
            );
            let times = &mut self.model.times;
            let pixel = frame
                .step
                .pixel(times, coder, content, first_on, (neighbours, following));
            frame.coded.pixels += 1;
            frame.coded.events += pixel.events;
            set(self.lists, x, list);
            set(self.lasts, x, pixel.last);
            made.occupied |= 1 << i;
            made.first_on |= u32::from(first_on) << i;
            made.last_on |= (pixel.last & 1) << i;
            if !pixel.goes_on {
                return false;
            }
            i += 1;
        }
        true
    }

    /// Returns the latest pixel with events of a column.
    #[inline(always)]
    fn latest(&self, x: usize) -> Neighbour {
        match (self.lists.get(x), self.lasts.get(x)) {
            (Some(list), Some(last)) => Neighbour {
                list: *list,
                last: *last,
            },
            _ => Neighbour::NONE,
        }
    }
}

const fn low_mask(bits: u32) -> u32 {
    if bits < 32 { (1 << bits) - 1 } else { u32::MAX }
}

#[inline(always)]
fn set(words: &mut [u32], at: usize, word: u32) {
    if let Some(place) = words.get_mut(at) {
        *place = word;
    }
}

/// Returns up to `count` words from `at` on.
#[inline(always)]
fn words_at(words: &mut [u32], at: usize, count: usize) -> &mut [u32] {
    let rest = words.get_mut(at..).unwrap_or_default();
    let count = rest.len().min(count);
    rest.get_mut(..count).unwrap_or_default()
}

/// Where rows begin in their words; [`NO_ROW`] for rows that do not exist.
struct Rows {
    here: usize,
    south: usize,
    north: usize,
    far_north: usize,
    first_here: usize,
    first_north: usize,
}

/// Beyond all words, also after a segment's number is added.
const NO_ROW: usize = usize::MAX / 2;

/// How far an assembly walk has coded a row that it leaves to the portable loop.
#[cfg_attr(not(eecvs_dsp), allow(dead_code))]
pub(super) struct Begun {
    /// The first segment that was not coded as a whole.
    pub(super) segment: usize,
    /// The first column of that segment that was not visited; `None` if the segment's flag was not coded.
    pub(super) column: Option<u32>,
    /// What was coded of that segment.
    pub(super) made: Made,
    /// Whether there is more to code; if not, the window's last event was coded or the output is full.
    pub(super) goes_on: bool,
    /// How the row uses its neighbours' times, as decided at its start.
    pub(super) following: Following,
}

/// Bits of the pixels coded in a segment.
#[derive(Debug, Default)]
pub(super) struct Made {
    pub(super) occupied: u32,
    pub(super) first_on: u32,
    pub(super) last_on: u32,
}

/// State kept from pixel to pixel of a frame.
struct Frame<S> {
    step: S,
    coded: CodedEvents,
    #[cfg(eecvs_dsp)]
    walk: Option<Walk>,
}

/// Codes what follows a pixel's place and the polarity of its first event.
pub(super) trait Step<T> {
    /// Codes a pixel; `around` has what is known of its neighbours to the west and north, and how the row uses
    /// their times.
    fn pixel<C: Binary>(
        &mut self,
        times: &mut LearnedTimes,
        coder: &mut C,
        content: &mut T,
        on: bool,
        around: ((Neighbour, Neighbour), Following),
    ) -> CodedPixel;

    /// Returns the clock if this step codes events and nothing else: an encoder's assembly walk may then replace
    /// it.
    #[cfg(eecvs_dsp)]
    fn clock(&mut self) -> Option<&mut Clock> {
        None
    }
}

/// Codes the pixel's events.
impl<T: Content> Step<T> for Clock {
    #[inline(always)]
    fn pixel<C: Binary>(
        &mut self,
        times: &mut LearnedTimes,
        coder: &mut C,
        content: &mut T,
        on: bool,
        around: ((Neighbour, Neighbour), Following),
    ) -> CodedPixel {
        Self::pixel(self, times, coder, content, on, around)
    }

    #[cfg(eecvs_dsp)]
    fn clock(&mut self) -> Option<&mut Clock> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::super::cells::Fidelity;
    use super::super::content::{END, Node};
    use super::super::range::{RangeDecoder, RangeEncoder};
    use super::*;
    use proptest::prelude::*;
    use std::boxed::Box;
    use std::collections::BTreeMap;
    use std::vec;
    use std::vec::Vec;

    type Pixel = ((u16, u16), Vec<(u32, bool)>);

    /// Returns pixels in raster order, with their events in order of time.
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

    /// Content of a frame for either direction, as one list of events.
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
            self.pixels
                .get(self.at.0)
                .is_some_and(|pixel| pixel.0.1 == y)
        }
        fn has_segment(&mut self, segment: u16, y: u16) -> bool {
            self.place = (segment, y);
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

    struct Memory(Box<Model>, Vec<u32>);

    impl Memory {
        fn new(sensor: Sensor, has_previous: bool) -> Self {
            let words = words(sensor, has_previous);
            Self(Box::new(Model::UNSET), vec![7; words])
        }
        fn lent(&mut self) -> DenseMemory<'_> {
            DenseMemory {
                model: &mut self.0,
                words: &mut self.1,
            }
        }
    }

    /// Encodes a window into as many frames as needed and decodes them; returns the frames' sizes in bytes.
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
            // For a sensor of a few rows the smaller memory is large enough for both windows.
            let has_previous = encoder.has_previous(sensor);
            let mut encoder = Dense::new(sensor, &mut encoder).unwrap();
            let mut decoder = Dense::with_previous(sensor, has_previous, &mut decoder).unwrap();
            encoder.restart();
            decoder.restart();
            for window in windows {
                there_and_back((&mut encoder, &mut decoder), &pixels(&window), cells, out_bytes);
            }
        }

        /// Any bytes decode to events or an end; decoded events lie on the sensor and in the window.
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
