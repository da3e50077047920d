//! Lines of four whole numbers, by AVX2: where the fields of a line end is found at once.

use core::arch::x86_64::{
    __m256i, _mm256_cmpeq_epi8, _mm256_loadu_si256, _mm256_min_epu8, _mm256_movemask_epi8,
    _mm256_set1_epi8, _mm256_sub_epi8,
};

use event_types::{Event, Polarity, Sensor};

use super::{Form, Four, POWERS, Run, number_of_digits};

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

    /// Parses lines at the start of `text` of this form, up to the first other one, and puts their events into `events`.
    pub fn parse(self, text: &[u8], form: Form, sensor: Sensor, events: &mut [Event]) -> Run {
        // SAFETY: `self` proves that the core has what the functions need.
        unsafe {
            match form.columns {
                T_X_Y_P => parse::<0>(text, form, sensor, events),
                X_Y_T_P => parse::<1>(text, form, sensor, events),
                _ => parse::<OTHERS>(text, form, sensor, events),
            }
        }
    }
}

/// The orders of columns that most files have.
const T_X_Y_P: Four = Four {
    t: 0,
    x: 1,
    y: 2,
    p: 3,
};
const X_Y_T_P: Four = Four {
    t: 2,
    x: 0,
    y: 1,
    p: 3,
};
/// Number of all other orders, after those two.
const OTHERS: u8 = 2;

/// Parses lines whose columns have the order of this number: where the code knows it, it takes fewer instructions.
#[target_feature(enable = "avx2,bmi1")]
fn parse<const ORDER: u8>(text: &[u8], form: Form, sensor: Sensor, events: &mut [Event]) -> Run {
    let form = Form {
        columns: match ORDER {
            0 => T_X_Y_P,
            1 => X_Y_T_P,
            _ => form.columns,
        },
        ..form
    };
    let Form {
        columns,
        separator,
        with_times,
    } = form;
    // The length of a line that is parsed, and its event: `None` for another.
    let line = |text: &[u8]| {
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
        let event = Event {
            t_us: take(text, field(columns.t), with_times)?,
            x: take_four(text, field(columns.x))?,
            y: take_four(text, field(columns.y))?,
            polarity: Polarity::from_bool(sign == 1),
        };
        let is_inside = sensor.contains(event.x, event.y);
        is_inside.then_some((ends[3] + 1 + usize::from(last & returns > 0), event))
    };
    let mut run = Run::default();
    let mut rest = text;
    for event in events {
        let Some((bytes, parsed)) = line(rest) else {
            break;
        };
        *event = parsed;
        run.has_zero |= parsed.polarity == Polarity::Off;
        run.lines += 1;
        run.bytes += bytes;
        rest = rest.get(bytes..).unwrap_or_default();
    }
    run
}

/// Returns the number of 1 to 4 digits: coordinates of more are left to the parser of all lines.
#[inline]
fn take_four(text: &[u8; NEAR], (start, count): (usize, usize)) -> Option<u16> {
    let four = text.get(start..)?.first_chunk::<4>()?;
    let digits = u32::from_le_bytes(*four) ^ 0x3030_3030;
    if count.wrapping_sub(1) >= 4 {
        return None;
    }
    // Zeros go before the digits, and take the place of what follows them.
    let values = digits << (8 * (4 - count));
    let pairs = values.wrapping_mul(10 << 8 | 1) >> 8 & 0x00FF_00FF;
    Some((pairs.wrapping_mul(100 << 16 | 1) >> 16) as u16)
}

/// Returns the number of 1 to 8 digits.
#[inline]
fn take_eight(text: &[u8; NEAR], (start, count): (usize, usize)) -> Option<u64> {
    let eight = text.get(start..)?.first_chunk::<TOGETHER>()?;
    let digits = u64::from_le_bytes(*eight) ^ 0x3030_3030_3030_3030;
    let is_short = count.wrapping_sub(1) < TOGETHER;
    is_short.then(|| number_of_digits(digits << (8 * (TOGETHER - count))))
}

/// Returns the number of 1 to 16 digits; 0 if it is not wanted.
#[inline]
fn take(text: &[u8; NEAR], (start, count): (usize, usize), is_wanted: bool) -> Option<u64> {
    if !is_wanted {
        return (count.wrapping_sub(1) < 2 * TOGETHER).then_some(0);
    }
    if count <= TOGETHER {
        return take_eight(text, (start, count));
    }
    let upper = take_eight(text, (start, count - TOGETHER))?;
    let lower = take_eight(text, (start + count - TOGETHER, TOGETHER))?;
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
