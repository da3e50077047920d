//! Exact densities: as fractions, and as integers in units of 1e-12 events per pixel per second ("pico"), the unit
//! in which thresholds are stored, written and compared.

use std::cmp::Ordering;

use eecvs_nostd::Sensor;
use event_types::stream::Result;
use event_types::{bail, error};

use crate::window_counts::WindowCount;

/// Number of decimals of a threshold, whose unit is 1e-12 events per pixel per second.
const DECIMALS: usize = 12;

/// A density in events per pixel per microsecond, as a reduced fraction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Density {
    /// At most 2^20, a window's capacity.
    numerator: u64,
    /// At most 2^54: 2^22 pixels times 2^32 us.
    denominator: u64,
}

impl Density {
    /// Density of a window without events.
    pub const EMPTY: Self = Self {
        numerator: 0,
        denominator: 1,
    };

    /// Returns N / (H W T) of a closed window, with its own duration as T.
    #[must_use]
    pub fn of(window: &WindowCount, sensor: Sensor) -> Self {
        let events = u64::from(window.events);
        let pixel_us = u64::from(sensor.pixels()) * u64::from(window.duration_us);
        let divisor = greatest_common_divisor(events, pixel_us);
        Self {
            numerator: events / divisor,
            denominator: pixel_us / divisor,
        }
    }
}

impl Ord for Density {
    fn cmp(&self, other: &Self) -> Ordering {
        let cross = |a: &Self, b: &Self| u128::from(a.numerator) * u128::from(b.denominator);
        cross(self, other).cmp(&cross(other, self))
    }
}

impl PartialOrd for Density {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Returns `below + (above - below) * quarters / 4`, rounded down to 1e-12 events per pixel per second, or `None`
/// if that does not fit a u64.
///
/// `below` and `above` are densities of windows with at most 2^20 events, and `quarters` is 0 to 3.
#[must_use]
pub fn interpolated_pico(below: Density, above: Density, quarters: u128) -> Option<u64> {
    let [n0, d0, n1, d1] = [
        below.numerator,
        below.denominator,
        above.numerator,
        above.denominator,
    ]
    .map(u128::from);
    // At most 2^77 and 2^110.
    let numerator = n0 * (4 - quarters) * d1 + n1 * quarters * d0;
    let denominator = 4 * d0 * d1;
    // From events per us to 1e-12 events per s is a factor of 10^18. It is applied by long division, digit by
    // digit, because numerator * 10^18 does not fit 128 bits.
    let mut quotient = numerator / denominator;
    let mut remainder = numerator % denominator;
    for _ in 0..18 {
        remainder *= 10;
        quotient = quotient * 10 + remainder / denominator;
        remainder %= denominator;
    }
    u64::try_from(quotient).ok()
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 {
        a
    } else {
        greatest_common_divisor(b, a % b)
    }
}

/// Formats a density in 1e-12 events per pixel per second as a decimal number with 12 decimals.
#[must_use]
pub fn decimal(pico: u64) -> String {
    let one = 10_u64.pow(DECIMALS as u32);
    format!("{}.{:0width$}", pico / one, pico % one, width = DECIMALS)
}

/// Parses a decimal number into units of 1e-12, exactly; further decimals are cut off.
///
/// # Errors
/// Fails if the text is not a finite number in 0..=18446744.073709551615; the message says what to write.
pub fn pico_from_decimal(text: &str) -> Result<u64> {
    let too_large = || {
        let largest = decimal(u64::MAX);
        error!(
            Damaged,
            "{text} is too large: a threshold is at most {largest} events per pixel per second"
        )
    };
    let (negative, unsigned) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (mantissa, exponent) = unsigned.split_once(['e', 'E']).unwrap_or((unsigned, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits = format!("{whole}{fraction}");
    if digits.is_empty() || !digits.bytes().all(|b| b.is_ascii_digit()) {
        bail!(
            Damaged,
            "{text} is not a finite number: write a decimal number such as 0.4"
        );
    }
    let significant = digits.trim_start_matches('0');
    if significant.is_empty() {
        return Ok(0);
    }
    if negative {
        bail!(
            Damaged,
            "{text} is negative: write a number of events per pixel per second, 0 or above"
        );
    }
    // The result is `significant` with the point moved by `shift` digits. An exponent that does not fit an i64 has
    // the same effect as the largest or smallest i64.
    let exponent: i64 = exponent.parse().unwrap_or(if exponent.starts_with('-') {
        i64::MIN
    } else {
        i64::MAX
    });
    let shift = exponent
        .saturating_add(DECIMALS as i64)
        .saturating_sub(fraction.len() as i64);
    let length = shift.saturating_add(significant.len() as i64);
    if length > 20 {
        return Err(too_large());
    }
    let length = usize::try_from(length).unwrap_or(0);
    if length == 0 {
        return Ok(0);
    }
    let moved: String = significant
        .chars()
        .chain(std::iter::repeat('0'))
        .take(length)
        .collect();
    moved.parse().map_err(|_| too_large())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fraction(numerator: u64, denominator: u64) -> Density {
        Density {
            numerator,
            denominator,
        }
    }

    #[test]
    fn equal_densities_of_different_windows_are_one() {
        let of = |events, width, height, duration_us| {
            let window = WindowCount {
                t0_us: 0,
                duration_us,
                events,
                begins_run: false,
            };
            Density::of(&window, Sensor::new(width, height).unwrap())
        };
        assert_eq!(of(2, 4, 3, 10), fraction(1, 60));
        assert_eq!(of(2, 4, 3, 10), of(5, 10, 1, 30));
        assert!(of(1, 1, 1, 3) < of(1, 1, 1, 2));
        assert!(Density::EMPTY < of(1, 2048, 2048, u32::MAX));
        assert_eq!(of(0, 7, 7, 7), Density::EMPTY);
    }

    #[test]
    fn interpolation_rounds_down_and_reports_overflow() {
        let third = fraction(1, 3_000_000);
        assert_eq!(interpolated_pico(third, third, 2), Some(333_333_333_333));
        let (one, two) = (fraction(1, 1_000_000), fraction(2, 1_000_000));
        assert_eq!(interpolated_pico(one, two, 0), Some(1_000_000_000_000));
        assert_eq!(interpolated_pico(one, two, 3), Some(1_750_000_000_000));
        // The bounds of the arithmetic: 2^20 events, denominators near 2^54.
        let (big, odd) = ((1 << 54) - 1, (1 << 54) - 3);
        let n = 1 << 20;
        assert_eq!(
            interpolated_pico(fraction(n, big), fraction(n, odd), 1),
            Some(58_207_660)
        );
        assert_eq!(interpolated_pico(fraction(n, 1), fraction(n, 1), 0), None);
    }

    #[test]
    fn decimals_are_written_in_full() {
        assert_eq!(decimal(0), "0.000000000000");
        assert_eq!(decimal(1), "0.000000000001");
        assert_eq!(decimal(u64::MAX), "18446744.073709551615");
    }

    #[test]
    fn decimals_are_read_exactly() {
        for (text, pico) in [
            ("0", 0),
            ("-0.0", 0),
            ("0.000000000001", 1),
            ("+0.1", 100_000_000_000),
            ("0.0000000000019", 1),
            ("1e-12", 1),
            ("9.99e-13", 0),
            ("12.5e3", 12_500_000_000_000_000),
            ("12.5E+3", 12_500_000_000_000_000),
            ("0.00000000000000000000025e20", 25_000_000_000),
            ("9007.199254740993", 9_007_199_254_740_993),
            ("18446744.073709551615", u64::MAX),
            ("18446744.0737095516159", u64::MAX),
            ("1e-99999999999999999999999", 0),
            ("0e99999999999999999999999", 0),
        ] {
            assert_eq!(pico_from_decimal(text).unwrap(), pico, "{text}");
        }
        for text in [
            "18446744.073709551616",
            "99999999",
            "1e8",
            "1e400",
            "1e9223372036854775807",
        ] {
            let message = pico_from_decimal(text).unwrap_err().to_string();
            assert!(message.contains("too large"), "{message}");
        }
    }
}
