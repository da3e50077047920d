//! Metrics, line by line as the text format has them.

use eecvs_hub::board::{Board, HubFigures};
use eecvs_hub::message::Status;
use event_emulator::Preset;

use super::EXACT;
use crate::feed::{Way, answer_clock, name, scene, stamp};

/// A sample of the text format: its name, labels and value.
fn sample(line: &str) -> (String, Vec<(String, String)>, f64) {
    let (series, value) = line.rsplit_once(' ').unwrap();
    let (name, labels) = series.split_once('{').unwrap_or((series, "}"));
    let good = |name: &str| {
        let letter = |c: char| c.is_ascii_lowercase() || c == '_' || c.is_ascii_digit();
        !name.is_empty() && name.chars().all(letter)
    };
    assert!(good(name), "{line}");
    let mut rest = labels.strip_suffix('}').unwrap();
    let mut found = Vec::new();
    while !rest.is_empty() {
        let (label, after) = rest.split_once("=\"").unwrap();
        assert!(good(label), "{line}");
        let mut text = String::new();
        let mut letters = after.chars();
        loop {
            match letters.next().expect(line) {
                '\\' => text.push(match letters.next().expect(line) {
                    'n' => '\n',
                    other => other,
                }),
                '"' => break,
                other => text.push(other),
            }
        }
        found.push((label.to_owned(), text));
        rest = letters.as_str();
        rest = rest.strip_prefix(',').unwrap_or(rest);
    }
    (name.to_owned(), found, value.parse().expect(line))
}

#[test]
fn metrics_are_in_the_text_format() {
    let board = Board::new("a \"hub\" \\ of\nlines");
    let scene = scene(Preset::IndoorFlying, Way::of(EXACT));
    for at in ["one", "two/three"] {
        for (number, frame) in scene.frames.iter().enumerate() {
            // A clock that is an hour behind.
            board.frame(&name(at), stamp(1, 2 * number as u64, 3_603_000_000), frame);
            if number == 0 {
                answer_clock(&board, &name(at), 1, -3_600_000_000);
            }
        }
    }
    let status = Status {
        run: 1,
        budget: Some(77),
        outages_us: 1_500_000,
        ..Status::default()
    };
    board.status(&name("one"), status);
    board.hub(HubFigures {
        routers: 2,
        receivers: 5,
    });
    let text = board.metrics();
    let (body, end) = text.rsplit_once("# EOF\n").unwrap();
    assert_eq!(end, "");
    let mut kinds = std::collections::BTreeMap::new();
    let (mut samples, mut family) = (Vec::new(), String::new());
    for line in body.lines() {
        if let Some(rest) = line.strip_prefix("# ") {
            let mut words = rest.splitn(3, ' ');
            let (what, name, text) = (words.next(), words.next().unwrap(), words.next().unwrap());
            match what {
                Some("HELP") => assert!(!text.is_empty()),
                Some("TYPE") => {
                    family = name.to_owned();
                    assert_eq!(
                        kinds.insert(family.clone(), text.to_owned()),
                        None,
                        "{line}"
                    );
                }
                _ => panic!("{line}"),
            }
            continue;
        }
        let (name, labels, value) = sample(line);
        let expected = match kinds[&family].as_str() {
            "counter" => format!("{family}_total"),
            "gauge" => family.clone(),
            other => panic!("{other}"),
        };
        assert_eq!(name, expected);
        assert!(value.is_finite(), "{line}");
        let series = (name, labels);
        assert!(
            samples.iter().all(|(other, _)| *other != series),
            "twice: {line}"
        );
        samples.push((series, value));
    }
    let value = |name: &str, labels: &[(&str, &str)]| {
        let labels: Vec<_> = labels
            .iter()
            .map(|(label, text)| ((*label).to_owned(), (*text).to_owned()))
            .collect();
        let found = samples
            .iter()
            .find(|(series, _)| *series == (name.to_owned(), labels.clone()));
        found.map(|(_, value)| *value)
    };
    let hub = [("hub", "a \"hub\" \\ of\nlines")];
    assert_eq!(value("eecvs_hub_routers", &hub), Some(2.0));
    assert_eq!(value("eecvs_hub_receivers", &hub), Some(5.0));
    let frames = scene.frames.len() as f64;
    for at in ["one", "two/three"] {
        let sensor = [("sensor", at)];
        assert_eq!(value("eecvs_received_frames_total", &sensor), Some(frames));
        let missing = [("sensor", at), ("run", "latest")];
        assert_eq!(value("eecvs_missing_frames", &missing), Some(frames - 1.0));
        let latency = [("sensor", at), ("quantile", "0.99")];
        let latency = value("eecvs_latency_seconds", &latency).unwrap();
        assert!((2.9..60.0).contains(&latency), "{latency}");
        let ahead_s = value("eecvs_clock_ahead_seconds", &sensor).unwrap();
        assert!((ahead_s + 3600.0).abs() < 0.01, "{ahead_s}");
        assert!(value("eecvs_clock_error_seconds", &sensor).unwrap() < 0.01);
        assert_eq!(value("eecvs_sensors_at_once", &sensor), Some(1.0));
    }
    assert_eq!(
        value("eecvs_budget_bytes_per_second", &[("sensor", "one")]),
        Some(77.0)
    );
    assert_eq!(
        value("eecvs_budget_bytes_per_second", &[("sensor", "two/three")]),
        None
    );
    assert_eq!(
        value("eecvs_outages_seconds_total", &[("sensor", "one")]),
        Some(1.5)
    );
    assert!(samples.len() > 50);
}
