//! A record: a frame on disk, what it is, and what tells damage.
//!
//! ```text
//! "EKF2" | length u32 | run u64 | number u64 | ordinal u64 | end_us u64 | CRC-32 of these 40 bytes    head
//! frame, of `length` bytes
//! CRC-32 of all before                                                                              little-endian
//! ```
//!
//! The ordinal counts the records that were written of a run. A damaged frame costs no other, since its head says
//! where the next record begins; a damaged head costs no other, since the next head is found by its first bytes and
//! its own CRC. How many records are damaged or missing is known from the ordinals of those that are not.

use std::iter::FusedIterator;

use eecvs_nostd::FRAME_BYTES_MAX;

use super::Kept;
use crate::message::Stamp;

const MAGIC: [u8; 4] = *b"EKF2";

/// Bytes of a record before the frame, and after it.
pub(super) const HEAD: usize = 44;
pub(super) const TAIL: usize = 4;

/// Maximum bytes of a record.
pub(super) const RECORD_BYTES_MAX: usize = HEAD + FRAME_BYTES_MAX + TAIL;

/// What a record's head says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) stamp: Stamp,
    pub(super) ordinal: u64,
    pub(super) frame_bytes: u32,
}

/// Returns a frame's record; `None` if the frame is larger than any frame may be.
pub(super) fn to_bytes(kept: &Kept, ordinal: u64) -> Option<Vec<u8>> {
    if kept.frame.len() > FRAME_BYTES_MAX {
        return None;
    }
    let mut record = Vec::with_capacity(HEAD + kept.frame.len() + TAIL);
    record.extend_from_slice(&MAGIC);
    record.extend_from_slice(&(kept.frame.len() as u32).to_le_bytes());
    let Stamp {
        run,
        number,
        end_us,
        ..
    } = kept.stamp;
    for field in [run, number, ordinal, end_us] {
        record.extend_from_slice(&field.to_le_bytes());
    }
    record.extend_from_slice(&crc32fast::hash(&record).to_le_bytes());
    record.extend_from_slice(&kept.frame);
    record.extend_from_slice(&crc32fast::hash(&record).to_le_bytes());
    Some(record)
}

impl Head {
    /// Parses the head at the beginning of `bytes`, if there is an undamaged one of this run.
    fn parse(bytes: &[u8], run: u64) -> Option<Self> {
        let (fields, crc) = bytes.get(..HEAD)?.split_last_chunk::<4>()?;
        let rest = fields.strip_prefix(&MAGIC)?;
        if crc32fast::hash(fields) != u32::from_le_bytes(*crc) {
            return None;
        }
        let (length, rest) = rest.split_first_chunk::<4>()?;
        let (fields, _) = rest.as_chunks::<8>();
        let &[of, number, ordinal, end_us] = fields else {
            return None;
        };
        let [of, number, ordinal, end_us] = [of, number, ordinal, end_us].map(u64::from_le_bytes);
        let head = Self {
            stamp: Stamp {
                run,
                number,
                end_us,
                up_us: 0,
            },
            ordinal,
            frame_bytes: u32::from_le_bytes(*length),
        };
        // What follows the highest number must fit into 64 bits too.
        let is_sound = of == run
            && number < u64::MAX
            && ordinal < u64::MAX
            && head.frame_bytes as usize <= FRAME_BYTES_MAX;
        is_sound.then_some(head)
    }

    /// Returns the bytes of the record.
    pub(super) const fn record_bytes(&self) -> usize {
        HEAD + self.frame_bytes as usize + TAIL
    }

    /// Returns whether these are all bytes of this head's record, undamaged.
    fn is_whole(&self, record: &[u8]) -> bool {
        let parts = record.split_last_chunk::<TAIL>();
        record.len() == self.record_bytes()
            && parts.is_some_and(|(rest, crc)| crc32fast::hash(rest) == u32::from_le_bytes(*crc))
    }
}

/// Returns the frame of a whole record, if it is undamaged.
pub(super) fn parse(record: &[u8], run: u64) -> Option<Kept> {
    let head = Head::parse(record, run)?;
    head.is_whole(record).then(|| Kept {
        stamp: head.stamp,
        frame: record[HEAD..record.len() - TAIL].into(),
    })
}

/// A part of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// An undamaged record.
    Record {
        /// Where it begins.
        place: usize,
        /// What it is.
        head: Head,
    },
    /// Bytes of a damaged record whose head is undamaged.
    DamagedFrame {
        /// What the record was.
        head: Head,
    },
    /// Bytes that no undamaged head describes: of one record, or of several.
    Damaged {
        /// How many bytes.
        bytes: usize,
    },
}

/// The parts of a segment's bytes, in order. The work is bounded by the number of bytes.
#[derive(Debug)]
pub(super) struct Parts<'a> {
    bytes: &'a [u8],
    place: usize,
    run: u64,
}

impl<'a> Parts<'a> {
    pub(super) const fn new(bytes: &'a [u8], run: u64) -> Self {
        Self {
            bytes,
            place: 0,
            run,
        }
    }
}

impl Iterator for Parts<'_> {
    type Item = Part;

    fn next(&mut self) -> Option<Part> {
        let rest = self.bytes.get(self.place..)?;
        if rest.is_empty() {
            return None;
        }
        let place = self.place;
        if let Some(head) = Head::parse(rest, self.run)
            && let Some(record) = rest.get(..head.record_bytes())
        {
            self.place += record.len();
            return Some(match head.is_whole(record) {
                true => Part::Record { place, head },
                false => Part::DamagedFrame { head },
            });
        }
        let next = rest.windows(MAGIC.len()).enumerate().skip(1);
        let next = next
            .filter(|(_, first)| *first == MAGIC)
            .find(|(at, _)| Head::parse(&rest[*at..], self.run).is_some());
        let bytes = next.map_or(rest.len(), |(at, _)| at);
        self.place += bytes;
        Some(Part::Damaged { bytes })
    }
}

impl FusedIterator for Parts<'_> {}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn kept(number: u64, bytes: usize) -> Kept {
        Kept {
            stamp: Stamp {
                run: 7,
                number,
                end_us: number * 3,
                up_us: 0,
            },
            frame: vec![number as u8; bytes].into(),
        }
    }

    #[test]
    fn a_record_comes_back_and_any_flipped_bit_is_seen() {
        let frame = kept(9, 100);
        let record = to_bytes(&frame, 4).unwrap();
        assert_eq!(record.len(), HEAD + 100 + TAIL);
        assert_eq!(parse(&record, 7), Some(frame));
        assert_eq!(parse(&record, 8), None, "another run");
        assert_eq!(parse(&record[..record.len() - 1], 7), None);
        for bit in 0..record.len() * 8 {
            let mut damaged = record.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(parse(&damaged, 7), None, "bit {bit}");
            // The head alone says whether the rest can be passed over.
            let head = Head::parse(&damaged, 7);
            assert_eq!(head.is_some(), bit / 8 >= HEAD, "bit {bit}");
        }
        let too_large = kept(1, FRAME_BYTES_MAX + 1);
        assert_eq!(to_bytes(&too_large, 0), None);
    }

    proptest! {
        /// Whatever stands there: every byte is in one part, and records are found behind any rubbish.
        #[test]
        fn records_are_found_among_any_bytes(
            pieces in prop::collection::vec((prop::collection::vec(any::<u8>(), 0..60), 0..80usize, any::<u16>()), 1..8)
        ) {
            let mut bytes = Vec::new();
            let mut places = Vec::new();
            for (index, (rubbish, length, cut)) in pieces.iter().enumerate() {
                // The beginning of a record, which was cut before its head's CRC, and rubbish.
                let record = to_bytes(&kept(index as u64, *length), 0).unwrap();
                bytes.extend_from_slice(&record[..usize::from(*cut) % (HEAD - 4)]);
                bytes.extend_from_slice(rubbish);
                places.push(bytes.len());
                bytes.extend_from_slice(&record);
            }
            let mut sum = 0;
            let mut found = Vec::new();
            for part in Parts::new(&bytes, 7) {
                sum += match part {
                    Part::Record { place, head } => {
                        found.push(place);
                        head.record_bytes()
                    }
                    Part::DamagedFrame { head } => head.record_bytes(),
                    Part::Damaged { bytes } => bytes,
                };
            }
            prop_assert_eq!(sum, bytes.len());
            prop_assert_eq!(found, places);
        }
    }
}
