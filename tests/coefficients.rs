//! Coefficients by the adaptive coders are those of the plain payload, to the bit.

use std::collections::BTreeMap;

use eecvs_nostd::{
    Coder, Config, Descriptor, Event, KEY_WINDOWS, Mode, OUTPUT_BYTES_MIN, Polarity,
};
use host_harness::reconstruct::coefficients::CoefficientDecoder;
use host_harness::reconstruct::hybrid::Refused;
use proptest::prelude::*;
use strategies::{config, encode, events, parse, sensor};

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
    let burst = (0..40_u16, 0..20_u16, 0..60_000_u64, 1..40_u64, 1..60_u64, any::<u8>());
    proptest::collection::vec(burst, 1..12).prop_map(|bursts| {
        let mut events = Vec::new();
        for (x, y, t_us, step_us, count, signs) in bursts {
            for i in 0..count * 3 {
                let on = signs >> (i / 3 % 8) & 1 == 1;
                let (x, t_us) = (x + (i % 3) as u16, t_us + i / 3 * step_us + i % 3);
                events.push(Event { t_us, x, y, polarity: Polarity::from_bool(on) });
            }
        }
        events.sort_by_key(|event| event.t_us);
        events
    })
}

fn job() -> impl Strategy<Value = (Config, Vec<Event>)> {
    sensor().prop_flat_map(|least| {
        let sensor = eecvs_nostd::Sensor {
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
}
