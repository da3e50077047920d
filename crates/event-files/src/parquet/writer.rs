//! Writes events as Parquet files: t (int64, us), x, y (uint16) as differences, p (bool), in row groups of 131,072
//! events with statistics; `width` and `height` are keys of the footer.
//!
//! Differences take about 4 bytes an event without compression, and every reader supports them.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Sensor};

use super::table::{Cells, Column, GROUP_ROWS, Kind, Table, Values};
use crate::EventWriter;
use crate::output::sequential::Output;

const COLUMNS: [Column; 4] = [
    column("t", Kind::I64),
    column("x", Kind::U16),
    column("y", Kind::U16),
    column("p", Kind::Bool),
];

const fn column(name: &'static str, kind: Kind) -> Column {
    Column {
        name,
        kind,
        is_optional: false,
    }
}

/// A writer of Parquet files. It holds one row group, and about 400 bytes for every row group written.
pub struct ParquetWriter {
    table: Table,
    sensor: Sensor,
    /// t, x and y.
    columns: [Vec<i64>; 3],
    polarities: Vec<bool>,
    events: u64,
}

impl ParquetWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        Ok(Self {
            table: Table::begin(Output::create(path)?, &COLUMNS)?,
            sensor,
            columns: [const { Vec::new() }; 3],
            polarities: Vec::new(),
            events: 0,
        })
    }

    fn write_group(&mut self) -> Result<()> {
        let [t, x, y] = &self.columns;
        let p = &self.polarities;
        let cells = [
            Values::Whole(t),
            Values::Whole(x),
            Values::Whole(y),
            Values::Bools(p),
        ];
        let cells = cells.map(|values| Cells {
            values,
            present: None,
        });
        self.table.group(p.len(), &cells)?;
        self.columns.iter_mut().for_each(Vec::clear);
        self.polarities.clear();
        Ok(())
    }
}

impl EventWriter for ParquetWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(self.table.name(), self.events, event, self.sensor)?;
            let (name, index, t_us) = (self.table.name(), self.events, event.t_us);
            let time = crate::signed_us(name, index, t_us)?;
            let [t, x, y] = &mut self.columns;
            t.push(time);
            x.push(event.x.into());
            y.push(event.y.into());
            self.polarities.push(event.polarity as u8 == 1);
            self.events += 1;
            if self.polarities.len() == GROUP_ROWS {
                self.write_group()?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.write_group()?;
        let Sensor { width, height } = self.sensor;
        let sides = [("width", width), ("height", height)];
        self.table
            .finish(&sides.map(|(key, side)| (key, side.to_string())))
    }
}
