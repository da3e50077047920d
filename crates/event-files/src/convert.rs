//! Converts a recording, or a part of it, from one event-file format to another: `eecvs convert`.

use std::path::{Path, PathBuf};

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, bail, ensure};

use crate::findings::Findings;
use crate::fit::{Fit, Lost, beyond, fits};
use crate::input::growing::{Follow, open_growing};
use crate::output::is_same;
use crate::sort::Sorted;
use crate::{Format, Intact, Reading, within};

/// A rectangle of a sensor's pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// Left column.
    pub x: u16,
    /// Top row.
    pub y: u16,
    /// Number of columns, at least 1.
    pub width: u16,
    /// Number of rows, at least 1.
    pub height: u16,
}

/// The events to keep; the default keeps all of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Filter {
    /// Keeps only events with t >= `from_us`, in the file's own time.
    pub from_us: Option<u64>,
    /// Keeps only events with t < `to_us`, in the file's own time.
    pub to_us: Option<u64>,
    /// Keeps only this part of the sensor; its top left corner becomes (0, 0).
    pub crop: Option<Crop>,
}

/// How to convert a recording; the default converts all of it without loss.
#[derive(Debug, Clone, Default)]
pub struct Conversion {
    /// The events to keep.
    pub filter: Filter,
    /// Makes events fit that the output format cannot hold, and counts them, instead of refusing them.
    pub allow_loss: bool,
    /// Sorts the events by time first.
    pub sort: bool,
    /// Also converts what is appended to the input while it is read.
    pub follow: Option<Follow>,
    /// Makes damage of the input an error without an output, instead of an output of what was before it.
    pub refuse_damage: bool,
    /// The output format; `None` chooses it by the output's file name.
    pub format: Option<&'static Format>,
}

/// The outcome of [`convert`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Converted {
    /// Number of events read. With an index, only those of the requested times and a few around them.
    pub events_in: u64,
    /// Number of events written; the others did not pass the filter or are counted in `lost`.
    pub events_out: u64,
    /// What the output format could not hold.
    pub lost: Lost,
    /// What the input's reader assumed and what it left out.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub findings: Findings,
    /// Where and why the input broke off; everything before that is in the output.
    pub damage: Option<String>,
    /// Only with `damage`: the file that was written. It is not the requested output if a file of that name
    /// existed.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub incomplete_output: Option<PathBuf>,
}

impl Filter {
    /// Returns the size of the part of `sensor` that is kept.
    ///
    /// # Errors
    /// The crop does not lie inside the sensor.
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
                    "crop {x},{y},{width},{height} does not lie inside the sensor ({}x{})",
                    sensor.width, sensor.height
                )
            })
    }

    /// Returns the event with its coordinates in the crop, or `None` if it is not kept.
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

/// Writes the events of `input` that pass the filter to `output`, by default in the format of its file name's
/// ending.
///
/// Events keep their order, unless [`Conversion::sort`] is set. If reading fails, everything before the damage is
/// in `output` and [`Converted::damage`] describes it; if writing fails, the incomplete output is removed.
///
/// Without an index of times, all of the recording is read. With one, reading begins at `from_us` and ends one second
/// after `to_us`; where the index assumes that times ascend, events after a larger step back in time are missed. That of
/// `.eecvs` files does not.
///
/// # Errors
/// The input cannot be opened; the output format cannot hold an event; the crop lies outside the sensor; `from_us`
/// is above `to_us`; input and output are the same file. Damage before the first event is also an error.
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
    // Before the input is opened, which may take long.
    format_of(output, conversion)?;
    let reader = match &conversion.follow {
        Some(follow) => open_growing(input, reading, follow)?,
        None => crate::open(input, reading)?,
    };
    // Before the output is created.
    filter
        .sensor(reader.sensor())
        .with_context(|| format!("{}: cannot be cropped", input.display()))?;
    ensure!(
        !is_same(input, output),
        Refused,
        "{}: input and output are the same file: give the output another name",
        input.display()
    );
    convert_reader(reader, output, conversion)
}

/// Does what [`convert`] does, from an opened reader; whether its file is the output is not checked.
///
/// # Errors
/// Those of [`convert`].
pub fn convert_reader(
    reader: Box<dyn crate::EventReader>,
    output: &Path,
    conversion: &Conversion,
) -> Result<Converted> {
    let format = format_of(output, conversion)?;
    let mut sensor = conversion
        .filter
        .sensor(reader.sensor())
        .with_context(|| format!("{}: cannot be written", output.display()))?;
    if conversion.allow_loss {
        sensor = Fit::sensor(format.limits, sensor);
    }
    let mut writer = crate::create_as(output, format, sensor)?;
    let reader: Box<dyn crate::EventReader> = if conversion.sort {
        Box::new(Sorted::new(reader, &mut |_| {})?)
    } else {
        reader
    };
    let mut reader = Intact::new(reader);
    let result = copy(&mut reader, writer.as_mut(), conversion, (format, sensor))
        .with_context(|| format!("{}: cannot be converted", output.display()));
    // A conversion without a single event read is an error, not an empty recording.
    let converted = result?;
    let findings = Findings::of(&reader);
    let damage = match reader.damage() {
        Some(damage) if converted.events_in == 0 || conversion.refuse_damage => return Err(damage),
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

/// Returns the output's format: the one asked for, or that of its name.
fn format_of(output: &Path, conversion: &Conversion) -> Result<&'static Format> {
    match conversion.format {
        Some(format) => Ok(format),
        None => Ok(crate::writable(output)?.0),
    }
}

fn copy(
    reader: &mut dyn crate::EventReader,
    writer: &mut dyn crate::EventWriter,
    conversion: &Conversion,
    (format, sensor): (&Format, Sensor),
) -> Result<Converted> {
    let filter = conversion.filter;
    let end_us = within::seek(reader, filter.from_us, filter.to_us)?;
    let mut events = Vec::with_capacity(crate::BATCH_EVENTS);
    let (mut kept, mut fitted) = (Vec::new(), Vec::new());
    let mut fit = Fit::new(format.limits);
    let mut last_us = None;
    let mut converted = Converted::default();
    loop {
        events.clear();
        kept.clear();
        if reader.read(&mut events)? == 0 {
            break;
        }
        let mut passing = events.as_slice();
        if filter != Filter::default() {
            kept.extend(events.iter().filter_map(|event| filter.apply(*event)));
            passing = &kept;
        }
        if conversion.allow_loss {
            fitted.clear();
            fitted.extend(passing.iter().filter_map(|event| fit.apply(*event)));
            passing = &fitted;
        } else if !fits(format.limits, sensor, passing, last_us) {
            refuse(format, passing, converted.events_out, last_us)?;
        }
        last_us = passing.last().map(|event| event.t_us).or(last_us);
        writer.write(passing)?;
        converted.events_in += events.len() as u64;
        converted.events_out += passing.len() as u64;
        let past = |end| events.iter().all(|event| event.t_us >= end);
        if end_us.is_some_and(past) {
            break;
        }
    }
    converted.lost = fit.lost();
    Ok(converted)
}

/// Returns an error that says which of `events`, the first of which has number `index`, is the first that the format
/// cannot hold, and why.
fn refuse(format: &Format, events: &[Event], index: u64, mut last_us: Option<u64>) -> Result<()> {
    for (index, event) in (index..).zip(events) {
        if let Some(what) = beyond(format.limits, index, *event, last_us) {
            bail!(
                CannotHold,
                "{} cannot hold {what} (--allow-loss leaves out or changes what it cannot hold)",
                format.title
            );
        }
        last_us = Some(event.t_us);
    }
    Ok(())
}
