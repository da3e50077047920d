//! AEDAT 1.0 of the DVS128, as jAER wrote it from 2008 to 2010.
//!
//! A file is `#!AER-DAT1.0`, further header lines that begin with `#`, and events of 6 bytes, big-endian: a 16-bit
//! address in the layout `Layout::Dvs128`, and a 32-bit time in us. The time wraps after 71.6 minutes; the wraps
//! are counted. y is as in the file: in jAER it counts upwards. The older files that jAER wrote without any header
//! cannot be distinguished from other bytes and are not read.

use event_types::stream::Result;
use event_types::{Event, Sensor};

use crate::aedat::aedat2::is_header_line;
use crate::aedat::chip::Chip;
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::wrapping::Wrapping;
use crate::{Assumption, Skipped};

/// First line of every AEDAT 1 file, without the minor version and the line end.
pub const MAGIC: &[u8] = b"#!AER-DAT1";

/// Largest length of the header and of a line, in bytes.
const HEADER_MAX: u64 = 1 << 20;
const LINE_MAX: usize = 1 << 16;

/// Bytes of an event.
const EVENT_BYTES: usize = 6;

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "aedat1",
    title: "AEDAT 1",
    endings: &[],
    detect: |start| start.begins(MAGIC),
    open: |Opening { source, name, .. }| Ok(Box::new(Aedat1Reader::new(source, name)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: None,
};

/// A reader of AEDAT 1.0 files.
pub type Aedat1Reader = Reader<Aedat1Decoder>;

impl Aedat1Reader {
    /// Reads the header of `source`, which messages call `name`; the events follow by
    /// [`crate::EventReader::read`].
    ///
    /// # Errors
    /// There is no AEDAT 1.0 header.
    pub fn new(source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let mut line = Vec::new();
        loop {
            let start = input.offset();
            line.clear();
            input.line(&mut line, LINE_MAX)?;
            if start == 0 && !line.starts_with(MAGIC) {
                return Err(input.error_at(0, "no AEDAT 1.0 header (#!AER-DAT1.0)"));
            }
            if start > HEADER_MAX {
                return Err(input.error("the header is longer than 1 MiB: damaged file"));
            }
            if !is_header_line(&line) {
                input.seek(start)?;
                break;
            }
        }
        Ok(Self::around(Aedat1Decoder {
            input,
            words: Words::default(),
            assumptions: [Assumption {
                what: "chip",
                taken: "DVS128 of 128x128".to_owned(),
                why: "AEDAT 1 names no chip".to_owned(),
            }],
            time: Wrapping::new(32, 0),
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`Aedat1Reader`]: its state between two events.
pub struct Aedat1Decoder {
    input: Input,
    words: Words<EVENT_BYTES>,
    assumptions: [Assumption; 1],
    time: Wrapping,
    skipped: Skipped,
}

impl Decode for Aedat1Decoder {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn sensor(&self) -> Sensor {
        Chip::DVS128.sensor
    }

    fn camera(&self) -> Option<&str> {
        Some("DVS128")
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    /// Always true: no address lies outside 128x128.
    fn leave_out_bad_events(&mut self) -> bool {
        true
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() > 0 {
            let Some([a0, a1, t0, t1, t2, t3]) = self.words.next(&mut self.input)? else {
                break;
            };
            let low = u32::from_be_bytes([t0, t1, t2, t3]);
            let t_us = self.time.extend(u64::from(low));
            match Chip::DVS128.decode(u16::from_be_bytes([a0, a1]).into()) {
                Ok((x, y, polarity)) => batch.push(Event {
                    t_us,
                    // x and y have seven bits each.
                    x: x as u16,
                    y: y as u16,
                    polarity,
                }),
                Err(kind) => self.skipped.add(kind, 1),
            }
        }
        Ok(())
    }
}
