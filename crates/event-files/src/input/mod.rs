//! The byte source of every reader: a file or memory, with its name and the current position.

pub(crate) mod adjusted;
pub(crate) mod buffer;
pub(crate) mod following;
pub mod growing;
pub(crate) mod marked;
pub mod piped;
pub(crate) mod section;

use std::fs::File;
use std::io::{BufRead, Read, Seek, SeekFrom};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, ensure, error};

use crate::input::buffer::{BUFFER_BYTES, InputBuffer};
use crate::{Assumption, BATCH_EVENTS, BadEvents, EventReader, Skipped};

/// A source that readers read from: a file, or bytes in memory (`std::io::Cursor`).
pub trait ReadSeek: Read + Seek + Send {}

impl<T: Read + Seek + Send> ReadSeek for T {}

/// Kind under which [`Skipped`] counts events outside the sensor that are left out.
pub const OUTSIDE: &str = "events outside of the sensor";

/// A buffered source, with the name and the position that error messages state.
pub struct Input {
    buffer: InputBuffer,
    name: String,
    length: u64,
    bad_events: BadEvents,
}

impl Input {
    /// Opens a file for reading from byte 0; messages call it by its path.
    ///
    /// # Errors
    /// The path cannot be opened, or is a directory.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
        let directory = file.metadata().is_ok_and(|metadata| metadata.is_dir());
        ensure!(
            !directory,
            Damaged,
            "{name}: is a directory, not a recording"
        );
        Self::new(Box::new(file), &name)
    }

    /// Reads from `source`, which messages call `name`.
    ///
    /// # Errors
    /// The source cannot seek.
    pub fn new(mut source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        let length = source
            .seek(SeekFrom::End(0))
            .with_context(|| format!("{name}: cannot seek; pipes are not supported"))?;
        Ok(Self {
            buffer: InputBuffer::new(source),
            name: name.to_owned(),
            length,
            bad_events: BadEvents::Refuse,
        })
    }

    /// Returns the source, whose position is then undefined.
    #[must_use]
    pub fn into_source(self) -> Box<dyn ReadSeek> {
        self.buffer.into_source()
    }

    /// Returns the source's name, with which messages begin.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the offset of the next byte.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.buffer.offset()
    }

    /// Returns the source's length in bytes, as known when it was opened or by [`Input::reaches`].
    #[must_use]
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Returns whether no byte follows. In a file that is still being written, it waits for a byte.
    ///
    /// # Errors
    /// I/O.
    pub fn at_end(&mut self) -> Result<bool> {
        let offset = self.offset();
        match self.buffer.fill_buf() {
            Ok(bytes) => Ok(bytes.is_empty()),
            Err(error) => Err(self.unreadable(offset, error)),
        }
    }

    /// Returns the next bytes that lie in the buffer, which is filled first if it has none; none at the end.
    ///
    /// # Errors
    /// I/O.
    pub(crate) fn block(&mut self) -> Result<&[u8]> {
        let offset = self.offset();
        // The bytes cannot be returned from the call that may fail.
        if let Err(error) = self.buffer.fill_buf() {
            return Err(self.unreadable(offset, error));
        }
        Ok(self.buffer.held())
    }

    /// Moves past bytes of [`Input::block`].
    pub(crate) fn consume(&mut self, bytes: usize) {
        self.buffer.consume(bytes);
    }

    /// Moves to the current end and returns its offset; unlike [`Input::length`], it sees that a file has grown.
    ///
    /// # Errors
    /// I/O.
    pub fn end(&mut self) -> Result<u64> {
        let end = self.buffer.end();
        let end = end.with_context(|| format!("{}: cannot seek to its end", self.name))?;
        self.buffer.seek(end);
        Ok(end)
    }

    /// Sets the offset of the next byte to read.
    ///
    /// # Errors
    /// `offset` is 2^63 or more, which no file has.
    pub fn seek(&mut self, offset: u64) -> Result<()> {
        ensure!(
            i64::try_from(offset).is_ok(),
            Damaged,
            "{}: byte {offset}: cannot seek here",
            self.name
        );
        self.buffer.seek(offset);
        Ok(())
    }

    /// Returns whether the source has at least `end` bytes; waits for them if a recording is still being written.
    ///
    /// # Errors
    /// I/O.
    pub fn reaches(&mut self, end: u64) -> Result<bool> {
        if end <= self.length {
            return Ok(true);
        }
        let here = self.offset();
        let is_there = self.fill_at(end - 1, &mut [0])? == 1;
        if is_there {
            let length = self.buffer.end();
            self.length = length
                .map_err(|error| self.unreadable(end, error))?
                .max(end);
        }
        self.seek(here)?;
        Ok(is_there)
    }

    /// Fills `bytes`, or as much of it as the source still has, and returns the number of bytes.
    ///
    /// # Errors
    /// I/O.
    pub fn fill(&mut self, bytes: &mut [u8]) -> Result<usize> {
        // A read as large as the buffer bypasses it, so that the bytes are copied only once.
        let past = bytes.len() >= BUFFER_BYTES;
        self.read_all(bytes, past)
    }

    /// Fills `bytes` from byte `offset` on, or as much of it as the source has there, and returns the number of
    /// bytes.
    ///
    /// It reads no more than that, which suits a few bytes at scattered places, and leaves the position after
    /// them.
    ///
    /// # Errors
    /// I/O.
    pub fn fill_at(&mut self, offset: u64, bytes: &mut [u8]) -> Result<usize> {
        self.seek(offset)?;
        self.read_all(bytes, true)
    }

    fn read_all(&mut self, bytes: &mut [u8], past: bool) -> Result<usize> {
        let mut filled = 0;
        while let Some(rest) = bytes.get_mut(filled..).filter(|rest| !rest.is_empty()) {
            let offset = self.offset();
            match self.buffer.read_some(rest, past) {
                Ok(0) => {
                    self.check_length(offset)?;
                    break;
                }
                Ok(read) => filled += read,
                Err(error) => return Err(self.unreadable(offset, error)),
            }
        }
        Ok(filled)
    }

    /// Appends the next line with its line feed, at most `cap` bytes, to `line`; returns the number of bytes, 0 at
    /// the end.
    ///
    /// # Errors
    /// I/O.
    pub fn line(&mut self, line: &mut Vec<u8>, cap: usize) -> Result<usize> {
        let offset = self.offset();
        let read = self
            .buffer
            .by_ref()
            .take(cap as u64)
            .read_until(b'\n', line);
        let read = read.map_err(|error| self.unreadable(offset, error))?;
        if read == 0 && cap > 0 {
            self.check_length(offset)?;
        }
        Ok(read)
    }

    /// Returns an error if the source ends before the length that it had when it was opened.
    fn check_length(&self, offset: u64) -> Result<()> {
        ensure!(
            offset >= self.length,
            Damaged,
            "{}: byte {offset}: the file ends here but had {} bytes: it was cut while it was read",
            self.name,
            self.length
        );
        Ok(())
    }

    /// Returns an error at the current position: name, offset and `what`.
    pub fn error(&self, what: impl std::fmt::Display) -> event_types::stream::Error {
        self.error_at(self.offset(), what)
    }

    /// Returns an error at byte `offset`: name, offset and `what`.
    pub fn error_at(
        &self,
        offset: u64,
        what: impl std::fmt::Display,
    ) -> event_types::stream::Error {
        error!(Damaged, "{}: byte {offset}: {what}", self.name)
    }

    /// Makes `bytes` `length` bytes long, as the file asks for.
    ///
    /// # Errors
    /// The system refuses the memory.
    pub(crate) fn room(&self, bytes: &mut Vec<u8>, length: usize) -> Result<()> {
        let more = length.saturating_sub(bytes.len());
        bytes.try_reserve(more).with_context(|| {
            let name = &self.name;
            format!("{name}: {length} bytes of memory are needed, which the system refuses")
        })?;
        bytes.resize(length, 0);
        Ok(())
    }

    fn unreadable(&self, offset: u64, error: std::io::Error) -> event_types::stream::Error {
        let what = format!("{}: byte {offset}: cannot be read", self.name);
        event_types::stream::Error::other(error).context(what)
    }
}

/// The decoder of one format; [`Reader`] turns it into an [`EventReader`].
pub trait Decode: Send {
    /// Implements [`EventReader::format`].
    fn format(&self) -> &'static str;

    /// Implements [`EventReader::sensor`].
    fn sensor(&self) -> Sensor;

    /// Implements [`EventReader::camera`].
    fn camera(&self) -> Option<&str> {
        None
    }

    /// Implements [`EventReader::assumptions`].
    fn assumptions(&self) -> &[Assumption] {
        &[]
    }

    /// Implements [`EventReader::skipped`].
    fn skipped(&self) -> &Skipped;

    /// Implements [`EventReader::leave_out_bad_events`].
    fn leave_out_bad_events(&mut self) -> bool {
        false
    }

    /// Implements [`EventReader::seek`].
    ///
    /// # Errors
    /// Those of [`EventReader::seek`].
    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let _ = t_us;
        Ok(false)
    }

    /// Implements [`EventReader::end_at`].
    ///
    /// # Errors
    /// Those of [`EventReader::end_at`].
    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        let _ = t_us;
        Ok(false)
    }

    /// Appends events until the batch has no room left, or the recording ends.
    ///
    /// If it appends none, the recording has ended. Events appended before an error are valid.
    ///
    /// # Errors
    /// Those of [`EventReader::read`].
    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()>;
}

/// The events that one call of [`EventReader::read`] returns.
pub struct Batch<'a> {
    events: &'a mut Vec<Event>,
    start: usize,
}

impl<'a> Batch<'a> {
    /// Creates a batch that is appended to `events`.
    #[must_use]
    pub const fn new(events: &'a mut Vec<Event>) -> Self {
        let start = events.len();
        Self { events, start }
    }

    /// Returns how many more events fit.
    #[must_use]
    pub fn room(&self) -> usize {
        (self.start + BATCH_EVENTS).saturating_sub(self.events.len())
    }

    /// Returns whether no event has been appended yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the number of events appended so far.
    #[must_use]
    pub fn len(&self) -> usize {
        self.events.len() - self.start
    }

    /// Appends events, which must not be more than there is room for.
    #[inline]
    pub fn extend(&mut self, events: impl ExactSizeIterator<Item = Event>) {
        self.events.extend(events);
    }

    /// Appends one event, for which there must be room.
    pub fn push(&mut self, event: Event) {
        self.events.push(event);
    }
}

/// An [`EventReader`] around a decoder: it holds an error back until the events before it have been returned.
pub struct Reader<D> {
    pub(super) decoder: D,
    held: Option<event_types::stream::Error>,
    ended: bool,
}

impl<D: Decode> Reader<D> {
    pub(super) fn around(decoder: D) -> Self {
        Self {
            decoder,
            held: None,
            ended: false,
        }
    }
}

impl<D: Decode> EventReader for Reader<D> {
    fn format(&self) -> &'static str {
        self.decoder.format()
    }

    fn sensor(&self) -> Sensor {
        self.decoder.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.decoder.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.decoder.assumptions()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        if let Some(error) = self.held.take() {
            return Err(error);
        }
        if self.ended {
            return Ok(0);
        }
        let mut batch = Batch::new(events);
        let result = self.decoder.decode(&mut batch);
        let read = batch.len();
        self.ended = result.is_err() || read == 0;
        match result {
            Err(error) if read == 0 => Err(error),
            Err(error) => {
                self.held = Some(error);
                Ok(read)
            }
            Ok(()) => Ok(read),
        }
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let sought = self.held.is_none() && self.decoder.seek(t_us)?;
        // The end may have been reached before the seek.
        self.ended &= !sought;
        Ok(sought)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        self.decoder.end_at(t_us)
    }

    fn skipped(&self) -> &Skipped {
        self.decoder.skipped()
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.decoder.leave_out_bad_events()
    }
}

/// Fixed-size words of an [`Input`], read in blocks.
pub struct Words<const N: usize> {
    bytes: Vec<u8>,
    next: usize,
    filled: usize,
}

impl<const N: usize> Default for Words<N> {
    /// Returns an empty block buffer of a whole number of words.
    fn default() -> Self {
        let whole_words = BUFFER_BYTES - BUFFER_BYTES % N;
        Self {
            bytes: vec![0; whole_words],
            next: 0,
            filled: 0,
        }
    }
}

impl<const N: usize> Words<N> {
    /// Returns the next word, or `None` at the end.
    ///
    /// # Errors
    /// I/O, or bytes after the last whole word. A single line feed there is allowed: old recorders ended files
    /// with one.
    #[inline]
    pub fn next(&mut self, input: &mut Input) -> Result<Option<[u8; N]>> {
        loop {
            let rest = self.bytes.get(self.next..self.filled);
            if let Some(word) = rest.and_then(<[u8]>::first_chunk) {
                self.next += N;
                return Ok(Some(*word));
            }
            if !self.refill(input)? {
                return Ok(None);
            }
        }
    }

    /// Returns the offset of the next words and at most `most` of them; none at the end.
    ///
    /// # Errors
    /// Those of [`Words::next`].
    pub fn run(&mut self, input: &mut Input, most: usize) -> Result<(u64, &[[u8; N]])> {
        if self.filled - self.next < N && !self.refill(input)? {
            return Ok((input.offset(), &[]));
        }
        let offset = input.offset() - (self.filled - self.next) as u64;
        let rest = self.bytes.get(self.next..self.filled);
        let (words, _) = rest.unwrap_or_default().as_chunks();
        let words = words.get(..most).unwrap_or(words);
        self.next += words.len() * N;
        Ok((offset, words))
    }

    /// Goes back by `words` of the words that [`Words::run`] returned last.
    pub const fn back(&mut self, words: usize) {
        self.next = self.next.saturating_sub(words * N);
    }

    /// Reads the next block when no whole word is left; returns false at the end.
    #[cold]
    fn refill(&mut self, input: &mut Input) -> Result<bool> {
        // A block ends within a word only at the end of the file.
        let mut rest = self.filled - self.next;
        let mut first = self.bytes.get(self.next).copied();
        if rest == 0 {
            (self.next, self.filled) = (0, input.fill(&mut self.bytes)?);
            if self.filled >= N {
                return Ok(true);
            }
            rest = self.filled;
            first = self.bytes.first().copied();
        }
        (self.next, self.filled) = (0, 0);
        if rest == 0 || (rest == 1 && first == Some(b'\n')) {
            return Ok(false);
        }
        Err(input.error_at(
            input.offset() - rest as u64,
            format!("the file ends within a word of {N} bytes ({rest} are present): truncated"),
        ))
    }

    /// Returns the offset of the word that [`Words::next`] returned last.
    #[must_use]
    pub fn offset(&self, input: &Input) -> u64 {
        input.offset() - (self.filled - self.next) as u64 - N as u64
    }
}

impl Input {
    /// Makes [`Input::outside`] count events from here on instead of returning an error.
    pub fn leave_out_bad_events(&mut self) {
        self.bad_events = BadEvents::LeaveOut;
    }

    /// Refuses or counts event number `index` at byte `offset`, which lies outside the sensor at (x, y).
    ///
    /// # Errors
    /// Always, unless [`Input::leave_out_bad_events`] was called.
    pub fn outside(
        &self,
        offset: u64,
        index: u64,
        (x, y): (i64, i64),
        sensor: Sensor,
        skipped: &mut Skipped,
    ) -> Result<()> {
        if self.bad_events == BadEvents::LeaveOut {
            skipped.add(OUTSIDE, 1);
            return Ok(());
        }
        let Sensor { width, height } = sensor;
        Err(self.error_at(
            offset,
            format!(
                "event {index} at x = {x}, y = {y} is outside the sensor ({width}x{height}): the \
                 recording is damaged, or the sensor has another size: see --width and --height, \
                 and --leave-out-bad-events"
            ),
        ))
    }
}
