//! The shared recordings as cameras send them, for the guest and for the tests with a mocked device.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use eecvs_nostd::{Event, Sensor};
use serde::Deserialize;

/// A recording in a format that can be read.
pub struct Recording {
    pub name: String,
    pub sensor: Sensor,
    pub path: PathBuf,
}

/// A recording as listed in REFERENCE.json.
#[derive(Deserialize)]
struct Reference {
    name: String,
    files: Vec<String>,
    width: u16,
    height: u16,
}

/// Returns the recordings of a folder whose names are `wanted`; those in a format without a reader are named on
/// stderr.
///
/// # Errors
/// The folder has no list of recordings.
pub fn all(data: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Vec<Recording>> {
    let list = data.join("REFERENCE.json");
    let name = list.display();
    let text = std::fs::read_to_string(&list).with_context(|| name.to_string())?;
    let references: Vec<Reference> =
        serde_json::from_str(&text).with_context(|| name.to_string())?;
    let mut all = Vec::new();
    for one in references.into_iter().filter(|one| wanted(&one.name)) {
        let sensor = Sensor::new(one.width, one.height).with_context(|| one.name.clone())?;
        // The files hold the same events in several formats.
        let mut paths = one.files.iter().map(|file| data.join(&one.name).join(file));
        match paths.find(|path| event_files::open(path, Some(sensor)).is_ok()) {
            Some(path) => all.push(Recording {
                name: one.name,
                sensor,
                path,
            }),
            None => eprintln!("skipped: {}: its format has no reader", one.name),
        }
    }
    Ok(all)
}

impl Recording {
    /// Reads the first events, at most `limit`.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn events(&self, limit: usize) -> Result<Vec<Event>> {
        let mut reader = event_files::open(&self.path, Some(self.sensor))?;
        let mut events = Vec::new();
        while events.len() < limit && reader.read(&mut events)? > 0 {}
        events.truncate(limit);
        Ok(events)
    }
}

/// Shifts events in time such that they cross 2^31 us halfway through; returns the time of the first event. A
/// device's clock has had more wraps by then than one word can count.
pub fn cross_2_31_us(events: &mut [Event]) -> u64 {
    let first_us = events.first().map_or(0, |event| event.t_us);
    let latest_us = events.last().map_or(0, |event| event.t_us);
    let start_us = (1 << 31) - (latest_us - first_us) / 2;
    for event in events {
        event.t_us = event.t_us - first_us + start_us;
    }
    start_us
}

/// Returns whether a model's events arrive in the order in which they are sent. The other models sort simultaneous
/// events by column or by pixel.
pub fn keeps_order(model: &str) -> bool {
    !["dvxplorer-mipi", "eecvs"].contains(&model)
}
