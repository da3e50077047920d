//! N-MNIST and N-Caltech101 files (`.bin`): 5-byte records and nothing else.
//!
//! | bits of a record, from the first byte's highest on | content |
//! |---|---|
//! | 8 | x |
//! | 8 | y, downwards; 240, the row below the ATIS sensor's last, marks 8,192 us that pass, not an event |
//! | 1 | polarity: 1 is on |
//! | 23 | time in microseconds, highest byte first |
//!
//! Times have 23 bits, 8.4 s, and count from the recording's start; every record with y = 240 adds 8,192 us to the
//! times after it. Times may step back, as nothing forbids it. Source: the data sets' page (Orchard, Jayawant,
//! Cohen, Thakor; 2015) and the reader offered there, `eventvision.py`, on which tonic's is based. The MATLAB
//! reader offered with it takes a record with y = 240 for an event; the data sets' own recordings have none.
//!
//! The file does not state the sensor's size. If the caller does not either, a first pass decides: N-MNIST's 34 x
//! 34 if every event fits or there are none, as not every digit reaches the border; otherwise the largest x and y,
//! plus one, as in `eventvision.py`. Only the ending of the file's name identifies the format. There is no index,
//! and each time depends on all records before it, so the reader does not seek.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor, error};

use crate::fit::beyond;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::output::sequential::Output;
use crate::{Assumption, EventWriter, Skipped, check_inside};

/// The y of a record that lets time pass instead of being an event.
const OVERFLOW_Y: u8 = 240;

/// Time that such a record lets pass.
const OVERFLOW_US: u64 = 1 << 13;

const TIME_BITS: u32 = 23;

/// Width and height of N-MNIST's recordings.
const SIDE: u16 = 34;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "nmnist",
    title: "N-MNIST",
    endings: &[".bin"],
    detect: |start| start.is_named(".bin"),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(NmnistReader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits {
        x_max: u8::MAX as u16,
        y_max: OVERFLOW_Y as u16 - 1,
        t_max_us: (1 << TIME_BITS) - 1,
        steps_back: true,
    },
    create: Some(|path, sensor| Ok(Box::new(NmnistWriter::create(path, sensor)?))),
};

/// A reader of N-MNIST's `.bin` files.
pub type NmnistReader = Reader<NmnistDecoder>;

impl NmnistReader {
    /// Reads `source`, which messages call `name`; without a `size`, all of it is first searched for the largest x
    /// and y.
    ///
    /// # Errors
    /// I/O.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let mut assumptions = Vec::new();
        let sensor = match size {
            Some(sensor) => sensor,
            None => {
                let sensor = largest(&mut input)?;
                assumptions.push(Assumption::size_taken(sensor));
                sensor
            }
        };
        Ok(Self::around(NmnistDecoder {
            input,
            words: Words::default(),
            sensor,
            assumptions,
            passed_us: 0,
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// Returns N-MNIST's size, or else one that holds every event; leaves the input at its start.
fn largest(input: &mut Input) -> Result<Sensor> {
    let mut words = Words::<5>::default();
    let (mut width, mut height) = (0, 0);
    // The reader reports damage later, after the events before it.
    while let Ok(Some([x, y, ..])) = words.next(input) {
        if y != OVERFLOW_Y {
            width = width.max(u16::from(x) + 1);
            height = height.max(u16::from(y) + 1);
        }
    }
    input.seek(0)?;
    if width <= SIDE && height <= SIDE {
        (width, height) = (SIDE, SIDE);
    }
    Sensor::new(width, height).ok_or_else(|| input.error_at(0, "damaged file"))
}

/// The decoder of [`NmnistReader`]: its state between two records.
pub struct NmnistDecoder {
    input: Input,
    words: Words<5>,
    sensor: Sensor,
    assumptions: Vec<Assumption>,
    /// Time passed by records with y = 240; added to every time that follows.
    passed_us: u64,
    events: u64,
    skipped: Skipped,
}

impl Decode for NmnistDecoder {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.input.leave_out_bad_events();
        true
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() > 0 {
            let Some([x, y, high, middle, low]) = self.words.next(&mut self.input)? else {
                break;
            };
            if y == OVERFLOW_Y {
                self.passed_us += OVERFLOW_US;
                self.skipped.add("overflows", 1);
                continue;
            }
            let time = u32::from_be_bytes([0, high & 0x7f, middle, low]);
            let event = Event {
                t_us: self.passed_us + u64::from(time),
                x: x.into(),
                y: y.into(),
                polarity: Polarity::from_bool(high & 0x80 != 0),
            };
            if !self.sensor.contains(event.x, event.y) {
                let offset = self.words.offset(&self.input);
                let (pixel, skipped) = ((x.into(), y.into()), &mut self.skipped);
                self.input
                    .outside(offset, self.events, pixel, self.sensor, skipped)?;
                self.events += 1;
                continue;
            }
            batch.push(event);
            self.events += 1;
        }
        Ok(())
    }
}

/// A writer of N-MNIST's `.bin` files. It writes no record with y = 240, which some readers do not know, so times
/// are limited to 23 bits.
pub struct NmnistWriter {
    file: Output,
    sensor: Sensor,
    events: u64,
}

impl NmnistWriter {
    /// Creates the file, which is empty until events are written.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let file = Output::create(path)?;
        Ok(Self {
            file,
            sensor,
            events: 0,
        })
    }

    /// Returns the record of an event, or `None` if the format cannot hold it.
    fn record(event: &Event) -> Option<[u8; 5]> {
        let [x, y] = [event.x, event.y].map(u8::try_from);
        let time = u32::try_from(event.t_us).ok()?;
        if time >> TIME_BITS > 0 {
            return None;
        }
        let [_, high, middle, low] = time.to_be_bytes();
        let on = u8::from(event.polarity == Polarity::On) << 7;
        let y = y.ok().filter(|y| *y < OVERFLOW_Y)?;
        Some([x.ok()?, y, on | high, middle, low])
    }
}

impl EventWriter for NmnistWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            check_inside(self.file.name(), self.events, event, self.sensor)?;
            let record = Self::record(event).ok_or_else(|| {
                let what = beyond(FORMAT.limits, self.events, *event, None).unwrap_or_default();
                error!(CannotHold, "{}: {what}: write .aedat4", self.file.name())
            })?;
            self.file.put(&record)?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.file.finish()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::EventReader;

    fn read(bytes: &[u8], size: Option<Sensor>) -> (Sensor, Vec<Event>, NmnistReader) {
        let mut reader =
            NmnistReader::new(Box::new(Cursor::new(bytes.to_vec())), "test", size).unwrap();
        let mut events = Vec::new();
        reader.read(&mut events).unwrap();
        (reader.sensor(), events, reader)
    }

    #[test]
    fn overflows_add_to_every_time_behind_them() {
        let bytes = [
            [3, 4, 0x80, 1, 2],
            [0, 240, 0, 0, 0],
            [33, 239, 0x7f, 0xff, 0xff],
            [9, 240, 0x80, 7, 7],
            [1, 241, 0, 0, 1],
        ];
        let (sensor, events, reader) = read(bytes.as_flattened(), None);
        assert_eq!((sensor.width, sensor.height), (34, 242));
        let event = |t_us, x, y, on| Event {
            t_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        };
        let want = [
            event(258, 3, 4, true),
            event(8_388_607 + 8_192, 33, 239, false),
            event(1 + 2 * 8_192, 1, 241, false),
        ];
        assert_eq!(events, want);
        let mut overflows = Skipped::default();
        overflows.add("overflows", 2);
        assert_eq!(reader.skipped(), &overflows);
    }

    #[test]
    fn what_is_before_a_cut_is_given() {
        let (_, events, mut reader) = read(&[3, 4, 0x80, 1, 2, 3, 4], None);
        assert_eq!(events.len(), 1);
        let error = reader.read(&mut Vec::new()).unwrap_err().to_string();
        assert!(
            error.contains("byte 5") && error.contains("truncated"),
            "{error}"
        );
        let (nowhere, nothing, _) = read(&[0, 240, 0, 0, 0], None);
        assert_eq!((nowhere, nothing.len()), (Sensor::new(34, 34).unwrap(), 0));
        let few = [[3, 4, 0x80, 1, 2], [0, 33, 0, 0, 0]];
        assert_eq!(
            read(few.as_flattened(), None).0,
            Sensor::new(34, 34).unwrap()
        );
    }

    #[test]
    fn what_it_cannot_hold_is_refused() {
        let event = Event {
            t_us: (1 << 23) - 1,
            x: 255,
            y: 239,
            polarity: Polarity::On,
        };
        assert_eq!(
            NmnistWriter::record(&event),
            Some([255, 239, 0xff, 0xff, 0xff])
        );
        for beyond in [
            Event {
                t_us: 1 << 23,
                ..event
            },
            Event { x: 256, ..event },
            Event { y: 240, ..event },
            Event {
                t_us: 1 << 32,
                ..event
            },
        ] {
            assert_eq!(NmnistWriter::record(&beyond), None);
        }
    }
}
