//! What `eecvs info` says about a recording.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity};
use sha2::{Digest, Sha256};
use twox_hash::XxHash3_128;

use crate::content::Rereadable;
use crate::findings::Findings;
use crate::{EventReader, Intact, Reading};

/// Counts, times and hash of a recording; the fields are the keys of `eecvs info --json`.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct RecordingInfo {
    /// Camera or chip, where the file names it.
    pub sensor: Option<String>,
    /// Format name: `aedat4`, `aedat2`, `evt2`, `evt3`, `text`, `npz`, ...
    pub format: String,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Number of events.
    pub events: u64,
    /// Events of polarity On.
    pub on: u64,
    /// Events of polarity Off.
    pub off: u64,
    /// Smallest time in microseconds; none where there is no event.
    pub t_first_us: Option<u64>,
    /// Largest time in microseconds.
    pub t_last_us: Option<u64>,
    /// Events whose time is before that of the event before them.
    pub times_back: u64,
    /// How far a time is before the latest one so far, at the most, in microseconds.
    pub back_max_us: u64,
    /// `t_last_us - t_first_us` in seconds.
    pub duration_s: f64,
    /// `events / duration_s`; 0 where the duration is 0.
    pub rate_eps: f64,
    /// Sum of all x.
    pub sum_x: u64,
    /// Sum of all y.
    pub sum_y: u64,
    /// SHA-256 over the columns t (int64), x, y (uint16), p (uint8, 0 or 1), little-endian, one
    /// after the other, events in file order; lower-case hex.
    pub sha256_events: String,
    /// Sum modulo 2^128 over the events of XXH3-128 of t, x, y, p as above, 13 bytes each: the same for the same events
    /// in any order; lower-case hex.
    pub xxh128_sum_events: String,
    /// What the file does not say and its reader took to be so, and what it holds besides events.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub findings: Findings,
    /// Where and why the recording ended before its end; the rest is of what stands before.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub damage: Option<String>,
}

/// Bytes of one column's value of an event.
type Column = fn(&Event, &mut Vec<u8>);

const COLUMNS: [Column; 4] = [
    |event, bytes| bytes.extend_from_slice(&event.t_us.to_le_bytes()),
    |event, bytes| bytes.extend_from_slice(&event.x.to_le_bytes()),
    |event, bytes| bytes.extend_from_slice(&event.y.to_le_bytes()),
    |event, bytes| bytes.push(event.polarity as u8),
];

/// Reads a recording; `reading` says what the file does not.
///
/// The hash needs whole columns one after the other: the file is read once per column, so that
/// memory stays bounded by a batch. `progress` gets the number of events read since its last
/// call, which comes to four times the recording's events.
///
/// # Errors
/// An unknown format, a damaged header. Damage behind it ends the recording, and is told.
pub fn info(
    path: &Path,
    reading: &Reading,
    progress: &mut dyn FnMut(u64),
) -> Result<RecordingInfo> {
    let recording = Rereadable::of(path)?;
    let mut reader = Intact::new(recording.open(reading)?);
    // Later passes need not search for the size again.
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
            let reading = Reading {
                size: Some(sensor),
                ..reading.clone()
            };
            reader = Intact::new(recording.open(reading)?);
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

/// An event's part of the hash in which order does not matter.
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
    /// `before_us` is the time of the event before.
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
