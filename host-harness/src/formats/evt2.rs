//! Prophesee RAW with EVT 2.0 words: 32 bits, little-endian, the type in the upper four.
//!
//! The core's [`eecvs_nostd::evt2`] decodes the words, here and on a microcontroller. Words that are
//! no events (triggers, vendor words) are skipped and counted; so is an event before the first
//! `TIME_HIGH`, which has no time. There is no maintained crate for EVT 2.0.

use std::path::Path;

use eecvs_nostd::evt2::{Evt2Decoder as WordDecoder, Word};
use eecvs_nostd::{Event, Polarity, Sensor};

use super::format::{Format, Limits, Opening};
use super::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use super::raw_header::{self, RawFile};
use super::raw_writer::RawWriter;
use super::{EventWriter, Skipped};

const TIME_HIGH: u32 = 0x8;
const TIME_HIGH_BITS: u32 = 28;
const TIME_LOW_BITS: u32 = 6;
/// 4.8 hours.
const PERIOD_US: u64 = 1 << (TIME_HIGH_BITS + TIME_LOW_BITS);

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "evt2",
    title: "Prophesee RAW EVT 2",
    endings: &[".evt2.raw", ".evt2"],
    detect: |start| start.holds(raw_header::Words::Evt2),
    open: |Opening {
               source, name, size, ..
           }| Ok(Box::new(Evt2Reader::new(source, name, size)?)),
    has_places: false,
    grows: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Evt2Writer::create(path, sensor)?))),
};

/// Reader of EVT 2.0 files.
pub type Evt2Reader = Reader<Evt2Decoder>;

impl Evt2Reader {
    /// Reads `source`, which messages call `name`; `size` counts where the header names no size.
    ///
    /// # Errors
    /// No EVT 2.0 header, no sensor size.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
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
            sensor,
            camera: header.camera,
            decoder: WordDecoder::new(base_us + t0_us),
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// State between two words.
pub struct Evt2Decoder {
    input: Input,
    words: Words<4>,
    sensor: Sensor,
    camera: Option<String>,
    decoder: WordDecoder,
    events: u64,
    skipped: Skipped,
}

impl Decode for Evt2Decoder {
    fn format(&self) -> &'static str {
        "evt2"
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

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        while batch.room() > 0 {
            let Some(word) = self.words.next(&mut self.input)? else {
                break;
            };
            let word = u32::from_le_bytes(word);
            match self.decoder.decode(word) {
                Word::Event(event) => {
                    let Event { x, y, .. } = event;
                    if !self.sensor.contains(x, y) {
                        let offset = self.words.offset(&self.input);
                        let (x, y) = (i64::from(x), i64::from(y));
                        return Err(self.input.outside(offset, self.events, x, y, self.sensor));
                    }
                    self.events += 1;
                    batch.push(event);
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

/// Writer of EVT 2.0 files.
///
/// Holds any times up to 2^60 us, in any order as long as a reader can follow the wraps. Up to
/// 4,096 wraps from time 0 are written out, for any reader; beyond that the header's
/// `% time_base_us` carries what exceeds 34 bits, and other readers lose only that.
pub struct Evt2Writer(RawWriter);

impl Evt2Writer {
    /// Creates the file.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> anyhow::Result<Self> {
        let bits = (TIME_HIGH_BITS, TIME_LOW_BITS);
        RawWriter::create(path, sensor, raw_header::Words::Evt2, bits).map(Self)
    }
}

impl EventWriter for Evt2Writer {
    fn write(&mut self, events: &[Event]) -> anyhow::Result<()> {
        for event in events {
            // Below 2^28.
            let time = |high: u64| (TIME_HIGH << 28 | high as u32).to_le_bytes();
            self.0.begin(std::slice::from_ref(event), time)?;
            let word = u32::from(event.polarity == Polarity::On) << 28
                | ((event.t_us & 0x3f) as u32) << 22
                | u32::from(event.x) << 11
                | u32::from(event.y);
            self.0.put(&word.to_le_bytes())?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> anyhow::Result<()> {
        self.0.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::super::wrapping::Wrapping;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The writer asks its own counter what a reader will make of a time.
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
