//! The fast event coder: Golomb-like codes whose parameters follow what went by, for the fewest
//! instructions.
//!
//! A frame's pixels go by in raster order; docs/wire-format.md has the codes. One adaptation serves
//! both directions, and it starts anew with every frame, so that each decodes by itself.

use crate::bits::{BitReader, BitWriter, Ended};
use crate::event::Sensor;

/// Bits that an event takes at the most: what became of the pixel's event before (2), and the longest
/// distance (3 and a code of 63 bits).
const EVENT_WORDS: usize = 3;
/// Words that a pixel's first event takes at the most: two gaps of up to 47 bits, a polarity, a time
/// of 32; with an end, and what was there before.
const FIRST_WORDS: usize = 6;
/// Words of room without which no pixel is begun, and no further event of it.
pub const ROOM_WORDS: usize = FIRST_WORDS + EVENT_WORDS;

/// Pixels after which the codes are chosen again.
const TERM_PIXELS: u32 = 16;
/// A mean of distances is held in units of 2^-3, and an eighth of it is new.
const MEAN_SHIFT: u32 = 3;
/// Distances beyond are learned as this much.
const DISTANCE_MAX: u32 = 1 << 28;
/// Quotients told in unary before the code widens.
const UNARY_MAX: u32 = 3;

/// What follows an event in its pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Then {
    /// Nothing.
    End = 0,
    /// An event of the same polarity.
    Same = 1,
    /// An event of the other one.
    Flip = 2,
}

impl Then {
    const fn of(index: u32) -> Self {
        match index {
            0 => Self::End,
            1 => Self::Same,
            _ => Self::Flip,
        }
    }
}

/// Up to 32 bits on their way.
#[derive(Debug, Clone, Copy)]
struct Piece {
    code: u32,
    bits: u32,
}

impl Piece {
    const NONE: Self = Self::of(0, 0);

    /// The low `bits` bits of `code`, which has no others.
    #[inline(always)]
    const fn of(code: u32, bits: u32) -> Self {
        Self { code, bits }
    }

    #[inline(always)]
    fn put(self, writer: &mut BitWriter<'_>) {
        writer.put_clean(self.code, self.bits);
    }

    /// Appends another, after what was there has been put where both are too long for a word.
    #[inline(always)]
    fn then(&mut self, other: Self, writer: &mut BitWriter<'_>) {
        if self.bits + other.bits < u32::BITS {
            self.code |= other.code << self.bits;
            self.bits += other.bits;
        } else {
            self.put(writer);
            *self = other;
        }
    }
}

/// What both sides know of the events that went by.
#[derive(Debug, Clone)]
pub struct Fast {
    cells: u32,
    time_bits: u32,
    width: u32,
    pixels_of_sensor: u32,
    next_index: u32,
    gap_mean_q3: u32,
    gap_max: u32,
    distance_means_q3: [u32; 2],
    counts: [u32; 3],
    favourite: u32,
    /// Codes of what follows an event.
    codes: [Piece; 3],
    /// Most pixels have a single event, which is not told of each.
    is_sparse: bool,
}

/// How bytes are not a frame's events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Malformed {
    /// They end too early.
    Ended,
    /// A pixel lies beyond the sensor.
    Position,
    /// A time lies beyond the window.
    Time,
    /// More events than the frame has.
    Events,
}

impl From<Ended> for Malformed {
    fn from(_: Ended) -> Self {
        Self::Ended
    }
}

const fn last_but(favourite: u32) -> u32 {
    if favourite == Then::Flip as u32 {
        Then::Same as u32
    } else {
        Then::Flip as u32
    }
}

/// A one for the favourite; for the others a zero, and which of them.
const fn codes(favourite: u32) -> [Piece; 3] {
    let mut codes = [Piece::of(0, 2); 3];
    let mut i = 0;
    while i < codes.len() {
        if i as u32 == favourite {
            codes[i] = Piece::of(1, 1);
        } else if i as u32 == last_but(favourite) {
            codes[i] = Piece::of(2, 2);
        }
        i += 1;
    }
    codes
}

impl Fast {
    /// The start of a frame of a window of `window_events` events in `cells` cells.
    #[must_use]
    pub const fn new(sensor: Sensor, window_events: u32, cells: u32) -> Self {
        let pixels = sensor.pixels();
        let events = if window_events == 0 { 1 } else { window_events };
        let gap = pixels / events;
        let cells = if cells == 0 { 1 } else { cells };
        let half = cells / 2;
        let half = if half < DISTANCE_MAX {
            half
        } else {
            DISTANCE_MAX
        };
        Self {
            cells,
            time_bits: u32::BITS - (cells - 1).leading_zeros(),
            width: sensor.width as u32,
            pixels_of_sensor: pixels,
            next_index: 0,
            gap_mean_q3: gap << MEAN_SHIFT,
            gap_max: (gap << MEAN_SHIFT) + 8,
            distance_means_q3: [half << MEAN_SHIFT; 2],
            counts: [0; 3],
            favourite: Then::End as u32,
            codes: codes(Then::End as u32),
            is_sparse: false,
        }
    }

    #[inline(always)]
    const fn gap_order(&self) -> u32 {
        match (self.gap_mean_q3 >> (MEAN_SHIFT + 1)).checked_ilog2() {
            Some(order) => order,
            None => 0,
        }
    }

    #[inline(always)]
    fn learn_gap(&mut self, gap: u32) {
        let mean = self.gap_mean_q3;
        self.gap_mean_q3 = mean - (mean >> MEAN_SHIFT) + gap.min(self.gap_max);
    }

    /// Order of the code of a distance from `cell`, by whether the polarity flips.
    #[inline(always)]
    fn distance_order(&self, flips: usize, cell: u32) -> u32 {
        let order = (self.distance_means_q3[flips & 1] >> MEAN_SHIFT)
            .checked_ilog2()
            .unwrap_or(0);
        let longest = self.cells - 1 - cell;
        order.min(u32::BITS - longest.leading_zeros())
    }

    #[inline(always)]
    fn learn_distance(&mut self, flips: usize, distance: u32) {
        let mean = &mut self.distance_means_q3[flips & 1];
        *mean = *mean - (*mean >> MEAN_SHIFT) + distance.min(DISTANCE_MAX);
    }

    /// A pixel is complete.
    #[inline(always)]
    fn learn_pixel(&mut self) {
        let [ends, sames, flips] = self.counts;
        if ends % TERM_PIXELS == 0 {
            self.favourite = if ends >= sames && ends >= flips {
                Then::End as u32
            } else if sames >= flips {
                Then::Same as u32
            } else {
                Then::Flip as u32
            };
            self.codes = codes(self.favourite);
            // Fewer than 5 events in 4 pixels.
            self.is_sparse = 4 * (sames + flips) < ends;
        }
    }

    /// Writes a pixel's events, cells ascending, as long as there is room; returns how many of them.
    ///
    /// `writer` has [`ROOM_WORDS`] of room before.
    #[inline(always)]
    pub fn write(
        &mut self,
        (x, y): (u16, u16),
        mut events: impl Iterator<Item = (u32, bool)>,
        writer: &mut BitWriter<'_>,
    ) -> u32 {
        let Some((mut cell, mut on)) = events.next() else {
            return 0;
        };
        let mut next = events.next();
        let index = u32::from(y) * self.width + u32::from(x);
        let gap = index - self.next_index;
        let order = self.gap_order();
        let is_sparse = self.is_sparse;
        if is_sparse && next.is_some() {
            writer.put_exp_golomb(0, order);
        }
        writer.put_exp_golomb(gap + u32::from(is_sparse), order);
        self.learn_gap(gap);
        self.next_index = index + 1;
        // What is told with a word at once goes out with what follows it.
        let mut told = Piece::of(u32::from(on), 1);
        told.then(Piece::of(cell, self.time_bits), writer);
        let mut written = 1;
        let mut is_first_of_sparse = is_sparse;
        while let Some((next_cell, next_on)) = next {
            let flips = usize::from(next_on != on);
            if is_first_of_sparse {
                told.then(Piece::of(flips as u32, 1), writer);
                is_first_of_sparse = false;
            } else {
                told.then(self.codes[1 + flips], writer);
            }
            self.counts[1 + flips] += 1;
            let distance = next_cell - cell;
            let order = self.distance_order(flips, cell);
            let quotient = distance >> order;
            if quotient < UNARY_MAX {
                // Zeros, a one, and the low bits.
                let low = distance & ((1 << order) - 1);
                let code = (low << 1 | 1) << quotient;
                told.then(Piece::of(code, quotient + 1 + order), writer);
            } else {
                told.then(Piece::of(0, UNARY_MAX), writer);
                told.put(writer);
                told = Piece::NONE;
                writer.put_exp_golomb(distance - (UNARY_MAX << order), order);
            }
            self.learn_distance(flips, distance);
            (cell, on) = (next_cell, next_on);
            written += 1;
            next = events.next();
            if next.is_some() && !writer.has_words(ROOM_WORDS) {
                break;
            }
        }
        if !is_first_of_sparse {
            told.then(self.codes[Then::End as usize], writer);
        }
        told.put(writer);
        self.counts[0] += 1;
        self.learn_pixel();
        written
    }

    /// Reads a frame's `events` events; `each` gets their columns, rows, cells and polarities.
    ///
    /// # Errors
    /// [`Malformed`]; what came before has been handed on. No input makes it panic.
    pub fn read(
        mut self,
        events: u32,
        reader: &mut BitReader<'_>,
        mut each: impl FnMut((u16, u16), u32, bool),
    ) -> Result<u32, Malformed> {
        let mut left = events;
        let mut pixels = 0;
        while left > 0 {
            let order = self.gap_order();
            let mut gap = reader.get_exp_golomb(order)?;
            let (mut is_told, mut goes_on) = (true, true);
            if self.is_sparse {
                goes_on = gap == 0;
                is_told = false;
                if gap == 0 {
                    gap = reader.get_exp_golomb(order)?;
                }
                gap = gap.checked_sub(1).ok_or(Malformed::Position)?;
            }
            let index = self.next_index.checked_add(gap);
            let index = index.filter(|index| *index < self.pixels_of_sensor);
            let index = index.ok_or(Malformed::Position)?;
            self.learn_gap(gap);
            self.next_index = index + 1;
            let position = ((index % self.width) as u16, (index / self.width) as u16);
            let mut on = reader.get(1)? == 1;
            let mut cell = reader.get(self.time_bits)?;
            if cell >= self.cells {
                return Err(Malformed::Time);
            }
            each(position, cell, on);
            left -= 1;
            while goes_on {
                let then = if is_told {
                    self.get_then(reader)?
                } else {
                    Then::of(1 + reader.get(1)?)
                };
                is_told = true;
                goes_on = then != Then::End;
                if !goes_on {
                    break;
                }
                left = left.checked_sub(1).ok_or(Malformed::Events)?;
                let flips = usize::from(then == Then::Flip);
                self.counts[1 + flips] += 1;
                let distance = self.get_distance(flips, cell, reader)?;
                let next = cell.checked_add(distance);
                cell = next
                    .filter(|cell| *cell < self.cells)
                    .ok_or(Malformed::Time)?;
                on ^= flips == 1;
                each(position, cell, on);
            }
            self.counts[0] += 1;
            self.learn_pixel();
            pixels += 1;
        }
        Ok(pixels)
    }

    /// The last of what is told with two bits, the second of them set.
    #[inline(always)]
    const fn last_but_favourite(&self) -> u32 {
        last_but(self.favourite)
    }

    #[inline(always)]
    fn get_then(&self, reader: &mut BitReader<'_>) -> Result<Then, Ended> {
        if reader.get(1)? == 1 {
            return Ok(Then::of(self.favourite));
        }
        // Of the other two the latter, or the one that is left.
        let last = self.last_but_favourite();
        let is_last = reader.get(1)? == 1;
        Ok(Then::of(if is_last {
            last
        } else {
            3 - last - self.favourite
        }))
    }

    #[inline(always)]
    fn get_distance(
        &mut self,
        flips: usize,
        cell: u32,
        reader: &mut BitReader<'_>,
    ) -> Result<u32, Malformed> {
        let order = self.distance_order(flips, cell);
        let quotient = reader.get_unary(UNARY_MAX)?;
        let distance = if quotient < UNARY_MAX {
            let low = reader.get(order)?;
            quotient
                .checked_shl(order)
                .and_then(|high| high.checked_add(low))
        } else {
            let more = reader.get_exp_golomb(order)?;
            more.checked_add(UNARY_MAX << order)
        };
        let distance = distance.ok_or(Malformed::Time)?;
        self.learn_distance(flips, distance);
        Ok(distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;
    use std::vec;
    use std::vec::Vec;

    type Pixels = BTreeMap<(u16, u16), Vec<(u32, bool)>>;

    /// Writes pixels into frames of `out_bytes` and reads them again.
    fn there_and_back(sensor: Sensor, cells: u32, pixels: &Pixels, out_bytes: usize) {
        let events = pixels.values().map(|events| events.len() as u32).sum();
        let mut left: Vec<_> = pixels
            .iter()
            .map(|(at, events)| (*at, &events[..]))
            .collect();
        let mut read = Pixels::new();
        while !left.is_empty() {
            let mut out = vec![0; out_bytes];
            let mut writer = BitWriter::new(&mut out);
            let mut coder = Fast::new(sensor, events, cells);
            let (mut done, mut written) = (0, 0);
            for ((y, x), events) in &mut left {
                if !writer.has_words(ROOM_WORDS) {
                    break;
                }
                let count = coder.write((*x, *y), events.iter().copied(), &mut writer);
                written += count;
                *events = &events[count as usize..];
                if !events.is_empty() {
                    break;
                }
                done += 1;
            }
            assert!(written > 0 && !writer.is_full());
            let bytes = writer.finish();
            let mut reader = BitReader::new(&out[..bytes]);
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
                &mut BitReader::new(&bytes),
                |(x, y), cell, _| {
                    assert!(x < width && y < height && cell < cells);
                    count += 1;
                },
            );
            prop_assert!(count <= events && (read.is_err() || count == events));
        }
    }
}
