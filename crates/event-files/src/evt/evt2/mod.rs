//! Prophesee RAW with EVT 2.0 words: 32 bits, little-endian, with the type in the upper four.
//!
//! [`event_types::evt2`] decodes the words, here and on a microcontroller. Words that are not events (triggers,
//! vendor words) are skipped and counted, and so are events before the first `TIME_HIGH`, which have no time.
//! There is no maintained crate for EVT 2.0.
//!
//! The reader does not seek. The file has no index, and although every `TIME_HIGH` restates the 34 bits of time,
//! only the words before it show how often they have wrapped, once in 4.8 hours. Two `TIME_HIGH` far apart look
//! alike whether or not there is a wrap between them, and no definition limits how many words may be skipped
//! safely.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod avx2;

use std::hint::select_unpredictable;
use std::path::Path;

use event_types::evt2::{Evt2Decoder as WordDecoder, Word};
use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor};

use crate::evt::header as raw_header;
use crate::evt::header::RawFile;
use crate::evt::writer::RawWriter;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::word_runs::{NO_EVENT, RUN_WORDS, plain_words};
use crate::{EventWriter, Skipped};

const TIME_HIGH: u32 = 0x8;
const TIME_HIGH_BITS: u32 = 28;
const HIGH_MASK: u32 = (1 << TIME_HIGH_BITS) - 1;
const TIME_LOW_BITS: u32 = 6;
/// 4.8 hours, after which the time bits wrap.
const PERIOD_US: u64 = 1 << (TIME_HIGH_BITS + TIME_LOW_BITS);

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "evt2",
    title: "Prophesee RAW EVT 2",
    endings: &[".evt2.raw", ".evt2"],
    detect: |start| start.holds(raw_header::Words::Evt2),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(Evt2Reader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Evt2Writer::create(path, sensor)?))),
};

/// A reader of EVT 2.0 files.
pub type Evt2Reader = Reader<Evt2Decoder>;

impl Evt2Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the header states no size.
    ///
    /// # Errors
    /// There is no EVT 2.0 header, or the sensor's size is unknown.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let RawFile {
            input,
            header,
            sensor,
            t0_us,
        } = RawFile::open(source, name, size, raw_header::Words::Evt2)?;
        let base_us = header.time_base_us - header.time_base_us % PERIOD_US;
        Ok(Self::around(Evt2Decoder {
            input,
            words: Words::default(),
            camera: header.camera,
            vectors: Vectors::detected(),
            state: State {
                sensor,
                decoder: WordDecoder::new(base_us + t0_us),
                events: 0,
                skipped: Skipped::default(),
            },
        }))
    }
}

/// The decoder of [`Evt2Reader`]: its state between two words.
pub struct Evt2Decoder {
    input: Input,
    words: Words<4>,
    camera: Option<String>,
    vectors: Option<Vectors>,
    state: State,
}

/// What the words so far have stated, and what they held.
struct State {
    sensor: Sensor,
    decoder: WordDecoder,
    events: u64,
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

    fn decode(self, _: &[[u8; 4]], _: u64, _: u32, _: Sensor, _: &mut [Event]) -> Decoded {
        match self {}
    }
}

/// What was decoded of a run of words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Decoded {
    /// Number of words.
    words: usize,
    /// Number of events among them.
    events: usize,
    /// Upper time bits after them.
    high: u32,
}

impl Decode for Evt2Decoder {
    fn format(&self) -> &'static str {
        "evt2"
    }

    fn sensor(&self) -> Sensor {
        self.state.sensor
    }

    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
    }

    fn skipped(&self) -> &Skipped {
        &self.state.skipped
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.input.leave_out_bad_events();
        true
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        let mut scratch = [NO_EVENT; RUN_WORDS];
        while batch.room() > 0 {
            let most = batch.room().min(RUN_WORDS);
            let (offset, run) = self.words.run(&mut self.input, most)?;
            if run.is_empty() {
                break;
            }
            let (mut taken, mut few) = (0, FEW);
            while let Some(rest) = run.get(taken..).filter(|rest| !rest.is_empty()) {
                let decoded = self.state.decode_plain(self.vectors, rest, &mut scratch);
                batch.extend(scratch.iter().take(decoded.events).copied());
                taken += decoded.words;
                // Words that are not plain come together: the more of them, the more are decoded one by one.
                few = if decoded.words > 0 { FEW } else { 2 * few };
                let rest = run.get(taken..).unwrap_or_default();
                let rest = rest.get(..few).unwrap_or(rest);
                let offset = offset + 4 * taken as u64;
                self.state.decode_each(rest, offset, &self.input, batch)?;
                taken += rest.len();
            }
        }
        Ok(())
    }
}

/// Number of words that are decoded one by one where one is not plain.
const FEW: usize = 8;

impl State {
    /// Decodes words that are plain from the front ([`plain`]), most of those before the first that is not, puts their
    /// events into `scratch`, and returns what it did.
    fn decode_plain(
        &mut self,
        vectors: Option<Vectors>,
        words: &[[u8; 4]],
        scratch: &mut [Event; RUN_WORDS],
    ) -> Decoded {
        let Some((start, start_us)) = self.decoder.time_high() else {
            return Decoded {
                words: 0,
                events: 0,
                high: 0,
            };
        };
        // All plain times lie within half a period after the decoder's time, so no step between two of them is a wrap.
        let zero_us = start_us.wrapping_sub(u64::from(start) << TIME_LOW_BITS);
        let sensor = self.sensor;
        let decoded = match vectors {
            Some(vectors) => vectors.decode(words, zero_us, start, sensor, scratch),
            None => decode_plain(words, zero_us, start, sensor, scratch),
        };
        if decoded.high != start {
            self.decoder.decode(TIME_HIGH << 28 | decoded.high);
        }
        self.events += decoded.events as u64;
        decoded
    }

    /// Decodes words of any type one by one, the first of which lies at byte `offset`.
    fn decode_each(
        &mut self,
        words: &[[u8; 4]],
        offset: u64,
        input: &Input,
        batch: &mut Batch<'_>,
    ) -> Result<()> {
        for (index, word) in words.iter().enumerate() {
            let word = u32::from_le_bytes(*word);
            match self.decoder.decode(word) {
                Word::Event(Event { x, y, .. }) if !self.sensor.contains(x, y) => {
                    let offset = offset + 4 * index as u64;
                    let (pixel, skipped) = ((i64::from(x), i64::from(y)), &mut self.skipped);
                    input.outside(offset, self.events, pixel, self.sensor, skipped)?;
                    self.events += 1;
                }
                Word::Event(event) => {
                    batch.push(event);
                    self.events += 1;
                }
                Word::Time => {}
                Word::Untimed => self.skipped.add("events before the first time", 1),
                Word::Other => self.skipped.add(
                    match word >> 28 {
                        0xa => "triggers",
                        0xe => "other words",
                        0xf => "continued words",
                        _ => "unknown words",
                    },
                    1,
                ),
            }
        }
        Ok(())
    }
}

/// Returns which of the first [`RUN_WORDS`] words are plain: events inside the sensor, and times less than half a
/// period after `start`.
///
/// The compiler vectorises the loop to four words at a time.
fn plain(start: u32, sensor: Sensor, words: &[[u8; 4]]) -> [bool; RUN_WORDS] {
    let mut plain = [false; RUN_WORDS];
    let (width, height) = (u32::from(sensor.width), u32::from(sensor.height));
    for (is_plain, word) in plain.iter_mut().zip(words) {
        let word = u32::from_le_bytes(*word);
        let (x, y) = (word >> 11 & 0x7ff, word & 0x7ff);
        // A step back underflows to more than 2^28.
        let step = (word & HIGH_MASK).wrapping_sub(start);
        *is_plain = (word >> 29 == 0) & (x < width) & (y < height)
            | (word >> 28 == TIME_HIGH) & (step >> (TIME_HIGH_BITS - 1) == 0);
    }
    plain
}

/// Decodes the words up to the first that is not plain according to [`plain`], and puts their events into `scratch`.
///
/// The order of the words' types is unpredictable, so nothing here branches on it.
fn decode_plain(
    words: &[[u8; 4]],
    zero_us: u64,
    start: u32,
    sensor: Sensor,
    scratch: &mut [Event; RUN_WORDS],
) -> Decoded {
    let plain = plain(start, sensor, words);
    let mut high = start;
    let words = words.get(..plain_words(&plain)).unwrap_or(words);
    let mut events = 0;
    for word in words {
        let word = u32::from_le_bytes(*word);
        // Only an event keeps its slot; the slot of any other word is overwritten.
        if let Some(event) = scratch.get_mut(events) {
            let low_us = u64::from(word >> 22 & 0x3f);
            *event = Event {
                t_us: zero_us.wrapping_add(u64::from(high) << TIME_LOW_BITS | low_us),
                x: (word >> 11 & 0x7ff) as u16,
                y: (word & 0x7ff) as u16,
                polarity: Polarity::from_bool(word >> 28 == 1),
            };
        }
        let is_time = word >> 28 == TIME_HIGH;
        high = select_unpredictable(is_time, word & HIGH_MASK, high);
        events += usize::from(!is_time);
    }
    Decoded {
        words: words.len(),
        events,
        high,
    }
}

/// A writer of EVT 2.0 files.
///
/// It holds any times up to 2^60 us, in any order as long as a reader can follow the wraps. Up to 4,096 wraps from
/// time 0 are written out for every reader. Beyond that, the header's `% time_base_us` carries what exceeds 34
/// bits, and readers that do not know it lose only that.
pub struct Evt2Writer(RawWriter);

impl Evt2Writer {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let bits = (TIME_HIGH_BITS, TIME_LOW_BITS);
        RawWriter::create(path, sensor, raw_header::Words::Evt2, bits).map(Self)
    }
}

impl EventWriter for Evt2Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        // `high` is below 2^28.
        let time = |high: u64| TIME_HIGH << 28 | high as u32;
        let word = |event: &Event| {
            u32::from(event.polarity == Polarity::On) << 28
                | ((event.t_us & 0x3f) as u32) << 22
                | u32::from(event.x) << 11
                | u32::from(event.y)
        };
        let mut rest = events;
        while let Some((first, later)) = rest.split_first() {
            // The most frequent case.
            let count = self.0.put_while(rest, time, word)?;
            if count > 0 {
                (_, rest) = rest.split_at(count);
                continue;
            }
            let first = std::slice::from_ref(first);
            self.0.begin(first, |high| time(high).to_le_bytes())?;
            for event in first {
                self.0.put(&word(event).to_le_bytes())?;
            }
            rest = later;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.0.finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::EventReader;
    use crate::wrapping::Wrapping;

    /// Returns words of every type: mostly events on 64 x 48 pixels, and times that change in small steps.
    fn words() -> impl Strategy<Value = Vec<u32>> {
        let event = (0..2_u32, 0..64_u32, 0..64_u32, 0..48_u32)
            .prop_map(|(kind, low, x, y)| kind << 28 | low << 22 | x << 11 | y);
        let step = prop_oneof![
            9 => -2..4_i32,
            1 => prop_oneof![
                (1 << 27) - 2..(1 << 27) + 2_i32,
                -(1 << 20) - 3..-(1 << 20) + 3_i32,
                0..1 << 28_i32,
            ],
        ];
        let word = prop_oneof![
            60 => event.prop_map(|word| (word, 0)),
            20 => step.prop_map(|step| (TIME_HIGH << 28, step)),
            1 => any::<u32>().prop_map(|word| (word & 0x3fff_ffff | 0xe << 28, 0)),
        ];
        proptest::collection::vec(word, 0..3000).prop_map(|words| {
            let mut high = HIGH_MASK - 9;
            let take = |(word, step): (u32, i32)| {
                if word >> 28 != TIME_HIGH {
                    return word;
                }
                high = high.wrapping_add_signed(step) & HIGH_MASK;
                word | high
            };
            words.into_iter().map(take).collect()
        })
    }

    proptest! {
        #[test]
        fn runs_are_what_the_core_makes_of_their_words(words in words()) {
            let header = b"% evt 2.0\n% geometry 64x48\n% end\n";
            let bytes = words.iter().flat_map(|word| word.to_le_bytes());
            let bytes: Vec<u8> = header.iter().copied().chain(bytes).collect();
            let read = |vectors| {
                let source = Box::new(std::io::Cursor::new(bytes.clone()));
                let mut reader = Evt2Reader::new(source, "test", None).unwrap();
                reader.decoder.vectors = vectors;
                let mut events = Vec::new();
                while reader.read(&mut events).unwrap() > 0 {}
                (events, reader.skipped().clone())
            };
            let (got, skipped) = read(None);
            let mut decoder = WordDecoder::new(0);
            let decoded = words.iter().filter_map(|word| match decoder.decode(*word) {
                Word::Event(event) => Some(event),
                _ => None,
            });
            let want: Vec<Event> = decoded.collect();
            prop_assert_eq!(&got, &want);
            prop_assert_eq!(read(Vectors::detected()), (got, skipped));
        }

        /// The writer uses its own counter to find out how a reader will interpret a time.
        #[test]
        fn the_writers_counter_agrees_with_the_decoder(
            periods in 0..3_u64,
            highs in proptest::collection::vec(
                prop_oneof![
                    0..1_u32 << TIME_HIGH_BITS,
                    0..9_u32,
                    (0..9_u32).prop_map(|below| (1 << TIME_HIGH_BITS) - 1 - below),
                    (0..9_u32).prop_map(|above| (1 << (TIME_HIGH_BITS - 1)) - 4 + above),
                    (0..9_u32).prop_map(|above| (1 << TIME_HIGH_BITS) - (1 << 20) - 4 + above),
                ],
                1..50,
            ),
        ) {
            let mut counter = Wrapping::new(TIME_HIGH_BITS, periods << TIME_HIGH_BITS);
            let mut decoder = WordDecoder::new(periods * PERIOD_US);
            for high in highs {
                prop_assert_eq!(decoder.decode(TIME_HIGH << 28 | high), Word::Time);
                let Word::Event(event) = decoder.decode(0) else {
                    return Err(TestCaseError::fail("no event"));
                };
                prop_assert_eq!(event.t_us, counter.extend(u64::from(high)) << TIME_LOW_BITS);
            }
        }
    }
}
