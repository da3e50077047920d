//! Every place where the core saturates or cuts: which of them happen, and that they are counted.
//!
//! | where | can it happen |
//! |---|---|
//! | a level of more than 32 bits (`WideSum::level`) | from 2^31 steps on; counted in `saturated` |
//! | a level of a pixel of up to 64 events (`Sum::level`) | no: 32 bits, shifted down by 8 or more |
//! | a sum of a chunk | no: 64 atoms, none above 1, in a range of 256 |
//! | a level wider than its field (`put_levels`) | no: |c_k| < n, see `quantiser_edges` |
//! | a sum of a window, its squares and magnitudes | no: fewer than 2^24 events |
//! | `late`, `filtered`, `dropped` | at 2^32 - 1, and there they stay |
//! | the end of a window beyond 2^64 us | no: what closes it is an event after it |
//! | the duration of a window that was full | no: an offset is below T |

use eecvs::encode::HostStorage;
use eecvs::reconstruct::pixels;
use eecvs_bench::errors::bound;
use eecvs_bench::kernel::kernels;
use eecvs_bench::window::Window;
use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Coefficient, Sum, WideSum};
use eecvs_nostd::transform::GRID_MAX;
use eecvs_nostd::{Event, OUTPUT_BYTES_MIN, Polarity, Push, Quantiser, Sensor, Transform};
use eecvs_oracle::transform::Impulse;
use strategies::{encode, parse, plain_config};

const SENSOR: Sensor = Sensor {
    width: 1,
    height: 1,
};

fn at(t_us: u64, on: bool) -> Event {
    Event {
        t_us,
        x: 0,
        y: 0,
        polarity: Polarity::from_bool(on),
    }
}

/// Levels beyond 32 bits are cut to the nearest, and told; 2^31 steps of events are not beyond, since
/// |c_k| < n.
#[test]
fn levels_beyond_32_bits_are_cut_and_counted() {
    // All at u = 0, where every cosine is 1 (less 2^-14 at the most) and every sine 0.
    for (transform, m, step_log2, count, saturated) in [
        (Transform::Dct, 4, -15, 65_536, 0),
        (Transform::Dtft, 4, -15, 65_536, 0),
        (Transform::Dct, 4, -15, 65_600, 3),
        (Transform::Dct, 8, -15, 65_600, 7),
        (Transform::Dct, 64, -15, 65_600, 63),
        (Transform::Dtft, 4, -15, 65_600, 3),
        (Transform::Dct, 4, -14, 65_600, 0),
        (Transform::Dct, 8, -14, 131_072, 0),
        (Transform::Dct, 4, -14, 131_200, 3),
        (Transform::Dwt, 4, -15, 131_200, 0),
    ] {
        for on in [true, false] {
            let case = format!("{transform:?} M {m} {step_log2} {count} {on}");
            let mut config = plain_config(SENSOR, transform, m);
            config.grid = Some(u16::from(m));
            config.quantiser = Quantiser::new(step_log2).expect("in range");
            let frames = encode(config, &vec![at(0, on); count], count, 4096);
            let frame = parse(&frames[0]);
            assert_eq!(frame.header.saturated, saturated, "{case}");
            let pixel = pixels(&frame).expect("the encoder's own payload")[0].clone();
            assert_eq!(pixel.on + pixel.off, count as u32, "{case}");
            let limit = 2_f64.powi(31 + i32::from(step_log2));
            let exact = if saturated > 0 { limit } else { count as f64 };
            let exact = if on { exact } else { -exact };
            // A cut level is the very last.
            let most = if saturated > 0 {
                1.0
            } else {
                count as f64 / 16_384.0
            };
            let c_1 = pixel.coefficients[1].1;
            assert!((c_1 - exact).abs() <= most, "{case}: {c_1}");
        }
    }
}

/// The types' own bounds: where no level of a chunk's sum is ever cut, and the most that the wide
/// sum's are.
#[test]
fn chunks_never_saturate() {
    const { assert!(!Sum::CAN_SATURATE && WideSum::CAN_SATURATE) };
    for shift in 8..=31 {
        for sum in [Sum::MAX, Sum::MIN] {
            assert!(!sum.is_cut(shift));
            assert_eq!(sum.level(shift), sum.wide().level(shift));
        }
    }
    // The kernels, with as many equal events as a chunk has: an overflow would change the sign.
    for transform in Transform::ALL {
        for mut contender in kernels(transform, GRID_MAX) {
            let kernel = contender.kernel().expect("a kernel");
            for (duration_us, offset_us) in [(1, 0), (2, 1), (32_768, 0), (u32::MAX, u32::MAX - 1)]
            {
                for p in [1.0, -1.0] {
                    let window = Window::new(
                        duration_us,
                        [
                            vec![Impulse { offset_us, p }; CHUNK_EVENTS],
                            vec![Impulse { offset_us, p }],
                        ],
                    );
                    let mut pixels = window.pixels();
                    let mut next = || {
                        let pixel = pixels.next().expect("two pixels");
                        contender.coefficients(pixel).expect("a kernel has them")
                    };
                    let (all, one) = (next(), next());
                    let n = CHUNK_EVENTS as f64;
                    for (k, (all, one)) in all.iter().zip(&one).enumerate() {
                        let error = (all - one * n).norm();
                        assert!(
                            error <= 2.0 * n * bound(kernel),
                            "{kernel:?} k {k}: {all} {one}"
                        );
                    }
                }
            }
        }
    }
}

/// Counts of lost events stay at the largest that there is, and are told.
#[test]
fn counts_stay_at_their_largest() {
    let mut storage = HostStorage::new(SENSOR, 4);
    let config = plain_config(SENSOR, Transform::Dct, 8);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut out = vec![0; OUTPUT_BYTES_MIN];
    let mut next = |dropped: &[u32], filtered: &[u32], t_us| {
        for count in dropped {
            encoder.window().count_dropped(*count);
        }
        for count in filtered {
            encoder.window().count_filtered(*count);
        }
        assert_eq!(encoder.push(at(t_us, true)), Push::Stored);
        encoder.flush();
        let encoded = encoder
            .next_frame(&mut out)
            .expect("room")
            .expect("a frame");
        let header = parse(&out[encoded.range]).header;
        assert_eq!(encoder.next_frame(&mut out), Ok(None));
        (header.dropped, header.filtered)
    };
    assert_eq!(
        next(&[u32::MAX, 5], &[u32::MAX - 1], 10),
        (u32::MAX, u32::MAX - 1)
    );
    assert_eq!(next(&[7], &[u32::MAX - 1, 1, 1], 20), (7, u32::MAX));
    assert_eq!(next(&[], &[], 30), (0, 0));
}

/// The longest window that closes early, and windows that end with the last microsecond.
#[test]
fn times_never_saturate() {
    let start_us = |window_us, slots, times: &[u64]| {
        let mut storage = HostStorage::new(SENSOR, slots);
        let mut config = plain_config(SENSOR, Transform::Dct, 8);
        config.window.window_us = window_us;
        let mut encoder = storage.encoder(config).expect("a valid configuration");
        let (last, stored) = times.split_last().expect("some times");
        for t_us in stored {
            assert_eq!(encoder.push(at(*t_us, true)), Push::Stored);
        }
        assert_eq!(encoder.push(at(*last, true)), Push::Closed);
        let window = encoder.window();
        (
            window.closed().expect("closed").duration_us,
            window.next_start().us,
        )
    };
    // Full, with an event in the last microsecond: T is all that 32 bits hold, and u < 1.
    let last = u64::from(u32::MAX) - 1;
    assert_eq!(
        start_us(u32::MAX, 2, &[0, last, last]),
        (u32::MAX, Some(last))
    );
    let late = u64::MAX - last;
    assert_eq!(
        start_us(u32::MAX, 2, &[late, u64::MAX, u64::MAX]),
        (u32::MAX, Some(u64::MAX))
    );
    // The next window begins at the last microsecond there is.
    assert_eq!(
        start_us(5, 9, &[u64::MAX - 5, u64::MAX - 1, u64::MAX]),
        (5, Some(u64::MAX))
    );
    assert_eq!(
        start_us(1, 9, &[u64::MAX - 1, u64::MAX]),
        (1, Some(u64::MAX))
    );
}
