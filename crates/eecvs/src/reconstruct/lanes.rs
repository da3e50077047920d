//! Numbers of several events at once, in lanes that a compiler puts into vector registers, and their sines and cosines.

use std::f64::consts::FRAC_PI_2;

/// Numbers that are computed at once.
pub const LANES: usize = 4;

/// One number of each of several events.
pub type Lanes = [f64; LANES];

/// Returns how many blocks of lanes n numbers take; lanes that are left hold 0.
pub const fn blocks(n: usize) -> usize {
    n.div_ceil(LANES)
}

/// Returns up to [`LANES`] numbers, with zeros behind them.
#[inline(always)]
pub fn filled(numbers: &[f64]) -> Lanes {
    std::array::from_fn(|lane| numbers.get(lane).copied().unwrap_or(0.0))
}

/// Returns the sum of the products of two rows.
#[inline(always)]
pub fn dot(a: &[Lanes], b: &[Lanes]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sum(sums)
}

/// Adds `factor` times `row` to `to`.
#[inline(always)]
pub fn add_row(to: &mut [Lanes], factor: f64, row: &[Lanes]) {
    for (to, row) in to.iter_mut().zip(row) {
        let (sums, row) = (*to, *row);
        *to = std::array::from_fn(|lane| sums[lane] + factor * row[lane]);
    }
}

/// Calls a function that is always inlined, compiled for AVX2 where the core has it. No product is fused with a sum, so
/// the result is the same to the bit.
macro_rules! wide {
    ($function:path, $($argument:ident: $type:ty),* $(; $result:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn by_avx2($($argument: $type),*) $(-> $result)? {
            $function($($argument),*)
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: The core has AVX2, which is all that the function needs.
            #[expect(unsafe_code, reason = "a call of a function for AVX2")]
            return unsafe { by_avx2($($argument),*) };
        }
        $function($($argument),*)
    }};
}
pub(super) use wide;

/// Returns the sum of the lanes.
#[inline(always)]
pub fn sum([a, b, c, d]: Lanes) -> f64 {
    (a + b) + (c + d)
}

/// Taylor's coefficients of sin r / r in r^2 up to r^16, and of cos r up to r^18: below pi / 4 the rest is less than
/// 2^-57.
const SINE: [f64; 9] = taylor(1);
const COSINE: [f64; 10] = taylor(0);

/// Returns (-1)^i / (2i + first)!.
const fn taylor<const N: usize>(first: usize) -> [f64; N] {
    let mut terms = [1.0; N];
    let mut i = 1;
    while i < N {
        let at = 2 * i + first;
        terms[i] = -terms[i - 1] / ((at - 1) * at) as f64;
        i += 1;
    }
    terms
}

/// Returns the polynomial of `terms` at x.
#[inline(always)]
fn polynomial(terms: &[f64], x: Lanes) -> Lanes {
    terms.iter().rev().fold([0.0; LANES], |sum, term| {
        std::array::from_fn(|lane| sum[lane] * x[lane] + term)
    })
}

/// Returns sin and cos of `quarters` times pi / 2, to 2^-50 (enforced by a test) for numbers up to 2^20; numbers that
/// are not finite give no number.
#[inline(always)]
pub fn sin_cos(quarters: Lanes) -> (Lanes, Lanes) {
    // Adding it leaves no room for a fraction, so the sum is rounded to a whole number, which its low bits hold.
    const WHOLE: f64 = (3_u64 << 51) as f64;
    let shifted = quarters.map(|x| x + WHOLE);
    let whole = shifted.map(|x| x - WHOLE);
    let r: Lanes = std::array::from_fn(|lane| (quarters[lane] - whole[lane]) * FRAC_PI_2);
    let squared = r.map(|r| r * r);
    let by_r = polynomial(&SINE, squared);
    let sine: Lanes = std::array::from_fn(|lane| by_r[lane] * r[lane]);
    let cosine = polynomial(&COSINE, squared);
    // Odd quarters exchange the two, and each changes its sign with its second bit.
    let turned = |lane: usize, quarter: u64| {
        let value = if quarter & 1 == 0 {
            sine[lane]
        } else {
            cosine[lane]
        };
        f64::from_bits(value.to_bits() ^ (quarter & 2) << 62)
    };
    let quarter = shifted.map(f64::to_bits);
    (
        std::array::from_fn(|lane| turned(lane, quarter[lane])),
        std::array::from_fn(|lane| turned(lane, quarter[lane] + 1)),
    )
}

/// 1 / i! up to i = 13: for |r| up to ln 2 / 2 the rest of exp r is less than 2^-57.
const POWERS: [f64; 14] = {
    let mut terms = [1.0; 14];
    let mut i = 1;
    while i < 14 {
        terms[i] = terms[i - 1] / i as f64;
        i += 1;
    }
    terms
};

/// Returns exp of numbers that are at most 0, to a relative 2^-49 (enforced by a test); of numbers below -707, that of
/// -707.
#[inline(always)]
pub fn exp(x: Lanes) -> Lanes {
    const WHOLE: f64 = (3_u64 << 51) as f64;
    // Few enough bits that their product with any power that occurs is exact; the rest of ln 2 is added.
    const LN_2_HIGH: f64 = f64::from_bits(std::f64::consts::LN_2.to_bits() & !0xFFFF);
    const LN_2_LOW: f64 = 2.319_046_813_846_299_6e-17 + (std::f64::consts::LN_2 - LN_2_HIGH);
    let x = x.map(|x| if x > -707.0 { x } else { -707.0 });
    let shifted = x.map(|x| x * std::f64::consts::LOG2_E + WHOLE);
    let whole = shifted.map(|x| x - WHOLE);
    let r: Lanes =
        std::array::from_fn(|lane| (x[lane] - whole[lane] * LN_2_HIGH) - whole[lane] * LN_2_LOW);
    let power = polynomial(&POWERS, r);
    std::array::from_fn(|lane| {
        let exponent = shifted[lane].to_bits().wrapping_add(1023) << 52;
        power[lane] * f64::from_bits(exponent)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_those_of_the_library() {
        for i in 0..80_000_u32 {
            let x = -f64::from(i) / 113.0;
            let (found, expected) = (exp([x, 0.0, x / 1000.0, -1e9]), x.max(-707.0).exp());
            assert!((found[0] / expected - 1.0).abs() <= 0.5_f64.powi(49), "{x}");
            let small = (x / 1000.0).exp();
            assert!((found[2] / small - 1.0).abs() <= 0.5_f64.powi(49), "{x}");
            assert_eq!(found[1], 1.0);
            assert!(found[3] > 0.0 && found[3] < 1e-300);
        }
    }

    #[test]
    fn sines_and_cosines_are_those_of_the_library() {
        // The library's own argument is rounded.
        let most = 0.5_f64.powi(50);
        for i in -40_000..40_000_i32 {
            let quarters = f64::from(i) / 9_973.0;
            let (sin, cos) = (quarters * FRAC_PI_2).sin_cos();
            let found = sin_cos([quarters, 0.0, quarters + 4.0, -quarters]);
            assert!((found.0[0] - sin).abs() <= most, "{quarters}");
            assert!((found.1[0] - cos).abs() <= most, "{quarters}");
            assert_eq!((found.0[1], found.1[1]), (0.0, 1.0));
            // So is the sum.
            assert!((found.0[2] - sin).abs() <= 3.0 * most, "{quarters}");
            assert_eq!((found.0[3], found.1[3]), (-found.0[0], found.1[0]));
        }
        for quarters in [1.0, 2.0, 3.0, 4.0, -1.0, 1_048_576.0] {
            let (sin, cos) = sin_cos([quarters; LANES]);
            let expected = match quarters as i64 & 3 {
                0 => (0.0, 1.0),
                1 => (1.0, 0.0),
                2 => (0.0, -1.0),
                _ => (-1.0, 0.0),
            };
            assert_eq!((sin[0], cos[0]), expected);
        }
        assert!(sin_cos([f64::INFINITY; LANES]).0[0].is_nan());
    }
}
