//! Exponential and logarithm in `f32` that compilers vectorise, with the same bits on every machine: additions,
//! multiplications and divisions in a fixed order, none of them fused.

/// Returns e^x within 2 units in the last place for x from -87 to 88; beyond, the value at the nearer end.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    // 1.5 * 2^23: adding it leaves the nearest whole number in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let rounded = x * core::f32::consts::LOG2_E + ROUND;
    let whole = rounded - ROUND;
    // ln 2 in two parts, the first of which has few bits: its product with a whole number is exact.
    let r = (x - whole * 0.693_359_4) - whole * -2.121_944_4e-4;
    // Taylor's series to the 7th power: r is within +-0.35, the next term is below 6e-9.
    let mut p = 1.0 / 5_040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r + 1.0;
    p = p * r + 1.0;
    let power = rounded.to_bits().wrapping_sub(ROUND.to_bits());
    f32::from_bits(p.to_bits().wrapping_add(power << 23))
}

/// Returns ln x within 1.2e-7 * max(1, |ln x|), for positive normal x.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    // The bits of sqrt(1/2): the mantissa becomes a number from there to sqrt(2).
    const HALF: u32 = 0x3f35_04f3;
    let bits = x.to_bits().wrapping_sub(HALF);
    let power = (bits as i32 >> 23) as f32;
    let f = f32::from_bits((bits & 0x007f_ffff) + HALF) - 1.0;
    // ln(1 + f) = 2 artanh(s), s = f / (2 + f), within +-0.172.
    let s = f / (2.0 + f);
    let z = s * s;
    let mut p = 2.0 / 9.0;
    p = p * z + 2.0 / 7.0;
    p = p * z + 2.0 / 5.0;
    p = p * z + 2.0 / 3.0;
    power * 0.693_359_4 + (power * -2.121_944_4e-4 + (s + s + s * z * p))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_logarithm_are_within_their_errors() {
        let (mut worst_exp, mut worst_ln) = (0.0_f64, 0.0_f64);
        for i in -870_000..880_000 {
            let x = i as f32 * 1e-4;
            let expected = libm::exp(f64::from(x));
            worst_exp = worst_exp.max((f64::from(exp(x)) / expected - 1.0).abs());
            let y = exp(x);
            let expected = libm::log(f64::from(y));
            let error = (f64::from(ln(y)) - expected).abs() / expected.abs().max(1.0);
            worst_ln = worst_ln.max(error);
        }
        assert!(worst_exp < 2.4e-7, "{worst_exp}");
        assert!(worst_ln < 1.2e-7, "{worst_ln}");
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(ln(1.0), 0.0);
        assert_eq!(exp(f32::NEG_INFINITY), exp(-87.0));
        assert_eq!(exp(f32::INFINITY), exp(88.0));
    }
}
