//! Lines of the plainest kind, parsed where they lie in the buffer: digits, one separator between two fields, and a
//! polarity of 1, 0 or -1. Nearly all lines of most files are such; any other line is left to the parser of all kinds,
//! which makes the same event of a plain one.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod avx2;

use event_types::{Event, Sensor};

use crate::text::decimal::Decimal;
use crate::text::layout::Layout;
use crate::text::lines::is_separator;

/// Most digits of a number: no more overflow 64 bits.
const DIGITS_MAX: usize = 18;
/// Longest field of a column that is ignored.
const IGNORED_MAX: usize = 32;

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Time,
    X,
    Y,
    Polarity,
    Ignored,
}

/// Places of the columns of a file that has no others, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Four {
    t: usize,
    x: usize,
    y: usize,
    p: usize,
}

/// The lines that are parsed at once.
#[derive(Debug, Clone, Copy)]
struct Form {
    columns: Four,
    separator: u8,
    /// Whether events need their times; else these are 0.
    with_times: bool,
}

/// Lines that were parsed at once.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Run {
    /// Number of lines.
    pub lines: usize,
    /// Bytes of them.
    pub bytes: usize,
    /// Whether a polarity among them is 0.
    pub has_zero: bool,
}

/// What parses lines at once, on a core that has it.
#[cfg(target_arch = "x86_64")]
type Vectors = avx2::Avx2;

/// On other cores there is none.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Vectors {}

#[cfg(not(target_arch = "x86_64"))]
impl Vectors {
    const fn detected() -> Option<Self> {
        None
    }

    fn parse(self, _: &[u8], _: Form, _: Sensor, _: &mut [Event]) -> Run {
        match self {}
    }
}

/// The columns of a file in their order, and the separator of the last line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plain {
    columns: Vec<Column>,
    /// Those of a file of four.
    vectors: Option<(Vectors, Four)>,
    separator: u8,
    with_times: bool,
}

/// The polarity of a plain line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sign {
    One,
    Zero,
    MinusOne,
}

impl Sign {
    /// Returns that of a field which is written so.
    pub const fn of(field: &[u8]) -> Option<Self> {
        match field {
            b"1" => Some(Self::One),
            b"0" => Some(Self::Zero),
            b"-1" => Some(Self::MinusOne),
            _ => None,
        }
    }
}

/// The fields of a plain line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fields {
    pub time: Decimal,
    pub x: u64,
    pub y: u64,
    pub polarity: Sign,
    /// Bytes of the line, with its line break.
    pub bytes: usize,
}

impl Plain {
    /// Returns the columns of a layout.
    pub fn new(layout: &Layout) -> Self {
        let column = |column: usize| match column {
            _ if column == layout.t => Column::Time,
            _ if column == layout.x => Column::X,
            _ if column == layout.y => Column::Y,
            _ if column == layout.p => Column::Polarity,
            _ => Column::Ignored,
        };
        let columns = (0..layout.columns).map(column).collect();
        let Layout { t, x, y, p, .. } = *layout;
        let four = (layout.columns == 4).then_some(Four { t, x, y, p });
        Self {
            vectors: Vectors::detected().zip(four),
            columns,
            separator: b',',
            with_times: true,
        }
    }

    /// Columns that no line has.
    #[cfg(test)]
    pub fn none() -> Self {
        Self {
            columns: vec![Column::Ignored; crate::text::lines::FIELDS_MAX + 1],
            vectors: None,
            separator: b',',
            with_times: true,
        }
    }

    /// Leaves every line to plain code.
    #[cfg(test)]
    pub fn without_vectors(self) -> Self {
        Self {
            vectors: None,
            ..self
        }
    }

    /// Parses lines at the start of `text` at once, if the core and the file's columns allow it: plain ones with whole
    /// microseconds, a pixel of the sensor and a polarity of one digit, up to the first other line. Puts their events into
    /// `events`.
    pub fn parse_many(&self, text: &[u8], sensor: Sensor, events: &mut [Event]) -> Run {
        let Some((vectors, columns)) = self.vectors else {
            return Run::default();
        };
        let form = Form {
            columns,
            separator: self.separator,
            with_times: self.with_times,
        };
        vectors.parse(text, form, sensor, events)
    }

    /// Says whether events of lines that are parsed at once need their times; at first they do. Without, these may be 0.
    pub const fn want_times(&mut self, with_times: bool) {
        self.with_times = with_times;
    }

    /// Parses the line at the start of `text`, or returns `None` if it is not plain, or does not end there.
    pub fn parse(&mut self, text: &[u8]) -> Option<Fields> {
        let mut rest = text;
        let mut separator = None;
        let (mut time, mut x, mut y) = (Decimal::of_digits(0, 0), 0, 0);
        let mut polarity = None;
        for (index, column) in self.columns.iter().enumerate() {
            if index > 0 {
                let (byte, after) = rest.split_first()?;
                let is_separating = match separator {
                    Some(separator) => *byte == separator,
                    None => is_separator(*byte),
                };
                if !is_separating {
                    return None;
                }
                separator = Some(*byte);
                rest = after;
            }
            match column {
                Column::Time => (time, rest) = take_time(rest)?,
                Column::X => (x, rest) = take_whole(rest)?,
                Column::Y => (y, rest) = take_whole(rest)?,
                Column::Polarity => {
                    let (sign, after) = take_polarity(rest)?;
                    (polarity, rest) = (Some(sign), after);
                }
                Column::Ignored => rest = pass(rest)?,
            }
        }
        let rest = match rest {
            [b'\n', rest @ ..] | [b'\r', b'\n', rest @ ..] => rest,
            _ => return None,
        };
        self.separator = separator.unwrap_or(self.separator);
        Some(Fields {
            time,
            x,
            y,
            polarity: polarity?,
            bytes: text.len() - rest.len(),
        })
    }
}

/// Returns the number before the first byte that is no digit, behind the digits of `before`; how many digits it has; and
/// what follows.
#[inline]
fn take_digits(text: &[u8], before: u64) -> (u64, usize, &[u8]) {
    let (mut value, mut count, mut rest) = (before, 0, text);
    while let Some((eight, after)) = rest.split_first_chunk::<8>() {
        let (number, digits) = leading_digits(u64::from_le_bytes(*eight));
        let scale = POWERS.get(digits).copied().unwrap_or_default();
        value = value.wrapping_mul(scale).wrapping_add(number);
        count += digits;
        if digits < 8 {
            return (value, count, rest.get(digits..).unwrap_or_default());
        }
        rest = after;
    }
    for byte in rest {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            break;
        }
        value = value.wrapping_mul(10).wrapping_add(digit.into());
        count += 1;
    }
    (value, count, text.get(count..).unwrap_or_default())
}

/// 10^n.
const POWERS: [u64; 9] = [
    1,
    10,
    100,
    1000,
    10_000,
    100_000,
    1_000_000,
    10_000_000,
    100_000_000,
];

/// Returns the number that the first bytes of eight are digits of, the first in the lowest byte, and how many are.
#[inline]
const fn leading_digits(eight: u64) -> (u64, usize) {
    // A digit is now 0 to 9. Adding 0x76 sets the highest bit of a byte that is more.
    let values = eight ^ 0x3030_3030_3030_3030;
    let above = (values & 0x7F7F_7F7F_7F7F_7F7F) + 0x7676_7676_7676_7676;
    let others = (above | values) & 0x8080_8080_8080_8080;
    let digits = others.trailing_zeros() / 8;
    // Zeros go before the digits, and take the place of what followed them.
    let Some(values) = values.checked_shl(64 - 8 * digits) else {
        return (0, 0);
    };
    (number_of_digits(values), digits as usize)
}

/// Returns the number of eight digits, the first in the lowest byte.
#[inline]
const fn number_of_digits(values: u64) -> u64 {
    // Pairs of digits, of pairs, and of those.
    let pairs = values.wrapping_mul(10 << 8 | 1) >> 8 & 0x00FF_00FF_00FF_00FF;
    let fours = pairs.wrapping_mul(100 << 16 | 1) >> 16 & 0x0000_FFFF_0000_FFFF;
    fours.wrapping_mul(10_000 << 32 | 1) >> 32
}

#[inline]
fn take_whole(text: &[u8]) -> Option<(u64, &[u8])> {
    let (value, count, rest) = take_digits(text, 0);
    (1..=DIGITS_MAX).contains(&count).then_some((value, rest))
}

#[inline]
fn take_time(text: &[u8]) -> Option<(Decimal, &[u8])> {
    let (value, count, rest) = take_digits(text, 0);
    if !(1..=DIGITS_MAX).contains(&count) {
        return None;
    }
    let [b'.', rest @ ..] = rest else {
        return Some((Decimal::of_digits(value, 0), rest));
    };
    let (value, places, rest) = take_digits(rest, value);
    let is_short = count + places <= DIGITS_MAX && places > 0;
    is_short.then_some((Decimal::of_digits(value, places), rest))
}

#[inline]
fn take_polarity(text: &[u8]) -> Option<(Sign, &[u8])> {
    match text {
        [b'1', rest @ ..] => Some((Sign::One, rest)),
        [b'0', rest @ ..] => Some((Sign::Zero, rest)),
        [b'-', b'1', rest @ ..] => Some((Sign::MinusOne, rest)),
        _ => None,
    }
}

/// Passes over a field that is ignored.
#[inline]
fn pass(text: &[u8]) -> Option<&[u8]> {
    let is_end = |byte: &u8| is_separator(*byte) || !byte.is_ascii_graphic();
    let end = text.iter().take(IGNORED_MAX).position(is_end)?;
    text.get(end..).filter(|_| end > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout {
        columns: 5,
        t: 0,
        x: 2,
        y: 3,
        p: 4,
        unit: None,
    };

    fn parsed(text: &str) -> Option<(Decimal, u64, u64, Sign, usize)> {
        let fields = Plain::new(&LAYOUT).parse(text.as_bytes())?;
        let Fields {
            time,
            x,
            y,
            polarity,
            bytes,
        } = fields;
        Some((time, x, y, polarity, bytes))
    }

    #[test]
    fn plain_lines() {
        let decimal = |text: &str| Decimal::parse(text.as_bytes()).unwrap();
        for (text, time, polarity) in [
            ("12,a\"b,7,8,1\n9", "12", Sign::One),
            ("12.50 a 7 8 0\r\n", "12.50", Sign::Zero),
            (
                "123456789012345678;-1;7;8;-1\n",
                "123456789012345678",
                Sign::MinusOne,
            ),
        ] {
            let bytes = text.find('\n').unwrap() + 1;
            let wanted = (decimal(time), 7, 8, polarity, bytes);
            assert_eq!(parsed(text), Some(wanted), "{text}");
        }
    }

    #[test]
    fn other_lines_are_left() {
        for text in [
            "",
            "12,a,7,8,1",
            "12,a,7,8,1\r",
            "12,a,7,8,10\n",
            "12,a,7,8\n",
            "12,a,7,8,1,\n",
            "12,,a,7,8,1\n",
            "12, a,7,8,1\n",
            "12 a,7,8,1\n",
            "12,a,7.0,8,1\n",
            "12.,a,7,8,1\n",
            ".5,a,7,8,1\n",
            "1e3,a,7,8,1\n",
            "-12,a,7,8,1\n",
            "+12,a,7,8,1\n",
            " 12,a,7,8,1\n",
            "12,a,7,8,true\n",
            "12,\u{e4},7,8,1\n",
            "1234567890123456789,a,7,8,1\n",
            "123456789012.3456789,a,7,8,1\n",
            "# 12,a,7,8,1\n",
            "\n",
        ] {
            assert_eq!(parsed(text), None, "{text}");
        }
    }

    #[test]
    fn digits_end_where_others_begin() {
        for digits in 0..=20_usize {
            for other in 0..=255_u8 {
                let mut text = b"98765432109876543210"[..digits].to_vec();
                let number = |text: &[u8]| {
                    text.iter().fold(7_u64, |number, byte| {
                        number.wrapping_mul(10).wrapping_add(u64::from(byte - b'0'))
                    })
                };
                let wanted = number(&text);
                assert_eq!(take_digits(&text, 7), (wanted, digits, &b""[..]));
                text.extend([other, b'5', b'6', 0xFF, b'1', b'2', b'3', b'4', b'5']);
                if !other.is_ascii_digit() {
                    assert_eq!(take_digits(&text, 7), (wanted, digits, &text[digits..]));
                }
            }
        }
    }
}
