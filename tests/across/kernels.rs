//! Every kernel of the accumulate stage against the f64 oracle, within its documented error.

use eecvs_bench::kernel::Number;
use eecvs_nostd::Transform;
use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Sum};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::kernel::{Accumulate, Haar, Kernel, Libm, Micromath, Precise, Recurrence, Table};
use eecvs_nostd::transform::haar_scale::scale_of;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft, Dwt, GRID_MAX};
use eecvs_oracle::{dwt, transform as oracle};
use num_complex::Complex64;
use proptest::prelude::*;

fn oracle_transform(transform: Transform) -> oracle::Transform {
    match transform {
        Transform::Dct => oracle::Transform::Dct,
        Transform::Dtft => oracle::Transform::Dtft,
        Transform::Dwt => oracle::Transform::Dwt,
    }
}

/// A kernel's sums of one chunk; c_0 and what lies beyond the grid keep what they had, -7.
fn accumulate<A: Accumulate<B>, B: Basis>(
    impulses: &[Impulse],
    duration_us: u32,
    grid: usize,
) -> Vec<A::Sum>
where
    A::Sum: Number,
{
    let mut sums = vec![A::Sum::default(); 2 * grid];
    A::accumulate(
        impulses.iter().copied(),
        PhaseScale::new(duration_us),
        grid,
        &mut A::Work::default(),
        &mut sums,
    );
    sums
}

/// Largest |c_k - c_ref| for k >= 1.
fn error<A: Accumulate<B>, B: Basis>(impulses: &[Impulse], duration_us: u32, grid: usize) -> f64
where
    A::Sum: Number,
{
    let sums = accumulate::<A, B>(impulses, duration_us, grid);
    let events: Vec<_> = impulses
        .iter()
        .map(|impulse| oracle::Impulse {
            offset_us: impulse.offset_us,
            p: if impulse.is_on { 1.0 } else { -1.0 },
        })
        .collect();
    let expected = oracle_transform(B::TRANSFORM).coefficients(&events, duration_us, grid);
    let mut worst = 0.0_f64;
    for k in 1..grid {
        let found = match B::TRANSFORM {
            Transform::Dct => Complex64::from(sums[k].to_f64()),
            Transform::Dtft => Complex64::new(sums[2 * k].to_f64(), sums[2 * k + 1].to_f64()),
            Transform::Dwt => Complex64::from(sums[k].to_f64() * dwt::height(k)),
        };
        worst = worst.max((found - expected[k]).norm());
    }
    assert!(sums[0].to_f64() == 0.0, "c_0 is the caller's");
    worst
}

/// One impulse anywhere in windows of any length, K = 1,024: the error of one atom. The worst is
/// where an atom's step is close to whole and half turns.
fn check_atoms<A: Accumulate<B>, B: Basis>(documented: f64)
where
    A::Sum: Number,
{
    let mut worst = 0.0_f64;
    let durations = [1, 3, 1000, 32_768, 33_333, 999_983, 3_600_000_000, u32::MAX];
    for duration_us in durations {
        let last = duration_us - 1;
        let spread = (0..500_u64).map(|i| (i * u64::from(duration_us) / 500) as u32);
        let edges = (0..40).flat_map(|i| {
            let half = duration_us / 2;
            [i, last.saturating_sub(i), half.saturating_sub(i), half + i]
        });
        for offset_us in spread.chain(edges).filter(|offset| *offset <= last) {
            let impulse = Impulse {
                offset_us,
                is_on: offset_us % 3 > 0,
            };
            worst = worst.max(error::<A, B>(&[impulse], duration_us, GRID_MAX));
        }
    }
    let name = format!("{} {}", A::KERNEL.name(), B::TRANSFORM.name());
    println!("{name}: 2^{:.2}", worst.log2());
    match A::KERNEL.error_log2() {
        Some(bound) => assert!(worst <= f64::from(bound).exp2(), "{name}: {worst:e}"),
        None => assert!(worst == 0.0, "{name}: {worst:e}"),
    }
    // What the kernel's own doc says was measured.
    if documented != 0.0 {
        let measured = worst.log2();
        assert!((measured - documented).abs() < 0.1, "{name}: 2^{measured}");
    }
}

#[test]
fn table_is_within_its_error() {
    check_atoms::<Table, Dct>(-15.2);
    check_atoms::<Table, Dtft>(-14.9);
}

#[test]
fn recurrence_is_within_its_error() {
    check_atoms::<Recurrence, Dct>(-17.4);
    check_atoms::<Recurrence, Dtft>(-16.9);
}

#[test]
fn precise_is_within_2_to_the_minus_26() {
    check_atoms::<Precise, Dct>(-27.2);
    check_atoms::<Precise, Dtft>(-27.1);
}

#[test]
fn micromath_is_within_its_error() {
    check_atoms::<Micromath, Dct>(-9.8);
    check_atoms::<Micromath, Dtft>(-9.8);
}

#[test]
fn libm_is_within_its_error() {
    check_atoms::<Libm, Dct>(-16.2);
    check_atoms::<Libm, Dtft>(-16.0);
}

#[test]
fn haar_is_exact() {
    check_atoms::<Haar, Dwt>(0.0);
}

/// A pixel in a window of any length.
fn pixel() -> impl Strategy<Value = (u32, Vec<Impulse>)> {
    let duration = prop_oneof![Just(1_u32), Just(32_768), Just(u32::MAX), 1..=u32::MAX];
    duration.prop_flat_map(|duration_us| {
        let impulse = (0..duration_us, any::<bool>())
            .prop_map(|(offset_us, is_on)| Impulse { offset_us, is_on });
        let impulses = proptest::collection::vec(impulse, 1..=CHUNK_EVENTS);
        (Just(duration_us), impulses)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn n_events_add_n_errors(
        (duration_us, impulses) in pixel(),
        grid in prop_oneof![1..=128_usize, Just(GRID_MAX)],
    ) {
        fn check<A: Accumulate<B>, B: Basis>(
            impulses: &[Impulse], duration_us: u32, grid: usize,
        ) -> Result<(), TestCaseError> where A::Sum: Number {
            let error = error::<A, B>(impulses, duration_us, grid);
            let per_event = A::KERNEL.error_log2().map_or(0.0, |log2| f64::from(log2).exp2());
            let bound = impulses.len() as f64 * per_event;
            prop_assert!(error <= bound, "{:?} {:?}: {} > {}", A::KERNEL, B::TRANSFORM, error, bound);
            Ok(())
        }
        check::<Table, Dct>(&impulses, duration_us, grid)?;
        check::<Table, Dtft>(&impulses, duration_us, grid)?;
        check::<Recurrence, Dct>(&impulses, duration_us, grid)?;
        check::<Recurrence, Dtft>(&impulses, duration_us, grid)?;
        check::<Precise, Dct>(&impulses, duration_us, grid)?;
        check::<Precise, Dtft>(&impulses, duration_us, grid)?;
        check::<Micromath, Dct>(&impulses, duration_us, grid)?;
        check::<Micromath, Dtft>(&impulses, duration_us, grid)?;
        check::<Libm, Dct>(&impulses, duration_us, grid)?;
        check::<Libm, Dtft>(&impulses, duration_us, grid)?;
        check::<Haar, Dwt>(&impulses, duration_us, grid.next_power_of_two())?;
    }

    /// The kernel that is named as the encoder's gives the encoder's bits.
    #[test]
    fn the_kernel_in_use_is_the_encoders(
        (duration_us, impulses) in pixel(),
        grid in 1..=130_usize,
    ) {
        fn encoders<B: Basis>(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<Sum> {
            let mut sums = vec![Sum::ZERO; 2 * grid];
            let scale = PhaseScale::new(duration_us);
            B::accumulate(impulses.iter().copied(), scale, grid, &mut sums);
            sums
        }
        prop_assert_eq!(Kernel::in_use(Transform::Dct), Kernel::Table);
        let dct = accumulate::<Table, Dct>(&impulses, duration_us, grid);
        prop_assert_eq!(dct, encoders::<Dct>(&impulses, duration_us, grid));
        prop_assert_eq!(Kernel::in_use(Transform::Dtft), Kernel::Table);
        let dtft = accumulate::<Table, Dtft>(&impulses, duration_us, grid);
        prop_assert_eq!(dtft, encoders::<Dtft>(&impulses, duration_us, grid));
        let power = grid.next_power_of_two();
        prop_assert_eq!(Kernel::in_use(Transform::Dwt), Kernel::Haar);
        let haar = accumulate::<Haar, Dwt>(&impulses, duration_us, power);
        prop_assert_eq!(haar, encoders::<Dwt>(&impulses, duration_us, power));
    }
}

/// A grid of no or one coefficient beyond c_0, more impulses than a chunk, no impulse.
#[test]
fn edges_do_no_harm() {
    let impulses = [Impulse {
        offset_us: 5,
        is_on: true,
    }; CHUNK_EVENTS + 1];
    fn check<A: Accumulate<B>, B: Basis>(impulses: &[Impulse])
    where
        A::Sum: Number,
    {
        for grid in [1, 2] {
            assert!(
                accumulate::<A, B>(&[], 9, grid)
                    .iter()
                    .all(|sum| sum.to_f64() == 0.0)
            );
            let chunk = accumulate::<A, B>(&impulses[..CHUNK_EVENTS], 9, grid);
            let more = accumulate::<A, B>(impulses, 9, grid);
            for (sum, more) in chunk.iter().zip(&more) {
                assert!(sum.to_f64() == more.to_f64(), "{:?}", A::KERNEL);
            }
        }
        let mut none: [A::Sum; 0] = [];
        let scale = PhaseScale::new(9);
        A::accumulate(
            impulses.iter().copied(),
            scale,
            4,
            &mut A::Work::default(),
            &mut none,
        );
    }
    check::<Table, Dct>(&impulses);
    check::<Table, Dtft>(&impulses);
    check::<Recurrence, Dct>(&impulses);
    check::<Recurrence, Dtft>(&impulses);
    check::<Precise, Dct>(&impulses);
    check::<Precise, Dtft>(&impulses);
    check::<Micromath, Dct>(&impulses);
    check::<Micromath, Dtft>(&impulses);
    check::<Libm, Dct>(&impulses);
    check::<Libm, Dtft>(&impulses);
    check::<Haar, Dwt>(&impulses);
}

#[test]
fn the_haar_scale_is_the_oracles() {
    for k in 0..GRID_MAX {
        let scale = f64::from(1_u32 << scale_of(k)).sqrt();
        assert!(scale == dwt::height(k), "{k}");
    }
}
