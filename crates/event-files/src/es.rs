//! Event Stream 2 (`.es`), the compact format of neuromorphic-paris' `sepia` and `faery`.
//!
//! | bytes | content |
//! |---|---|
//! | 0..12 | `Event Stream` |
//! | 12..15 | version: major 2, minor, patch |
//! | 15 | type: 0 generic, 1 DVS, 2 ATIS, 4 colour |
//! | 16..18, 18..20 | width, height, little-endian; absent in generic files |
//!
//! Events follow, each with the microseconds since the previous one (the first since 0). Between them there may be
//! bytes that only let time pass:
//!
//! | type | first byte | lets time pass | does nothing | followed by |
//! |---|---|---|---|---|
//! | generic | time | `0xff`: 254 us | `0xfe` | length in 7-bit groups, lowest first, bit 0 = 1: more; content |
//! | DVS | bits 7..1 time, bit 0 = ON | `0xff`: 127 us | `0xfe` | x, y |
//! | ATIS | bits 7..2 time, bit 1 polarity, bit 0 = crossing | `0xfd`..`0xff`: 63 us times bits 1..0 | `0xfc` | x, y |
//! | colour | time | `0xff`: 254 us | `0xfe` | x, y, three bytes of colour |
//!
//! x and y are 16 bits, little-endian. In the file y counts upwards from the lowest row; here it counts downwards
//! from the top, as everywhere in this crate and as `faery` reads it: row = height - 1 - y. An ATIS file's changes
//! (bit 0 = 0) are events; threshold crossings, colours and generic events are only counted. Source: the
//! specification (`neuromorphic-paris/event_stream`) and its reference implementation, `sepia.hpp`.
//!
//! Times cannot step back, and there is no index.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor, bail, ensure};

use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::output::collected::{Collected, ROOM};
use crate::output::sequential::Output;
use crate::{EventWriter, Skipped};

/// First bytes of every Event Stream file.
pub const MAGIC: &[u8] = b"Event Stream";

const VERSION: [u8; 3] = [2, 0, 0];

/// Longest time that one byte of a DVS file can let pass.
const DVS_OVERFLOW_US: u64 = 127;

/// Largest time that is written, 19 hours: every 127 us of a gap costs a byte, so such a gap costs 541 MB.
const T_MAX_US: u64 = 1 << 36;
/// Bytes of an event: its step in time and polarity, x, and y from below.
const RECORD_BYTES: usize = 5;

/// Largest number of bytes of a generic event's length: 63 bits.
const LENGTH_BYTES: u32 = 9;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "es",
    title: "Event Stream",
    endings: &[".es"],
    detect: |start| start.begins(MAGIC),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(EsReader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits {
        t_max_us: T_MAX_US,
        steps_back: false,
        ..Limits::NONE
    },
    create: Some(|path, sensor| Ok(Box::new(EsWriter::create(path, sensor)?))),
};

/// The type of a file's events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Generic,
    Dvs,
    Atis,
    Colour,
}

/// Meaning of an event's first byte, or of a byte between two events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum First {
    /// No event begins; this number of microseconds passes.
    Pass(u64),
    /// An event begins after this number of microseconds; its polarity, if it is a brightness change.
    Begin(u64, Option<Polarity>),
}

impl Kind {
    fn first(self, byte: u8) -> First {
        let value = u64::from(byte);
        match (self, byte) {
            (Self::Atis, 0xfc..) => First::Pass(63 * (value & 3)),
            (Self::Atis, _) => {
                let polarity = Polarity::from_bool(byte & 2 != 0);
                First::Begin(value >> 2, (byte & 1 == 0).then_some(polarity))
            }
            (_, 0xfe) => First::Pass(0),
            (Self::Dvs, 0xff) => First::Pass(DVS_OVERFLOW_US),
            (Self::Dvs, _) => First::Begin(value >> 1, Some(Polarity::from_bool(byte & 1 != 0))),
            (Self::Generic | Self::Colour, 0xff) => First::Pass(254),
            (Self::Generic | Self::Colour, _) => First::Begin(value, None),
        }
    }
}

/// A reader of Event Stream files.
pub type EsReader = Reader<EsDecoder>;

impl EsReader {
    /// Reads `source`, which messages call `name`; `size` is used only if the file holds generic events.
    ///
    /// # Errors
    /// There is no Event Stream header; the version or the type is unknown; the size is out of range.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let mut magic = [0; MAGIC.len()];
        let mut rest = [0; 4];
        if input.fill(&mut magic)? < magic.len() || magic != *MAGIC {
            return Err(input.error_at(0, "no Event Stream header"));
        }
        if input.fill(&mut rest)? < rest.len() {
            return Err(input.error("the file ends within its header: truncated"));
        }
        let [major, minor, patch, kind] = rest;
        if major != 2 {
            return Err(input.error_at(
                12,
                format!(
                    "Event Stream {major}.{minor}.{patch} is not supported: convert it to version 2"
                ),
            ));
        }
        let kind = match kind {
            0 => Kind::Generic,
            1 => Kind::Dvs,
            2 => Kind::Atis,
            4 => Kind::Colour,
            other => {
                return Err(input.error_at(
                    15,
                    format!("events of type {other} are not known (0, 1, 2 and 4 are)"),
                ));
            }
        };
        let sensor = if kind == Kind::Generic {
            // Generic events have no pixel, so any sensor will do.
            size.unwrap_or(Sensor {
                width: 1,
                height: 1,
            })
        } else {
            let mut sides = [0; 4];
            if input.fill(&mut sides)? < sides.len() {
                return Err(input.error("the file ends within its header: truncated"));
            }
            let [w0, w1, h0, h1] = sides;
            let (width, height) = (u16::from_le_bytes([w0, w1]), u16::from_le_bytes([h0, h1]));
            Sensor::new(width, height).ok_or_else(|| {
                input.error_at(16, format!("{width}x{height} is not a valid sensor size"))
            })?
        };
        Ok(Self::around(EsDecoder {
            input,
            bytes: Words::default(),
            kind,
            sensor,
            t_us: 0,
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`EsReader`]: its state between two events.
pub struct EsDecoder {
    input: Input,
    bytes: Words<1>,
    kind: Kind,
    sensor: Sensor,
    t_us: u64,
    events: u64,
    skipped: Skipped,
}

impl EsDecoder {
    /// Reads a byte within an event; the end of the file is an error.
    #[inline]
    fn byte(&mut self) -> Result<u8> {
        match self.bytes.next(&mut self.input)? {
            Some([byte]) => Ok(byte),
            None => Err(self.input.error("the file ends within an event: truncated")),
        }
    }

    #[inline]
    fn side(&mut self) -> Result<u16> {
        Ok(u16::from_le_bytes([self.byte()?, self.byte()?]))
    }

    /// Reads the pixel of an event that began at byte `offset`, with its row counted from the top; `None` if the
    /// event is left out.
    fn pixel(&mut self, offset: u64) -> Result<Option<(u16, u16)>> {
        let (x, y) = (self.side()?, self.side()?);
        if !self.sensor.contains(x, y) {
            let (pixel, skipped) = ((i64::from(x), i64::from(y)), &mut self.skipped);
            self.input
                .outside(offset, self.events, pixel, self.sensor, skipped)?;
            return Ok(None);
        }
        Ok(Some((x, self.sensor.height - 1 - y)))
    }

    /// Appends the events of a DVS file whose bytes are there, up to one outside of the sensor.
    fn decode_run(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        let (_, bytes) = self.bytes.run(&mut self.input, usize::MAX)?;
        let mut rest = bytes.as_flattened();
        let (mut t_us, mut events) = (self.t_us, 0);
        while batch.room() > 0
            && let Some([first, x0, x1, y0, y1]) = rest.first_chunk::<RECORD_BYTES>().copied()
        {
            let length = match Kind::Dvs.first(first) {
                First::Pass(passed_us) => {
                    t_us = t_us.saturating_add(passed_us);
                    1
                }
                First::Begin(passed_us, polarity) => {
                    let (x, y) = (u16::from_le_bytes([x0, x1]), u16::from_le_bytes([y0, y1]));
                    let Some(polarity) = polarity.filter(|_| self.sensor.contains(x, y)) else {
                        break;
                    };
                    t_us = t_us.saturating_add(passed_us);
                    let y = self.sensor.height - 1 - y;
                    batch.push(Event {
                        t_us,
                        x,
                        y,
                        polarity,
                    });
                    events += 1;
                    RECORD_BYTES
                }
            };
            rest = rest.get(length..).unwrap_or_default();
        }
        let left = rest.len();
        self.bytes.back(left);
        (self.t_us, self.events) = (t_us, self.events + events);
        Ok(())
    }

    /// Skips a generic event's length and bytes.
    fn skip_generic(&mut self, offset: u64) -> Result<()> {
        let mut length = 0_u64;
        for index in 0..LENGTH_BYTES {
            let byte = self.byte()?;
            length |= u64::from(byte >> 1) << (7 * index);
            if byte & 1 == 0 {
                for _ in 0..length {
                    self.byte()?;
                }
                return Ok(());
            }
        }
        Err(self.input.error_at(
            offset,
            format!("a generic event's length has more than {LENGTH_BYTES} bytes: damaged"),
        ))
    }
}

impl Decode for EsDecoder {
    fn format(&self) -> &'static str {
        "es"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
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
            if self.kind == Kind::Dvs {
                self.decode_run(batch)?;
                if batch.room() == 0 {
                    break;
                }
            }
            let Some([byte]) = self.bytes.next(&mut self.input)? else {
                break;
            };
            let (passed_us, polarity) = match self.kind.first(byte) {
                First::Pass(passed_us) => {
                    self.t_us = self.t_us.saturating_add(passed_us);
                    continue;
                }
                First::Begin(passed_us, polarity) => (passed_us, polarity),
            };
            let offset = self.bytes.offset(&self.input);
            self.t_us = self.t_us.saturating_add(passed_us);
            if self.kind == Kind::Generic {
                self.skip_generic(offset)?;
                self.skipped.add("generic events", 1);
                continue;
            }
            let pixel = self.pixel(offset)?;
            self.events += 1;
            match polarity {
                Some(polarity) => {
                    if let Some((x, y)) = pixel {
                        batch.push(Event {
                            t_us: self.t_us,
                            x,
                            y,
                            polarity,
                        });
                    }
                }
                None if self.kind == Kind::Colour => {
                    for _ in 0..3 {
                        self.byte()?;
                    }
                    self.skipped.add("colours", 1);
                }
                None => self.skipped.add("threshold crossings", 1),
            }
        }
        Ok(())
    }
}

/// A writer of Event Stream files of DVS events.
pub struct EsWriter {
    file: Collected,
    sensor: Sensor,
    t_us: u64,
    events: u64,
}

impl EsWriter {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let mut writer = Self {
            file: Collected::new(Output::create(path)?),
            sensor,
            t_us: 0,
            events: 0,
        };
        writer.file.put(MAGIC)?;
        writer.file.put(&VERSION)?;
        writer.file.put(&[1])?;
        writer.file.put(&sensor.width.to_le_bytes())?;
        writer.file.put(&sensor.height.to_le_bytes())?;
        Ok(writer)
    }
}

impl EsWriter {
    /// Checks an event, and writes the bytes that carry whole [`DVS_OVERFLOW_US`] of its step in time; returns the rest of
    /// the step.
    #[inline(never)]
    fn begin(&mut self, event: &Event) -> Result<u64> {
        crate::check_inside(self.file.name(), self.events, event, self.sensor)?;
        let (name, index, t_us) = (self.file.name(), self.events, event.t_us);
        let Some(step_us) = t_us.checked_sub(self.t_us) else {
            bail!(
                CannotHold,
                "{name}: event {index}: time {t_us} us is before {} us, and times cannot step \
                 back in Event Stream: sort the events, or write .aedat4",
                self.t_us
            );
        };
        ensure!(
            t_us <= T_MAX_US,
            CannotHold,
            "{name}: event {index}: time {t_us} us is above 2^36 us, the largest written as \
             Event Stream: write .aedat4"
        );
        for _ in 0..step_us / DVS_OVERFLOW_US {
            self.file.put_first([0xff; ROOM], 1)?;
        }
        Ok(step_us % DVS_OVERFLOW_US)
    }
}

/// Returns the bytes of an event, `step_us`, below [`DVS_OVERFLOW_US`], after the bytes before it.
#[inline]
fn record(event: &Event, step_us: u64, sensor: Sensor) -> [u8; ROOM] {
    // It fits into 7 bits and is not taken for `0xff` or `0xfe`.
    let first = step_us << 1 | u64::from(event.polarity == Polarity::On);
    let y = sensor.height.wrapping_sub(1).wrapping_sub(event.y);
    (first | u64::from(event.x) << 8 | u64::from(y) << 24).to_le_bytes()
}

impl EventWriter for EsWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let mut rest = events;
        while !rest.is_empty() {
            // All events of a recording but a few are close to the one before.
            let (before, mut last_us, sensor) = (rest.len(), self.t_us, self.sensor);
            self.file.fill(|room| {
                let mut at = 0;
                while let Some((event, later)) = rest.split_first()
                    && let Some(room) = room.get_mut(at..).and_then(<[u8]>::first_chunk_mut)
                    && let step_us = event.t_us.wrapping_sub(last_us)
                    && step_us < DVS_OVERFLOW_US
                    && event.t_us <= T_MAX_US
                    && sensor.contains(event.x, event.y)
                {
                    *room = record(event, step_us, sensor);
                    at += RECORD_BYTES;
                    last_us = event.t_us;
                    rest = later;
                }
                at
            })?;
            self.t_us = last_us;
            self.events += (before - rest.len()) as u64;
            if before == rest.len()
                && let Some((event, later)) = rest.split_first()
            {
                let step_us = self.begin(event)?;
                self.file
                    .put_first(record(event, step_us, sensor), RECORD_BYTES)?;
                self.t_us = event.t_us;
                self.events += 1;
                rest = later;
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.file.finish()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;
    use crate::EventReader;

    const SENSOR: Sensor = Sensor {
        width: 3,
        height: 2,
    };

    fn file(kind: u8, body: &[u8]) -> Vec<u8> {
        let size: &[u8] = if kind == 0 { &[] } else { &[3, 0, 2, 0] };
        [MAGIC, &VERSION, &[kind], size, body].concat()
    }

    fn event(t_us: u64, x: u16, y: u16, polarity: Polarity) -> Event {
        Event {
            t_us,
            x,
            y,
            polarity,
        }
    }

    /// Returns all events, what was skipped, and the error, if any.
    fn read(bytes: Vec<u8>) -> (Vec<Event>, Vec<(&'static str, u64)>, Option<String>) {
        let mut reader = EsReader::new(Box::new(Cursor::new(bytes)), "test", None).unwrap();
        let mut events = Vec::new();
        let error = loop {
            match reader.read(&mut events) {
                Ok(0) => break None,
                Ok(_) => {}
                Err(error) => break Some(error.to_string()),
            }
        };
        let skipped = reader.skipped().iter().collect();
        (events, skipped, error)
    }

    #[test]
    fn dvs_times_pass_and_rows_count_from_the_uppermost() {
        let body = [
            5 << 1 | 1,
            2,
            0,
            0,
            0, // at 5 us in the lowest row
            0xff,
            0xfe,
            0xff,
            126 << 1,
            0,
            0,
            1,
            0, // 127 + 127 + 126 us later
        ];
        let (events, skipped, error) = read(file(1, &body));
        assert_eq!(error, None);
        assert!(skipped.is_empty());
        assert_eq!(
            events,
            [
                event(5, 2, 1, Polarity::On),
                event(385, 0, 0, Polarity::Off)
            ]
        );
    }

    #[test]
    fn changes_of_atis_are_events_and_crossings_are_counted() {
        let body = [
            1 << 2 | 0b10,
            0,
            0,
            0,
            0, // ON at 1 us
            0xff,
            0xfc,
            1 << 2 | 0b01,
            1,
            0,
            0,
            0, // a crossing at 191 us
            0xfd,
            0,
            2,
            0,
            1,
            0, // OFF at 254 us
        ];
        let (events, skipped, error) = read(file(2, &body));
        assert_eq!(error, None);
        assert_eq!(skipped, [("threshold crossings", 1)]);
        assert_eq!(
            events,
            [
                event(1, 0, 1, Polarity::On),
                event(254, 2, 0, Polarity::Off)
            ]
        );
    }

    #[test]
    fn colours_and_generic_events_are_counted() {
        let (events, skipped, error) = read(file(4, &[0xff, 0, 1, 0, 1, 0, 7, 8, 9]));
        assert_eq!((events.len(), error), (0, None));
        assert_eq!(skipped, [("colours", 1)]);
        let mut body = vec![0, 0, 0xff, 3, 3, 1 << 1];
        body.extend([0xaa; 129]);
        let (events, skipped, error) = read(file(0, &body));
        assert_eq!((events.len(), error), (0, None));
        assert_eq!(skipped, [("generic events", 2)]);
        let (_, _, error) = read(file(0, &[0xfd; 18]));
        assert!(error.unwrap().contains("length"));
    }

    #[test]
    fn damage_comes_after_what_is_before_it() {
        let whole = [1, 0, 0, 0, 0];
        for (rest, what) in [
            (&[1, 0, 0, 0][..], "byte 29: the file ends within an event"),
            (
                &[1, 3, 0, 0, 0],
                "byte 25: event 1 at x = 3, y = 0 is outside",
            ),
            (
                &[1, 0, 0, 2, 0],
                "byte 25: event 1 at x = 0, y = 2 is outside",
            ),
        ] {
            let (events, _, error) = read(file(1, &[&whole, rest].concat()));
            assert_eq!(events, [event(0, 0, 1, Polarity::On)]);
            assert!(error.as_ref().unwrap().contains(what), "{error:?}");
        }
        for (bytes, what) in [
            (&b"Event Stream\x01\0\0\x01\x01\0\x01\0"[..], "byte 12: "),
            (b"Event Stream\x02\0\0\x03\x01\0\x01\0", "byte 15: "),
            (b"Event Stream\x02\0\0\x01\0\0\x01\0", "byte 16: "),
            (b"Event Stream\x02\0\0\x01\x01\0\x01", "byte 19: "),
            (b"Event Stream\x02\0", "byte 14: "),
            (b"Event stream\x02\0\0\x01\x01\0\x01\0", "byte 0: "),
        ] {
            let Err(error) = EsReader::new(Box::new(Cursor::new(bytes)), "test", None) else {
                panic!("{what} is no header");
            };
            assert!(error.to_string().contains(what), "{error}");
        }
    }

    #[test]
    fn what_cannot_be_written_is_refused_by_number_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let first = event(9, 0, 0, Polarity::On);
        for (t_us, what) in [(8, "event 1: time 8 us"), (T_MAX_US + 1, "above 2^36")] {
            let path = folder.path().join("a.es");
            let mut writer = EsWriter::create(&path, SENSOR).unwrap();
            let events = [first, event(t_us, 0, 0, Polarity::On)];
            let error = writer.write(&events).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(
            steps in proptest::collection::vec(
                (prop_oneof![0..4_u64, 120..260_u64, 0..100_000_u64], 0..3_u16, 0..2_u16, any::<bool>()),
                0..200,
            ),
        ) {
            let mut t_us = 0;
            let events: Vec<Event> = steps.iter().map(|&(step, x, y, on)| {
                t_us += step;
                event(t_us, x, y, Polarity::from_bool(on))
            }).collect();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.es");
            let mut writer = Box::new(EsWriter::create(&path, SENSOR).unwrap());
            writer.write(&events).unwrap();
            writer.finish().unwrap();
            let (got, _, error) = read(std::fs::read(&path).unwrap());
            prop_assert_eq!(error, None);
            prop_assert_eq!(got, events);
        }
    }
}
