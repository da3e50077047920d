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
mod lines;
mod plain;
mod rules;
mod start;
pub(crate) mod utf16;
pub(crate) mod writer;

use event_types::stream::{ErrorKind, Result};
use event_types::{Event, Sensor};

use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader};
use crate::reading::{Reading, TimeUnit};
use crate::table::time_unit;
pub use crate::text::layout::Layout;
use crate::text::layout::{Found, times_of};
use crate::text::lines::{Lines, split};
use crate::text::plain::Plain;
use crate::text::rules::{Bad, Polarities, Rules};
use crate::text::start::Start;
use crate::text::utf16::Utf16;
pub(crate) use crate::text::utf16::is_utf16;
use crate::text::writer::TextWriter;
use crate::{Assumption, BadEvents, Skipped, format};

/// Most lines that are parsed together.
const TOGETHER: usize = 256;

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
        lines.go_to(start.data, start.data_line)?;
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
                decoder.lines.go_to(start.data, start.data_line)?;
                let assumptions = &mut decoder.rules.assumptions;
                assumptions.push(Assumption::size_taken(sensor));
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

impl TextDecoder {
    /// Returns the smallest sensor that holds every event from here to the end or the first damage.
    fn largest(&mut self) -> Result<Sensor> {
        let (mut width, mut height) = (0, 0);
        let mut events = Vec::with_capacity(crate::BATCH_EVENTS);
        self.plain.want_times(false);
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
        self.plain.want_times(true);
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
        let what = self.rules.told(bad);
        self.lines.error(format!("event {}: {what}", self.events))
    }

    /// Parses the current line, of any kind.
    fn parse(&mut self) -> Result<Event, Bad> {
        self.rules.parse(&self.lines.line)
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

    use event_types::Polarity;
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
