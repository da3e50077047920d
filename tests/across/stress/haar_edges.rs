//! The Haar transform at every discontinuity of every atom, one microsecond before and after.

use eecvs_bench::kernel::Number;
use eecvs_nostd::fixed_point::CHUNK_EVENTS;
use eecvs_nostd::group::Impulse;
use eecvs_nostd::kernel::{Accumulate, Haar};
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Dwt, GRID_MAX};
use eecvs_oracle::dwt;

use super::any_window::DURATIONS_US;

/// Offsets next to every m / K of the window: the last before, the first at or after, the next.
fn edges(duration_us: u32, grid: u64) -> Vec<u32> {
    let duration = u64::from(duration_us);
    let mut offsets: Vec<u32> = (0..=grid)
        .flat_map(|m| {
            let first = (m * duration).div_ceil(grid);
            [first.saturating_sub(1), first, first + 1]
        })
        .filter(|offset| *offset < duration)
        .map(|offset| offset as u32)
        .collect();
    offsets.dedup();
    offsets
}

/// D_k by the definition, for the one atom of every scale that is not 0 at `offset_us`.
fn add_expected(expected: &mut [i64], offset_us: u32, duration_us: u32, sign: i64) {
    let grid = expected.len();
    let part = |parts: u128| (u128::from(offset_us) * parts / u128::from(duration_us)) as usize;
    let mut width = 1;
    while width < grid {
        let k = width + part(width as u128);
        let is_second_half = part(2 * width as u128) % 2 == 1;
        let value = if is_second_half { -1 } else { 1 };
        assert_eq!(value, dwt::sign(k, offset_us, duration_us), "the oracle");
        expected[k] += sign * value;
        width *= 2;
    }
}

fn differences(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<f64> {
    let mut sums = vec![<Haar as Accumulate<Dwt>>::Sum::default(); 2 * grid];
    let scale = PhaseScale::new(duration_us);
    Haar::accumulate(impulses.iter().copied(), scale, grid, &mut (), &mut sums);
    sums[1..grid].iter().map(|sum| sum.to_f64()).collect()
}

#[test]
fn every_discontinuity_is_where_it_belongs() {
    for duration_us in DURATIONS_US {
        for scales in 0..=GRID_MAX.ilog2() {
            let grid = 1_usize << scales;
            let offsets = edges(duration_us, grid as u64);
            assert!(offsets.contains(&0) && offsets.contains(&(duration_us - 1)));
            let compare = |offsets: &[u32]| {
                let mut expected = vec![0; grid];
                let impulses: Vec<Impulse> = offsets
                    .iter()
                    .map(|offset_us| {
                        let is_on = offset_us % 5 != 1;
                        add_expected(
                            &mut expected,
                            *offset_us,
                            duration_us,
                            if is_on { 1 } else { -1 },
                        );
                        Impulse {
                            offset_us: *offset_us,
                            is_on,
                        }
                    })
                    .collect();
                let found = differences(&impulses, duration_us, grid);
                let expected = expected[1..].iter().map(|d| *d as f64);
                assert!(
                    found.iter().copied().eq(expected),
                    "T {duration_us} K {grid} {offsets:?}"
                );
            };
            // One by one, and as many as one goes through the butterflies with.
            offsets.chunks(1).for_each(compare);
            offsets.chunks(CHUNK_EVENTS).for_each(compare);
        }
    }
}
