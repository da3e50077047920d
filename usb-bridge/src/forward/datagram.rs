//! Datagrams: a stream of bytes in numbered parts, so that a lost one is known.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | stream: a number that is chosen anew whenever a sender starts, little-endian |
//! | 4 | number of the datagram, wrapping |
//! | n | the next bytes of the stream, 1 to [`PART_BYTES_MAX`] |
//!
//! A datagram that comes late, after one that overtook it, is left out: its place is lost already.

/// Bytes before a datagram's part.
const HEAD_BYTES: usize = 8;
/// Most bytes of a part: what Ethernet takes without cutting it.
pub const PART_BYTES_MAX: usize = 1400 - HEAD_BYTES;
/// Bytes of the longest datagram.
pub const DATAGRAM_BYTES_MAX: usize = HEAD_BYTES + PART_BYTES_MAX;

/// Cuts a stream.
#[derive(Debug, Clone, Copy)]
pub struct Cutter {
    stream: u32,
    number: u32,
}

impl Cutter {
    /// Before the first byte of stream number `stream`.
    #[must_use]
    pub const fn new(stream: u32) -> Self {
        Self { stream, number: 0 }
    }

    /// Makes the datagram of a part.
    pub fn cut(&mut self, part: &[u8], datagram: &mut Vec<u8>) {
        datagram.clear();
        datagram.extend_from_slice(&self.stream.to_le_bytes());
        datagram.extend_from_slice(&self.number.to_le_bytes());
        datagram.extend_from_slice(part);
        self.number = self.number.wrapping_add(1);
    }
}

/// What a datagram brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part<'d> {
    /// The bytes that were due.
    Next(&'d [u8]),
    /// Bytes that others are missing before, as many datagrams as this.
    AfterLoss(u32, &'d [u8]),
    /// Bytes of a sender that was started anew.
    Anew(&'d [u8]),
    /// A datagram that came twice or late.
    Late,
    /// Not a datagram of a stream.
    Strange,
}

/// Puts a stream together again.
#[derive(Debug, Clone, Copy, Default)]
pub struct Joiner {
    stream: Option<u32>,
    next: u32,
}

impl Joiner {
    /// Takes a datagram.
    pub fn join<'d>(&mut self, datagram: &'d [u8]) -> Part<'d> {
        let Some((stream, rest)) = datagram.split_first_chunk() else {
            return Part::Strange;
        };
        let Some((number, part)) = rest.split_first_chunk() else {
            return Part::Strange;
        };
        if part.is_empty() || part.len() > PART_BYTES_MAX {
            return Part::Strange;
        }
        let (stream, number) = (u32::from_le_bytes(*stream), u32::from_le_bytes(*number));
        let missing = number.wrapping_sub(self.next);
        let known = self.stream.replace(stream) == Some(stream);
        if known && missing >= 1 << 31 {
            return Part::Late;
        }
        self.next = number.wrapping_add(1);
        match (known, missing) {
            (false, _) => Part::Anew(part),
            (true, 0) => Part::Next(part),
            (true, _) => Part::AfterLoss(missing, part),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_order_is_told() {
        let mut cutter = Cutter::new(9);
        cutter.number = u32::MAX - 1;
        let datagrams: Vec<Vec<u8>> = (0..6_u8)
            .map(|i| {
                let mut datagram = Vec::new();
                cutter.cut(&[i], &mut datagram);
                datagram
            })
            .collect();
        let mut joiner = Joiner::default();
        assert_eq!(joiner.join(&datagrams[0]), Part::Anew(&[0]));
        assert_eq!(joiner.join(&datagrams[1]), Part::Next(&[1]));
        assert_eq!(joiner.join(&datagrams[1]), Part::Late);
        assert_eq!(joiner.join(&datagrams[4]), Part::AfterLoss(2, &[4]));
        assert_eq!(joiner.join(&datagrams[2]), Part::Late);
        assert_eq!(joiner.join(&datagrams[5]), Part::Next(&[5]));
        let mut other = Vec::new();
        Cutter::new(8).cut(&[77], &mut other);
        assert_eq!(joiner.join(&other), Part::Anew(&[77]));
        assert_eq!(joiner.join(&datagrams[5][..8]), Part::Strange);
        assert_eq!(joiner.join(&[]), Part::Strange);
        assert_eq!(joiner.join(&[0; DATAGRAM_BYTES_MAX + 1]), Part::Strange);
    }
}
