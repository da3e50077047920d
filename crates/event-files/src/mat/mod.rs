//! Reads and writes events in MATLAB files of level 5 (`.mat`, written by `save` by default and with `-v6` and
//! `-v7`).
//!
//! * A structure with fields t, x, y and p (also ts, time, timestamp(s); pol, polarity), as Prophesee's
//!   `load_atis_data` returns it and as `TD` of N-MNIST's `Read_Ndataset`; or variables of these names; or one
//!   matrix of N rows and 4 columns, which are told apart like those of a text file without a header. If there are
//!   several structures or matrices, the name of one is appended to the file's: `FILE.mat/TD`.
//! * Scalars `width` and `height`, as variables or in the structure, give the sensor's size; without them and
//!   without a size from the caller it is the largest x and y, plus one.
//! * Real numbers of any class, including the smaller integer types in which MATLAB stores whole numbers;
//!   compressed or not, of either byte order.
//! * A structure inside structures is named by its place: `FILE.mat/aedat/data/polarity` of `AedatTools`.
//! * t: the unit follows the rule in `crate::table::time_unit`; `crate::table::row_events` describes clocks that
//!   wrap, polarities and invalid events.
//! * p: 1 is ON; 0 or -1 is OFF. If all are 1 or 2 and some are 2, 2 is ON and 1 is OFF.
//! * Pixels are counted from 1, as MATLAB does, if no x and no y is 0, since some event of a camera's recording
//!   lies in its first row or column. If the file states width and height, pixels are counted from 1 only if, in
//!   addition, an event has x = width or y = height: files written by this crate state both and count from 0.
//!   `AedatTools` also counts from 0; the field `timeStamp` identifies it.
//!
//! Level 4 cannot be recognised, since its files have no signature. Files of `-v7.3` are HDF5 and read as such.
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

/// A reader of MAT-files.
pub type MatReader = Reader<MatDecoder>;

impl MatReader {
    /// Reads `source`, which messages call `name`. `place` is the variable of the events, if the user named one;
    /// `reading` states what the file does not.
    ///
    /// # Errors
    /// This is no MAT-file of level 5; it is damaged; it has no events, or several variables that may hold them;
    /// the columns, the unit or the size cannot be determined.
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

/// The decoder of [`MatReader`]: its state between two batches.
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
            let rows: Vec<Row> = (0..whole).map(|row| self.row(row)).collect();
            let appended = self.rows.append(&rows, &mut self.events, batch);
            appended.map_err(|(which, what)| self.error(which, what))?;
            match ended {
                // The rest of the file, after the events, may be damaged.
                None if count == 0 => return self.file.damage().map_or(Ok(()), Err),
                // All rows of a batch may have been left out.
                None if batch.is_empty() => {}
                None => return Ok(()),
                Some((which, what)) => return Err(self.error(which, what)),
            }
        }
    }
}
