//! Unpacks chunks of HDF5 files packed by Blosc 2 (filter 32026): a frame of one or more buffers, or a single
//! buffer without a frame.
//!
//! The numbers of a frame are big-endian (README_CFRAME_FORMAT.rst of c-blosc2):
//!
//! | byte | content |
//! |---|---|
//! | 2 | `b2frame` and 0 |
//! | 11 | u32: header size in bytes; the buffers follow the header |
//! | 25 | flags; bits 6 and 7: buffers or blocks of variable length |
//! | 26 | bits 0 to 3: kind of frame (0: all in one piece) |
//! | 30, 39 | u64: unpacked size, size of the buffers, in bytes |
//! | 48, 58 | u32: element size, unpacked size of a buffer, in bytes |
//! | 87 | named metadata: `b2nd` if the data has several dimensions |
//!
//! An index buffer follows the data buffers. It has a little-endian i64 for each of them: its offset from the end
//! of the header or, if negative, the kind of value that fills the buffer, in bits 56 to 62.
//!
//! The numbers of a buffer are little-endian (README_CHUNK_FORMAT.rst). A buffer begins as in Blosc 1
//! ([`super::blosc`]); if bits 0 and 2 of byte 2 are both set, another 16 bytes of header follow:
//!
//! | byte | content |
//! |---|---|
//! | 16, 24 | six filters, in the order in which they were applied, and a value for each (see below) |
//! | 31, bits 0, 3, 7 | has a dictionary; is only a part; has no data |
//! | 31, bits 4 to 6 | kind of value that fills the buffer: 1 zeros, 2 NaN, 3 the value that follows, 4 undefined |
//!
//! The filters are 0 none, 1 byte shuffle (value: element size), 2 bit shuffle, 3 differences, 4 truncated
//! precision.
//!
//! Blocks are as in Blosc 1, except that bit 4 of byte 2 alone decides whether they are split; a shorter last block
//! never is. A stream of size 0 is all zeros; a stream of size -n, followed by a byte with bit 0 set, consists of
//! bytes n.

use super::blosc;
use super::shuffle::{unshuffle_bits, unshuffle_bytes};

const FRAME: &[u8; 8] = b"b2frame\0";
const FRAME_AT: usize = 2;

/// Flags of a frame whose buffers or blocks vary in length.
const ANY_LENGTH: u8 = 0xc0;

// Kinds of value that fill a buffer.
const ZEROS: u8 = 1;
const NANS: u8 = 2;
const VALUE: u8 = 3;
const ANYTHING: u8 = 4;

const HEADER_BYTES: usize = 16;
const EXTENDED_BYTES: usize = 32;
const FILTERS: usize = 6;

/// Latest buffer format that is supported.
const VERSION: u8 = 5;

/// Up to this format, Blosc 1's last, the bits of a block are not shuffled if its number of elements is not a
/// multiple of 8.
const VERSION_1: u8 = 2;

const BYTES_SHUFFLED: u8 = 1;
const STORED: u8 = 2;
const BITS_SHUFFLED: u8 = 4;
const DIFFERENCES: u8 = 8;
const NOT_SPLIT: u8 = 0x10;

const DAMAGED: &str = "damaged Blosc 2 data";

/// Largest number of dimensions of an array.
const DIMENSIONS_MAX: usize = 8;

/// Unpacks a frame or a buffer whose unpacked size is at most `most` bytes.
///
/// # Errors
/// The data is damaged, larger than `most`, or of a kind that is not supported.
pub fn unpack(packed: &[u8], most: usize) -> Result<Vec<u8>, String> {
    if packed
        .get(FRAME_AT..)
        .is_some_and(|rest| rest.starts_with(FRAME))
    {
        frame(packed, most)
    } else {
        buffer(packed, most)
    }
}

fn small(bytes: &[u8], at: usize) -> Result<usize, String> {
    let four = bytes
        .get(at..)
        .and_then(<[u8]>::first_chunk)
        .ok_or(DAMAGED)?;
    usize::try_from(u32::from_be_bytes(*four)).map_err(|error| error.to_string())
}

fn large(bytes: &[u8], at: usize) -> Result<usize, String> {
    let eight = bytes
        .get(at..)
        .and_then(<[u8]>::first_chunk)
        .ok_or(DAMAGED)?;
    usize::try_from(u64::from_be_bytes(*eight)).map_err(|_| DAMAGED.to_owned())
}

fn frame(packed: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let (header, buffers) = (small(packed, 11)?, large(packed, 39)?);
    let [size, element, each] = [large(packed, 30)?, small(packed, 48)?, small(packed, 58)?];
    let &[flags, kind] = packed
        .get(25..)
        .and_then(<[u8]>::first_chunk)
        .ok_or(DAMAGED)?;
    if flags & ANY_LENGTH != 0 || kind & 15 != 0 {
        return Err(
            "a Blosc 2 frame in several files or with buffers of variable length is not supported"
                .to_owned(),
        );
    }
    if size > most {
        return Err(format!("a Blosc 2 frame of {size} bytes, above {most}"));
    }
    if size == 0 {
        return Ok(Vec::new());
    }
    let count = size.div_ceil(each.max(1));
    if each == 0 || count > most / 8 {
        return Err(DAMAGED.to_owned());
    }
    let rest = packed.get(header..).ok_or(DAMAGED)?;
    let index = buffer(rest.get(buffers..).ok_or(DAMAGED)?, 8 * count)?;
    let (places, _) = index.as_chunks::<8>();
    if places.len() != count {
        return Err(DAMAGED.to_owned());
    }
    let mut out = Vec::with_capacity(size);
    for place in places {
        let place = i64::from_le_bytes(*place);
        let bytes = each.min(size - out.len());
        let part = match usize::try_from(place) {
            Ok(place) => buffer(rest.get(place..).ok_or(DAMAGED)?, bytes)?,
            Err(_) => full(place.to_be_bytes()[0] & 0x7f, &[], element, bytes)?,
        };
        if part.len() != bytes {
            return Err(DAMAGED.to_owned());
        }
        out.extend(part);
    }
    match Array::of(packed)? {
        Some(array) => array.in_rows(&out, element),
        None => Ok(out),
    }
}

/// Returns `bytes` bytes filled with one value of this kind; `rest` follows the buffer's header and begins with the
/// value, if the kind is [`VALUE`].
fn full(kind: u8, rest: &[u8], element: usize, bytes: usize) -> Result<Vec<u8>, String> {
    let value = match (kind, element) {
        // Elements that were never written are read as zeros, as elsewhere in HDF5 files.
        (ZEROS | ANYTHING, _) => return Ok(vec![0; bytes]),
        (NANS, 4) => &f32::NAN.to_le_bytes()[..],
        (NANS, 8) => &f64::NAN.to_le_bytes(),
        (VALUE, 1..) => rest.get(..element).ok_or(DAMAGED)?,
        _ => return Err(DAMAGED.to_owned()),
    };
    let mut out = value.repeat(bytes / element);
    out.resize(bytes, 0);
    Ok(out)
}

/// A buffer being unpacked.
struct Buffer<'a> {
    packed: &'a [u8],
    version: u8,
    flags: u8,
    element: usize,
    size: usize,
    block: usize,
    header: usize,
    /// The filters and their values.
    filters: [(u8, u8); FILTERS],
}

fn buffer(packed: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let &[version, _, flags, element, ..] = packed.first_chunk::<HEADER_BYTES>().ok_or(DAMAGED)?;
    let [size, block, all] = [4, 8, 12].map(|at| blosc::number(packed, at));
    let (size, block, all) = (size?, block?, all?);
    if version > VERSION {
        return Err(format!(
            "a Blosc 2 buffer of format {version}, which is not supported"
        ));
    }
    if version == 0 {
        return Err(DAMAGED.to_owned());
    }
    if size > most {
        return Err(format!("a Blosc 2 buffer of {size} bytes, above {most}"));
    }
    let packed = packed.get(..all).ok_or(DAMAGED)?;
    let mut buffer = Buffer {
        packed,
        version,
        flags,
        element: usize::from(element),
        size,
        block,
        header: HEADER_BYTES,
        filters: [(0, 0); FILTERS],
    };
    if flags & (BYTES_SHUFFLED | BITS_SHUFFLED) == BYTES_SHUFFLED | BITS_SHUFFLED {
        let header = packed.first_chunk::<EXTENDED_BYTES>().ok_or(DAMAGED)?;
        let more = header[EXTENDED_BYTES - 1];
        buffer.header = EXTENDED_BYTES;
        let kind = more >> 4 & 7;
        if more & 0x89 != 0 {
            return Err(
                "a Blosc 2 buffer with a dictionary or without data is not supported".to_owned(),
            );
        }
        if kind != 0 {
            let rest = packed.get(EXTENDED_BYTES..).ok_or(DAMAGED)?;
            return full(kind, rest, buffer.element, size);
        }
        let filters = header[16..].iter().zip(&header[24..]);
        for (place, (filter, value)) in buffer.filters.iter_mut().zip(filters) {
            *place = (*filter, *value);
        }
    } else {
        // The last two filters, in the order in which Blosc 1 applied them.
        buffer.filters[4] = (if flags & DIFFERENCES != 0 { 3 } else { 0 }, 0);
        buffer.filters[5] = match flags {
            _ if flags & BYTES_SHUFFLED != 0 => (1, 0),
            _ if flags & BITS_SHUFFLED != 0 => (2, 0),
            _ => (0, 0),
        };
    }
    buffer.unpack()
}

impl Buffer<'_> {
    fn unpack(&self) -> Result<Vec<u8>, String> {
        if self.flags & STORED != 0 {
            let stored = self.packed.get(self.header..).ok_or(DAMAGED)?;
            return Ok(stored.get(..self.size).ok_or(DAMAGED)?.to_vec());
        }
        if self.size == 0 {
            return Ok(Vec::new());
        }
        if self.element == 0 || self.block == 0 {
            return Err(DAMAGED.to_owned());
        }
        // Checked before memory is allocated: every block has an offset of 4 bytes.
        let blocks = self.size.div_ceil(self.block);
        if blocks > (self.packed.len() - self.header) / 4 {
            return Err(DAMAGED.to_owned());
        }
        let mut out = vec![0; self.size];
        let each = self.block.min(self.size);
        let (mut block, mut other) = (vec![0; each], vec![0; each]);
        for index in 0..blocks {
            let start = index * self.block;
            let bytes = self.block.min(self.size - start);
            let (block, other) = (
                block.get_mut(..bytes).ok_or(DAMAGED)?,
                other.get_mut(..bytes).ok_or(DAMAGED)?,
            );
            let place = blosc::number(self.packed, self.header + 4 * index)?;
            let streams = self.packed.get(place..).ok_or(DAMAGED)?;
            self.unpack_block(streams, block)?;
            let (before, to) = out.split_at_mut_checked(start).ok_or(DAMAGED)?;
            let to = to.get_mut(..bytes).ok_or(DAMAGED)?;
            self.undo_filters(block, other, before)?;
            to.copy_from_slice(block);
        }
        Ok(out)
    }

    /// Unpacks the streams of a block.
    fn unpack_block(&self, mut packed: &[u8], block: &mut [u8]) -> Result<(), String> {
        let is_split = self.flags & NOT_SPLIT == 0 && block.len() == self.block;
        let each = if is_split {
            block.len() / self.element
        } else {
            block.len()
        };
        if each == 0 || !block.len().is_multiple_of(each) {
            return Err(DAMAGED.to_owned());
        }
        for to in block.chunks_exact_mut(each) {
            let (length, rest) = packed.split_first_chunk().ok_or(DAMAGED)?;
            let length = i32::from_le_bytes(*length);
            packed = match usize::try_from(length) {
                Ok(0) => {
                    to.fill(0);
                    rest
                }
                Ok(length) => {
                    let (stream, behind) = rest.split_at_checked(length).ok_or(DAMAGED)?;
                    if length == each {
                        to.copy_from_slice(stream);
                    } else {
                        blosc::unpack_stream(stream, to, self.flags >> 5)?;
                    }
                    behind
                }
                Err(_) => {
                    let value = u8::try_from(length.unsigned_abs()).map_err(|_| DAMAGED)?;
                    let (token, behind) = rest.split_first().ok_or(DAMAGED)?;
                    if token & 1 == 0 {
                        return Err(DAMAGED.to_owned());
                    }
                    to.fill(value);
                    behind
                }
            };
        }
        Ok(())
    }

    /// Undoes the filters of `block`, the last one first; `before` holds the blocks of the buffer unpacked so far.
    fn undo_filters(
        &self,
        block: &mut [u8],
        other: &mut [u8],
        before: &[u8],
    ) -> Result<(), String> {
        for (filter, value) in self.filters.into_iter().rev() {
            match filter {
                // Truncated bits are zeros.
                0 | 4 => {}
                1 => {
                    let element = if value == 0 {
                        self.element
                    } else {
                        usize::from(value)
                    };
                    unshuffle_bytes(block, element, other);
                    block.copy_from_slice(other);
                }
                2 => {
                    let count = block.len() / self.element;
                    if self.version > VERSION_1 || count.is_multiple_of(8) {
                        unshuffle_bits(block, self.element, other);
                        block.copy_from_slice(other);
                    }
                }
                3 => add_differences(block, before, self.element),
                other => {
                    return Err(format!(
                        "a Blosc 2 buffer with filter {other}, which is not supported"
                    ));
                }
            }
        }
        Ok(())
    }
}

/// Undoes the differences, which are exclusive ors: in the first block with the previous element, in later blocks
/// with the first block. Bytes after the last whole element are unchanged.
fn add_differences(block: &mut [u8], before: &[u8], element: usize) {
    let element = match element {
        1 | 2 | 4 | 8 => element,
        element if element.is_multiple_of(8) => 8,
        _ => 1,
    };
    let whole = block.len() / element * element;
    if before.is_empty() {
        for at in element..whole {
            let Some(last) = block.get(at - element).copied() else {
                return;
            };
            if let Some(byte) = block.get_mut(at) {
                *byte ^= last;
            }
        }
    } else {
        for (byte, first) in block.iter_mut().take(whole).zip(before) {
            *byte ^= first;
        }
    }
}

/// The `b2nd` layout of an array of several dimensions: one buffer, stored block by block.
struct Array {
    shape: Vec<usize>,
    /// Shape of the buffer, rounded up to whole blocks, and of a block.
    whole: Vec<usize>,
    block: Vec<usize>,
}

impl Array {
    /// Reads the layout from a frame's header; `None` if the frame has none.
    fn of(frame: &[u8]) -> Result<Option<Self>, String> {
        let mut rest = Msgpack(frame.get(91..).ok_or(DAMAGED)?);
        let count = rest.counted(0xde)?;
        let mut found = None;
        for _ in 0..count {
            let length = rest.byte()? & 31;
            let name = rest.take(usize::from(length))?;
            let place = rest.number()?;
            if name == b"b2nd" {
                found = Some(place);
            }
        }
        let Some(place) = found else {
            return Ok(None);
        };
        // The offset leads to the mark and length of a byte string.
        let start = place.checked_add(5).ok_or(DAMAGED)?;
        let mut rest = Msgpack(frame.get(start..).ok_or(DAMAGED)?);
        let _ = (rest.byte()?, rest.byte()?);
        let dimensions = usize::from(rest.byte()?);
        if dimensions > DIMENSIONS_MAX {
            return Err(DAMAGED.to_owned());
        }
        let mut sides = || -> Result<Vec<usize>, String> {
            let _ = rest.byte()?;
            (0..dimensions).map(|_| rest.number()).collect()
        };
        let (shape, chunk, block) = (sides()?, sides()?, sides()?);
        if shape.iter().zip(&chunk).any(|(side, chunk)| side > chunk) {
            return Err("a Blosc 2 array of several buffers is not supported".to_owned());
        }
        let whole = chunk.iter().zip(&block).map(|(chunk, block)| {
            let count = chunk.checked_add(block.checked_sub(1)?)? / block;
            count.checked_mul(*block)
        });
        let whole = whole.collect::<Option<Vec<_>>>().ok_or(DAMAGED)?;
        Ok(Some(Self {
            shape,
            whole,
            block,
        }))
    }

    /// Returns the array's elements in row order; in `blocks` the blocks follow one another.
    fn in_rows(&self, blocks: &[u8], element: usize) -> Result<Vec<u8>, String> {
        let product = |sides: &[usize]| {
            let mut sides = sides.iter();
            sides.try_fold(element, |all, side| all.checked_mul(*side))
        };
        let (Some(all), Some(bytes), Some(block), Some(last)) = (
            product(&self.whole),
            product(&self.shape),
            product(&self.block),
            self.block.last(),
        ) else {
            return Err(DAMAGED.to_owned());
        };
        // No side of a block may be 0.
        if all != blocks.len() || bytes > all || block == 0 {
            return Err(DAMAGED.to_owned());
        }
        if self.shape == self.block {
            return Ok(blocks.to_vec());
        }
        let mut out = vec![0; bytes];
        let grid: Vec<usize> = self
            .whole
            .iter()
            .zip(&self.block)
            .map(|(a, b)| a / b)
            .collect();
        // A row here is a run of elements along the last dimension of a block.
        for (index, row) in blocks.chunks_exact(last * element).enumerate() {
            let (mut of_block, mut of_row) = (index / (block / (last * element)), index);
            let (mut place, mut step, mut width) = (0, element, 0);
            for dimension in (0..self.shape.len()).rev() {
                let is_last = dimension + 1 == self.shape.len();
                let (side, inner) = (self.shape[dimension], self.block[dimension]);
                let mut at = of_block % grid[dimension] * inner;
                of_block /= grid[dimension];
                if is_last {
                    width = side.saturating_sub(at).min(inner);
                } else {
                    at += of_row % inner;
                    of_row /= inner;
                    if at >= side {
                        width = 0;
                    }
                }
                place += at * step;
                step *= side;
            }
            if width > 0 {
                let to = out
                    .get_mut(place..)
                    .and_then(|out| out.get_mut(..width * element));
                let from = row.get(..width * element);
                to.ok_or(DAMAGED)?.copy_from_slice(from.ok_or(DAMAGED)?);
            }
        }
        Ok(out)
    }
}

/// A reader of the few kinds of msgpack values in a frame's header.
struct Msgpack<'a>(&'a [u8]);

impl<'a> Msgpack<'a> {
    fn byte(&mut self) -> Result<u8, String> {
        let (byte, rest) = self.0.split_first().ok_or(DAMAGED)?;
        self.0 = rest;
        Ok(*byte)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(DAMAGED)?;
        self.0 = rest;
        Ok(taken)
    }

    /// Reads a 16-bit count after this mark.
    fn counted(&mut self, mark: u8) -> Result<u16, String> {
        let is_so = self.byte()? == mark;
        let bytes = self.take(2)?.first_chunk().ok_or(DAMAGED)?;
        is_so
            .then_some(u16::from_be_bytes(*bytes))
            .ok_or_else(|| DAMAGED.to_owned())
    }

    /// Reads a non-negative number of 4 or 8 bytes.
    fn number(&mut self) -> Result<usize, String> {
        match self.byte()? {
            0xd2 => small(self.take(4)?, 0),
            0xd3 => large(self.take(8)?, 0),
            _ => Err(DAMAGED.to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: usize = 1 << 16;

    /// Returns a buffer of format 5 with a header of 32 bytes.
    fn extended(flags: u8, element: u8, lengths: [u32; 3], kind: u8, rest: &[u8]) -> Vec<u8> {
        let mut bytes = vec![VERSION, 1, flags | 5, element];
        bytes.extend(lengths.map(u32::to_le_bytes).concat());
        bytes.extend([0; 15]);
        bytes.push(kind << 4);
        bytes.extend(rest);
        bytes
    }

    #[test]
    fn buffers_full_of_one_value() {
        let of = |kind, element, size, rest: &[u8]| {
            let all = 32 + rest.len() as u32;
            unpack(
                &extended(STORED, element, [size, size, all], kind, rest),
                MOST,
            )
        };
        assert_eq!(of(ZEROS, 4, 8, &[]), Ok(vec![0; 8]));
        assert_eq!(of(ANYTHING, 4, 8, &[]), Ok(vec![0; 8]));
        let nans = f64::NAN.to_le_bytes().repeat(2);
        assert_eq!(of(NANS, 8, 16, &[]), Ok(nans));
        assert_eq!(of(VALUE, 2, 6, b"ab"), Ok(b"ababab".to_vec()));
        assert!(of(NANS, 2, 6, &[]).is_err());
        assert!(of(VALUE, 2, 6, b"a").is_err());
        assert!(of(VALUE, 0, 6, b"a").is_err());
        assert!(of(5, 2, 6, b"ab").is_err());
    }

    #[test]
    fn streams_of_one_byte() {
        // Two elements of two bytes, with one stream for each byte: zeros, and 7s.
        let streams = [
            &36_u32.to_le_bytes()[..],
            &[0; 4],
            &(-7_i32).to_le_bytes(),
            &[1],
        ]
        .concat();
        let all = 32 + streams.len() as u32;
        let mut bytes = extended(1 << 5, 2, [4, 4, all], 0, &streams);
        assert_eq!(unpack(&bytes, MOST), Ok(vec![0, 0, 7, 7]));
        // The same with shuffled bytes.
        bytes[21] = 1;
        assert_eq!(unpack(&bytes, MOST), Ok(vec![0, 7, 0, 7]));
        // An unknown filter and an unknown token.
        bytes[21] = 35;
        assert!(unpack(&bytes, MOST).is_err_and(|what| what.contains("filter 35")));
        bytes[21] = 0;
        bytes[44] = 2;
        assert!(unpack(&bytes, MOST).is_err());
    }

    #[test]
    fn arrays_of_blocks_go_to_rows() {
        // 3 x 5 elements in blocks of 2 x 2, some of which extend beyond the array.
        let array = Array {
            shape: vec![3, 5],
            whole: vec![4, 6],
            block: vec![2, 2],
        };
        let mut blocks = Vec::new();
        for block in 0..6_u8 {
            for inner in 0..4_u8 {
                let (row, column) = (block / 3 * 2 + inner / 2, block % 3 * 2 + inner % 2);
                blocks.push(if row < 3 && column < 5 {
                    row * 5 + column
                } else {
                    99
                });
            }
        }
        let want: Vec<u8> = (0..15).collect();
        assert_eq!(array.in_rows(&blocks, 1), Ok(want));
        assert!(array.in_rows(&blocks[1..], 1).is_err());
    }

    #[test]
    fn what_is_claimed_is_not_believed() {
        for bytes in [
            extended(0, 8, [MOST as u32, 1, 32], 0, &[]),
            extended(0, 8, [MOST as u32 + 1, 1, 32], 0, &[]),
            extended(0, 0, [64, 64, 40], 0, &[0; 8]),
            extended(0, 8, [64, 0, 40], 0, &[0; 8]),
            extended(STORED, 8, [64, 64, 40], 0, &[0; 8]),
            extended(0, 8, [64, 64, 40], 0, &[0xff; 8]),
            extended(0, 8, [64, 64, 40], 8, &[0; 8]),
            [&[6], &extended(0, 8, [64, 64, 40], 0, &[0; 8])[1..]].concat(),
            b"\x9e\xa8b2frame\0".to_vec(),
        ] {
            assert!(unpack(&bytes, MOST).is_err(), "{bytes:?}");
        }
    }

    /// Real frames with each byte changed in several ways, or cut to each length, give an error or at most the
    /// permitted number of bytes.
    #[test]
    fn damage_anywhere() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/seeds/read_hdf5");
        for name in ["blosclz", "lz4", "zlib", "zstd", "bits", "delta", "table"] {
            let path = format!("{folder}/blosc2_{name}.h5");
            let file = std::fs::read(path).expect("a seed of the fuzz targets");
            let is_frame = |at: &usize| file[*at..].starts_with(b"\x9e\xa8b2frame\0");
            let starts: Vec<usize> = (0..file.len()).filter(is_frame).collect();
            assert!(!starts.is_empty());
            for start in starts {
                let length = large(&file, start + 16).expect("a length");
                let good = &file[start..start + length];
                assert!(unpack(good, MOST).is_ok_and(|unpacked| !unpacked.is_empty()));
                for at in 0..good.len() {
                    for flip in [0xff, 0x80, 1 << (at % 8)] {
                        let mut bad = good.to_vec();
                        bad[at] ^= flip;
                        if let Ok(unpacked) = unpack(&bad, MOST) {
                            assert!(unpacked.len() <= MOST);
                        }
                    }
                    if let Ok(unpacked) = unpack(&good[..at], MOST) {
                        assert!(unpacked.len() <= MOST);
                    }
                }
            }
        }
    }
}
