//! Decodes the LZ4 frames of AEDAT 4, one per packet, which are wholly in memory.
//!
//! | bytes | |
//! |---|---|
//! | 4 | magic number 0x184D2204 |
//! | 1 | flags: bits 7..6 version (1); bit 5 independent blocks; bit 4 block checksums; |
//! | | bit 3 content size follows; bit 2 content checksum; bit 1 reserved, 0; bit 0 dictionary |
//! | 1 | bits 6..4 largest block: 4 to 7 mean 64 kB, 256 kB, 1 MB, 4 MB; other bits 0 |
//! | 0 or 8 | size of the content |
//! | 1 | checksum of the bytes from the flags on |
//! | blocks | u32 size, bit 31 set: not compressed; content; checksum if flagged |
//! | 4 | 0: the end |
//! | 0 or 4 | checksum of the content |
//!
//! All numbers are little-endian; checksums are XXH32. Source: "LZ4 Frame Format Description" 1.6.
//!
//! The frame decoder of `lz4_flex` zeroes a buffer of the largest block's size for every frame and copies the
//! decoded bytes out of it, which takes longer than decoding the few hundred events of a packet. Here the block
//! decoder of `lz4_flex` writes directly to the place of the content. Frames that this decoder does not accept,
//! above all damaged ones, are decoded by the frame decoder of `lz4_flex`, so that the result and the message are
//! its own.

use std::io::{Read, Result};

use lz4_flex::block::decompress_into_with_dict;
use lz4_flex::frame::FrameDecoder;
use twox_hash::XxHash32;

/// First bytes of an LZ4 frame.
pub(crate) const MAGIC: [u8; 4] = [0x04, 0x22, 0x4d, 0x18];

/// How far back a block that is not independent may refer.
const WINDOW: usize = 1 << 16;

/// Bit of a block's size that marks it as not compressed.
const STORED: u32 = 1 << 31;

/// The content of packets, in a buffer that is reused from packet to packet.
#[derive(Default)]
pub(crate) struct Content {
    /// As long as the longest content so far plus a block, so that no byte is zeroed twice.
    bytes: Vec<u8>,
    filled: usize,
}

impl Content {
    /// Returns the content of the latest packet.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.filled).unwrap_or_default()
    }

    /// Reads all of `source` without decoding it.
    ///
    /// # Errors
    /// Those of the source.
    pub fn read(&mut self, mut source: impl Read) -> Result<()> {
        self.bytes.clear();
        let read = source.read_to_end(&mut self.bytes);
        self.filled = self.bytes.len();
        read.map(drop)
    }

    /// Returns the bytes so far, and room for `more` after them.
    fn room(&mut self, more: usize) -> Option<(&[u8], &mut [u8])> {
        let end = self.filled.checked_add(more)?;
        if self.bytes.len() < end {
            self.bytes.resize(end, 0);
        }
        let (before, after) = self.bytes.split_at_mut_checked(self.filled)?;
        Some((before, after.get_mut(..more)?))
    }

    /// Decodes the frame at the start of `frame`, at most `limit` bytes of content.
    ///
    /// # Errors
    /// The frame is damaged; the error is that of `lz4_flex`. More than `limit` bytes are not an error: the
    /// content is cut off there.
    pub fn decode(&mut self, frame: &[u8], limit: usize) -> Result<()> {
        self.filled = 0;
        if self.decode_whole(frame, limit).is_some() {
            return Ok(());
        }
        self.read(FrameDecoder::new(frame).take(limit as u64))
    }

    /// Does the same as [`Content::decode`] for a complete frame without unusual features; returns `None` for any
    /// other.
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

/// Splits the first `N` bytes off `bytes`.
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

    /// Returns frames of every kind and whether they are complete: whole, cut, without an end, damaged.
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
        // Incompressible noise is stored uncompressed.
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
            // A complete frame is decoded here, not by `lz4_flex`'s frame decoder.
            assert!(!is_whole || content.decode_whole(&frame, 1 << 20).is_some());
        }
    }
}
