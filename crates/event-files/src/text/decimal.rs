//! Parses decimal numbers of text files exactly, as digits and a power of ten rather than a float.

/// A number: sign * `digits` * 10^`exponent`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decimal {
    negative: bool,
    digits: u64,
    exponent: i32,
    /// Whether the number is written with a point or an exponent.
    pub fractional: bool,
}

/// The error for a value that is out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutOfRange;

impl Decimal {
    /// Returns `digits` * 10^-`places`, as [`Decimal::parse`] does for digits with so many behind a point.
    #[inline]
    pub const fn of_digits(digits: u64, places: usize) -> Self {
        Self {
            negative: false,
            digits,
            exponent: -(places as i32),
            fractional: places > 0,
        }
    }

    /// Returns the digits of a number that is written with nothing else.
    #[inline]
    pub const fn integer(self) -> Option<u64> {
        let is_plain = !self.negative && !self.fractional && self.exponent == 0;
        if is_plain { Some(self.digits) } else { None }
    }

    /// Parses `[+-]digits[.digits][e[+-]digits]`, with at least one digit and nothing else; `None` otherwise.
    ///
    /// From about the 20th significant digit on, where `digits` would overflow, digits only shift the exponent:
    /// they are below any microsecond of a time that fits.
    pub fn parse(text: &[u8]) -> Option<Self> {
        let (negative, mut rest) = match text.split_first()? {
            (b'-', rest) => (true, rest),
            (b'+', rest) => (false, rest),
            _ => (false, text),
        };
        let mut number = Self {
            negative,
            digits: 0,
            exponent: 0,
            fractional: false,
        };
        let mut any = false;
        while let Some((byte, after)) = rest.split_first() {
            match byte {
                b'0'..=b'9' => {
                    any = true;
                    let digit = u64::from(byte - b'0');
                    let longer = number
                        .digits
                        .checked_mul(10)
                        .and_then(|d| d.checked_add(digit));
                    match longer {
                        Some(digits) => {
                            number.digits = digits;
                            number.exponent -= i32::from(number.fractional);
                        }
                        None => number.exponent += i32::from(!number.fractional),
                    }
                }
                b'.' if !number.fractional => number.fractional = true,
                b'e' | b'E' if any => {
                    number.fractional = true;
                    let exponent: i32 = std::str::from_utf8(after).ok()?.parse().ok()?;
                    number.exponent = number.exponent.checked_add(exponent)?;
                    return Some(number);
                }
                _ => return None,
            }
            rest = after;
        }
        any.then_some(number)
    }

    /// Returns the value times 10^`shift`, rounded to the nearest whole number, halves away from zero.
    ///
    /// # Errors
    /// The result is negative or above 2^63 - 1.
    pub fn scaled(self, shift: i32) -> Result<u64, OutOfRange> {
        let exponent = self.exponent.saturating_add(shift);
        let power = |n: u32| 10_u64.checked_pow(n);
        let value = if self.digits == 0 {
            0
        } else if exponent >= 0 {
            let scale = power(exponent.unsigned_abs()).ok_or(OutOfRange)?;
            self.digits.checked_mul(scale).ok_or(OutOfRange)?
        } else {
            // From 10^20 on, more than 2 * u64::MAX, the number rounds to 0.
            power(exponent.unsigned_abs()).map_or(0, |scale| {
                let (whole, rest) = (self.digits / scale, self.digits % scale);
                whole + u64::from(rest >= scale - rest)
            })
        };
        let fits = value <= i64::MAX as u64 && (value == 0 || !self.negative);
        fits.then_some(value).ok_or(OutOfRange)
    }

    /// Returns the value times 10^`shift`, of either sign, rounded like [`Decimal::scaled`].
    ///
    /// # Errors
    /// The magnitude is above 2^63 - 1.
    pub fn signed(self, shift: i32) -> Result<i64, OutOfRange> {
        let size = Self {
            negative: false,
            ..self
        };
        // `scaled` returns at most 2^63 - 1.
        let size = size.scaled(shift)?.cast_signed();
        Ok(if self.negative { -size } else { size })
    }

    /// Returns the value if it is whole and not negative, such as `12`, `12.0` or `1.2e1`.
    pub fn whole(self) -> Option<u64> {
        let value = self.scaled(0).ok()?;
        self.is_whole().then_some(value)
    }

    /// Returns whether [`Decimal::scaled`] with this shift needs no rounding.
    pub fn is_whole_at(self, shift: i32) -> bool {
        Self {
            exponent: self.exponent.saturating_add(shift),
            ..self
        }
        .is_whole()
    }

    /// Returns whether the fraction is 0.
    pub fn is_whole(self) -> bool {
        let places = self.exponent.min(0).unsigned_abs();
        self.digits == 0
            || 10_u64
                .checked_pow(places)
                .is_some_and(|p| self.digits.is_multiple_of(p))
    }

    /// Returns whether the value is exactly -1.
    pub fn is_minus_one(self) -> bool {
        self.negative
            && Self {
                negative: false,
                ..self
            }
            .whole()
                == Some(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn micros(text: &str) -> Option<u64> {
        Decimal::parse(text.as_bytes())?.scaled(6).ok()
    }

    #[test]
    fn seconds_to_microseconds() {
        let cases = [
            ("0", Some(0)),
            ("0.000004000", Some(4)),
            ("1633953690.975950", Some(1_633_953_690_975_950)),
            ("1633953690.9759504999", Some(1_633_953_690_975_950)),
            ("1633953690.9759505", Some(1_633_953_690_975_951)),
            ("0.0000005", Some(1)),
            ("0.00000049999999999999999999999", Some(0)),
            ("1e-06", Some(1)),
            ("2.5E+1", Some(25_000_000)),
            (".5", Some(500_000)),
            ("5.", Some(5_000_000)),
            ("+1", Some(1_000_000)),
            ("-0.0", Some(0)),
            ("-0.0000001", Some(0)),
            ("-1", None),
            ("1e300", None),
            ("1e-300", Some(0)),
            ("9223372036854.775807", Some(i64::MAX as u64)),
            ("9223372036854.775808", None),
            ("", None),
            (".", None),
            ("e5", None),
            ("1e", None),
            ("1.2.3", None),
            ("0x1", None),
            ("nan", None),
            ("1e99999999999", None),
        ];
        for (text, want) in cases {
            assert_eq!(micros(text), want, "{text}");
        }
    }

    #[test]
    fn whole_values() {
        let whole = |text: &str| Decimal::parse(text.as_bytes()).and_then(Decimal::whole);
        assert_eq!(whole("12.0"), Some(12));
        assert_eq!(whole("1.2e1"), Some(12));
        assert_eq!(whole("12.5"), None);
        assert_eq!(whole("-3"), None);
        let number = |text: &str| Decimal::parse(text.as_bytes()).expect("a number");
        assert!(number("-1.0").is_minus_one());
        assert!(!number("1").is_minus_one());
    }
}
