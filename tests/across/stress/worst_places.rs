//! Every kernel where its error is the largest that can be found.

use eecvs_bench::errors::{Effort, bound, check, measure, offsets};
use eecvs_bench::kernel::kernels;
use eecvs_bench::window::Window;
use eecvs_bench::{Contender, oracle_of};
use eecvs_nostd::Transform;
use eecvs_nostd::transform::GRID_MAX;
use eecvs_oracle::transform::Impulse;

use super::any_window::DURATIONS_US;
use super::{Random, effort};

/// The curves of `eecvs bench --errors`, with fewer random places: every kernel and transform, each k
/// up to 1,023, 1 to 65,535 events in a pixel, windows from 1 us on.
#[test]
fn no_curve_leaves_its_bound() {
    let effort = Effort {
        random: 20 * effort(),
        denominators: 6,
        events: 65_535,
    };
    let rows = measure(effort, &mut || ());
    check(&rows).expect("within the documented bounds");
    // The largest errors are not far from the bounds, else something else was measured.
    for row in rows
        .iter()
        .filter(|row| row.axis == "k" && row.value == 1023)
    {
        let most = row.max_error_per_event;
        assert!(most >= row.bound / 8.0, "{row:?}");
    }
}

/// Error of one event at (T, offset): the largest over k = 1 to 1,023, and its k.
fn error(contender: &mut dyn Contender, transform: Transform, place: (u32, u32)) -> (f64, usize) {
    let (duration_us, offset_us) = place;
    let impulse = Impulse { offset_us, p: 1.0 };
    let expected = oracle_of(transform).coefficients(&[impulse], duration_us, GRID_MAX);
    let window = Window::new(duration_us, [vec![impulse]]);
    let pixel = window.pixels().next().expect("one pixel");
    let found = contender.coefficients(pixel).expect("a kernel has them");
    let errors = found
        .iter()
        .zip(&expected)
        .map(|(found, exact)| (found - exact).norm());
    let errors = errors.enumerate().skip(1);
    errors.fold((0.0, 0), |most, (k, error)| {
        // What is no number counts as the largest.
        if error <= most.0 { most } else { (error, k) }
    })
}

/// From the worst of some places, small and large steps in u and in T as long as the error grows.
fn climb(contender: &mut dyn Contender, transform: Transform, random: &mut Random) -> Found {
    let duration_us = match random.below(3) {
        0 => DURATIONS_US[random.below(DURATIONS_US.len() as u32) as usize],
        1 => u32::MAX - random.below(1 << 20),
        _ => (u32::MAX >> random.below(28)) - random.below(8),
    };
    let mut places = offsets(duration_us, 5, 0);
    places.extend((0..8).map(|_| random.below(duration_us)));
    let place = places[random.below(places.len() as u32) as usize];
    let mut best = Found::new(contender, transform, (duration_us, place));
    for _ in 0..24 {
        let (duration_us, offset_us) = best.place;
        let step = 1_i64 << random.below(32 - duration_us.leading_zeros());
        let sign = if random.below(2) == 0 { 1 } else { -1 };
        let (mut duration_us, mut offset_us) = (i64::from(duration_us), i64::from(offset_us));
        if random.below(4) == 0 {
            duration_us += sign * step;
        } else {
            offset_us += sign * step;
        }
        let (Ok(duration_us), Ok(offset_us)) =
            (u32::try_from(duration_us), u32::try_from(offset_us))
        else {
            continue;
        };
        if offset_us < duration_us {
            let found = Found::new(contender, transform, (duration_us, offset_us));
            if found.error > best.error {
                best = found;
            }
        }
    }
    best
}

#[derive(Debug, Clone, Copy)]
struct Found {
    error: f64,
    k: usize,
    place: (u32, u32),
}

impl Found {
    fn new(contender: &mut dyn Contender, transform: Transform, place: (u32, u32)) -> Self {
        let (error, k) = error(contender, transform, place);
        Self { error, k, place }
    }
}

/// What recurrences and phases lose grows with k, and most next to whole and half turns: searched,
/// not only sampled.
#[test]
fn no_place_is_worse_than_documented() {
    for transform in Transform::ALL {
        for mut contender in kernels(transform, GRID_MAX) {
            let kernel = contender.kernel().expect("a kernel");
            let mut random = Random(7);
            let mut worst = Found {
                error: 0.0,
                k: 0,
                place: (1, 0),
            };
            for _ in 0..60 * effort() {
                let found = climb(contender.as_mut(), transform, &mut random);
                if found.error > worst.error {
                    worst = found;
                }
            }
            let name = format!("{} {}", kernel.name(), transform.name());
            let Found { error, k, place } = worst;
            println!(
                "{name}: 2^{:.2} at k = {k}, T and t = {place:?}",
                error.log2()
            );
            assert!(
                error <= bound(kernel),
                "{name}: {error:e} at k = {k}, {place:?}"
            );
        }
    }
}

/// At u = 0 every atom is 1 (and its sine 0), and no k is worse than another; at u = 1/2 it is so
/// for every second one. What a recurrence loses at each step would show.
#[test]
fn errors_do_not_grow_along_k_where_atoms_repeat() {
    for (transform, place, period) in [
        (Transform::Dct, (u32::MAX, 0), 1),
        (Transform::Dtft, (u32::MAX, 0), 1),
        (Transform::Dct, (1 << 31, 1 << 30), 4),
        (Transform::Dtft, (1 << 31, 1 << 30), 2),
    ] {
        for mut contender in kernels(transform, GRID_MAX) {
            let kernel = contender.kernel().expect("a kernel");
            let (duration_us, offset_us) = place;
            let impulse = Impulse { offset_us, p: 1.0 };
            let window = Window::new(duration_us, [vec![impulse]]);
            let pixel = window.pixels().next().expect("one pixel");
            let c = contender.coefficients(pixel).expect("a kernel has them");
            for k in period + 1..GRID_MAX {
                let first = 1 + (k - 1) % period;
                let drift = (c[k] - c[first]).norm();
                // Twice the bound holds for any two within it; a repeated atom is far closer.
                let most = bound(kernel) * if offset_us == 0 { 0.0 } else { 0.75 };
                assert!(drift <= most, "{kernel:?} {transform:?} k {k}: {drift:e}");
            }
        }
    }
}
