//! Splits a stream into words, wherever its bytes are cut: whole words go to the model's reader, the rest is kept.

use eecvs_nostd::{Event, Sensor};
use event_files::Skipped;

use super::clock::{Clock, Settled};
use super::strikes::Strikes;
use super::tally::{Count, Tally};
use crate::device::Parse;

/// Bytes per block, for whose events room is reserved at once.
const BLOCK_BYTES: usize = 4096;

/// Length of the longest word, in bytes.
const WORD_MAX: usize = 4;

/// How a model reads its words.
pub trait Reader: Send {
    /// Bytes per word: 2 or 4.
    const WORD: usize;

    /// Most events per word.
    const EVENTS: usize;

    /// Length of a tick of the device's counter, in microseconds.
    const TICK_US: u64 = 1;

    /// Takes a word, which is counted once: as an event, by name, or as lost. Returns whether reading goes on; it
    /// ends where the words were found misaligned, which only the methods of [`State`] detect.
    fn word(&mut self, word: Word, state: &mut State, events: &mut Vec<Event>) -> bool;

    /// Forgets the current row and column.
    fn forget(&mut self);

    /// Returns the latest time in the stream, in microseconds.
    fn time_us(&self, clock: &Clock) -> Option<u64> {
        clock.time()
    }
}

/// A word of a stream.
#[derive(Debug, Clone, Copy)]
pub struct Word {
    /// Its bits.
    pub bits: u32,
    /// Its number in the stream, from 0.
    pub number: u64,
}

/// State that the parsers of all models keep.
#[derive(Debug)]
pub struct State {
    /// The device's time.
    pub clock: Clock,
    /// Counts of words by name.
    pub tally: Tally,
    strikes: Strikes,
    /// Number of words so far.
    words: u64,
    /// The clock to continue with after one byte was skipped.
    realign: Option<Clock>,
}

impl State {
    /// Counts a word that the device does not send at this place; the clock must be as before the word. Returns
    /// whether reading goes on.
    #[cold]
    pub fn strange(&mut self, count: Count, word: Word) -> bool {
        self.tally.add(count);
        self.strike(word)
    }

    /// Takes a low part of time that the clock refused. Returns whether reading goes on.
    #[cold]
    pub fn settle(&mut self, low: u64, word: Word) -> bool {
        let goes_on = !self.clock.runs_back(low) || self.strike(word);
        match self.clock.settle(low) {
            Settled::Found => {}
            Settled::Wrapped => self.tally.add(Count::WrapsMissing),
            Settled::Back => self.tally.add(Count::TimesBack),
        }
        goes_on
    }

    /// Records a strike against a word; the clock must be as before the word. Returns whether reading goes on.
    #[cold]
    pub fn strike(&mut self, word: Word) -> bool {
        let found = self.strikes.add(word.number, &self.clock);
        self.realign = self.realign.or(found);
        self.realign.is_none()
    }

    /// Counts a word by name; reading goes on.
    #[inline(always)]
    pub fn count(&mut self, count: Count) -> bool {
        self.tally.add(count);
        true
    }
}

/// A parser of the words that `R` reads.
#[derive(Debug)]
pub struct WordParser<R> {
    reader: R,
    state: State,
    sensor: Sensor,
    events: u64,
    kept: [u8; WORD_MAX],
    kept_bytes: usize,
}

impl<R: Reader> WordParser<R> {
    /// Starts at the beginning of a stream whose counter has `bits` bits.
    #[must_use]
    pub fn new(reader: R, sensor: Sensor, bits: u32) -> Self {
        let clock = Clock::new(bits);
        Self {
            reader,
            state: State {
                clock,
                tally: Tally::new(),
                strikes: Strikes::new(clock),
                words: 0,
                realign: None,
            },
            sensor,
            events: 0,
            kept: [0; WORD_MAX],
            kept_bytes: 0,
        }
    }

    /// Returns the number of whole words so far, and of those counted by name or as lost. If each event has its own
    /// word, the difference is the number of events; with masks there is no difference.
    #[must_use]
    pub fn accounts(&self) -> (u64, u64) {
        (self.state.words, self.state.tally.all_words())
    }

    /// Reads whole words. Returns the number of bytes read: fewer than given if the words were found misaligned.
    fn read(&mut self, bytes: &[u8], events: &mut Vec<Event>) -> usize {
        events.reserve(bytes.len() / R::WORD * R::EVENTS);
        let first = self.state.words;
        let mut number = first;
        for word in bytes.chunks_exact(R::WORD) {
            // A word is loaded whole, not byte by byte, for speed.
            let bits = match R::WORD {
                2 => word
                    .first_chunk()
                    .map_or(0, |word| u16::from_le_bytes(*word).into()),
                _ => word
                    .first_chunk()
                    .map_or(0, |word| u32::from_le_bytes(*word)),
            };
            let word = Word { bits, number };
            number += 1;
            if !self.reader.word(word, &mut self.state, events) {
                break;
            }
        }
        self.state.words = number;
        (number - first) as usize * R::WORD
    }

    /// Completes the word that is kept; returns the number of bytes used.
    fn fill(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes.len().min(R::WORD - self.kept_bytes);
        self.kept[self.kept_bytes..][..taken].copy_from_slice(&bytes[..taken]);
        self.kept_bytes += taken;
        taken
    }
}

impl<R: Reader> Parse for WordParser<R> {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn parse(&mut self, mut bytes: &[u8], events: &mut Vec<Event>) {
        let before = events.len();
        while !bytes.is_empty() {
            let used = if let Some(clock) = self.state.realign.take() {
                self.state.clock = clock;
                self.state.clock.lose_misaligned();
                self.reader.forget();
                self.state.tally.add(Count::BytesMisaligned);
                1
            } else if self.kept_bytes > 0 || bytes.len() < R::WORD {
                let taken = self.fill(bytes);
                if self.kept_bytes == R::WORD {
                    self.kept_bytes = 0;
                    let word = self.kept;
                    self.read(&word[..R::WORD], events);
                }
                taken
            } else {
                let whole = bytes.len().min(BLOCK_BYTES) / R::WORD * R::WORD;
                self.read(&bytes[..whole], events)
            };
            bytes = &bytes[used..];
        }
        self.events += (events.len() - before) as u64;
    }

    fn resume(&mut self, now_us: Option<u64>) {
        let state = &mut self.state;
        state
            .tally
            .add_many(Count::BytesIncomplete, self.kept_bytes as u64);
        self.kept_bytes = 0;
        state.realign = None;
        state.clock.lose(now_us.map(|now| now / R::TICK_US));
        state.strikes = Strikes::new(state.clock);
        self.reader.forget();
    }

    fn time_us(&self) -> Option<u64> {
        self.reader.time_us(&self.state.clock)
    }

    fn events(&self) -> u64 {
        self.events
    }

    fn words(&self) -> Skipped {
        self.state.tally.words()
    }

    fn losses(&self) -> Skipped {
        self.state.tally.losses()
    }
}
