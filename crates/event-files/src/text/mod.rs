//! Reads and writes events as lines of text: `t x y p`, `x y t p`, `t,x,y,on` and the like.
//!
//! Rules for reading, in the order in which they are applied:
//!
//! 1. Lines end with LF or CRLF. Empty lines and lines that begin with `#` or `%` are skipped; the latter are
//!    counted as comments. A byte-order mark is skipped; UTF-16 with one is read as described in `utf16.rs`.
//! 2. Fields are separated by any number of commas, semicolons, tabs or spaces; quotes around a field are removed.
//!    Decimal commas are an error.
//! 3. A first line of two whole numbers is the sensor's width and height (the RPG data set).
//! 4. A line whose fields are not numbers names the columns: t (ts, time, timestamp; `_us`, `(us)`, `[us]` and the
//!    like state the unit), x, y, p (pol, polarity, on), in any order; other columns and those without a name are
//!    ignored. `x@320` and `y@240` state the size. A comment with as many names as the first event has fields is
//!    used likewise. The columns that the caller states, by positions or names, take precedence.
//! 5. Without names, the order is the one of `t x y p`, `x y t p`, `x y p t`, `t p x y`, `p t x y`, `p x y t` that
//!    fits the first 4,096 lines: see [`Layout::from_numbers`]. If several fit, the error asks for `--columns`.
//! 6. The time's unit is the caller's, or the name's; otherwise it is found by the rule in `time_unit.rs` and
//!    reported as an assumption. Decimals are parsed exactly and rounded to the nearest microsecond. The caller's
//!    offset is added.
//! 7. p is 1, true or on; or 0, -1, false or off. Both 0 and -1 in one file are an error.
//! 8. If neither the file nor the caller states the size, a first pass over the file finds the largest x and y, and
//!    the size is these plus one.
//! 9. A last line without a line break is an event; if it ends with a time, x or y, which may have been cut, this
//!    is reported as an assumption.
//! 10. A line that is not an event ends the recording with an error, or is left out and counted by its cause.
//!
//! The parser is part of this crate: no CSV crate converts decimals to microseconds without a float.

pub(crate) mod decimal;
pub mod layout;
mod plain;
pub(crate) mod utf16;
pub(crate) mod writer;

use event_types::stream::{ErrorKind, Result};
use event_types::{Event, Polarity, Sensor};

use crate::format::{Format, Limits, Opening};
use crate::input::marked::MARK;
use crate::input::{Batch, Decode, Input, OUTSIDE, ReadSeek, Reader};
use crate::reading::{Columns, Reading, TimeUnit};
use crate::table::time_unit;
use crate::text::decimal::Decimal;
pub use crate::text::layout::Layout;
use crate::text::layout::{Found, Header, polarity, times_of};
use crate::text::plain::{Fields, Plain, Sign};
use crate::text::utf16::Utf16;
pub(crate) use crate::text::utf16::is_utf16;
use crate::text::writer::TextWriter;
use crate::{Assumption, BadEvents, Skipped, format};

/// Longest line in bytes.
const LINE_MAX: usize = 4096;

/// Largest number of fields kept of a line; a file with more columns is not an event file.
const FIELDS_MAX: usize = 32;

/// Most lines that are parsed together.
const TOGETHER: usize = 256;

/// Number of event lines from which the layout is found.
const SAMPLE_LINES: usize = time_unit::SAMPLE_TIMES;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "text",
    title: "text t x y p",
    endings: &[".txt"],
    detect: is_text,
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(TextReader::new(source, name, reading)?)),
    has_places: false,
    is_table: true,
    grows: true,
    streams: true,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(TextWriter::create(path, sensor, b' ')?))),
};

/// The format with commas and names, which is read like [`FORMAT`].
pub const CSV_FORMAT: Format = Format {
    name: "csv",
    title: "CSV",
    endings: &[".csv"],
    create: Some(|path, sensor| Ok(Box::new(TextWriter::create(path, sensor, b',')?))),
    ..FORMAT
};

/// Returns whether a file may hold lines of events: its first line is text without control characters other than
/// separators. Anything after it may be damaged; the reader reports that after the events before it.
fn is_text(start: &format::Start) -> bool {
    if let Some(header) = &start.header
        && header
            .words
            .as_ref()
            .err()
            .is_none_or(|other| !other.is_empty())
    {
        // Words that no reader recognises.
        return false;
    }
    if is_utf16(start.bytes) {
        return true;
    }
    let first = start.bytes.split(|byte| *byte == b'\n').next();
    let first = first.unwrap_or_default();
    let control = |byte: &u8| byte.is_ascii_control() && !b"\t\r".contains(byte);
    let is_other_aedat = start.begins(b"#!AER-DAT");
    std::str::from_utf8(first).is_ok() && !first.iter().any(control) && !is_other_aedat
}

/// A reader of text files.
pub type TextReader = Reader<TextDecoder>;

impl TextReader {
    /// Reads `source`, which messages call `name`; the size in `reading` is used if the file states none.
    ///
    /// # Errors
    /// The columns, the unit or the size cannot be determined; the first line is damaged.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, reading: impl Into<Reading>) -> Result<Self> {
        let reading = reading.into();
        let mut input = Input::new(source, name)?;
        let mut mark = [0; 4];
        input.fill(&mut mark)?;
        input.seek(0)?;
        if is_utf16(&mark) {
            let [first, ..] = mark;
            input = Input::new(Box::new(Utf16::new(input.into_source(), first)), name)?;
        }
        let mut lines = Lines::new(input);
        let start = Start::read(&mut lines, &reading)?;
        let stated = match start.size {
            Some((width, height)) => {
                let side = |side| u16::try_from(side).unwrap_or(0);
                let sensor = Sensor::new(side(width), side(height));
                Some(sensor.ok_or_else(|| {
                    lines.error(format!("sensor size {width}x{height} is out of range"))
                })?)
            }
            None => reading.size,
        };
        let fields: Vec<Vec<&[u8]>> = start.sample.iter().map(|line| split(line)).collect();
        let wrong = |what: String| {
            let what = format!("line {}: {what}", start.data_line);
            lines
                .input
                .error_at(start.data, what)
                .of_kind(ErrorKind::Undecided)
        };
        let Found { layout, why } = match &start.layout {
            Some(layout) => Found {
                layout: layout.clone(),
                why: None,
            },
            None => Layout::from_numbers(&fields, stated).map_err(|what| wrong(what.to_owned()))?,
        };
        let mut assumptions = Vec::new();
        if let Some(why) = why {
            assumptions.push(Assumption {
                what: "columns",
                taken: layout.title(),
                why: format!("{why}; --columns overrides this"),
            });
        }
        let (times, whole) = times_of(&fields, layout.t);
        let mut has_whole_times = false;
        let unit = match reading.time_unit.or(layout.unit) {
            Some(unit) => unit,
            None => {
                let taken = time_unit::unstated(&times, whole).map_err(wrong)?;
                has_whole_times = whole && taken.unit == TimeUnit::Us;
                if !times.is_empty() {
                    assumptions.push(Assumption {
                        what: "time unit",
                        taken: taken.unit.name().to_owned(),
                        why: taken.why,
                    });
                }
                taken.unit
            }
        };
        let polarities = Polarities::of(&fields, layout.p);
        lines.restart(&start)?;
        let mut decoder = TextDecoder {
            lines,
            plain: Plain::new(&layout),
            rules: Rules {
                layout,
                unit,
                has_whole_times,
                offset_us: reading.time_offset_us,
                polarities,
                is_rounded: false,
                assumptions,
                sensor: LARGEST,
            },
            leaves_out: reading.bad_events == BadEvents::LeaveOut,
            is_cut_noted: false,
            events: 0,
            skipped: start.skipped.clone(),
        };
        decoder.rules.sensor = match stated {
            Some(sensor) => sensor,
            None => {
                let sensor = decoder.largest()?;
                decoder.skipped = start.skipped.clone();
                decoder.rules.polarities = polarities;
                decoder.lines.restart(&start)?;
                let assumptions = &mut decoder.rules.assumptions;
                assumptions.push(Assumption::size_taken(sensor));
                sensor
            }
        };
        Ok(Self::around(decoder))
    }
}

/// The values of OFF that have occurred in a file.
#[derive(Debug, Clone, Copy, Default)]
struct Polarities {
    zero: bool,
    minus: bool,
    /// Whether the first lines have both 0 and -1; in `CeleX` files 0 means no change.
    third: bool,
}

impl Polarities {
    fn of(lines: &[Vec<&[u8]>], column: usize) -> Self {
        let has = |value: &[u8]| {
            let mut fields = lines.iter().filter_map(|line| line.get(column));
            fields.any(|field| *field == value)
        };
        Self {
            third: has(b"0") && has(b"-1"),
            ..Self::default()
        }
    }

    /// Adds the polarity of an event, if it is written as such a number; returns whether it is still one of two.
    #[inline]
    fn takes(&mut self, sign: Option<Sign>) -> bool {
        match sign {
            Some(Sign::Zero) if self.third => return false,
            Some(Sign::Zero) => self.zero = true,
            Some(Sign::MinusOne) => self.minus = true,
            _ => {}
        }
        !(self.zero && self.minus)
    }
}

const LARGEST: Sensor = Sensor {
    width: Sensor::SIDE_MAX,
    height: Sensor::SIDE_MAX,
};

/// The lines of a file, with their numbers.
struct Lines {
    input: Input,
    line: Vec<u8>,
    /// Number of the current line, from 1, and its offset.
    number: u64,
    offset: u64,
    /// Whether the current line has a line break.
    is_ended: bool,
}

impl Lines {
    fn new(input: Input) -> Self {
        Self {
            input,
            line: Vec::with_capacity(LINE_MAX),
            number: 0,
            offset: 0,
            is_ended: true,
        }
    }

    /// Moves to the next line; returns `false` at the end.
    fn advance(&mut self) -> Result<bool> {
        self.line.clear();
        self.offset = self.input.offset();
        let read = self.input.line(&mut self.line, LINE_MAX)?;
        self.number += 1;
        self.is_ended = self.line.last() == Some(&b'\n');
        if read == LINE_MAX && self.line.last() != Some(&b'\n') {
            return Err(self.error("the line is longer than 4096 bytes: not event text"));
        }
        if self.number == 1 && self.line.starts_with(MARK) {
            self.line.drain(..MARK.len());
        }
        while self.line.last().is_some_and(u8::is_ascii_whitespace) {
            self.line.pop();
        }
        Ok(read > 0)
    }

    /// Moves past `count` lines of `bytes` bytes in all.
    fn pass(&mut self, bytes: usize, count: u64) {
        self.input.consume(bytes);
        self.number += count;
    }

    /// Returns whether the current line is empty or a comment.
    fn is_comment(&self) -> bool {
        let first = self.line.iter().find(|byte| !byte.is_ascii_whitespace());
        matches!(first, None | Some(b'#' | b'%'))
    }

    fn error(&self, what: impl std::fmt::Display) -> event_types::stream::Error {
        self.input
            .error_at(self.offset, format!("line {}: {what}", self.number))
    }

    fn restart(&mut self, start: &Start) -> Result<()> {
        self.input.seek(start.data)?;
        self.number = start.data_line - 1;
        Ok(())
    }
}

/// What the start of a file states.
struct Start {
    size: Option<(u64, u64)>,
    /// The layout that column names or the caller state.
    layout: Option<Layout>,
    /// The first event lines.
    sample: Vec<Vec<u8>>,
    /// Offset and number of the first event line.
    data: u64,
    data_line: u64,
    skipped: Skipped,
}

impl Start {
    fn read(lines: &mut Lines, reading: &Reading) -> Result<Self> {
        let columns = reading.columns.as_ref();
        let mut start = Self {
            size: None,
            layout: columns.and_then(Layout::of_places),
            sample: Vec::new(),
            data: 0,
            data_line: 1,
            skipped: Skipped::default(),
        };
        let parse = |fields: &[&[u8]]| match columns {
            Some(Columns::Names(names)) => Header::of_names(fields, names),
            _ => Header::parse(fields),
        };
        let mut comment: Option<Header> = None;
        let mut has_names = false;
        while start.sample.len() < SAMPLE_LINES {
            match lines.advance() {
                Ok(true) => {}
                Ok(false) => break,
                // The reader meets the error again, after the events before it.
                Err(_) if !start.sample.is_empty() => break,
                Err(error) => return Err(error),
            }
            let is_before = start.sample.is_empty();
            if lines.is_comment() {
                if is_before {
                    let text = lines.line.trim_ascii_start().get(1..).unwrap_or_default();
                    comment = comment.or_else(|| parse(&names(text)));
                    start
                        .skipped
                        .add("comment lines", u64::from(!lines.line.is_empty()));
                }
                continue;
            }
            if is_before {
                let fields = split(&lines.line);
                let numbers: Vec<_> = fields.iter().map(|field| Decimal::parse(field)).collect();
                // After column names, two numbers are an event with missing fields.
                if let ([Some(width), Some(height)], None) = (numbers.as_slice(), start.size)
                    && !has_names
                    && comment.is_none()
                {
                    start.size = width.whole().zip(height.whole());
                    if start.size.is_some() {
                        continue;
                    }
                }
                if numbers.iter().all(Option::is_none) && !has_names {
                    has_names = true;
                    if let Some(header) = parse(&names(&lines.line)) {
                        start.take(&header);
                    } else if start.layout.is_none() {
                        return Err(lines.error(match columns {
                            Some(_) => "these are not the column names that --columns gives",
                            None => {
                                "no events and no column names t, x, y, p: name the columns with \
                                 --columns"
                            }
                        }).of_kind(ErrorKind::Undecided));
                    }
                    continue;
                }
                if fields.iter().take(2).any(|field| field.contains(&b':')) {
                    let what = "a date or a time of day: write times as numbers, such as seconds since 1970";
                    return Err(lines.error(what));
                }
                if has_decimal_comma(&lines.line) {
                    let what = "a comma within a field, as in numbers with a decimal comma: write \
                                decimal points";
                    return Err(lines.error(what));
                }
                // The words of a comment may be names by chance.
                if let Some(header) = &comment
                    && header.layout().columns == fields.len()
                {
                    start.take(header);
                }
                if start.layout.is_none() && matches!(columns, Some(Columns::Names(_))) {
                    return Err(lines
                        .error("no earlier line has the column names that --columns gives")
                        .of_kind(ErrorKind::Undecided));
                }
                (start.data, start.data_line) = (lines.offset, lines.number);
            }
            start.sample.push(lines.line.clone());
        }
        if start.sample.is_empty() {
            (start.data, start.data_line) = (lines.input.offset(), lines.number);
            if let Some(header) = &comment {
                start.take(header);
            }
        }
        Ok(start)
    }

    /// Takes from the column names what is not known yet.
    fn take(&mut self, header: &Header) {
        self.layout = self.layout.take().or_else(|| Some(header.layout().clone()));
        self.size = self.size.or(header.sensor);
    }
}

const fn is_separator(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b',' | b';')
}

/// Returns a field without the quotes around it.
fn unquoted(field: &[u8]) -> &[u8] {
    match field {
        [b'"', inner @ .., b'"'] => inner,
        field => field,
    }
}

/// Returns the fields of a line.
fn split(line: &[u8]) -> Vec<&[u8]> {
    line.split(|byte| is_separator(*byte))
        .filter(|field| !field.is_empty())
        .take(FIELDS_MAX)
        .map(unquoted)
        .collect()
}

/// Returns the column names of a line; between commas, semicolons or tabs, a name may be empty or have several
/// words.
fn names(line: &[u8]) -> Vec<&[u8]> {
    let separator = [b',', b';', b'\t']
        .into_iter()
        .find(|byte| line.contains(byte));
    match separator {
        Some(separator) => {
            let names = line.split(|byte| *byte == separator);
            names.take(FIELDS_MAX).collect()
        }
        None => split(line),
    }
}

/// Returns whether a comma stands between two digits in a line with another separator.
fn has_decimal_comma(line: &[u8]) -> bool {
    let is_decimal = line.windows(3).any(|letters| {
        matches!(letters, [before, b',', after] if before.is_ascii_digit() && after.is_ascii_digit())
    });
    // A space beside a comma is only padding.
    let separates = |letters: &[u8]| matches!(letters, [before, b' ', after] if !is_separator(*before) && !is_separator(*after));
    let others = line.contains(&b';') || line.contains(&b'\t') || line.windows(3).any(separates);
    is_decimal && others
}

/// The decoder of [`TextReader`]: its state between two lines.
pub struct TextDecoder {
    lines: Lines,
    plain: Plain,
    rules: Rules,
    leaves_out: bool,
    /// Whether the last line has no line break and an assumption says so.
    is_cut_noted: bool,
    events: u64,
    skipped: Skipped,
}

/// What makes an event of a line's fields.
struct Rules {
    layout: Layout,
    unit: TimeUnit,
    /// Whether the unit was inferred from times without fractions.
    has_whole_times: bool,
    offset_us: i64,
    polarities: Polarities,
    /// Whether a time has been rounded and an assumption says so.
    is_rounded: bool,
    assumptions: Vec<Assumption>,
    sensor: Sensor,
}

/// The reason why a line is not an event.
enum Bad {
    Fields(usize),
    NoTime,
    Fraction,
    TimeRange,
    NoPixel,
    NoPolarity,
    ThirdPolarity,
    Outside(u64, u64),
}

impl Bad {
    const fn kind(&self) -> &'static str {
        match self {
            Self::Fields(_) => "lines of another number of fields",
            Self::NoTime | Self::NoPixel => "events with a value that is no number",
            Self::Fraction => "events with a time of another unit",
            Self::TimeRange => "events before time 0",
            Self::NoPolarity => "events of no polarity",
            Self::ThirdPolarity => "events of a third polarity",
            Self::Outside(..) => OUTSIDE,
        }
    }
}

impl TextDecoder {
    /// Returns the smallest sensor that holds every event from here to the end or the first damage.
    fn largest(&mut self) -> Result<Sensor> {
        let (mut width, mut height) = (0, 0);
        let mut events = Vec::with_capacity(crate::BATCH_EVENTS);
        loop {
            events.clear();
            // The reader reports damage after the first event, after it has returned the events before it.
            let is_sound = self.decode_lines(&mut Batch::new(&mut events)).is_ok();
            for event in &events {
                width = width.max(event.x + 1);
                height = height.max(event.y + 1);
            }
            if events.is_empty() || !is_sound {
                break;
            }
        }
        if width == 0 && !self.lines.line.is_empty() {
            // The first line is not an event.
            self.parse().map_err(|bad| self.refusal(&bad))?;
        }
        self.events = 0;
        Sensor::new(width, height).ok_or_else(|| {
            self.lines
                .error("no event, so no sensor size: give --width W --height H")
                .of_kind(ErrorKind::Undecided)
        })
    }

    /// Appends events until the batch has no room left, or the file ends.
    fn decode_lines(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        loop {
            self.decode_plain(batch)?;
            if batch.room() == 0 {
                return Ok(());
            }
            // A line that is not plain, or lies in two blocks, or ends the file.
            let Some(event) = self.next_event()? else {
                return Ok(());
            };
            batch.push(event);
        }
    }

    /// Appends the events of plain lines up to the first other one, the end of the block that was read, or that of the
    /// batch's room.
    fn decode_plain(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        let Self {
            lines,
            plain,
            rules,
            ..
        } = self;
        let block = lines.input.block()?;
        let mut scratch = [Event::UNSET; TOGETHER];
        let (mut taken, mut count) = (0, 0);
        while batch.room() > 0 {
            let rest = block.get(taken..).unwrap_or_default();
            if rules.is_as_written() {
                let most = batch.room().min(TOGETHER);
                let room = scratch.get_mut(..most).unwrap_or_default();
                let run = plain.parse_many(rest, rules.sensor, room);
                batch.extend(scratch.iter().take(run.lines).copied());
                rules.polarities.zero |= run.has_zero;
                taken += run.bytes;
                count += run.lines as u64;
                if run.lines > 0 {
                    continue;
                }
            }
            let fields = plain.parse(rest);
            let event = fields.and_then(|fields| Some((rules.event(fields).ok()?, fields.bytes)));
            let Some((event, bytes)) = event else {
                break;
            };
            batch.push(event);
            taken += bytes;
            count += 1;
        }
        lines.pass(taken, count);
        self.events += count;
        Ok(())
    }

    fn next_event(&mut self) -> Result<Option<Event>> {
        loop {
            if !self.lines.advance()? {
                return Ok(None);
            }
            if self.lines.is_comment() {
                self.skipped
                    .add("comment lines", u64::from(!self.lines.line.is_empty()));
                continue;
            }
            let event = self.parse();
            match event {
                Ok(event) => {
                    self.events += 1;
                    self.note_cut();
                    return Ok(Some(event));
                }
                Err(bad) if self.leaves_out => {
                    self.events += 1;
                    self.skipped.add(bad.kind(), 1);
                }
                Err(bad) => return Err(self.refusal(&bad)),
            }
        }
    }

    /// Notes that the current line may be cut within its last number, if it has no line break; a polarity cannot be
    /// cut to another one.
    fn note_cut(&mut self) {
        let Layout {
            columns, t, x, y, ..
        } = self.rules.layout;
        let is_number = [t, x, y].contains(&(columns - 1));
        if is_number && !self.lines.is_ended && !self.is_cut_noted {
            self.is_cut_noted = true;
            self.rules.assumptions.push(Assumption::last_line_whole());
        }
    }

    /// Returns the error for the current line.
    fn refusal(&self, bad: &Bad) -> event_types::stream::Error {
        let what = match bad {
            Bad::Fields(count) => format!("{count} fields instead of {}", self.rules.layout.columns),
            Bad::NoTime => "the time is not a number".to_owned(),
            Bad::Fraction => "a time with a fraction after whole microseconds: give --time-unit, or name the column \
                              t_s or t_us"
                .to_owned(),
            Bad::TimeRange => {
                "the time is negative or above 2^63 us: see --time-offset-us".to_owned()
            }
            Bad::NoPixel => "x and y must be whole numbers that are not negative".to_owned(),
            Bad::NoPolarity => "the polarity is not one of 0, 1, -1, true, false".to_owned(),
            Bad::ThirdPolarity => {
                "the polarities include both 0 and -1: more than two; --leave-out-bad-events \
                 leaves the third out"
                    .to_owned()
            }
            Bad::Outside(x, y) => {
                let Sensor { width, height } = self.rules.sensor;
                format!("x = {x}, y = {y} is outside the sensor ({width}x{height})")
            }
        };
        self.lines.error(format!("event {}: {what}", self.events))
    }

    /// Parses the current line, of any kind.
    fn parse(&mut self) -> Result<Event, Bad> {
        self.rules.parse(&self.lines.line)
    }
}

impl Rules {
    fn parse(&mut self, line: &[u8]) -> Result<Event, Bad> {
        let mut fields = [&line[..0]; FIELDS_MAX];
        let mut count = 0;
        let parts = line.split(|byte| is_separator(*byte));
        for field in parts.filter(|field| !field.is_empty()) {
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
            ..
        } = self.layout;
        if count != columns {
            return Err(Bad::Fields(count));
        }
        let field = |column: usize| unquoted(fields.get(column).copied().unwrap_or_default());
        let time = Decimal::parse(field(t)).ok_or(Bad::NoTime)?;
        let t_us = self.time(time)?;
        let side = |field: &[u8]| Decimal::parse(field).and_then(Decimal::whole);
        let (Some(x), Some(y)) = (side(field(x)), side(field(y))) else {
            return Err(Bad::NoPixel);
        };
        let p = field(p);
        let on = polarity(p).ok_or(Bad::NoPolarity)?;
        self.finish(t_us, (x, y), on, Sign::of(p))
    }

    /// Returns whether a time in whole numbers is in microseconds, and a polarity of 0 is taken.
    fn is_as_written(&self) -> bool {
        let Polarities { minus, third, .. } = self.polarities;
        self.unit == TimeUnit::Us && self.offset_us == 0 && !minus && !third
    }

    /// Returns the event of a plain line.
    #[inline]
    fn event(&mut self, fields: Fields) -> Result<Event, Bad> {
        let t_us = match (fields.time.integer(), self.unit) {
            (Some(t_us), TimeUnit::Us) if self.offset_us == 0 => t_us,
            _ => self.time(fields.time)?,
        };
        let on = fields.polarity == Sign::One;
        self.finish(t_us, (fields.x, fields.y), on, Some(fields.polarity))
    }

    /// Returns a time in microseconds.
    #[inline]
    fn time(&mut self, time: Decimal) -> Result<u64, Bad> {
        if self.has_whole_times && !time.is_whole() {
            return Err(Bad::Fraction);
        }
        let shift = self.unit.shift();
        let t_us = time
            .signed(shift)
            .ok()
            .and_then(|t_us| t_us.checked_add(self.offset_us))
            .and_then(|t_us| u64::try_from(t_us).ok())
            .ok_or(Bad::TimeRange)?;
        if !self.is_rounded && !time.is_whole_at(shift) {
            self.is_rounded = true;
            self.assumptions
                .push(Assumption::times_rounded("to the nearest"));
        }
        Ok(t_us)
    }

    /// Returns the event of a time, a pixel and a polarity.
    #[inline]
    fn finish(
        &mut self,
        t_us: u64,
        (x, y): (u64, u64),
        on: bool,
        sign: Option<Sign>,
    ) -> Result<Event, Bad> {
        if !self.polarities.takes(sign) {
            return Err(Bad::ThirdPolarity);
        }
        match (u16::try_from(x), u16::try_from(y)) {
            (Ok(x), Ok(y)) if self.sensor.contains(x, y) => Ok(Event {
                t_us,
                x,
                y,
                polarity: Polarity::from_bool(on),
            }),
            _ => Err(Bad::Outside(x, y)),
        }
    }
}

impl Decode for TextDecoder {
    fn format(&self) -> &'static str {
        "text"
    }

    fn sensor(&self) -> Sensor {
        self.rules.sensor
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.rules.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        self.decode_lines(batch)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;
    use crate::EventReader;

    fn read(text: &str) -> Result<(Sensor, Vec<Event>), String> {
        let source = Box::new(Cursor::new(text.as_bytes().to_vec()));
        let mut reader = TextReader::new(source, "test", None).map_err(|e| e.to_string())?;
        let mut events = Vec::new();
        while reader.read(&mut events).map_err(|e| e.to_string())? > 0 {}
        Ok((reader.sensor(), events))
    }

    #[test]
    fn a_last_line_that_may_be_cut_is_noted() {
        let notes = |text: &str| {
            let source = Box::new(Cursor::new(text.as_bytes().to_vec()));
            let mut reader = TextReader::new(source, "test", None).unwrap();
            while reader.read(&mut Vec::new()).unwrap() > 0 {}
            let notes = reader.assumptions().iter();
            notes.filter(|note| note.what == "last line").count()
        };
        for (text, want) in [
            ("x,y,p,t\n1,2,1,1500\n1,2,0,15", 1),
            ("x,y,p,t\n1,2,1,1500\n1,2,0,15\n", 0),
            ("x,y,p,t\n1,2,1,1500\n1,2,0,15\n# end", 0),
            ("t,x,y,p\n1500,1,2,1\n1501,1,2,0", 0),
            ("240 180\n1500 100 2 1\n1501 101 2 0", 0),
            ("p,t,x,y\n1,1500,1,20\n1,1501,1,2", 1),
        ] {
            assert_eq!(notes(text), want, "{text:?}");
        }
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
            // Two whole decimals would be taken for seconds, so this case states its unit.
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
                "4 4\n# t x y p\n1 2 3 1\n2 4 0 1\n",
                "line 4: event 1: x = 4, y = 0 is outside",
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
        // Every column is below 2048, so only the times show the order.
        let xytp = lines(|i| format!("{} {} {} {}\n", i * 37 % 300, i * 91 % 200, i * 9, i % 2));
        let (_, events) = read(&xytp).expect("events");
        assert_eq!((events[1].t_us, events[1].x, events[1].y), (9, 37, 91));
        let txyp = lines(|i| format!("{} {} {} {}\n", i * 9, i * 37 % 300, i * 91 % 200, i % 2));
        assert_eq!(read(&txyp).expect("events").1, events);
    }

    /// Lines of all kinds, most of them plain.
    fn lines() -> impl Strategy<Value = Vec<String>> {
        let digits = |most: u64| (0..most).prop_map(|number| number.to_string());
        let time = prop_oneof![
            40 => digits(1 << 40),
            1 => any::<u64>().prop_map(|number| number.to_string()),
            2 => (0..1000_u32, 0..99_999_u32).prop_map(|(whole, part)| format!("{whole}.{part}")),
            1 => prop::sample::select(vec!["-5", "+7", "1e3", "5.", ".5", "00012", "x", "1 2"]).prop_map(str::to_owned),
        ];
        let side = prop_oneof![
            60 => digits(300),
            1 => digits(70_000),
            1 => prop::sample::select(vec!["7.0", "-1", "0007", "\"7\"", "1e1"]).prop_map(str::to_owned),
        ];
        let p = prop::sample::select(vec![
            "0", "1", "0", "1", "0", "1", "0", "1", "-1", "on", "2", "+1", "01",
        ]);
        let between = prop::sample::select(vec![
            ",", ",", ",", ",", ",", ",", ";", " ", "\t", ", ", ",,",
        ]);
        let end = prop::sample::select(vec![
            "\n", "\n", "\n", "\n", "\r\n", " \n", ",\n", "\n\n", "\n# a\n", "\r",
        ]);
        let line = (time, side.clone(), side, p, between, end)
            .prop_map(|(t, x, y, p, by, end)| format!("{t}{by}{x}{by}{y}{by}{p}{end}"));
        proptest::collection::vec(line, 0..400)
    }

    proptest! {
        /// Plain lines are what the parser of all lines makes of them, and so is what is said of the others.
        #[test]
        fn plain_lines_are_lines(
            lines in lines(), cut in 0..30_usize, pad in 0..70_000_usize,
            sized: bool, leaves_out: bool, unit in prop_oneof![Just(None), Just(Some(TimeUnit::Us)), Just(Some(TimeUnit::S))],
        ) {
            let mut text = lines.concat();
            text.truncate(text.len().saturating_sub(cut));
            // Lines lie in two blocks wherever that is.
            let text = format!("t,x,y,p\n{}\n{text}", format!("#{}\n", "-".repeat(60)).repeat(pad / 62));
            let reading = Reading {
                size: sized.then_some(Sensor { width: 290, height: 280 }),
                time_unit: unit,
                bad_events: if leaves_out { BadEvents::LeaveOut } else { BadEvents::Refuse },
                ..Reading::default()
            };
            let read = |change: fn(Plain) -> Plain| {
                let source = Box::new(Cursor::new(text.clone().into_bytes()));
                let mut reader = TextReader::new(source, "test", reading.clone()).map_err(|error| error.to_string())?;
                reader.decoder.plain = change(reader.decoder.plain.clone());
                let mut events = Vec::new();
                let error = loop {
                    match reader.read(&mut events) {
                        Ok(0) => break None,
                        Ok(_) => {}
                        Err(error) => break Some(error.to_string()),
                    }
                };
                let notes: Vec<String> = reader.assumptions().iter().map(|it| format!("{it:?}")).collect();
                Ok::<_, String>((reader.sensor(), events, error, notes, reader.skipped().clone()))
            };
            let wanted = read(|_| Plain::none());
            prop_assert_eq!(&read(Plain::without_vectors), &wanted);
            prop_assert_eq!(&read(|plain| plain), &wanted);
        }
    }
}
