//! What the lines before the events state, and the first event lines.

use event_types::stream::{ErrorKind, Result};

use crate::Skipped;
use crate::reading::{Columns, Reading};
use crate::table::time_unit;
use crate::text::decimal::Decimal;
use crate::text::layout::{Header, Layout};
use crate::text::lines::{Lines, has_decimal_comma, names, split};

/// Number of event lines from which the layout is found.
const SAMPLE_LINES: usize = time_unit::SAMPLE_TIMES;

/// What the start of a file states.
pub struct Start {
    pub size: Option<(u64, u64)>,
    /// The layout that column names or the caller state.
    pub layout: Option<Layout>,
    /// The first event lines.
    pub sample: Vec<Vec<u8>>,
    /// Offset and number of the first event line.
    pub data: u64,
    pub data_line: u64,
    pub skipped: Skipped,
}

impl Start {
    pub fn read(lines: &mut Lines, reading: &Reading) -> Result<Self> {
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
