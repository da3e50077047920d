//! Coefficients by the adaptive coders are those of the plain payload, to the bit.

use std::collections::BTreeMap;

use eecvs::decode::WindowReader;
use eecvs::encode::step::quantiser_within;
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::coefficients::CoefficientDecoder;
use eecvs::reconstruct::hybrid::Refused;
use eecvs_nostd::frame::{HEADER_BYTES_MAX, seal};
use eecvs_nostd::{
    Coder, Config, Descriptor, Event, Frame, KEY_WINDOWS, Mode, OUTPUT_BYTES_MIN, Polarity, Sensor,
    Transform,
};
use proptest::prelude::*;
use strategies::one_pixel::{bound, expected, impulses, through_the_link};
use strategies::{config, encode, events, parse, plain_config, sensor, transform};

/// Windows by their starts and durations, each with its pixels in raster order.
type Windows = BTreeMap<(u64, u32), Vec<Descriptor>>;

/// What frames hold.
fn windows(frames: &[Vec<u8>]) -> Result<Windows, Refused> {
    let mut windows = Windows::new();
    let mut decoder = CoefficientDecoder::default();
    for bytes in frames {
        let frame = parse(bytes);
        let header = &frame.header;
        let mut found = Vec::new();
        match header.mode {
            Mode::Coefficients(coder) => {
                decoder.descriptors(&frame, coder, |pixel| found.push(pixel))?;
            }
            _ => found.extend(frame.descriptors().map(|pixel| pixel.expect("plain"))),
        }
        assert_eq!(found.len(), header.pixels as usize);
        let events: u32 = found.iter().map(Descriptor::events).sum();
        assert_eq!(events, header.events);
        let window = windows.entry((header.t0_us, header.duration_us));
        window.or_default().extend(found);
    }
    Ok(windows)
}

/// A scene of bursts: pixels side by side whose events come at about the same times.
fn bursts() -> impl Strategy<Value = Vec<Event>> {
    let burst = (
        0..40_u16,
        0..20_u16,
        0..60_000_u64,
        1..40_u64,
        1..60_u64,
        any::<u8>(),
    );
    proptest::collection::vec(burst, 1..12).prop_map(|bursts| {
        let mut events = Vec::new();
        for (x, y, t_us, step_us, count, signs) in bursts {
            for i in 0..count * 3 {
                let on = signs >> (i / 3 % 8) & 1 == 1;
                let (x, t_us) = (x + (i % 3) as u16, t_us + i / 3 * step_us + i % 3);
                events.push(Event {
                    t_us,
                    x,
                    y,
                    polarity: Polarity::from_bool(on),
                });
            }
        }
        events.sort_by_key(|event| event.t_us);
        events
    })
}

fn job() -> impl Strategy<Value = (Config, Vec<Event>)> {
    sensor().prop_flat_map(|least| {
        let sensor = Sensor {
            width: least.width.max(43),
            height: least.height.max(20),
        };
        (config(sensor), prop_oneof![events(sensor, 400), bursts()])
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn levels_are_those_of_the_plain_payload(
        (config, events) in job(),
        window_events in prop_oneof![1..40_usize, Just(2000)],
        frame_bytes in prop_oneof![
            Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..6000, Just(1 << 16)
        ],
        key_windows in prop_oneof![1..4_u16, Just(KEY_WINDOWS)],
    ) {
        // Fewer pixels are sent as times by the dense coder: `few_as_times` has tests of these.
        let config = Config { few_as_times: false, ..config };
        let plain = encode(config, &events, window_events, 1 << 20);
        let plain = windows(&plain).expect("plain");
        for coder in [Coder::Fast, Coder::Dense] {
            let config = Config { mode: Mode::Coefficients(coder), key_windows, ..config };
            let frames = encode(config, &events, window_events, frame_bytes);
            prop_assert!(frames.iter().all(|frame| frame.len() <= frame_bytes));
            let found = windows(&frames);
            prop_assert_eq!(found.as_ref(), Ok(&plain), "{:?}", coder);
        }
    }

    /// A frame that is lost takes those that go on from it with it, up to the next key frame; all others
    /// come back.
    #[test]
    fn a_lost_frame_costs_no_more_than_its_chain(
        (config, events) in job(), key_windows in 1..5_u16, lost: usize, coder_is_dense: bool,
    ) {
        let coder = if coder_is_dense { Coder::Dense } else { Coder::Fast };
        let mode = Mode::Coefficients(coder);
        let frames = encode(Config { mode, key_windows, ..config }, &events, 30, 1 << 16);
        prop_assume!(!frames.is_empty());
        let lost = lost % frames.len();
        let mut decoder = CoefficientDecoder::default();
        let mut is_whole = true;
        for (at, bytes) in frames.iter().enumerate() {
            let frame = parse(bytes);
            prop_assert!(frame.header.is_key || coder == Coder::Dense);
            if at == lost {
                is_whole = false;
                continue;
            }
            is_whole |= frame.header.is_key;
            let found = decoder.descriptors(&frame, coder, |_| ());
            let expected = if is_whole { Ok(()) } else { Err(Refused::Dependent) };
            prop_assert_eq!(found, expected);
        }
    }

    /// Sound checksums around any payload: refused or decoded, without a panic; what is decoded could
    /// have been sent plain.
    #[test]
    fn any_payload_decodes_or_is_refused(
        (config, events) in job(), flips in proptest::collection::vec((any::<usize>(), 1..=255_u8), 0..4),
        noise in proptest::option::of(proptest::collection::vec(any::<u8>(), 0..300)),
        cut in 0..6_usize, more in 0..20_u32, coder_is_dense: bool,
    ) {
        let coder = if coder_is_dense { Coder::Dense } else { Coder::Fast };
        let mode = Mode::Coefficients(coder);
        let frames = encode(Config { mode, ..config }, &events, 400, 1 << 16);
        let mut decoder = CoefficientDecoder::default();
        for bytes in &frames {
            let frame = parse(bytes);
            let mut payload = noise.clone().unwrap_or_else(|| frame.payload.to_vec());
            for (at, bits) in &flips {
                let len = payload.len().max(1);
                if let Some(byte) = payload.get_mut(at % len) {
                    *byte ^= bits;
                }
            }
            payload.truncate(payload.len().saturating_sub(cut));
            let mut header = frame.header;
            header.events = (header.events + more).min(header.window_events);
            header.pixels = header.pixels.min(header.events);
            header.last = header.last && more == 0;
            let mut out = vec![0; HEADER_BYTES_MAX + payload.len() + 8];
            out[HEADER_BYTES_MAX..][..payload.len()].copy_from_slice(&payload);
            let range = seal(&header, payload.len(), &mut out).expect("room");
            let Ok(frame) = Frame::parse(&out[range]) else {
                continue;
            };
            let packing = header.packing();
            let mut found = Vec::new();
            let result = decoder.descriptors(&frame, coder, |pixel| found.push(pixel));
            prop_assert!(found.len() <= header.pixels.max(header.events) as usize);
            for pixel in &found {
                prop_assert!(packing.sensor.contains(pixel.x, pixel.y));
                let mut bytes = [0; eecvs_nostd::transform::shape::PIXEL_BYTES_MAX];
                let mut writer = eecvs_nostd::pack::bits_lsb_first::BitWriter::new(&mut bytes);
                prop_assert!(packing.pack(pixel, &mut 0, &mut writer).is_ok());
                let len = writer.finish();
                let mut reader = eecvs_nostd::pack::bits_lsb_first::BitReader::new(&bytes[..len]);
                let again = packing.unpack(&mut 0, pixel.events(), &mut reader);
                prop_assert_eq!(again.as_ref(), Ok(pixel));
            }
            if result.is_ok() {
                prop_assert_eq!(found.len(), header.pixels as usize);
            }
        }
    }

    /// `--max-error`: every number of a kept coefficient is within it, but for the kernel's own error.
    #[test]
    fn no_number_is_off_by_more_than_is_asked(
        error_log2 in -16_f64..9.0, transform in transform(), m in 1..=32_u8,
        offsets in proptest::collection::vec((0..32_768_u32, any::<bool>()), 1..40),
    ) {
        let error = error_log2.exp2();
        let mut config = plain_config(strategies::one_pixel::SENSOR, transform, m);
        config.quantiser = quantiser_within(error).expect("a step for it");
        let mut events = impulses(offsets.iter().map(|(offset_us, _)| *offset_us), 1.0);
        for (impulse, (_, on)) in events.iter_mut().zip(&offsets) {
            impulse.p = if *on { 1.0 } else { -1.0 };
        }
        let expected = expected(&config, &events);
        let (_, pixel) = through_the_link(config, &events);
        // A Haar coefficient of a single event is exact or not sent.
        let most = error + bound(transform, events.len()) + 1e-9;
        for (k, re, im) in pixel.coefficients {
            let expected = expected[usize::from(k)];
            prop_assert!((re - expected.re).abs() <= most, "{} of {}", re, expected);
            prop_assert!((im - expected.im).abs() <= most, "{} of {}", im, expected);
        }
    }
}

/// A stream of all modes decodes as windows, and an empty one is a frame without pixels.
#[test]
fn modes_follow_each_other_in_a_stream() {
    let sensor = Sensor::new(40, 20).expect("a sensor");
    let events: Vec<_> = (0..4000_u64)
        .map(|i| Event {
            t_us: 37 * i,
            x: (i * i % 40) as u16,
            y: (i / 7 % 20) as u16,
            polarity: Polarity::from_bool(i % 5 < 2),
        })
        .collect();
    for transform in Transform::ALL {
        let mut plain = plain_config(sensor, transform, 16);
        let read = |config: Config| {
            let bytes = encode(config, &events, 5000, 1 << 20).concat();
            let mut reader = WindowReader::new(FrameReader::new(&bytes[..]));
            let mut windows = Vec::new();
            while let Some(window) = reader.next_window().expect("memory") {
                windows.push(window.pixels);
            }
            assert!(reader.report().is_clean());
            (windows, bytes.len())
        };
        let (expected, plain_bytes) = read(plain);
        for (coder, most) in [(Coder::Fast, 0.9), (Coder::Dense, 0.75)] {
            plain.mode = Mode::Coefficients(coder);
            let (found, bytes) = read(plain);
            assert_eq!(found, expected);
            let ratio = bytes as f64 / plain_bytes as f64;
            assert!(ratio < most, "{transform:?} {coder:?}: {ratio}");
        }
    }
}

/// The CRC-32 that ends each frame of a small scene: the payloads do not change unnoticed.
#[test]
fn frames_are_pinned() {
    let sensor = Sensor::new(40, 20).expect("a sensor");
    let events: Vec<_> = (0..700_u64)
        .map(|i| Event {
            t_us: 91 * i + i * i % 64,
            x: (i * i % 37) as u16,
            y: (i / 7 % 20) as u16,
            polarity: Polarity::from_bool(i % 5 < 2),
        })
        .collect();
    let mut found = Vec::new();
    for transform in Transform::ALL {
        for coder in [Coder::Fast, Coder::Dense] {
            let config = Config {
                mode: Mode::Coefficients(coder),
                ..plain_config(sensor, transform, 8)
            };
            let frames = encode(config, &events, 1000, 1 << 20);
            let crc = |frame: &Vec<u8>| frame.last_chunk().map(|crc| u32::from_le_bytes(*crc));
            found.push(frames.iter().filter_map(crc).collect::<Vec<_>>());
        }
    }
    assert_eq!(found, PINNED);
}

const PINNED: [[u32; 2]; 6] = [
    [2_000_018_242, 2_846_243_466],
    [641_221_429, 1_608_081_997],
    [2_317_896_542, 2_064_608_879],
    [3_087_243_257, 470_150_757],
    [3_286_882_414, 3_686_979_783],
    [2_090_136_273, 4_147_239_240],
];
