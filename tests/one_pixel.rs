//! One pixel's events through the whole encoder and back, against the oracle.

use std::collections::BTreeMap;

use eecvs::reconstruct::{Pixel, pixels};
use eecvs_bench::oracle_of;
use eecvs_nostd::{Config, Event, Header, Polarity, Sensor, Transform};
use eecvs_oracle::prune;
use eecvs_oracle::transform::Impulse;
use num_complex::Complex64;
use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

use crate::{encode, parse, plain_config};

/// The sensor of [`through_the_link`]: its other pixel has the event that sets t0.
pub const SENSOR: Sensor = Sensor {
    width: 2,
    height: 1,
};

/// |c - c_ref| <= n 2^-14 before quantisation; the Haar sums are exact.
#[must_use]
pub fn bound(transform: Transform, events: usize) -> f64 {
    match transform {
        Transform::Dct | Transform::Dtft => events as f64 / 16_384.0,
        Transform::Dwt => 0.0,
    }
}

/// [`plain_config`] of one pixel with another T.
#[must_use]
pub fn config(transform: Transform, m: u8, window_us: u32) -> Config {
    let mut config = plain_config(SENSOR, transform, m);
    config.window.window_us = window_us;
    config
}

/// `p` at each of `offsets`.
#[must_use]
pub fn impulses(offsets: impl IntoIterator<Item = u32>, p: f64) -> Vec<Impulse> {
    let impulse = |offset_us| Impulse { offset_us, p };
    offsets.into_iter().map(impulse).collect()
}

/// One impulse for each time, its p the sum: the same coefficients, in less time.
#[must_use]
pub fn merged(events: &[Impulse]) -> Vec<Impulse> {
    let mut by_time = BTreeMap::new();
    for event in events {
        *by_time.entry(event.offset_us).or_insert(0.0) += event.p;
    }
    let impulse = |(offset_us, p)| Impulse { offset_us, p };
    by_time.into_iter().map(impulse).collect()
}

/// The oracle's coefficients.
#[must_use]
pub fn expected(config: &Config, impulses: &[Impulse]) -> Vec<Complex64> {
    let transform = config.transform.expect("one transform");
    let grid = usize::from(transform.grid_size(config.m, config.grid));
    oracle_of(transform).coefficients(&merged(impulses), config.window.window_us, grid)
}

/// One pixel's events through the whole encoder and back.
#[must_use]
pub fn through_the_link(config: Config, impulses: &[Impulse]) -> (Header, Pixel) {
    let event = |x, offset_us: u32, on| Event {
        t_us: 1000 + u64::from(offset_us),
        x,
        y: 0,
        polarity: Polarity::from_bool(on),
    };
    let mut events = vec![event(1, 0, true)];
    events.extend(impulses.iter().map(|i| event(0, i.offset_us, i.p > 0.0)));
    let frames = encode(config, &events, events.len(), 1 << 16);
    assert_eq!(frames.len(), 1);
    let frame = parse(&frames[0]);
    let mut pixels = pixels(&frame).expect("the encoder's own payload");
    assert_eq!(pixels.len(), 2);
    (frame.header, pixels.swap_remove(0))
}

/// The whole path of a pixel of 2 events or more: its counts, the kept coefficients within the bound
/// and half a step, and the oracle's kept set but for magnitudes that differ by less than the bound.
///
/// # Errors
/// What is not so.
pub fn check_kept(config: Config, impulses: &[Impulse]) -> Result<(), TestCaseError> {
    let transform = config.transform.expect("one transform");
    let expected = expected(&config, impulses);
    let kept = prune::kept(oracle_of(transform), &expected, usize::from(config.m));
    let (header, found) = through_the_link(config, impulses);
    prop_assert_eq!(header.saturated, 0);
    let on = impulses.iter().filter(|impulse| impulse.p > 0.0).count();
    let counts = (found.on as usize, found.off as usize);
    prop_assert_eq!(counts, (on, impulses.len() - on));
    let step_log2 = config.quantiser.step_log2();
    let step = 2_f64.powi(i32::from(step_log2));
    // Pixels that are sent as times have no error of the kernel, but one of their cells.
    let is_timed = found.times.len() > 1;
    let slack = match transform {
        Transform::Dct | Transform::Dtft if is_timed => step / 2.0,
        _ => bound(transform, impulses.len()),
    };
    let half_step = match transform {
        // A lattice that steps up to 1 leave as it is.
        _ if is_timed => 0.0,
        Transform::Dwt if step_log2 <= 0 => 0.0,
        Transform::Dwt | Transform::Dct => step / 2.0,
        // re and im are quantised on their own.
        Transform::Dtft => step / 2.0 * 2_f64.sqrt(),
    };
    let tolerance = slack + half_step;
    // Of the f64 arithmetic.
    let rounding = 1e-9 + 1e-14 * impulses.len() as f64;
    let least_kept = kept
        .iter()
        .map(|k| expected[*k].norm())
        .fold(f64::INFINITY, f64::min);
    for (k, re, im) in &found.coefficients {
        let expected = expected[usize::from(*k)];
        let error = (re - expected.re).hypot(im - expected.im);
        prop_assert!(
            error <= tolerance + rounding,
            "k {}: {} > {}",
            k,
            error,
            tolerance
        );
        prop_assert!(
            kept.contains(&usize::from(*k))
                || expected.norm() >= least_kept - 2.0 * slack - rounding,
            "k {} is not among the largest",
            k
        );
    }
    for k in kept {
        let mut all = found.coefficients.iter();
        let is_found = all.any(|(found, ..)| usize::from(*found) == k);
        let may_be_cut = expected[k].norm() <= least_kept + 2.0 * slack + rounding;
        prop_assert!(
            is_found || may_be_cut || expected[k].norm() <= tolerance + rounding,
            "k {} is missing",
            k
        );
    }
    Ok(())
}
