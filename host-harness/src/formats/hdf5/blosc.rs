//! Buffers packed by Blosc 1, as chunks of DSEC's HDF5 files are.
//!
//! All numbers are little-endian (README_CHUNK_FORMAT.rst of c-blosc 1.21):
//!
//! | byte | what |
//! |---|---|
//! | 0, 1 | version of the format (2; blosc2 has more), of the codec's format |
//! | 2 | bit 0 bytes shuffled, 1 stored, 2 bits shuffled, 4 blocks not split; 5 to 7 the codec: 0 blosclz, 1 LZ4, 2 Snappy, 3 zlib, 4 Zstandard |
//! | 3 | bytes of an element |
//! | 4, 8, 12 | u32: bytes unpacked, bytes of a block, bytes of all this |
//! | 16 | u32 for every block: where it begins |
//!
//! A block is one stream, or as many as an element has bytes (at most 16, of at least 128 bytes each, and
//! never in a shorter last block): i32 bytes, and these; as many as unpacked are stored. Bits of a block
//! whose number of elements is no multiple of 8 are not shuffled.

use super::copies;
use crate::formats::unpack;

const HEADER_BYTES: usize = 16;

const BYTES_SHUFFLED: u8 = 1;
const STORED: u8 = 2;
const BITS_SHUFFLED: u8 = 4;
const NOT_SPLIT: u8 = 0x10;

/// Format of Blosc 1; later ones are Blosc 2's.
const VERSION: u8 = 2;

/// Most streams of a block, and fewest bytes of one of several.
const STREAMS_MAX: usize = 16;
const STREAM_BYTES_MIN: usize = 128;

const DAMAGED: &str = "damaged Blosc buffer";

/// Unpacks a buffer of at most `most` bytes.
///
/// # Errors
/// A damaged buffer, one of Blosc 2 or of a codec that is not known, one that is larger.
pub fn unpack(packed: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let header: &[u8; HEADER_BYTES] = packed.first_chunk().ok_or(DAMAGED)?;
    let [version, _, flags, element, ..] = *header;
    let element = usize::from(element);
    let [size, block, all] = [number(packed, 4)?, number(packed, 8)?, number(packed, 12)?];
    if version > VERSION {
        return Err(format!(
            "a Blosc buffer of format {version}, which is Blosc 2's"
        ));
    }
    if version == 0 {
        return Err(DAMAGED.to_owned());
    }
    if size > most {
        return Err(format!("a Blosc buffer of {size} bytes, above {most}"));
    }
    let packed = packed.get(..all).ok_or(DAMAGED)?;
    if flags & STORED != 0 {
        let stored = packed.get(HEADER_BYTES..).ok_or(DAMAGED)?;
        let stored = stored.get(..size).ok_or(DAMAGED)?;
        return Ok(stored.to_vec());
    }
    if size == 0 {
        return Ok(Vec::new());
    }
    if element == 0 || block == 0 {
        return Err(DAMAGED.to_owned());
    }
    // Before memory is asked for: every block has its place in the list and bytes of its own.
    if size.div_ceil(block) > packed.len() / 8 {
        return Err(DAMAGED.to_owned());
    }
    let mut out = Vec::with_capacity(size);
    for index in 0..size.div_ceil(block) {
        let start = number(packed, HEADER_BYTES + 4 * index)?;
        let stream = packed.get(start..).ok_or(DAMAGED)?;
        let bytes = block.min(size - out.len());
        let unpacked = unpack_block(stream, bytes, bytes < block, flags, element)?;
        if flags & BITS_SHUFFLED != 0 {
            out.extend(unshuffle_bits(&unpacked, element));
        } else if flags & BYTES_SHUFFLED != 0 && element > 1 {
            out.extend(unshuffle_bytes(&unpacked, element));
        } else {
            out.extend(unpacked);
        }
    }
    Ok(out)
}

fn number(bytes: &[u8], at: usize) -> Result<usize, String> {
    let four = bytes.get(at..).and_then(<[u8]>::first_chunk);
    let four = four.ok_or(DAMAGED)?;
    usize::try_from(u32::from_le_bytes(*four)).map_err(|error| error.to_string())
}

/// The streams of a block, one behind the other.
fn unpack_block(
    mut packed: &[u8],
    bytes: usize,
    is_short: bool,
    flags: u8,
    element: usize,
) -> Result<Vec<u8>, String> {
    let is_split = flags & NOT_SPLIT == 0
        && element <= STREAMS_MAX
        && bytes / element >= STREAM_BYTES_MIN
        && !is_short;
    let streams = if is_split { element } else { 1 };
    let each = bytes / streams;
    let mut out = Vec::with_capacity(bytes);
    for _ in 0..streams {
        let length = number(packed, 0)?;
        let rest = packed.get(4..).ok_or(DAMAGED)?;
        let (stream, behind) = rest.split_at_checked(length).ok_or(DAMAGED)?;
        if length == each {
            out.extend_from_slice(stream);
        } else {
            out.extend(unpack_stream(stream, each, flags >> 5)?);
        }
        packed = behind;
    }
    if out.len() == bytes {
        Ok(out)
    } else {
        Err(DAMAGED.to_owned())
    }
}

fn unpack_stream(packed: &[u8], size: usize, codec: u8) -> Result<Vec<u8>, String> {
    let unpacked = match codec {
        0 => copies::blosclz(packed, size),
        1 => lz4_flex::block::decompress(packed, size).ok(),
        2 => unpack::snappy(packed, size),
        3 => unpack::stream(flate2::read::ZlibDecoder::new(packed), size),
        4 => unpack::zstandard(packed, size),
        other => return Err(format!("a Blosc buffer packed by codec {other}")),
    };
    let unpacked = unpacked.filter(|unpacked| unpacked.len() == size);
    unpacked.ok_or_else(|| DAMAGED.to_owned())
}

/// Puts the bytes of elements together again that stand in a plane for each; what is left stays behind.
fn unshuffle_bytes(shuffled: &[u8], element: usize) -> Vec<u8> {
    let count = shuffled.len() / element;
    let whole = count * element;
    let mut out = shuffled.to_vec();
    if count == 0 {
        return out;
    }
    let planes = shuffled.get(..whole).unwrap_or_default();
    for (byte, plane) in planes.chunks_exact(count).enumerate() {
        let places = out.get_mut(..whole).unwrap_or_default();
        let places = places.iter_mut().skip(byte).step_by(element);
        for (to, from) in places.zip(plane) {
            *to = *from;
        }
    }
    out
}

/// As [`unshuffle_bytes`] for bits: a plane for bit 0 of byte 0, for bit 1 and so on; the bits of elements
/// 0 to 7 are in its first byte, the lowest first.
fn unshuffle_bits(shuffled: &[u8], element: usize) -> Vec<u8> {
    let count = shuffled.len() / element;
    if !count.is_multiple_of(8) || count == 0 {
        return shuffled.to_vec();
    }
    let whole = count * element;
    let mut out = shuffled.to_vec();
    let (Some(planes), Some(elements)) = (shuffled.get(..whole), out.get_mut(..whole)) else {
        return out;
    };
    elements.fill(0);
    for (index, plane) in planes.chunks_exact(count / 8).enumerate() {
        let (byte, bit) = (index / 8, index % 8);
        for (eight, bits) in elements.chunks_exact_mut(8 * element).zip(plane) {
            let places = eight.iter_mut().skip(byte).step_by(element);
            for (i, place) in places.enumerate() {
                *place |= (bits >> i & 1) << bit;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(flags: u8, element: u8, size: u32, block: u32, all: u32) -> Vec<u8> {
        let mut bytes = vec![2, 1, flags, element];
        bytes.extend([size, block, all].map(u32::to_le_bytes).concat());
        bytes
    }

    #[test]
    fn stored_buffers() {
        let bytes = [header(STORED, 2, 4, 4, 20), b"abcd".to_vec()].concat();
        assert_eq!(unpack(&bytes, 4), Ok(b"abcd".to_vec()));
        assert!(unpack(&bytes, 3).is_err());
        assert!(unpack(&bytes[..19], 4).is_err());
    }

    #[test]
    fn bytes_and_bits_go_back() {
        assert_eq!(unshuffle_bytes(b"acebdf!", 2), b"abcdef!");
        let elements: Vec<u8> = (0..32).map(|i: u8| i.wrapping_mul(37)).collect();
        let mut planes = vec![0; 32];
        // 16 elements of 2 bytes.
        for (i, pair) in elements.chunks(2).enumerate() {
            for bit in 0..16 {
                let set = pair[bit / 8] >> (bit % 8) & 1;
                planes[bit * 2 + i / 8] |= set << (i % 8);
            }
        }
        assert_eq!(unshuffle_bits(&planes, 2), elements);
    }

    #[test]
    fn what_is_claimed_is_not_believed() {
        for bytes in [
            header(0, 8, 1 << 30, 8, 16),
            header(0, 0, 64, 64, 16),
            header(0, 8, 64, 0, 16),
            header(2, 8, 64, 64, 16),
            vec![2, 1, 0],
            vec![5; 40],
        ] {
            assert!(unpack(&bytes, 1 << 30).is_err(), "{bytes:?}");
        }
    }
}
