//! `eecvs convert`: from one event-file format to another, optionally a part of it.

use std::path::Path;

use anyhow::Context;
use eecvs_nostd::{Event, Sensor};

use crate::formats;
use crate::output_file::{refuse_same_file, remove_partial};

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// Its left column.
    pub x: u16,
    /// Its top row.
    pub y: u16,
    /// Columns, at least 1.
    pub width: u16,
    /// Rows, at least 1.
    pub height: u16,
}

/// What to keep; the default keeps everything.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Filter {
    /// Only events with t >= `from_us`, in the file's own time.
    pub from_us: Option<u64>,
    /// Only events with t < `to_us`, in the file's own time.
    pub to_us: Option<u64>,
    /// Only this part of the sensor; its corner becomes (0, 0).
    pub crop: Option<Crop>,
}

/// Outcome of [`convert`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Converted {
    /// Events read.
    pub events_in: u64,
    /// Events written; the others did not pass the filter.
    pub events_out: u64,
}

impl Filter {
    /// Size of what is kept of a sensor.
    ///
    /// # Errors
    /// The crop does not lie inside of the sensor.
    pub fn sensor(&self, sensor: Sensor) -> anyhow::Result<Sensor> {
        let Some(crop) = self.crop else {
            return Ok(sensor);
        };
        let fits =
            |from: u16, side: u16, of: u16| u32::from(from) + u32::from(side) <= u32::from(of);
        let inside =
            fits(crop.x, crop.width, sensor.width) && fits(crop.y, crop.height, sensor.height);
        Sensor::new(crop.width, crop.height)
            .filter(|_| inside)
            .with_context(|| {
                let Crop {
                    x,
                    y,
                    width,
                    height,
                } = crop;
                format!(
                    "crop {x},{y},{width},{height} does not lie inside of the sensor ({}x{})",
                    sensor.width, sensor.height
                )
            })
    }

    /// The event as it is kept, or `None`.
    #[must_use]
    pub fn apply(&self, event: Event) -> Option<Event> {
        let early = self.from_us.is_some_and(|from| event.t_us < from);
        let late = self.to_us.is_some_and(|to| event.t_us >= to);
        if early || late {
            return None;
        }
        let Some(crop) = self.crop else {
            return Some(event);
        };
        let x = event.x.checked_sub(crop.x).filter(|x| *x < crop.width)?;
        let y = event.y.checked_sub(crop.y).filter(|y| *y < crop.height)?;
        Some(Event { x, y, ..event })
    }
}

/// Writes the events of `input` that pass `filter` to `output`, whose extension names the format.
///
/// Where reading or writing fails, what was written of `output` is removed.
///
/// # Errors
/// An unknown or damaged input, an output format that cannot hold the events, a crop outside of
/// the sensor, `from_us` above `to_us`, input and output the same file.
pub fn convert(
    input: &Path,
    output: &Path,
    size: Option<Sensor>,
    filter: Filter,
) -> anyhow::Result<Converted> {
    if let (Some(from), Some(to)) = (filter.from_us, filter.to_us) {
        anyhow::ensure!(from <= to, "--from-us {from} is after --to-us {to}");
    }
    let mut reader = formats::open(input, size)?;
    let sensor = filter
        .sensor(reader.sensor())
        .with_context(|| format!("{}: cannot be cropped", input.display()))?;
    refuse_same_file(input, output)?;
    let writer = formats::create(output, sensor)?;
    let result = copy(reader.as_mut(), writer, filter);
    if result.is_err() {
        remove_partial(output);
    }
    result
}

fn copy(
    reader: &mut dyn formats::EventReader,
    mut writer: Box<dyn formats::EventWriter>,
    filter: Filter,
) -> anyhow::Result<Converted> {
    let mut events = Vec::with_capacity(formats::BATCH_EVENTS);
    let mut kept = Vec::with_capacity(formats::BATCH_EVENTS);
    let mut converted = Converted {
        events_in: 0,
        events_out: 0,
    };
    loop {
        events.clear();
        kept.clear();
        if reader.read(&mut events)? == 0 {
            break;
        }
        kept.extend(events.iter().filter_map(|event| filter.apply(*event)));
        writer.write(&kept)?;
        converted.events_in += events.len() as u64;
        converted.events_out += kept.len() as u64;
    }
    writer.finish()?;
    Ok(converted)
}
