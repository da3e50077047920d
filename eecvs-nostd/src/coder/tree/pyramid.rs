//! Which pixels have events, as a pyramid of bitmaps: level 0 has a bit for each pixel, and each further level one for
//! up to 2 x 2 of the level below, down to a single one.
//!
//! All levels lie in one piece of bytes. A row has eight bytes of zeros before its bits, which are whole words of 64,
//! and each level has a row of zeros above and one below, so that what is around a bit is read without asking whether
//! it exists.

use event_types::Sensor;

/// Most levels of any sensor: sides of up to 4096.
const LEVELS_MAX: usize = 13;
const _: () = assert!(Sensor::SIDE_MAX <= 4096);

/// Bytes of zeros before a row.
pub(super) const MARGIN_BYTES: usize = 8;

/// One level of a pyramid.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Level {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Offset of its first row, and from row to row, in bytes.
    at: usize,
    pub(super) stride: usize,
    /// Number of nodes of the finer levels.
    pub(super) nodes_at: usize,
}

impl Level {
    /// Returns the offset of a row's bytes; -1 is the row above the first.
    #[inline(always)]
    pub(super) const fn row(&self, y: i32) -> usize {
        (self.at as i32 + y * self.stride as i32) as usize
    }

    /// Returns how many words a row has.
    #[inline(always)]
    pub(super) const fn words(&self) -> usize {
        self.width.div_ceil(64) as usize
    }
}

/// The levels of a sensor's pyramid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pyramid {
    levels: [Level; LEVELS_MAX],
    count: usize,
    /// Size in bytes.
    pub(super) bytes: usize,
    /// Number of nodes of all levels.
    pub(super) nodes: usize,
}

impl Pyramid {
    pub(super) const fn new(sensor: Sensor) -> Self {
        const NONE: Level = Level {
            width: 0,
            height: 0,
            at: 0,
            stride: 0,
            nodes_at: 0,
        };
        let mut pyramid = Self {
            levels: [NONE; LEVELS_MAX],
            count: 0,
            bytes: 0,
            nodes: 0,
        };
        let (mut width, mut height) = (sensor.width as u32, sensor.height as u32);
        while pyramid.count < LEVELS_MAX {
            let stride = MARGIN_BYTES + 8 * width.div_ceil(64) as usize;
            pyramid.levels[pyramid.count] = Level {
                width,
                height,
                at: pyramid.bytes + stride,
                stride,
                nodes_at: pyramid.nodes,
            };
            // The row below ends with the margin of a row after it.
            pyramid.bytes += stride * (height as usize + 2) + MARGIN_BYTES;
            pyramid.nodes += (width * height) as usize;
            pyramid.count += 1;
            if width <= 1 && height <= 1 {
                break;
            }
            (width, height) = (width.div_ceil(2), height.div_ceil(2));
        }
        pyramid
    }

    /// Returns the level of the pixels.
    #[inline(always)]
    pub(super) const fn pixels(&self) -> &Level {
        &self.levels[0]
    }

    /// Returns the pairs of a level and the next coarser one, the coarsest first, with the finer one's number.
    pub(super) fn coarse_to_fine(&self) -> impl Iterator<Item = (usize, &Level, &Level)> {
        let levels = self.levels.get(..self.count).unwrap_or_default();
        let pairs = levels.windows(2).enumerate().rev();
        pairs.filter_map(|(k, pair)| Some((k, pair.first()?, pair.get(1)?)))
    }

    /// Sets the only bit of the coarsest level.
    pub(super) fn set_top(&self, bytes: &mut [u8]) {
        if let Some(top) = self.levels.get(self.count.wrapping_sub(1)) {
            set_word(bytes, top.row(0) + MARGIN_BYTES, 1);
        }
    }

    /// Sets the pixels of an encoder's events, and no others, in all levels.
    pub(super) fn set(&self, bytes: &mut [u8], pixels: impl Iterator<Item = (u32, u32)>) {
        let level = self.pixels();
        let whole = level.row(-1)..level.row(level.height as i32 + 1);
        bytes.get_mut(whole).unwrap_or_default().fill(0);
        for (x, y) in pixels {
            let at = level.row(y as i32) + MARGIN_BYTES + (x >> 3) as usize;
            if let Some(byte) = bytes.get_mut(at) {
                *byte |= 1 << (x & 7);
            }
        }
        let levels = self.levels.get(..self.count).unwrap_or_default();
        for pair in levels.windows(2) {
            if let [fine, coarse] = pair {
                set_coarser(bytes, fine, coarse);
            }
        }
    }
}

/// Derives a level from the one below it.
fn set_coarser(bytes: &mut [u8], fine: &Level, coarse: &Level) {
    for y in 0..coarse.height as i32 {
        let rows = [fine.row(2 * y), fine.row(2 * y + 1)];
        for j in 0..coarse.words() {
            let mut word = 0;
            for half in 0..2 {
                let at = MARGIN_BYTES + 8 * (2 * j + half);
                if at < fine.stride {
                    // Below the last row are zeros.
                    let pairs = word_at(bytes, rows[0] + at) | word_at(bytes, rows[1] + at);
                    word |= halved(pairs | pairs >> 1) << (32 * half);
                }
            }
            set_word(bytes, coarse.row(y) + MARGIN_BYTES + 8 * j, word);
        }
    }
}

/// Returns eight bytes as a word; zeros where there are none.
#[inline(always)]
pub(super) fn word_at(bytes: &[u8], at: usize) -> u64 {
    match bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(word) => u64::from_le_bytes(*word),
        None => 0,
    }
}

#[inline(always)]
pub(super) fn set_word(bytes: &mut [u8], at: usize, word: u64) {
    let rest = bytes.get_mut(at..).unwrap_or_default();
    if let Some(place) = rest.first_chunk_mut() {
        *place = word.to_le_bytes();
    }
}

/// The columns that are set in a row.
#[derive(Debug)]
pub(super) struct Columns<'r> {
    /// The words that are left.
    row: &'r [u8],
    /// Columns that are left of the word before [`Self::next_word`].
    todo: u64,
    next_word: u32,
}

impl<'r> Columns<'r> {
    /// Those of row `y` of a level.
    #[inline(always)]
    pub(super) fn of(level: &Level, bytes: &'r [u8], y: u32) -> Self {
        let begin = level.row(y as i32) + MARGIN_BYTES;
        Self {
            row: bytes
                .get(begin..begin + 8 * level.words())
                .unwrap_or_default(),
            todo: 0,
            next_word: 0,
        }
    }
}

impl Iterator for Columns<'_> {
    type Item = u32;

    #[inline(always)]
    fn next(&mut self) -> Option<u32> {
        while self.todo == 0 {
            let (word, rest) = self.row.split_first_chunk()?;
            self.todo = u64::from_le_bytes(*word);
            self.row = rest;
            self.next_word += 1;
        }
        let i = self.todo.trailing_zeros();
        self.todo &= self.todo - 1;
        Some(64 * (self.next_word - 1) + i)
    }
}

/// Returns the bits around column `x` of the row that begins at `row`: bit 0 is column x - 2, bit 3 is x + 1; bits
/// above are further columns.
#[inline(always)]
pub(super) fn near(bytes: &[u8], row: usize, x: u32) -> u32 {
    let bit = 62 + x;
    let at = row + (bit >> 3) as usize;
    match bytes.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(two) => u32::from(u16::from_le_bytes(*two)) >> (bit & 7),
        None => 0,
    }
}

/// Returns each of 32 bits twice.
#[inline(always)]
pub(super) const fn doubled(bits: u32) -> u64 {
    let mut v = bits as u64;
    v = (v | v << 16) & 0x0000_FFFF_0000_FFFF;
    v = (v | v << 8) & 0x00FF_00FF_00FF_00FF;
    v = (v | v << 4) & 0x0F0F_0F0F_0F0F_0F0F;
    v = (v | v << 2) & 0x3333_3333_3333_3333;
    v = (v | v << 1) & 0x5555_5555_5555_5555;
    v | v << 1
}

/// Returns the even bits of a word, side by side.
#[inline(always)]
pub(super) const fn halved(word: u64) -> u64 {
    let mut v = word & 0x5555_5555_5555_5555;
    v = (v | v >> 1) & 0x3333_3333_3333_3333;
    v = (v | v >> 2) & 0x0F0F_0F0F_0F0F_0F0F;
    v = (v | v >> 4) & 0x00FF_00FF_00FF_00FF;
    v = (v | v >> 8) & 0x0000_FFFF_0000_FFFF;
    (v | v >> 16) & 0xFFFF_FFFF
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::{vec, vec::Vec};

    proptest! {
        #[test]
        fn doubling_is_undone_by_halving(bits: u32) {
            prop_assert_eq!(halved(doubled(bits)), u64::from(bits));
            prop_assert_eq!(halved(doubled(bits) >> 1), u64::from(bits));
        }

        /// A node is set exactly if one of its four is.
        #[test]
        fn levels_follow_from_the_pixels(
            width in 1_u16..150, height in 1_u16..40,
            pixels in proptest::collection::vec((any::<u16>(), any::<u16>()), 0..30),
        ) {
            let sensor = Sensor::new(width, height).unwrap();
            let pyramid = Pyramid::new(sensor);
            let pixels: Vec<_> = pixels
                .iter()
                .map(|(x, y)| (u32::from(x % width), u32::from(y % height)))
                .collect();
            let mut bytes = vec![0; pyramid.bytes];
            pyramid.set(&mut bytes, [(0, 0)].into_iter());
            pyramid.set(&mut bytes, pixels.iter().copied());
            for (k, level) in pyramid.levels[..pyramid.count].iter().enumerate() {
                for y in -1..=level.height as i32 {
                    for x in 0..level.stride as u32 * 8 - 64 {
                        let is_set = pixels.iter().any(|(px, py)| (px >> k, (py >> k) as i32) == (x, y));
                        prop_assert_eq!(near(&bytes, level.row(y), x) >> 2 & 1 == 1, is_set);
                    }
                }
            }
        }
    }
}
