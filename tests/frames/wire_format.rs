//! The worked example of docs/wire-format.md is what the encoder writes.

use eecvs_nostd::{Config, Event, Polarity, Sensor, Transform};
use strategies::{encode, plain_config};

#[test]
fn the_documents_example_is_true() {
    let config = Config {
        grid: Some(4),
        ..plain_config(
            Sensor {
                width: 8,
                height: 4,
            },
            Transform::Dwt,
            2,
        )
    };
    let event = Event {
        t_us: 1000,
        x: 3,
        y: 1,
        polarity: Polarity::On,
    };
    let frames = encode(config, &[event], 10, 4096);
    let document = include_str!("../../docs/wire-format.md");
    let example = document
        .split("## Worked example")
        .nth(1)
        .and_then(|rest| rest.split("\n# ").next())
        .expect("the example's section");
    let hex: String = example
        .lines()
        .filter_map(|line| line.split_once(" | `")?.1.split_once('`'))
        .flat_map(|(bytes, _)| bytes.split(' '))
        .collect();
    let found: String = frames
        .concat()
        .iter()
        .map(|byte| format!("{byte:02X}"))
        .collect();
    assert_eq!(hex, found);
}
