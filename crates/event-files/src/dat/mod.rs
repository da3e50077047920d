//! Prophesee DAT: decoded events in 8-byte records, little-endian.
//!
//! A file is header lines that begin with `% `, then two bytes (the type of the events and the size of a record,
//! 8), then the records. Types 0 (`Event2d`) and 12 (`EventCD`) are read; type 14 means triggers.
//!
//! | | bits 31..0 | x | y | polarity |
//! |---|---|---|---|---|
//! | version 2 | time in us | bits 45..32 | 59..46 | 63..60, 0 = OFF |
//! | version 1 | time in us | bits 40..32 | 48..41 | 52..49, 0 = OFF |
//!
//! Source: "DAT File Format" in Prophesee's documentation for version 2, and kAER's readers for version 1. x
//! counts from the left and y from the top. If the header has no `% Version`, the records show the version: bits
//! 63..53 are empty in version 1. The header may state the size (`% Width`, `% Height`); that of N-CARS does not.
//! Old files without any header line cannot be distinguished from other bytes and are not read.
//!
//! The time wraps after 71.6 minutes; the wraps are counted, which OpenEB does not do. The value of a line `% T0`,
//! which faery's writer adds, is added to every time, as faery does. Unlike this reader, faery replaces a time
//! that steps back by the time before it, and reads files of type 0 only with its inner decoder. The reader seeks
//! by bisection, as described in `times.rs`.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod avx2;
pub(crate) mod times;
pub(crate) mod writer;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor};

use crate::dat::times::Times;
use crate::evt::header::RawHeader;
use crate::format::{Format, Limits, Opening, Start};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::word_runs::RUN_WORDS;
use crate::wrapping::Wrapping;
use crate::{Assumption, DatWriter, Skipped};

/// Bytes of a record.
pub(super) const RECORD_BYTES: u64 = 8;

/// Type of `Event2d`.
const EVENT_2D: u8 = 0;
/// Type of `EventCD`.
pub(super) const EVENT_CD: u8 = 12;
/// Type of `EventExtTrigger`.
const TRIGGER: u8 = 14;

/// Number of records from which the version is inferred if the header does not state it.
const VERSION_RECORDS: usize = 4096;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "dat",
    title: "Prophesee DAT",
    endings: &[".dat"],
    detect: is_dat,
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(DatReader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(DatWriter::create(path, sensor)?))),
};

/// Returns whether a header is that of a DAT file: it names no word format, and it either has
/// `% Data file containing` or is followed by a type and a record's size, which no text has.
fn is_dat(start: &Start) -> bool {
    start.header.as_ref().is_some_and(|header| {
        let at = usize::try_from(header.length).unwrap_or(usize::MAX);
        let kind = start.bytes.get(at..).and_then(<[u8]>::first_chunk);
        let is_kind = matches!(kind, Some([EVENT_2D | EVENT_CD | TRIGGER, 8]));
        let names_no_words = header.words == Err(String::new());
        names_no_words && (header.data.is_some() || is_kind)
    })
}

/// Layout of a record's second half.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Version {
    /// 9 bits of x, 8 bits of y.
    One,
    /// 14 bits each of x and y.
    Two,
}

/// Returns the lower bits of the time, x, y and polarity of a record with `X_BITS` bits of x and `Y_BITS` of y.
#[inline]
const fn parse<const X_BITS: u32, const Y_BITS: u32>(record: [u8; 8]) -> (u32, u16, u16, Polarity) {
    let record = u64::from_le_bytes(record);
    let address = (record >> 32) as u32;
    let x = address & ((1 << X_BITS) - 1);
    let y = address >> X_BITS & ((1 << Y_BITS) - 1);
    let polarity = address >> (X_BITS + Y_BITS) & 0xf;
    let polarity = Polarity::from_bool(polarity != 0);
    (record as u32, x as u16, y as u16, polarity)
}

/// A reader of DAT files.
pub type DatReader = Reader<DatDecoder>;

impl DatReader {
    /// Reads `source`, which messages call `name`; `size` is used if the header states no size.
    ///
    /// # Errors
    /// There is no DAT header; the sensor's size is unknown; the version is unknown; the records are not events.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let header = RawHeader::read(&mut input)?;
        if header.length == 0 {
            return Err(input.error("no DAT header (% Version 2)"));
        }
        let mut kind = [0; 2];
        if input.fill(&mut kind)? < kind.len() {
            return Err(input.error("the file ends before its events: truncated"));
        }
        let wrong = |what: String| Err(input.error_at(header.length, what));
        match kind {
            [EVENT_2D | EVENT_CD, 8] => {}
            [TRIGGER, _] => {
                return wrong(
                    "the file holds triggers, not events: read the _cd.dat file beside it".into(),
                );
            }
            [EVENT_2D | EVENT_CD, bytes] => {
                return wrong(format!(
                    "records of {bytes} bytes instead of 8: damaged file"
                ));
            }
            [other, _] => {
                return wrong(format!(
                    "events of type {other}: only types 0 and 12 are supported: convert the file \
                     with Metavision"
                ));
            }
        }
        let sensor = header.sensor_or(size, &input)?;
        let start = input.offset();
        let t0_us = header.t0_us(&input)?;
        let mut assumptions = Vec::new();
        let version = match header.version.as_deref() {
            Some("2") => Version::Two,
            Some("0" | "1") => Version::One,
            Some(other) => {
                let what = format!("version {other} of DAT is not supported: only 0, 1 and 2 are");
                return Err(input.error_at(0, what));
            }
            None => {
                let (version, assumption) = version_of_records(&mut input, sensor)?;
                assumptions.push(assumption);
                version
            }
        };
        Ok(Self::around(DatDecoder {
            input,
            words: Words::default(),
            version,
            sensor,
            start,
            t0_us,
            time: Wrapping::new(32, 0),
            times: None,
            assumptions,
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// Returns the version that the first records fit; leaves the input where it is.
///
/// Records of version 1 leave the upper bits empty, and most of them lie outside the sensor when read as version
/// 2. Records of version 2 leave the upper bits empty only for polarity OFF in the first 128 rows.
fn version_of_records(input: &mut Input, sensor: Sensor) -> Result<(Version, Assumption)> {
    let start = input.offset();
    let mut words = Words::<8>::default();
    let (mut is_one, mut is_two) = (true, true);
    for _ in 0..VERSION_RECORDS {
        // The reader will meet the damage again, after the events before it.
        let Ok(Some(record)) = words.next(input) else {
            break;
        };
        let (_, x, y, _) = parse::<9, 8>(record);
        is_one &= u64::from_le_bytes(record) >> 53 == 0 && sensor.contains(x, y);
        let (_, x, y, _) = parse::<14, 14>(record);
        is_two &= sensor.contains(x, y);
    }
    input.seek(start)?;
    let (version, why) = match (is_one, is_two) {
        (true, false) => (
            Version::One,
            "the first records all fit version 1, but not all fit version 2",
        ),
        (false, true) => (
            Version::Two,
            "the first records all fit version 2, but not all fit version 1",
        ),
        (true, true) => (Version::Two, "the first records fit versions 1 and 2"),
        (false, false) => (
            Version::Two,
            "not all of the first records fit version 1, nor do all fit version 2",
        ),
    };
    let taken = if version == Version::One { "1" } else { "2" };
    Ok((
        version,
        Assumption {
            what: "version",
            taken: taken.to_owned(),
            why: format!("no `% Version` line; {why}"),
        },
    ))
}

/// What decodes and encodes several records of version 2 at once, on a core that has it.
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

    fn decode(self, _: &[[u8; 8]], _: u64, _: u32, _: Sensor, _: &mut [Event]) -> usize {
        match self {}
    }

    fn encode(self, _: &[Event], _: u64, _: u32, _: Sensor, _: &mut [[u8; 8]]) -> usize {
        match self {}
    }
}

/// The decoder of [`DatReader`]: its state between two records.
pub struct DatDecoder {
    input: Input,
    words: Words<8>,
    version: Version,
    sensor: Sensor,
    /// Offset of the first record.
    start: u64,
    t0_us: u64,
    time: Wrapping,
    /// Times for seeking, read at the first seek.
    times: Option<Times>,
    assumptions: Vec<Assumption>,
    events: u64,
    skipped: Skipped,
}

impl DatDecoder {
    /// Implements [`Decode::decode`] for records with `X_BITS` bits of x and `Y_BITS` of y.
    fn decode_version<const X_BITS: u32, const Y_BITS: u32>(
        &mut self,
        batch: &mut Batch<'_>,
    ) -> Result<()> {
        let Self { sensor, t0_us, .. } = *self;
        let vectors = Vectors::detected().filter(|_| (X_BITS, Y_BITS) == (14, 14));
        let mut scratch = [Event::UNSET; RUN_WORDS];
        while batch.room() > 0 {
            let most = batch.room().min(RUN_WORDS);
            let (mut offset, mut run) = self.words.run(&mut self.input, most)?;
            if let (Some(vectors), Some(time)) = (vectors, self.time.last()) {
                let before = self.time.low(time) as u32;
                let base_us = self.time.base() + t0_us;
                let decoded = vectors.decode(run, base_us, before, sensor, &mut scratch);
                let (taken, rest) = run.split_at(decoded);
                if let Some(last) = taken.last() {
                    let events = scratch.iter().take(decoded).copied();
                    batch.extend(events);
                    let (low, ..) = parse::<X_BITS, Y_BITS>(*last);
                    self.time.extend(u64::from(low));
                    self.events += decoded as u64;
                    if rest.is_empty() {
                        continue;
                    }
                    (offset, run) = (offset + decoded as u64 * RECORD_BYTES, rest);
                }
            }
            let Some(last) = run.last() else {
                break;
            };
            let records = run.iter().map(|record| parse::<X_BITS, Y_BITS>(*record));
            let before = self
                .time
                .last()
                .map_or(0, |time| self.time.low(time) as u32);
            // If no time is half a period or more from another, none has wrapped.
            let (steps, is_inside) = records.clone().fold((0, true), |(steps, inside), record| {
                let (low, x, y, _) = record;
                (steps | (low ^ before), inside & sensor.contains(x, y))
            });
            if is_inside && steps >> 31 == 0 && self.time.last().is_some() {
                let base_us = self.time.base() + t0_us;
                batch.extend(records.map(|(low, x, y, polarity)| Event {
                    t_us: base_us + u64::from(low),
                    x,
                    y,
                    polarity,
                }));
                let (low, ..) = parse::<X_BITS, Y_BITS>(*last);
                self.time.extend(u64::from(low));
                self.events += run.len() as u64;
                continue;
            }
            for (index, (low, x, y, polarity)) in records.enumerate() {
                let t_us = self.time.extend(u64::from(low)) + t0_us;
                if !sensor.contains(x, y) {
                    let offset = offset + index as u64 * RECORD_BYTES;
                    let pixel = (i64::from(x), i64::from(y));
                    self.input
                        .outside(offset, self.events, pixel, sensor, &mut self.skipped)?;
                    self.events += 1;
                    continue;
                }
                batch.push(Event {
                    t_us,
                    x,
                    y,
                    polarity,
                });
                self.events += 1;
            }
        }
        Ok(())
    }

    /// Returns the number of the first record at or after `t_us`, and the time counter before it.
    fn place(&mut self, t_us: u64) -> Result<Option<(u64, Wrapping)>> {
        let times = match self.times.take() {
            Some(times) => times,
            None => Times::of(&mut self.input, self.start)?,
        };
        let times = self.times.insert(times);
        times.place(&mut self.input, t_us.saturating_sub(self.t0_us))
    }
}

impl Decode for DatDecoder {
    fn format(&self) -> &'static str {
        "dat"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.input.leave_out_bad_events();
        true
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        // Offset from which the next block of records would be read.
        let offset = self.input.offset();
        let place = self.place(t_us);
        let Ok(Some((index, time))) = place else {
            self.input.seek(offset)?;
            return place.map(|_| false);
        };
        self.input.seek(self.start + index * RECORD_BYTES)?;
        self.words = Words::default();
        self.time = time;
        self.events = index;
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        match self.version {
            Version::One => self.decode_version::<9, 8>(batch),
            Version::Two => self.decode_version::<14, 14>(batch),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;
    use crate::EventReader;
    use crate::format::open_source;

    const HEADER: &str = "% Data file containing CD events.\n% Width 300\n% Height 200\n";

    fn record(t_us: u64, address: u32) -> [u8; 8] {
        (u64::from(address) << 32 | t_us & 0xffff_ffff).to_le_bytes()
    }

    fn open(lines: &str, records: &[[u8; 8]]) -> Box<dyn EventReader> {
        let bytes = [lines.as_bytes(), &[12, 8], &records.concat()].concat();
        let reader = open_source(Box::new(Cursor::new(bytes)), "test", None).unwrap();
        assert_eq!(reader.format(), "dat");
        reader
    }

    fn read(lines: &str, records: &[[u8; 8]]) -> Vec<Event> {
        let mut reader = open(lines, records);
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    }

    fn event(t_us: u64, x: u16, y: u16, on: bool) -> Event {
        Event {
            t_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        }
    }

    proptest! {
        /// Records that differ in the time's highest bit, at the sensor's edges, and of any polarity.
        #[test]
        fn vectors_decode_what_plain_code_does(
            records in proptest::collection::vec(
                (
                    any::<u32>(),
                    prop::bool::weighted(0.02),
                    prop_oneof![60 => 0..300_u32, 1 => 299..302_u32, 1 => 0..1_u32 << 14],
                    prop_oneof![60 => 0..200_u32, 1 => 199..202_u32, 1 => 0..1_u32 << 14],
                    prop_oneof![60 => 0..2_u32, 1 => 0..16_u32],
                ),
                0..60,
            ),
            before: u32, base_us in 0..u64::MAX >> 1, room in 0..60_usize,
        ) {
            let Some(vectors) = Vectors::detected() else {
                return Ok(());
            };
            let sensor = Sensor { width: 300, height: 200 };
            let records: Vec<_> = records
                .iter()
                .map(|(low, differs, x, y, polarity)| {
                    let highest = (before ^ u32::from(*differs) << 31) & 1 << 31;
                    let low = low & !(1 << 31) | highest;
                    record(low.into(), polarity << 28 | y << 14 | x)
                })
                .collect();
            let mut events = vec![Event::UNSET; room];
            let decoded = vectors.decode(&records, base_us, before, sensor, &mut events);
            let expected: Vec<_> = records
                .iter()
                .map_while(|record| {
                    let (low, x, y, polarity) = parse::<14, 14>(*record);
                    let is_plain = (low ^ before) >> 31 == 0
                        && sensor.contains(x, y)
                        && u64::from_le_bytes(*record) >> 61 == 0;
                    let t_us = base_us + u64::from(low);
                    is_plain.then_some(Event { t_us, x, y, polarity })
                })
                .take(room)
                .collect();
            prop_assert_eq!(decoded, expected.len() / 4 * 4);
            prop_assert_eq!(&events[..decoded], &expected[..decoded]);
        }
    }

    #[test]
    fn records_of_both_versions() {
        let two = [
            record(5, 1 << 28 | 199 << 14 | 299),
            record(6, 7),
            record(6, 0xf << 28 | 3 << 14),
        ];
        let want = [
            event(5, 299, 199, true),
            event(6, 7, 0, false),
            event(6, 0, 3, true),
        ];
        let line = |version: &str| format!("{HEADER}{version}");
        assert_eq!(read(&line("% Version 2\n"), &two), want);
        // Inferred from the records, although the second would fit either version.
        assert_eq!(read(HEADER, &two), want);
        let one = [
            record(5, 1 << 17 | 199 << 9 | 299),
            record(6, 7),
            record(6, 0xf << 17 | 3 << 9),
        ];
        assert_eq!(read(&line("% Version 1\n"), &one), want);
        assert_eq!(read(HEADER, &one), want);
    }

    #[test]
    fn times_wrap_and_t0_is_added() {
        let top = u64::from(u32::MAX);
        let times = [
            top - 9,
            top,
            top + 2,
            top - 1,
            top + 9,
            top + (1 << 30),
            top + (1 << 31),
            top + (3 << 30),
            2 * top + 99,
        ];
        let records: Vec<_> = times.iter().map(|time| record(*time, 0)).collect();
        let lines = format!("{HEADER}% Version 2\n");
        let got: Vec<u64> = read(&lines, &records).iter().map(|e| e.t_us).collect();
        assert_eq!(got, times);
        let lines = format!("{lines}% T0 1000\n");
        let got: Vec<u64> = read(&lines, &records).iter().map(|e| e.t_us).collect();
        assert_eq!(got, times.map(|time| time + 1000));
    }

    #[test]
    fn a_header_of_few_lines_is_told_by_the_bytes_after_it() {
        let records = [record(1, 1 << 28)];
        assert_eq!(
            read("% Width 9\n% Height 9\n", &records),
            [event(1, 0, 0, true)]
        );
        // Text that begins in the same way.
        let text = b"% Version 2\n% Width 9\n% Height 9\n1 2 3 1\n2 3 4 0\n";
        let source = Box::new(Cursor::new(text.to_vec()));
        if let Ok(reader) = open_source(source, "test", Sensor::new(9, 9)) {
            assert_ne!(reader.format(), "dat");
        }
    }

    #[test]
    fn seeking_leads_to_the_events_from_a_time_on() {
        let times = |i: u64| 4_000_000_000 + i / 2 * 90_000;
        let records: Vec<_> = (0..20_000_u64)
            .map(|i| record(times(i), (i % 300) as u32))
            .collect();
        let lines = format!("{HEADER}% Version 2\n% T0 77\n");
        let want = read(&lines, &records);
        assert!(want[0].t_us < 1 << 32 && want[19_999].t_us > 1 << 32);
        let mut reader = open(&lines, &records);
        let mut events = Vec::new();
        // To the end, and back from there.
        while reader.read(&mut events).unwrap() > 0 {}
        for target in [
            0,
            77,
            4_000_000_077,
            4_000_000_078,
            4_300_000_000,
            4_899_910_077,
        ] {
            events.clear();
            assert!(reader.seek(target).unwrap());
            while reader.read(&mut events).unwrap() > 0 {}
            let first = want.partition_point(|event| event.t_us < target);
            assert_eq!(events, want[first..], "{target}");
        }
        assert!(reader.seek(u64::MAX).unwrap());
        assert_eq!(reader.read(&mut events).unwrap(), 0);
        // A reader that cannot seek goes on where it was.
        let mut reader = open(&lines, &records[..8000]);
        events.clear();
        assert!(!reader.seek(4_300_000_000).unwrap());
        while reader.read(&mut events).unwrap() > 0 {
            assert!(!reader.seek(0).unwrap());
        }
        assert_eq!(events, want[..8000]);
    }
}
