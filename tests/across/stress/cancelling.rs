//! Events that cancel, exactly and nearly.

use eecvs_bench::errors::bound;
use eecvs_bench::kernel::kernels;
use eecvs_bench::window::Window;
use eecvs_nostd::transform::GRID_MAX;
use eecvs_nostd::{Quantiser, Transform};
use eecvs_oracle::transform::Impulse;
use strategies::one_pixel::{check_kept, config, through_the_link};

/// `pairs` of opposite events, each at one time.
fn pairs(pairs: usize, offset_us: u32) -> Vec<Impulse> {
    let pair = [1.0, -1.0].map(|p| Impulse { offset_us, p });
    pair.repeat(pairs)
}

#[test]
fn events_at_one_time_leave_nothing() {
    for duration_us in [2, 32_768, 33_333, u32::MAX] {
        for offset_us in [0, duration_us / 3, duration_us / 2, duration_us - 1] {
            for count in [1, 32, 33, 500, 32_767] {
                let events = pairs(count, offset_us);
                for (transform, m) in Transform::ALL.into_iter().zip([8, 16, 64]) {
                    let case = format!("{offset_us} of {duration_us}, {count}, {transform:?}");
                    let config = config(transform, m, duration_us);
                    let (header, pixel) = through_the_link(config, &events);
                    assert_eq!(
                        (pixel.on, pixel.off),
                        (count as u32, count as u32),
                        "{case}"
                    );
                    assert_eq!(header.saturated, 0);
                    let ks: Vec<u16> = pixel.coefficients.iter().map(|c| c.0).collect();
                    if transform == Transform::Dwt {
                        assert!(ks.is_empty(), "{case}: {ks:?}");
                        continue;
                    }
                    // All tie, and the lowest are kept.
                    assert_eq!(ks, (0..u16::from(m)).collect::<Vec<_>>(), "{case}");
                    assert_eq!(pixel.coefficients[0], (0, 0.0, 0.0), "{case}");
                    // A level beside 0, and no more than a sum's last bits per event.
                    let half_step = 2_f64.powi(i32::from(Quantiser::DEFAULT.step_log2())) / 2.0;
                    let most = half_step + count as f64 * 2_f64.powi(-20);
                    for (k, re, im) in &pixel.coefficients[1..] {
                        assert!(
                            re.abs() <= most && im.abs() <= most,
                            "{case} k {k}: {re} {im}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn events_a_microsecond_apart_leave_what_they_should() {
    for duration_us in [2, 129, 32_768, 33_333, 3_600_000_000] {
        for offset_us in [0, duration_us / 4, duration_us / 2 - 1, duration_us - 2] {
            for count in [1, 40, 3000] {
                let mut events = pairs(count, offset_us);
                for event in events.iter_mut().skip(1).step_by(2) {
                    event.offset_us += 1;
                }
                for transform in Transform::ALL {
                    for step_log2 in [-15, 0] {
                        let mut config = config(transform, 16, duration_us);
                        config.quantiser = Quantiser::new(step_log2).expect("in range");
                        let result = check_kept(config, &events);
                        result.unwrap_or_else(|error| {
                            panic!("{offset_us} of {duration_us} {count} {transform:?}: {error}")
                        });
                    }
                }
            }
        }
    }
}

/// Of every kernel, K = 1,024: a chunk of pairs in any order.
#[test]
fn kernels_cancel() {
    for transform in Transform::ALL {
        for mut contender in kernels(transform, GRID_MAX) {
            let kernel = contender.kernel().expect("a kernel");
            for duration_us in [32_768, 999_983, u32::MAX] {
                for offset_us in [0, 1, duration_us / 3, duration_us - 1] {
                    let mut events = pairs(32, offset_us);
                    events.sort_by(|a, b| a.p.total_cmp(&b.p));
                    let window = Window::new(duration_us, [pairs(32, offset_us), events]);
                    for pixel in window.pixels() {
                        let c = contender.coefficients(pixel).expect("a kernel has them");
                        let most = c[1..].iter().map(|c| c.norm()).fold(0.0, f64::max);
                        assert!(
                            most <= 64.0 * bound(kernel),
                            "{kernel:?} {transform:?}: {most:e}"
                        );
                    }
                }
            }
        }
    }
}
