//! Prophesee RAW with EVT 4.0 words: 32 bits, little-endian, with the type in the upper four.
//!
//! | type | bits 27..22 | 21..11 | 10..0 |
//! |---|---|---|---|
//! | A `CD_OFF`, B `CD_ON` | time bits 5..0 | x | y |
//! | C `CD_VEC_OFF`, D `CD_VEC_ON` | time bits 5..0 | first x | y |
//! | E `EVT_TIME_HIGH` | time bits 33..6 (28 bits) |||
//! | 9 `EXT_TRIGGER`, 6 `OTHER`, 7 `CONTINUED`, F padding | skipped and counted |||
//!
//! A word of type C or D is followed by a word of 32 columns without a type: bit i set means an event at x + i.
//! Source: the decoder and the event types of Prophesee's OpenEB, as there is no document yet. Origin, polarity
//! and the 34 bits of time are those of [`crate::evt::evt2`]; the wraps are counted. Events before the first
//! `EVT_TIME_HIGH` have no time: they are skipped and counted.
//!
//! OpenEB's robust decoder drops a vector whose 32 columns do not all lie on the sensor, even if no event is
//! outside; the writer therefore starts no vector within the last 31 columns. It also drops the events after an
//! `EVT_TIME_HIGH` that is 1,000 us or more after the previous one, until another one confirms it; the writer
//! therefore writes such an `EVT_TIME_HIGH` twice. The reader does not seek, for the reasons given in
//! [`crate::evt::evt21`]; besides, in the middle of a file a word of columns looks like any other.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor};

use crate::evt::header as raw_header;
use crate::evt::header::RawFile;
use crate::evt::row::{Outside, Row};
use crate::evt::vector::Run;
use crate::evt::writer::RawWriter;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::wrapping::Wrapping;
use crate::{EventWriter, Skipped};

const CD_OFF: u32 = 0xa;
const CD_ON: u32 = 0xb;
const CD_VEC_OFF: u32 = 0xc;
const CD_VEC_ON: u32 = 0xd;
const TIME_HIGH: u32 = 0xe;
const TYPE_SHIFT: u32 = 28;
const HIGH_BITS: u32 = 28;
const LOW_BITS: u32 = 6;
const LOW_SHIFT: u32 = 22;
const X_SHIFT: u32 = 11;
const SIDE: u32 = 0x7ff;

/// Number of events that one vector can hold.
const VECTOR_EVENTS: usize = 32;

/// Smallest step of `EVT_TIME_HIGH` that OpenEB's robust decoder doubts, in units of 64 us: 1,000 us.
const TIME_JUMP: u64 = 1000_u64.div_ceil(1 << LOW_BITS);

/// Number of events from which on a vector of two words is shorter than one word per event.
const VECTOR_MIN: usize = 3;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "evt4",
    title: "Prophesee RAW EVT 4",
    endings: &[".evt4.raw", ".evt4"],
    detect: |start| start.holds(raw_header::Words::Evt4),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(Evt4Reader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Evt4Writer::create(path, sensor)?))),
};

/// A reader of EVT 4.0 files.
pub type Evt4Reader = Reader<Evt4Decoder>;

impl Evt4Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the header states no size.
    ///
    /// # Errors
    /// There is no EVT 4.0 header, or the sensor's size is unknown.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let RawFile {
            input,
            header,
            sensor,
            t0_us,
        } = RawFile::open(source, name, size, raw_header::Words::Evt4)?;
        Ok(Self::around(Evt4Decoder {
            input,
            words: Words::default(),
            sensor,
            camera: header.camera,
            t0_us,
            high: Wrapping::new(HIGH_BITS, header.time_base_us >> LOW_BITS),
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`Evt4Reader`]: its state between two words.
pub struct Evt4Decoder {
    input: Input,
    words: Words<4>,
    sensor: Sensor,
    camera: Option<String>,
    t0_us: u64,
    /// Counter of time bits 6 and up; it has no value before the first `EVT_TIME_HIGH`.
    high: Wrapping,
    events: u64,
    skipped: Skipped,
}

impl Evt4Decoder {
    fn next(&mut self) -> Result<Option<u32>> {
        let bytes = self.words.next(&mut self.input)?;
        Ok(bytes.map(u32::from_le_bytes))
    }

    /// Appends the events at x + i of `word` for every set bit i of `columns`.
    fn emit(&mut self, word: u32, columns: u32, batch: &mut Batch<'_>) -> Result<()> {
        let Some(high) = self.high.last() else {
            let count = u64::from(columns.count_ones());
            self.skipped.add("events before the first time", count);
            return Ok(());
        };
        let low = word >> LOW_SHIFT & ((1 << LOW_BITS) - 1);
        let t_us = (high << LOW_BITS | u64::from(low)) + self.t0_us;
        // The types of ON events are odd.
        let polarity = Polarity::from_bool(word >> TYPE_SHIFT & 1 == 1);
        let y = (word & SIDE) as u16;
        let x = word >> X_SHIFT & SIDE;
        let row = Row { t_us, y, polarity };
        let mut columns = columns;
        while let Err(outside) = row.emit(x, columns, self.sensor, &mut self.events, batch) {
            let Outside { x, y, left } = outside;
            let (offset, pixel) = (self.words.offset(&self.input), (x.into(), y.into()));
            self.input
                .outside(offset, self.events, pixel, self.sensor, &mut self.skipped)?;
            self.events += 1;
            columns = left;
        }
        Ok(())
    }
}

impl Decode for Evt4Decoder {
    fn format(&self) -> &'static str {
        "evt4"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.input.leave_out_bad_events();
        true
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() >= VECTOR_EVENTS {
            let Some(word) = self.next()? else {
                break;
            };
            match word >> TYPE_SHIFT {
                CD_OFF | CD_ON => self.emit(word, 1, batch)?,
                CD_VEC_OFF | CD_VEC_ON => match self.next()? {
                    Some(0) => self.skipped.add("empty vectors", 1),
                    Some(columns) => self.emit(word, columns, batch)?,
                    None => {
                        let what = "the file ends before the columns of a vector: truncated";
                        return Err(self.input.error(what));
                    }
                },
                TIME_HIGH => {
                    let high = word & ((1 << HIGH_BITS) - 1);
                    self.high.extend(u64::from(high));
                }
                0x9 => self.skipped.add("triggers", 1),
                0x6 => self.skipped.add("other words", 1),
                0x7 => self.skipped.add("continued words", 1),
                0xf => self.skipped.add("padding", 1),
                _ => self.skipped.add("unknown words", 1),
            }
        }
        Ok(())
    }
}

/// A writer of EVT 4.0 files; runs of at least three events in one row become vectors.
///
/// It can hold the same events as [`crate::evt::evt2::Evt2Writer`].
pub struct Evt4Writer(RawWriter);

impl Evt4Writer {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let bits = (HIGH_BITS, LOW_BITS);
        let raw = RawWriter::create(path, sensor, raw_header::Words::Evt4, bits)?;
        Ok(Self(raw.confirming(TIME_JUMP)))
    }

    fn word(&mut self, word: u32) -> Result<()> {
        self.0.put(&word.to_le_bytes())
    }
}

impl EventWriter for Evt4Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let mut rest = events;
        while let Some(first) = rest.first() {
            let run = Run::of(rest, self.0.sensor().width);
            let (now, later) = rest.split_at(run.count);
            // `high` is below 2^28.
            let time = |high: u64| (TIME_HIGH << TYPE_SHIFT | high as u32).to_le_bytes();
            self.0.begin(now, time)?;
            let on = u32::from(first.polarity == Polarity::On);
            let low = (first.t_us & ((1 << LOW_BITS) - 1)) as u32;
            let rest_of = |x: u16| low << LOW_SHIFT | u32::from(x) << X_SHIFT | u32::from(first.y);
            if run.count >= VECTOR_MIN {
                self.word((CD_VEC_OFF + on) << TYPE_SHIFT | rest_of(run.x))?;
                self.word(run.columns)?;
            } else {
                for event in now {
                    self.word((CD_OFF + on) << TYPE_SHIFT | rest_of(event.x))?;
                }
            }
            rest = later;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.0.finish()
    }
}
