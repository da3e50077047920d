//! Writer of Prophesee DAT files.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor, bail};

use crate::EventWriter;
use crate::dat::{EVENT_CD, RECORD_BYTES, Vectors};
use crate::output::sequential::Output;
use crate::wrapping::Wrapping;

/// Time between a `% T0` and the first event, so that events somewhat earlier can still be written.
const ROOM_US: u64 = 1 << 20;

/// A writer of DAT files of version 2, with events of type 12 (`EventCD`).
///
/// It holds times up to 2^60 us, in any order as long as a reader can follow the wraps; gaps must be below 35
/// minutes. If the first time is 2^32 us or later, times count from about one second before it, and a line `% T0`
/// states this start: readers that do not know the line lose only that.
pub struct DatWriter {
    file: Output,
    sensor: Sensor,
    t0_us: u64,
    /// Counter of the times; `None` until the first event, whose time the header needs.
    time: Option<Wrapping>,
    events: u64,
    vectors: Option<Vectors>,
    /// Records that are being made.
    records: Vec<[u8; RECORD_BYTES as usize]>,
}

/// Records that are made before they are written.
const RECORDS: usize = 512;
/// Largest side of a sensor whose events several records at once can hold.
const SIDE_MAX: u16 = 1 << 14;

/// Events that are written one by one where one of them needs a closer look.
const FEW: usize = 4;

/// Records that are made at once by plain code.
const TOGETHER: usize = 64;

/// As [`Vectors::encode`], on any core: [`TOGETHER`] events or what is left of them, or none.
fn make(
    events: &[Event],
    zero_us: u64,
    before: u64,
    sensor: Sensor,
    records: &mut [[u8; RECORD_BYTES as usize]],
) -> usize {
    let events = events.get(..TOGETHER).unwrap_or(events);
    // If no time is half a period or more from another, none has wrapped.
    let (steps, is_inside) = events.iter().fold((0, true), |(steps, is_inside), event| {
        let step = event.t_us.wrapping_sub(zero_us) ^ before;
        (steps | step, is_inside & sensor.contains(event.x, event.y))
    });
    if steps >> 31 != 0 || !is_inside {
        return 0;
    }
    for (made, event) in records.iter_mut().zip(events) {
        *made = record(event, event.t_us.wrapping_sub(zero_us));
    }
    events.len()
}

/// Returns the record of an event whose time has these 32 bits.
fn record(event: &Event, low: u64) -> [u8; RECORD_BYTES as usize] {
    let address = u64::from(event.polarity == Polarity::On) << 28
        | u64::from(event.y) << 14
        | u64::from(event.x);
    (address << 32 | low).to_le_bytes()
}

impl DatWriter {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let file = Output::create(path)?;
        Ok(Self {
            file,
            sensor,
            t0_us: 0,
            time: None,
            events: 0,
            vectors: Vectors::detected().filter(|_| sensor.width.max(sensor.height) <= SIDE_MAX),
            records: vec![[0; RECORD_BYTES as usize]; RECORDS],
        })
    }

    fn header(&mut self, first_us: u64) -> Result<Wrapping> {
        if first_us > Wrapping::START_MAX {
            bail!(CannotHold, "{}", self.refused(first_us));
        }
        if first_us >> 32 > 0 {
            self.t0_us = first_us - ROOM_US;
        }
        let Sensor { width, height } = self.sensor;
        let mut text = format!(
            "% Data file containing CD events.\n% Version 2\n% Width {width}\n% Height {height}\n"
        );
        if self.t0_us > 0 {
            text += &format!("% T0 {}\n", self.t0_us);
        }
        self.file.put(text.as_bytes())?;
        self.file.put(&[EVENT_CD, RECORD_BYTES as u8])?;
        Ok(Wrapping::new(32, 0))
    }

    /// Writes events from the front that lie on the sensor and whose times do not wrap, several at once, and returns
    /// their number: at most [`RECORDS`], and none if the first needs a closer look.
    fn run(&mut self, events: &[Event]) -> Result<usize> {
        let Some(time) = self.time.as_mut() else {
            return Ok(0);
        };
        let zero_us = self.t0_us + time.base();
        let before = time.last().map_or(0, |last| time.low(last));
        let made = match self.vectors {
            Some(vectors) => {
                // The lower 32 bits of a time.
                let before = before as u32;
                vectors.encode(events, zero_us, before, self.sensor, &mut self.records)
            }
            None => make(events, zero_us, before, self.sensor, &mut self.records),
        };
        let (Some(records), Some(last)) = (
            self.records.get(..made),
            made.checked_sub(1).and_then(|last| events.get(last)),
        ) else {
            return Ok(0);
        };
        time.extend(last.t_us - zero_us);
        self.file.put(records.as_flattened())?;
        self.events += made as u64;
        Ok(made)
    }

    /// Writes an event, and before the first one the header.
    fn put(&mut self, event: &Event) -> Result<()> {
        crate::check_inside(self.file.name(), self.events, event, self.sensor)?;
        let mut time = match self.time.take() {
            Some(time) => time,
            None => self.header(event.t_us)?,
        };
        let since_t0 = event.t_us.checked_sub(self.t0_us);
        let low = since_t0.map(|since| time.low(since)).filter(|low| {
            // The time must be what a reader will decode.
            since_t0 == Some(time.extend(*low))
        });
        let Some(low) = low else {
            bail!(CannotHold, "{}", self.refused(event.t_us));
        };
        self.time = Some(time);
        self.file.put(&record(event, low))?;
        self.events += 1;
        Ok(())
    }

    fn refused(&self, t_us: u64) -> String {
        crate::time_refused(self.file.name(), self.events, t_us, "DAT")
    }
}

impl EventWriter for DatWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let mut rest = events;
        while !rest.is_empty() {
            let (_, left) = rest.split_at(self.run(rest)?);
            let (few, left) = left.split_at(left.len().min(FEW));
            for event in few {
                self.put(event)?;
            }
            rest = left;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        if self.events == 0 {
            self.header(0)?;
        }
        self.file.finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 640,
        height: 480,
    };

    /// Returns the bytes of a file, or the error of its first event that cannot be written.
    fn written(
        write: impl FnOnce(&mut DatWriter) -> Result<()>,
    ) -> std::result::Result<Vec<u8>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.dat");
        let mut writer = Box::new(DatWriter::create(&path, SENSOR).unwrap());
        write(&mut writer)
            .map_err(|error| error.to_string().replace(path.to_str().unwrap(), ""))?;
        writer.finish().unwrap();
        Ok(std::fs::read(&path).unwrap())
    }

    proptest! {
        /// Events written together are those written one by one, around wraps and over several chunks.
        #[test]
        fn runs_are_what_their_events_are(
            start in prop_oneof![0..5_u64, (1..4_u64).prop_map(|half| (half << 31) - 300), Just(1 << 40)],
            steps in proptest::collection::vec(
                prop_oneof![200 => -2..4_i64, 1 => prop_oneof![-40_i64..40, Just(1 << 30), Just(1 << 31), Just(-(1 << 30))]],
                0..1500,
            ),
            batch in 1..1500_usize,
            outside in prop_oneof![Just(usize::MAX), Just(639), Just(1279)],
        ) {
            let mut t_us = start;
            let events: Vec<Event> = steps
                .iter()
                .enumerate()
                .map(|(i, step)| {
                    t_us = t_us.saturating_add_signed(*step);
                    Event {
                        t_us,
                        x: (i % 640 + usize::from(outside == i)) as u16,
                        y: (i % 479) as u16,
                        polarity: Polarity::from_bool(i % 3 == 0),
                    }
                })
                .collect();
            let one_by_one = written(|writer| events.iter().try_for_each(|event| writer.put(event)));
            for vectors in [None, Vectors::detected()] {
                let together = written(|writer| {
                    writer.vectors = vectors;
                    events.chunks(batch).try_for_each(|events| writer.write(events))
                });
                prop_assert_eq!(&together, &one_by_one);
            }
        }
    }

    #[test]
    fn an_event_outside_is_named() {
        let inside = Event {
            t_us: 5,
            x: 639,
            y: 479,
            polarity: Polarity::On,
        };
        let mut events = vec![inside; 700];
        events.push(Event { x: 640, ..inside });
        let error = written(|writer| writer.write(&events)).unwrap_err();
        assert!(
            error.contains("event 700 at x = 640, y = 479 is outside"),
            "{error}"
        );
    }
}
