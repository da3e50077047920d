//! The fast event coder: Golomb-like codes whose orders adapt to what was coded before, for the fewest
//! instructions.
//!
//! A frame's pixels are coded in raster order; docs/wire-format.md has the codes. Each order follows a length that
//! the coder has at hand anyway: that of the last distance between events of the same two polarities, or of the
//! stretch of places over which the last 32 pixels lie. Both directions share this state. It starts anew with every
//! frame, so that each frame decodes by itself.

mod read;
pub(crate) mod walk;

use crate::coder::bits_msb_first::{BigWriter, CODE_BITS, Code};
use crate::pack::bits_lsb_first::Ended;
#[cfg(not(target_pointer_width = "64"))]
use crate::window::FIRST;
use crate::window::SEGMENT_PIXELS;
use event_types::Sensor;

/// Words of room without which no pixel, and no further event of a pixel, is begun: up to 48 bits of gap, 34 of the
/// first event, then twice 67 of a distance and what follows it, and 31 bits pending before that.
pub const ROOM_WORDS: usize = 9;

/// Number of pixels in a term, after which the order of the gaps is chosen again.
pub(crate) const TERM_PIXELS: u32 = 32;
/// Shift from the number of places that a term spans to 2^order of its gaps: an eighth of the mean gap.
pub(crate) const TERM_SHIFT: u32 = 8;
/// A term counts as spanning at most 2^6 expected gaps, twice what is expected of its 32 pixels.
const TERM_LIMIT_SHIFT: u32 = 6;

/// Two-bit code after a distance: the pixel ends. Another event of the same polarity has a code of one bit, 0.
pub(crate) const END: u32 = 0b10;
/// Two-bit code after a distance: another event follows, of the other polarity.
pub(crate) const FLIP: u32 = 0b11;

/// What both directions know of the events coded so far.
#[derive(Debug, Clone)]
pub struct Fast {
    cells: u32,
    cell_bits: u32,
    /// Places per row: the sensor's width in whole segments.
    row: u32,
    height: u32,
    width: u32,
    pub(crate) gaps: Gaps,
    pub(crate) orders: Orders,
    order_mask: u8,
}

/// State of the gaps between pixels.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Gaps {
    /// Place after the last pixel's.
    pub(crate) next: u32,
    /// Value of `next` when the term began.
    pub(crate) term_start: u32,
    /// Pixels left of the term.
    pub(crate) term_left: u32,
    /// Most places that a term is taken to span.
    pub(crate) term_max: u32,
    /// 2^order, above a bit for whether the pixel has a single event.
    pub(crate) base: u32,
    /// Bits of a gap with that bit, of the first event's cell and of its polarity, plus twice the leading zeros of
    /// the gap with that bit.
    pub(crate) bits: u32,
}

/// Orders of the distances, indexed by twice the polarity before plus the polarity after.
pub(crate) type Orders = [u8; 4];

/// Why bytes are not the events of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Malformed {
    /// The bytes end too early.
    Ended,
    /// A pixel lies beyond the sensor.
    Position,
    /// A time lies beyond the window.
    Time,
    /// The bytes have more events than the frame.
    Events,
}

impl From<Ended> for Malformed {
    fn from(_: Ended) -> Self {
        Self::Ended
    }
}

/// How much of a pixel has been written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Written {
    /// Number of its events written.
    pub events: u32,
    /// Whether these are all of its events.
    pub is_whole: bool,
}

/// Error: a pixel's events are not in order. Nothing of the pixel has been written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Unordered;

/// Returns floor(log2 x), and 0 for 0.
const fn log2(x: u32) -> u32 {
    (x | 1).leading_zeros() ^ 31
}

impl Gaps {
    const fn new(sensor: Sensor, window_events: u32, cell_bits: u32) -> Self {
        let events = if window_events == 0 { 1 } else { window_events };
        let gap = row(sensor) * sensor.height as u32 / events;
        let mut gaps = Self {
            next: 0,
            term_start: 0,
            term_left: TERM_PIXELS,
            term_max: (gap + 1) << TERM_LIMIT_SHIFT,
            base: 0,
            bits: 0,
        };
        gaps.set((gap + 1) * TERM_PIXELS, cell_bits);
        gaps
    }

    const fn set(&mut self, way: u32, cell_bits: u32) {
        let order = log2(way).saturating_sub(TERM_SHIFT);
        self.base = 2 << (order & 31);
        self.bits = 64 + cell_bits - 1 - order;
    }

    const fn order(&self) -> u32 {
        log2(self.base) - 1
    }

    /// Takes note that the pixel at `place` is complete.
    #[inline(always)]
    fn step(&mut self, place: u32, cell_bits: u32) {
        self.next = place + 1;
        self.term_left -= 1;
        if self.term_left == 0 {
            self.end_term(self.next, cell_bits);
        }
    }

    /// Ends a term; its last pixel was the one before `next`.
    #[inline(always)]
    pub(crate) fn end_term(&mut self, next: u32, cell_bits: u32) {
        let way = next - self.term_start;
        self.set(way.min(self.term_max), cell_bits);
        self.term_start = next;
        self.term_left = TERM_PIXELS;
    }

    /// Returns the longest gap that fits a code of 32 bits together with the first event and the polarity of a
    /// second one; 0 also if no gap does.
    #[cfg(not(target_pointer_width = "64"))]
    pub(crate) const fn gap_max(&self) -> u32 {
        // Fewest leading zeros that such a gap has.
        let zeros = self.bits.saturating_sub(30) >> 1;
        let raised = if zeros < u32::BITS { FIRST >> zeros } else { 0 };
        raised.saturating_sub(self.base / 2 + 1)
    }
}

const fn row(sensor: Sensor) -> u32 {
    (sensor.width as u32).next_multiple_of(SEGMENT_PIXELS as u32)
}

impl Fast {
    /// Starts a frame of a window of `window_events` events in `cells` cells.
    #[must_use]
    pub const fn new(sensor: Sensor, window_events: u32, cells: u32) -> Self {
        let cells = if cells == 0 { 1 } else { cells };
        let cell_bits = u32::BITS - (cells - 1).leading_zeros();
        // The order after a distance of half the window.
        let order = cell_bits.saturating_sub(2) as u8;
        // A distance of 2^32 - 1 has a code of order 0 only.
        let is_long = cell_bits == u32::BITS;
        Self {
            cells,
            cell_bits,
            row: row(sensor),
            height: sensor.height as u32,
            width: sensor.width as u32,
            gaps: Gaps::new(sensor, window_events, cell_bits),
            orders: if is_long { [0; 4] } else { [order; 4] },
            order_mask: if is_long { 0 } else { u8::MAX },
        }
    }

    /// Returns the number of places per row.
    #[cfg(not(target_pointer_width = "64"))]
    pub(crate) const fn row(&self) -> u32 {
        self.row
    }

    /// Returns the number of bits of a cell.
    #[cfg(not(target_pointer_width = "64"))]
    pub(crate) const fn cell_bits(&self) -> u32 {
        self.cell_bits
    }

    /// Sets the order that follows a distance; the code's number had `zeros` leading zeros.
    #[inline(always)]
    fn learn(&mut self, polarities: usize, zeros: u32) {
        // One less than the number of bits below the highest.
        let order = 30_u32.saturating_sub(zeros) as u8;
        self.orders[polarities % 4] = order & self.order_mask;
    }

    /// Writes a pixel's events, cells ascending, as long as there is room.
    ///
    /// `writer` has to have room for [`ROOM_WORDS`] words.
    ///
    /// # Errors
    /// [`Unordered`] if the cells do not ascend.
    #[inline(always)]
    pub fn write(
        &mut self,
        (x, y): (u16, u16),
        mut events: impl Iterator<Item = (u32, bool)>,
        writer: &mut BigWriter<'_>,
    ) -> Result<Written, Unordered> {
        let mut written = Written {
            events: 0,
            is_whole: true,
        };
        let Some((cell, on)) = events.next() else {
            return Ok(written);
        };
        let place = u32::from(y) * self.row + u32::from(x);
        let gap = place - self.gaps.next;
        let first = 2 * gap + self.gaps.base;
        written.events = 1;
        match events.next() {
            None => {
                let first = first + 1;
                let bits = self.gaps.bits - 2 * first.leading_zeros();
                put_first(
                    writer,
                    first,
                    (cell, self.cell_bits),
                    (u32::from(on), 1),
                    bits,
                );
            }
            Some((next, next_on)) => {
                let before = (writer.position(), self.orders);
                let bits = self.gaps.bits + 1 - 2 * first.leading_zeros();
                let signs = u32::from(on) << 1 | u32::from(next_on);
                put_first(writer, first, (cell, self.cell_bits), (signs, 2), bits);
                let further = Further {
                    cell,
                    next,
                    polarities: signs as usize,
                };
                match self.write_further(further, &mut events, writer) {
                    Ok(further) => {
                        written.events += further.events;
                        written.is_whole = further.is_whole;
                    }
                    Err(unordered) => {
                        writer.rewind(before.0);
                        self.orders = before.1;
                        return Err(unordered);
                    }
                }
            }
        }
        self.gaps.step(place, self.cell_bits);
        Ok(written)
    }

    #[inline(always)]
    fn write_further(
        &mut self,
        further: Further,
        events: &mut impl Iterator<Item = (u32, bool)>,
        writer: &mut BigWriter<'_>,
    ) -> Result<Written, Unordered> {
        let Further {
            mut cell,
            mut next,
            mut polarities,
        } = further;
        let mut events_written = 0;
        // Code that comes before the distance, and its number of bits.
        let mut prefix = (0, 0);
        loop {
            let distance = next.checked_sub(cell).ok_or(Unordered)?;
            let order = u32::from(self.orders[polarities % 4]);
            // Below 2^32: see `order_mask`.
            let raised = distance + (1 << (order & 31));
            let zeros = raised.leading_zeros();
            self.learn(polarities, zeros);
            let bits = 63 - order - 2 * zeros;
            events_written += 1;
            let has_room = writer.has_words(ROOM_WORDS);
            let after = events.next();
            let Some((after, on)) = after.filter(|_| has_room) else {
                put_distance(writer, prefix, (raised, bits), (END, 2));
                return Ok(Written {
                    events: events_written,
                    is_whole: after.is_none(),
                });
            };
            put_distance(writer, prefix, (raised, bits), (0, 0));
            (cell, next) = (next, after);
            polarities = (polarities << 1 | usize::from(on)) & 3;
            prefix = match polarities {
                0b00 | 0b11 => (0, 1),
                _ => (FLIP, 2),
            };
        }
    }
}

/// A pixel's second event, before it is written.
#[derive(Clone, Copy)]
struct Further {
    /// Cell of the first event.
    cell: u32,
    /// Cell of the second event.
    next: u32,
    /// Index into [`Orders`].
    polarities: usize,
}

/// Writes a pixel's place, its first event's cell and polarity, and the polarity of a second event if there is one:
/// `bits` bits in all. The place's own bits are what the other two leave.
#[inline(always)]
fn put_first(
    writer: &mut BigWriter<'_>,
    place: u32,
    (cell, cell_bits): (u32, u32),
    (signs, sign_bits): (u32, u32),
    bits: u32,
) {
    if bits <= CODE_BITS {
        let event = Code::from(cell) << sign_bits | Code::from(signs);
        let place = Code::from(place) << ((cell_bits + sign_bits) & (Code::BITS - 1));
        writer.put(place | event, bits);
    } else {
        let place_bits = bits - cell_bits - sign_bits;
        let parts = [(place, place_bits), (cell, cell_bits), (signs, sign_bits)];
        writer.aside(|writer| put_long(writer, parts));
    }
}

/// Writes a raised distance between the codes before and after it.
#[inline(always)]
fn put_distance(
    writer: &mut BigWriter<'_>,
    (prefix, prefix_bits): (u32, u32),
    (raised, bits): (u32, u32),
    (suffix, suffix_bits): (u32, u32),
) {
    let all = prefix_bits + bits + suffix_bits;
    if all <= CODE_BITS {
        let code = Code::from(prefix) << (bits & (Code::BITS - 1)) | Code::from(raised);
        writer.put(code << suffix_bits | Code::from(suffix), all);
    } else {
        let parts = [(prefix, prefix_bits), (raised, bits), (suffix, suffix_bits)];
        writer.aside(|writer| put_long(writer, parts));
    }
}

/// Writes codes of 0 to 64 bits each, whose bits above the lowest 32 are zeros.
#[cold]
#[inline(never)]
fn put_long(writer: &mut BigWriter<'_>, parts: [(u32, u32); 3]) {
    for (code, bits) in parts {
        if bits > 32 {
            writer.put(0, bits - 32);
        }
        if bits > 0 {
            writer.put(Code::from(code), bits.min(32));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coder::bits_msb_first::BigReader;
    use proptest::prelude::*;
    use std::collections::BTreeMap;
    use std::vec;
    use std::vec::Vec;

    type Pixels = BTreeMap<(u16, u16), Vec<(u32, bool)>>;

    /// Writes pixels into frames of `out_bytes` bytes and reads them back.
    fn there_and_back(sensor: Sensor, cells: u32, pixels: &Pixels, out_bytes: usize) {
        let events = pixels.values().map(|events| events.len() as u32).sum();
        let mut left: Vec<_> = pixels
            .iter()
            .map(|(at, events)| (*at, &events[..]))
            .collect();
        let mut read = Pixels::new();
        while !left.is_empty() {
            let mut out = vec![0; out_bytes];
            let mut writer = BigWriter::new(&mut out);
            let mut coder = Fast::new(sensor, events, cells);
            let (mut done, mut written) = (0, 0);
            for ((y, x), events) in &mut left {
                if !writer.has_words(ROOM_WORDS) {
                    break;
                }
                let at = (*x, *y);
                let count = coder.write(at, events.iter().copied(), &mut writer);
                let Written {
                    events: count,
                    is_whole,
                } = count.unwrap();
                assert_eq!(is_whole, count as usize == events.len());
                written += count;
                *events = &events[count as usize..];
                if !events.is_empty() {
                    break;
                }
                done += 1;
            }
            assert!(written > 0);
            let bytes = writer.finish();
            let mut reader = BigReader::new(&out[..bytes]);
            let coder = Fast::new(sensor, events, cells);
            let mut each = |(x, y), cell, on| read.entry((y, x)).or_default().push((cell, on));
            coder.read(written, &mut reader, &mut each).unwrap();
            assert!(reader.is_spent());
            left.drain(..done);
        }
        assert_eq!(&read, pixels);
    }

    fn pixels(width: u16, height: u16, cells: u32) -> impl Strategy<Value = Pixels> {
        let event = (prop_oneof![0..cells, 0..cells.min(9)], any::<bool>());
        let few = proptest::collection::vec(event.clone(), 1..3);
        let several = proptest::collection::vec(event, 1..40);
        let pixel = prop_oneof![3 => few, 1 => several].prop_map(|mut events| {
            events.sort_by_key(|(cell, _)| *cell);
            events
        });
        proptest::collection::btree_map((0..height, 0..width), pixel, 0..150)
    }

    proptest! {
        #[test]
        fn windows_come_back(
            (width, height, cells, pixels) in (
                1_u16..200, 1_u16..60, prop_oneof![1_u32..70, 1_u32..]
            ).prop_flat_map(|(width, height, cells)| {
                (Just(width), Just(height), Just(cells), pixels(width, height, cells))
            }),
            out_bytes in prop_oneof![Just(20_000_usize), 60_usize..300],
        ) {
            there_and_back(Sensor::new(width, height).unwrap(), cells, &pixels, out_bytes);
        }

        #[test]
        fn any_bytes_are_events_or_an_error(
            bytes in any::<Vec<u8>>(), width in 1_u16..100, height in 1_u16..20,
            cells in 1_u32.., window_events in 0_u32..10_000, events in 0_u32..10_000,
        ) {
            let sensor = Sensor::new(width, height).unwrap();
            let mut count = 0;
            let read = Fast::new(sensor, window_events, cells).read(
                events,
                &mut BigReader::new(&bytes),
                |(x, y), cell, _| {
                    assert!(x < width && y < height && cell < cells);
                    count += 1;
                },
            );
            prop_assert!(count <= events && (read.is_err() || count == events));
        }
    }
}
