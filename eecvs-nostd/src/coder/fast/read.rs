//! Reads the fast coder's events, with few branches.
//!
//! A pixel with its first event, and each further event, is decoded at once from the bits read ahead. If anything
//! is wrong with these bits, and near the end of the bytes, it is decoded again step by step.

use super::{Fast, Malformed, TERM_PIXELS};
use crate::coder::bits_msb_first::{AHEAD_BITS, BigReader};

/// Shift of a row's reciprocal. For places, all below 2^22, its error of 2^-40 each adds up to less than a column's
/// share of a row, 2^-11 or more.
const ROW_SHIFT: u32 = 40;

/// What does not change within a frame.
struct Shape {
    /// Places per row.
    row: u32,
    /// 2^40 / `row`, and up to 1 more.
    reciprocal: u64,
    width: u32,
    /// Places in all rows.
    places: u64,
    cells: u32,
    cell_bits: u32,
    /// As many ones as `cell_bits`.
    cell_mask: u32,
}

/// A pixel and its first event.
struct First {
    place: u64,
    at: (u16, u16),
    cell: u32,
    /// Its polarity, 1 for ON.
    on: u32,
    is_single: bool,
}

/// An event after its pixel's first.
struct Next {
    cell: u32,
    /// Leading zeros of its distance's code.
    zeros: u32,
    /// 0 if another event of the same polarity follows, else 1.
    is_other: u32,
    is_last: bool,
}

impl Fast {
    /// Reads a frame's `events` events and calls `each` with their column and row, cell and polarity.
    ///
    /// # Errors
    /// [`Malformed`]; all or most of the events before the error have been handed on. No input makes it panic.
    pub fn read(
        mut self,
        events: u32,
        reader: &mut BigReader<'_>,
        mut each: impl FnMut((u16, u16), u32, bool),
    ) -> Result<(), Malformed> {
        let shape = Shape::new(&self);
        // A copy whose address is never taken stays in registers.
        let mut bits = reader.clone();
        // One byte per order.
        let mut orders = u32::from_le_bytes(self.orders);
        let order_mask = u32::from(self.order_mask);
        let mut left = events;
        let mut next = u64::from(self.gaps.next);
        loop {
            let order = self.gaps.order();
            for _ in 0..TERM_PIXELS {
                if left == 0 {
                    *reader = bits;
                    return Ok(());
                }
                let first = match shape.first(next, order, &mut bits) {
                    Some(first) => first,
                    None => {
                        let slow = shape.first_slowly(next, order, bits)?;
                        bits = slow.1;
                        slow.0
                    }
                };
                each(first.at, first.cell, first.on == 1);
                left -= 1;
                next = first.place + 1;
                if first.is_single {
                    continue;
                }
                let mut cell = first.cell;
                let mut polarities = first.on << 1 | bits.one()?;
                loop {
                    left = left.checked_sub(1).ok_or(Malformed::Events)?;
                    let shift = 8 * polarities;
                    let order = (orders >> shift) & 31;
                    let next = match shape.next(cell, order, &mut bits) {
                        Some(next) => next,
                        None => {
                            let slow = shape.next_slowly(cell, order, bits)?;
                            bits = slow.1;
                            slow.0
                        }
                    };
                    cell = next.cell;
                    let on = polarities & 1;
                    each(first.at, cell, on == 1);
                    let learned = (order + next.zeros).saturating_sub(1) & order_mask;
                    orders = (orders & !(0xff << shift)) | (learned << shift);
                    if next.is_last {
                        break;
                    }
                    polarities = on << 1 | (on ^ next.is_other);
                }
            }
            self.gaps.end_term(next as u32, self.cell_bits);
        }
    }
}

impl Shape {
    const fn new(coder: &Fast) -> Self {
        let row = if coder.row == 0 { 1 } else { coder.row };
        Self {
            row,
            reciprocal: (1 << ROW_SHIFT) / row as u64 + 1,
            width: coder.width,
            places: row as u64 * coder.height as u64,
            cells: coder.cells,
            cell_bits: coder.cell_bits,
            cell_mask: ((1_u64 << coder.cell_bits) - 1) as u32,
        }
    }

    /// Returns column and row of a place. If the column is beyond the width, there is no such pixel.
    #[inline(always)]
    const fn position(&self, place: u64) -> (u32, u32) {
        let y = (place.wrapping_mul(self.reciprocal) >> ROW_SHIFT) as u32;
        ((place as u32).wrapping_sub(y.wrapping_mul(self.row)), y)
    }

    /// Reads a pixel at or after the place `next`; `None` where [`Self::first_slowly`] has to.
    #[inline(always)]
    fn first(&self, next: u64, order: u32, bits: &mut BigReader<'_>) -> Option<First> {
        if !bits.look() {
            return None;
        }
        // The gap, whether the pixel has a single event, and the first event's cell and polarity.
        let all = 2 * bits.zeros() + order + self.cell_bits + 3;
        let code = bits.top(all);
        let upper = code >> ((self.cell_bits + 1) & 63);
        let place = next.wrapping_sub(1 << order).wrapping_add(upper >> 1);
        let (x, y) = self.position(place);
        let cell = (code >> 1) as u32 & self.cell_mask;
        // A gap of more than 32 bits leads to a place beyond the last.
        if all <= AHEAD_BITS && place < self.places && x < self.width && cell < self.cells {
            bits.skip(all);
            return Some(First {
                place,
                at: (x as u16, y as u16),
                cell,
                on: code as u32 & 1,
                is_single: upper & 1 == 1,
            });
        }
        None
    }

    /// As [`Self::first`], near the end of the bytes or to find the error.
    #[cold]
    #[inline(never)]
    fn first_slowly<'i>(
        &self,
        next: u64,
        order: u32,
        mut bits: BigReader<'i>,
    ) -> Result<(First, BigReader<'i>), Malformed> {
        let gap = bits.get_raised(order)? - (1 << order);
        let place = next + u64::from(gap);
        let (x, y) = self.position(place);
        if place >= self.places || x >= self.width {
            return Err(Malformed::Position);
        }
        let is_single = bits.get(1)? == 1;
        let cell = bits.get(self.cell_bits)?;
        if cell >= self.cells {
            return Err(Malformed::Time);
        }
        let first = First {
            place,
            at: (x as u16, y as u16),
            cell,
            on: bits.get(1)?,
            is_single,
        };
        Ok((first, bits))
    }

    /// Reads an event after one in `cell`; `None` where [`Self::next_slowly`] has to.
    #[inline(always)]
    fn next(&self, cell: u32, order: u32, bits: &mut BigReader<'_>) -> Option<Next> {
        if !bits.look() {
            return None;
        }
        let zeros = bits.zeros();
        // With the two bits after the distance, the second of which may be of another code.
        let all = 2 * zeros + order + 3;
        let code = bits.top(all);
        let cell = u64::from(cell).wrapping_add((code >> 2).wrapping_sub(1 << order));
        // Orders are at most 30, and 0 with more than 2^31 cells, so a distance of more than 32 bits leads to a
        // cell beyond the last.
        if all <= AHEAD_BITS && cell < u64::from(self.cells) {
            let is_other = (code >> 1) as u32 & 1;
            bits.skip(all - 1 + is_other);
            return Some(Next {
                cell: cell as u32,
                zeros,
                is_other,
                is_last: code & 3 == 0b10,
            });
        }
        None
    }

    /// As [`Self::next`], near the end of the bytes or to find the error.
    #[cold]
    #[inline(never)]
    fn next_slowly<'i>(
        &self,
        cell: u32,
        order: u32,
        mut bits: BigReader<'i>,
    ) -> Result<(Next, BigReader<'i>), Malformed> {
        let raised = bits.get_raised(order)?;
        let next = cell.checked_add(raised - (1 << order));
        let cell = next
            .filter(|cell| *cell < self.cells)
            .ok_or(Malformed::Time)?;
        let is_other = bits.get(1)?;
        let next = Next {
            cell,
            // Number of bits below the highest, less the order.
            zeros: raised.ilog2() - order,
            is_other,
            is_last: is_other == 1 && bits.get(1)? == 0,
        };
        Ok((next, bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use event_types::Sensor;
    use proptest::prelude::*;
    use std::vec::Vec;

    type Found = Vec<((u16, u16), u32, bool)>;

    /// Reads as [`Fast::read`] does, but code by code.
    fn read_slowly(
        mut coder: Fast,
        events: u32,
        reader: &mut BigReader<'_>,
        found: &mut Found,
    ) -> Result<(), Malformed> {
        while found.len() < events as usize {
            let gap = reader.get_raised(coder.gaps.order())? - coder.gaps.base / 2;
            let place = coder.gaps.next.checked_add(gap);
            let place = place.ok_or(Malformed::Position)?;
            let (x, y) = (place % coder.row, place / coder.row);
            if x >= coder.width || y >= coder.height {
                return Err(Malformed::Position);
            }
            let at = (x as u16, y as u16);
            let is_single = reader.get(1)? == 1;
            let mut cell = reader.get(coder.cell_bits)?;
            if cell >= coder.cells {
                return Err(Malformed::Time);
            }
            let mut on = reader.get(1)?;
            found.push((at, cell, on == 1));
            coder.gaps.step(place, coder.cell_bits);
            if is_single {
                continue;
            }
            let mut next_on = reader.get(1)?;
            loop {
                if found.len() == events as usize {
                    return Err(Malformed::Events);
                }
                let polarities = (on << 1 | next_on) as usize;
                let order = u32::from(coder.orders[polarities]);
                let raised = reader.get_raised(order)?;
                coder.learn(polarities, raised.leading_zeros());
                let next = cell.checked_add(raised - (1 << order));
                let next = next.filter(|cell| *cell < coder.cells);
                (cell, on) = (next.ok_or(Malformed::Time)?, next_on);
                found.push((at, cell, on == 1));
                if reader.get(1)? == 1 {
                    if reader.get(1)? == 0 {
                        break;
                    }
                    next_on = 1 - on;
                }
            }
        }
        Ok(())
    }

    proptest! {
        /// Any bytes give the same events, or the same error, as reading code by code.
        #[test]
        fn codes_at_once_are_those_one_by_one(
            bytes in proptest::collection::vec((any::<u8>(), any::<u8>()), 0..300),
            (has_many_ones, has_many_zeros) in any::<(bool, bool)>(),
            (width, height) in (1..=2048_u16, 1..=2048_u16),
            cells in prop_oneof![1_u32..70, (0_u32..32).prop_map(|bits| 1 << bits), 1_u32..],
            (window_events, events) in (0_u32..1 << 24, 0_u32..1000),
        ) {
            let bytes: Vec<_> = bytes
                .iter()
                .map(|(byte, other)| match (has_many_ones, has_many_zeros) {
                    (true, false) => byte | other,
                    (false, true) => byte & other,
                    _ => *byte,
                })
                .collect();
            let coder = Fast::new(Sensor::new(width, height).unwrap(), window_events, cells);
            let (mut found, mut expected) = (Found::new(), Found::new());
            let (mut reader, mut plain) = (BigReader::new(&bytes), BigReader::new(&bytes));
            let read = coder.clone().read(events, &mut reader, |at, cell, on| {
                found.push((at, cell, on));
            });
            let read_slowly = read_slowly(coder, events, &mut plain, &mut expected);
            prop_assert_eq!(read, read_slowly);
            if read.is_err() {
                // How many events are handed on before an error is not promised.
                let len = found.len().min(expected.len());
                found.truncate(len);
                expected.truncate(len);
            } else {
                prop_assert_eq!(reader.is_spent(), plain.is_spent());
            }
            prop_assert_eq!(found, expected);
        }
    }
}
