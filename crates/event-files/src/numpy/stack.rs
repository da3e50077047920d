//! Reads frames from an array of shape (frames, rows, columns), in a `.npy` or an `.npz`.
//!
//! Integers of 8 and 16 bits without a sign have white at their largest number, floats at 1; other integers need to be
//! told which number is white. In an `.npz`, an array of one dimension with a number for each frame has the times: `t`,
//! `ts`, `time`, `times` or `timestamps`, with the unit at the end of the name (`times_us`), in its type (timedelta64), or
//! stated by the caller. Both arrays are read in step.

use std::io::Read;

use event_types::stream::{Context, Error, ErrorKind, Response, Result};
use event_types::{Sensor, bail, ensure, error};

use super::npy_header::{Descr, Dtype, NpyHeader, Number};
use crate::Assumption;
use crate::input::ReadSeek;
use crate::reading::TimeUnit;
use crate::table::row_events::Scale;
use crate::video::{Frames, Taken, VideoReading, fill, size_of};
use crate::zipped::entry::{Entries, Entry, EntryReader};

/// Names of arrays of times, without a unit.
const TIMES: [&str; 5] = ["t", "ts", "time", "times", "timestamps"];

/// Units at the end of a name.
const UNITS: [TimeUnit; 4] = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];

/// Where an array's bytes come from.
enum Source {
    Plain(Box<dyn Read + Send>),
    Entry(Box<EntryReader>),
}

impl Read for Source {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Self::Plain(source) => source.read(bytes),
            // An entry that ends is an error of its reader, not an end.
            Self::Entry(source) => source.read(bytes),
        }
    }
}

/// The times of the frames.
struct Times {
    source: EntryReader,
    name: String,
    dtype: Dtype,
    unit: Unit,
}

/// The unit of times.
#[derive(Clone, Copy)]
enum Unit {
    /// Of numbers, as a power of ten of microseconds.
    Power(i32),
    /// Of numpy's type of times.
    Scale(Scale),
}

/// A reader of frames.
pub(crate) struct Stack {
    source: Source,
    name: String,
    dtype: Dtype,
    sensor: Sensor,
    frames: u64,
    next: u64,
    scale: f64,
    is_white_stated: bool,
    bytes: Vec<u8>,
    times: Option<Times>,
    assumptions: Vec<Assumption>,
}

impl Stack {
    /// Reads a `.npy`, also from a pipe.
    ///
    /// # Errors
    /// It is no array of frames.
    pub(crate) fn npy(
        source: Box<dyn Read + Send>,
        name: &str,
        white: Option<f64>,
    ) -> Result<Self> {
        let mut source = Source::Plain(source);
        let header = NpyHeader::read(&mut source).map_err(|what| damaged(name, &what))?;
        Self::new(source, name.to_owned(), &header, white)
    }

    /// Reads an `.npz`: the array `place`, or else the only one of three dimensions. Times are not looked for where the
    /// caller states them.
    ///
    /// # Errors
    /// There is no such array, or none with times where they are needed.
    pub(crate) fn npz(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        reading: &VideoReading,
        has_clock: bool,
    ) -> Result<Self> {
        let entries = Entries::read(source);
        let entries =
            entries.map_err(|what| damaged(name, &format!("damaged npz file: {what}")))?;
        let mut arrays = Vec::new();
        for entry in entries.iter() {
            let title = entry.name.strip_suffix(".npy").unwrap_or(&entry.name);
            let mut reader = entries.open(entry);
            // What is no array is not looked at.
            if let Ok(header) = NpyHeader::read(&mut reader) {
                arrays.push((title.to_owned(), header, entry));
            }
        }
        let is_wanted = |title: &str, header: &NpyHeader| match place {
            Some(place) => title == place,
            None => frame_size(&header.shape).is_some(),
        };
        let mut found = arrays
            .iter()
            .filter(|(title, header, _)| is_wanted(title, header));
        let all = || {
            let titles = arrays
                .iter()
                .map(|(title, header, _)| format!("{title} {:?}", header.shape));
            titles.collect::<Vec<_>>().join(", ")
        };
        let Some((title, header, entry)) = found.next() else {
            let wanted = place.unwrap_or("of shape (frames, rows, columns)");
            bail!(Undecided, "{name}: no array {wanted}: it has {}", all());
        };
        if let Some((other, ..)) = found.next() {
            bail!(
                Undecided,
                "{name}: {title} and {other} may both be frames: name one after the file, as in {name}/{title}"
            );
        }
        let called = format!("{name}/{title}");
        let source = Source::Entry(Box::new(behind(&entries, entry, header, &called)?));
        let mut stack = Self::new(source, called, header, reading.white)?;
        if has_clock {
            return Ok(stack);
        }
        let times = arrays.iter().find_map(|(title, header, entry)| {
            let (stem, unit) = stem_and_unit(title);
            let is_list = header.shape == [stack.frames];
            (is_list && TIMES.contains(&stem)).then_some((title, unit, header, *entry))
        });
        let Some((title, unit, header, entry)) = times else {
            bail!(
                Undecided,
                "{name}: no array of {} times ({}): give --fps, or --times FILE with --time-unit; it has {}",
                stack.frames,
                TIMES.join(", "),
                all()
            );
        };
        let Descr::Plain(dtype) = header.descr else {
            bail!(
                Damaged,
                "{name}/{title}: is structured, not a list of times"
            );
        };
        ensure!(
            dtype.is_number(),
            Damaged,
            "{name}/{title}: holds no numbers"
        );
        let unit = match (dtype.scale(), unit.or(reading.time_unit)) {
            (Some(scale), _) => Unit::Scale(scale),
            (None, Some(unit)) => Unit::Power(unit.shift()),
            (None, None) => bail!(
                Undecided,
                "{name}/{title}: the unit of the times is not stated: give --time-unit s, ms, us or ns"
            ),
        };
        let called = format!("{name}/{title}");
        stack.times = Some(Times {
            source: behind(&entries, entry, header, &called)?,
            name: called,
            dtype,
            unit,
        });
        Ok(stack)
    }

    fn new(source: Source, name: String, header: &NpyHeader, white: Option<f64>) -> Result<Self> {
        let Some((frames, height, width)) = frame_size(&header.shape) else {
            bail!(
                Damaged,
                "{name}: an array of shape {:?}: give frames as (frames, rows, columns)",
                header.shape
            );
        };
        ensure!(
            !header.fortran_order,
            Unsupported,
            "{name}: is stored column by column: save numpy.ascontiguousarray of it"
        );
        let sensor = size_of(width, height).map_err(|what| damaged(&name, &what))?;
        let Descr::Plain(dtype) = header.descr else {
            bail!(
                Unsupported,
                "{name}: is structured: give an array of numbers"
            );
        };
        let is_number = dtype.is_number() && dtype.scale().is_none();
        ensure!(
            is_number,
            Unsupported,
            "{name}: is not of numbers: give integers or floats"
        );
        let natural = match dtype.whole_bits() {
            _ if dtype.is_float() => Some(1.0),
            Some((8, false)) => Some(255.0),
            Some((16, false)) => Some(65_535.0),
            // Of the other byte order.
            None if dtype.bytes == 2 && dtype.is_unsigned() => Some(65_535.0),
            _ => None,
        };
        let Some(white_at) = white.or(natural) else {
            bail!(
                Undecided,
                "{name}: integers of this type do not say which number is white: give --white"
            );
        };
        Ok(Self {
            source,
            name,
            dtype,
            sensor,
            frames,
            next: 0,
            scale: 1.0 / white_at,
            is_white_stated: white.is_some(),
            bytes: vec![0; sensor.pixels() as usize * dtype.bytes],
            times: None,
            assumptions: Vec::new(),
        })
    }

    /// Checks what follows the last frame.
    fn check_end(&mut self) -> Result<()> {
        match &mut self.source {
            Source::Plain(source) => {
                let more = fill(source, &mut [0]).with_context(|| self.name.clone())?;
                ensure!(
                    more == 0,
                    Damaged,
                    "{}: bytes follow the {} frames that its header states: save one array per file",
                    self.name,
                    self.frames
                );
            }
            Source::Entry(entry) => ensure!(
                !entry.is_damaged(),
                Damaged,
                "{}: the array's CRC-32 is wrong: damaged data",
                self.name
            ),
        }
        if let Some(times) = &self.times {
            ensure!(
                !times.source.is_damaged(),
                Damaged,
                "{}: the array's CRC-32 is wrong: damaged data",
                times.name
            );
        }
        Ok(())
    }

    fn values(&self, values: &mut Vec<f32>) -> Option<()> {
        values.clear();
        let scale = self.scale as f32;
        match self.dtype.whole_bits() {
            Some((bits @ (8 | 16), false)) => {
                crate::video::numbers(&self.bytes, bits == 16, scale, values);
            }
            _ => {
                for bytes in self.bytes.chunks_exact(self.dtype.bytes) {
                    let number = self.dtype.number(bytes)?.float();
                    values.push((number * self.scale) as f32);
                }
            }
        }
        Some(())
    }
}

fn damaged(name: &str, what: &str) -> Error {
    error!(Damaged, "{name}: {what}")
}

/// Opens an array's entry behind its header.
fn behind(entries: &Entries, entry: &Entry, header: &NpyHeader, name: &str) -> Result<EntryReader> {
    let mut reader = entries.open(entry);
    let mut passed = reader.by_ref().take(header.bytes);
    std::io::copy(&mut passed, &mut std::io::sink())
        .with_context(|| format!("{name}: cannot be read"))?;
    Ok(reader)
}

/// Returns frames, rows and columns of a shape.
fn frame_size(shape: &[u64]) -> Option<(u64, u64, u64)> {
    match *shape {
        [frames, height, width] | [frames, height, width, 1] => Some((frames, height, width)),
        _ => None,
    }
}

/// Splits a unit off an array's name.
fn stem_and_unit(title: &str) -> (&str, Option<TimeUnit>) {
    let split = title.rsplit_once('_').and_then(|(stem, name)| {
        let unit = UNITS.into_iter().find(|unit| unit.name() == name)?;
        Some((stem, Some(unit)))
    });
    split.unwrap_or((title, None))
}

impl Times {
    /// Reads the time of frame `number`, in us.
    fn next(&mut self, number: u64) -> Result<u64> {
        let mut bytes = [0; 8];
        let bytes = bytes.get_mut(..self.dtype.bytes).unwrap_or_default();
        self.source
            .read_exact(bytes)
            .with_context(|| format!("{}: time {number} cannot be read", self.name))?;
        let value = self.dtype.number(bytes);
        let t_us = value.and_then(|value| match self.unit {
            Unit::Scale(scale) => scale.us(value).and_then(|us| u64::try_from(us).ok()),
            Unit::Power(shift) => microseconds(value, shift),
        });
        t_us.ok_or_else(|| {
            error!(
                Damaged,
                "{}: time {number} is missing, negative or too late: give times of 0 or more",
                self.name
            )
        })
    }
}

/// Returns a number times 10^shift, to the nearest, if it is a time in us.
fn microseconds(value: Number, shift: i32) -> Option<u64> {
    let power = 10_i64.pow(shift.unsigned_abs());
    match value {
        Number::Whole(whole) if shift >= 0 => u64::try_from(whole.checked_mul(power)?).ok(),
        Number::Whole(whole) => {
            let whole = u64::try_from(whole).ok()?;
            let power = power.unsigned_abs();
            Some(whole / power + u64::from(whole % power >= power / 2))
        }
        Number::Float(float) => {
            let power = power as f64;
            let us = if shift >= 0 {
                float * power
            } else {
                float / power
            };
            let us = us.round();
            (0.0..9.2e18).contains(&us).then_some(us as u64)
        }
    }
}

impl Frames for Stack {
    fn format(&self) -> &'static str {
        match self.source {
            Source::Plain(_) => "npy",
            Source::Entry(_) => "npz",
        }
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn response(&self) -> Response {
        if self.dtype.is_float() {
            Response::Linear
        } else {
            Response::Srgb
        }
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>> {
        if self.next >= self.frames {
            self.check_end()?;
            return Ok(None);
        }
        let got = fill(&mut self.source, &mut self.bytes);
        let got = match got {
            Ok(got) => got,
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => 0,
            Err(error) => {
                let what = format!("{}: frame {}: cannot be read", self.name, self.next);
                return Err(Error::from(error).of_kind(ErrorKind::Damaged).context(what));
            }
        };
        ensure!(
            got == self.bytes.len(),
            Damaged,
            "{}: frame {} ends after {got} of {} bytes, and the header states {} frames: the array is cut",
            self.name,
            self.next,
            self.bytes.len(),
            self.frames
        );
        let taken = self.values(values);
        taken.with_context(|| {
            format!("{}: frame {}: a number is too large", self.name, self.next)
        })?;
        let t_us = match &mut self.times {
            Some(times) => Some(times.next(self.next)?),
            None => None,
        };
        self.next += 1;
        Ok(Some(Taken { t_us }))
    }

    fn place(&self) -> String {
        self.name.clone()
    }

    fn doubts_white(&self) -> bool {
        self.dtype.is_float() && !self.is_white_stated
    }
}
