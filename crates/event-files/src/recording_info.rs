//! Counts, time range and hashes of a recording: `eecvs info`.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity};
use sha2::{Digest, Sha256};
use twox_hash::XxHash3_128;

use crate::content::Rereadable;
use crate::findings::Findings;
use crate::{EventReader, Intact, Reading};

/// Counts, times and hashes of a recording; the fields are the keys of `eecvs info --json`.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct RecordingInfo {
    /// Camera or chip, if the file names it.
    pub sensor: Option<String>,
    /// Format name: `aedat4`, `aedat2`, `evt2`, `evt3`, `text`, `npz`, ...
    pub format: String,
    /// Number of columns.
    pub width: u16,
    /// Number of rows.
    pub height: u16,
    /// Number of events.
    pub events: u64,
    /// Number of events of polarity On.
    pub on: u64,
    /// Number of events of polarity Off.
    pub off: u64,
    /// Smallest time in microseconds; `None` if there are no events.
    pub t_first_us: Option<u64>,
    /// Largest time in microseconds; `None` if there are no events.
    pub t_last_us: Option<u64>,
    /// Number of events whose time is before that of the previous event.
    pub times_back: u64,
    /// Largest distance in microseconds of an event's time behind the latest time so far.
    pub back_max_us: u64,
    /// `t_last_us - t_first_us` in seconds.
    pub duration_s: f64,
    /// `events / duration_s`; 0 if the duration is 0.
    pub rate_eps: f64,
    /// Sum of all x.
    pub sum_x: u64,
    /// Sum of all y.
    pub sum_y: u64,
    /// SHA-256 over the columns t (int64), x, y (uint16) and p (uint8, 0 or 1), little-endian, one whole column
    /// after the other, with the events in file order; in lower-case hex.
    pub sha256_events: String,
    /// Sum modulo 2^128, over all events, of the XXH3-128 of the event's t, x, y and p, encoded as above in 13
    /// bytes. It does not depend on the order of the events; in lower-case hex.
    pub xxh128_sum_events: String,
    /// What the reader assumed because the file does not state it, and what the file holds besides events.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub findings: Findings,
    /// Where and why the recording broke off; the other fields describe the events before.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub damage: Option<String>,
}

/// Appends the bytes of one column's value of an event.
type Column = fn(&Event, &mut Vec<u8>);

const COLUMNS: [Column; 4] = [
    |event, bytes| bytes.extend_from_slice(&event.t_us.to_le_bytes()),
    |event, bytes| bytes.extend_from_slice(&event.x.to_le_bytes()),
    |event, bytes| bytes.extend_from_slice(&event.y.to_le_bytes()),
    |event, bytes| bytes.push(event.polarity as u8),
];

/// Reads the whole recording and returns its counts, times and hashes; `reading` states what the file does not.
///
/// SHA-256 needs whole columns one after the other, so the file is read four times, once per column, and memory
/// stays bounded by a batch. `progress` gets the number of events read since its last call; the numbers add up to
/// four times the recording's events.
///
/// # Errors
/// The format is unknown, or the header is damaged. Later damage ends the recording and is in
/// [`RecordingInfo::damage`].
pub fn info(
    path: &Path,
    reading: &Reading,
    progress: &mut dyn FnMut(u64),
) -> Result<RecordingInfo> {
    let recording = Rereadable::of(path)?;
    let first = recording.open(reading)?;
    // Saves later passes from searching for the size again.
    let reading = Reading {
        size: Some(first.sensor()),
        ..reading.clone()
    };
    info_of(first, &|| recording.open(&reading), progress)
}

/// Returns the same as [`info`] of anything that can be read four times: `first` reads it once, `again` opens it anew.
///
/// # Errors
/// Those of `again`. Later damage ends the recording and is in [`RecordingInfo::damage`].
pub fn info_of(
    first: Box<dyn EventReader>,
    again: &dyn Fn() -> Result<Box<dyn EventReader>>,
    progress: &mut dyn FnMut(u64),
) -> Result<RecordingInfo> {
    let mut reader = Intact::new(first);
    let sensor = reader.sensor();
    let mut info = RecordingInfo {
        sensor: reader.camera().map(str::to_owned),
        format: reader.format().to_owned(),
        width: sensor.width,
        height: sensor.height,
        events: 0,
        on: 0,
        off: 0,
        t_first_us: None,
        t_last_us: None,
        times_back: 0,
        back_max_us: 0,
        duration_s: 0.0,
        rate_eps: 0.0,
        sum_x: 0,
        sum_y: 0,
        sha256_events: String::new(),
        xxh128_sum_events: String::new(),
        findings: Findings::default(),
        damage: None,
    };
    let mut hash = Sha256::new();
    let mut sum = 0_u128;
    let mut before_us = 0;
    let mut events = Vec::with_capacity(crate::BATCH_EVENTS);
    let mut bytes = Vec::new();
    for (pass, column) in COLUMNS.iter().enumerate() {
        if pass > 0 {
            reader = Intact::new(again()?);
        }
        loop {
            events.clear();
            let read = reader.read(&mut events)?;
            if read == 0 {
                break;
            }
            bytes.clear();
            for event in &events {
                column(event, &mut bytes);
            }
            hash.update(&bytes);
            if pass == 0 {
                info.count(&events, &mut before_us);
                sum = events.iter().map(unordered).fold(sum, u128::wrapping_add);
            }
            progress(read as u64);
        }
        if pass == 0 {
            info.findings = Findings::of(&reader);
        }
    }
    info.xxh128_sum_events = format!("{sum:032x}");
    info.damage = reader.damage().map(|error| format!("{error:#}"));
    info.sha256_events = hash
        .finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    if let (Some(first), Some(last)) = (info.t_first_us, info.t_last_us) {
        info.duration_s = (last - first) as f64 / 1e6;
        info.rate_eps = if last > first {
            info.events as f64 / info.duration_s
        } else {
            0.0
        };
    }
    Ok(info)
}

/// Returns an event's summand in the hash that does not depend on the order.
fn unordered(event: &Event) -> u128 {
    let mut bytes = [0; 13];
    let (t, rest) = bytes.split_at_mut(8);
    t.copy_from_slice(&event.t_us.to_le_bytes());
    let (x, rest) = rest.split_at_mut(2);
    x.copy_from_slice(&event.x.to_le_bytes());
    let (y, p) = rest.split_at_mut(2);
    y.copy_from_slice(&event.y.to_le_bytes());
    p.fill(event.polarity as u8);
    XxHash3_128::oneshot(&bytes)
}

impl RecordingInfo {
    /// Counts the events of a batch; `before_us` is the time of the event before them.
    fn count(&mut self, events: &[Event], before_us: &mut u64) {
        for event in events {
            self.events += 1;
            match event.polarity {
                Polarity::On => self.on += 1,
                Polarity::Off => self.off += 1,
            }
            let (first, last) = (self.t_first_us, self.t_last_us);
            self.times_back += u64::from(event.t_us < *before_us);
            *before_us = event.t_us;
            let back_us = last.map_or(0, |last| last.saturating_sub(event.t_us));
            self.back_max_us = self.back_max_us.max(back_us);
            self.t_first_us = Some(first.map_or(event.t_us, |t| t.min(event.t_us)));
            self.t_last_us = Some(last.map_or(event.t_us, |t| t.max(event.t_us)));
            self.sum_x += u64::from(event.x);
            self.sum_y += u64::from(event.y);
        }
    }
}
