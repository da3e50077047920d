//! Bytes of frames that come in portions, as a source to read frames from.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bytes that were pushed and not read: one clone is read, the other pushes.
///
/// A read of none that is not at the end fails with [`io::ErrorKind::WouldBlock`]: readers of frames go on from there.
#[derive(Debug, Clone, Default)]
pub struct Pushed(Arc<Mutex<Queue>>);

#[derive(Debug, Default)]
struct Queue {
    bytes: VecDeque<u8>,
    is_complete: bool,
}

/// Why bytes are refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PushError {
    /// The end was there.
    Finished,
    /// The system refuses memory for them.
    NoMemory,
}

impl Pushed {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// [`PushError`] after [`Self::finish`], or without memory; none of the bytes is then taken.
    pub fn push(&self, bytes: &[u8]) -> Result<(), PushError> {
        let mut queue = self.queue();
        if queue.is_complete {
            return Err(PushError::Finished);
        }
        let room = queue.bytes.try_reserve(bytes.len());
        room.map_err(|_| PushError::NoMemory)?;
        queue.bytes.extend(bytes);
        Ok(())
    }

    /// Ends the stream after the bytes so far.
    pub fn finish(&self) {
        self.queue().is_complete = true;
    }
}

impl Read for Pushed {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let mut queue = self.queue();
        if queue.bytes.is_empty() && !queue.is_complete {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        queue.bytes.read(into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_in_order_and_the_end_after_them() {
        let pushed = Pushed::default();
        let (mut source, mut room) = (pushed.clone(), [0; 4]);
        let blocks = |error: io::Error| error.kind() == io::ErrorKind::WouldBlock;
        assert!(source.read(&mut room).is_err_and(blocks));
        pushed.push(&[1, 2, 3]).unwrap();
        pushed.push(&[4, 5]).unwrap();
        source.read_exact(&mut room).unwrap();
        assert_eq!(room, [1, 2, 3, 4]);
        pushed.finish();
        assert_eq!(pushed.push(&[6]), Err(PushError::Finished));
        let mut rest = vec![];
        source.read_to_end(&mut rest).unwrap();
        assert_eq!(rest, [5]);
    }
}
