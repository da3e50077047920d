//! Windows of 1 us to 2^32 - 1 us, M = 64 and every transform, through the encoder and back.

use std::f64::consts::TAU;

use eecvs::reconstruct::pixels;
use eecvs_bench::oracle_of;
use eecvs_nostd::transform::GRID_MAX;
use eecvs_nostd::{Event, Polarity, Quantiser, Sensor, Transform};
use eecvs_oracle::transform::Impulse;
use strategies::one_pixel::{bound, merged};
use strategies::{encode, parse, plain_config};

/// Powers of two and their neighbours, primes, round numbers, an hour, the longest.
pub const DURATIONS_US: [u32; 34] = [
    1,
    2,
    3,
    4,
    5,
    7,
    8,
    9,
    31,
    32,
    33,
    127,
    128,
    129,
    1000,
    1021,
    1023,
    1024,
    1025,
    32_767,
    32_768,
    32_769,
    33_333,
    65_521,
    999_983,
    1_048_575,
    1_048_577,
    16_777_213,
    1_000_000_007,
    2_147_483_647,
    2_147_483_649,
    3_600_000_000,
    4_294_967_291,
    u32::MAX,
];

/// Pixels of one and of two events at the window's ends, its middle and next to them.
fn pixels_of(duration_us: u32) -> Vec<Vec<Impulse>> {
    let (half, last) = (duration_us / 2, duration_us - 1);
    let places = [
        0,
        1,
        half.saturating_sub(1),
        half,
        half + 1,
        last / 3,
        last.saturating_sub(1),
        last,
    ];
    let on = |offset_us| Impulse { offset_us, p: 1.0 };
    let off = |offset_us| Impulse { offset_us, p: -1.0 };
    let mut pixels: Vec<_> = places.iter().map(|at| vec![on(*at)]).collect();
    pixels.push(vec![off(last)]);
    pixels.extend([
        vec![on(0), on(last)],
        vec![on(0), off(last)],
        vec![on(last), on(last)],
        vec![off(half), off(last), on(0)],
    ]);
    pixels.retain(|pixel| pixel.iter().all(|impulse| impulse.offset_us <= last));
    pixels
}

#[test]
fn every_window_gives_its_coefficients_back() {
    for duration_us in DURATIONS_US {
        let expected = pixels_of(duration_us);
        let sensor = Sensor {
            width: expected.len() as u16 + 1,
            height: 1,
        };
        let event = |x, offset_us: u32, p| Event {
            t_us: 77 + u64::from(offset_us),
            x,
            y: 0,
            polarity: Polarity::from_bool(p > 0.0),
        };
        // The last column sets t0.
        let mut events = vec![event(sensor.width - 1, 0, 1.0)];
        for (x, pixel) in (0..).zip(&expected) {
            events.extend(pixel.iter().map(|i| event(x, i.offset_us, i.p)));
        }
        for (transform, grid, step_log2) in Transform::ALL.into_iter().flat_map(|transform| {
            [
                (None, -15),
                (None, -6),
                (Some(GRID_MAX as u16), -15),
                (Some(8), 0),
            ]
            .map(|(grid, step_log2)| (transform, grid, step_log2))
        }) {
            let mut config = plain_config(sensor, transform, 64);
            config.window.window_us = duration_us;
            config.grid = grid;
            config.quantiser = Quantiser::new(step_log2).expect("in range");
            let frames = encode(config, &events, events.len(), 1 << 16);
            let frame = parse(&frames[0]);
            assert_eq!((frames.len(), frame.header.duration_us), (1, duration_us));
            let found = pixels(&frame).expect("the encoder's own payload");
            let grid = usize::from(frame.header.grid);
            for (found, events) in found.iter().zip(&expected) {
                let case = format!("T {duration_us} {transform:?} {grid} {step_log2} {events:?}");
                let on = events.iter().filter(|event| event.p > 0.0).count();
                let counts = (found.on as usize, found.off as usize);
                assert_eq!(counts, (on, events.len() - on), "{case}");
                let exact = oracle_of(transform).coefficients(&merged(events), duration_us, grid);
                let step = 2_f64.powi(i32::from(step_log2));
                let tolerance = match (transform, events.len()) {
                    (Transform::Dwt, _) => 0.0,
                    // The middle of a cell, whose edge may be 3 * 2^-31 of the window away.
                    (_, 1) => step / 2.0 + TAU * 64.0 * 3.0 * 2_f64.powi(-31),
                    (Transform::Dct, n) => bound(transform, n) + step / 2.0,
                    (Transform::Dtft, n) => bound(transform, n) + step * 0.5_f64.sqrt(),
                };
                for (k, re, im) in &found.coefficients {
                    let exact = exact[usize::from(*k)];
                    let error = (re - exact.re).hypot(im - exact.im);
                    assert!(error <= tolerance + 1e-9, "{case} k {k}: {error:e}");
                }
                // Of the Haar coefficients, as many as there are; of the others r.
                let nonzero = exact.iter().filter(|c| c.norm() > 1e-9).count();
                let kept = match transform {
                    Transform::Dwt => nonzero.min(64),
                    Transform::Dct | Transform::Dtft => grid.min(64),
                };
                assert_eq!(found.coefficients.len(), kept, "{case}");
            }
        }
    }
}
