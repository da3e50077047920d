//! What the tests share: models with their sensors, streams of events, counts.

use eecvs_nostd::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use usb_bridge::device::{Info, Model, Parse, find};

/// Every model with the sizes that it is tested with.
pub const MODELS: [(&str, u16, u16); 7] = [
    ("dvs128", 128, 128),
    ("davis240", 240, 180),
    ("davis346", 346, 260),
    ("dvxplorer", 640, 480),
    ("dvxplorer", 320, 240),
    ("dvxplorer", 33, 45),
    ("dvxplorer-mipi", 640, 480),
];

pub fn model(name: &str) -> &'static dyn Model {
    find(name).expect("it is registered")
}

pub fn sensor(width: u16, height: u16) -> Sensor {
    Sensor::new(width, height).expect("a sensor")
}

pub fn parser(name: &str, sensor: Sensor) -> Box<dyn Parse> {
    model(name).parser(&Info {
        name: name.into(),
        serial: None,
        firmware: String::new(),
        sensor,
        stream: "",
    })
}

/// The stream of events.
pub fn write(name: &str, sensor: Sensor, events: &[Event]) -> Vec<u8> {
    let mut writer = model(name).writer(sensor).expect("it fits");
    let mut bytes = Vec::new();
    writer.write(events, &mut bytes).expect("events in order");
    writer.finish(&mut bytes).expect("events in order");
    bytes
}

pub fn parse(name: &str, sensor: Sensor, bytes: &[u8]) -> Vec<Event> {
    let mut events = Vec::new();
    parser(name, sensor).parse(bytes, &mut events);
    events
}

/// Events of one time may come in another order from a device with frames: the rest is exact.
pub fn sorted_frames(name: &str, mut events: Vec<Event>) -> Vec<Event> {
    if name == "dvxplorer-mipi" {
        events.sort_by_key(|event| (event.t_us, event.x));
    }
    events
}

/// Numbers from a seed.
pub struct Numbers(Xoshiro256PlusPlus);

impl Numbers {
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// A number below `end`.
    pub fn below(&mut self, end: u64) -> u64 {
        self.0.next_u64() % end
    }
}

/// Events as a scene has them: runs of one time, columns of neighbours, quiet times over wraps.
pub fn scene(sensor: Sensor, count: usize, seed: u64) -> Vec<Event> {
    let mut numbers = Numbers::new(seed);
    let mut events = Vec::with_capacity(count);
    let mut t_us = 0;
    while events.len() < count {
        t_us += match numbers.below(2000) {
            0 => numbers.below(3_000_000),
            1..20 => numbers.below(4000),
            _ => numbers.below(40),
        };
        let (x, mut y) = (
            numbers.below(sensor.width.into()),
            numbers.below(sensor.height.into()),
        );
        for _ in 0..=numbers.below(4) {
            events.push(Event {
                t_us,
                x: x as u16,
                y: y as u16,
                polarity: Polarity::from_bool(numbers.below(3) == 0),
            });
            y = (y + numbers.below(3)).min(u64::from(sensor.height) - 1);
        }
    }
    events
}
