//! Coefficients on the border of a step, the widest levels, every step from 2^-15 to 2^8.

use eecvs_nostd::fixed_point::{Coefficient, Sum, WideSum};
use eecvs_nostd::transform::haar_scale::scale_of;
use eecvs_nostd::{Level, Quantiser, Transform};
use strategies::one_pixel::{bound, config, expected, impulses, through_the_link};

fn quantisers() -> impl Iterator<Item = Quantiser> {
    let steps = Quantiser::STEP_LOG2_MIN..=Quantiser::STEP_LOG2_MAX;
    steps.map(|step_log2| Quantiser::new(step_log2).expect("in range"))
}

/// A border belongs to the level above it, its neighbour to the one below; both are half a step away
/// from what they stand for, at the most.
#[test]
fn borders_belong_to_the_level_above() {
    for quantiser in quantisers() {
        let shift = quantiser.shift();
        let step = 2_f64.powi(i32::from(quantiser.step_log2()));
        let near = (-70..=70).chain([(1 << 24) - 1, 1 - (1 << 24)]);
        for level in near.chain([i32::MIN, i32::MAX]) {
            // Sums are far from where this ends.
            let Some(border) = i64::from(level).checked_mul(2 << shift) else {
                continue;
            };
            let border = border / 2;
            for (bits, expected) in [
                (border, level),
                (border + 1, level),
                (border + (1 << shift) - 1, level),
                (border - 1, level.saturating_sub(1)),
            ] {
                let value = WideSum::from_bits(bits);
                assert_eq!(quantiser.uniform(value), expected, "{quantiser:?} {bits}");
                // Only what is below the lowest level is cut here.
                assert_eq!(value.is_cut(shift), level == i32::MIN && bits < border);
                if let Ok(bits) = i32::try_from(bits) {
                    let narrow = Sum::from_bits(bits);
                    assert_eq!(quantiser.uniform(narrow), expected, "{quantiser:?} {bits}");
                    assert!(!narrow.is_cut(shift));
                }
                if value.is_cut(shift) {
                    continue;
                }
                let level = Level {
                    k: 1,
                    re: expected,
                    im: expected,
                };
                let (re, im) = quantiser.dequantise(Transform::Dtft, level);
                let error = (re - value.to_num::<f64>()).abs();
                assert!(
                    error <= step / 2.0 && re.total_cmp(&im).is_eq(),
                    "{quantiser:?} {bits}"
                );
                // At a border itself there is no nearer one.
                assert!(bits != border || error == step / 2.0);
            }
        }
    }
}

/// Halves of a Haar step go away from 0, alike for both signs, up to the largest difference.
#[test]
fn haar_halves_go_away_from_0() {
    let largest = [8_388_607, 8_388_608, 8_388_609, (1 << 24) - 1];
    for quantiser in quantisers() {
        let step = 2_f64.powi(i32::from(quantiser.step_log2()));
        for k in [1, 2, 5, 11, 31, 32, 100, 255, 300, 1023] {
            let scale = scale_of(k);
            let unit = 2_f64.powi(scale as i32).sqrt();
            // q = max(1, floor(D / 2^(j/2))), in integers: q^2 2^j <= D^2 < (q + 1)^2 2^j.
            let square = if quantiser.step_log2() > 0 {
                1_u64 << (2 * quantiser.step_log2())
            } else {
                0
            };
            let q = (1..=256_u64)
                .rev()
                .find(|q| (q * q) << scale <= square)
                .unwrap_or(1) as i32;
            for difference in (0..1200).chain(largest) {
                let level = quantiser.haar(difference, scale);
                // 2 |D| + q over 2 q, rounded down, is round(|D| / q) with halves up.
                let rounded = (2 * i64::from(difference) + i64::from(q)) / (2 * i64::from(q));
                assert_eq!(
                    i64::from(level),
                    rounded,
                    "{quantiser:?} {difference} k {k}"
                );
                assert_eq!(quantiser.haar(-difference, scale), -level);
                let level = Level {
                    k: k as u16,
                    re: level,
                    im: 0,
                };
                let (value, _) = quantiser.dequantise(Transform::Dwt, level);
                let error = (value - f64::from(difference) * unit).abs();
                let most = if q == 1 { 0.0 } else { step / 2.0 };
                assert!(
                    error <= most + 1e-9 * unit,
                    "{quantiser:?} {difference} k {k}: {error}"
                );
            }
        }
    }
}

/// n events at the start of the window, or at its middle: |c_k| is as close to n as it comes, and the
/// level is the first or the last of the widest there are.
#[test]
fn the_widest_levels_come_back() {
    let duration_us = 32_768;
    let counts = [
        2, 3, 4, 5, 63, 64, 65, 127, 128, 129, 255, 256, 257, 4096, 65_535,
    ];
    for (n, quantiser) in counts
        .into_iter()
        .flat_map(|n| quantisers().map(move |quantiser| (n, quantiser)))
    {
        let step = 2_f64.powi(i32::from(quantiser.step_log2()));
        for (offset_us, p) in [(0, 1.0), (0, -1.0), (duration_us / 2, 1.0)] {
            let events = impulses(std::iter::repeat_n(offset_us, n), p);
            for (transform, m) in [
                (Transform::Dct, 4),
                (Transform::Dct, 8),
                (Transform::Dct, 10),
                (Transform::Dtft, 4),
                (Transform::Dwt, 4),
            ] {
                let case = format!("{n} at {offset_us} {transform:?} M {m} {quantiser:?}");
                let mut config = config(transform, m, duration_us);
                config.grid = Some(u16::from(m));
                config.quantiser = quantiser;
                let expected = expected(&config, &events);
                let (header, pixel) = through_the_link(config, &events);
                assert_eq!(header.saturated, 0, "{case}");
                let half_step = match transform {
                    Transform::Dwt if step <= 1.0 => 0.0,
                    Transform::Dwt | Transform::Dct => step / 2.0,
                    Transform::Dtft => step * 0.5_f64.sqrt(),
                };
                let most = bound(transform, n) + half_step + 1e-9 * n as f64;
                let mut absent = expected.clone();
                for (k, re, im) in pixel.coefficients {
                    let k = usize::from(k);
                    let error = (re - expected[k].re).hypot(im - expected[k].im);
                    assert!(error <= most, "{case} k {k}: {re} {im} off by {error}");
                    absent[k] = 0.0.into();
                }
                // What a coarse Haar step leaves out is as small.
                let left_out = absent.iter().map(|c| c.norm()).fold(0.0, f64::max);
                assert!(left_out <= most, "{case}: {left_out} left out");
            }
        }
    }
}
