//! Events in MATLAB's files of level 5 (`.mat`, what `save` writes by default and as `-v6` and `-v7`).
//!
//! * A structure with fields t, x, y and p (also ts, time, timestamp(s); pol, polarity), as Prophesee's
//!   `load_atis_data` returns them and `TD` of N-MNIST's `Read_Ndataset` has them; or variables of these
//!   names; or one matrix of N rows and 4 columns, whose columns are told apart as those of a text file
//!   without header. A structure or matrix is named behind the file, where there are several:
//!   `FILE.mat/TD`.
//! * Scalars `width` and `height`, among the variables or in the structure, give the sensor's size; without
//!   them and without a size from the caller it is the largest x and y, plus one.
//! * Real numbers of any class, also as the smaller types that MATLAB stores whole ones in; compressed or
//!   not, of either byte order.
//! * t: integers are microseconds. Floats are seconds, rounded to the nearest microsecond, unless the first
//!   4,096 are whole and there are 16 different ones, or one of 1e10 and more.
//! * p: 1 is on; 0 or -1 is off. Where all are 1 or 2 and some are 2, 2 is on and 1 is off, and where no
//!   column or row is 0, both count from 1: `Read_Ndataset` adds one to all three.
//!
//! Level 4 has no mark to be told by. Files of `-v7.3` are HDF5 and read as such.
//!
//! Source: MAT-File Format, The MathWorks, R2020a.

mod file;
mod layout;
mod writer;

use eecvs_nostd::{Event, Sensor};

use super::Skipped;
use super::event_numbers::{self, P, T, X, Y};
use super::format::{Format, Limits, Opening};
use super::input::{Batch, Decode, ReadSeek, Reader};
use super::npy_header::Number;
use file::{MatFile, Numbers, byte_order};
use layout::Plan;
pub use writer::MatWriter;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "mat",
    title: "MATLAB",
    endings: &[".mat"],
    detect: |start| byte_order(start.bytes).is_some(),
    open: |Opening {
               source,
               name,
               place,
               reading,
               ..
           }| Ok(Box::new(MatReader::new(source, name, place, reading.size)?)),
    has_places: true,
    grows: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(MatWriter::create(path, sensor)?))),
};

/// Reader of MAT-files.
pub type MatReader = Reader<MatDecoder>;

impl MatReader {
    /// Reads `source`, which messages call `name`; `place` is the variable of the events, where it was
    /// named; `size` counts where the file states none.
    ///
    /// # Errors
    /// No MAT-file of level 5, no events in it, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
        let file = MatFile::open(source, name)?;
        let plan = Plan::find(&file, place, size)?;
        let mut skipped = Skipped::default();
        let others = file.variables().len().saturating_sub(plan.used);
        skipped.add("other variables", others as u64);
        let columns = plan.columns(&file, 0)?;
        Ok(Self::around(MatDecoder {
            file,
            plan,
            columns,
            events: 0,
            skipped,
        }))
    }
}

/// State between two batches.
pub struct MatDecoder {
    file: MatFile,
    plan: Plan,
    columns: [Numbers; 4],
    events: u64,
    skipped: Skipped,
}

impl MatDecoder {
    fn event(&self, row: usize) -> Result<Event, (usize, String)> {
        let mut numbers = [T, X, Y, P].map(|which| self.columns.get(which)?.get(row));
        let base = self.plan.base;
        for (which, base) in [(X, base.pixel), (Y, base.pixel), (P, base.polarity)] {
            numbers[which] = numbers[which].map(|number| less(number, base));
        }
        event_numbers::event(&numbers, self.plan.unit, self.plan.sensor)
    }

    fn error(&self, which: usize, what: impl std::fmt::Display) -> anyhow::Error {
        let what = format!("event {}: {what}", self.events);
        match self.plan.arrays.get(which) {
            Some(array) => self.file.error_in(array, what),
            None => self.file.error(0, what),
        }
    }
}

/// The number less what is counted from.
fn less(number: Number, base: i64) -> Number {
    match number {
        Number::Whole(value) => Number::Whole(value.saturating_sub(base)),
        Number::Float(value) => Number::Float(value - base as f64),
    }
}

impl Decode for MatDecoder {
    fn format(&self) -> &'static str {
        "mat"
    }

    fn sensor(&self) -> Sensor {
        self.plan.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        let left = self.plan.events - self.events;
        let count = usize::try_from(left)
            .unwrap_or(usize::MAX)
            .min(batch.room());
        let (whole, ended) = layout::fill(&mut self.columns, count);
        for row in 0..whole {
            match self.event(row) {
                Ok(event) => batch.push(event),
                Err((which, what)) => return Err(self.error(which, what)),
            }
            self.events += 1;
        }
        match ended {
            // What is behind the events may be damaged too.
            None if count == 0 => self.file.damage().map_or(Ok(()), Err),
            None => Ok(()),
            Some((which, what)) => Err(self.error(which, what)),
        }
    }
}
