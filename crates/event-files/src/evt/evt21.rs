//! Prophesee RAW with EVT 2.1 words: 64 bits, with vectors of up to 32 columns ([`event_types::evt21`]).
//!
//! Source: "EVT 2.1 Format" in Prophesee's documentation, and the decoder of their OpenEB. x counts from the left
//! and y from the top, as in every RAW file; type 1 is a rise in brightness, ON. The 34 bits of time wrap every
//! 4.8 hours; the wraps are counted as in [`crate::evt::evt2`].
//!
//! The bytes of a word come in one of two orders ([`Order`]). The header states it by `% endianness` or
//! `% format EVT21;endianness=`: `legacy` means the upper half first, `little` the whole word little-endian. If
//! the header does not, the order is inferred from the words: in the right order the values of `EVT_TIME_HIGH`
//! ascend, while in the wrong one a vector's columns stand in their place. OpenEB decides by the board number in
//! the file, which other recorders do not write.
//!
//! Triggers, vendor words and vectors without events are skipped and counted, and so are events before the first
//! `EVT_TIME_HIGH`, which have no time. The reader does not seek: nothing limits the time that passes between two
//! words, so only all words before a place show how often the time has wrapped.

use std::path::Path;

use event_types::evt21::{
    COLUMNS, HIGH_BITS, LOW_BITS, Order, SIDE, TIME_HIGH, TIME_SHIFT, TYPE_SHIFT, X_SHIFT, Y_SHIFT,
    time_high, time_word, vector,
};
use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor};

use crate::evt::header::{self as raw_header, RawFile};
use crate::evt::row::{Outside, Row};
use crate::evt::writer::RawWriter;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::wrapping::Wrapping;
use crate::{EventWriter, Skipped};

/// Number of events that one word can hold.
const WORD_EVENTS: usize = COLUMNS as usize;

/// Number of words from which the byte order is inferred if the header does not state it.
const ORDER_WORDS: usize = 1 << 14;

/// Largest step from one `EVT_TIME_HIGH` to the next that counts in favour of a byte order: 17 minutes.
const STEP_MAX: u64 = 1 << 24;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "evt21",
    title: "Prophesee RAW EVT 2.1",
    endings: &[".evt21.raw", ".evt21"],
    detect: |start| start.holds(raw_header::Words::Evt21),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(Evt21Reader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Evt21Writer::create(path, sensor)?))),
};

/// A reader of EVT 2.1 files.
pub type Evt21Reader = Reader<Evt21Decoder>;

impl Evt21Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the header states no size.
    ///
    /// # Errors
    /// There is no EVT 2.1 header; the sensor's size is unknown; the header's byte order is unknown.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let RawFile {
            mut input,
            header,
            sensor,
            t0_us,
        } = RawFile::open(source, name, size, raw_header::Words::Evt21)?;
        let order = match header.endianness.as_deref() {
            Some("legacy") => Order::UpperFirst,
            Some("little") => Order::Little,
            Some(other) => {
                let what =
                    format!("endianness {other} is not known: write the words as little or legacy");
                return Err(input.error_at(0, what));
            }
            None => order_of_words(&mut input, sensor)?,
        };
        Ok(Self::around(Evt21Decoder {
            input,
            words: Words::default(),
            order,
            sensor,
            camera: header.camera,
            t0_us,
            high: Wrapping::new(HIGH_BITS, header.time_base_us >> LOW_BITS),
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`Evt21Reader`]: its state between two words.
pub struct Evt21Decoder {
    input: Input,
    words: Words<8>,
    order: Order,
    sensor: Sensor,
    camera: Option<String>,
    t0_us: u64,
    /// Counter of time bits 6 and up; it has no value before the first `EVT_TIME_HIGH`.
    high: Wrapping,
    events: u64,
    skipped: Skipped,
}

impl Evt21Decoder {
    /// Appends the events of a vector.
    fn vector(&mut self, word: u64, batch: &mut Batch<'_>) -> Result<()> {
        let columns = word as u32;
        if columns == 0 {
            self.skipped.add("empty vectors", 1);
            return Ok(());
        }
        let Some(high) = self.high.last() else {
            let count = u64::from(columns.count_ones());
            self.skipped.add("events before the first time", count);
            return Ok(());
        };
        let low = word >> TIME_SHIFT & ((1 << LOW_BITS) - 1);
        let t_us = (high << LOW_BITS | low) + self.t0_us;
        let polarity = Polarity::from_bool(word >> TYPE_SHIFT == 1);
        let y = (word >> Y_SHIFT & SIDE) as u16;
        let x = (word >> X_SHIFT & SIDE) as u32;
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

impl Decode for Evt21Decoder {
    fn format(&self) -> &'static str {
        "evt21"
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
        while batch.room() >= WORD_EVENTS {
            let Some(bytes) = self.words.next(&mut self.input)? else {
                break;
            };
            let word = self.order.word(bytes);
            match word >> TYPE_SHIFT {
                0 | 1 => self.vector(word, batch)?,
                TIME_HIGH => {
                    self.high.extend(time_high(word));
                }
                0xa => self.skipped.add("triggers", 1),
                0xe => self.skipped.add("other words", 1),
                0xf => self.skipped.add("continued words", 1),
                _ => self.skipped.add("unknown words", 1),
            }
        }
        Ok(())
    }
}

/// Returns the byte order that fits the first words best; leaves the input where it is.
fn order_of_words(input: &mut Input, sensor: Sensor) -> Result<Order> {
    let start = input.offset();
    let mut words = Words::<8>::default();
    let orders = [Order::Little, Order::UpperFirst];
    let mut evidence = orders.map(|order| Evidence::new(order, sensor));
    for _ in 0..ORDER_WORDS {
        // The reader will meet the damage again, after the events before it.
        let Ok(Some(bytes)) = words.next(input) else {
            break;
        };
        for evidence in &mut evidence {
            evidence.take(bytes);
        }
    }
    input.seek(start)?;
    let [little, upper_first] = evidence.map(|evidence| evidence.score);
    Ok(match upper_first > little {
        true => Order::UpperFirst,
        false => Order::Little,
    })
}

/// Evidence for or against one byte order.
struct Evidence {
    order: Order,
    sensor: Sensor,
    last: Option<u64>,
    /// Number of ascending times, minus the number of words that no sensor sends.
    score: i64,
}

impl Evidence {
    const fn new(order: Order, sensor: Sensor) -> Self {
        Self {
            order,
            sensor,
            last: None,
            score: 0,
        }
    }

    fn take(&mut self, bytes: [u8; 8]) {
        let word = self.order.word(bytes);
        self.score += match word >> TYPE_SHIFT {
            0 | 1 => {
                let x = (word >> X_SHIFT & SIDE) as u16;
                let y = (word >> Y_SHIFT & SIDE) as u16;
                -i64::from(!self.sensor.contains(x, y))
            }
            TIME_HIGH => {
                let high = time_high(word);
                let last = self.last.replace(high);
                match last.map(|last| high.checked_sub(last)) {
                    // The first or a repeated time.
                    None | Some(Some(0)) => 0,
                    Some(Some(step)) if step <= STEP_MAX => 1,
                    // A step back, a wrap, or not a time at all.
                    Some(_) => -1,
                }
            }
            0xa | 0xe | 0xf => 0,
            _ => -1,
        };
    }
}

/// A writer of EVT 2.1 files with little-endian words; neighbouring events in one row share a word.
///
/// It can hold the same events as [`crate::evt::evt2::Evt2Writer`].
pub struct Evt21Writer(RawWriter);

impl Evt21Writer {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let bits = (HIGH_BITS, LOW_BITS);
        RawWriter::create(path, sensor, raw_header::Words::Evt21, bits).map(Self)
    }
}

impl EventWriter for Evt21Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let order = Order::Little;
        let mut rest = events;
        while !rest.is_empty() {
            let (count, word) = vector(rest);
            let (now, later) = rest.split_at(count);
            self.0.begin(now, |high| order.bytes(time_word(high)))?;
            self.0.put(&order.bytes(word))?;
            rest = later;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.0.finish()
    }
}
