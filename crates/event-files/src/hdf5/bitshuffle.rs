//! Unpacks chunks of HDF5 files packed by bitshuffle (filter 32008).
//!
//! The filter's values are its major and minor version, the element size in bytes, the number of elements in a
//! block (0: as many as fit into 8 KiB), and the codec that packs the blocks: 0 none, 2 LZ4, 3 Zstandard. A packed
//! chunk begins with its unpacked size in bytes (u64) and the block size in bytes (u32); each block follows its
//! packed size in bytes (u32). All these numbers are big-endian. The last block may be shorter, a multiple of 8
//! elements; the remaining elements, fewer than 8, are stored unpacked after it.

use super::filters::CHUNK_BYTES;
use super::shuffle::unshuffle_bits;
use crate::unpack;

const LZ4: u32 = 2;
const ZSTANDARD: u32 = 3;

/// The number of elements in a block is a multiple of this.
const EIGHT: usize = 8;

/// Size in bytes of a block whose size is not stated, and the smallest number of elements in such a block.
const BLOCK_BYTES: usize = 8192;
const BLOCK_ELEMENTS_MIN: usize = 128;

const DAMAGED: &str = "damaged data";

/// Unpacks a chunk; `values` are the values of its filter.
///
/// # Errors
/// The chunk is damaged or larger than [`CHUNK_BYTES`], or the codec or the element size is not supported.
pub fn unpack(chunk: &[u8], values: &[u32]) -> Result<Vec<u8>, String> {
    let value = |index| values.get(index).copied().unwrap_or(0);
    let element = usize::try_from(value(2)).map_err(|_| DAMAGED)?;
    if element == 0 || element > CHUNK_BYTES {
        return Err(format!("elements of {element} bytes"));
    }
    match value(4) {
        0 => stored(chunk, element, value(3) as usize),
        LZ4 => packed(chunk, element, |bytes, out| {
            lz4_flex::block::decompress_into(bytes, out).ok()
        }),
        ZSTANDARD => packed(chunk, element, unpack::zstandard_into),
        other => Err(format!(
            "blocks packed with codec {other}, which is not supported"
        )),
    }
}

/// Unshuffles the blocks of a chunk that no codec has packed.
fn stored(chunk: &[u8], element: usize, elements: usize) -> Result<Vec<u8>, String> {
    if chunk.len() > CHUNK_BYTES {
        return Err(format!("{} bytes, above {CHUNK_BYTES}", chunk.len()));
    }
    let elements = match elements {
        0 => (BLOCK_BYTES / element / EIGHT * EIGHT).max(BLOCK_ELEMENTS_MIN),
        elements => elements,
    };
    let block = elements.saturating_mul(element);
    let mut out = vec![0; chunk.len()];
    for (from, to) in chunk.chunks(block).zip(out.chunks_mut(block)) {
        // Elements after the last group of eight are not shuffled.
        unshuffle_bits(from, element, to);
    }
    Ok(out)
}

/// Unpacks the blocks of a chunk with `unpack`, which returns the number of bytes written.
fn packed(
    chunk: &[u8],
    element: usize,
    unpack: impl Fn(&[u8], &mut [u8]) -> Option<usize>,
) -> Result<Vec<u8>, String> {
    let (size, rest) = chunk.split_first_chunk().ok_or(DAMAGED)?;
    let (block, mut rest) = rest.split_first_chunk().ok_or(DAMAGED)?;
    let size = usize::try_from(u64::from_be_bytes(*size)).map_err(|_| DAMAGED)?;
    let block = u32::from_be_bytes(*block) as usize;
    if size > CHUNK_BYTES {
        return Err(format!("{size} bytes, above {CHUNK_BYTES}"));
    }
    let eight = EIGHT * element;
    if block == 0 || !block.is_multiple_of(eight) {
        return Err(DAMAGED.to_owned());
    }
    let whole = size / eight * eight;
    // Checked before memory is allocated: every block has a length of 4 bytes.
    if whole.div_ceil(block) > rest.len() / 4 {
        return Err(DAMAGED.to_owned());
    }
    let mut out = vec![0; size];
    let mut shuffled = vec![0; block.min(whole)];
    let (blocks, last) = out.split_at_mut(whole);
    for to in blocks.chunks_mut(block) {
        let (length, behind) = rest.split_first_chunk().ok_or(DAMAGED)?;
        let length = u32::from_be_bytes(*length) as usize;
        let (bytes, behind) = behind.split_at_checked(length).ok_or(DAMAGED)?;
        let shuffled = shuffled.get_mut(..to.len()).ok_or(DAMAGED)?;
        if unpack(bytes, shuffled) != Some(to.len()) {
            return Err(DAMAGED.to_owned());
        }
        unshuffle_bits(shuffled, element, to);
        rest = behind;
    }
    last.copy_from_slice(rest.get(..last.len()).ok_or(DAMAGED)?);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn what_is_claimed_is_not_believed() {
        let header =
            |size: u64, block: u32| [&size.to_be_bytes()[..], &block.to_be_bytes()].concat();
        for codec in [LZ4, ZSTANDARD] {
            for (chunk, element) in [
                (header(1 << 40, 64), 1),
                (header(1 << 20, 64), 1),
                (header(64, 0), 1),
                (header(64, 64), 3),
                (header(64, 64), 0),
                (header(7, 64), 1),
                ([header(64, 64), vec![0xff; 4]].concat(), 1),
                ([header(64, 64), vec![0, 0, 0, 1, 0]].concat(), 1),
                (vec![0; 11], 1),
            ] {
                let unpacked = unpack(&chunk, &[0, 4, element, 0, codec]);
                assert!(unpacked.is_err(), "{chunk:?}");
            }
        }
        assert!(unpack(&[0; 16], &[0, 4, 2, 0, 9]).is_err());
        assert!(unpack(&[0; 16], &[]).is_err());
        // Fewer than eight elements are stored unpacked.
        let few = [header(3, 64), b"abc".to_vec()].concat();
        assert_eq!(unpack(&few, &[0, 4, 1, 0, LZ4]), Ok(b"abc".to_vec()));
        assert_eq!(unpack(b"abc", &[0, 4, 1, 0, 0]), Ok(b"abc".to_vec()));
    }

    proptest! {
        /// Any bytes give an error or at most as many bytes as a chunk may have.
        #[test]
        fn any_bytes_are_an_error_or_a_chunk(
            size in 0..5000_u64, block in 0..64_u32, element in 0..20_u32, elements in 0..300_u32,
            codec in 0..5_u32, lengths in 0..40_u8, rest in prop::collection::vec(any::<u8>(), 0..400),
        ) {
            let header = [&size.to_be_bytes()[..], &(block * 8 * element).to_be_bytes()].concat();
            let first = [0, 0, 0, lengths];
            let chunk = [&header[..], &first, &rest].concat();
            if let Ok(unpacked) = unpack(&chunk, &[0, 4, element, elements, codec]) {
                prop_assert!(unpacked.len() <= chunk.len().max(5000));
            }
        }
    }
}
