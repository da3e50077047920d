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
//! * A structure in structures is named by its place: `FILE.mat/aedat/data/polarity` of `AedatTools`.
//! * t: `crate::table::time_unit` has the rule; `crate::table::row_events` those for clocks that wrap, polarities and
//!   events that cannot be one.
//! * p: 1 is on; 0 or -1 is off. Where all are 1 or 2 and some are 2, 2 is on and 1 is off.
//! * Pixels count from 1, as MATLAB does, where no column or row is 0, since some event of a camera's recording
//!   is in its first row or column. But where the file states width and height, they count from 1 only where
//!   an event is in the column or row of that number: files of this program state both and count from 0. So do
//!   `AedatTools`, told by the field `timeStamp`.
//!
//! Level 4 has no mark to be told by. Files of `-v7.3` are HDF5 and read as such.
//!
//! Source: MAT-File Format, The MathWorks, R2020a.

mod file;
mod layout;
mod writer;

use event_types::Sensor;
use event_types::stream::{ErrorKind, Result};

use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, ReadSeek, Reader};
use crate::reading::Reading;
use crate::table::event_numbers::{P, Row, T, X, Y};
use crate::table::row_events::RowEvents;
use crate::{Assumption, Skipped};
use file::{MatFile, Numbers, byte_order};
use layout::Plan;
pub use layout::Range;
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
           }| Ok(Box::new(MatReader::new(source, name, place, &reading)?)),
    has_places: true,
    is_table: true,
    grows: false,
    streams: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(MatWriter::create(path, sensor)?))),
};

/// Reader of MAT-files.
pub type MatReader = Reader<MatDecoder>;

impl MatReader {
    /// Reads `source`, which messages call `name`; `place` is the variable of the events, where it was
    /// named; `reading` says what the file does not.
    ///
    /// # Errors
    /// No MAT-file of level 5, no events in it, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        reading: &Reading,
    ) -> Result<Self> {
        let file = MatFile::open(source, name)?;
        let plan = Plan::find(&file, place, reading)?;
        let mut rows =
            RowEvents::new(reading, plan.times, plan.base, &plan.sample).map_err(|what| {
                file.error_in(&plan.arrays[T], what)
                    .of_kind(ErrorKind::Undecided)
            })?;
        rows.sensor = plan.sensor;
        rows.assumptions.extend(plan.assumption.clone());
        if plan.is_size_taken {
            rows.assumptions.push(Assumption::size_taken(plan.sensor));
        }
        let others = file.variables().len().saturating_sub(plan.used);
        rows.skipped.add("other variables", others as u64);
        let columns = plan.columns(&file, 0)?;
        Ok(Self::around(MatDecoder {
            file,
            plan,
            columns,
            rows,
            events: 0,
        }))
    }
}

/// State between two batches.
pub struct MatDecoder {
    file: MatFile,
    plan: Plan,
    columns: [Numbers; 4],
    rows: RowEvents,
    events: u64,
}

impl MatDecoder {
    fn row(&self, row: usize) -> Row {
        [T, X, Y, P].map(|which| self.columns.get(which)?.get(row))
    }

    fn error(&self, which: usize, what: impl std::fmt::Display) -> event_types::stream::Error {
        let what = format!("event {}: {what}", self.events);
        match self.plan.arrays.get(which) {
            Some(array) => self.file.error_in(array, what),
            None => self.file.error(0, what),
        }
    }
}

impl Decode for MatDecoder {
    fn format(&self) -> &'static str {
        "mat"
    }

    fn sensor(&self) -> Sensor {
        self.rows.sensor
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.rows.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.rows.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        loop {
            let left = self.plan.events - self.events;
            let count = usize::try_from(left)
                .unwrap_or(usize::MAX)
                .min(batch.room());
            let (whole, ended) = layout::fill(&mut self.columns, count);
            for row in 0..whole {
                let numbers = self.row(row);
                match self.rows.event(&numbers) {
                    Ok(event) => event.into_iter().for_each(|event| batch.push(event)),
                    Err((which, what)) => return Err(self.error(which, what)),
                }
                self.events += 1;
            }
            match ended {
                // What is behind the events may be damaged too.
                None if count == 0 => return self.file.damage().map_or(Ok(()), Err),
                // None of a batch may have been an event.
                None if batch.is_empty() => {}
                None => return Ok(()),
                Some((which, what)) => return Err(self.error(which, what)),
            }
        }
    }
}
