//! What simulated cameras send while there is no event, at a reset of their clock, and at a second start.

use eecvs_nostd::{Event, Polarity, Sensor};
use proptest::prelude::*;
use usb_bridge::device::{MODELS, Model};

/// Longest time after which every model but an encoder shows its time: that of a wrap of 15 bits.
const SHOWN_US: u64 = 1 << 15;

/// The largest sensor that a model has.
fn sensor(model: &dyn Model) -> Sensor {
    let sizes = [
        (1280, 720),
        (640, 480),
        (346, 260),
        (320, 320),
        (240, 180),
        (128, 128),
    ];
    let mut sensors = sizes
        .iter()
        .filter_map(|&(width, height)| Sensor::new(width, height));
    sensors
        .find(|&sensor| model.writer(sensor).is_some())
        .unwrap()
}

/// Models that send words of time: not encoders, which send frames.
fn models() -> impl Iterator<Item = (&'static dyn Model, Sensor)> {
    let all = MODELS.iter().filter(|model| model.name() != "eecvs");
    all.map(|model| (*model, sensor(*model)))
}

fn parse(model: &dyn Model, sensor: Sensor, bytes: &[u8]) -> (Vec<Event>, Option<u64>) {
    let stream = match model.name() {
        "evk4-evt21" => "evt21-upper-first",
        "evk3-genx320" => "evt21",
        _ => model.streams()[0],
    };
    let info = model.describe(sensor, stream).unwrap();
    let mut parser = model.parser(&info);
    let mut events = Vec::new();
    parser.parse(bytes, &mut events);
    assert_eq!(
        parser.losses().iter().count(),
        0,
        "{}: {:?}",
        model.name(),
        parser.losses()
    );
    (events, parser.time_us())
}

fn events(steps: &[(u64, u64)]) -> Vec<Event> {
    let mut t_us = 0;
    let mut number = 0_u16;
    let mut event = |(before, _): &(u64, u64)| {
        t_us += before;
        number += 1;
        Event {
            t_us,
            x: number % 128,
            y: number / 128 % 128,
            polarity: Polarity::from_bool(number.is_multiple_of(3)),
        }
    };
    steps.iter().map(&mut event).collect()
}

/// The gap before each event, and the part of it, in thousandths, after which the time is shown.
fn steps() -> impl Strategy<Value = Vec<(u64, u64)>> {
    let gap = prop_oneof![
        5 => 0..3_u64,
        3 => 0..40_000_u64,
        2 => (0..4_u64).prop_map(|periods| periods << 15),
        1 => 0..5_000_000_u64,
    ];
    prop::collection::vec((gap, 0..1000_u64), 1..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn shown_times_change_no_event(steps in steps(), last in 0..200_000_u64) {
        let events = events(&steps);
        for (model, sensor) in models() {
            let mut writer = model.writer(sensor).unwrap();
            let (mut bytes, mut before) = (Vec::new(), 0);
            for (event, (gap, part)) in events.iter().zip(&steps) {
                writer.advance(before + gap * part / 1000, &mut bytes);
                writer.write(std::slice::from_ref(event), &mut bytes).unwrap();
                before = event.t_us;
            }
            writer.advance(before + last, &mut bytes);
            let (got, time_us) = parse(model, sensor, &bytes);
            let is_held = got.len() < events.len();
            prop_assert!(!is_held || last == 0, "{}", model.name());
            if is_held {
                // A frame is sent when its time is over.
                continue;
            }
            prop_assert_eq!(&got, &events, "{}", model.name());
            let shown_us = time_us.unwrap();
            prop_assert!(shown_us + SHOWN_US > before + last, "{}: {}", model.name(), shown_us);
            prop_assert!(shown_us <= before + last, "{}: {}", model.name(), shown_us);
        }
    }

    #[test]
    fn after_a_reset_times_count_from_it(steps in steps(), other in steps()) {
        let (first, second) = (events(&steps), events(&other));
        for (model, sensor) in models() {
            let mut writer = model.writer(sensor).unwrap();
            let mut bytes = Vec::new();
            writer.write(&first, &mut bytes).unwrap();
            if !writer.reset_time(&mut bytes) {
                continue;
            }
            writer.write(&second, &mut bytes).unwrap();
            writer.finish(&mut bytes).unwrap();
            let (got, _) = parse(model, sensor, &bytes);
            prop_assert_eq!(got.len(), first.len() + second.len());
            // The parser goes on from the last time before the reset.
            let from_us = first.last().unwrap().t_us;
            let shifted = second.iter().map(|event| Event { t_us: event.t_us + from_us, ..*event });
            let want: Vec<Event> = first.iter().copied().chain(shifted).collect();
            prop_assert_eq!(&got, &want, "{}", model.name());
        }
    }

    #[test]
    fn a_second_start_is_as_the_first(steps in steps(), other in steps()) {
        for (model, sensor) in models() {
            let mut writer = model.writer(sensor).unwrap();
            let (mut bytes, mut again) = (Vec::new(), Vec::new());
            writer.write(&events(&other), &mut bytes).unwrap();
            writer.advance(1 << 30, &mut bytes);
            writer.restart();
            writer.write(&events(&steps), &mut again).unwrap();
            bytes.clear();
            model.writer(sensor).unwrap().write(&events(&steps), &mut bytes).unwrap();
            prop_assert_eq!(&bytes, &again, "{}", model.name());
        }
    }
}

/// The words of a DAVIS and of a DVXplorer hold no time of 0, as those of their logic.
#[test]
fn no_word_holds_a_time_of_zero() {
    let times = [
        0,
        0,
        5,
        32_767,
        32_768,
        32_768,
        65_536,
        1 << 20,
        (1 << 20) + 1,
    ];
    for name in ["davis240", "davis346", "dvxplorer"] {
        let model = usb_bridge::device::find(name).unwrap();
        let sensor = sensor(model);
        let event = |t_us: &u64| Event {
            t_us: *t_us,
            x: 1,
            y: 2,
            polarity: Polarity::On,
        };
        let events: Vec<Event> = times.iter().map(event).collect();
        let mut writer = model.writer(sensor).unwrap();
        let mut bytes = Vec::new();
        writer.write(&events, &mut bytes).unwrap();
        writer.reset_time(&mut bytes);
        writer.write(&events, &mut bytes).unwrap();
        let words = bytes
            .chunks_exact(2)
            .map(|word| u16::from_le_bytes([word[0], word[1]]));
        assert!(words.clone().all(|word| word != 0x8000), "{name}");
        // Some hosts count each word as one wrap.
        assert!(
            words.clone().all(|word| word >> 12 != 7 || word == 0x7001),
            "{name}"
        );
        let resets = words.filter(|word| *word == 1).count();
        assert_eq!(resets, 1, "{name}");
        let (got, _) = parse(model, sensor, &bytes);
        assert_eq!(got.len(), 2 * events.len(), "{name}");
        assert_eq!(got[..events.len()], events, "{name}");
    }
}
