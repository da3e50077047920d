//! Lines of four whole numbers, by AVX2: where the fields of a line end is found at once.

use core::arch::x86_64::{
    __m256i, _mm256_cmpeq_epi8, _mm256_loadu_si256, _mm256_min_epu8, _mm256_movemask_epi8,
    _mm256_set1_epi8, _mm256_sub_epi8,
};

use event_types::{Event, Polarity, Sensor};

use super::{Four, POWERS, Run, number_of_digits};

/// Bytes that are looked at together: no longer line is parsed.
const LANES: usize = 32;
/// Digits that are parsed together.
const TOGETHER: usize = 8;
/// Bytes that lie behind the start of a line: its last field may be read as eight bytes.
const NEAR: usize = LANES + TOGETHER;

/// Proof that the core has AVX2, and the instructions for single bits that came with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has them.
    pub fn detected() -> Option<Self> {
        let has_both = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi1");
        has_both.then_some(Self(()))
    }

    /// Parses lines at the start of `text` that have these columns, whole microseconds, a pixel of the sensor and a
    /// polarity of one digit between separators like this, up to the first other one, and puts their events into
    /// `events`.
    pub fn parse(
        self,
        text: &[u8],
        columns: Four,
        separator: u8,
        sensor: Sensor,
        events: &mut [Event],
    ) -> Run {
        // SAFETY: `self` proves that the core has what the function needs.
        unsafe { parse(text, columns, separator, sensor, events) }
    }
}

#[target_feature(enable = "avx2,bmi1")]
fn parse(text: &[u8], columns: Four, separator: u8, sensor: Sensor, events: &mut [Event]) -> Run {
    let mut run = Run::default();
    let mut rest = text;
    for event in events {
        let Some((bytes, parsed)) = parse_line(rest, columns, separator) else {
            break;
        };
        let (Ok(x), Ok(y)) = (u16::try_from(parsed.x), u16::try_from(parsed.y)) else {
            break;
        };
        if !sensor.contains(x, y) {
            break;
        }
        *event = Event {
            t_us: parsed.t_us,
            x,
            y,
            polarity: Polarity::from_bool(parsed.is_on),
        };
        run.has_zero |= !parsed.is_on;
        run.lines += 1;
        run.bytes += bytes;
        rest = rest.get(bytes..).unwrap_or_default();
    }
    run
}

/// A line of four whole numbers.
#[derive(Clone, Copy)]
struct Line {
    t_us: u64,
    x: u64,
    y: u64,
    is_on: bool,
}

/// Parses a line, and returns its length and its numbers, or `None` if it is another.
#[inline]
#[target_feature(enable = "avx2,bmi1")]
fn parse_line(text: &[u8], columns: Four, separator: u8) -> Option<(usize, Line)> {
    let text: &[u8; NEAR] = text.first_chunk()?;
    let line = load(text.first_chunk()?);
    let digits = _mm256_sub_epi8(line, _mm256_set1_epi8(b'0' as i8));
    let is_digit = _mm256_cmpeq_epi8(_mm256_min_epu8(digits, _mm256_set1_epi8(9)), digits);
    let others = !mask(is_digit);
    let separators = mask(_mm256_cmpeq_epi8(line, _mm256_set1_epi8(separator as i8)));
    let feeds = mask(_mm256_cmpeq_epi8(line, _mm256_set1_epi8(b'\n' as i8)));
    let returns = mask(_mm256_cmpeq_epi8(line, _mm256_set1_epi8(b'\r' as i8)));
    let second = others & others.wrapping_sub(1);
    let third = second & second.wrapping_sub(1);
    let fourth = third & third.wrapping_sub(1);
    // The first four bytes that are no digits: three separators, then the line's end.
    let last = fourth & fourth.wrapping_neg();
    if (others ^ fourth) & !separators != 0 || last & (feeds | returns & feeds >> 1) == 0 {
        return None;
    }
    let ends = [others, second, third, fourth].map(|rest| rest.trailing_zeros() as usize);
    let starts = [0, ends[0] + 1, ends[1] + 1, ends[2] + 1];
    let field = |column: usize| {
        let start = starts[column % 4];
        (start, ends[column % 4] - start)
    };
    let (start, count) = field(columns.p);
    let sign = text.get(start)?.wrapping_sub(b'0');
    if count != 1 || sign > 1 {
        return None;
    }
    let parsed = Line {
        t_us: take(text, field(columns.t))?,
        x: take_short(text, field(columns.x))?,
        y: take_short(text, field(columns.y))?,
        is_on: sign == 1,
    };
    Some((ends[3] + 1 + usize::from(last & returns > 0), parsed))
}

/// Returns the number of 1 to 8 digits.
#[inline]
fn take_short(text: &[u8; NEAR], (start, count): (usize, usize)) -> Option<u64> {
    let eight = text.get(start..)?.first_chunk::<TOGETHER>()?;
    let digits = u64::from_le_bytes(*eight) ^ 0x3030_3030_3030_3030;
    let is_short = count.wrapping_sub(1) < TOGETHER;
    // Zeros go before the digits, and take the place of what follows them.
    is_short.then(|| number_of_digits(digits << (8 * (TOGETHER - count))))
}

/// Returns the number of 1 to 16 digits.
#[inline]
fn take(text: &[u8; NEAR], (start, count): (usize, usize)) -> Option<u64> {
    if count <= TOGETHER {
        return take_short(text, (start, count));
    }
    let upper = take_short(text, (start, count - TOGETHER))?;
    let lower = take_short(text, (start + count - TOGETHER, TOGETHER))?;
    Some(upper * POWERS[TOGETHER] + lower)
}

/// Returns which bytes have their highest bit set.
#[inline]
#[target_feature(enable = "avx2,bmi1")]
fn mask(lanes: __m256i) -> u32 {
    _mm256_movemask_epi8(lanes) as u32
}

#[inline]
#[target_feature(enable = "avx2,bmi1")]
fn load(line: &[u8; LANES]) -> __m256i {
    // SAFETY: the reference makes 32 bytes readable.
    unsafe { _mm256_loadu_si256(line.as_ptr().cast()) }
}
