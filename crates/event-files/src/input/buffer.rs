//! A buffer over a source, which knows the offsets of the bytes that it holds.
//!
//! [`Input`](crate::input::Input) seeks by setting an offset; the source itself seeks only when bytes are read
//! that the buffer does not hold. Reads that bypass the buffer therefore cannot make a later seek use bytes of
//! another place.

use std::io::{self, BufRead, ErrorKind, Read, SeekFrom};

use crate::input::ReadSeek;

/// Number of bytes read from the source at once.
pub const BUFFER_BYTES: usize = 1 << 16;

/// A source, the offset of its next byte, and some of its bytes.
pub struct InputBuffer {
    source: Box<dyn ReadSeek>,
    /// The source's own position, if it is known.
    source_at: Option<u64>,
    bytes: Vec<u8>,
    /// Number of bytes of the buffer in use, and the offset of the first.
    filled: usize,
    bytes_at: u64,
    offset: u64,
}

impl InputBuffer {
    /// Creates a buffer that starts at byte 0 of `source`, whatever the source's position.
    pub fn new(source: Box<dyn ReadSeek>) -> Self {
        Self {
            source,
            source_at: None,
            bytes: Vec::new(),
            filled: 0,
            bytes_at: 0,
            offset: 0,
        }
    }

    /// Returns the source, whose position is then undefined.
    pub fn into_source(self) -> Box<dyn ReadSeek> {
        self.source
    }

    /// Returns the offset of the next byte.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Continues at byte `offset`, without reading.
    pub fn seek(&mut self, offset: u64) {
        self.offset = offset;
    }

    /// Returns the source's current end; the offset of the next byte does not change.
    pub fn end(&mut self) -> io::Result<u64> {
        self.source_at = None;
        let end = self.source.seek(SeekFrom::End(0))?;
        self.source_at = Some(end);
        Ok(end)
    }

    /// Returns those of the next bytes that the buffer holds.
    pub fn held(&self) -> &[u8] {
        let held = self.bytes.get(..self.filled).unwrap_or_default();
        let passed = self.offset.checked_sub(self.bytes_at);
        let passed = passed.and_then(|passed| usize::try_from(passed).ok());
        passed
            .and_then(|passed| held.get(passed..))
            .unwrap_or_default()
    }

    /// Reads the next bytes into `bytes`: those that the buffer holds, or else those of one read from the source.
    /// Returns their number, 0 at the end.
    ///
    /// `past` requests a read that bypasses the buffer, so that it copies only once and reads no more than
    /// `bytes`.
    pub fn read_some(&mut self, bytes: &mut [u8], past: bool) -> io::Result<usize> {
        let read = if past && self.held().is_empty() {
            let Self {
                source,
                source_at,
                offset,
                ..
            } = self;
            read_at(&mut **source, source_at, *offset, bytes)?
        } else {
            let held = self.fill_buf()?;
            let read = held.len().min(bytes.len());
            if let (Some(to), Some(from)) = (bytes.get_mut(..read), held.get(..read)) {
                to.copy_from_slice(from);
            }
            read
        };
        self.offset += read as u64;
        Ok(read)
    }
}

impl Read for InputBuffer {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.read_some(bytes, false)
    }
}

impl BufRead for InputBuffer {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.held().is_empty() {
            self.bytes.resize(BUFFER_BYTES, 0);
            (self.filled, self.bytes_at) = (0, self.offset);
            let Self {
                source,
                source_at,
                bytes,
                offset,
                ..
            } = self;
            self.filled = read_at(&mut **source, source_at, *offset, bytes)?;
        }
        Ok(self.held())
    }

    fn consume(&mut self, count: usize) {
        self.offset += count as u64;
    }
}

/// Reads from byte `offset` of `source`, whose position is `source_at`; an interrupted read is repeated.
fn read_at(
    source: &mut dyn ReadSeek,
    source_at: &mut Option<u64>,
    offset: u64,
    bytes: &mut [u8],
) -> io::Result<usize> {
    if *source_at != Some(offset) {
        *source_at = None;
        source.seek(SeekFrom::Start(offset))?;
        *source_at = Some(offset);
    }
    loop {
        match source.read(bytes) {
            Ok(read) => {
                *source_at = Some(offset + read as u64);
                return Ok(read);
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => {
                *source_at = None;
                return Err(error);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;
    use crate::input::{Input, Words};

    /// A source that returns less than it is asked for, as pipes and disks do.
    struct Dribble(Cursor<Vec<u8>>, usize);

    impl Read for Dribble {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let most = bytes.len().min(self.1);
            self.0.read(&mut bytes[..most])
        }
    }

    impl io::Seek for Dribble {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.0.seek(to)
        }
    }

    #[derive(Debug, Clone)]
    enum Step {
        Fill(usize),
        FillAt(u64, usize),
        Line(usize),
        Seek(u64),
        SeekBy(i64),
        End,
        Reaches(u64),
        AtEnd,
    }

    /// Returns lengths below, at and above the buffer's, and short ones.
    fn length() -> impl Strategy<Value = usize> {
        let buffer = BUFFER_BYTES;
        prop_oneof![
            0..300_usize,
            Just(buffer - 1),
            Just(buffer),
            Just(buffer + 1),
            buffer - 50..buffer + 50,
            2 * buffer - 2..3 * buffer,
        ]
    }

    fn step(bytes: usize) -> impl Strategy<Value = Step> {
        let offset = 0..bytes as u64 + 100;
        prop_oneof![
            3 => length().prop_map(Step::Fill),
            1 => (offset.clone(), length()).prop_map(|(at, length)| Step::FillAt(at, length)),
            3 => (0..5_000_usize).prop_map(Step::Line),
            2 => offset.clone().prop_map(Step::Seek),
            3 => (-70_000..70_000_i64).prop_map(Step::SeekBy),
            1 => Just(Step::End),
            1 => offset.prop_map(|end| Step::Reaches(end + 1)),
            1 => Just(Step::AtEnd),
        ]
    }

    fn content(length: usize) -> Vec<u8> {
        let mut state = 7_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..length).map(|_| next()).collect()
    }

    const BYTES: usize = 5 * BUFFER_BYTES + 123;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn any_steps_give_what_a_slice_gives(
            most in prop_oneof![Just(usize::MAX), Just(1_000), Just(BUFFER_BYTES - 1)],
            steps in prop::collection::vec(step(BYTES), 1..40),
        ) {
            let bytes = content(BYTES);
            let source = Dribble(Cursor::new(bytes.clone()), most);
            let mut input = Input::new(Box::new(source), "test").unwrap();
            let mut at = 0_u64;
            let rest = |at: u64| bytes.get(at as usize..).unwrap_or_default();
            for step in steps {
                match step {
                    Step::Fill(length) | Step::FillAt(_, length) => {
                        let mut read = vec![0; length];
                        let filled = if let Step::FillAt(to, _) = step {
                            at = to;
                            input.fill_at(to, &mut read).unwrap()
                        } else {
                            input.fill(&mut read).unwrap()
                        };
                        let want = &rest(at)[..length.min(rest(at).len())];
                        prop_assert!(read[..filled] == *want, "{:?} at {}", step, at);
                        at += filled as u64;
                    }
                    Step::Line(cap) => {
                        let mut line = vec![b'!'];
                        let read = input.line(&mut line, cap).unwrap();
                        let end = rest(at).iter().position(|byte| *byte == b'\n');
                        let length = end.map_or(rest(at).len(), |end| end + 1).min(cap);
                        prop_assert!(line[1..] == rest(at)[..length], "{:?} at {}", step, at);
                        prop_assert_eq!(read, length);
                        at += length as u64;
                    }
                    Step::Seek(to) => {
                        input.seek(to).unwrap();
                        at = to;
                    }
                    Step::SeekBy(by) => {
                        at = at.saturating_add_signed(by);
                        input.seek(at).unwrap();
                    }
                    Step::End => {
                        prop_assert_eq!(input.end().unwrap(), BYTES as u64);
                        at = BYTES as u64;
                    }
                    Step::Reaches(end) => {
                        prop_assert_eq!(input.reaches(end).unwrap(), end <= BYTES as u64);
                    }
                    Step::AtEnd => {
                        prop_assert_eq!(input.at_end().unwrap(), rest(at).is_empty());
                    }
                }
                prop_assert_eq!(input.offset(), at);
            }
        }

        /// Words that detection looked at are read again after a seek back.
        #[test]
        fn words_after_a_look_ahead_are_those_of_the_source(
            header in prop_oneof![1..2_000_usize, BUFFER_BYTES - 20..BUFFER_BYTES + 20],
            looked in prop_oneof![0..100_usize, 8_000..8_300_usize, 16_000..20_000_usize],
            runs in prop::collection::vec((1..600_usize, 0..600_usize), 1..20),
        ) {
            let bytes = content(BYTES);
            let mut input = Input::new(Box::new(Cursor::new(bytes.clone())), "test").unwrap();
            input.fill(&mut vec![0; header]).unwrap();
            let start = input.offset();
            let mut ahead = Words::<8>::default();
            for _ in 0..looked {
                ahead.next(&mut input).unwrap();
            }
            input.seek(start).unwrap();
            let mut words = Words::<8>::default();
            let mut at = header;
            for (most, back) in runs {
                let (offset, run) = words.run(&mut input, most).unwrap();
                prop_assert_eq!(offset, at as u64);
                let taken = run.len() - back.min(run.len());
                prop_assert!(*run.as_flattened() == bytes[at..at + 8 * run.len()]);
                let back = run.len() - taken;
                words.back(back);
                at += 8 * taken;
            }
        }
    }
}
