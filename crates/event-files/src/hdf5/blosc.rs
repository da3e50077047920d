//! Unpacks buffers packed by Blosc 1, such as the chunks of DSEC's HDF5 files.
//!
//! All numbers are little-endian (README_CHUNK_FORMAT.rst of c-blosc 1.21):
//!
//! | byte | content |
//! |---|---|
//! | 0, 1 | version of the buffer format (2; [`super::blosc2`] handles later ones), version of the codec's format |
//! | 2, bits 0 to 4 | bit 0 bytes shuffled, 1 stored, 2 bits shuffled, 4 blocks not split |
//! | 2, bits 5 to 7 | codec: 0 blosclz, 1 LZ4, 2 Snappy, 3 zlib, 4 Zstandard |
//! | 3 | element size in bytes |
//! | 4, 8, 12 | u32: unpacked size, block size, size of the whole buffer, in bytes |
//! | 16 | u32 for each block: its offset in the buffer |
//!
//! A block is one stream, or one stream for each byte of an element (at most 16 streams, of at least 128 bytes
//! each; a shorter last block is never split). A stream is its packed size (i32) followed by that number of bytes;
//! it is stored if the packed size equals the unpacked size. The bits of a block are not shuffled if its number of
//! elements is not a multiple of 8.

use super::shuffle::{unshuffle_bits, unshuffle_bytes};
use super::{blosc2, copies};
use crate::unpack;

const HEADER_BYTES: usize = 16;

const BYTES_SHUFFLED: u8 = 1;
const STORED: u8 = 2;
const BITS_SHUFFLED: u8 = 4;
const NOT_SPLIT: u8 = 0x10;

/// Format version of Blosc 1; later versions are Blosc 2's.
const VERSION: u8 = 2;

/// Largest number of streams in a block, and smallest size in bytes of a stream of a split block.
const STREAMS_MAX: usize = 16;
const STREAM_BYTES_MIN: usize = 128;

const DAMAGED: &str = "damaged Blosc buffer";

/// Unpacks a buffer whose unpacked size is at most `most` bytes.
///
/// # Errors
/// The buffer is damaged, its codec is unknown, or its unpacked size is above `most`.
pub fn unpack(packed: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let header: &[u8; HEADER_BYTES] = packed.first_chunk().ok_or(DAMAGED)?;
    let [version, _, flags, element, ..] = *header;
    let element = usize::from(element);
    let [size, block, all] = [number(packed, 4)?, number(packed, 8)?, number(packed, 12)?];
    if version > VERSION {
        return blosc2::unpack(packed, most);
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
    // Checked before memory is allocated: every block has an offset and at least a size of its own.
    if size.div_ceil(block) > packed.len() / 8 {
        return Err(DAMAGED.to_owned());
    }
    let mut out = vec![0; size];
    let mut unpacked = vec![0; block.min(size)];
    for (index, to) in out.chunks_mut(block).enumerate() {
        let start = number(packed, HEADER_BYTES + 4 * index)?;
        let stream = packed.get(start..).ok_or(DAMAGED)?;
        let is_short = to.len() < block;
        let unpacked = unpacked.get_mut(..to.len()).ok_or(DAMAGED)?;
        unpack_block(stream, unpacked, is_short, flags, element)?;
        if flags & BITS_SHUFFLED != 0 && (to.len() / element).is_multiple_of(8) {
            unshuffle_bits(unpacked, element, to);
        } else if flags & (BITS_SHUFFLED | BYTES_SHUFFLED) == BYTES_SHUFFLED {
            unshuffle_bytes(unpacked, element, to);
        } else {
            to.copy_from_slice(unpacked);
        }
    }
    Ok(out)
}

/// Returns the little-endian u32 at byte `at`.
pub fn number(bytes: &[u8], at: usize) -> Result<usize, String> {
    let four = bytes.get(at..).and_then(<[u8]>::first_chunk);
    let four = four.ok_or(DAMAGED)?;
    usize::try_from(u32::from_le_bytes(*four)).map_err(|error| error.to_string())
}

/// Unpacks a block's streams, which follow one another.
fn unpack_block(
    mut packed: &[u8],
    block: &mut [u8],
    is_short: bool,
    flags: u8,
    element: usize,
) -> Result<(), String> {
    let is_split = flags & NOT_SPLIT == 0
        && element <= STREAMS_MAX
        && block.len() / element >= STREAM_BYTES_MIN
        && !is_short;
    let each = block.len() / if is_split { element } else { 1 };
    if !block.len().is_multiple_of(each) {
        return Err(DAMAGED.to_owned());
    }
    for to in block.chunks_exact_mut(each) {
        let length = number(packed, 0)?;
        let rest = packed.get(4..).ok_or(DAMAGED)?;
        let (stream, behind) = rest.split_at_checked(length).ok_or(DAMAGED)?;
        if length == each {
            to.copy_from_slice(stream);
        } else {
            unpack_stream(stream, to, flags >> 5)?;
        }
        packed = behind;
    }
    Ok(())
}

/// Unpacks a stream, which must fill `out` exactly.
///
/// # Errors
/// The stream is damaged, or its codec is unknown.
pub fn unpack_stream(packed: &[u8], out: &mut [u8], codec: u8) -> Result<(), String> {
    let size = out.len();
    let filled = match codec {
        0 => copies::blosclz(packed, size).map(|unpacked| copied(&unpacked, out)),
        1 => lz4_flex::block::decompress_into(packed, out).ok(),
        2 => unpack::snappy(packed, size).map(|unpacked| copied(&unpacked, out)),
        3 => unpack::fill(flate2::read::ZlibDecoder::new(packed), out),
        4 => unpack::zstandard_into(packed, out),
        other => {
            return Err(format!(
                "a Blosc buffer packed with codec {other}, which is not supported"
            ));
        }
    };
    if filled == Some(size) {
        Ok(())
    } else {
        Err(DAMAGED.to_owned())
    }
}

fn copied(from: &[u8], to: &mut [u8]) -> usize {
    if let Some(to) = to.get_mut(..from.len()) {
        to.copy_from_slice(from);
    }
    from.len()
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
