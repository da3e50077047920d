//! Pixels of few events that are sent as times: what a decoder makes of them.

use eecvs::reconstruct::coefficients::CoefficientDecoder;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::volume::inverse::Inverse;
use eecvs::reconstruct::{DecodedWindow, Pixel};
use eecvs::work_limit::WorkLimit;
use eecvs_nostd::pack::timed::TIMED_EVENTS_MAX;
use eecvs_nostd::{Coder, Config, Event, Mode, Polarity, Quantiser, Sensor, Transform};
use proptest::prelude::*;
use strategies::{encode, parse, plain_config, transform};

const SENSOR: Sensor = Sensor {
    width: 40,
    height: 3,
};

/// Pixels, each with its events' times and polarities, in a window of this many microseconds.
fn pixels() -> impl Strategy<Value = (u32, Vec<Vec<(u32, bool)>>)> {
    let duration = prop_oneof![Just(32_768_u32), 2..60_u32, 1000..100_000_u32];
    duration.prop_flat_map(|duration_us| {
        let event = (0..duration_us, any::<bool>());
        let alone = proptest::collection::vec(event.clone(), 1..8);
        let burst = (
            0..duration_us,
            proptest::collection::vec((0..9_u32, any::<bool>()), 2..70),
        )
            .prop_map(move |(from_us, steps)| {
                let mut at_us = from_us;
                let next = |(step_us, is_on): (u32, bool)| {
                    at_us = (at_us + step_us).min(duration_us - 1);
                    (at_us, is_on)
                };
                steps.into_iter().map(next).collect::<Vec<_>>()
            });
        let pixel = prop_oneof![3 => alone, 1 => burst];
        (Just(duration_us), proptest::collection::vec(pixel, 1..60))
    })
}

fn events(pixels: &[Vec<(u32, bool)>]) -> Vec<Event> {
    let mut events = vec![Event {
        t_us: 5000,
        x: 39,
        y: 2,
        polarity: Polarity::On,
    }];
    for (at, pixel) in (0_u16..).zip(pixels) {
        events.extend(pixel.iter().map(|(offset_us, is_on)| Event {
            t_us: 5000 + u64::from(*offset_us),
            x: at % 40,
            y: at / 40,
            polarity: Polarity::from_bool(*is_on),
        }));
    }
    events.sort_by_key(|event| event.t_us);
    events
}

/// The whole window, as a host decodes it.
fn decoded(config: Config, events: &[Event]) -> (DecodedWindow, usize) {
    let frames = encode(config, events, events.len(), 1 << 20);
    let [bytes] = &frames[..] else {
        panic!("{} frames", frames.len());
    };
    let frame = parse(bytes);
    let pixels = match frame.header.mode {
        Mode::Coefficients(coder) => CoefficientDecoder::default()
            .frame(&frame, coder)
            .expect("the encoder's own"),
        _ => frame
            .descriptors()
            .map(|descriptor| Pixel::dequantise(&frame.header, &descriptor.expect("plain")))
            .collect(),
    };
    let window = DecodedWindow {
        header: frame.header,
        pixels,
        events: vec![],
    };
    (window, bytes.len())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// All three coders carry the same pixels where their n0 is the same; each event of a pixel that is sent as times
    /// comes back within its cell, with its polarity, and cells of a microsecond bring the microsecond back.
    #[test]
    fn events_come_back_within_their_cells(
        (duration_us, sent) in pixels(),
        transform in transform(),
        m in 1..=64_u8,
        step_log2 in -15..=8_i8,
        coder in prop_oneof![Just(None), Just(Some(Coder::Fast)), Just(Some(Coder::Dense))],
    ) {
        let events = events(&sent);
        let mut config = Config {
            quantiser: Quantiser::new(step_log2).expect("-15 to 8"),
            few_as_times: true,
            ..plain_config(SENSOR, transform, m)
        };
        config.window.window_us = duration_us;
        let (mut window, _) = decoded(config, &events);
        if let Some(coder) = coder {
            let mode = Mode::Coefficients(coder);
            let (coded, _) = decoded(Config { mode, ..config }, &events);
            // The coders differ in n0.
            if coded.header.timed_max == window.header.timed_max {
                prop_assert_eq!(&coded.pixels, &window.pixels);
            }
            window = coded;
        }
        let most = u32::from(window.header.timed_max);
        prop_assert!(most <= u32::from(TIMED_EVENTS_MAX));
        EventDecoder::new(Finder::Exact).fill(&mut window);
        prop_assert_eq!(window.events.len(), events.len());
        for pixel in &window.pixels {
            let count = pixel.on + pixel.off;
            let is_timed = (2..=most).contains(&count);
            prop_assert_eq!(pixel.times.len() > 1, is_timed);
            if !is_timed {
                continue;
            }
            let cells = window.header.packing().timed_cells(count);
            let of = |events: &[Event], polarity| {
                let here = events
                    .iter()
                    .filter(|e| (e.x, e.y, e.polarity) == (pixel.x, pixel.y, polarity));
                let mut cells: Vec<_> = here.map(|e| cells.of((e.t_us - 5000) as u32)).collect();
                cells.sort_unstable();
                cells
            };
            for polarity in [Polarity::On, Polarity::Off] {
                prop_assert_eq!(of(&window.events, polarity), of(&events, polarity));
            }
        }
    }
}

/// Times at the edges of bins are in the bins that they begin, and empty bins are 0; no limit on work costs a time that
/// is sent.
#[test]
fn bins_and_times_are_exact_whatever_the_window() {
    for duration_us in [98_u32, 103, 10_000, 33_000, 100_000] {
        let mut config = Config {
            quantiser: Quantiser::new(-12).expect("-15 to 8"),
            few_as_times: true,
            ..plain_config(SENSOR, Transform::Dct, 64)
        };
        config.window.window_us = duration_us;
        let offsets: Vec<u32> = (0..100)
            .map(|i| i * (duration_us / 97) % duration_us)
            .collect();
        let sent: Vec<Vec<_>> = offsets
            .iter()
            .map(|offset_us| vec![(*offset_us, true), (duration_us - 1, false)])
            .collect();
        let (window, _) = decoded(config, &events(&sent));
        for bins in [50, 98, 100, 103] {
            let table = Inverse::new(Transform::Dct, window.header.grid, bins);
            for (pixel, offset_us) in window.pixels.iter().zip(&offsets) {
                assert_eq!(pixel.times.len(), 2, "{duration_us}");
                let bin = |at: u32| (u64::from(at) * bins as u64 / u64::from(duration_us)) as usize;
                let (on, off) = (bin(*offset_us), bin(duration_us - 1));
                for at in 0..bins {
                    let expected = f64::from(i8::from(at == on) - i8::from(at == off));
                    let found = table.value(pixel, at);
                    assert!(found == expected && found.is_sign_negative() == (expected < 0.0));
                }
            }
        }
        let mut limited = window.clone();
        EventDecoder::new(Finder::Exact)
            .with_work_limit(WorkLimit::units(0))
            .fill(&mut limited);
        let mut whole = window;
        EventDecoder::new(Finder::Exact).fill(&mut whole);
        assert_eq!(limited.events, whole.events);
    }
}

/// Returns random numbers below what is asked, always the same ones.
fn random() -> impl FnMut(u64) -> u64 {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    move |most| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % most
    }
}

/// A scene of `count` pixels whose events come in bursts, as pixels of a moving edge fire.
fn scene(count: u64) -> Vec<Vec<(u32, bool)>> {
    let mut next = random();
    (0..count)
        .map(|_| {
            let events = 1 + next(2) * next(4) * next(3);
            let (mut at_us, is_on) = (next(20_000), next(2) == 1);
            let event = |_| {
                at_us += next(2000);
                (at_us as u32, is_on)
            };
            (0..events).map(event).collect()
        })
        .collect()
}

/// The rule for n0 costs no bits, at any M and step: pixels of up to so many events take fewer as times.
#[test]
fn best_takes_no_more_bits() {
    let sent = scene(110);
    let events = events(&sent);
    for transform in Transform::ALL {
        for m in [2, 4, 8, 16, 24, 32, 64] {
            for step_log2 in [-12, -6, -3, 0, 2] {
                let config = Config {
                    quantiser: Quantiser::new(step_log2).expect("-15 to 8"),
                    ..plain_config(SENSOR, transform, m)
                };
                let (_, levels) = decoded(config, &events);
                let best = Config {
                    few_as_times: true,
                    ..config
                };
                let (window, times) = decoded(best, &events);
                let most = window.header.timed_max;
                assert!(
                    times <= levels + 2,
                    "{transform:?} {m} {step_log2} {most}: {times} {levels}"
                );
                let by_dense = |config: Config| {
                    let mode = Mode::Coefficients(Coder::Dense);
                    decoded(Config { mode, ..config }, &events)
                };
                let (_, levels_dense) = by_dense(config);
                let (window, times_dense) = by_dense(best);
                let most_dense = window.header.timed_max;
                assert!(
                    times_dense <= levels_dense + 2
                        && (most_dense > 0 || times_dense == levels_dense),
                    "{transform:?} {m} {step_log2} {most_dense}, dense: {times_dense} {levels_dense}"
                );
                // Cells of a microsecond have said all.
                if transform == Transform::Dtft && m >= 24 && step_log2 <= -6 {
                    assert_eq!(most_dense, 0, "{m} {step_log2}");
                }
                // The case that the rule is for.
                if m >= 8 && step_log2 == -6 {
                    assert!(
                        most >= 4 && 10 * times < 9 * levels,
                        "{transform:?} {m}: {most}"
                    );
                }
            }
        }
    }
}

/// Hardly any more by any coder where every pixel's events are spread over the whole window: such pixels are the dearest
/// as times. None at all at the step of 2^-6.
#[test]
fn even_pixels_take_hardly_more_bits() {
    let mut next = random();
    let finest = [6, 8, 10, 12, 16, 20, 24, 28, 32, 48].map(|m| (m, -6));
    let others = [-9, -5, -4, -3, -2, 0].map(|step_log2| [10, 16, 20].map(|m| (m, step_log2)));
    let settings = finest.into_iter().chain(others.into_iter().flatten());
    for of_pixel in 2..=24_u64 {
        let pixel = |_| {
            let mut offsets: Vec<_> = (0..of_pixel)
                .map(|_| (next(32_768) as u32, next(2) == 1))
                .collect();
            offsets.sort_unstable();
            offsets
        };
        let events = events(&(0..110).map(pixel).collect::<Vec<_>>());
        for transform in Transform::ALL {
            for (m, step_log2) in settings.clone() {
                let coders = [Coder::Fast, Coder::Dense].map(Mode::Coefficients);
                for mode in [Mode::Transform].into_iter().chain(coders) {
                    let config = Config {
                        mode,
                        quantiser: Quantiser::new(step_log2).expect("-15 to 8"),
                        ..plain_config(SENSOR, transform, m)
                    };
                    let (_, levels) = decoded(config, &events);
                    let best = Config {
                        few_as_times: true,
                        ..config
                    };
                    let (window, times) = decoded(best, &events);
                    let most = window.header.timed_max;
                    // The further flags and n0 take two bytes.
                    assert!(
                        times <= levels + 2 + if step_log2 == -6 { 0 } else { levels / 100 },
                        "{mode:?} {transform:?} {m}, 2^{step_log2}, {of_pixel} events, n0 {most}: {times} {levels}"
                    );
                }
            }
        }
    }
}

/// The rule looks at no event: where every ON event has an OFF event at its time, all levels are 0, and times take more.
#[test]
fn events_that_cancel_take_more_bits() {
    let mut next = random();
    let pair = |_| {
        let at_us = next(32_768) as u32;
        [(at_us, false), (at_us, true)]
    };
    let mut pairs: Vec<_> = (0..330).map(pair).collect();
    pairs.chunks_mut(3).for_each(<[_]>::sort_unstable);
    let sent: Vec<_> = pairs.chunks(3).map(<[_]>::concat).collect();
    let events = events(&sent);
    let config = plain_config(SENSOR, Transform::Dct, 16);
    let best = Config {
        few_as_times: true,
        ..config
    };
    let ((_, levels), (_, times)) = (decoded(config, &events), decoded(best, &events));
    assert!(2 * levels < times && times < 4 * levels, "{times} {levels}");
}
