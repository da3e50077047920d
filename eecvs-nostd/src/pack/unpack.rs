//! Unpacks bits to descriptors: the inverse of [`crate::pack::packer`].

use heapless::Vec;

use crate::coder::cells::Cells;
use crate::pack::bits_lsb_first::{BitReader, Ended};
use crate::pack::descriptor::{Coded, Descriptor};
use crate::pack::timed::{TimedEvent, TimedEvents, first_order, next_order};
use crate::quantise::Level;
use crate::transform::shape::{MASK_GRID_MAX, Packing, width_of};
use crate::transform::{M_MAX, Transform};

/// Why a payload is malformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UnpackError {
    /// The payload ends inside a pixel.
    Ended,
    /// A pixel lies beyond the sensor.
    Position,
    /// The pixels' counts contradict the header.
    Events,
    /// More coefficients than M, an index beyond the grid, or a level or a cell that no encoder writes.
    Levels,
    /// Bits are left after the last pixel.
    Trailing,
}

impl core::fmt::Display for UnpackError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Ended => "the payload ends inside of a pixel",
            Self::Position => "a pixel lies beyond the sensor",
            Self::Events => "a pixel's event count contradicts the header",
            Self::Levels => "a coefficient contradicts M or the grid",
            Self::Trailing => "bits are left after the last pixel",
        })
    }
}

impl core::error::Error for UnpackError {}

impl From<Ended> for UnpackError {
    fn from(_: Ended) -> Self {
        Self::Ended
    }
}

impl Packing {
    /// Reads the next pixel, of at most `events_left` events; the inverse of [`Packing::pack`]. `next_index` is the
    /// raster index after the previous pixel's, and is moved on.
    ///
    /// # Errors
    /// [`UnpackError`] for bits that no encoder writes; no input makes it panic or loop for ever.
    pub fn unpack(
        &self,
        next_index: &mut u32,
        events_left: u32,
        reader: &mut BitReader<'_>,
    ) -> Result<Descriptor, UnpackError> {
        let gap = reader.get_exp_golomb(self.gap_order())?;
        let index = next_index.checked_add(gap).ok_or(UnpackError::Position)?;
        if index >= self.sensor.pixels() {
            return Err(UnpackError::Position);
        }
        let more = reader.get_exp_golomb(0)?;
        if more >= events_left {
            return Err(UnpackError::Events);
        }
        let events = more + 1;
        let on = reader.get(width_of(events))?;
        let off = events.checked_sub(on).ok_or(UnpackError::Events)?;
        let coded = if events == 1 {
            Coded::Cell(reader.get(self.cells_log2())?)
        } else if self.timed.has(events) {
            Coded::Times(unpack_times((on, off), self.timed_cells(events), reader)?)
        } else {
            Coded::Levels(self.unpack_levels((on, off), reader)?)
        };
        *next_index = index + 1;
        let width = u32::from(self.sensor.width);
        Ok(Descriptor {
            x: (index % width) as u16,
            y: (index / width) as u16,
            on,
            off,
            coded,
        })
    }

    fn unpack_levels(
        &self,
        (on, off): (u32, u32),
        reader: &mut BitReader<'_>,
    ) -> Result<Vec<Level, M_MAX>, UnpackError> {
        let ks = self.unpack_set(reader)?;
        let mut levels = Vec::new();
        let mut bits = self.level_bits_max(on + off);
        let has_width = ks.iter().any(|k| *k > 0);
        if has_width {
            let less = reader.get_unary(32)?;
            bits = bits
                .checked_sub(less)
                .filter(|bits| *bits > 0)
                .ok_or(UnpackError::Levels)?;
        }
        let mut spread = 0;
        let mut next = || -> Result<i32, UnpackError> {
            let level = (reader.get(bits)? << (32 - bits)) as i32 >> (32 - bits);
            spread |= (level ^ (level >> 31)) as u32;
            Ok(level)
        };
        for k in ks {
            let (re, im) = match (k, self.transform) {
                (0, _) => (on as i32 - off as i32, 0),
                (_, Transform::Dct) => (next()?, 0),
                (_, Transform::Dtft) => (next()?, next()?),
                (_, Transform::Dwt) => {
                    let re = next()?;
                    // At most 25 bits, so the sum does not overflow.
                    (re + i32::from(re >= 0), 0)
                }
            };
            if self.transform == Transform::Dwt && re == 0 {
                return Err(UnpackError::Levels);
            }
            levels
                .push(Level { k, re, im })
                .map_err(|_| UnpackError::Levels)?;
        }
        // The width has to be the narrowest that fits, so that a pixel has only one encoding.
        if has_width && width_of(spread) + 1 != bits {
            return Err(UnpackError::Levels);
        }
        Ok(levels)
    }

    /// Reads the indices of the coefficients that are sent, including k = 0 where it is kept.
    fn unpack_set(&self, reader: &mut BitReader<'_>) -> Result<Vec<u16, M_MAX>, UnpackError> {
        let r = self.kept() as u32;
        let mut ks = Vec::new();
        let mut keep = |k: u32| ks.push(k as u16).map_err(|_| UnpackError::Levels);
        let is_low = match self.transform {
            Transform::Dct => true,
            Transform::Dtft => r == u32::from(self.grid) || reader.get(1)? == 1,
            Transform::Dwt => false,
        };
        if is_low {
            (0..r).try_for_each(keep)?;
            return Ok(ks);
        }
        let mut count = None;
        if self.transform.is_complex() {
            count = Some(r);
        } else if self.grid > MASK_GRID_MAX {
            count = Some(reader.get(width_of(r))?);
        }
        if count.is_some_and(|count| count > r) {
            return Err(UnpackError::Levels);
        }
        if count.is_some_and(|count| self.lists_indices(count)) {
            let mut least = 0;
            for _ in 0..count.unwrap_or(0) {
                let k = reader.get(self.index_bits())?;
                if k < least || k >= u32::from(self.grid) {
                    return Err(UnpackError::Levels);
                }
                least = k + 1;
                keep(k)?;
            }
        } else {
            for k in 0..u32::from(self.grid) {
                if reader.get(1)? == 1 {
                    keep(k)?;
                }
            }
        }
        let found = ks.len() as u32;
        let is_contiguous = || ks.last().is_none_or(|last| u32::from(*last) + 1 == r);
        if found > r
            || count.is_some_and(|count| count != found)
            || (self.transform.is_complex() && is_contiguous())
        {
            return Err(UnpackError::Levels);
        }
        Ok(ks)
    }
}

/// Reads the events of a pixel that is sent as times: what [`crate::pack::timed`] puts.
fn unpack_times(
    (on, off): (u32, u32),
    cells: Cells,
    reader: &mut BitReader<'_>,
) -> Result<TimedEvents, UnpackError> {
    let bits = width_of(cells.count() - 1);
    let (mut on_left, mut off_left) = (on, off);
    let mut order = first_order(bits);
    let mut events = TimedEvents::new();
    while on_left + off_left > 0 {
        let is_on = match (on_left, off_left) {
            (0, _) => false,
            (_, 0) => true,
            _ => reader.get(1)? == 1,
        };
        on_left -= u32::from(is_on);
        off_left -= u32::from(!is_on);
        let before = events.last().copied();
        let cell = match before {
            None => reader.get(bits)?,
            Some(TimedEvent { cell, .. }) => {
                let distance = reader.get_exp_golomb(order)?;
                let next = cell.checked_add(distance).ok_or(UnpackError::Levels)?;
                if next >= cells.count() {
                    return Err(UnpackError::Levels);
                }
                order = next_order(order, distance);
                next
            }
        };
        let event = TimedEvent { cell, is_on };
        // A pixel has only one encoding.
        if cell >= cells.count() || before.is_some_and(|before| event < before) {
            return Err(UnpackError::Levels);
        }
        events.push(event).map_err(|_| UnpackError::Levels)?;
    }
    Ok(events)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pack::bits_lsb_first::BitWriter;
    use crate::quantise::Quantiser;
    use crate::transform::shape::Timed;
    use event_types::Sensor;

    fn packing(transform: Transform, m: u8, grid: u16, step_log2: i8) -> Packing {
        Packing {
            sensor: Sensor {
                width: Sensor::SIDE_MAX,
                height: Sensor::SIDE_MAX,
            },
            // As many events as pixels: the gap code's order is 0, its longest.
            window_events: 1 << 22,
            transform,
            m,
            grid,
            quantiser: Quantiser::new(step_log2).unwrap(),
            timed: Timed::NONE,
        }
    }

    /// Unpacks a pixel at (0, 0) with `on` ON events, whose counts are followed by `fields` (value, bits).
    fn unpack(packing: Packing, on: u32, fields: &[(u32, u32)]) -> Result<Descriptor, UnpackError> {
        let mut bytes = [0; 64];
        let mut writer = BitWriter::new(&mut bytes);
        writer.put_exp_golomb(0, 0);
        writer.put_exp_golomb(on - 1, 0);
        writer.put(on, width_of(on));
        for (value, bits) in fields {
            writer.put(*value, *bits);
        }
        let len = writer.finish();
        packing.unpack(&mut 0, on, &mut BitReader::new(&bytes[..len]))
    }

    /// Codes of the levels' width: the widest possible, one less, and two less.
    const WIDEST: (u32, u32) = (1, 1);
    const ONE_LESS: (u32, u32) = (2, 2);
    const TWO_LESS: (u32, u32) = (4, 3);

    #[test]
    fn a_pixel_has_one_encoding() {
        let refused = Err(UnpackError::Levels);
        let levels = |descriptor: Result<Descriptor, _>| {
            let Coded::Levels(levels) = descriptor.unwrap().coded else {
                panic!("a single event");
            };
            levels
                .iter()
                .map(|l| (l.k, l.re, l.im))
                .collect::<std::vec::Vec<_>>()
        };
        // Two events: Haar levels of -2 to 2, the positive ones sent as one less.
        let set = packing(Transform::Dwt, 4, 16, 0);
        let mask = |mask: u32, width, first: (u32, u32), second: (u32, u32)| {
            unpack(set, 2, &[(mask, 16), width, first, second])
        };
        let found = mask(1 << 3 | 1 << 5, WIDEST, (1, 2), (3, 2));
        assert_eq!(levels(found), [(3, 2, 0), (5, -1, 0)]);
        let found = mask(1 << 3 | 1 << 5, ONE_LESS, (0, 1), (1, 1));
        assert_eq!(levels(found), [(3, 1, 0), (5, -1, 0)]);
        let found = mask(1 << 3 | 1 << 5, WIDEST, (0, 2), (3, 2));
        assert_eq!(found, refused, "a width that no level needs");
        let found = mask(1 << 3 | 1 << 5, TWO_LESS, (0, 1), (0, 1));
        assert_eq!(found, refused, "a width of 0");
        assert_eq!(
            unpack(set, 2, &[(0x1f << 3, 16), WIDEST]),
            refused,
            "5 of 4"
        );
        assert_eq!(levels(unpack(set, 2, &[(1, 16)])), [(0, 2, 0)]);
        assert_eq!(levels(unpack(set, 2, &[(0, 16)])), []);

        // More than 32 coefficients: the number that is sent, and a list.
        let wide = packing(Transform::Dwt, 4, 64, 0);
        let list = |first, second| {
            let fields = [(2, 3), (first, 6), (second, 6), ONE_LESS, (0, 1), (0, 1)];
            unpack(wide, 2, &fields)
        };
        assert_eq!(levels(list(3, 5)), [(3, 1, 0), (5, 1, 0)]);
        assert_eq!(list(5, 5), refused, "an index twice");
        assert_eq!(list(5, 3), refused, "descending indices");
        assert_eq!(unpack(wide, 2, &[(5, 3), WIDEST]), refused, "more than M");

        let complex = packing(Transform::Dtft, 2, 16, 0);
        let pair = [ONE_LESS, (0, 1), (1, 1), (1, 1), (0, 1)];
        let found = unpack(
            complex,
            2,
            &[&[(0, 1), (1 << 3 | 1 << 5, 16)], &pair[..]].concat(),
        );
        assert_eq!(levels(found), [(3, 0, -1), (5, -1, 0)]);
        let low = [&[(0, 1), (3, 16)], &pair[..]].concat();
        assert_eq!(unpack(complex, 2, &low), refused, "the lowest as a set");
        let one = [&[(0, 1), (1 << 3, 16)], &pair[..]].concat();
        assert_eq!(unpack(complex, 2, &one), refused, "fewer than r");

        let run = packing(Transform::Dct, 3, 3, 0);
        assert_eq!(
            levels(unpack(run, 2, &[WIDEST, (1, 2), (0, 2)])),
            [(0, 2, 0), (1, 1, 0), (2, 0, 0)]
        );
        let found = unpack(run, 2, &[WIDEST, (3, 2), (0, 2)]);
        assert_eq!(found, refused, "a width that no level needs");
    }

    #[test]
    fn a_single_event_is_its_cell() {
        // At least pi 7 / 2^-6 = 1,407 cells for the DCT; 4 times that for the DTFT, 13 bits, of which 12 are
        // written here and the last is padding; K bins for the DWT.
        for (transform, grid, bits) in [
            (Transform::Dct, 8, 11),
            (Transform::Dtft, 16, 13),
            (Transform::Dwt, 16, 4),
        ] {
            let packing = packing(transform, 8, grid, -6);
            let last = (1 << bits) - 1;
            let found = unpack(packing, 1, &[(last, bits)]).unwrap();
            assert_eq!(found.coded, Coded::Cell(last), "{transform:?}");
        }
    }
}
