//! LZ4 frames as AEDAT 4 holds them, one for each packet, whole in memory.
//!
//! | bytes | |
//! |---|---|
//! | 4 | magic number 0x184D2204 |
//! | 1 | flags: bits 7..6 version 1, 5 blocks stand alone, 4 blocks have checksums, 3 content size follows, 2 content has a checksum, 1 none, 0 dictionary |
//! | 1 | bits 6..4 largest block: 4 to 7 are 64 kB, 256 kB, 1 MB, 4 MB; others 0 |
//! | 0 or 8 | size of the content |
//! | 1 | checksum of the bytes since the flags |
//! | blocks | u32 size, bit 31: not compressed; content; checksum where flagged |
//! | 4 | 0: the end |
//! | 0 or 4 | checksum of the content |
//!
//! All numbers are little-endian, checksums XXH32. Definition: "LZ4 Frame Format Description" 1.6.
//!
//! The decoder of frames in `lz4_flex` zeroes a buffer of the largest block's size for every frame and copies
//! what it decodes out of it, which takes longer than the few hundred events of a packet. Here its decoder
//! of blocks writes where the content is wanted. What this does not take, damaged frames above all, is decoded
//! by `lz4_flex`, so that the outcome and the message are its own.

use std::io::{Read, Result};

use lz4_flex::block::decompress_into_with_dict;
use lz4_flex::frame::FrameDecoder;
use twox_hash::XxHash32;

/// First bytes of a frame.
pub(crate) const MAGIC: [u8; 4] = [0x04, 0x22, 0x4d, 0x18];

/// How far back a block that does not stand alone reaches.
const WINDOW: usize = 1 << 16;

/// A block of this bit in its size is not compressed.
const STORED: u32 = 1 << 31;

/// Content of packets, in a buffer that serves many of them.
#[derive(Default)]
pub(crate) struct Content {
    /// As long as the longest content so far and a block, so that nothing is zeroed twice.
    bytes: Vec<u8>,
    filled: usize,
}

impl Content {
    /// The content of the latest one.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.filled).unwrap_or_default()
    }

    /// Takes all of `source` as it is.
    ///
    /// # Errors
    /// Those of the source.
    pub fn read(&mut self, mut source: impl Read) -> Result<()> {
        self.bytes.clear();
        let read = source.read_to_end(&mut self.bytes);
        self.filled = self.bytes.len();
        read.map(drop)
    }

    /// The bytes so far, and room for `more` after them.
    fn room(&mut self, more: usize) -> Option<(&[u8], &mut [u8])> {
        let end = self.filled.checked_add(more)?;
        if self.bytes.len() < end {
            self.bytes.resize(end, 0);
        }
        let (before, after) = self.bytes.split_at_mut_checked(self.filled)?;
        Some((before, after.get_mut(..more)?))
    }

    /// Decodes the frame that `frame` begins with, at most `limit` bytes of content.
    ///
    /// # Errors
    /// A damaged frame, as `lz4_flex` tells it. One that goes on beyond `limit` is none: its content is cut there.
    pub fn decode(&mut self, frame: &[u8], limit: usize) -> Result<()> {
        self.filled = 0;
        if self.decode_whole(frame, limit).is_some() {
            return Ok(());
        }
        self.read(FrameDecoder::new(frame).take(limit as u64))
    }

    /// As [`Content::decode`], for a whole frame with nothing unusual about it; none for every other.
    fn decode_whole(&mut self, frame: &[u8], limit: usize) -> Option<()> {
        let mut rest = frame.strip_prefix(&MAGIC)?;
        let descriptor = rest;
        let [flags, largest] = *take(&mut rest)?;
        let is = |bit: u8| flags & 1 << bit != 0;
        let is_plain = flags >> 6 == 1 && !is(1) && !is(0) && largest & 0x8f == 0;
        let block_max = match largest >> 4 {
            kind @ 4..=7 if is_plain => 1_usize << (8 + 2 * kind),
            _ => return None,
        };
        let size = if is(3) {
            Some(u64::from_le_bytes(*take(&mut rest)?))
        } else {
            None
        };
        let descriptor = descriptor.get(..descriptor.len() - rest.len())?;
        let [checksum] = *take(&mut rest)?;
        if (xxh32(descriptor) >> 8) as u8 != checksum {
            return None;
        }
        let stand_alone = is(5);
        loop {
            let block = u32::from_le_bytes(*take(&mut rest)?);
            if block == 0 {
                break;
            }
            let length = usize::try_from(block & !STORED).ok()?;
            let (block_bytes, after) = rest.split_at_checked(length)?;
            rest = after;
            if is(4) && xxh32(block_bytes) != u32::from_le_bytes(*take(&mut rest)?) {
                return None;
            }
            let from = if stand_alone {
                self.filled
            } else {
                self.filled.saturating_sub(WINDOW)
            };
            let decoded = if block & STORED == 0 {
                let (before, room) = self.room(block_max)?;
                decompress_into_with_dict(block_bytes, room, before.get(from..)?).ok()?
            } else {
                let (_, room) = self.room(length)?;
                room.copy_from_slice(block_bytes);
                length
            };
            self.filled += decoded;
            if length > block_max || self.filled > limit {
                return None;
            }
        }
        let is_whole = size.is_none_or(|size| size == self.filled as u64)
            && (!is(2) || xxh32(self.bytes()) == u32::from_le_bytes(*take(&mut rest)?));
        is_whole.then_some(())
    }
}

/// The first `N` bytes, which `bytes` then begins after.
fn take<'a, const N: usize>(bytes: &mut &'a [u8]) -> Option<&'a [u8; N]> {
    let (first, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(first)
}

fn xxh32(bytes: &[u8]) -> u32 {
    XxHash32::oneshot(0, bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};

    use super::*;

    /// Frames of every kind, which are whole, and what becomes of them: cut, without an end, damaged.
    fn frames() -> Vec<(Vec<u8>, bool)> {
        let content: Vec<u8> = (0..300_000_u32)
            .map(|i| ((i / 7).wrapping_mul(i) % 251) as u8)
            .collect();
        let mut frames = vec![(vec![], false), (vec![4; 3], false)];
        for size in [BlockSize::Max64KB, BlockSize::Max1MB, BlockSize::Max64KB] {
            for mode in [BlockMode::Linked, BlockMode::Independent] {
                for (block_checksums, checksum, length) in [
                    (false, false, None),
                    (true, false, None),
                    (false, true, Some(0)),
                ] {
                    let content = &content[frames.len()..];
                    let info = FrameInfo::new()
                        .block_size(size)
                        .block_mode(mode)
                        .block_checksums(block_checksums)
                        .content_checksum(checksum)
                        .content_size(length.map(|_| content.len() as u64));
                    let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
                    encoder.write_all(content).unwrap();
                    let frame = encoder.finish().unwrap();
                    frames.push((frame[..frame.len() / 2].to_vec(), false));
                    frames.push((frame[..frame.len() - 4].to_vec(), false));
                    frames.push(([&frame[..], b"more"].concat(), true));
                    for at in [0, 4, 5, 6, 8, 20, frame.len() / 2, frame.len() - 1] {
                        let mut damaged = frame.clone();
                        damaged[at] ^= 0x41;
                        frames.push((damaged, false));
                    }
                    frames.push((frame, true));
                }
            }
        }
        // Noise is stored as it is.
        let mut noise = 1_u32;
        let noise: Vec<u8> = (0..200_000)
            .map(|_| {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (noise >> 24) as u8
            })
            .collect();
        let mut encoder = FrameEncoder::new(Vec::new());
        encoder.write_all(&noise).unwrap();
        frames.push((encoder.finish().unwrap(), true));
        frames
    }

    #[test]
    fn the_outcome_is_that_of_the_library() {
        let mut content = Content::default();
        for (frame, is_whole) in frames() {
            for limit in [1 << 20, 100_000] {
                let got = content.decode(&frame, limit);
                let mut expected = Vec::new();
                let want = FrameDecoder::new(frame.as_slice())
                    .take(limit as u64)
                    .read_to_end(&mut expected);
                assert_eq!(
                    got.map_err(|error| error.to_string()),
                    want.map(drop).map_err(|error| error.to_string())
                );
                assert!(content.bytes() == expected);
            }
            content.filled = 0;
            // Not by the library.
            assert!(!is_whole || content.decode_whole(&frame, 1 << 20).is_some());
        }
    }
}
