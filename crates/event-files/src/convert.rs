//! `eecvs convert`: from one event-file format to another, optionally a part of it.

use std::path::{Path, PathBuf};

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, bail, ensure};

use crate::findings::Findings;
use crate::fit::{Fit, Lost, beyond};
use crate::input::growing::{Follow, open_growing};
use crate::output::is_same;
use crate::sort::Sorted;
use crate::{Format, Intact, Reading};

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

/// How a recording is converted; the default converts all of it, and loses nothing.
#[derive(Debug, Clone, Default)]
pub struct Conversion {
    /// What is kept.
    pub filter: Filter,
    /// What the output's format cannot hold is made to fit, and counted, in place of being refused.
    pub allow_loss: bool,
    /// Events are sorted by time first.
    pub sort: bool,
    /// What is appended to the input comes as well.
    pub follow: Option<Follow>,
    /// The output's format, in place of that of its extension.
    pub format: Option<&'static Format>,
}

/// Outcome of [`convert`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Converted {
    /// Events read: with an index, those of the times that were asked for, and a few around them.
    pub events_in: u64,
    /// Events written; the others did not pass the filter, or are in `lost`.
    pub events_out: u64,
    /// What the output's format could not hold.
    pub lost: Lost,
    /// What the input's reader took to be so, and what it left out.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub findings: Findings,
    /// Where and why the input ended before its end; everything before is in the output.
    pub damage: Option<String>,
    /// With `damage`: the file that has it, which is another than the output where that was there already.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub incomplete_output: Option<PathBuf>,
}

impl Filter {
    /// Size of what is kept of a sensor.
    ///
    /// # Errors
    /// The crop does not lie inside of the sensor.
    pub fn sensor(&self, sensor: Sensor) -> Result<Sensor> {
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

/// Times of a recording step back by less than this: reading may end so long behind the last that is wanted.
const STEP_BACK_MAX_US: u64 = 1_000_000;

/// Writes the events of `input` that pass the filter to `output`, whose extension names the format.
///
/// Events keep their order. Where reading fails, everything before the damage is in `output`, and
/// [`Converted::damage`] tells it; where writing fails, what was written is removed.
///
/// Reading begins at `from_us` where the format has an index, and ends a second behind `to_us`: times that
/// step back further than that are not found.
///
/// # Errors
/// An unknown input, an output format that cannot hold the events, a crop outside of the sensor,
/// `from_us` above `to_us`, input and output the same file.
pub fn convert(
    input: &Path,
    output: &Path,
    reading: &Reading,
    conversion: &Conversion,
) -> Result<Converted> {
    let filter = conversion.filter;
    if let (Some(from), Some(to)) = (filter.from_us, filter.to_us) {
        ensure!(
            from <= to,
            Refused,
            "--from-us {from} is after --to-us {to}"
        );
    }
    let format = match conversion.format {
        Some(format) => format,
        None => crate::writable(output)?.0,
    };
    let reader = match &conversion.follow {
        Some(follow) => open_growing(input, reading, follow)?,
        None => crate::open(input, reading)?,
    };
    let mut sensor = filter
        .sensor(reader.sensor())
        .with_context(|| format!("{}: cannot be cropped", input.display()))?;
    if conversion.allow_loss {
        sensor = Fit::sensor(format.limits, sensor);
    }
    ensure!(
        !is_same(input, output),
        Refused,
        "{}: input and output are the same file: give the output another name",
        input.display()
    );
    let mut writer = crate::create_as(output, format, sensor)?;
    let reader: Box<dyn crate::EventReader> = if conversion.sort {
        Box::new(Sorted::new(reader, &mut |_| {})?)
    } else {
        reader
    };
    let mut reader = Intact::new(reader);
    let result = copy(&mut reader, writer.as_mut(), conversion, format)
        .with_context(|| format!("{}: cannot be converted", output.display()));
    // Nothing of a recording is no recording.
    let converted = result?;
    let findings = Findings::of(&reader);
    let damage = match reader.damage() {
        Some(damage) if converted.events_in == 0 => return Err(damage),
        damage => damage.map(|error| format!("{error:#}")),
    };
    let incomplete_output = if damage.is_some() && conversion.follow.is_none() {
        writer.finish_incomplete()?
    } else {
        writer.finish()?;
        None
    };
    Ok(Converted {
        findings,
        damage,
        incomplete_output,
        ..converted
    })
}

fn copy(
    reader: &mut dyn crate::EventReader,
    writer: &mut dyn crate::EventWriter,
    conversion: &Conversion,
    format: &Format,
) -> Result<Converted> {
    let filter = conversion.filter;
    if let Some(from_us) = filter.from_us {
        reader.seek(from_us)?;
    }
    let end_us = filter.to_us.map(|to| to.saturating_add(STEP_BACK_MAX_US));
    let mut events = Vec::with_capacity(crate::BATCH_EVENTS);
    let mut kept = Vec::with_capacity(crate::BATCH_EVENTS);
    let mut fit = Fit::new(format.limits);
    let mut last_us = None;
    let mut converted = Converted::default();
    loop {
        events.clear();
        kept.clear();
        if reader.read(&mut events)? == 0 {
            break;
        }
        for event in events.iter().filter_map(|event| filter.apply(*event)) {
            if conversion.allow_loss {
                kept.extend(fit.apply(event));
                continue;
            }
            let index = converted.events_out + kept.len() as u64;
            if let Some(what) = beyond(format.limits, index, event, last_us) {
                bail!(
                    CannotHold,
                    "{} cannot hold {what} (--allow-loss leaves out or changes what it cannot hold)",
                    format.title
                );
            }
            last_us = Some(event.t_us);
            kept.push(event);
        }
        writer.write(&kept)?;
        converted.events_in += events.len() as u64;
        converted.events_out += kept.len() as u64;
        let past = |end| events.iter().all(|event| event.t_us >= end);
        if end_us.is_some_and(past) {
            break;
        }
    }
    converted.lost = fit.lost();
    Ok(converted)
}
