//! Parses and writes headers of `.npy` arrays, versions 1 to 3, and decodes their numbers.
//!
//! The crates `npyz` and `ndarray-npy` depend on a parser generator and big integers, or on `ndarray`, for this
//! single line of text, so it is parsed here.

use std::io::Read;

use crate::table::row_events::Scale;

/// First bytes of every array.
pub const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// Largest header in bytes; numpy itself warns above 10,000 characters.
const HEADER_MAX: usize = 1 << 16;

/// Greatest depth of nesting in a header's literal.
const DEPTH_MAX: usize = 8;

/// The header of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NpyHeader {
    /// Number of bytes before the first element.
    pub bytes: u64,
    /// Whether the array is stored column by column rather than row by row.
    pub fortran_order: bool,
    /// Length of each dimension.
    pub shape: Vec<u64>,
    /// Type of the elements.
    pub descr: Descr,
}

/// The type of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Descr {
    /// A single number.
    Plain(Dtype),
    /// Named fields with their offsets, and the size in bytes of the whole element.
    Fields(Vec<(String, usize, Dtype)>, usize),
}

/// The type and size of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dtype {
    kind: u8,
    big_endian: bool,
    /// Size in bytes of a number.
    pub bytes: usize,
    /// For numpy's times and durations: the unit.
    scale: Option<Scale>,
}

/// A number of an array.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// A number of an integer or bool type.
    Whole(i64),
    /// A number of a float type.
    Float(f64),
}

impl Number {
    /// Returns the value if it is whole and, as a float, exact (at most 9e15).
    pub fn whole(self) -> Option<i64> {
        match self {
            Self::Whole(value) => Some(value),
            Self::Float(value) => {
                (value.fract() == 0.0 && value.abs() <= 9e15).then_some(value as i64)
            }
        }
    }

    /// Returns the value as a float, rounded if needed.
    pub fn float(self) -> f64 {
        match self {
            Self::Whole(value) => value as f64,
            Self::Float(value) => value,
        }
    }
}

impl Dtype {
    /// Creates a type of `bytes` bytes: `b'i'` signed, `b'u'` unsigned, `b'f'` float, `b'b'` bool; `None` if
    /// [`Dtype::number`] could not read it.
    pub fn new(kind: u8, big_endian: bool, bytes: usize) -> Option<Self> {
        let dtype = Self {
            kind,
            big_endian,
            bytes,
            scale: None,
        };
        dtype.is_number().then_some(dtype)
    }

    fn parse(text: &str) -> Option<Self> {
        let (order, rest) = match text.split_at_checked(1)? {
            (order @ ("<" | ">" | "|" | "="), rest) => (order, rest),
            _ => ("=", text),
        };
        let (kind, size) = rest.split_at_checked(1)?;
        let (size, unit) = match size.split_once('[') {
            Some((size, unit)) => (size, unit.strip_suffix(']')),
            None => (size, None),
        };
        // Python objects have no stated size.
        let size: usize = if kind == "O" { 8 } else { size.parse().ok()? };
        let bytes = if kind == "U" {
            size.checked_mul(4)?
        } else {
            size
        };
        let kind = *kind.as_bytes().first()?;
        (bytes <= HEADER_MAX).then_some(Self {
            kind,
            big_endian: order == ">",
            bytes,
            scale: unit.and_then(unit_scale),
        })
    }

    /// Returns the unit of a type of times or durations; `None` if it has none, or months or years.
    pub fn scale(self) -> Option<Scale> {
        self.scale
    }

    /// Returns the bits of a number of a little-endian type of integers, and whether it is signed.
    pub const fn whole_bits(self) -> Option<(u32, bool)> {
        match (self.kind, self.bytes, self.big_endian) {
            (b'i' | b'u', bytes @ 1..=8, false) => Some((8 * bytes as u32, self.kind == b'i')),
            _ => None,
        }
    }

    /// Returns whether the numbers are unsigned 32-bit integers.
    pub fn is_u32(self) -> bool {
        self.kind == b'u' && self.bytes == 4
    }

    /// Returns whether this is numpy's type of Python objects.
    pub fn is_object(self) -> bool {
        self.kind == b'O'
    }

    /// Returns whether [`Dtype::number`] can read the type: bool, integers of 1 to 8 bytes, floats of 2 to 8, times
    /// of 8 with a unit.
    pub fn is_number(self) -> bool {
        match self.kind {
            b'b' => self.bytes == 1,
            b'i' | b'u' => matches!(self.bytes, 1 | 2 | 4 | 8),
            b'f' => matches!(self.bytes, 2 | 4 | 8),
            b'm' | b'M' => self.bytes == 8 && self.scale.is_some(),
            _ => false,
        }
    }

    /// Returns whether the numbers are unsigned integers.
    pub fn is_unsigned(self) -> bool {
        self.kind == b'u'
    }

    /// Returns whether the numbers are floats.
    pub fn is_float(self) -> bool {
        self.kind == b'f'
    }

    /// Appends all numbers of `bytes`; for the common types, the type is examined only once.
    pub fn numbers(self, bytes: &[u8], out: &mut Vec<Option<Number>>) {
        fn each<const N: usize>(
            bytes: &[u8],
            out: &mut Vec<Option<Number>>,
            number: impl Fn([u8; N]) -> Number,
        ) {
            let numbers = bytes.as_chunks().0.iter();
            out.extend(numbers.map(|bytes| Some(number(*bytes))));
        }
        let whole = |value: i64| Number::Whole(value);
        match (self.kind, self.bytes, self.big_endian) {
            (b'i', 8, false) => each(bytes, out, |bytes| whole(i64::from_le_bytes(bytes))),
            (b'i', 4, false) => each(bytes, out, |bytes| whole(i32::from_le_bytes(bytes).into())),
            (b'u', 4, false) => each(bytes, out, |bytes| whole(u32::from_le_bytes(bytes).into())),
            (b'u', 2, false) => each(bytes, out, |bytes| whole(u16::from_le_bytes(bytes).into())),
            (b'u' | b'b', 1, _) => each(bytes, out, |[byte]| whole(byte.into())),
            (b'f', 8, false) => each(bytes, out, |bytes| Number::Float(f64::from_le_bytes(bytes))),
            _ => {
                let numbers = bytes.chunks_exact(self.bytes.max(1));
                out.extend(numbers.map(|bytes| self.number(bytes)));
            }
        }
    }

    /// Returns whether [`Dtype::whole_numbers`] reads the type: bools and little-endian integers, but for unsigned ones of 8
    /// bytes.
    pub const fn is_whole(self) -> bool {
        matches!(
            (self.kind, self.bytes),
            (b'i', 1 | 2 | 4 | 8) | (b'u', 1 | 2 | 4) | (b'b', 1)
        ) && (self.bytes == 1 || !self.big_endian)
    }

    /// Appends all numbers of `bytes`, of a type for which [`Dtype::is_whole`].
    pub fn whole_numbers(self, bytes: &[u8], out: &mut Vec<i64>) {
        fn each<const N: usize>(bytes: &[u8], out: &mut Vec<i64>, number: impl Fn([u8; N]) -> i64) {
            out.extend(bytes.as_chunks().0.iter().map(|bytes| number(*bytes)));
        }
        match (self.kind, self.bytes) {
            (b'i', 8) => each(bytes, out, i64::from_le_bytes),
            (b'i', 4) => each(bytes, out, |bytes| i32::from_le_bytes(bytes).into()),
            (b'u', 4) => each(bytes, out, |bytes| u32::from_le_bytes(bytes).into()),
            (b'i', 2) => each(bytes, out, |bytes| i16::from_le_bytes(bytes).into()),
            (b'u', 2) => each(bytes, out, |bytes| u16::from_le_bytes(bytes).into()),
            (b'i', 1) => each(bytes, out, |[byte]| byte.cast_signed().into()),
            (b'u' | b'b', 1) => each(bytes, out, |[byte]| byte.into()),
            _ => {}
        }
    }

    /// Returns the number at the start of `bytes`; `None` if they are too few or hold an unsigned number of 2^63 or
    /// more.
    #[inline]
    pub fn number(self, bytes: &[u8]) -> Option<Number> {
        let bytes = bytes.get(..self.bytes)?;
        let mut padded = [0; 8];
        let slots = padded.get_mut(..self.bytes)?;
        slots.copy_from_slice(bytes);
        if self.big_endian {
            slots.reverse();
        }
        let raw = u64::from_le_bytes(padded);
        Some(match (self.kind, self.bytes) {
            (b'i', 1..=8) => {
                let shift = 64 - 8 * self.bytes as u32;
                Number::Whole((raw << shift) as i64 >> shift)
            }
            // NaT, numpy's missing time.
            (b'm' | b'M', 8) if raw == 1 << 63 => Number::Float(f64::NAN),
            (b'm' | b'M', 8) => Number::Whole(raw as i64),
            (b'u' | b'b', _) => Number::Whole(i64::try_from(raw).ok()?),
            (b'f', 2) => Number::Float(half(raw as u16)),
            (b'f', 4) => Number::Float(f64::from(f32::from_bits(raw as u32))),
            (b'f', 8) => Number::Float(f64::from_bits(raw)),
            _ => return None,
        })
    }
}

/// Parses numpy's unit of times, such as `ns` or `25us`.
fn unit_scale(unit: &str) -> Option<Scale> {
    let digits = unit.find(|letter: char| !letter.is_ascii_digit())?;
    let (count, unit) = unit.split_at_checked(digits)?;
    let count: i64 = if count.is_empty() {
        1
    } else {
        count.parse().ok()?
    };
    let (times, by) = match unit {
        "W" => (604_800_000_000, 1),
        "D" => (86_400_000_000, 1),
        "h" => (3_600_000_000, 1),
        "m" => (60_000_000, 1),
        "s" => (1_000_000, 1),
        "ms" => (1_000, 1),
        "us" => (1, 1),
        "ns" => (1, 1_000),
        "ps" => (1, 1_000_000),
        "fs" => (1, 1_000_000_000),
        "as" => (1, 1_000_000_000_000),
        _ => return None,
    };
    let times = count.checked_mul(times).filter(|times| *times > 0)?;
    Some(Scale::new(times, by))
}

/// Converts an IEEE 754 binary16 number.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let value = match exponent {
        0 => fraction * 2_f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2_f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -value } else { value }
}

impl NpyHeader {
    /// Reads a header and leaves the reader at the first element.
    ///
    /// # Errors
    /// The header is damaged or of an unknown version; the message says which.
    pub fn read(reader: &mut impl Read) -> Result<Self, String> {
        let mut take = |n: usize| {
            let mut bytes = vec![0; n];
            let read = reader.read_exact(&mut bytes);
            read.map(|()| bytes)
                .map_err(|error| format!("truncated npy header: {error}"))
        };
        let start = take(8)?;
        if start.get(..6) != Some(MAGIC) {
            return Err("not an npy array".to_owned());
        }
        let version = start.get(6).copied().unwrap_or(0);
        let size_bytes = match version {
            1 => 2,
            2 | 3 => 4,
            _ => return Err(format!("npy version {version} is not known")),
        };
        let size = take(size_bytes)?
            .iter()
            .rev()
            .fold(0, |size, b| size << 8 | usize::from(*b));
        if size > HEADER_MAX {
            return Err(format!("npy header of {size} bytes: damaged"));
        }
        let text = take(size)?;
        let text = String::from_utf8_lossy(&text);
        let header = Self::parse(&text).ok_or("damaged npy header")?;
        Ok(Self {
            bytes: (8 + size_bytes + size) as u64,
            ..header
        })
    }

    fn parse(text: &str) -> Option<Self> {
        let Literal::Dict(entries) = Literal::parse(text)? else {
            return None;
        };
        let get = |key: &str| {
            entries
                .iter()
                .find(|(k, _)| k == key)
                .map(|(_, value)| value)
        };
        let Literal::Bool(fortran_order) = *get("fortran_order")? else {
            return None;
        };
        let Literal::Sequence(shape) = get("shape")? else {
            return None;
        };
        let shape: Option<Vec<u64>> = shape.iter().map(Literal::number).collect();
        let descr = match get("descr")? {
            Literal::Text(text) => Descr::Plain(Dtype::parse(text)?),
            Literal::Sequence(fields) => {
                let mut offset = 0_usize;
                let mut named = Vec::new();
                for field in fields {
                    let Literal::Sequence(parts) = field else {
                        return None;
                    };
                    let name = match parts.first()? {
                        Literal::Text(name) => name.clone(),
                        // A pair (title, name).
                        Literal::Sequence(names) => match names.last()? {
                            Literal::Text(name) => name.clone(),
                            _ => return None,
                        },
                        _ => return None,
                    };
                    let Literal::Text(dtype) = parts.get(1)? else {
                        return None;
                    };
                    let dtype = Dtype::parse(dtype)?;
                    let count = match parts.get(2) {
                        None => 1,
                        Some(Literal::Sequence(shape)) => shape.iter().try_fold(1, |n, side| {
                            usize::try_from(side.number()?).ok()?.checked_mul(n)
                        })?,
                        Some(_) => return None,
                    };
                    if count == 1 {
                        named.push((name, offset, dtype));
                    }
                    offset = offset.checked_add(dtype.bytes.checked_mul(count)?)?;
                }
                (offset <= HEADER_MAX).then_some(Descr::Fields(named, offset))?
            }
            _ => return None,
        };
        Some(Self {
            bytes: 0,
            fortran_order,
            shape: shape?,
            descr,
        })
    }

    /// Returns a version 1 header of `count` numbers of type `descr`, or of a single scalar if `count` is `None`.
    pub fn text(descr: &str, count: Option<u64>) -> Vec<u8> {
        Self::padded(&format!("'{descr}'"), count, 0)
    }

    /// Returns a header like [`NpyHeader::text`], for a `descr` in Python syntax and of at least `least` bytes.
    pub fn padded(descr: &str, count: Option<u64>, least: usize) -> Vec<u8> {
        let shape = count.map_or(String::from("()"), |count| format!("({count},)"));
        let mut text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}");
        // The elements begin at a multiple of 64, after a line feed.
        while 11 + text.len() < least || !(11 + text.len()).is_multiple_of(64) {
            text.push(' ');
        }
        text.push('\n');
        let size = (text.len() as u16).to_le_bytes();
        [MAGIC.as_slice(), &[1, 0], &size, text.as_bytes()].concat()
    }
}

/// A Python literal.
#[derive(Debug)]
enum Literal {
    Text(String),
    Bool(bool),
    Number(u64),
    Sequence(Vec<Self>),
    Dict(Vec<(String, Self)>),
}

impl Literal {
    fn parse(text: &str) -> Option<Self> {
        Self::value(&mut text.trim_start(), 0)
    }

    fn number(&self) -> Option<u64> {
        match self {
            Self::Number(number) => Some(*number),
            _ => None,
        }
    }

    fn value(rest: &mut &str, depth: usize) -> Option<Self> {
        if depth > DEPTH_MAX {
            return None;
        }
        let first = rest.chars().next()?;
        match first {
            '\'' | '"' => {
                let (text, after) = rest.get(1..)?.split_once(first)?;
                *rest = after.trim_start();
                Some(Self::Text(text.to_owned()))
            }
            '(' | '[' => {
                let close = if first == '(' { ")" } else { "]" };
                let mut values = Vec::new();
                *rest = rest.get(1..)?.trim_start();
                while !accept(rest, close) {
                    values.push(Self::value(rest, depth + 1)?);
                    if !accept(rest, ",") && !rest.starts_with(close) {
                        return None;
                    }
                }
                Some(Self::Sequence(values))
            }
            '{' => {
                let mut entries = Vec::new();
                *rest = rest.get(1..)?.trim_start();
                while !accept(rest, "}") {
                    let Self::Text(key) = Self::value(rest, depth + 1)? else {
                        return None;
                    };
                    if !accept(rest, ":") {
                        return None;
                    }
                    entries.push((key, Self::value(rest, depth + 1)?));
                    if !accept(rest, ",") && !rest.starts_with('}') {
                        return None;
                    }
                }
                Some(Self::Dict(entries))
            }
            '0'..='9' => {
                let end = rest
                    .find(|c: char| !c.is_ascii_digit())
                    .unwrap_or(rest.len());
                let (digits, after) = rest.split_at_checked(end)?;
                // Python 2 writes long integers with an L.
                *rest = after.strip_prefix('L').unwrap_or(after).trim_start();
                digits.parse().ok().map(Self::Number)
            }
            _ if accept(rest, "True") => Some(Self::Bool(true)),
            _ if accept(rest, "False") => Some(Self::Bool(false)),
            _ => None,
        }
    }
}

/// Removes `token` and the spaces after it from the start of `rest`; returns whether it was there.
fn accept(rest: &mut &str, token: &str) -> bool {
    match rest.strip_prefix(token) {
        Some(after) => {
            *rest = after.trim_start();
            true
        }
        None => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_numbers_are_those_of_each() {
        let bytes: Vec<u8> = (0..64_u8).map(|i| i.wrapping_mul(91)).collect();
        for (kind, size) in [b'b', b'i', b'u', b'f']
            .into_iter()
            .flat_map(|kind| [1, 2, 4, 8].map(|size| (kind, size)))
        {
            for big_endian in [false, true] {
                let Some(dtype) = Dtype::new(kind, big_endian, size) else {
                    continue;
                };
                let want: Vec<_> = bytes
                    .chunks(size)
                    .map(|bytes| dtype.number(bytes))
                    .collect();
                let mut got = Vec::new();
                dtype.numbers(&bytes, &mut got);
                // Compared as text, since NaN is not equal to itself.
                assert_eq!(format!("{got:?}"), format!("{want:?}"), "{dtype:?}");
            }
        }
    }

    #[test]
    fn headers_of_numpy() {
        let header = NpyHeader::parse(
            "{'descr': '<i8', 'fortran_order': False, 'shape': (117667,), }      \n",
        );
        let header = header.expect("a header");
        assert_eq!(header.shape, [117_667]);
        assert!(matches!(header.descr, Descr::Plain(dtype) if dtype.bytes == 8));
        let header = NpyHeader::parse(
            "{'descr': [('x', '<u2'), ('', '|V2'), (('title', 't'), '>f8'), ('v', '<f4', (3,)), \
             ('p', '|b1')], 'fortran_order': True, 'shape': (2, 3)}",
        );
        let Descr::Fields(fields, size) = header.expect("a header").descr else {
            panic!("fields")
        };
        let offsets: Vec<_> = fields
            .iter()
            .map(|(name, at, _)| (name.as_str(), *at))
            .collect();
        assert_eq!(offsets, [("x", 0), ("", 2), ("t", 4), ("p", 24)]);
        assert_eq!(size, 25);
        for damaged in [
            "",
            "{",
            "{'descr'",
            "[[[[[[[[[[[[[[[[",
            "{'shape': (1,)}",
            "1",
        ] {
            assert_eq!(NpyHeader::parse(damaged), None);
        }
    }

    #[test]
    fn written_headers_read_back() {
        for (descr, count) in [("<i8", Some(5)), ("|u1", Some(0)), ("<i8", None)] {
            let bytes = NpyHeader::text(descr, count);
            assert_eq!(bytes.len() % 64, 0);
            let header = NpyHeader::read(&mut bytes.as_slice()).expect("a header");
            assert_eq!(header.bytes, bytes.len() as u64);
            assert_eq!(header.shape, Vec::from_iter(count));
        }
    }

    #[test]
    fn numbers_of_every_width() {
        let read = |text: &str, bytes: &[u8]| Dtype::parse(text).and_then(|d| d.number(bytes));
        assert_eq!(read("|i1", &[0xff]), Some(Number::Whole(-1)));
        assert_eq!(read("|u1", &[0xff]), Some(Number::Whole(255)));
        assert_eq!(read(">i2", &[0xff, 0xfe]), Some(Number::Whole(-2)));
        assert_eq!(
            read("<u4", &[1, 0, 0, 0x80]),
            Some(Number::Whole(0x8000_0001))
        );
        assert_eq!(read("<u8", &[0xff; 8]), None);
        assert_eq!(read("<f2", &[0, 0x3c]), Some(Number::Float(1.0)));
        assert_eq!(
            read("<f2", &[1, 0x80]),
            Some(Number::Float(-(2_f64.powi(-24))))
        );
        assert_eq!(
            read(">f4", &1.5_f32.to_be_bytes()),
            Some(Number::Float(1.5))
        );
        assert_eq!(
            read("<f8", &0.1_f64.to_le_bytes()),
            Some(Number::Float(0.1))
        );
        assert_eq!(read("<f8", &[0; 7]), None);
        let timed = |text: &str, value: i64| {
            let dtype = Dtype::parse(text).filter(|dtype| dtype.is_number())?;
            dtype.scale()?.us(dtype.number(&value.to_le_bytes())?)
        };
        assert_eq!(timed("<m8[ns]", 1_500), Some(2));
        assert_eq!(timed("<M8[us]", 7), Some(7));
        assert_eq!(timed("<m8[25ms]", 2), Some(50_000));
        assert_eq!(timed("<m8[D]", 1), Some(86_400_000_000));
        assert_eq!(timed("<m8[Y]", 1), None);
        assert_eq!(timed("<m8[ns]", i64::MIN), None);
        assert!(Dtype::parse("|O").expect("a type").is_object());
        assert!(!Dtype::parse("<f16").expect("a type").is_number());
        assert!(!Dtype::parse("<c8").expect("a type").is_number());
    }
}
