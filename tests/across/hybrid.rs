//! Mode `hybrid`: what comes back is what was asked for, whatever the events, the frames' sizes and
//! their losses.

use eecvs::decode::WindowReader;
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{self, DenseMemory};
use eecvs_nostd::coder::tree::Levels;
use eecvs_nostd::frame::{HEADER_BYTES_MAX, seal};
use eecvs_nostd::{
    Axis, Coder, Config, Effort, Event, Fidelity, Frame, Header, Hybrid, Mode, OUTPUT_BYTES_MIN,
    Polarity, Readout, Scans, Scratch, Sensor, Slot, Window, WindowBuffers, WindowConfig,
    WindowEncoder, bitmap_words, segments,
};
use proptest::prelude::*;
use strategies::{encode, hybrid, job, parse};

fn readout() -> impl Strategy<Value = Readout> {
    let axis = prop_oneof![Just(Axis::Columns), Just(Axis::Rows)];
    (axis, 16_u32 << 16..=250 << 16, -(3 << 16)..=3 << 16)
        .prop_map(|(axis, period, slope)| Readout::new(axis, period, slope).expect("in range"))
}

/// Moves most events to the time at which their line was read.
fn scanned(readout: Readout, events: &mut [Event]) {
    let start_us = events.iter().map(|event| event.t_us).min().unwrap_or(0);
    let (period, slope) = (
        i64::from(readout.period_q16()),
        i64::from(readout.slope_q16()),
    );
    for (i, event) in events.iter_mut().enumerate() {
        let line = match readout.axis() {
            Axis::Columns => event.x,
            Axis::Rows => event.y,
        };
        let since_q16 = ((event.t_us - start_us) as i64) << 16;
        let time_q16 = since_q16 / period * period + i64::from(line) * slope;
        let jitter_us = i64::from(i % 7 == 0) - 2 * i64::from(i % 11 == 0);
        let t_us = (start_us as i64).saturating_add((time_q16 >> 16) + jitter_us);
        if i % 5 > 0 {
            event.t_us = t_us.max(0) as u64;
        }
    }
}

fn hybrid_job(most: usize) -> impl Strategy<Value = (Config, Hybrid, Vec<Event>)> {
    let readout = proptest::option::of(readout());
    (job(most), hybrid(), 1_u16..6, readout).prop_map(
        |((config, mut events), hybrid, key_windows, readout)| {
            if let Some(readout) = readout {
                scanned(readout, &mut events);
            }
            let mode = Mode::Hybrid(hybrid);
            let config = Config {
                mode,
                key_windows,
                readout,
                ..config
            };
            (config, hybrid, events)
        },
    )
}

fn decode(frames: &[Vec<u8>]) -> (Vec<DecodedWindow>, LinkReport) {
    let bytes = frames.concat();
    let mut reader = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().expect("memory") {
        windows.push(window);
    }
    (windows, reader.report().clone())
}

/// Events of a window in one order, for multisets.
fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_by_key(|event| (event.y, event.x, event.t_us, event.polarity));
    events
}

/// Whether decoded events are a window's as exactly as was asked.
fn check(hybrid: Hybrid, header: &Header, of: Vec<Event>, decoded: Vec<Event>) {
    let end_us = header.t0_us.saturating_add(u64::from(header.duration_us));
    for event in &decoded {
        assert!((header.t0_us..end_us).contains(&event.t_us), "{event:?}");
    }
    let cell = |event: &Event| {
        let offset_us = event.t_us - header.t0_us;
        match hybrid.fidelity {
            Fidelity::Lossless => offset_us,
            Fidelity::ToleranceUs(tolerance_us) => offset_us / (2 * u64::from(tolerance_us) + 1),
            Fidelity::Bins(bins) => offset_us * u64::from(bins) / u64::from(header.duration_us),
            Fidelity::SpreadUs(width_us) => offset_us / u64::from(width_us),
        }
    };
    let told = |events: Vec<Event>| {
        let told = |event: &Event| (event.y, event.x, cell(event), event.polarity);
        let mut told: Vec<_> = events.iter().map(told).collect();
        told.sort_unstable();
        told
    };
    if let Some(within_us) = hybrid.fidelity.within_us() {
        // Pixel by pixel and polarity by polarity, in order: none is further off.
        let key = |event: &Event| (event.y, event.x, event.polarity, event.t_us);
        let (mut a, mut b) = (of.clone(), decoded.clone());
        a.sort_by_key(key);
        b.sort_by_key(key);
        for (a, b) in a.iter().zip(&b) {
            assert!(a.t_us.abs_diff(b.t_us) <= u64::from(within_us));
        }
    }
    assert_eq!(told(of), told(decoded));
}

/// The events by window, as the encoder makes windows of them.
fn windows_of(config: Config, events: &[Event], window_events: usize) -> Vec<(Header, Vec<Event>)> {
    let lossless = Config {
        mode: Mode::Hybrid(Hybrid::default()),
        ..config
    };
    let (windows, report) = decode(&encode(lossless, events, window_events, 1 << 20));
    assert!(report.is_clean());
    let windows: Vec<_> = windows.into_iter().map(|w| (w.header, w.events)).collect();
    let decoded: Vec<Event> = windows
        .iter()
        .flat_map(|(_, events)| events.clone())
        .collect();
    // The fast coder's lossless frames are checked against the events themselves.
    let mut left = sorted(events.to_vec());
    for event in sorted(decoded) {
        let at = left.iter().position(|other| *other == event);
        left.remove(at.expect("an event that was pushed"));
    }
    let outside: u32 = encode(lossless, events, window_events, 1 << 20)
        .iter()
        .map(|bytes| parse(bytes).header)
        .map(|header| header.dropped)
        .sum();
    assert_eq!(left.len(), outside as usize);
    windows
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn windows_come_back_as_exactly_as_was_asked(
        (config, hybrid, events) in hybrid_job(300),
        window_events in prop_oneof![1..40_usize, Just(1000)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), Just(1 << 16)],
    ) {
        let windows = windows_of(config, &events, window_events);
        let frames = encode(config, &events, window_events, frame_bytes);
        for (index, bytes) in frames.iter().enumerate() {
            prop_assert!(bytes.len() <= frame_bytes);
            prop_assert_eq!(parse(bytes).header.sequence, index as u32);
        }
        let (decoded, report) = decode(&frames);
        prop_assert!(report.is_clean(), "{:?}", report);
        prop_assert_eq!(decoded.len(), windows.len());
        for ((header, events), decoded) in windows.into_iter().zip(decoded) {
            prop_assert_eq!(decoded.header.t0_us, header.t0_us);
            prop_assert_eq!(decoded.header.duration_us, header.duration_us);
            check(hybrid, &header, events, decoded.events);
        }
    }

    /// The volume is the same array in both modes.
    #[test]
    fn the_volume_of_lossless_events_is_that_of_the_transform(
        (config, _, events) in hybrid_job(200),
    ) {
        let transform = Config { mode: Mode::Transform, few_as_times: false, ..config };
        let lossless = Config { mode: Mode::Hybrid(Hybrid::default()), ..config };
        let (of_transform, _) = decode(&encode(transform, &events, 1000, 1 << 20));
        let (of_events, _) = decode(&encode(lossless, &events, 1000, 1 << 20));
        prop_assert_eq!(of_transform.len(), of_events.len());
        for (a, b) in of_transform.iter().zip(of_events) {
            let b = b.with_pixels().expect("a window");
            prop_assert_eq!(&a.pixels, &b.pixels);
            prop_assert_eq!(a.header.transform, b.header.transform);
        }
    }

    /// A frame that does not come costs what goes on from it, and nothing else, and is told.
    #[test]
    fn a_lost_frame_is_told_and_left_behind_at_the_next_key(
        (config, hybrid, events) in hybrid_job(300), lost in any::<prop::sample::Index>(),
    ) {
        let mut frames = encode(config, &events, 20, OUTPUT_BYTES_MIN);
        prop_assume!(frames.len() > 2);
        let lost = lost.index(frames.len() - 1);
        let (all, _) = decode(&frames);
        let next_key = (lost + 1..frames.len())
            .find(|i| parse(&frames[*i]).header.is_key)
            .unwrap_or(frames.len());
        if !Mode::Hybrid(hybrid).is_dense() {
            prop_assert_eq!(next_key, lost + 1);
        }
        let dependent = next_key - lost - 1;
        let after = frames.get(next_key).map(|bytes| parse(bytes).header);
        frames.remove(lost);
        let (decoded, report) = decode(&frames);
        prop_assert_eq!(report.frames_dependent, dependent as u64);
        prop_assert_eq!(report.frames_malformed, 0);
        // Whole windows from the next key on are there.
        if let Some(after) = after.filter(|header| header.part == 0) {
            // Not by time: windows that are full at once begin at the same one.
            let from = |windows: &[DecodedWindow]| -> usize {
                let is_later = |w: &&DecodedWindow| w.header.sequence >= after.sequence;
                windows.iter().filter(is_later).count()
            };
            prop_assert_eq!(from(&decoded), from(&all));
        }
    }

    /// Any payload behind a sound header is events of its window, or refused.
    #[test]
    fn any_payload_is_events_or_refused(
        hybrid in hybrid(), payload in proptest::collection::vec(any::<u8>(), 0..300),
        (width, height) in (1_u16..100, 1_u16..50), duration_us in 1_u32..,
        events in 0_u32..5000, more in 0_u32..5000, flags in 0_u8..8,
        (readout, phase_q16) in (readout(), any::<i32>()),
    ) {
        let scans = Scans::new(readout, phase_q16, Sensor { width, height }, duration_us);
        let scans = scans.filter(|_| hybrid.coder == Coder::Dense && hybrid.fidelity == Fidelity::Lossless);
        // The tree coder codes whole windows whose times have 28 bits or less.
        let effort = Mode::Hybrid(hybrid).effort();
        let (more, duration_us) = match effort {
            Some(_) => (0, 1 + duration_us % (1 << 28)),
            None => (more, duration_us),
        };
        let has_previous = match effort {
            Some(effort) => effort != Effort::One || flags & 4 != 0,
            None => hybrid.coder == Coder::Dense && flags & 4 != 0,
        };
        let header = Header {
            mode: Mode::Hybrid(hybrid),
            sensor: Sensor { width, height },
            duration_us,
            events,
            window_events: events + more,
            last: flags & 1 != 0,
            is_key: !Mode::Hybrid(hybrid).is_dense() || flags & 2 != 0,
            has_previous,
            levels: effort.map(|_| Levels { first: 1, second: 0 }),
            pixels: 0,
            scans,
            ..header()
        };
        let mut out = vec![0; HEADER_BYTES_MAX + payload.len() + 4];
        out[HEADER_BYTES_MAX..][..payload.len()].copy_from_slice(&payload);
        let range = seal(&header, payload.len(), &mut out).expect("room");
        let frame = Frame::parse(&out[range]).expect("a sound header");
        prop_assert_eq!(frame.header, header);
        let end_us = header.t0_us + u64::from(duration_us);
        if let Ok(found) = HybridDecoder::default().frame(&frame, hybrid) {
            prop_assert_eq!(found.len(), events as usize);
            prop_assert!(header.is_key);
            for event in found {
                prop_assert!(header.sensor.contains(event.x, event.y));
                prop_assert!((header.t0_us..end_us).contains(&event.t_us));
            }
        }
    }
}

fn header() -> Header {
    let event = Event {
        t_us: 77,
        x: 0,
        y: 0,
        polarity: Polarity::On,
    };
    let sensor = Sensor {
        width: 1,
        height: 1,
    };
    let config = strategies::plain_config(sensor, eecvs_nostd::Transform::Dct, 8);
    parse(&encode(config, &[event], 1, 1 << 16)[0]).header
}

/// A pixel of more events than a frame has room for is in several.
#[test]
fn a_crowded_pixel_takes_several_frames() {
    let sensor = Sensor {
        width: 3,
        height: 2,
    };
    let events: Vec<Event> = (0..65_535_u32)
        .map(|i| Event {
            t_us: u64::from(i.wrapping_mul(2_654_435_761) >> 17),
            x: 1,
            y: 1,
            polarity: Polarity::from_bool(i % 3 == 0),
        })
        .collect();
    let mut config = strategies::plain_config(sensor, eecvs_nostd::Transform::Dct, 8);
    config.window.window_us = 1 << 15;
    let first = events.iter().map(|event| event.t_us).min().expect("some");
    for coder in [Coder::Fast, Coder::Dense, Coder::Keys, Coder::Quick] {
        let fidelity = Fidelity::Lossless;
        config.mode = Mode::Hybrid(Hybrid { coder, fidelity });
        // The window is aligned to its first event: that has to be the earliest.
        let mut events = events.clone();
        events.sort_by_key(|event| event.t_us != first);
        let frames = encode(config, &events, 1 << 17, OUTPUT_BYTES_MIN);
        assert!(frames.len() > 20);
        let (windows, report) = decode(&frames);
        assert!(report.is_clean(), "{report:?}");
        assert_eq!(windows.len(), 1);
        assert_eq!(sorted(windows[0].events.clone()), sorted(events));
    }
}

/// A window of a sensor that the dense coder's memory is too small for goes out with the other coder,
/// and its frame says so.
#[test]
fn a_window_beyond_the_dense_coders_memory_is_a_fast_frame() {
    let side = |width, height| Sensor::new(width, height).expect("a sensor");
    let (small, large) = (side(8, 8), side(400, 300));
    let mut config = strategies::plain_config(small, eecvs_nostd::Transform::Dct, 8);
    config.mode = Mode::Hybrid(Hybrid {
        coder: Coder::Dense,
        fidelity: Fidelity::Lossless,
    });
    let mut model = Box::new(Model::UNSET);
    let mut words = vec![0; dense::words(small, true)];
    let scratch = Scratch {
        sums: &mut [],
        totals: &mut [],
        magnitudes: &mut [],
        dense: Some(DenseMemory {
            model: &mut model,
            words: &mut words,
        }),
        tree: None,
        keys: None,
        coefficients: None,
        hot: &mut [],
        order: &mut [],
    };
    let mut encoder = WindowEncoder::new(config, scratch).expect("enough for the small sensor");
    let count = segments(400, 300);
    let (mut slots, mut heads) = (vec![Slot::EMPTY; 10], vec![0; count]);
    let mut bitmap = vec![0; bitmap_words(count)];
    let buffers = WindowBuffers {
        slots: &mut slots,
        heads: &mut heads,
        bitmap: &mut bitmap,
    };
    let window_config = WindowConfig {
        sensor: large,
        ..config.window
    };
    let mut window = Window::new(window_config, buffers).expect("a window");
    let event = Event {
        t_us: 9,
        x: 399,
        y: 299,
        polarity: Polarity::Off,
    };
    window.push(event);
    window.flush();
    let mut out = vec![0; OUTPUT_BYTES_MIN];
    let encoded = encoder.next_frame(&mut window, &mut out).expect("room");
    let range = encoded.expect("a frame").range;
    let frame = parse(&out[range.clone()]);
    assert_eq!(frame.header.mode, Mode::Hybrid(Hybrid::default()));
    let (windows, report) = decode(&[out[range].to_vec()]);
    assert!(report.is_clean() && windows[0].events == [event]);
}

/// The property tests above do reach frames that are told by scans, and those are shorter.
#[test]
fn times_on_a_grid_are_told_by_scans() {
    let sensor = Sensor::new(200, 100).expect("a sensor");
    let readout = Readout::new(Axis::Columns, 197 << 16, -(39 << 10)).expect("in range");
    let mut events: Vec<Event> = (0..4000_u64)
        .map(|i| Event {
            t_us: 1000 + i * 8,
            x: (i.wrapping_mul(2_654_435_761) >> 7) as u16 % 200,
            y: (i.wrapping_mul(2_246_822_519) >> 9) as u16 % 100,
            polarity: Polarity::from_bool(i % 3 == 0),
        })
        .collect();
    scanned(readout, &mut events);
    events.sort_by_key(|event| event.t_us);
    let bytes = |coder, fidelity, readout| {
        let mut config = strategies::plain_config(sensor, eecvs_nostd::Transform::Dct, 8);
        config.readout = readout;
        config.mode = Mode::Hybrid(Hybrid { coder, fidelity });
        let frames = encode(config, &events, 1 << 14, 1 << 20);
        let header = parse(&frames[0]).header;
        assert!(matches!(header.mode, Mode::Hybrid(hybrid) if hybrid.coder == coder));
        (frames.concat().len(), header.scans.is_some(), header.mode)
    };
    for coder in [Coder::Dense]
        .into_iter()
        .chain(Effort::ALL.map(Coder::Tree))
    {
        let bytes = |fidelity, readout| bytes(coder, fidelity, readout);
        let (without, is_told, _) = bytes(Fidelity::Lossless, None);
        assert!(!is_told);
        let (with, is_told, mode) = bytes(Fidelity::Lossless, Some(readout));
        assert!(
            is_told && with * 5 < without * 4,
            "{coder:?}: {with} {without}"
        );
        // A tolerance that is finer than the scans costs more than exact times; a coarser one does not.
        assert_eq!(
            bytes(Fidelity::ToleranceUs(20), Some(readout)),
            (with, true, mode)
        );
        assert!(!bytes(Fidelity::ToleranceUs(200), Some(readout)).1);
        assert!(!bytes(Fidelity::Bins(8), Some(readout)).1);
    }
}
