//! Times, numbers and polarities of the events, pixel after pixel in raster order.
//!
//! A window of 2^B time units is divided by a tree of up to six levels into slots, and of those that have events each
//! by a second tree of up to six levels, if the shape has one. Nodes below an occupied one are coded, by what is
//! occupied at the same place in the trees of the neighbours, and by how long the pixel has been silent. In a leaf
//! follow the number of its events, the low bits of their times, and after each time the polarity.

mod beside;
pub(super) mod mixed;
pub(super) mod single;

use event_types::Sensor;
use zerocopy::FromZeros;

use self::beside::Beside;
use super::counter::{Counter, code_value};
use super::places::MixedSizes;
use super::pyramid::{Columns, Level, halved};
use super::range::BitCoder;
use super::{Shape, TreeEvent};
use crate::coder::scan::{FINE_BITS, Scans};

/// Number of counters that [`single`] has, and [`mixed`] besides its mixers.
pub(super) const COUNTERS_SINGLE: usize = single::COUNTERS;
/// Number of mixers that [`mixed`] has.
pub(super) const MIXERS: usize = 3;
/// Slots of a window that [`mixed`] counts.
pub(super) const HISTOGRAM: usize = mixed::HISTOGRAM;

/// Number of each that [`mixed`] needs.
pub(super) const fn mixed_sizes(is_full: bool) -> MixedSizes {
    let mixers = mixed::sizes(is_full);
    let mut sizes = MixedSizes::of(&mixers);
    sizes.counters += Low::COUNTERS;
    sizes
}

/// Columns of a row of pixels: two to the west of the sensor, and one to the east.
pub(super) const fn row_pixels(sensor: Sensor) -> usize {
    sensor.width as usize + 3
}

/// Number of areas of `side` x `side` pixels.
pub(super) const fn area_count(sensor: Sensor, side: u16) -> usize {
    sensor.width.div_ceil(side) as usize * sensor.height.div_ceil(side) as usize
}

/// Which nodes of a tree of up to six levels are occupied.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, FromZeros)]
pub struct Nodes {
    /// Node i of level l is bit 2^l + i; the root is level 0.
    inner: u64,
    leaves: u64,
}

impl Nodes {
    const NONE: Self = Self {
        inner: 0,
        leaves: 0,
    };

    /// Returns a tree of `levels` with these leaves.
    #[inline(always)]
    const fn of(leaves: u64, levels: u32) -> Self {
        let mut inner = 0;
        let mut level = leaves;
        let mut l = levels;
        while l > 0 {
            l -= 1;
            level = halved(level | level >> 1);
            inner |= level << (1_u32 << l);
        }
        Self { inner, leaves }
    }

    #[inline(always)]
    fn add(&mut self, other: Self) {
        self.inner |= other.inner;
        self.leaves |= other.leaves;
    }

    #[inline(always)]
    const fn and(self, other: Self) -> Self {
        Self {
            inner: self.inner & other.inner,
            leaves: self.leaves & other.leaves,
        }
    }
}

/// What is kept of a pixel for its neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, FromZeros)]
pub struct Pixel {
    /// Inner nodes of its first tree.
    inner: u64,
    /// Leaves of it with ON, with OFF events.
    on: u64,
    off: u64,
    /// Number of its first second tree in the row.
    seconds: u32,
    /// Polarity of its last event: 2 ON, 0 OFF; 1 without events.
    last: u32,
}

impl Pixel {
    /// No events; for memory whose content does not count.
    pub const NONE: Self = Self {
        inner: 0,
        on: 0,
        off: 0,
        seconds: 0,
        last: 1,
    };

    #[inline(always)]
    const fn leaves(&self) -> u64 {
        self.on | self.off
    }

    #[inline(always)]
    const fn nodes(&self) -> Nodes {
        Nodes {
            inner: self.inner,
            leaves: self.leaves(),
        }
    }

    /// Returns the number in the row of the second tree below a leaf that is occupied, of which `leaf` is the bit.
    #[inline(always)]
    const fn second(&self, leaf: u64) -> usize {
        (self.seconds + (self.leaves() & (leaf - 1)).count_ones()) as usize
    }
}

/// What `mixed` keeps beside a tree: nodes with ON and with OFF events, and times.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, FromZeros)]
pub struct Marks {
    on: Nodes,
    off: Nodes,
    /// Times of the first and the last event from the window's start.
    first: u32,
    last: u32,
}

/// Empties the pixels of a row that have events in the window.
#[inline(always)]
fn empty<T: Copy>(level: &Level, now: &[u8], y: u32, pixels: &mut [T], none: T) {
    if y >= level.height {
        return;
    }
    for x in Columns::of(level, now, y) {
        if let Some(pixel) = pixels.get_mut(x as usize + 2) {
            *pixel = none;
        }
    }
}

/// The lowest `count` bits, up to 64.
#[inline(always)]
const fn lowest(count: u32) -> u64 {
    if count >= 64 {
        u64::MAX
    } else {
        (1 << count) - 1
    }
}

/// The lowest `count` bits, up to 31.
#[inline(always)]
const fn low_mask(count: u32) -> u32 {
    (1 << (count & 31)) - 1
}

/// Leaves of the events of one pixel at the start of `events`, in a tree of `levels` whose leaves have `leaf_bits`.
#[inline(always)]
fn leaves_within(events: &[TreeEvent], place: u32, leaf_bits: u32, levels: u32) -> u64 {
    let of_pixel = events.iter().take_while(|event| event.place() == place);
    let mask = low_mask(levels);
    of_pixel.fold(0, |leaves, event| {
        leaves | 1 << (event.time >> leaf_bits & mask & 63)
    })
}

/// Low bits of the times in a leaf.
#[derive(Debug)]
struct Low<'m> {
    /// Upper two bits of the first event's, if there are two events, or more.
    first: [&'m mut [Counter; 4]; 2],
    /// Class of the distance to the event before: 0, or one more than the logarithm.
    distance: [&'m mut [Counter; 32]; 2],
    beside: Beside<'m>,
}

impl<'m> Low<'m> {
    const COUNTERS: usize = 2 * (4 + 32) + Beside::COUNTERS;

    fn new(counters: &mut &'m mut [Counter]) -> Option<Self> {
        fn two<'m, const N: usize>(
            counters: &mut &'m mut [Counter],
        ) -> Option<[&'m mut [Counter; N]; 2]> {
            Some([
                counters.split_off_mut(..N)?.as_mut_array()?,
                counters.split_off_mut(..N)?.as_mut_array()?,
            ])
        }
        Some(Self {
            first: two(counters)?,
            distance: two(counters)?,
            beside: Beside::new(counters)?,
        })
    }

    fn restart(&mut self) {
        for counters in &mut self.first {
            counters.fill(Counter::EVEN);
        }
        for counters in &mut self.distance {
            counters.fill(Counter::EVEN);
        }
        self.beside.restart();
    }

    /// Codes the time of event number `k` of `count` of a pixel in a leaf that begins at `base` and has `shift` bits;
    /// `before` is the time of the event before it. Both are from the leaf's start.
    #[inline(always)]
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (k, count): (u32, u32),
        (scans, place): (Option<&Scans>, u32),
        (base, shift): (u32, u32),
        time: u32,
        before: u32,
    ) -> u32 {
        let Some(scans) = scans else {
            return self.steps(coder, (k, count), shift, time, before);
        };
        let upper = (time >> FINE_BITS, before >> FINE_BITS);
        let shift = shift.saturating_sub(FINE_BITS);
        let scan = self.steps(coder, (k, count), shift, upper.0, upper.1);
        let at = (place as u16, (place >> 16) as u16);
        let fraction = scans.fraction(at, (base >> FINE_BITS) + scan);
        let fine = time & low_mask(FINE_BITS);
        scan << FINE_BITS | self.beside.code(coder, fraction, fine)
    }

    /// As [`Self::code`], without scans.
    #[inline(always)]
    fn steps<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (k, count): (u32, u32),
        shift: u32,
        time: u32,
        before: u32,
    ) -> u32 {
        if count == 1 {
            return coder.raw(time, shift);
        }
        if shift == 0 {
            return 0;
        }
        let set = usize::from(count > 2);
        if k == 0 {
            let low = shift.saturating_sub(2);
            let top = code_value(coder, self.first[set], shift - low, time >> low);
            return top << low | coder.raw(time & low_mask(low), low);
        }
        let distance = time.wrapping_sub(before);
        let class = 32 - distance.leading_zeros();
        let class = code_value(coder, self.distance[set], 5, class);
        let distance = match class.checked_sub(1) {
            None => 0,
            Some(low) => 1 << low | coder.raw(distance & low_mask(low), low),
        };
        before.wrapping_add(distance) & low_mask(shift)
    }
}

/// What the events of a window have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    pub(super) shape: Shape,
    /// Low bits of the window's start: in time units, or where these are scans in microseconds.
    start: u32,
    /// Units of a time for each microsecond, in 2^-16, if times are scans.
    per_us_q16: u64,
}

impl Clock {
    /// Most time units that matter.
    const FAR: u64 = 1 << 30;

    pub(super) fn new(shape: Shape, start: u32) -> Self {
        let per_us_q16 = shape.scans.map_or(0, |scans| {
            (1 << (32 + FINE_BITS)) / scans.readout().period()
        });
        Self {
            shape,
            start,
            per_us_q16,
        }
    }

    /// Returns a time of the window on the clock on which windows follow each other.
    #[inline(always)]
    pub(super) const fn at(&self, time: u32) -> u32 {
        let since = match self.shape.scans {
            None => time,
            Some(scans) => scans.line0_us(time >> FINE_BITS),
        };
        self.start.wrapping_add(since)
    }

    /// Returns how many time units an interval of that clock has.
    #[inline(always)]
    pub(super) const fn units(&self, interval: u32) -> u32 {
        if self.per_us_q16 == 0 {
            return interval;
        }
        let units = (interval as u64 * self.per_us_q16) >> 16;
        if units < Self::FAR {
            units as u32
        } else {
            Self::FAR as u32
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inner_nodes_are_above_their_leaves() {
        assert_eq!(Nodes::of(0, 6), Nodes::NONE);
        assert_eq!(Nodes::of(1, 0).inner, 0);
        // Leaf 5 of 8: nodes 2 of 4, 1 of 2, 0 of 1.
        assert_eq!(Nodes::of(1 << 5, 3).inner, 1 << 6 | 1 << 3 | 1 << 1);
        assert_eq!(Nodes::of(u64::MAX, 6).inner, u64::MAX - 1);
    }
}
