//! Lamps switch at their own times.

use event_emulator::{Effect, Light, PixelArray, PixelParameters, Preset, Tile};
use event_types::{Event, Polarity, Sensor};

use crate::{events_of, whole};

/// The scene's lamp: a square wave of 180 Hz. Its inner columns and rows.
const LAMP: (std::ops::Range<u16>, std::ops::Range<u16>) = (160..172, 105..113);

/// Period in us.
const PERIOD_US: f64 = 1e6 / 180.0;

/// Returns the mean time in us of the ON events of each cycle of a second but the first, in which all pixels are new,
/// and the last, which is cut. A cycle begins in the middle of the dark half.
fn bursts<'a>(lamp: impl Iterator<Item = &'a Event>) -> Vec<f64> {
    let mut cycles: Vec<Vec<f64>> = vec![Vec::new(); 180];
    for event in lamp {
        let t_us = event.t_us as f64 + 0.25 * PERIOD_US;
        cycles[((t_us / PERIOD_US) as usize).min(179)].push(event.t_us as f64);
    }
    let cycles = cycles[1..179].iter();
    cycles
        .map(|times| {
            assert!(times.len() > 50, "{} events", times.len());
            times.iter().sum::<f64>() / times.len() as f64
        })
        .collect()
}

#[test]
fn bursts_of_a_lamp_of_180_hz_are_5_56_ms_apart() {
    let events = events_of(whole(Preset::Motorcycle, 1));
    let lamp = events.iter().filter(|event| {
        let is_inside = LAMP.0.contains(&event.x) && LAMP.1.contains(&event.y);
        is_inside && event.polarity == Polarity::On
    });
    let bursts = bursts(lamp);
    let mut apart: Vec<f64> = bursts.windows(2).map(|pair| pair[1] - pair[0]).collect();
    apart.sort_by(f64::total_cmp);
    let (middle, count) = (apart[apart.len() / 2], apart.len());
    let mean = (bursts[count] - bursts[0]) / count as f64;
    println!(
        "bursts {mean:.1} us apart, median {middle:.1} us, 9 of 10 within {:.1} to {:.1} us",
        apart[count / 20],
        apart[count - 1 - count / 20]
    );
    assert!((mean - PERIOD_US).abs() < 20.0, "{mean}");
    assert!((middle - PERIOD_US).abs() < 20.0, "{middle}");
}

/// A lamp of 180 Hz that lights all pixels and nothing else.
struct Lamp;

impl Light for Lamp {
    fn sensor(&self) -> Sensor {
        Sensor {
            width: 32,
            height: 32,
        }
    }

    fn sample(&self, _: Tile, t_ns: u64, ln_lux: &mut [f32]) {
        // Half cycle k begins at ceil(k 10^9 / 360) ns.
        let half = (t_ns * 360) / 1_000_000_000;
        ln_lux.fill(if half.is_multiple_of(2) { 6.0 } else { 4.8 });
    }

    fn rate_bound(&self, _: Tile, _: u64, _: u64) -> f64 {
        0.0
    }

    fn next_switch_ns(&self, _: Tile, after_ns: u64) -> u64 {
        let half = (after_ns * 360) / 1_000_000_000;
        ((half + 1) * 1_000_000_000).div_ceil(360)
    }
}

#[test]
fn every_burst_of_a_lamp_alone_is_5_56_ms_after_the_one_before() {
    // Shot noise spreads the events of a burst over half a millisecond, and their mean by some 10 us.
    let mut quiet = PixelParameters::default();
    quiet.switch_off(Effect::ShotNoise);
    let mut array = PixelArray::new(Lamp, &quiet, 1).expect("parameters");
    let mut events = Vec::new();
    while array.read(1_000, (0, 1_000_000), &mut events, None) > 0 {}
    let lamp = events.iter().filter(|event| event.polarity == Polarity::On);
    let bursts = bursts(lamp);
    let (mut least, mut most) = (f64::MAX, 0.0_f64);
    for pair in bursts.windows(2) {
        (least, most) = (least.min(pair[1] - pair[0]), most.max(pair[1] - pair[0]));
    }
    println!("bursts {least:.1} to {most:.1} us apart");
    assert!(
        PERIOD_US - least < 20.0 && most - PERIOD_US < 20.0,
        "{least} to {most}"
    );
}
