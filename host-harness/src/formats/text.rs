//! Events as lines of text: `t x y p`, `x y t p`, `t,x,y,on` and the like.
//!
//! Rules, in the order in which they are applied:
//!
//! 1. Lines end with LF or CRLF; empty lines and lines that begin with `#` or `%` are skipped and
//!    counted as comments. A byte-order mark is skipped.
//! 2. Fields are separated by commas, semicolons, tabs or spaces, any number of them.
//! 3. A first line of two whole numbers is the sensor's width and height (the RPG data set).
//! 4. A line whose fields are not numbers names the columns: t (ts, time, timestamp; `_s`, `_ms`,
//!    `_us`, `_ns` name the unit), x, y, p (pol, polarity, on), in any order, other columns are
//!    ignored. `x@320` and `y@240` give the size. A comment of such names counts as well.
//! 5. Without names the order is the first of `t x y p`, `x y t p`, `x y p t`, `t p x y`,
//!    `p t x y`, `p x y t` that fits the first 1,000 lines: see [`Layout::detect`].
//! 6. Times without a fraction are microseconds. Where most of the first 1,000 times are written
//!    as decimals, they are seconds, unless all of them are whole and many or large: then they are whole microseconds in a float column.
//!    Decimals are parsed exactly and rounded to the nearest microsecond.
//! 7. p is 1, true or on, or else 0, -1, false or off.
//! 8. Where neither the file nor the caller knows the size, a first pass over the file finds the
//!    largest x and y, and the size is these plus one.
//!
//! Parsing is our own: the formats have no quoting, and no CSV crate converts decimals to
//! microseconds without a float.

use eecvs_nostd::{Event, Polarity, Sensor};

use super::Skipped;
use super::decimal::Decimal;
use super::format::{self, Format, Limits, Opening};
use super::input::{Batch, Decode, Input, ReadSeek, Reader};
pub use super::text_layout::Layout;
use super::text_layout::{Header, Unit, polarity};
use super::text_writer::TextWriter;

/// Longest line.
const LINE_MAX: usize = 4096;

/// Fields kept of a line; a file of more columns is no event file.
const FIELDS_MAX: usize = 32;

/// Event lines that the layout is found from.
const SAMPLE_LINES: usize = 1000;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "text",
    title: "text t x y p",
    endings: &[".csv", ".txt"],
    detect: is_text,
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(TextReader::new(source, name, reading.size)?)),
    has_places: false,
    grows: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(TextWriter::create(path, sensor)?))),
};

/// Whether a file may be lines of events: its first line is text without control characters but
/// separators. What follows may be damaged, which the reader reports after the events before it.
fn is_text(start: &format::Start) -> bool {
    if let Some(header) = &start.header
        && header
            .words
            .as_ref()
            .err()
            .is_none_or(|other| !other.is_empty())
    {
        // Words that no reader knows.
        return false;
    }
    let first = start.bytes.split(|byte| *byte == b'\n').next();
    let first = first.unwrap_or_default();
    let control = |byte: &u8| byte.is_ascii_control() && !b"\t\r".contains(byte);
    let is_other_aedat = start.begins(b"#!AER-DAT");
    std::str::from_utf8(first).is_ok() && !first.iter().any(control) && !is_other_aedat
}

/// Reader of text files.
pub type TextReader = Reader<TextDecoder>;

impl TextReader {
    /// Reads `source`, which messages call `name`; `size` counts where the file names no size.
    ///
    /// # Errors
    /// Columns that cannot be told apart, a damaged first line, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
        let mut lines = Lines::new(Input::new(source, name)?);
        let start = Start::read(&mut lines)?;
        let stated = match start.size {
            Some((width, height)) => {
                let side = |side| u16::try_from(side).unwrap_or(0);
                let sensor = Sensor::new(side(width), side(height));
                Some(sensor.ok_or_else(|| {
                    lines.error(format!("sensor size {width}x{height} is out of range"))
                })?)
            }
            None => size,
        };
        let fields: Vec<Vec<&[u8]>> = start.sample.iter().map(|line| split(line)).collect();
        let layout = Layout::detect(start.header.as_ref(), &fields, stated)
            .map_err(|what| lines.input.error_at(start.data, what))?;
        lines.restart(&start)?;
        let mut decoder = TextDecoder {
            lines,
            layout,
            sensor: LARGEST,
            events: 0,
            skipped: start.skipped.clone(),
        };
        decoder.sensor = match stated {
            Some(sensor) => sensor,
            None => {
                let sensor = decoder.largest()?;
                decoder.skipped = start.skipped.clone();
                decoder.lines.restart(&start)?;
                sensor
            }
        };
        Ok(Self::around(decoder))
    }
}

const LARGEST: Sensor = Sensor {
    width: Sensor::SIDE_MAX,
    height: Sensor::SIDE_MAX,
};

/// Lines with their numbers.
struct Lines {
    input: Input,
    line: Vec<u8>,
    /// Number of the present line, from 1, and its offset.
    number: u64,
    offset: u64,
}

impl Lines {
    fn new(input: Input) -> Self {
        Self {
            input,
            line: Vec::with_capacity(LINE_MAX),
            number: 0,
            offset: 0,
        }
    }

    /// Moves to the next line; `false` at the end.
    fn advance(&mut self) -> anyhow::Result<bool> {
        self.line.clear();
        self.offset = self.input.offset();
        let read = self.input.line(&mut self.line, LINE_MAX)?;
        self.number += 1;
        if read == LINE_MAX && self.line.last() != Some(&b'\n') {
            return Err(self.error("the line is longer than 4096 bytes: no event text"));
        }
        if self.number == 1 && self.line.starts_with(b"\xef\xbb\xbf") {
            self.line.drain(..3);
        }
        while self.line.last().is_some_and(u8::is_ascii_whitespace) {
            self.line.pop();
        }
        Ok(read > 0)
    }

    /// Whether the present line holds no event.
    fn is_comment(&self) -> bool {
        let first = self.line.iter().find(|byte| !byte.is_ascii_whitespace());
        matches!(first, None | Some(b'#' | b'%'))
    }

    fn error(&self, what: impl std::fmt::Display) -> anyhow::Error {
        self.input
            .error_at(self.offset, format!("line {}: {what}", self.number))
    }

    fn restart(&mut self, start: &Start) -> anyhow::Result<()> {
        self.input.seek(start.data)?;
        self.number = start.data_line - 1;
        Ok(())
    }
}

/// What the start of a file tells.
struct Start {
    size: Option<(u64, u64)>,
    header: Option<Header>,
    /// The first event lines.
    sample: Vec<Vec<u8>>,
    /// Offset and number of the first event line.
    data: u64,
    data_line: u64,
    skipped: Skipped,
}

impl Start {
    fn read(lines: &mut Lines) -> anyhow::Result<Self> {
        let mut start = Self {
            size: None,
            header: None,
            sample: Vec::new(),
            data: 0,
            data_line: 1,
            skipped: Skipped::default(),
        };
        while start.sample.len() < SAMPLE_LINES {
            match lines.advance() {
                Ok(true) => {}
                Ok(false) => break,
                // The reader will meet it again, after the events before it.
                Err(_) if !start.sample.is_empty() => break,
                Err(error) => return Err(error),
            }
            let first_event = start.sample.is_empty();
            if lines.is_comment() {
                if first_event {
                    let text = lines.line.trim_ascii_start().get(1..).unwrap_or_default();
                    start.header = start.header.take().or_else(|| Header::parse(&split(text)));
                    start
                        .skipped
                        .add("comment lines", u64::from(!lines.line.is_empty()));
                }
                continue;
            }
            let fields = split(&lines.line);
            if first_event {
                let numbers: Vec<_> = fields.iter().map(|field| Decimal::parse(field)).collect();
                if let ([Some(width), Some(height)], None) = (numbers.as_slice(), start.size) {
                    start.size = width.whole().zip(height.whole());
                    if start.size.is_some() {
                        continue;
                    }
                }
                if numbers.iter().all(Option::is_none) || numbers.len() > 4 {
                    if let Some(header) = Header::parse(&fields) {
                        start.header = Some(header);
                        continue;
                    }
                    if start.header.is_none() {
                        return Err(lines.error("no events and no column names t, x, y, p"));
                    }
                }
                (start.data, start.data_line) = (lines.offset, lines.number);
            }
            start.sample.push(lines.line.clone());
        }
        if start.sample.is_empty() {
            (start.data, start.data_line) = (lines.input.offset(), lines.number);
        }
        start.size = start
            .size
            .or(start.header.as_ref().and_then(|header| header.sensor));
        Ok(start)
    }
}

/// Fields of a line.
fn split(line: &[u8]) -> Vec<&[u8]> {
    let separator = |byte: &u8| matches!(byte, b' ' | b'\t' | b',' | b';');
    line.split(separator)
        .filter(|field| !field.is_empty())
        .take(FIELDS_MAX)
        .collect()
}

/// State between two lines.
pub struct TextDecoder {
    lines: Lines,
    layout: Layout,
    sensor: Sensor,
    events: u64,
    skipped: Skipped,
}

impl TextDecoder {
    /// Size that holds every event from here to the end.
    fn largest(&mut self) -> anyhow::Result<Sensor> {
        let (mut width, mut height) = (0, 0);
        // Damage after the first event is for the reader, which returns the events before it.
        while let Ok(Some(event)) = self.next_event() {
            width = width.max(event.x + 1);
            height = height.max(event.y + 1);
        }
        self.events = 0;
        Sensor::new(width, height).ok_or_else(|| {
            self.lines
                .error("no event, so no sensor size: give --width W --height H")
        })
    }

    fn next_event(&mut self) -> anyhow::Result<Option<Event>> {
        loop {
            if !self.lines.advance()? {
                return Ok(None);
            }
            if !self.lines.is_comment() {
                break;
            }
            self.skipped
                .add("comment lines", u64::from(!self.lines.line.is_empty()));
        }
        let event = self.parse()?;
        self.events += 1;
        Ok(Some(event))
    }

    fn parse(&self) -> anyhow::Result<Event> {
        let line = self.lines.line.as_slice();
        let mut fields = [&line[..0]; FIELDS_MAX];
        let mut count = 0;
        let separator = |byte: &u8| matches!(byte, b' ' | b'\t' | b',' | b';');
        for field in line.split(separator).filter(|field| !field.is_empty()) {
            match fields.get_mut(count) {
                Some(slot) => *slot = field,
                None => break,
            }
            count += 1;
        }
        let Layout {
            columns,
            t,
            x,
            y,
            p,
            unit,
        } = self.layout;
        let wrong = |what: &str| self.lines.error(format!("event {}: {what}", self.events));
        if count != columns {
            return Err(wrong(&format!("{count} fields instead of {columns}")));
        }
        let field = |column: usize| fields.get(column).copied().unwrap_or_default();
        let (t, p) = (field(t), field(p));
        let time = Decimal::parse(t).ok_or_else(|| wrong("the time is no number"))?;
        let shift = match unit {
            Unit::Shift(shift) => shift,
            Unit::Whole if time.is_whole() => 0,
            Unit::Whole => {
                return Err(wrong(
                    "a time with a fraction after whole microseconds: name the column t_s or t_us",
                ));
            }
        };
        let t_us = time
            .scaled(shift)
            .map_err(|_| wrong("the time is negative or above 2^63 us"))?;
        let side = |field: &[u8]| Decimal::parse(field).and_then(Decimal::whole);
        let (Some(x), Some(y)) = (side(field(x)), side(field(y))) else {
            return Err(wrong("x and y must be whole numbers that are not negative"));
        };
        let polarity =
            polarity(p).ok_or_else(|| wrong("the polarity is not one of 0, 1, -1, true, false"))?;
        match (u16::try_from(x), u16::try_from(y)) {
            (Ok(x), Ok(y)) if self.sensor.contains(x, y) => Ok(Event {
                t_us,
                x,
                y,
                polarity: Polarity::from_bool(polarity),
            }),
            _ => {
                let Sensor { width, height } = self.sensor;
                Err(wrong(&format!(
                    "x = {x}, y = {y} is outside of the sensor ({width}x{height})"
                )))
            }
        }
    }
}

impl Decode for TextDecoder {
    fn format(&self) -> &'static str {
        "text"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        while batch.room() > 0 {
            let Some(event) = self.next_event()? else {
                break;
            };
            batch.push(event);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::super::EventReader;
    use super::*;

    fn read(text: &str) -> Result<(Sensor, Vec<Event>), String> {
        let source = Box::new(Cursor::new(text.as_bytes().to_vec()));
        let mut reader = TextReader::new(source, "test", None).map_err(|e| e.to_string())?;
        let mut events = Vec::new();
        while reader.read(&mut events).map_err(|e| e.to_string())? > 0 {}
        Ok((reader.sensor(), events))
    }

    #[test]
    fn the_same_two_events_in_many_layouts() {
        let event = |t_us, x, y, on| Event {
            t_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        };
        let want = [
            event(1_500_000, 218, 15, true),
            event(1_500_003, 9, 76, false),
        ];
        let sized = Sensor {
            width: 240,
            height: 180,
        };
        let found = Sensor {
            width: 219,
            height: 77,
        };
        let cases = [
            ("1.500000000 218 15 1\n1.500003000 9 76 0\n", found),
            ("1500000 218 15 1\n1500003 9 76 0", found),
            ("1500000,218,15,1\r\n1500003,9,76,-1\r\n", found),
            ("t;x;y;p\n1500000;218;15;1\n1500003;9;76;0\n", found),
            (
                "x y p timestamp\n218\t15\tTrue\t1500000\n9\t76\tFalse\t1500003\n",
                found,
            ),
            ("218 15 1.5 1\n9 76 1.500003 0\n", found),
            ("218 15 1 1500000\n9 76 0 1500003\n", found),
            ("1500000 1 218 15\n1500003 0 9 76\n", found),
            ("240 180\n1.5 218 15 1\n1.5000029999 9 76 0\n", sized),
            (
                "t,x@240,y@180,on\n1500000,218,15,1\n1500003,9,76,0\n",
                sized,
            ),
            (
                "# t x y p\n1500000 218 15 1\n\n# half\n1500003 9 76 0\n",
                found,
            ),
            (
                "id,t_ms,x,y,pol\n1,1500,218,15,on\n2,1500.003,9,76,off\n",
                found,
            ),
            (
                "t_ns,x,y,p\n1500000400,218,15,1\n1500002500,9,76,0\n",
                found,
            ),
            (
                "t,x,y,p\n1500000.0,218.0,15.0,1.0\n1.5000030e6,9.0,76.0,0.0\n",
                found,
            ),
            ("\u{feff}t,x,y,p\n1.5,218,15,1\n1.500003,9,76,0\n", found),
        ];
        for (text, sensor) in cases {
            // Two whole decimals are seconds: this one needs its unit.
            let text = text.replacen("t,x,y,p\n1500000.0", "t_us,x,y,p\n1500000.0", 1);
            assert_eq!(read(&text), Ok((sensor, want.to_vec())), "{text}");
        }
    }

    #[test]
    fn errors_name_line_and_event() {
        let cases = [
            (
                "t,x,y,p\n1,2,3,1\n-4,2,3,1\n",
                "line 3: event 1: the time is negative",
            ),
            (
                "t,x,y,p\n1,2,3,1\n4,2,3\n",
                "line 3: event 1: 3 fields instead of 4",
            ),
            (
                "t,x,y,p\n1,2,3,1\n4,2,3,5\n",
                "line 3: event 1: the polarity",
            ),
            ("t,x,y,p\n1,2,3,1\n4,2,-3,1\n", "line 3: event 1: x and y"),
            (
                "4 4\n1 2 3 1\n2 4 0 1\n",
                "line 3: event 1: x = 4, y = 0 is outside",
            ),
            (
                "t,x,y,p\n1,2,3,1\n1,2,3,1\n1.5,2,3,1\n",
                "line 4: event 2: a time with a fraction",
            ),
            ("9 2 3 4\n5 6 7 8\n", "the order of the columns is unclear"),
            ("hello world\n", "no events and no column names"),
            ("t,x,y,p\n", "no event, so no sensor size"),
        ];
        for (text, want) in cases {
            let error = read(text).expect_err(text);
            assert!(error.contains(want) && error.contains("byte "), "{error}");
        }
    }

    #[test]
    fn rising_times_tell_the_order() {
        let lines = |order: fn(u32) -> String| (0..40).map(order).collect::<String>();
        // Every column is below 2048, so only the times tell.
        let xytp = lines(|i| format!("{} {} {} {}\n", i * 37 % 300, i * 91 % 200, i * 9, i % 2));
        let (_, events) = read(&xytp).expect("events");
        assert_eq!((events[1].t_us, events[1].x, events[1].y), (9, 37, 91));
        let txyp = lines(|i| format!("{} {} {} {}\n", i * 9, i * 37 % 300, i * 91 % 200, i % 2));
        assert_eq!(read(&txyp).expect("events").1, events);
    }
}
