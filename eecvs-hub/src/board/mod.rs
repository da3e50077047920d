//! What a hub knows of its sensors: rows, pictures, metrics, and a live page of them.
//!
//! Frames are not decoded as they come, only their headers are read; where somebody looks at a sensor's picture, its
//! frames are kept from one on that decodes by itself, and decoded when the picture is fetched. Memory is bounded, by
//! sensors and by bytes of each, whatever is published.

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
use std::time::Instant;

use eecvs_nostd::Frame;
use serde::Serialize;

pub use row::Row;
use sensor::{Arrived, Moment, Sensor};

use crate::key::Name;
use crate::message::{Stamp, Status, now_us};

/// Sensors of a board, at the most.
pub const SENSORS_MAX: usize = 10_000;

/// What a hub says of its own links.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct HubFigures {
    /// Other hubs that it has a link to.
    pub routers: usize,
    /// Receivers with a link to it, or to another hub that it has a link to.
    pub receivers: usize,
}

/// All of a board at a moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Overview {
    /// The hub's name.
    pub hub: String,
    /// Microseconds since 1970, by this computer's clock.
    pub now_us: u64,
    /// The hub's links.
    #[serde(flatten)]
    pub figures: HubFigures,
    /// Sensors that are connected.
    pub connected: usize,
    /// Messages of sensors that the board has no room for.
    pub refused: u64,
    /// Messages that could not be read and belong to no sensor here.
    pub malformed: u64,
    /// The sensors, by their names.
    pub sensors: Vec<Row>,
}

/// What a hub knows of its sensors.
#[derive(Debug)]
pub struct Board {
    hub: String,
    began: Instant,
    sensors: RwLock<BTreeMap<Name, Arc<Sensor>>>,
    refused: AtomicU64,
    malformed: AtomicU64,
    figures: Mutex<HubFigures>,
}

impl Board {
    /// Of a hub with this name.
    #[must_use]
    pub fn new(hub: &str) -> Self {
        Self {
            hub: hub.to_owned(),
            began: Instant::now(),
            sensors: RwLock::default(),
            refused: AtomicU64::new(0),
            malformed: AtomicU64::new(0),
            figures: Mutex::default(),
        }
    }

    fn now(&self) -> Moment {
        Moment {
            at: self.began.elapsed(),
            unix_us: now_us(),
        }
    }

    /// A sensor that is known.
    fn known(&self, name: &Name) -> Option<Arc<Sensor>> {
        let sensors = self.sensors.read().unwrap_or_else(PoisonError::into_inner);
        sensors.get(name).cloned()
    }

    /// A sensor, known from here on; none where there are too many.
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

    /// Takes a frame that has come. Its checksums and its header are read; its payload is not.
    pub fn frame(&self, name: &Name, stamp: Stamp, frame: &[u8]) {
        let Some(sensor) = self.sensor(name) else {
            return;
        };
        let parsed = Frame::parse(frame).ok();
        // Bytes behind a frame are damage too.
        let parsed = parsed.filter(|parsed| parsed.bytes == frame.len());
        let arrived = Arrived {
            stamp,
            header: parsed.as_ref().map(|parsed| &parsed.header),
            bytes: frame,
        };
        sensor.frame(self.now(), arrived);
    }

    /// Takes what a sensor says of itself.
    pub fn status(&self, name: &Name, status: Status) {
        if let Some(sensor) = self.sensor(name) {
            sensor.status(self.now(), status);
        }
    }

    /// A sensor's token has come, or gone.
    pub fn alive(&self, name: &Name, is_alive: bool) {
        if let Some(sensor) = self.sensor(name) {
            sensor.alive(is_alive);
        }
    }

    /// Something could not be read; under a sensor's name, where it had one.
    pub fn malformed(&self, name: Option<&Name>) {
        match name.and_then(|name| self.known(name)) {
            Some(sensor) => sensor.malformed(),
            None => {
                self.malformed.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Takes what the hub says of its links.
    pub fn hub(&self, figures: HubFigures) {
        *self.figures.lock().unwrap_or_else(PoisonError::into_inner) = figures;
    }

    /// Somebody looks at a sensor: for ten seconds, frames for its picture are kept.
    pub fn want(&self, name: &Name) {
        if let Some(sensor) = self.known(name) {
            sensor.want(self.now());
        }
    }

    /// What is known of each sensor, by their names.
    #[must_use]
    pub fn rows(&self) -> Vec<Row> {
        let sensors = self.sensors.read().unwrap_or_else(PoisonError::into_inner);
        // What writes waits for readers: these have the sensors and no more.
        let sensors: Vec<_> = sensors
            .iter()
            .map(|(name, sensor)| (name.clone(), Arc::clone(sensor)))
            .collect();
        let now = self.now();
        sensors
            .iter()
            .map(|(name, sensor)| sensor.row(name, now))
            .collect()
    }

    /// All of the board.
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

    /// The board in OpenMetrics' text format, which Prometheus reads.
    #[must_use]
    pub fn metrics(&self) -> String {
        metrics::text(self.overview())
    }

    /// A sensor's latest whole window as a PNG. The first call asks for frames to be kept, so that there is a picture
    /// soon after; calls within a second of another get the same one.
    #[must_use]
    pub fn picture(&self, name: &Name) -> Option<Vec<u8>> {
        self.known(name)?.png(self.now())
    }
}
