//! A file written a few bytes at a time: they are collected, and written together.

use event_types::stream::Result;

use super::sequential::Output;

/// Bytes that are written together, or some more.
const TOGETHER: usize = 8192;
/// How many bytes more: the most that are put at once.
pub const ROOM: usize = 8;

/// A file of records of up to [`ROOM`] bytes.
pub struct Collected {
    file: Output,
    bytes: Box<[u8; TOGETHER + ROOM]>,
    /// How many there are: fewer than [`TOGETHER`] between two calls.
    filled: usize,
}

impl Collected {
    /// Continues with a file.
    pub fn new(file: Output) -> Self {
        Self {
            file,
            bytes: Box::new([0; TOGETHER + ROOM]),
            filled: 0,
        }
    }

    /// Returns the name for messages.
    pub fn name(&self) -> &str {
        self.file.name()
    }

    /// Writes the next bytes.
    ///
    /// # Errors
    /// I/O.
    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        for part in bytes.chunks(ROOM) {
            let mut whole = [0; ROOM];
            for (to, from) in whole.iter_mut().zip(part) {
                *to = *from;
            }
            self.put_first(whole, part.len())?;
        }
        Ok(())
    }

    /// Writes the first `count` of these bytes.
    ///
    /// # Errors
    /// I/O.
    #[inline]
    pub fn put_first(&mut self, bytes: [u8; ROOM], count: usize) -> Result<()> {
        // As by `fill`, in fewer instructions.
        let room = self.bytes.get_mut(self.filled..);
        if let Some(room) = room.and_then(<[u8]>::first_chunk_mut) {
            *room = bytes;
        }
        self.filled += count.min(ROOM);
        if self.filled < TOGETHER {
            return Ok(());
        }
        self.put_all()
    }

    /// Writes what `write` puts in the bytes that it is given, [`ROOM`] at the least; it returns how many these are.
    ///
    /// # Errors
    /// I/O.
    #[inline]
    pub fn fill(&mut self, write: impl FnOnce(&mut [u8]) -> usize) -> Result<()> {
        let room = self.bytes.get_mut(self.filled..).unwrap_or_default();
        let most = room.len();
        self.filled += write(room).min(most);
        if self.filled < TOGETHER {
            return Ok(());
        }
        self.put_all()
    }

    /// Writes the bytes so far.
    #[inline(never)]
    fn put_all(&mut self) -> Result<()> {
        let filled = std::mem::take(&mut self.filled);
        let bytes = self.bytes.get(..filled).unwrap_or_default();
        self.file.put(bytes)
    }

    /// Writes everything to the disk.
    ///
    /// # Errors
    /// I/O.
    pub fn finish(mut self) -> Result<()> {
        self.put_all()?;
        self.file.finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// However bytes are put, they are there in their order.
        #[test]
        fn bytes_keep_their_order(
            parts in proptest::collection::vec((0..3_u8, 0..3000_u32), 1..40),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("collected");
            let mut file = Collected::new(Output::create(&path).unwrap());
            let mut expected = Vec::new();
            for (kind, count) in parts {
                let numbers: Vec<_> = (0..count).map(u32::to_le_bytes).collect();
                match kind {
                    0 => file.put(numbers.as_flattened()).unwrap(),
                    1 => for number in 0..count {
                        file.put_first(u64::from(number).to_le_bytes(), 4).unwrap();
                    },
                    _ => {
                        let mut rest = numbers.as_flattened();
                        while !rest.is_empty() {
                            file.fill(|room| {
                                assert!(room.len() >= ROOM);
                                let (now, later) = rest.split_at(rest.len().min(room.len()));
                                room[..now.len()].copy_from_slice(now);
                                rest = later;
                                now.len()
                            })
                            .unwrap();
                        }
                    }
                }
                expected.extend_from_slice(numbers.as_flattened());
            }
            file.finish().unwrap();
            prop_assert!(std::fs::read(&path).unwrap() == expected);
        }
    }
}
