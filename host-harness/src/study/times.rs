//! Errors of the decoded events' times.

use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::Event;
use serde::{Deserialize, Serialize};

use super::method::{Method, Trip};
use super::set::Set;

/// Upper ends of the bins in us; the first bin is for exact times. No error exceeds the last, since a window ends
/// there.
pub const EDGES_US: [u64; 16] = [
    0, 1, 3, 7, 15, 31, 63, 127, 255, 511, 1023, 2047, 4095, 8191, 16_383, 32_767,
];

/// Histogram of the time errors of a method on a source.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Times {
    /// `scenes` or `recordings`.
    pub set: String,
    /// Name of the source in the set.
    pub source: String,
    /// Name of the method, see [`Method::name`].
    pub method: String,
    /// Number of coefficients or channels; 0 if events are sent.
    pub m: u8,
    /// Setting of the method, see [`Method::setting`].
    pub setting: String,
    /// Number of events of the source whose time error is at most [`EDGES_US`] of the bin, and above the edge
    /// before.
    pub counts: [u64; EDGES_US.len()],
    /// Number of events of the source that are not paired, because another number of events was decoded in their
    /// place.
    pub unpaired: u64,
}

/// Pairs the original and decoded events of each window, pixel and polarity in order of time, which is the pairing
/// of least cost, if their numbers agree; counts the errors.
#[must_use]
pub fn measure(set: &Set, source: &Source, method: Method, trip: &Trip) -> Times {
    let mut times = Times {
        set: set.name.to_owned(),
        source: source.name.clone(),
        method: method.name().to_owned(),
        m: method.m(),
        setting: method.setting(),
        counts: [0; EDGES_US.len()],
        unpaired: 0,
    };
    let start_us = source.start_us();
    let place = |event: &Event| {
        let window = event.t_us.saturating_sub(start_us) / u64::from(WINDOW_US);
        (window, event.y, event.x, event.polarity)
    };
    let sorted = |events: &[Event]| {
        let mut events = events.to_vec();
        events.sort_unstable_by_key(|event| (place(event), event.t_us));
        events
    };
    let (original, decoded) = (sorted(&source.events), sorted(&trip.events));
    let mut rest = &decoded[..];
    for group in original.chunk_by(|a, b| place(a) == place(b)) {
        let Some(at) = group.first().map(place) else {
            continue;
        };
        rest = rest
            .get(rest.partition_point(|event| place(event) < at)..)
            .unwrap_or_default();
        let (same, after) = rest.split_at(rest.partition_point(|event| place(event) == at));
        rest = after;
        if same.len() != group.len() {
            times.unpaired += group.len() as u64;
            continue;
        }
        for (a, b) in group.iter().zip(same) {
            let bin = EDGES_US.partition_point(|edge| *edge < a.t_us.abs_diff(b.t_us));
            if let Some(count) = times.counts.get_mut(bin) {
                *count += 1;
            }
        }
    }
    times
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Coder, Fidelity, Thresholds};
    use event_types::test_events::{SENSOR, event};

    use super::*;
    use crate::study::set::SCENES;

    #[test]
    fn events_are_paired_where_as_many_came_back() {
        let source = Source {
            name: "test".to_owned(),
            sensor: SENSOR,
            events: vec![
                event(0, 1, 1, true),
                event(100, 1, 1, true),
                event(100, 1, 1, false),
                event(200, 5, 1, false),
                event(40_000, 1, 1, true),
            ]
            .into(),
        };
        let trip = Trip {
            bytes: 0,
            packed_bytes: 0,
            seconds: 0.0,
            // The two events of the first group are off by 3 and 4 us, the third is exact and the fourth is lost;
            // the last one has two in its place.
            events: vec![
                event(104, 1, 1, true),
                event(3, 1, 1, true),
                event(100, 1, 1, false),
                event(40_000, 1, 1, true),
                event(41_000, 1, 1, true),
            ],
            has_times: true,
            windows: [0; 3],
        };
        let set = Set {
            name: SCENES,
            sources: Vec::new(),
            thresholds: Thresholds::new(0, 0).unwrap(),
            tau: [0.0; 2],
        };
        let method = Method::Hybrid {
            coder: Coder::Dense,
            fidelity: Fidelity::Lossless,
        };
        let times = measure(&set, &source, method, &trip);
        assert_eq!(times.counts[..4], [1, 0, 1, 1]);
        assert_eq!(times.counts.iter().sum::<u64>(), 3);
        assert_eq!(times.unpaired, 2);
    }
}
