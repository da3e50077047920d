//! AEDAT 3.0 and 3.1, as cAER writes it, for instance in IBM's DVS128 Gesture data set.
//!
//! A file is `#!AER-DAT3.1\r\n`, lines that begin with `#` (`#Format: RAW`, `#Source 1: DVS128`) up to
//! `#!END-HEADER`, then packets. A packet's header is little-endian: i16 type, i16 source, i32 bytes of an event,
//! i32 offset of its time, i32 overflows of the time, i32 capacity, i32 events, i32 valid events; the events
//! follow. An event of a polarity packet (type 1) has 8 bytes:
//!
//! | bits of the first word | content |
//! |---|---|
//! | 0 | whether it is valid |
//! | 1 | polarity, 1 = ON |
//! | 16..2 | y, downwards |
//! | 31..17 | x |
//!
//! The second word is the time in us, 31 bits; the packet's overflow count provides the bits above. Invalid events
//! and the events of other packets are counted as skipped. So are those of all sources but the first in the
//! header; the reader's assumptions then state which source is read. The sensor's size is that of the camera that
//! the source names, or else the caller's. Source: iniVation's page "AEDAT 3.1" and the data set's README.

use event_types::stream::{ErrorKind, Result};
use event_types::{Event, Polarity, Sensor};

use crate::aedat::chip::Chip;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader};
use crate::{Assumption, Skipped};

/// First line of every AEDAT 3 file, without the minor version and the line end.
pub const MAGIC: &[u8] = b"#!AER-DAT3";

/// Largest length of the header and of a line, in bytes.
const HEADER_MAX: u64 = 1 << 20;
const LINE_MAX: usize = 1 << 16;

/// Bytes of a packet's header.
const PACKET_HEADER: usize = 28;

/// Largest length of a packet's content, in bytes.
const PACKET_MAX: u64 = 1 << 26;

/// Type of a packet of polarity events.
const POLARITY: u16 = 1;

/// Bytes of a polarity event.
const EVENT_BYTES: usize = 8;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "aedat3",
    title: "AEDAT 3",
    endings: &[],
    detect: |start| start.begins(MAGIC),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(Aedat3Reader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: None,
};

/// A reader of AEDAT 3 files.
pub type Aedat3Reader = Reader<Aedat3Decoder>;

impl Aedat3Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the header names no known camera.
    ///
    /// # Errors
    /// There is no AEDAT 3 header; the packets are compressed; the sensor's size is unknown.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let sources = read_header(&mut input)?;
        let first = sources.first();
        let chip = first.and_then(|(_, name)| Chip::of_name(name));
        let Some(sensor) = chip.map(|chip| chip.sensor).or(size) else {
            let what = match first {
                Some((_, name)) => format!("the size of source {name} is not known"),
                None => {
                    "the header has no #Source line, so the sensor size is not known".to_owned()
                }
            };
            return Err(input
                .error(format!("{what}: give --width W --height H"))
                .of_kind(ErrorKind::Undecided));
        };
        let mut assumptions = Vec::new();
        if let [(number, name), others @ ..] = sources.as_slice()
            && !others.is_empty()
        {
            let others: Vec<_> = others.iter().map(|(_, name)| name.as_str()).collect();
            assumptions.push(Assumption {
                what: "stream",
                taken: format!("source {number}, {name}"),
                why: format!(
                    "the first in the header; the events of the others are only counted: {}",
                    others.join(", ")
                ),
            });
        }
        Ok(Self::around(Aedat3Decoder {
            input,
            sensor,
            source: sources.first().map(|(number, _)| *number),
            camera: sources.into_iter().next().map(|(_, name)| name),
            assumptions,
            packet: Vec::new(),
            next: 0,
            packet_at: 0,
            overflow_us: 0,
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// Returns the numbers and names of the sources; leaves the input at the first packet.
fn read_header(input: &mut Input) -> Result<Vec<(u16, String)>> {
    let mut sources = Vec::new();
    let mut line = Vec::new();
    loop {
        let start = input.offset();
        line.clear();
        input.line(&mut line, LINE_MAX)?;
        if start == 0 && !line.starts_with(MAGIC) {
            return Err(input.error_at(0, "no AEDAT 3 header (#!AER-DAT3.1)"));
        }
        if !line.starts_with(b"#") || start > HEADER_MAX {
            let what = "the header does not end with #!END-HEADER: truncated or damaged";
            return Err(input.error_at(start, what));
        }
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_start_matches('#').trim();
        if text == "!END-HEADER" {
            return Ok(sources);
        }
        let Some((key, value)) = text.split_once(':') else {
            continue;
        };
        let value = value.trim();
        if key.eq_ignore_ascii_case("Format") && !value.eq_ignore_ascii_case("RAW") {
            let what =
                format!("packets in the format {value}: only RAW is supported: record as RAW");
            return Err(input.error_at(start, what));
        }
        // Lines of `-Source` describe earlier recordings from which this one was made.
        let number = key.strip_prefix("Source").map(str::trim);
        if let Some(Ok(number)) = number.map(str::parse) {
            sources.push((number, value.to_owned()));
        }
    }
}

/// The decoder of [`Aedat3Reader`]: its state between two batches, with one packet.
pub struct Aedat3Decoder {
    input: Input,
    sensor: Sensor,
    /// Number of the source that is read, if the header names one.
    source: Option<u16>,
    camera: Option<String>,
    assumptions: Vec<Assumption>,
    /// Events of the current packet, and the offset of the next event in it.
    packet: Vec<u8>,
    next: usize,
    packet_at: u64,
    overflow_us: u64,
    events: u64,
    skipped: Skipped,
}

impl Aedat3Decoder {
    /// Reads packets up to the next one with events; returns false at the end.
    fn next_packet(&mut self) -> Result<bool> {
        loop {
            let start = self.input.offset();
            let mut header = [0; PACKET_HEADER];
            match self.input.fill(&mut header)? {
                0 => return Ok(false),
                PACKET_HEADER => {}
                _ => {
                    let what = "the file ends within a packet's header: truncated";
                    return Err(self.input.error_at(start, what));
                }
            }
            let [k0, k1, s0, s1, rest @ ..] = header;
            let kind = u16::from_le_bytes([k0, k1]);
            let source = u16::from_le_bytes([s0, s1]);
            let (numbers, _) = rest.as_chunks::<4>();
            let number = |index: usize| {
                let bytes = numbers.get(index).copied().unwrap_or_default();
                u64::from(u32::from_le_bytes(bytes))
            };
            let (size, overflow, count) = (number(0), number(2), number(4));
            let bytes = size * count;
            if kind & 0x8000 != 0 || size == 0 || bytes > PACKET_MAX || overflow >> 28 != 0 {
                let what = format!(
                    "a packet of type {kind} with {count} events of {size} bytes: damaged or compressed"
                );
                return Err(self.input.error_at(start, what));
            }
            let end = self.input.offset() + bytes;
            if !self.input.reaches(end)? {
                let what = format!("the packet of {bytes} bytes runs past the end: truncated");
                return Err(self.input.error_at(start, what));
            }
            let is_other = self.source.is_some_and(|read| read != source);
            if kind != POLARITY || is_other {
                let what = match kind {
                    POLARITY => "events of further sources",
                    0 => "special events",
                    2 => "frames",
                    3 | 4 => "IMU samples",
                    5 => "ADC samples",
                    7 => "configuration events",
                    _ => "other events",
                };
                self.skipped.add(what, count);
                self.input.seek(end)?;
                continue;
            }
            if size != EVENT_BYTES as u64 {
                let what = format!("polarity events of {size} bytes: only 8 bytes are supported");
                return Err(self.input.error_at(start, what));
            }
            // `bytes` is at most [`PACKET_MAX`].
            self.input.room(&mut self.packet, bytes as usize)?;
            self.packet_at = self.input.offset();
            if self.input.fill(&mut self.packet)? < self.packet.len() {
                return Err(self.input.error_at(start, "truncated packet"));
            }
            (self.next, self.overflow_us) = (0, overflow << 31);
            if count > 0 {
                return Ok(true);
            }
        }
    }
}

impl Decode for Aedat3Decoder {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
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
            let rest = self.packet.get(self.next..).unwrap_or_default();
            let Some([w0, w1, w2, w3, t0, t1, t2, t3]) = rest.first_chunk::<EVENT_BYTES>() else {
                if self.next_packet()? {
                    continue;
                }
                break;
            };
            let word = u32::from_le_bytes([*w0, *w1, *w2, *w3]);
            let low = u32::from_le_bytes([*t0, *t1, *t2, *t3]);
            let offset = self.packet_at + self.next as u64;
            self.next += EVENT_BYTES;
            if word & 1 == 0 {
                self.skipped.add("invalid events", 1);
                continue;
            }
            let (x, y) = ((word >> 17) as u16, (word >> 2 & 0x7fff) as u16);
            if low >> 31 != 0 {
                return Err(self.input.error_at(offset, "a negative time: damaged file"));
            }
            if self.sensor.contains(x, y) {
                batch.push(Event {
                    t_us: self.overflow_us + u64::from(low),
                    x,
                    y,
                    polarity: Polarity::from_bool(word & 2 != 0),
                });
            } else {
                let pixel = (x.into(), y.into());
                self.input
                    .outside(offset, self.events, pixel, self.sensor, &mut self.skipped)?;
            }
            self.events += 1;
        }
        Ok(())
    }
}
