//! Blocks of bytes that formats of tables pack as a whole, unpacked to a size that is known before.
//!
//! `None` where the bytes are damaged; no more memory is taken than the size asks for.

use std::io::Read;

/// What a decoder gives, at most one byte more than `size`, by which the caller sees that it is too much.
pub fn stream(decoder: impl Read, size: usize) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    let read = decoder.take(size as u64 + 1).read_to_end(&mut out);
    read.is_ok().then_some(out)
}

/// A frame of Zstandard, as [`stream`].
pub fn zstandard(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let decoder = ruzstd::decoding::StreamingDecoder::new(packed).ok()?;
    stream(decoder, size)
}

/// Fills `out` with what a decoder gives: returns how many bytes, one more than there is room for if it gives more.
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

/// A frame of Zstandard, as [`fill`].
pub fn zstandard_into(packed: &[u8], out: &mut [u8]) -> Option<usize> {
    fill(ruzstd::decoding::StreamingDecoder::new(packed).ok()?, out)
}

/// A raw block of Snappy, of exactly `size` bytes.
pub fn snappy(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    if snap::raw::decompress_len(packed).ok()? != size {
        return None;
    }
    let mut out = vec![0; size];
    let filled = snap::raw::Decoder::new().decompress(packed, &mut out);
    (filled.ok()? == size).then_some(out)
}
