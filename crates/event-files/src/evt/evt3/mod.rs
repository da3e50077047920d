//! Prophesee RAW with EVT 3.0 words: 16 bits, little-endian, with the type in the upper four.
//!
//! | type | bits 11..0 |
//! |---|---|
//! | 0 `ADDR_Y` | 10..0 y |
//! | 2 `ADDR_X` | 11 polarity, 10..0 x: one event |
//! | 3 `VECT_BASE_X` | 11 polarity, 10..0 first x of the vectors that follow |
//! | 4 `VECT_12`, 5 `VECT_8` | bit i set: an event at x + i; then x advances by 12 or 8 |
//! | 6 `TIME_LOW`, 8 `TIME_HIGH` | time bits 11..0, 23..12 |
//! | A `EXT_TRIGGER`, 7 and F CONTINUED, E OTHERS | skipped and counted |
//!
//! Sensors send vectors as `VECT_BASE_X` and then always `VECT_12`, `VECT_12`, `VECT_8`, and so does the writer
//! (`group.rs`). The reader also takes vectors of any other words, which other decoders misread: files that
//! earlier writers made have a lone `VECT_12`. Sensors also send every `TIME_HIGH`; the writer leaves some out only
//! in a silence of more than 16.8 s: OpenEB's robust decoder reports those as lost, though it loses no event.
//!
//! Only `TIME_HIGH` carries the overflow: a `TIME_LOW` may step back by a few microseconds after a `TIME_HIGH`,
//! and to take that for a wrap would stretch a recording. A new `TIME_HIGH` value sets the low bits to 0 until a
//! `TIME_LOW` follows; a repeated one keeps them. The 24 bits of time wrap every 16.8 s; the wraps are counted.
//! Events before the first `TIME_HIGH` have no time, those before the first `ADDR_Y` no row, and vectors before
//! the first `VECT_BASE_X` no column: they are counted and skipped.
//!
//! The reader does not seek. The file has no index, a word's row and time may be stated any number of words before
//! it, and only the words between two places show whether the 24 bits of time have wrapped between them.
//!
//! The crate `evt3` decodes the shared recordings to the same events, but its column counter overflows (a panic in
//! debug builds) on a long run of vectors, it returns no offsets, and it drops unknown words and events without a
//! time uncounted. Hence this decoder, which the tests compare with `evt3`.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod avx2;
pub mod group;

use std::hint::select_unpredictable;
use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor};

use crate::evt::evt3::group::Group;
use crate::evt::header as raw_header;
use crate::evt::header::RawFile;
use crate::evt::row::{Outside, Row};
use crate::evt::writer::RawWriter;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, OUTSIDE, ReadSeek, Reader, Words};
use crate::word_runs::{NO_EVENT, RUN_WORDS, plain_words};
use crate::wrapping::Wrapping;
use crate::{EventWriter, Skipped};

/// Type of a word that states the row.
pub const ADDR_Y: u16 = 0x0;
/// Type of a word that is one event.
pub const ADDR_X: u16 = 0x2;
/// Type of a word that states the first column and the polarity of the vectors after it.
pub const VECT_BASE_X: u16 = 0x3;
/// Type of a vector of 12 columns.
pub const VECT_12: u16 = 0x4;
/// Type of a vector of 8 columns.
pub const VECT_8: u16 = 0x5;
/// Type of a word with the lower bits of time.
pub const TIME_LOW: u16 = 0x6;
/// Type of a word with the upper bits of time.
pub const TIME_HIGH: u16 = 0x8;
/// Number of bits of each part of the time.
pub const TIME_BITS: u32 = 12;

/// Type of a trigger.
const TRIGGER: u16 = 0xa;
/// The lower three bits of the two types (7 and F) of words that continue another word.
const CONTINUED: u16 = 0x7;
/// Type of a word that begins vendor data.
const OTHER: u16 = 0xe;

/// Largest number of events that one word can hold.
pub(crate) const VECTOR_EVENTS: usize = 12;

/// Longest silence in which the writer writes every `TIME_HIGH`, one per 4,096 us: a period, 16.8 s, in 8 KiB.
const WALK_MAX: u64 = 1 << TIME_BITS;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "evt3",
    title: "Prophesee RAW EVT 3",
    endings: &[".raw", ".evt3"],
    detect: |start| start.holds(raw_header::Words::Evt3),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(Evt3Reader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Evt3Writer::create(path, sensor)?))),
};

/// A reader of EVT 3.0 files.
pub type Evt3Reader = Reader<Evt3Decoder>;

impl Evt3Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the header states no size.
    ///
    /// # Errors
    /// There is no EVT 3.0 header, or the sensor's size is unknown.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let RawFile {
            input,
            header,
            sensor,
            t0_us,
        } = RawFile::open(source, name, size, raw_header::Words::Evt3)?;
        let mut decoder = WordDecoder::new(sensor, header.time_base_us);
        decoder.t0_us = t0_us;
        Ok(Self::around(Evt3Decoder {
            input,
            words: Words::default(),
            camera: header.camera,
            vectors: Vectors::detected(),
            decoder,
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`Evt3Reader`]: its state between two words.
pub struct Evt3Decoder {
    input: Input,
    words: Words<2>,
    camera: Option<String>,
    vectors: Option<Vectors>,
    decoder: WordDecoder,
    skipped: Skipped,
}

/// What decodes several words at once, on a core that has it.
#[cfg(target_arch = "x86_64")]
type Vectors = avx2::Avx2;

/// On other cores there is none.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Debug, Clone, Copy)]
enum Vectors {}

#[cfg(not(target_arch = "x86_64"))]
impl Vectors {
    const fn detected() -> Option<Self> {
        None
    }

    fn decode(self, _: &[[u8; 2]], _: &mut Plain, _: &mut [Event]) -> Decoded {
        match self {}
    }
}

/// What words before plain ones have stated. Plain are a row or a column on the sensor, lower bits of time, the current
/// upper bits of time, and a word that is only counted.
#[derive(Debug, Clone, Copy)]
struct Plain {
    sensor: Sensor,
    /// Upper bits of time as a word states them, and the time that they stand for, in microseconds.
    high: u16,
    high_us: u64,
    low: u16,
    y: u16,
}

/// What was decoded of a run of plain words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Decoded {
    /// Number of words.
    words: usize,
    /// Number of events among them.
    events: usize,
    /// Number of plain words right behind them, before one that is not plain.
    plain_left: usize,
    /// Words that are only counted: triggers, continued words and vendor words.
    skipped: [u16; 3],
}

impl Decoded {
    const NOTHING: Self = Self {
        words: 0,
        events: 0,
        plain_left: 0,
        skipped: [0; 3],
    };
}

impl Decode for Evt3Decoder {
    fn format(&self) -> &'static str {
        "evt3"
    }

    fn sensor(&self) -> Sensor {
        self.decoder.sensor
    }

    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.decoder.leave_out = true;
        true
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        let mut skipped = [0; SKIPPED.len()];
        let decoded = self.decode_runs(batch, &mut skipped);
        for (name, count) in SKIPPED.into_iter().zip(skipped) {
            self.skipped.add(name, count);
        }
        decoded
    }
}

impl Evt3Decoder {
    /// Decodes a batch, and counts the words of runs that are only counted.
    fn decode_runs(
        &mut self,
        batch: &mut Batch<'_>,
        skipped: &mut [u64; SKIPPED.len()],
    ) -> Result<()> {
        let mut scratch = [NO_EVENT; RUN_WORDS];
        while batch.room() >= VECTOR_EVENTS {
            let most = batch.room().min(RUN_WORDS);
            let (offset, run) = self.words.run(&mut self.input, most)?;
            if run.is_empty() {
                break;
            }
            let (mut taken, mut few) = (0, 0);
            while let Some(rest) = run.get(taken..).filter(|rest| !rest.is_empty()) {
                // What is too short for vectors is better taken with what follows.
                if rest.len() < TOGETHER && taken > 0 && run.len() == RUN_WORDS {
                    break;
                }
                let most = batch.room();
                let rest = rest.get(..most).unwrap_or(rest);
                let decoded = self.decoder.decode_plain(self.vectors, rest, &mut scratch);
                batch.extend(scratch.iter().take(decoded.events).copied());
                for (sum, count) in skipped.iter_mut().zip(decoded.skipped) {
                    *sum += u64::from(count);
                }
                taken += decoded.words;
                // Words that are not plain come together: the more of them, the more are decoded one by one.
                few = if decoded.words > 0 {
                    FEW
                } else {
                    2 * few.max(FEW)
                };
                for word in run.iter().skip(taken).take(decoded.plain_left + few) {
                    if batch.room() < VECTOR_EVENTS {
                        break;
                    }
                    let word = u16::from_le_bytes(*word);
                    let decoded = self.decoder.decode(word, batch, &mut self.skipped);
                    if let Err(Outside { x, y, .. }) = decoded {
                        let offset = offset + 2 * taken as u64;
                        let WordDecoder { events, sensor, .. } = self.decoder;
                        let pixel = (x.into(), y.into());
                        self.input
                            .outside(offset, events, pixel, sensor, &mut self.skipped)?;
                    }
                    taken += 1;
                }
                if batch.room() < VECTOR_EVENTS {
                    break;
                }
            }
            let left = run.len() - taken;
            self.words.back(left);
        }
        Ok(())
    }
}

/// Number of words that vectors take together.
const TOGETHER: usize = 16;

/// Number of words that are decoded one by one from one on that is not plain: those of a vector.
const FEW: usize = 4;

/// Names of the words that contribute nothing to an event, in the order of [`Decoded::skipped`].
const SKIPPED: [&str; 3] = ["triggers", "continued words", "other words"];

/// Counts the words that contribute nothing to an event.
fn skipped_of(words: &[[u8; 2]]) -> [u16; 3] {
    let mut skipped = [0; 3];
    for word in words {
        let kind = u16::from_le_bytes(*word) >> 12;
        let is_one = [kind == TRIGGER, kind & 0x7 == CONTINUED, kind == OTHER];
        for (count, is_one) in skipped.iter_mut().zip(is_one) {
            *count += u16::from(is_one);
        }
    }
    skipped
}

/// A decoder of EVT 3.0 words from any source: what the words so far have stated.
#[derive(Debug)]
pub(crate) struct WordDecoder {
    sensor: Sensor,
    /// Counter of time bits 12 and up; it has no value before the first `TIME_HIGH`.
    high: Wrapping,
    low: u16,
    /// Microseconds added to every time.
    t0_us: u64,
    y: Option<u16>,
    /// First x of the next vector, and its polarity. x may be beyond the sensor; a vector there must be empty.
    base: Option<(u32, Polarity)>,
    /// Number of events returned so far.
    pub events: u64,
    /// Whether events outside the sensor are counted instead of refused.
    pub leave_out: bool,
}

impl WordDecoder {
    /// Creates a decoder that starts in the time period that contains `start_us`.
    pub fn new(sensor: Sensor, start_us: u64) -> Self {
        Self {
            sensor,
            high: Wrapping::new(TIME_BITS, start_us >> TIME_BITS),
            low: 0,
            t0_us: 0,
            y: None,
            base: None,
            events: 0,
            leave_out: false,
        }
    }

    /// Returns the sensor on which rows and columns must lie.
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the time that the next event would have, once there has been a `TIME_HIGH`.
    pub fn t_us(&self) -> Option<u64> {
        let high = self.high.last()?;
        Some((high << TIME_BITS | u64::from(self.low)) + self.t0_us)
    }

    /// Adds `t_us` to all times from here on.
    pub fn add_us(&mut self, t_us: u64) {
        self.t0_us += t_us;
    }

    /// Appends the events at `x + i` for every set bit i of `bits`.
    fn emit(
        &mut self,
        x: u32,
        bits: u16,
        polarity: Polarity,
        batch: &mut Batch<'_>,
        skipped: &mut Skipped,
    ) -> Result<(), Outside> {
        let (high, y) = match (self.high.last(), self.y) {
            (Some(high), Some(y)) => (high, y),
            (None, _) => {
                skipped.add("events before the first time", u64::from(bits.count_ones()));
                return Ok(());
            }
            (_, None) => {
                skipped.add("events before the first row", u64::from(bits.count_ones()));
                return Ok(());
            }
        };
        let t_us = (high << TIME_BITS | u64::from(self.low)) + self.t0_us;
        let row = Row { t_us, y, polarity };
        let mut bits = bits.into();
        while let Err(outside) = row.emit(x, bits, self.sensor, &mut self.events, batch) {
            if !self.leave_out {
                return Err(outside);
            }
            skipped.add(OUTSIDE, 1);
            self.events += 1;
            bits = outside.left;
        }
        Ok(())
    }

    fn vector(
        &mut self,
        bits: u16,
        width: u32,
        batch: &mut Batch<'_>,
        skipped: &mut Skipped,
    ) -> Result<(), Outside> {
        let Some((x, polarity)) = self.base else {
            skipped.add(
                "events before the first column",
                u64::from(bits.count_ones()),
            );
            return Ok(());
        };
        self.base = Some((x.saturating_add(width), polarity));
        self.emit(x, bits, polarity, batch, skipped)
    }

    /// Decodes words that are plain from the front ([`Plain`]), most of those before the first that is not, puts their
    /// events into `scratch`, and returns what it did: nothing while events have no time, or no row on the sensor.
    fn decode_plain(
        &mut self,
        vectors: Option<Vectors>,
        words: &[[u8; 2]],
        scratch: &mut [Event; RUN_WORDS],
    ) -> Decoded {
        let (high, y) = match (self.high.last(), self.y) {
            (Some(high), Some(y)) if y < self.sensor.height => (high, y),
            _ => {
                return Decoded::NOTHING;
            }
        };
        let mut plain = Plain {
            sensor: self.sensor,
            high: self.high.low(high) as u16,
            high_us: (high << TIME_BITS) + self.t0_us,
            low: self.low,
            y,
        };
        let decoded = match vectors {
            Some(vectors) => vectors.decode(words, &mut plain, scratch),
            None => plain.decode(words, scratch),
        };
        (self.low, self.y) = (plain.low, Some(plain.y));
        self.events += decoded.events as u64;
        decoded
    }

    /// Decodes the next word; the batch must have room for the [`VECTOR_EVENTS`] of a vector.
    // If this is not inlined, it takes half as many instructions again per word. The file reader and the reader of
    // bags each call it in one loop only.
    #[inline(always)]
    pub fn decode(
        &mut self,
        word: u16,
        batch: &mut Batch<'_>,
        skipped: &mut Skipped,
    ) -> Result<(), Outside> {
        let (value, coordinate) = (word & 0xfff, word & 0x7ff);
        let polarity = Polarity::from_bool(word & 0x800 != 0);
        match word >> 12 {
            ADDR_X => match (self.high.last(), self.y) {
                // The most frequent case, without the loop over a vector's bits.
                (Some(high), Some(y)) if self.sensor.contains(coordinate, y) => {
                    batch.push(Event {
                        t_us: (high << TIME_BITS | u64::from(self.low)) + self.t0_us,
                        x: coordinate,
                        y,
                        polarity,
                    });
                    self.events += 1;
                }
                _ => self.emit(u32::from(coordinate), 1, polarity, batch, skipped)?,
            },
            ADDR_Y => self.y = Some(coordinate),
            TIME_LOW => self.low = value,
            TIME_HIGH => {
                let previous = self.high.last();
                if Some(self.high.extend(u64::from(value))) != previous {
                    self.low = 0;
                }
            }
            VECT_BASE_X => self.base = Some((u32::from(coordinate), polarity)),
            VECT_12 => self.vector(value, 12, batch, skipped)?,
            VECT_8 => self.vector(value & 0xff, 8, batch, skipped)?,
            TRIGGER => skipped.add("triggers", 1),
            CONTINUED | 0xf => skipped.add("continued words", 1),
            OTHER => skipped.add("other words", 1),
            _ => skipped.add("unknown words", 1),
        }
        Ok(())
    }
}

impl Plain {
    /// Returns which of the first [`RUN_WORDS`] words are plain.
    ///
    /// The compiler vectorises the loop to eight words at a time.
    fn of(&self, words: &[[u8; 2]]) -> [bool; RUN_WORDS] {
        let mut plain = [false; RUN_WORDS];
        let Sensor { width, height } = self.sensor;
        for (is_plain, word) in plain.iter_mut().zip(words) {
            let word = u16::from_le_bytes(*word);
            let (kind, coordinate) = (word >> 12, word & 0x7ff);
            *is_plain = (kind == ADDR_X) & (coordinate < width)
                | (kind == ADDR_Y) & (coordinate < height)
                | (kind == TIME_LOW)
                | (kind == TRIGGER)
                | (kind & 0x7 == CONTINUED)
                | (kind == OTHER)
                | (word == TIME_HIGH << 12 | self.high);
        }
        plain
    }

    /// Decodes the words up to the first that is not plain, and puts their events into `scratch`.
    ///
    /// The order of the words' types is unpredictable, so nothing here branches on it.
    fn decode(&mut self, words: &[[u8; 2]], scratch: &mut [Event; RUN_WORDS]) -> Decoded {
        let taken = plain_words(&self.of(words));
        let words = words.get(..taken).unwrap_or(words);
        let Self { mut low, mut y, .. } = *self;
        let mut count = 0;
        for word in words {
            let word = u16::from_le_bytes(*word);
            let (kind, coordinate) = (word >> 12, word & 0x7ff);
            // Only an event keeps its slot; the slot of any other word is overwritten.
            if let Some(event) = scratch.get_mut(count) {
                *event = Event {
                    t_us: self.high_us + u64::from(low),
                    x: coordinate,
                    y,
                    polarity: Polarity::from_bool(word & 0x800 != 0),
                };
            }
            count += usize::from(kind == ADDR_X);
            low = select_unpredictable(kind == TIME_LOW, word & 0xfff, low);
            y = select_unpredictable(kind == ADDR_Y, coordinate, y);
        }
        (self.low, self.y) = (low, y);
        Decoded {
            words: words.len(),
            events: count,
            plain_left: 0,
            skipped: skipped_of(words),
        }
    }
}

/// A writer of EVT 3.0 files; five events or more of one row and time become vectors ([`Group`]).
///
/// It holds any times up to 2^60 us, in any order as long as a reader can follow the wraps. Up to 4,096 wraps from
/// time 0 are written out for every reader. Beyond that, the header's `% time_base_us` carries what exceeds 24
/// bits, and readers that do not know it lose only that.
pub struct Evt3Writer {
    raw: RawWriter,
    stated: Stated,
}

impl Evt3Writer {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let bits = (TIME_BITS, TIME_BITS);
        Ok(Self {
            raw: RawWriter::create(path, sensor, raw_header::Words::Evt3, bits)?.walking(WALK_MAX),
            stated: Stated {
                low: 0,
                y: u16::MAX,
            },
        })
    }
}

/// What the words so far have stated: the lower bits of the time, and the row.
#[derive(Debug, Clone, Copy)]
struct Stated {
    low: u16,
    /// Above all rows before the first.
    y: u16,
}

impl Stated {
    /// Returns the words of an event, one after the other, and the number of their bytes: the lower bits of its time and
    /// its row, where they have changed, and `word`. Decoders differ in the low bits that they assume after a new
    /// `TIME_HIGH`, so these are always written then.
    #[inline]
    fn words(&mut self, event: &Event, new_high: bool, word: u16) -> (u64, usize) {
        let low = (event.t_us & 0xfff) as u16;
        let (is_low_due, is_row_due) = (new_high | (low != self.low), event.y != self.y);
        (self.low, self.y) = (low, event.y);
        // What is due is hard to predict, so nothing here branches on it.
        let with = |before: u16, is_due: bool, after: u64| {
            let both = u64::from(before) | after << 16;
            select_unpredictable(is_due, both, after)
        };
        let words = with(ADDR_Y << 12 | event.y, is_row_due, word.into());
        let words = with(TIME_LOW << 12 | low, is_low_due, words);
        (
            words,
            2 * (1 + usize::from(is_low_due) + usize::from(is_row_due)),
        )
    }
}

impl EventWriter for Evt3Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let mut rest = events;
        let width = self.raw.sensor().width;
        while let Some(first) = rest.first() {
            // The most frequent case.
            let mut stated = self.stated;
            let count = self.raw.put_run(rest, |event, later| {
                group::is_single(event, later)
                    .then(|| stated.words(event, false, group::word(event)))
            })?;
            self.stated = stated;
            if count > 0 {
                (_, rest) = rest.split_at(count);
                continue;
            }
            let Some(group) = Group::of(rest, width) else {
                break;
            };
            let (now, later) = rest.split_at(group.events);
            // `high` is below 2^12, and so are the lower bits.
            let time = |high: u64| (TIME_HIGH << 12 | high as u16).to_le_bytes();
            let new_high = self.raw.begin(now, time)?;
            if let Some((word, more)) = group.words().split_first() {
                let (words, bytes) = self.stated.words(first, new_high, *word);
                self.raw.put_first(words.to_le_bytes(), bytes)?;
                for word in more {
                    self.raw.put(&word.to_le_bytes())?;
                }
            }
            rest = later;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.raw.finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::EventReader;

    const SENSOR: Sensor = Sensor {
        width: 64,
        height: 48,
    };

    /// Returns words of every type: rows, columns and vectors mostly on the sensor, and times that change in small
    /// steps.
    fn words() -> impl Strategy<Value = Vec<u16>> {
        let pixel = |side: u16| prop_oneof![9999 => 0..side, 1 => 0..2048_u16];
        let step = prop_oneof![9 => 0..3_u16, 3 => Just(4095_u16), 1 => 0..4096_u16];
        let word = prop_oneof![
            30 => pixel(48).prop_map(|y| (ADDR_Y, y)),
            30 => (pixel(64), 0..2_u16).prop_map(|(x, on)| (ADDR_X, on << 11 | x)),
            20 => (0..4096_u16).prop_map(|low| (TIME_LOW, low)),
            9 => step.prop_map(|step| (TIME_HIGH, step)),
            4 => (0..40_u16, 0..2_u16).prop_map(|(x, on)| (VECT_BASE_X, on << 11 | x)),
            2 => (0..4096_u16).prop_map(|bits| (VECT_12, bits)),
            2 => (0..256_u16).prop_map(|bits| (VECT_8, bits)),
            9 => (0..16_u16, 0..4096_u16).prop_map(|(kind, value)| (kind | 0x7, value)),
            3 => (0..2_u16, 0..4096_u16).prop_map(|(kind, value)| (0xa | kind << 2, value)),
        ];
        proptest::collection::vec(word, 0..3000).prop_map(|words| {
            let mut high = 4090;
            let take = |(kind, value): (u16, u16)| {
                if kind != TIME_HIGH {
                    return kind << 12 | value;
                }
                high = (high + value) & 0xfff;
                kind << 12 | high
            };
            words.into_iter().map(take).collect()
        })
    }

    proptest! {
        /// Also compares what is skipped, and where an error ends the reading.
        #[test]
        fn runs_are_what_their_words_are(words in words()) {
            let header = b"% evt 3.0\n% geometry 64x48\n% end\n";
            let bytes = words.iter().flat_map(|word| word.to_le_bytes());
            let bytes: Vec<u8> = header.iter().copied().chain(bytes).collect();
            let read = |vectors| {
                let source = Box::new(std::io::Cursor::new(bytes.clone()));
                let mut reader = Evt3Reader::new(source, "test", None).unwrap();
                reader.decoder.vectors = vectors;
                let mut events = Vec::new();
                let error = loop {
                    match reader.read(&mut events) {
                        Ok(0) => break None,
                        Ok(_) => {}
                        Err(error) => break Some(error.to_string()),
                    }
                };
                (events, error, reader.skipped().clone())
            };
            let (got, error, found) = read(None);

            let mut decoder = WordDecoder::new(SENSOR, 0);
            let (mut want, mut skipped) = (Vec::new(), Skipped::default());
            let mut batch = Batch::new(&mut want);
            let outside = words
                .iter()
                .position(|word| decoder.decode(*word, &mut batch, &mut skipped).is_err());
            prop_assert_eq!(&got, &want);
            prop_assert_eq!(&found, &skipped);
            prop_assert_eq!(read(Vectors::detected()), (got, error.clone(), found));
            let place = outside.map(|word| format!("byte {}:", header.len() + 2 * word));
            match (error, place) {
                (None, None) => {}
                (Some(error), Some(place)) => prop_assert!(error.contains(&place), "{error} {place}"),
                other => prop_assert!(false, "{other:?}"),
            }
        }
    }
}
