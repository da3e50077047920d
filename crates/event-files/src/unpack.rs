//! Decompresses the blocks that table formats compress as a whole, to a size known in advance.
//!
//! All functions return `None` if the bytes are damaged, and take no more memory than the size requires.

use std::io::Read;

/// Returns a decoder's output, cut off one byte past `size`, from which the caller sees that it is too long.
pub fn stream(decoder: impl Read, size: usize) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    let read = decoder.take(size as u64 + 1).read_to_end(&mut out);
    read.is_ok().then_some(out)
}

/// Decompresses a Zstandard frame, with the result of [`stream`].
pub fn zstandard(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let decoder = ruzstd::decoding::StreamingDecoder::new(packed).ok()?;
    stream(decoder, size)
}

/// Fills `out` with a decoder's output and returns its length, or `out.len() + 1` if the output is longer than
/// `out`.
pub fn fill(mut decoder: impl Read, out: &mut [u8]) -> Option<usize> {
    let mut filled = 0;
    while let Some(rest @ [_, ..]) = out.get_mut(filled..) {
        match decoder.read(rest).ok()? {
            0 => return Some(filled),
            read => filled += read,
        }
    }
    let more = decoder.read(&mut [0]).ok()?;
    Some(filled + more)
}

/// Decompresses a Zstandard frame into `out`, with the result of [`fill`].
pub fn zstandard_into(packed: &[u8], out: &mut [u8]) -> Option<usize> {
    fill(ruzstd::decoding::StreamingDecoder::new(packed).ok()?, out)
}

/// Decompresses a raw Snappy block that must yield exactly `size` bytes.
pub fn snappy(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    if snap::raw::decompress_len(packed).ok()? != size {
        return None;
    }
    let mut out = vec![0; size];
    let filled = snap::raw::Decoder::new().decompress(packed, &mut out);
    (filled.ok()? == size).then_some(out)
}
