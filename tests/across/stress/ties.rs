//! Exact ties of magnitudes: the lower k wins, in the core and in the oracle.

use std::cmp::Reverse;

use eecvs_nostd::fixed_point::{Coefficient, Sum, WideSum};
use eecvs_nostd::prune::Kept;
use eecvs_nostd::transform::haar_scale::scale_of;
use eecvs_nostd::transform::{Basis, Dtft};
use eecvs_nostd::{Quantiser, Shape, Transform};
use eecvs_oracle::transform::Impulse;
use eecvs_oracle::{dwt, prune};
use num_complex::Complex64;
use strategies::one_pixel::{config, expected, merged, through_the_link};

use super::{Random, effort};

const DURATION_US: u32 = 32_768;

/// The r largest of `keys` by a stable sort, ascending, and whether a tie was cut.
fn largest<T: Ord + Copy>(keys: &[T], r: usize) -> (Vec<usize>, bool) {
    let mut order: Vec<usize> = (0..keys.len()).collect();
    order.sort_by_key(|k| Reverse(keys[*k]));
    let is_cut = order
        .get(r)
        .is_some_and(|next| keys[*next] == keys[order[r - 1]]);
    order.truncate(r);
    order.sort_unstable();
    (order, is_cut)
}

/// The Haar coefficients' D^2 2^j are integers, so ties are exact, also across scales: few events, and
/// the same again a hundred times, on few places.
#[test]
fn haar_ties_go_to_the_lower_k() {
    let mut random = Random(11);
    let mut cut = 0;
    for case in 0..700 * effort() {
        let m = [8, 16, 64][case % 3];
        let places = 1 << (2 + random.below(6));
        let times = [1, 1, 100][case / 3 % 3];
        let mut events = Vec::new();
        for _ in 0..2 + random.below(60) {
            let offset_us = random.below(places) * (DURATION_US / places);
            let p = if random.below(3) == 0 { -1.0 } else { 1.0 };
            events.extend(vec![Impulse { offset_us, p }; times]);
        }
        let mut config = config(Transform::Dwt, m, DURATION_US);
        config.grid = [None, Some(1024)][case / 9 % 2];
        let grid = usize::from(Transform::Dwt.grid_size(m, config.grid));
        let differences = dwt::unscaled(&merged(&events), DURATION_US, grid);
        let keys: Vec<u64> = differences
            .iter()
            .enumerate()
            .map(|(k, d)| (d * d).unsigned_abs() << scale_of(k))
            .collect();
        let (order, is_cut) = largest(&keys, usize::from(m).min(grid));
        let nonzero = |k: &usize| keys[*k] > 0;
        let order: Vec<usize> = order.into_iter().filter(nonzero).collect();
        // A tie of zeros cuts nothing.
        cut += usize::from(is_cut && order.len() == usize::from(m));

        let oracle = prune::kept(
            eecvs_oracle::transform::Transform::Dwt,
            &expected(&config, &events),
            usize::from(m),
        );
        let oracle: Vec<usize> = oracle.into_iter().filter(nonzero).collect();
        assert_eq!(oracle, order, "the oracle, case {case}");
        let (_, pixel) = through_the_link(config, &events);
        let found: Vec<usize> = pixel
            .coefficients
            .iter()
            .map(|c| usize::from(c.0))
            .collect();
        assert_eq!(found, order, "the core, case {case}: {differences:?}");
    }
    // Not for nothing.
    assert!(cut > 100, "{cut} ties were cut");
}

/// All events at u = 0: every |c_k| is n (but for what all atoms have in common), in the core too.
#[test]
fn dtft_ties_at_the_start_go_to_the_lower_k() {
    for m in [8, 16, 64] {
        for (on, off) in [
            (2, 0),
            (3, 0),
            (0, 5),
            (40, 2),
            (64, 0),
            (65, 0),
            (2, 300),
            (700, 0),
        ] {
            let event = |p| Impulse { offset_us: 0, p };
            let events = [vec![event(1.0); on], vec![event(-1.0); off]].concat();
            for grid in [None, Some(u16::from(m) + 1), Some(1024)] {
                let mut config = config(Transform::Dtft, m, DURATION_US);
                config.grid = grid;
                let lowest: Vec<usize> = (0..usize::from(m)).collect();
                let oracle = prune::kept(
                    eecvs_oracle::transform::Transform::Dtft,
                    &expected(&config, &events),
                    usize::from(m),
                );
                assert_eq!(oracle, lowest);
                let (_, pixel) = through_the_link(config, &events);
                let found: Vec<usize> = pixel
                    .coefficients
                    .iter()
                    .map(|c| usize::from(c.0))
                    .collect();
                assert_eq!(found, lowest, "M {m} K {grid:?}: {on} and {off}");
            }
        }
    }
}

/// What the core's pruning keeps of these coefficients.
fn pruned<C: Coefficient>(values: &[(i32, i32)], events: u32, r: usize) -> Vec<usize> {
    let grid = values.len();
    let pairs = values.iter().flat_map(|(re, im)| [*re, *im]);
    let sums: Vec<C> = pairs.map(C::from_integer).collect();
    let shape = Shape {
        grid,
        r,
        quantiser: Quantiser::DEFAULT,
    };
    let mut kept = Kept::NONE;
    Dtft::prune(&sums, events, shape, &mut vec![0; grid], &mut kept);
    let mut found = Vec::new();
    kept.for_each(grid, |k| found.push(k));
    found
}

/// Complex integers of few magnitudes, 0, 5, 13, 25 and 25 again: in both widths of sums.
#[test]
fn dtft_ties_of_any_angle_go_to_the_lower_k() {
    let values = [
        (0, 0),
        (3, 4),
        (-4, 3),
        (5, 0),
        (0, -5),
        (5, -12),
        (-13, 0),
        (7, 24),
        (-15, 20),
        (0, 25),
        (25, 0),
    ];
    let mut random = Random(5);
    let mut cut = 0;
    for case in 0..3000 * effort() {
        let r = [8, 16, 64][case % 3];
        let grid = r + 1 + random.below(2 * r as u32) as usize;
        let classes = 1 + random.below(values.len() as u32);
        let pixel: Vec<(i32, i32)> = (0..grid)
            .map(|_| values[random.below(classes) as usize])
            .collect();
        let keys: Vec<i32> = pixel.iter().map(|(re, im)| re * re + im * im).collect();
        let (order, is_cut) = largest(&keys, r);
        cut += usize::from(is_cut);
        let complex = |(re, im): &(i32, i32)| Complex64::new(f64::from(*re), f64::from(*im));
        let oracle = prune::kept(
            eecvs_oracle::transform::Transform::Dtft,
            &pixel.iter().map(complex).collect::<Vec<_>>(),
            r,
        );
        assert_eq!(oracle, order, "the oracle: {pixel:?}");
        for events in [26, 31, 32, 63] {
            assert_eq!(
                pruned::<Sum>(&pixel, events, r),
                order,
                "{events}: {pixel:?}"
            );
        }
        for events in [26, 64, 65, 1000, 32_767] {
            assert_eq!(
                pruned::<WideSum>(&pixel, events, r),
                order,
                "{events}: {pixel:?}"
            );
        }
    }
    assert!(cut > 1000, "{cut} ties were cut");
}
