//! A pixel as the encoder would send it, for tests.

use eecvs_nostd::fixed_point::Sum;
use eecvs_nostd::group::Impulse;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft};
use eecvs_nostd::{Header, Level, Quantiser, Transform};

use super::{Pixel, test_header};

/// Returns the header of a window of `duration_us`, with K = M = `m`.
pub fn header(transform: Transform, m: u8, step_log2: i8, duration_us: u32) -> Header {
    Header {
        transform,
        m,
        grid: u16::from(m),
        quantiser: Quantiser::new(step_log2).expect("in range"),
        ..test_header::header(duration_us)
    }
}

/// Returns the levels of k from 1 on, for up to 63 events given as (offset in microseconds, whether ON).
pub fn levels(header: &Header, events: &[(u32, bool)]) -> Vec<Level> {
    let grid = usize::from(header.grid);
    let mut sums = vec![Sum::ZERO; 2 * grid];
    let scale = PhaseScale::new(header.duration_us);
    let impulses = events.iter().map(|(offset_us, is_on)| Impulse {
        offset_us: *offset_us,
        is_on: *is_on,
    });
    let level = |sum: Sum| header.quantiser.uniform(sum);
    match header.transform {
        Transform::Dct => Dct::accumulate(impulses, scale, grid, &mut sums),
        _ => Dtft::accumulate(impulses, scale, grid, &mut sums),
    }
    (1..grid)
        .map(|k| match header.transform {
            Transform::Dct => (k, level(sums[k]), 0),
            _ => (k, level(sums[2 * k]), level(sums[2 * k + 1])),
        })
        .map(|(k, re, im)| Level {
            k: k as u16,
            re,
            im,
        })
        .collect()
}

/// Returns the pixel that a decoder receives for these events.
pub fn pixel(header: &Header, events: &[(u32, bool)]) -> Pixel {
    let on = events.iter().filter(|(_, is_on)| *is_on).count() as u32;
    let off = events.len() as u32 - on;
    let zeroth = (0, f64::from(on) - f64::from(off), 0.0);
    let rest = levels(header, events).into_iter().map(|level| {
        let (re, im) = header.quantiser.dequantise(header.transform, level);
        (level.k, re, im)
    });
    Pixel {
        x: 0,
        y: 0,
        on,
        off,
        coefficients: std::iter::once(zeroth).chain(rest).collect(),
        times: vec![],
    }
}
