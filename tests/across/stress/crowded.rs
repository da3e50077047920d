//! 65,535 events in one pixel.

use eecvs_nostd::{Quantiser, Transform};
use eecvs_oracle::transform::Impulse;
use strategies::one_pixel::{check_kept, config};

const EVENTS: u32 = 65_535;

#[derive(Debug, Clone, Copy)]
enum Polarities {
    On,
    Off,
    Alternating,
}

/// Events on 997 times all over the window, its ends among them.
fn events(duration_us: u32, polarities: Polarities) -> Vec<Impulse> {
    let at = |i: u32| {
        let time = u64::from(i % 997);
        (time * u64::from(duration_us - 1) / 996) as u32
    };
    let p = |i: u32| match polarities {
        Polarities::On => 1.0,
        Polarities::Off => -1.0,
        Polarities::Alternating if i.is_multiple_of(2) => 1.0,
        Polarities::Alternating => -1.0,
    };
    let event = |i| Impulse {
        offset_us: at(i),
        p: p(i),
    };
    (0..EVENTS).map(event).collect()
}

#[test]
fn counts_are_exact_and_coefficients_within_the_bound() {
    for polarities in [Polarities::On, Polarities::Off, Polarities::Alternating] {
        for duration_us in [1, 32_768, 33_333, u32::MAX] {
            let events = events(duration_us, polarities);
            for transform in Transform::ALL {
                for (m, step_log2) in [(64, -15), (8, -15), (8, -6), (16, 3)] {
                    let mut config = config(transform, m, duration_us);
                    config.quantiser = Quantiser::new(step_log2).expect("in range");
                    let result = check_kept(config, &events);
                    result.unwrap_or_else(|error| {
                        panic!("{polarities:?} T {duration_us} {transform:?} M {m}: {error}")
                    });
                }
            }
        }
    }
}

/// All at one time, where every error is added 65,535 times.
#[test]
fn events_at_one_time_add_up_to_the_bound_at_most() {
    for duration_us in [32_768, 999_983] {
        for offset_us in [0, 1, duration_us / 3, duration_us / 2, duration_us - 1] {
            let events = vec![Impulse { offset_us, p: 1.0 }; EVENTS as usize];
            for transform in Transform::ALL {
                for m in [8, 64] {
                    let mut config = config(transform, m, duration_us);
                    config.quantiser = Quantiser::new(-15).expect("in range");
                    let result = check_kept(config, &events);
                    result.unwrap_or_else(|error| {
                        panic!("{offset_us} of {duration_us} {transform:?} M {m}: {error}")
                    });
                }
            }
        }
    }
}
