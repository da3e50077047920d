//! Each stage of the fixed-point core against the f64 oracle, within the stated bounds.

use eecvs_bench::oracle_of;
use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Sum};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft, Dwt, GRID_MAX};
use eecvs_nostd::{Config, Quantiser, Sensor, Transform};
use eecvs_oracle::transform as oracle;
use proptest::prelude::*;
use strategies::one_pixel::{bound, check_kept};
use strategies::{plain_config, transform};

fn accumulate(
    transform: Transform,
    impulses: &[oracle::Impulse],
    duration_us: u32,
    grid: usize,
) -> Vec<(f64, f64)> {
    let scale = PhaseScale::new(duration_us);
    let net = impulses.iter().map(|impulse| impulse.p as i32).sum::<i32>();
    let impulses = impulses.iter().map(|impulse| Impulse {
        offset_us: impulse.offset_us,
        is_on: impulse.p > 0.0,
    });
    let mut sums = vec![Sum::ZERO; 2 * grid];
    match transform {
        Transform::Dct => Dct::accumulate(impulses, scale, grid, &mut sums),
        Transform::Dtft => Dtft::accumulate(impulses, scale, grid, &mut sums),
        Transform::Dwt => Dwt::accumulate(impulses, scale, grid, &mut sums),
    }
    // c_0 is known to the caller of `accumulate`.
    sums[0] = Sum::from_num(net);
    if transform == Transform::Dtft {
        sums[1] = Sum::ZERO;
    }
    (0..grid)
        .map(|k| {
            let number = |i: usize| sums[i].to_num::<f64>();
            match transform {
                Transform::Dct => (number(k), 0.0),
                Transform::Dtft => (number(2 * k), number(2 * k + 1)),
                Transform::Dwt => (
                    number(k)
                        * 2_f64
                            .powf(f64::from(eecvs_nostd::transform::haar_scale::scale_of(k)) / 2.0),
                    0.0,
                ),
            }
        })
        .collect()
}

/// Durations with their edges, and offsets that favour the atoms' discontinuities.
fn pixel() -> impl Strategy<Value = (u32, Vec<oracle::Impulse>)> {
    let duration = prop_oneof![
        Just(1_u32),
        Just(32_768),
        Just(3_600_000_000),
        Just(u32::MAX),
        1..100_u32,
        1..=u32::MAX,
    ];
    duration.prop_flat_map(|duration_us| {
        let offset = prop_oneof![
            Just(0),
            Just(duration_us - 1),
            0..duration_us,
            (0..=256_u64, 0..3_u64).prop_map(move |(m, more)| {
                // At, just before and just after m / 256 of the window.
                let at = (m * u64::from(duration_us) / 256 + more).saturating_sub(1);
                at.min(u64::from(duration_us) - 1) as u32
            }),
        ];
        let impulse = (offset, any::<bool>()).prop_map(|(offset_us, on)| oracle::Impulse {
            offset_us,
            p: if on { 1.0 } else { -1.0 },
        });
        (
            Just(duration_us),
            proptest::collection::vec(impulse, 1..=CHUNK_EVENTS),
        )
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn accumulate_is_within_n_times_2_to_the_minus_14(
        (duration_us, impulses) in pixel(),
        transform in transform(),
        grid in prop_oneof![1..=128_u16, Just(GRID_MAX as u16)],
    ) {
        let grid = usize::from(transform.grid_size(8, Some(grid)));
        let expected = oracle_of(transform).coefficients(&impulses, duration_us, grid);
        let found = accumulate(transform, &impulses, duration_us, grid);
        for (k, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let error = (found.0 - expected.re).hypot(found.1 - expected.im);
            let bound = match transform {
                // The Haar sums are exact; what is left is the f64 rounding of the scale.
                Transform::Dwt => 1e-12 * (1.0 + expected.re.abs()),
                _ => bound(transform, impulses.len()),
            };
            if transform != Transform::Dwt && k > 0 {
                // What lets the levels of n events do without a bit for n itself.
                let most = found.0.abs().max(found.1.abs());
                prop_assert!(most < impulses.len() as f64, "{:?} k {}: {}", transform, k, most);
            }
            prop_assert!(error <= bound, "{:?} k {} of {}: {} > {}", transform, k, grid, error, bound);
        }
    }
}

/// A single event anywhere in windows of any length: the error of one atom, which n events add up
/// to n times at the most. The worst is where an atom's step is close to whole and half turns.
#[test]
fn atoms_are_within_the_documented_error() {
    let mut worst = [0.0_f64; 4];
    let durations = [1, 3, 1000, 32_768, 33_333, 999_983, 3_600_000_000, u32::MAX];
    for duration_us in durations {
        let last = duration_us - 1;
        let spread = (0..1500_u64).map(|i| (i * u64::from(duration_us) / 1500) as u32);
        let edges = (0..40).flat_map(|i| {
            let half = duration_us / 2;
            [i, last.saturating_sub(i), half.saturating_sub(i), half + i]
        });
        for offset_us in spread.chain(edges).filter(|offset| *offset <= last) {
            // The DTFT of K = 16 has atoms of its own.
            for (transform, grid, slot) in [
                (Transform::Dct, GRID_MAX, 0),
                (Transform::Dtft, GRID_MAX, 1),
                (Transform::Dtft, 16, 3),
            ] {
                let impulse = [oracle::Impulse { offset_us, p: 1.0 }];
                let expected = oracle_of(transform).coefficients(&impulse, duration_us, grid);
                let found = accumulate(transform, &impulse, duration_us, grid);
                for ((re, im), expected) in found.iter().zip(&expected).skip(1) {
                    let error = (re - expected.re).abs().max((im - expected.im).abs());
                    worst[slot] = worst[slot].max(error);
                    worst[2] = worst[2].max(re.abs().max(im.abs()));
                }
            }
        }
    }
    println!(
        "DCT 2^{:.2}, DTFT 2^{:.2}, of K = 16 2^{:.2}",
        worst[0].log2(),
        worst[1].log2(),
        worst[3].log2()
    );
    assert!(worst[0] <= 2_f64.powf(-14.9), "DCT: {:e}", worst[0]);
    assert!(worst[1] <= 2_f64.powf(-14.9), "DTFT: {:e}", worst[1]);
    assert!(worst[3] <= 2_f64.powf(-14.15), "K = 16: {:e}", worst[3]);
    assert!(worst[2] < 1.0, "an atom of {}", worst[2]);
}

/// Events of one pixel in a window of 32,768 us.
fn impulses(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<oracle::Impulse>> {
    let impulse = (0..32_768_u32, any::<bool>()).prop_map(|(offset_us, on)| oracle::Impulse {
        offset_us,
        p: if on { 1.0 } else { -1.0 },
    });
    proptest::collection::vec(impulse, count)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn the_link_keeps_the_oracles_coefficients(
        transform in transform(),
        m in prop_oneof![Just(8_u8), Just(16), Just(24), Just(64), 1..=64_u8],
        step_log2 in -15..=2_i8,
        impulses in prop_oneof![9 => impulses(1..20), 1 => impulses(200..700)],
        few_as_times: bool,
    ) {
        let config = Config {
            few_as_times,
            quantiser: Quantiser::new(step_log2).expect("-15 to 8"),
            ..plain_config(Sensor { width: 2, height: 1 }, transform, m)
        };
        check_kept(config, &impulses)?;
    }
}

/// A pixel's events are summed in chunks: none is lost or counted twice at their edges.
#[test]
fn no_event_is_lost_between_chunks() {
    let chunk = CHUNK_EVENTS as u32;
    for count in [
        chunk - 1,
        chunk,
        chunk + 1,
        2 * chunk - 1,
        2 * chunk,
        2 * chunk + 1,
        255,
        256,
    ] {
        for transform in Transform::ALL {
            // All in the first 1/16 of the window, where no atom is small.
            let impulses: Vec<_> = (0..count)
                .map(|i| oracle::Impulse {
                    offset_us: i,
                    p: 1.0,
                })
                .collect();
            let sensor = Sensor {
                width: 2,
                height: 1,
            };
            check_kept(plain_config(sensor, transform, 16), &impulses).expect("within the bound");
        }
    }
}
