//! The board's figures in OpenMetrics' text format.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, text};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::Registry;

use super::Overview;
use super::row::Row;

/// First part of the names of all metrics.
const PREFIX: &str = "eecvs";

/// Names of the regimes, in the order of a row's windows.
const REGIMES: [&str; 3] = ["sparse", "moderate", "dense"];

/// Returns the text for a board.
pub(super) fn text(board: Overview) -> String {
    let mut registry = Registry::with_prefix(PREFIX);
    registry.register_collector(Box::new(board));
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = text::encode(&mut text, &registry);
    text
}

/// A metric with one value per sensor, or one per sensor and kind.
struct Metric {
    name: &'static str,
    help: &'static str,
    /// Label of the kinds; empty if the metric has no kinds.
    label: &'static str,
    kind: MetricType,
    values: fn(&Row) -> Vec<(&'static str, f64)>,
}

/// Creates a metric that counts from the start of the sensor or the hub.
const fn counter(
    name: &'static str,
    help: &'static str,
    label: &'static str,
    values: fn(&Row) -> Vec<(&'static str, f64)>,
) -> Metric {
    let kind = MetricType::Counter;
    Metric {
        name,
        help,
        label,
        kind,
        values,
    }
}

/// Creates a metric that goes up and down.
const fn gauge(
    name: &'static str,
    help: &'static str,
    label: &'static str,
    values: fn(&Row) -> Vec<(&'static str, f64)>,
) -> Metric {
    let kind = MetricType::Gauge;
    Metric {
        name,
        help,
        label,
        kind,
        values,
    }
}

/// Returns the value of a metric without kinds.
fn one(value: f64) -> Vec<(&'static str, f64)> {
    vec![("", value)]
}

/// Returns the value of a metric without kinds, if it is known.
fn known(value: Option<f64>) -> Vec<(&'static str, f64)> {
    value.into_iter().flat_map(one).collect()
}

const METRICS: &[Metric] = &[
    gauge(
        "sensor_connected",
        "Whether the sensor is connected",
        "",
        |row| one(f64::from(u8::from(row.is_connected))),
    ),
    counter(
        "received_frames",
        "Frames that arrived at this hub, without repetitions",
        "",
        |row| one(row.frames_received as f64),
    ),
    counter("received_bytes", "Bytes of these frames", "", |row| {
        one(row.bytes_received as f64)
    }),
    counter("received_events", "Events in these frames", "", |row| {
        one(row.events_received as f64)
    }),
    counter(
        "received_windows",
        "Windows that arrived at this hub",
        "regime",
        |row| {
            let windows = REGIMES.into_iter().zip(row.windows);
            windows
                .map(|(regime, count)| (regime, count as f64))
                .collect()
        },
    ),
    gauge(
        "frame_age_seconds",
        "Time since the last frame arrived",
        "",
        |row| row.frame_age_s.into_iter().flat_map(one).collect(),
    ),
    gauge(
        "latency_seconds",
        "Time from a window's end to its arrival, corrected for the difference between the clocks",
        "quantile",
        |row| {
            let latency = row.latency.map(|latency| {
                let seconds = |us| us as f64 / 1e6;
                [
                    ("0.5", seconds(latency.p50_us)),
                    ("0.99", seconds(latency.p99_us)),
                ]
            });
            latency.into_iter().flatten().collect()
        },
    ),
    gauge(
        "clock_ahead_seconds",
        "How far the sensor's clock is ahead of this hub's",
        "",
        |row| known(row.clock.map(|clock| clock.ahead_us as f64 / 1e6)),
    ),
    gauge(
        "clock_error_seconds",
        "Bound on the error of the difference between the clocks, and of latencies",
        "",
        |row| known(row.clock.map(|clock| clock.error_us as f64 / 1e6)),
    ),
    gauge(
        "sensors_at_once",
        "Sensors that send under this name now; the figures of several sensors are mixed",
        "",
        |row| one(row.at_once as f64),
    ),
    counter(
        "lost_events",
        "Events that are in no frame, as reported by the sensor",
        "cause",
        |row| {
            let losses = &row.losses;
            vec![
                ("late", losses.events_late as f64),
                ("filtered", losses.events_filtered as f64),
                ("dropped", losses.events_dropped as f64),
                ("thinned", losses.events_thinned as f64),
            ]
        },
    ),
    gauge(
        "missing_frames",
        "Frames that exist and have not arrived at this hub",
        "run",
        |row| {
            let losses = &row.losses;
            vec![
                ("latest", losses.frames_missing as f64),
                ("earlier", losses.frames_missing_before as f64),
            ]
        },
    ),
    counter(
        "lost_frames",
        "Frames that were lost for good",
        "cause",
        |row| {
            vec![
                ("damaged", row.losses.frames_damaged as f64),
                ("let_go", row.losses.frames_let_go as f64),
            ]
        },
    ),
    counter("repeated_frames", "Frames that arrived again", "", |row| {
        one(row.losses.frames_repeated as f64)
    }),
    counter(
        "disk_failures",
        "Frames that the sensor could not write to disk",
        "",
        |row| one(row.losses.disk_failures as f64),
    ),
    counter(
        "disk_damaged_frames",
        "Frames in the sensor's store on disk that are damaged or missing",
        "",
        |row| one(row.losses.disk_damaged_frames as f64),
    ),
    counter(
        "malformed_messages",
        "Messages that could not be read",
        "",
        |row| one(row.losses.malformed as f64),
    ),
    counter("outages", "Times that the sensor had no link", "", |row| {
        one(row.losses.outages as f64)
    }),
    counter("outages_seconds", "Time without a link", "", |row| {
        one(row.losses.outages_s)
    }),
    gauge(
        "budget_bytes_per_second",
        "Bytes per second to which the sensor is limited",
        "",
        |row| {
            row.budget
                .into_iter()
                .flat_map(|budget| one(budget.into()))
                .collect()
        },
    ),
    gauge(
        "congested",
        "Whether the sensor lowers its rate because of its link",
        "",
        |row| one(f64::from(u8::from(row.is_congested))),
    ),
    gauge(
        "store_bytes",
        "Bytes that the sensor's store takes",
        "place",
        |row| {
            vec![
                ("memory", row.store_memory_bytes as f64),
                ("disk", row.store_disk_bytes as f64),
            ]
        },
    ),
    gauge(
        "store_damaged_bytes",
        "Bytes of damaged records among those on disk",
        "",
        |row| one(row.store_damaged_bytes as f64),
    ),
];

impl Metric {
    fn encode(&self, board: &Overview, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let mut family = encoder.encode_descriptor(self.name, self.help, None, self.kind)?;
        for row in &board.sensors {
            for (kind, value) in (self.values)(row) {
                let labels = [("sensor", row.name.as_str()), (self.label, kind)];
                let labels = if self.label.is_empty() {
                    &labels[..1]
                } else {
                    &labels[..]
                };
                let metric = family.encode_family(&labels)?;
                match self.kind {
                    MetricType::Counter => ConstCounter::new(value).encode(metric)?,
                    _ => ConstGauge::new(value).encode(metric)?,
                }
            }
        }
        Ok(())
    }
}

impl Collector for Overview {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let own = [
            (
                "hub_routers",
                "Other hubs linked to this hub",
                self.figures.routers as f64,
            ),
            (
                "hub_receivers",
                "Receivers with a link to any hub",
                self.figures.receivers as f64,
            ),
            ("hub_sensors", "Known sensors", self.sensors.len() as f64),
        ];
        let labels = [("hub", self.hub.as_str())];
        for (name, help, value) in own {
            let mut family = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
            ConstGauge::new(value).encode(family.encode_family(&labels)?)?;
        }
        let own = [
            (
                "hub_refused_messages",
                "Messages from sensors that the hub has no room for",
                self.refused,
            ),
            (
                "hub_malformed_messages",
                "Messages that could not be read and are from no known sensor",
                self.malformed,
            ),
        ];
        for (name, help, value) in own {
            let mut family = encoder.encode_descriptor(name, help, None, MetricType::Counter)?;
            ConstCounter::new(value).encode(family.encode_family(&labels)?)?;
        }
        METRICS
            .iter()
            .try_for_each(|metric| metric.encode(self, &mut encoder))
    }
}
