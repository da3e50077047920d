//! Descriptors to bits and back: the payload of a frame.
//!
//! Pixels follow each other in raster order. Per pixel: the gap to the previous pixel, the event
//! counts, which coefficients follow, and their levels; docs/wire-format.md has every field.
//! Nothing adapts: every code parameter follows from the header and from what the pixel sent
//! before, so a frame decodes by itself.

use heapless::Vec;

use crate::bits::{BitReader, BitWriter, Ended, Full};
use crate::descriptor::Descriptor;
use crate::event::Sensor;
use crate::quantise::{Level, Quantiser};
use crate::transform::{M_MAX, Rule, Transform};

/// Bytes that one packed pixel can take at the most: gap and counts 15, which coefficients 81,
/// 128 numbers of 7; `the_largest_pixel_fits_its_bound` packs it.
pub const PIXEL_BYTES_MAX: usize = 1100;

/// How a payload is malformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UnpackError {
    /// The payload ends inside of a pixel.
    Ended,
    /// A pixel lies beyond the sensor.
    Position,
    /// A pixel's counts are more than what the header has left.
    Events,
    /// More coefficients than M, or an index beyond the grid.
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

/// What both directions know of a frame before its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Packing {
    /// Sensor size.
    pub sensor: Sensor,
    /// N_w, which sets the order of the gap code.
    pub window_events: u32,
    /// Transform.
    pub transform: Transform,
    /// M, 1 to 64.
    pub m: u8,
    /// K, 1 to 1024.
    pub grid: u16,
    /// Quantiser.
    pub quantiser: Quantiser,
}

/// Bits that hold a value from 0 to `most`.
const fn width_of(most: u32) -> u32 {
    u32::BITS - most.leading_zeros()
}

impl Packing {
    /// r = min(M, K).
    #[must_use]
    pub const fn kept(&self) -> usize {
        if (self.m as u16) < self.grid {
            self.m as usize
        } else {
            self.grid as usize
        }
    }

    /// Order of the gap code: log2 of the mean gap, were every event alone in its pixel.
    const fn gap_order(&self) -> u32 {
        let pixels = self.sensor.pixels();
        let events = if self.window_events == 0 {
            1
        } else {
            self.window_events
        };
        if pixels <= events {
            0
        } else {
            (pixels / events).ilog2()
        }
    }

    /// Plain bits of a level's Rice code for a pixel of n events: |c| grows as sqrt(n), and a
    /// Haar level counts events and not steps.
    fn rice_bits(&self, events: u32) -> u32 {
        let growth = events.ilog2() as i32 / 2;
        let steps = match self.transform {
            Transform::Dct | Transform::Dtft => -i32::from(self.quantiser.step_log2()),
            Transform::Dwt => -(i32::from(self.quantiser.step_log2()).max(0)),
        };
        (steps + growth).clamp(0, 31) as u32
    }

    /// Level of c_0, which the counts already tell.
    fn level_zero(&self, on: u32, off: u32) -> Level {
        let net = crate::fixed_point::WideSum::from_num(i64::from(on) - i64::from(off));
        let (re, _) = match self.transform {
            Transform::Dct | Transform::Dtft => self.quantiser.uniform(net),
            Transform::Dwt => self.quantiser.haar(net, 0),
        };
        Level { k: 0, re, im: 0 }
    }

    /// Appends `descriptor`; `next_index` is the raster index after the previous pixel's.
    ///
    /// # Errors
    /// [`Full`], with the writer to be rewound by the caller.
    pub fn pack(
        &self,
        descriptor: &Descriptor,
        next_index: &mut u32,
        writer: &mut BitWriter<'_>,
    ) -> Result<(), Full> {
        let index =
            u32::from(descriptor.y) * u32::from(self.sensor.width) + u32::from(descriptor.x);
        writer.put_exp_golomb(index - *next_index, self.gap_order())?;
        let events = descriptor.events();
        writer.put_exp_golomb(events - 1, 0)?;
        writer.put(descriptor.on, width_of(events))?;
        match self.transform.rule() {
            Rule::LowFrequency => self.pack_run(descriptor, writer)?,
            Rule::Magnitude => self.pack_set(descriptor, writer)?,
        }
        *next_index = index + 1;
        Ok(())
    }

    /// Coefficients 0..len, zeros in between included.
    fn pack_run(&self, descriptor: &Descriptor, writer: &mut BitWriter<'_>) -> Result<(), Full> {
        let bits = self.rice_bits(descriptor.events());
        let len = descriptor
            .levels
            .last()
            .map_or(0, |level| u32::from(level.k) + 1);
        writer.put(len, width_of(self.kept() as u32))?;
        let mut levels = descriptor.levels.iter().peekable();
        for k in 0..len {
            let level = levels.next_if(|level| u32::from(level.k) == k);
            if k > 0 {
                writer.put_rice(level.map_or(0, |level| level.re), bits)?;
            }
        }
        Ok(())
    }

    /// A set of coefficients: how many, which, and their levels.
    fn pack_set(&self, descriptor: &Descriptor, writer: &mut BitWriter<'_>) -> Result<(), Full> {
        let levels = &descriptor.levels;
        let count = levels.len() as u32;
        writer.put(count, width_of(self.kept() as u32))?;
        if count == 0 {
            return Ok(());
        }
        let contiguous = levels
            .last()
            .is_some_and(|level| u32::from(level.k) + 1 == count);
        writer.put(u32::from(contiguous), 1)?;
        if !contiguous {
            if self.lists_indices(count) {
                for level in levels {
                    writer.put(u32::from(level.k), self.index_bits())?;
                }
            } else {
                let mut ks = levels.iter().map(|level| level.k).peekable();
                for k in 0..self.grid {
                    writer.put(u32::from(ks.next_if_eq(&k).is_some()), 1)?;
                }
            }
        }
        let bits = self.rice_bits(descriptor.events());
        for level in levels.iter().filter(|level| level.k > 0) {
            if self.transform.is_complex() {
                writer.put_rice(level.re, bits)?;
                writer.put_rice(level.im, bits)?;
            } else {
                // Never 0, so the positive values move down to it.
                writer.put_rice(level.re - i32::from(level.re > 0), bits)?;
            }
        }
        Ok(())
    }

    const fn index_bits(&self) -> u32 {
        width_of(self.grid as u32 - 1)
    }

    /// Whether a list of indices is shorter than a bit per grid point.
    const fn lists_indices(&self, count: u32) -> bool {
        count * self.index_bits() < self.grid as u32
    }

    /// Reads the next pixel; the inverse of [`Packing::pack`]. At most `events_left` events.
    ///
    /// # Errors
    /// [`UnpackError`] for bits that no encoder writes; no input makes it panic or loop.
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
        let width = u32::from(self.sensor.width);
        let mut descriptor = Descriptor {
            x: (index % width) as u16,
            y: (index / width) as u16,
            on,
            off,
            levels: Vec::new(),
        };
        match self.transform.rule() {
            Rule::LowFrequency => self.unpack_run(&mut descriptor, reader)?,
            Rule::Magnitude => self.unpack_set(&mut descriptor, reader)?,
        }
        *next_index = index + 1;
        Ok(descriptor)
    }

    fn unpack_run(
        &self,
        descriptor: &mut Descriptor,
        reader: &mut BitReader<'_>,
    ) -> Result<(), UnpackError> {
        let bits = self.rice_bits(descriptor.events());
        let len = reader.get(width_of(self.kept() as u32))?;
        if len as usize > self.kept() {
            return Err(UnpackError::Levels);
        }
        for k in 0..len as u16 {
            let level = if k == 0 {
                self.level_zero(descriptor.on, descriptor.off)
            } else {
                Level {
                    k,
                    re: reader.get_rice(bits)?,
                    im: 0,
                }
            };
            if level.re != 0 {
                descriptor
                    .levels
                    .push(level)
                    .map_err(|_| UnpackError::Levels)?;
            }
        }
        // The encoder's last coefficient is never 0: a length has one meaning.
        if descriptor
            .levels
            .last()
            .map_or(0, |level| u32::from(level.k) + 1)
            != len
        {
            return Err(UnpackError::Levels);
        }
        Ok(())
    }

    fn unpack_set(
        &self,
        descriptor: &mut Descriptor,
        reader: &mut BitReader<'_>,
    ) -> Result<(), UnpackError> {
        let count = reader.get(width_of(self.kept() as u32))?;
        if count as usize > self.kept() {
            return Err(UnpackError::Levels);
        }
        if count == 0 {
            return Ok(());
        }
        let ks = self.unpack_indices(count, reader)?;
        let bits = self.rice_bits(descriptor.events());
        for k in ks {
            let level = if k == 0 {
                self.level_zero(descriptor.on, descriptor.off)
            } else {
                let re = reader.get_rice(bits)?;
                if self.transform.is_complex() {
                    Level {
                        k,
                        re,
                        im: reader.get_rice(bits)?,
                    }
                } else {
                    let re = re
                        .checked_add(i32::from(re >= 0))
                        .ok_or(UnpackError::Levels)?;
                    Level { k, re, im: 0 }
                }
            };
            if (level.re, level.im) == (0, 0) {
                return Err(UnpackError::Levels);
            }
            descriptor
                .levels
                .push(level)
                .map_err(|_| UnpackError::Levels)?;
        }
        Ok(())
    }

    fn unpack_indices(
        &self,
        count: u32,
        reader: &mut BitReader<'_>,
    ) -> Result<Vec<u16, M_MAX>, UnpackError> {
        let mut ks = Vec::new();
        let mut keep = |k: u32| ks.push(k as u16).map_err(|_| UnpackError::Levels);
        if reader.get(1)? == 1 {
            (0..count).try_for_each(&mut keep)?;
        } else if self.lists_indices(count) {
            let mut least = 0;
            for _ in 0..count {
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
        if ks.len() as u32 == count {
            Ok(ks)
        } else {
            Err(UnpackError::Levels)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        }
    }

    #[test]
    fn rice_bits_follow_steps_and_events_and_haar_levels_events_alone() {
        for (transform, step_log2, events, bits) in [
            (Transform::Dct, -6, 1, 6),
            (Transform::Dtft, -6, 4, 7),
            (Transform::Dtft, 2, 1 << 10, 3),
            (Transform::Dct, 8, 1, 0),
            (Transform::Dwt, -6, 1, 0),
            (Transform::Dwt, -15, 16, 2),
            (Transform::Dwt, 2, 1 << 10, 3),
            (Transform::Dwt, 8, 1, 0),
        ] {
            let packing = packing(transform, 8, 16, step_log2);
            assert_eq!(
                packing.rice_bits(events),
                bits,
                "{transform:?} {step_log2} {events}"
            );
        }
    }

    #[test]
    fn indices_are_listed_only_where_that_is_shorter() {
        for (grid, count, lists) in [
            (16, 3, true),
            (16, 4, false),
            (1024, 64, true),
            (640, 64, false),
            (1, 1, true),
        ] {
            let packing = packing(Transform::Dtft, 64, grid, 0);
            assert_eq!(packing.lists_indices(count), lists, "{count} of {grid}");
        }
    }

    /// Every code of a pixel at its longest, for the grids where the indices take most.
    #[test]
    fn the_largest_pixel_fits_its_bound() {
        let mut longest = 0;
        for transform in Transform::ALL {
            for grid in [64, 512, 640, 1024] {
                for step_log2 in [-15, -6, 8] {
                    let grid = transform.grid_size(64, Some(grid));
                    let packing = packing(transform, 64, grid, step_log2);
                    let side = Sensor::SIDE_MAX;
                    let mut descriptor = Descriptor {
                        x: side - 1,
                        y: side - 1,
                        on: (1 << 24) - 2,
                        off: 1,
                        levels: Vec::new(),
                    };
                    let first = match transform.rule() {
                        Rule::LowFrequency => 0,
                        Rule::Magnitude => grid - 64,
                    };
                    for k in first..first + 64 {
                        let level = Level {
                            k,
                            re: i32::MIN,
                            im: i32::from(transform.is_complex()) * i32::MIN,
                        };
                        let _ = descriptor.levels.push(level);
                    }
                    let mut bytes = [0; 2 * PIXEL_BYTES_MAX];
                    let mut writer = BitWriter::new(&mut bytes);
                    packing.pack(&descriptor, &mut 0, &mut writer).unwrap();
                    longest = longest.max(writer.finish());
                }
            }
        }
        assert!(longest <= PIXEL_BYTES_MAX, "{longest}");
        // Not by chance: counts and gap, 640 bits of indices, 128 escaped numbers of 56 bits.
        assert_eq!(
            longest,
            (45 + 47 + 24 + 7 + 1 + 640 + 128 * 56_usize).div_ceil(8)
        );
    }

    /// Unpacks a pixel at (0, 0) with one ON event whose `fields` (value, bits) follow its counts.
    fn unpack(packing: Packing, fields: &[(u32, u32)]) -> Result<Descriptor, UnpackError> {
        let mut bytes = [0; 64];
        let mut writer = BitWriter::new(&mut bytes);
        writer.put_exp_golomb(0, 0).unwrap();
        writer.put_exp_golomb(0, 0).unwrap();
        writer.put(1, 1).unwrap();
        for (value, bits) in fields {
            writer.put(*value, *bits).unwrap();
        }
        let len = writer.finish();
        packing.unpack(&mut 0, 1, &mut BitReader::new(&bytes[..len]))
    }

    /// Rice codes without plain bits: zigzag 0, 1 and 2.
    const ZERO: (u32, u32) = (0, 1);
    const MINUS_ONE: (u32, u32) = (1, 2);
    const ONE: (u32, u32) = (3, 3);

    #[test]
    fn a_pixel_has_one_encoding() {
        let set = packing(Transform::Dwt, 4, 16, 0);
        let listed = |first: u32, second: u32, level| {
            // A Haar level of 1 moves down to the code of 0.
            let fields = [(2, 3), (0, 1), (first, 4), (second, 4), ZERO, level];
            unpack(set, &fields)
        };
        assert_eq!(
            listed(3, 5, MINUS_ONE).unwrap().levels[..],
            [(3, 1), (5, -1)].map(|(k, re)| Level { k, re, im: 0 })
        );
        let refused = Err(UnpackError::Levels);
        assert_eq!(listed(5, 5, MINUS_ONE), refused, "an index twice");
        assert_eq!(listed(5, 3, MINUS_ONE), refused, "descending indices");
        let complex = packing(Transform::Dtft, 4, 16, 0);
        let fields = [(1, 3), (0, 1), (3, 4), ZERO, ZERO];
        assert_eq!(unpack(complex, &fields), refused, "a level of 0");
        assert_eq!(unpack(set, &[(5, 3), (1, 1)]), refused, "more than M");

        let run = packing(Transform::Dct, 4, 4, 0);
        assert_eq!(unpack(run, &[(3, 3), ZERO, ONE]).unwrap().levels.len(), 2);
        assert_eq!(
            unpack(run, &[(3, 3), ONE, ZERO]),
            refused,
            "a run that ends with 0"
        );
        assert_eq!(
            unpack(run, &[(5, 3), ONE, ONE, ONE, ONE]),
            refused,
            "more than r"
        );
    }
}
