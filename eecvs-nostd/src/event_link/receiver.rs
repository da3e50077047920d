//! Finds packets in received bytes.

use heapless::Vec;

use super::packet::{BODY_BYTES_MAX, CRC_BYTES, HEAD_BYTES, Kind, PACKET_BYTES_MAX, Packet, SYNC};
use crate::checksum::CRC_16;
use crate::frame::stream::next_sync;

/// Finds packets in received bytes, which may be damaged.
#[derive(Debug, Clone)]
pub struct Receiver {
    buffer: Vec<u8, PACKET_BYTES_MAX>,
    /// Length of the packet that was returned and is still in the buffer.
    taken: usize,
    /// Number of bytes in the buffer from which on looking again is worthwhile.
    awaited: usize,
    damaged_bytes: u32,
}

impl Receiver {
    /// Returns a receiver without any bytes.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: Vec::new(),
            taken: 0,
            awaited: 1,
            damaged_bytes: 0,
        }
    }

    /// Returns how many bytes belonged to no packet; wraps.
    #[must_use]
    pub const fn damaged_bytes(&self) -> u32 {
        self.damaged_bytes
    }

    /// Takes the next byte and returns the packet that it completes.
    ///
    /// After damage the search goes on at the next sync bytes within what was received, so that a byte may complete
    /// several packets: [`Receiver::next_packet`] returns the others.
    pub fn push(&mut self, byte: u8) -> Option<Packet<'_>> {
        self.release();
        self.put(byte);
        self.next_packet()
    }

    /// Takes the next byte without looking for a packet. All packets before it must have been taken.
    #[inline]
    pub fn put(&mut self, byte: u8) {
        // Never full: whatever can be a packet is shorter, and everything else is discarded.
        let _ = self.buffer.push(byte);
    }

    /// Takes bytes until looking for a packet is worthwhile; returns `false` if `next_byte` ends before that.
    #[inline]
    pub fn fill(&mut self, mut next_byte: impl FnMut() -> Option<u8>) -> bool {
        while self.buffer.len() < self.awaited {
            match next_byte() {
                Some(byte) => self.put(byte),
                None => return false,
            }
        }
        true
    }

    /// Returns the next packet in what was received, if it is complete.
    #[inline]
    pub fn next_packet(&mut self) -> Option<Packet<'_>> {
        self.release();
        if self.buffer.len() < self.awaited {
            return None;
        }
        self.search();
        self.packet()
    }

    /// Returns the packet that was returned last, until the next one is asked for.
    #[inline]
    #[must_use]
    pub fn packet(&self) -> Option<Packet<'_>> {
        let packet = self.buffer.get(..self.taken)?;
        let (head, rest) = packet.split_first_chunk::<HEAD_BYTES>()?;
        let (body, _) = rest.split_last_chunk::<CRC_BYTES>()?;
        Some(Packet {
            kind: Kind::from_code(head[2])?,
            position: u32::from_le_bytes([head[5], head[6], head[7], head[8]]),
            body,
        })
    }

    /// Returns the little-endian words of that packet's body, from offset `at` on.
    #[inline]
    #[must_use]
    pub fn words(&self, at: usize) -> &[[u8; 4]] {
        let end = self.taken.saturating_sub(CRC_BYTES);
        let bytes = self.buffer.get(HEAD_BYTES + at..end);
        bytes.map_or(&[], |bytes| bytes.as_chunks().0)
    }

    /// Discards what was received, as the rest of it will not come. Bytes that belong to no packet that was
    /// returned count as damaged.
    pub fn restart(&mut self) {
        self.release();
        let left = self.buffer.len();
        self.damaged_bytes = self.damaged_bytes.wrapping_add(left as u32);
        self.discard(left);
    }

    /// Discards the packet that was returned last.
    fn release(&mut self) {
        if self.taken > 0 {
            let taken = core::mem::take(&mut self.taken);
            self.discard(taken);
        }
    }

    fn search(&mut self) {
        loop {
            match look(&self.buffer) {
                Look::More(awaited) => {
                    self.awaited = awaited;
                    return;
                }
                Look::Damage => {
                    let skip = next_sync(&self.buffer, SYNC);
                    self.damaged_bytes = self.damaged_bytes.wrapping_add(skip as u32);
                    self.discard(skip);
                }
                Look::Packet(end) => {
                    self.taken = end;
                    return;
                }
            }
        }
    }

    fn discard(&mut self, bytes: usize) {
        let len = self.buffer.len();
        let bytes = bytes.min(len);
        self.buffer.copy_within(bytes.., 0);
        self.buffer.truncate(len - bytes);
        self.awaited = 1;
    }
}

enum Look {
    /// This many bytes have to be there for more to be seen.
    More(usize),
    Damage,
    /// A complete packet of this length.
    Packet(usize),
}

fn look(bytes: &[u8]) -> Look {
    if bytes.iter().zip(SYNC).any(|(byte, sync)| *byte != sync) {
        return Look::Damage;
    }
    let Some(head) = bytes.first_chunk::<HEAD_BYTES>() else {
        return match bytes.get(2) {
            Some(kind) if Kind::from_code(*kind).is_none() => Look::Damage,
            _ => Look::More(bytes.len() + 1),
        };
    };
    let body = usize::from(u16::from_le_bytes([head[3], head[4]]));
    if Kind::from_code(head[2]).is_none() || body > BODY_BYTES_MAX {
        return Look::Damage;
    }
    let end = HEAD_BYTES + body + CRC_BYTES;
    let Some((checked, crc)) = bytes
        .get(..end)
        .and_then(<[u8]>::split_last_chunk::<CRC_BYTES>)
    else {
        return Look::More(end);
    };
    if CRC_16.checksum(checked).to_le_bytes() == *crc {
        Look::Packet(end)
    } else {
        Look::Damage
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec as StdVec;

    fn packet() -> impl Strategy<Value = (Kind, u32, StdVec<u8>)> {
        (
            prop_oneof![
                Just(Kind::Setup),
                Just(Kind::Words),
                Just(Kind::Flush),
                Just(Kind::Status),
                Just(Kind::Hot)
            ],
            any::<u32>(),
            proptest::collection::vec(
                prop_oneof![any::<u8>(), Just(0xEE), Just(0xC6)],
                0..=BODY_BYTES_MAX,
            ),
        )
    }

    fn bytes((kind, position, body): &(Kind, u32, StdVec<u8>)) -> StdVec<u8> {
        let mut out = [0; PACKET_BYTES_MAX];
        let packet = Packet {
            kind: *kind,
            position: *position,
            body,
        };
        let len = packet.write(&mut out).unwrap();
        out[..len].to_vec()
    }

    fn receive(receiver: &mut Receiver, bytes: &[u8]) -> StdVec<(Kind, u32, StdVec<u8>)> {
        let mut found = StdVec::new();
        for byte in bytes {
            let mut packet = receiver.push(*byte);
            while let Some(Packet {
                kind,
                position,
                body,
            }) = packet
            {
                found.push((kind, position, body.to_vec()));
                packet = receiver.next_packet();
            }
        }
        found
    }

    proptest! {
        #[test]
        fn packets_are_received(packets in proptest::collection::vec(packet(), 0..6)) {
            let stream: StdVec<u8> = packets.iter().flat_map(bytes).collect();
            let mut receiver = Receiver::new();
            prop_assert_eq!(receive(&mut receiver, &stream), packets);
            prop_assert_eq!(receiver.damaged_bytes(), 0);
        }

        #[test]
        fn whole_packets_are_found_behind_damage(
            before in packet(), after in proptest::collection::vec(packet(), 2..5),
            flip in any::<usize>(), bits in 1..=255_u8, garbage in proptest::collection::vec(any::<u8>(), 0..40),
        ) {
            let mut stream = bytes(&before);
            let at = flip % stream.len();
            stream[at] ^= bits;
            stream.extend(garbage);
            for packet in &after {
                stream.extend(bytes(packet));
            }
            // Whatever the damaged bytes claim to be ends within the longest packet.
            stream.extend([0; PACKET_BYTES_MAX]);
            let mut receiver = Receiver::new();
            let found = receive(&mut receiver, &stream);
            prop_assert!(found.ends_with(&after), "{:?} {:?}", found.len(), receiver.damaged_bytes());
        }

        #[test]
        fn any_bytes_are_survived(bytes in proptest::collection::vec(
            prop_oneof![any::<u8>(), Just(0xEE), Just(0xC6), Just(2), Just(0)], 0..3000,
        )) {
            receive(&mut Receiver::new(), &bytes);
        }
    }
}
