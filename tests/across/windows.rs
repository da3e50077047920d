//! The core's windows, regimes and order independence against the oracle.

use std::num::{NonZeroU32, NonZeroUsize};

use eecvs::encode::HostStorage;
use eecvs::reconstruct::pixels;
use eecvs_nostd::evt2::{Evt2Decoder, Evt2Encoder, Word};
use eecvs_nostd::window::{EMPTY_WINDOWS_MAX, EVENTS_MAX};
use eecvs_nostd::{
    Coder, Encoder, Event, Fidelity, Hybrid, Mode, NoRoom, OUTPUT_BYTES_MIN, Polarity, Push,
    Quantiser, Regime, Sensor, Slot, Transform, Window, WindowBuffers, WindowConfig,
};
use eecvs_oracle::{density, regime, window};
use proptest::prelude::*;
use strategies::{encode, job, parse, plain_config};

const FRAME_BYTES: usize = 1 << 20;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn windows_and_regimes_are_the_oracles(
        (config, events) in job(300), window_events in prop_oneof![1..30_usize, Just(1000)],
    ) {
        let sensor = config.window.sensor;
        let expected = window::windows(
            &events,
            NonZeroU32::new(config.window.window_us).expect("at least 1"),
            NonZeroUsize::new(window_events).expect("at least 1"),
        );
        let frames = encode(config, &events, window_events, FRAME_BYTES);
        let headers: Vec<_> = frames
            .iter()
            .map(|bytes| parse(bytes).header)
            .filter(|header| header.window_events > 0)
            .collect();
        prop_assert_eq!(headers.len(), expected.len());
        for (header, expected) in headers.iter().zip(&expected) {
            prop_assert_eq!(header.t0_us, expected.t0_us);
            prop_assert_eq!(header.duration_us, expected.duration_us);
            prop_assert_eq!(header.begins_run, expected.begins_run);
            prop_assert_eq!(header.late, 0);
            prop_assert_eq!(header.window_events as usize, expected.events.len());
            let truncated = expected.duration_us != config.window.window_us;
            prop_assert!(header.truncated || !truncated);
            let rho = density::window_density(expected, sensor);
            let pico = |tau: u64| tau as f64 * 1e-12;
            let (low, high) =
                (pico(config.thresholds.tau_low_pico()), pico(config.thresholds.tau_high_pico()));
            // A density within rounding of a threshold is decided exactly by the core alone.
            if (rho - low).abs() > 1e-9 * low && (rho - high).abs() > 1e-9 * high {
                let expected = match regime::Regime::of(rho, low, high) {
                    regime::Regime::Sparse => Regime::Sparse,
                    regime::Regime::Moderate => Regime::Moderate,
                    regime::Regime::Dense => Regime::Dense,
                };
                prop_assert_eq!(header.regime, expected);
                prop_assert_eq!(
                    header.transform,
                    config.transform.unwrap_or(expected.transform())
                );
            }
        }
    }

    #[test]
    fn a_listed_window_is_the_one_that_its_events_were_pushed_into(
        (config, events) in job(300), window_events in prop_oneof![1..30_usize, Just(1000)],
    ) {
        prop_assume!(!config.windows().keeps_arrival);
        let pushed = encode(config, &events, window_events, FRAME_BYTES);
        let mut storage = HostStorage::new(config.window.sensor, window_events);
        let mut encoder = storage.encoder(config).expect("a valid configuration");
        let mut slots = vec![Slot::EMPTY; window_events];
        let mut arrived = arrived(config.window, &mut slots);
        let (mut frames, mut bytes) = (Vec::new(), vec![0; FRAME_BYTES]);
        let mut take = |arrived: &mut Window<'_>| {
            let held = (arrived.events(), arrived.closed());
            assert_eq!(encoder.window().list(arrived), held.1.is_some());
            if held.1.is_some() {
                assert_eq!((encoder.window().events(), encoder.window().closed()), held);
                assert_eq!((arrived.events(), arrived.closed()), (0, None));
                // Full: it takes no other.
                assert!(!encoder.window().list(arrived));
            }
            while let Some(frame) = encoder.next_frame(&mut bytes).expect("room") {
                frames.push(bytes[frame.range].to_vec());
            }
        };
        for event in events {
            while arrived.push(event) == Push::Closed {
                take(&mut arrived);
            }
        }
        arrived.flush();
        take(&mut arrived);
        prop_assert_eq!(frames, pushed);
    }

    #[test]
    fn order_inside_a_window_is_irrelevant(
        (config, mut events) in job(200), seed in any::<u64>(),
    ) {
        // One window: every event within it, the first one first so that t0 stays.
        for event in &mut events {
            event.t_us %= u64::from(config.window.window_us);
        }
        events.sort_by_key(|event| event.t_us);
        let sorted = encode(config, &events, 1000, FRAME_BYTES);
        if events.len() > 2 {
            let rest = &mut events[1..];
            let mut state = seed | 1;
            for i in (1..rest.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                rest.swap(i, (state >> 33) as usize % (i + 1));
            }
        }
        prop_assert_eq!(encode(config, &events, 1000, FRAME_BYTES), sorted);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Cells of the grid, told by their number: what windows of two sensors are matched by.
    #[test]
    fn with_an_origin_windows_lie_in_the_cells_of_its_grid(
        mut times in prop::collection::vec(0..3000_u64, 1..60),
        is_sorted in any::<bool>(),
        window_us in 1..200_u32,
        origin_us in prop_oneof![0..4000_u64, Just(u64::MAX)],
        every_window in any::<bool>(),
        window_events in prop_oneof![1..6_usize, Just(1000)],
    ) {
        if is_sorted {
            times.sort_unstable();
        }
        let sensor = Sensor { width: 40, height: 2 };
        let mut config = plain_config(sensor, Transform::Dct, 8);
        (config.window.window_us, config.window.origin_us) = (window_us, Some(origin_us));
        config.window.every_window = every_window;
        let events: Vec<_> = times.iter().map(|t_us| at(*t_us, 0)).collect();
        let frames = encode(config, &events, window_events, FRAME_BYTES);
        let cell = |t_us: u64| {
            (i128::from(t_us) - i128::from(origin_us)).div_euclid(i128::from(window_us))
        };
        let mut before: Option<i128> = None;
        let mut times = times.into_iter();
        for bytes in &frames {
            let header = parse(bytes).header;
            let duration_us = u64::from(header.duration_us);
            let here = cell(header.t0_us);
            prop_assert_eq!(cell(header.t0_us + duration_us - 1), here);
            if !header.truncated {
                // Up to the end of its cell.
                prop_assert_eq!(cell(header.t0_us + duration_us), here + 1);
            }
            for t_us in times.by_ref().take(header.window_events as usize) {
                prop_assert_eq!(cell(t_us), here);
            }
            if let Some(before) = before && !header.begins_run {
                prop_assert!(here >= before);
                if every_window {
                    prop_assert!(here <= before + 1);
                } else {
                    prop_assert!(header.window_events > 0);
                }
            }
            before = Some(here);
        }
        prop_assert_eq!(times.next(), None);
    }
}

#[test]
fn every_window_has_a_frame_but_those_of_a_jump() {
    let sensor = Sensor {
        width: 40,
        height: 2,
    };
    let mut config = plain_config(sensor, Transform::Dct, 8);
    (config.window.window_us, config.window.every_window) = (10, true);
    let frames = |events: &[Event]| -> Vec<_> {
        let frames = encode(config, events, 10, FRAME_BYTES);
        let headers = frames.iter().map(|bytes| parse(bytes).header);
        headers.map(|h| (h.t0_us, h.window_events)).collect()
    };
    assert_eq!(
        frames(&[at(7, 0), at(45, 1)]),
        [(7, 1), (17, 0), (27, 0), (37, 1)]
    );
    // The last gap that is filled, and the first that is taken for a jump of the clock.
    let gap_us = 10 * EMPTY_WINDOWS_MAX;
    assert_eq!(
        frames(&[at(0, 0), at(gap_us + 9, 1)]).len() as u64,
        EMPTY_WINDOWS_MAX + 1
    );
    assert_eq!(
        frames(&[at(0, 0), at(gap_us + 10, 1)]),
        [(0, 1), (gap_us + 10, 1)]
    );
    // A clock that passes closes them without events, and begins before any has come.
    let mut storage = HostStorage::new(sensor, 10);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut out = vec![0; OUTPUT_BYTES_MIN];
    let mut starts = Vec::new();
    for now_us in [100, 105, 110, 131] {
        loop {
            encoder.window().pass(now_us);
            if encoder.window().closed().is_none() {
                break;
            }
            while let Some(frame) = encoder.next_frame(&mut out).expect("room for a frame") {
                starts.push((now_us, frame.header.t0_us, frame.header.events));
            }
        }
    }
    assert_eq!(starts, [(110, 100, 0), (131, 110, 0), (131, 120, 0)]);
}

fn at(t_us: u64, x: u16) -> Event {
    Event {
        t_us,
        x,
        y: 0,
        polarity: Polarity::On,
    }
}

fn headers(events: &[Event], window_events: usize) -> Vec<(u64, u32, u32, bool, u32, u32)> {
    let sensor = Sensor {
        width: 40,
        height: 2,
    };
    let config = plain_config(sensor, Transform::Dct, 8);
    encode(config, events, window_events, FRAME_BYTES)
        .iter()
        .map(|bytes| {
            let h = parse(bytes).header;
            (
                h.t0_us,
                h.duration_us,
                h.window_events,
                h.truncated,
                h.late,
                h.dropped,
            )
        })
        .collect()
}

#[test]
fn windows_are_half_open_and_aligned_to_the_first_event() {
    assert_eq!(
        headers(
            &[at(5, 0), at(32_772, 1), at(32_773, 2), at(200_000, 3)],
            10
        ),
        [
            (5, 32_768, 2, false, 0, 0),
            (32_773, 32_768, 1, false, 0, 0),
            (5 + 6 * 32_768, 32_768, 1, false, 0, 0),
        ]
    );
}

#[test]
fn a_full_buffer_closes_early_and_loses_nothing() {
    // The second window is full when the fifth event comes, still within its T.
    assert_eq!(
        headers(
            &[at(10, 0), at(20, 1), at(30, 2), at(30, 3), at(32_797, 4)],
            2
        ),
        [
            (10, 20, 2, true, 0, 0),
            (30, 32_767, 2, true, 0, 0),
            (32_797, 32_768, 1, false, 0, 0)
        ]
    );
    // All at one time: every window lasts one microsecond and starts at the same time.
    assert_eq!(
        headers(&[at(7, 0); 5], 2),
        [
            (7, 1, 2, true, 0, 0),
            (7, 1, 2, true, 0, 0),
            (7, 32_768, 1, false, 0, 0)
        ]
    );
}

#[test]
fn a_clock_that_falls_back_begins_a_run_and_outside_events_are_counted() {
    assert_eq!(
        headers(&[at(100, 0), at(99, 1), at(101, 40), at(102, 39)], 10),
        [(100, 32_768, 1, false, 0, 0), (99, 32_768, 2, false, 0, 1)]
    );
    // Counts without a window still reach the link.
    assert_eq!(
        headers(&[at(100, 0), at(40_000, 1), at(3, 1), at(4, 40)], 10),
        [
            (100, 32_768, 1, false, 0, 0),
            (32_868, 32_768, 1, false, 0, 0),
            (3, 32_768, 1, false, 0, 1)
        ]
    );
    assert_eq!(headers(&[at(4, 40)], 10), [(0, 32_768, 0, false, 0, 1)]);
}

#[test]
fn times_at_the_end_of_the_range_work() {
    assert_eq!(
        headers(&[at(u64::MAX - 1, 0), at(u64::MAX, 1), at(0, 2)], 10),
        [
            (u64::MAX - 1, 32_768, 2, false, 0, 0),
            (0, 32_768, 1, false, 0, 0)
        ]
    );
}

#[test]
fn the_stream_starts_anew_after_a_flush() {
    let sensor = Sensor {
        width: 40,
        height: 2,
    };
    let mut storage = HostStorage::new(sensor, 10);
    let config = plain_config(sensor, Transform::Dwt, 8);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut out = vec![0; OUTPUT_BYTES_MIN];
    let mut frames = Vec::new();
    // Before the grid's next window, on it, and before everything so far: each flush aligns anew.
    for t_us in [100_000, 100_500, 132_768, 5] {
        assert_eq!(encoder.push(at(t_us, 3)), Push::Stored);
        encoder.flush();
        encoder.flush();
        assert_eq!(encoder.push(at(t_us, 4)), Push::Closed);
        while let Some(frame) = encoder.next_frame(&mut out).expect("room for a frame") {
            let header = frame.header;
            frames.push((header.t0_us, header.sequence, header.late, header.events));
        }
    }
    encoder.flush();
    assert_eq!(encoder.next_frame(&mut out), Ok(None));
    assert_eq!(
        frames,
        [
            (100_000, 0, 0, 1),
            (100_500, 1, 0, 1),
            (132_768, 2, 0, 1),
            (5, 3, 0, 1)
        ]
    );
}

#[test]
fn nothing_is_lost_where_the_output_is_too_short() {
    let sensor = Sensor {
        width: 40,
        height: 40,
    };
    let config = plain_config(sensor, Transform::Dtft, 64);
    // Two a pixel: a single one is but the cell of its time.
    let events: Vec<_> = (0..400)
        .map(|i| Event {
            y: i as u16 / 80,
            ..at(i, i as u16 / 2 % 40)
        })
        .collect();
    let expected = encode(config, &events, 400, OUTPUT_BYTES_MIN);
    assert!(expected.len() > 5);
    let mut storage = HostStorage::new(sensor, 400);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut out = vec![0; OUTPUT_BYTES_MIN];
    for event in events {
        assert_eq!(encoder.push(event), Push::Stored);
    }
    encoder.window().count_filtered(7);
    encoder.flush();
    let mut frames = Vec::new();
    let mut filtered = 0;
    loop {
        for len in [0, 1, OUTPUT_BYTES_MIN - 1] {
            assert_eq!(encoder.next_frame(&mut out[..len]), Err(NoRoom));
        }
        match encoder.next_frame(&mut out) {
            Ok(Some(frame)) => {
                filtered += frame.header.filtered;
                frames.push(out[frame.range].to_vec());
            }
            Ok(None) => break,
            Err(NoRoom) => panic!("there was room"),
        }
    }
    assert_eq!(filtered, 7);
    // The counts make the first frame differ; the pixels are the same.
    assert_eq!(frames[1..], expected[1..]);
    assert_eq!(parse(&frames[0]).payload, parse(&expected[0]).payload);
    assert_eq!(encoder.push(at(1000, 0)), Push::Stored);
}

/// 2^24 - 1 events of one pixel, over 2^32 - 1 us that end with the last microsecond there is.
#[test]
fn the_largest_window_at_the_end_of_time_fits_one_pixel() {
    let sensor = Sensor {
        width: 1,
        height: 1,
    };
    let window_events = EVENTS_MAX as u64;
    let t0_us = u64::MAX - (window_events - 1) * 256;
    let mut storage = HostStorage::new(sensor, EVENTS_MAX);
    let mut out = vec![0; OUTPUT_BYTES_MIN];
    for (transform, step_log2) in [
        (Transform::Dct, -15),
        (Transform::Dtft, -15),
        (Transform::Dwt, 8),
    ] {
        let mut config = plain_config(sensor, transform, 64);
        config.window.window_us = u32::MAX;
        config.grid = Some(4);
        config.quantiser = Quantiser::new(step_log2).expect("in range");
        let mut encoder = storage.encoder(config).expect("a valid configuration");
        for i in 0..window_events {
            assert_eq!(encoder.push(at(t0_us + i * 256, 0)), Push::Stored);
        }
        assert_eq!(encoder.push(at(u64::MAX, 0)), Push::Closed);
        let encoded = encoder
            .next_frame(&mut out)
            .expect("room")
            .expect("a frame");
        let header = encoded.header;
        assert!(header.truncated && header.last);
        // One microsecond beyond the latest: u < 1.
        assert_eq!(header.duration_us, (EVENTS_MAX as u32 - 1) * 256 + 1);
        let frame = parse(&out[encoded.range]);
        let pixel = pixels(&frame).expect("the encoder's own payload")[0].clone();
        assert_eq!((pixel.on, pixel.off), (EVENTS_MAX as u32, 0));
        assert_eq!(pixel.coefficients[0], (0, window_events as f64, 0.0));
        // c_0 in steps of 2^-15 is beyond 32 bits, but known from the counts.
        assert_eq!(header.saturated, 0);
        assert_eq!(encoder.next_frame(&mut out), Ok(None));
        assert_eq!(encoder.push(at(u64::MAX, 0)), Push::Stored);
    }
}

/// What a window is asked to do in [`words_are_taken_as_events_are`].
#[derive(Debug, Clone, Copy)]
enum Input {
    Event {
        step_us: i32,
        x: u16,
        y: u16,
        on: bool,
    },
    Word(u32),
    /// The next event comes as an event, between words.
    Apart,
}

fn input() -> impl Strategy<Value = Input> {
    let event =
        |steps: std::ops::Range<i32>| {
            (steps, 0..44_u16, 0..4_u16, any::<bool>())
                .prop_map(|(step_us, x, y, on)| Input::Event { step_us, x, y, on })
        };
    prop_oneof![
        20 => event(0..20),
        3 => event(-100..300),
        1 => event(0..5000),
        1 => any::<u32>().prop_map(Input::Word),
        1 => Just(Input::Apart),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn words_are_taken_as_events_are(
        inputs in prop::collection::vec(input(), 0..300),
        window_us in prop_oneof![1..200_u32, 200..3000_u32, Just(u32::MAX)],
        slots in prop_oneof![1..20_usize, Just(1000)],
        chunk in prop_oneof![1..5_usize, Just(1000)],
        base_us in prop_oneof![Just(0), any::<u64>()],
        keeps_arrival: bool,
    ) {
        let sensor = Sensor { width: 40, height: 3 };
        let mut config = plain_config(sensor, Transform::Dct, 8);
        config.window.window_us = window_us;
        if keeps_arrival {
            config.mode = Mode::Hybrid(Hybrid { coder: Coder::Quick, fidelity: Fidelity::Lossless });
        }

        // The words, and whether the window is to get the next one's event by itself.
        let mut words = Vec::new();
        let mut apart = false;
        let mut t_us = base_us.saturating_add(1000);
        let mut encoder = Evt2Encoder::new(base_us);
        for input in inputs {
            match input {
                Input::Apart => apart = true,
                Input::Word(word) => words.push((word.to_le_bytes(), false)),
                Input::Event { step_us, x, y, on } => {
                    t_us = t_us.saturating_add_signed(step_us.into());
                    let polarity = Polarity::from_bool(on);
                    let Some((time, word)) = encoder.encode(Event { t_us, x, y, polarity }) else {
                        continue;
                    };
                    words.extend(time.map(|time| (time.to_le_bytes(), false)));
                    words.push((word.to_le_bytes(), std::mem::take(&mut apart)));
                }
            }
        }

        let one_by_one = |words: &[([u8; 4], bool)]| {
            let mut storage = HostStorage::new(sensor, slots);
            let mut encoder = storage.encoder(config).expect("a valid configuration");
            let mut decoder = Evt2Decoder::new(base_us);
            let mut frames = Frames::default();
            for (word, _) in words {
                match decoder.decode(u32::from_le_bytes(*word)) {
                    Word::Event(event) => {
                        frames.events += 1;
                        while encoder.push(event) == Push::Closed {
                            frames.take(&mut encoder);
                        }
                    }
                    Word::Time => {}
                    Word::Untimed | Word::Other => frames.ignored += 1,
                }
            }
            encoder.flush();
            frames.take(&mut encoder);
            frames
        };
        let in_runs = |words: &[([u8; 4], bool)]| {
            let mut storage = HostStorage::new(sensor, slots);
            let mut encoder = storage.encoder(config).expect("a valid configuration");
            let mut decoder = Evt2Decoder::new(base_us);
            let mut frames = Frames::default();
            for run in words.chunk_by(|_, (_, apart)| !apart) {
                let mut rest = run;
                if let Some((word, true)) = run.first()
                    && let Word::Event(event) = decoder.decode(u32::from_le_bytes(*word))
                {
                    frames.events += 1;
                    while encoder.push(event) == Push::Closed {
                        frames.take(&mut encoder);
                    }
                    rest = &run[1..];
                }
                let words: Vec<_> = rest.iter().map(|(word, _)| *word).collect();
                for chunk in words.chunks(chunk) {
                    let mut rest = chunk;
                    while !rest.is_empty() {
                        let taken = encoder.window().push_words(&mut decoder, rest);
                        frames.events += taken.events;
                        frames.ignored += taken.ignored;
                        rest = &rest[taken.words..];
                        if !rest.is_empty() {
                            assert!(encoder.window().closed().is_some());
                            frames.take(&mut encoder);
                        }
                    }
                }
            }
            encoder.flush();
            frames.take(&mut encoder);
            frames
        };
        prop_assert_eq!(in_runs(&words), one_by_one(&words));
    }
}

/// A window that keeps the order of arrival, without memory for pixels.
fn arrived(config: WindowConfig, slots: &mut [Slot]) -> Window<'_> {
    let config = WindowConfig {
        keeps_arrival: true,
        ..config
    };
    let buffers = WindowBuffers {
        slots,
        heads: &mut [],
        bitmap: &mut [],
    };
    Window::new(config, buffers).expect("a valid configuration")
}

#[test]
fn a_window_lists_only_what_it_can_hold() {
    let sensor = Sensor {
        width: 40,
        height: 2,
    };
    let config = plain_config(sensor, Transform::Dct, 8);
    let mut slots = [Slot::EMPTY; 4];
    let mut full = arrived(config.window, &mut slots);
    for t_us in 0..4 {
        assert_eq!(full.push(at(t_us, 0)), Push::Stored);
    }
    let lists = |sensor, window_events, full: &mut Window<'_>| {
        let mut config = config;
        config.window.sensor = sensor;
        let mut storage = HostStorage::new(sensor, window_events);
        let mut encoder = storage.encoder(config).expect("a valid configuration");
        let lists = encoder.window().list(full);
        assert_eq!(encoder.window().events(), if lists { 4 } else { 0 });
        lists
    };
    assert!(!lists(sensor, 4, &mut full), "it is open");
    full.flush();
    let mut other = [Slot::EMPTY; 4];
    assert!(
        !arrived(config.window, &mut other).list(&mut full),
        "it would keep the order of arrival"
    );
    assert!(!lists(sensor, 3, &mut full), "it has no room");
    let wider = Sensor {
        width: 41,
        ..sensor
    };
    assert!(!lists(wider, 4, &mut full), "it is another sensor's");
    assert_eq!(full.events(), 4);
    assert!(lists(sensor, 4, &mut full));
    assert_eq!(full.events(), 0);
}

#[derive(Debug, Default, PartialEq)]
struct Frames {
    bytes: Vec<Vec<u8>>,
    events: u32,
    ignored: u32,
}

impl Frames {
    fn take(&mut self, encoder: &mut Encoder<'_>) {
        let mut out = vec![0; 1 << 16];
        while let Some(frame) = encoder.next_frame(&mut out).expect("room") {
            self.bytes.push(out[frame.range].to_vec());
        }
    }
}
