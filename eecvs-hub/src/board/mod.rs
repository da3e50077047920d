//! What a hub knows of its sensors: rows, pictures, metrics, and a live page that shows them.
//!
//! Frames are not decoded on arrival; only their headers are read. While somebody looks at a sensor's picture, its
//! frames are kept from a key frame on, which decodes on its own, and they are decoded when the picture is fetched.
//! Memory is bounded, by the number of sensors and the bytes of each, whatever is published.

mod connections;
pub mod kept;
pub mod latency;
mod metrics;
pub mod page;
pub mod picture;
pub mod rate;
pub mod row;
pub mod runs;
mod sensor;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use eecvs_nostd::Frame;
use serde::Serialize;

pub use row::Row;
use sensor::{Arrived, Moment, Sensor};

use crate::clock::{Clock, RoundTrip};
use crate::key::Name;
use crate::message::{Stamp, Status, now_us};

/// Maximum number of sensors on a board.
pub const SENSORS_MAX: usize = 10_000;

/// Counts of a hub's links.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct HubFigures {
    /// Number of other hubs with a link to this one.
    pub routers: usize,
    /// Number of receivers with a link to this hub, or to another hub with a link to this one.
    pub receivers: usize,
}

/// The state of a board at one moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Overview {
    /// Name of the hub.
    pub hub: String,
    /// Time by this computer's clock, in microseconds since 1970.
    pub now_us: u64,
    /// Counts of the hub's links.
    #[serde(flatten)]
    pub figures: HubFigures,
    /// Number of connected sensors.
    pub connected: usize,
    /// Messages of sensors that the board has no room for.
    pub refused: u64,
    /// Unreadable messages that belong to no known sensor.
    pub malformed: u64,
    /// The sensors, sorted by name.
    pub sensors: Vec<Row>,
}

/// What a hub knows of its sensors.
#[derive(Debug)]
pub struct Board {
    hub: String,
    clock: Clock,
    sensors: RwLock<BTreeMap<Name, Arc<Sensor>>>,
    refused: AtomicU64,
    malformed: AtomicU64,
    figures: Mutex<HubFigures>,
}

impl Board {
    /// Creates the board of a hub with this name.
    #[must_use]
    pub fn new(hub: &str) -> Self {
        Self {
            hub: hub.to_owned(),
            clock: Clock::start(),
            sensors: RwLock::default(),
            refused: AtomicU64::new(0),
            malformed: AtomicU64::new(0),
            figures: Mutex::default(),
        }
    }

    fn now(&self) -> Moment {
        let up_us = self.clock.up_us();
        Moment {
            at: Duration::from_micros(up_us),
            unix_us: self.clock.origin_us().saturating_add(up_us),
        }
    }

    /// Returns the clock by which the board measures.
    #[must_use]
    pub const fn clock(&self) -> Clock {
        self.clock
    }

    /// Returns a known sensor.
    fn known(&self, name: &Name) -> Option<Arc<Sensor>> {
        let sensors = self.sensors.read().unwrap_or_else(PoisonError::into_inner);
        sensors.get(name).cloned()
    }

    /// Returns a sensor, adding it if it is new; `None` if there are too many.
    fn sensor(&self, name: &Name) -> Option<Arc<Sensor>> {
        if let Some(sensor) = self.known(name) {
            return Some(sensor);
        }
        let mut sensors = self.sensors.write().unwrap_or_else(PoisonError::into_inner);
        if sensors.len() >= SENSORS_MAX && !sensors.contains_key(name) {
            self.refused.fetch_add(1, Ordering::Relaxed);
            return None;
        }
        Some(Arc::clone(sensors.entry(name.clone()).or_default()))
    }

    /// Records a frame that has arrived. Its checksums and its header are read; its payload is not.
    pub fn frame(&self, name: &Name, stamp: Stamp, frame: &[u8]) {
        let Some(sensor) = self.sensor(name) else {
            return;
        };
        let parsed = Frame::parse(frame).ok();
        // Bytes after a frame count as damage too.
        let parsed = parsed.filter(|parsed| parsed.bytes == frame.len());
        let arrived = Arrived {
            stamp,
            header: parsed.as_ref().map(|parsed| &parsed.header),
            bytes: frame,
        };
        sensor.frame(self.now(), arrived);
    }

    /// Records the latest status that a sensor sent.
    pub fn status(&self, name: &Name, status: Status) {
        if let Some(sensor) = self.sensor(name) {
            sensor.status(self.now(), status);
        }
    }

    /// Records what a sensor's clock showed on request.
    pub fn trip(&self, name: &Name, trip: RoundTrip) {
        if let Some(sensor) = self.known(name) {
            sensor.trip(trip);
        }
    }

    /// Returns the sensors to ask for their clocks now, and records that they are asked.
    #[must_use]
    pub fn clocks_due(&self) -> Vec<Name> {
        let now = self.now();
        let sensors = self.all().into_iter();
        let due = sensors.filter(|(_, sensor)| sensor.is_clock_due(now));
        due.map(|(name, _)| name).collect()
    }

    /// Returns the names under which several sensors send at present, each with their number.
    #[must_use]
    pub fn shared_names(&self) -> Vec<(Name, usize)> {
        let now = self.now();
        let sensors = self.all().into_iter();
        let counts = sensors.map(|(name, sensor)| (name, sensor.at_once(now)));
        counts.filter(|(_, count)| *count > 1).collect()
    }

    /// Records that a sensor's token has appeared or disappeared.
    pub fn alive(&self, name: &Name, is_alive: bool) {
        if let Some(sensor) = self.sensor(name) {
            sensor.alive(is_alive);
        }
    }

    /// Counts an unreadable message, under a sensor's name if that sensor is known.
    pub fn malformed(&self, name: Option<&Name>) {
        match name.and_then(|name| self.known(name)) {
            Some(sensor) => sensor.malformed(),
            None => {
                self.malformed.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Records the counts of the hub's links.
    pub fn hub(&self, figures: HubFigures) {
        *self.figures.lock().unwrap_or_else(PoisonError::into_inner) = figures;
    }

    /// Notes that somebody looks at a sensor: for ten seconds, frames for its picture are kept.
    pub fn want(&self, name: &Name) {
        if let Some(sensor) = self.known(name) {
            sensor.want(self.now());
        }
    }

    /// Returns all sensors, sorted by name.
    fn all(&self) -> Vec<(Name, Arc<Sensor>)> {
        let sensors = self.sensors.read().unwrap_or_else(PoisonError::into_inner);
        // Writers wait for readers, so hold the lock only to copy the references.
        sensors
            .iter()
            .map(|(name, sensor)| (name.clone(), Arc::clone(sensor)))
            .collect()
    }

    /// Returns what is known of each sensor, sorted by name.
    #[must_use]
    pub fn rows(&self) -> Vec<Row> {
        let sensors = self.all();
        let now = self.now();
        sensors
            .iter()
            .map(|(name, sensor)| sensor.row(name, now))
            .collect()
    }

    /// Returns the state of the whole board.
    #[must_use]
    pub fn overview(&self) -> Overview {
        let sensors = self.rows();
        Overview {
            hub: self.hub.clone(),
            now_us: now_us(),
            figures: *self.figures.lock().unwrap_or_else(PoisonError::into_inner),
            connected: sensors.iter().filter(|row| row.is_connected).count(),
            refused: self.refused.load(Ordering::Relaxed),
            malformed: self.malformed.load(Ordering::Relaxed),
            sensors,
        }
    }

    /// Returns the board in OpenMetrics' text format, which Prometheus reads.
    #[must_use]
    pub fn metrics(&self) -> String {
        metrics::text(self.overview())
    }

    /// Returns a sensor's latest whole window as a PNG. The first call starts the keeping of frames, so that there
    /// is a picture soon after; calls within a second of another return the same picture.
    #[must_use]
    pub fn picture(&self, name: &Name) -> Option<Vec<u8>> {
        self.known(name)?.png(self.now())
    }
}
