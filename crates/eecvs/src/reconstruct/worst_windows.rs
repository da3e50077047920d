//! The windows that cost most to solve: their work is counted, and stays below the limit.

use eecvs_nostd::{Event, Header, Quantiser, Transform};

use super::cost::PIXEL;
use super::events::{EventDecoder, Finder};
use super::{DecodedWindow, Pixel, test_header};
use crate::work_limit::WorkLimit;

/// Returns a number in -1..1 that depends on `seed` alone, and changes `seed`.
fn noise(seed: &mut u64) -> f64 {
    *seed = seed
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
}

fn header(transform: Transform, m: u8, grid: u16) -> Header {
    Header {
        transform,
        m,
        grid,
        quantiser: Quantiser::DEFAULT,
        ..test_header::header(32_768)
    }
}

/// Returns a pixel whose coefficients are noise, which no times explain, at evenly spaced k.
fn pixel(header: &Header, at: u32, events: u32, seed: &mut u64) -> Pixel {
    let kept = u16::from(header.m).min(header.grid);
    let apart = if header.transform == Transform::Dct {
        1
    } else {
        header.grid / kept
    };
    let height = f64::from(events).sqrt();
    let off = events / 3;
    let coefficients = (0..kept).map(|i| {
        let im = if header.transform.is_complex() {
            height * noise(seed)
        } else {
            0.0
        };
        (i * apart, height * noise(seed), im)
    });
    Pixel {
        x: (at % 2048) as u16,
        y: (at / 2048) as u16,
        on: events - off,
        off,
        coefficients: coefficients.collect(),
        times: vec![],
    }
}

fn window(header: Header, pixels: u32, events: u32) -> DecodedWindow {
    let mut seed = u64::from(events);
    let pixel = |at| pixel(&header, at, events, &mut seed);
    DecodedWindow {
        header,
        pixels: (0..pixels).map(pixel).collect(),
        events: Vec::new(),
    }
}

/// Shapes of windows: the most that a frame may state, the default, and a grid that is no power of two.
fn shapes() -> impl Iterator<Item = Header> {
    let of = |transform| {
        let grids: &[(u8, u16)] = match transform {
            Transform::Dct => &[(64, 1024), (16, 16)],
            Transform::Dtft => &[(64, 1024), (16, 32), (64, 1000)],
            Transform::Dwt => &[(64, 1024), (16, 32)],
        };
        grids
            .iter()
            .map(move |(m, grid)| header(transform, *m, *grid))
    };
    Transform::ALL.into_iter().flat_map(of)
}

const SIZES: [u32; 7] = [2, 16, 40, 60, 64, 65, 65_536];

fn solve(window: &DecodedWindow, finder: Finder, limit: WorkLimit) -> (Vec<Event>, u64, u64) {
    let mut window = window.clone();
    let mut decoder = EventDecoder::new(finder).with_work_limit(limit);
    let confidences = decoder.fill(&mut window);
    let over = confidences.pixels_over_work_limit;
    assert!(over <= confidences.pixels_approximate);
    (window.events, decoder.units(), over)
}

/// What a pixel is said to cost at most, it does not exceed, and it is no exaggeration: noise costs a good part of it.
#[test]
fn estimates_are_upper_bounds_of_what_is_counted() {
    for header in shapes() {
        for finder in Finder::ALL {
            for events in SIZES {
                let window = window(header, 1, events);
                let most = EventDecoder::new(finder).most(&window);
                // The peaks of so many events take seconds to minutes, which is what the limit is for.
                if finder == Finder::Peaks && events == 65_536 {
                    continue;
                }
                let (found, units, over) = solve(&window, finder, WorkLimit::NONE);
                assert_eq!((found.len() as u32, over), (events, 0));
                let name = format!("{:?} {} {finder:?} {events}", header.transform, header.grid);
                assert!(units >= PIXEL && units <= most, "{name}: {units} of {most}");
                assert!(60 * units >= most, "{name}: {units} of {most}");
            }
        }
    }
}

/// Windows of so many pixels that solving all of them would take minutes to hours; a limit of a hundredth of a second
/// keeps the test short.
#[test]
fn the_worst_windows_stay_below_the_limit() {
    let limit = WorkLimit::millions(20);
    for header in shapes() {
        for finder in Finder::ALL {
            for events in SIZES {
                let pixels = (20_000 / events).clamp(1, 1000);
                let window = window(header, pixels, events);
                let most = EventDecoder::new(finder).most(&window);
                let (found, units, over) = solve(&window, finder, limit);
                let name = format!("{:?} {} {finder:?} {events}", header.transform, header.grid);
                assert_eq!(found.len() as u32, pixels * events, "{name}");
                assert!(units <= limit.get(), "{name}: {units}");
                assert!(over == 0 || most > limit.get(), "{name}: {over}");
                // All pixels of a window cost the same at most.
                let is_solvable = most / u64::from(pixels) <= limit.get();
                assert!(over < u64::from(pixels) || !is_solvable, "{name}");
                let end_us = header.t0_us + u64::from(header.duration_us);
                assert!(
                    found
                        .iter()
                        .all(|event| (header.t0_us..end_us).contains(&event.t_us))
                );
                assert!(found.is_sorted_by_key(|event| event.t_us));
            }
        }
    }
}

/// Which pixels are solved does not depend on the number of threads.
#[test]
fn threads_change_nothing() {
    for (transform, finder) in [
        (Transform::Dct, Finder::Exact),
        (Transform::Dtft, Finder::Exact),
        (Transform::Dtft, Finder::Peaks),
        (Transform::Dwt, Finder::Exact),
    ] {
        let mut window = window(header(transform, 16, 32), 400, 9);
        let others = (0..).zip(&mut window.pixels).filter(|(at, _)| at % 3 > 0);
        for (at, other) in others {
            let mut seed = at;
            *other = pixel(&window.header, at as u32, 2 + at as u32 % 30, &mut seed);
        }
        let limit = WorkLimit::units(solve(&window, finder, WorkLimit::NONE).1 / 2);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads")
                .install(|| solve(&window, finder, limit))
        };
        let one = on(1);
        assert!(
            one.2 > 0 && one.2 < 400,
            "{transform:?} {finder:?}: {}",
            one.2
        );
        for threads in [2, 5] {
            assert!(on(threads) == one, "{transform:?} {finder:?} {threads}");
        }
    }
}

/// Without a limit, or below it, the times are those that were found before there was one.
#[test]
fn a_limit_that_is_not_reached_changes_nothing() {
    let window = window(header(Transform::Dtft, 16, 32), 40, 7);
    let all = solve(&window, Finder::Exact, WorkLimit::NONE);
    // The most that the pixels could cost is above the limit, what they cost is not.
    let limit = WorkLimit::units(all.1 + EventDecoder::new(Finder::Exact).most(&window) / 40);
    assert!(EventDecoder::new(Finder::Exact).most(&window) > limit.get());
    assert!(solve(&window, Finder::Exact, limit) == all);
}
