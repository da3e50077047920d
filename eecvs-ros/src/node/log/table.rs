//! The two tables: their columns and rows.

use anyhow::Result;
use eecvs::reconstruct::DecodedWindow;
use event_files::parquet::table::Kind;
use serde::{Serialize, Serializer};

use super::window::Window;
use crate::message::Time;

/// A column: its name and the kind of its values.
pub type Column = (&'static str, Kind);

/// The columns of a table.
#[derive(Debug, Clone, Copy)]
pub struct Table {
    /// The table's name, which is also its topic's.
    pub name: &'static str,
    /// Columns whose values all rows of a window share.
    pub shared: &'static [Column],
    /// Columns with separate values in each row; if there are none, a window has one row.
    pub own: &'static [Column],
}

/// A value in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell {
    /// The value is unknown or does not apply.
    Missing,
    /// An integer.
    Whole(i64),
    /// A floating-point number.
    Float(f64),
    /// One of a few fixed words.
    Text(&'static str),
}

/// Table with one row per window.
///
/// `seq` and `stamp_ns` are those of the window's last frame received. `window_events` is N_w, from which rate and
/// density are computed; `events` counts the events in the frames received, from which `bits_per_event` is
/// computed. Values that another operator's frames do not provide are missing, and so are the coefficients of a
/// window sent as events. `frames_lost` counts the losses of all windows so far.
pub const FEATURES: Table = Table {
    name: "features",
    shared: &[
        ("seq", Kind::I64),
        ("stamp_ns", Kind::I64),
        ("t0_us", Kind::I64),
        ("duration_us", Kind::I64),
        ("width", Kind::I64),
        ("height", Kind::I64),
        ("operator", Kind::Text),
        ("mode", Kind::Text),
        ("coder", Kind::Text),
        ("time_tolerance_us", Kind::I64),
        ("bins", Kind::I64),
        ("window_events", Kind::I64),
        ("rate_eps", Kind::F64),
        ("density_per_px_s", Kind::F64),
        ("regime", Kind::Text),
        ("transform", Kind::Text),
        ("m", Kind::I64),
        ("grid", Kind::I64),
        ("step", Kind::F64),
        ("events", Kind::I64),
        ("frames", Kind::I64),
        ("bytes", Kind::I64),
        ("bits_per_event", Kind::F64),
        ("coefficients", Kind::I64),
        ("coefficient_pixels", Kind::I64),
        ("late", Kind::I64),
        ("filtered", Kind::I64),
        ("dropped", Kind::I64),
        ("thinned", Kind::I64),
        ("frames_lost", Kind::I64),
    ],
    own: &[],
};

/// Table with one row per coefficient; `seq` is that of its window's row. Coefficients of real transforms have no
/// `im`.
pub const COEFFICIENTS: Table = Table {
    name: "coefficients",
    shared: &[
        ("seq", Kind::I64),
        ("t0_us", Kind::I64),
        ("duration_us", Kind::I64),
        ("transform", Kind::Text),
    ],
    own: &[
        ("x", Kind::U16),
        ("y", Kind::U16),
        ("k", Kind::U16),
        ("re", Kind::F64),
        ("im", Kind::F64),
    ],
};

/// The rows of a window in one table.
pub struct Rows<'w> {
    /// The stamp of the window's frame.
    pub stamp: Time,
    /// Values of the columns [`Table::shared`].
    pub shared: Vec<Cell>,
    /// Source of the values of [`Table::own`]; `None` if the table has no such columns.
    pub coefficients: Option<&'w DecodedWindow>,
}

/// Callback that receives the values of a row's own columns.
pub type Each<'e> = &'e mut dyn FnMut(&[Cell]) -> Result<()>;

impl<'w> Rows<'w> {
    /// Returns a window's row of [`FEATURES`].
    pub fn features(window: &Window, frames_lost: u64) -> Self {
        let header = window.header.as_ref();
        let density = window.density();
        let duration_s = f64::from(window.duration_us) * 1e-6;
        let bits = window.bytes as f64 * 8.0;
        Self {
            stamp: window.stamp,
            shared: vec![
                window.seq.into(),
                Cell::Whole(window.stamp.ns()),
                window.t0_us.into(),
                window.duration_us.into(),
                window.width.into(),
                window.height.into(),
                Cell::Text(window.operator),
                window.mode().into(),
                window.coder().into(),
                window.time_tolerance_us().into(),
                window.bins().into(),
                window.window_events().into(),
                Cell::ratio(window.window_events() as f64, duration_s),
                density.into(),
                header.map(|header| header.regime.name()).into(),
                header.map(|header| header.transform.name()).into(),
                header.map(|header| u32::from(header.m)).into(),
                header.map(|header| u32::from(header.grid)).into(),
                window.step().into(),
                window.events.into(),
                window.frames.into(),
                window.bytes.into(),
                Cell::ratio(bits, window.events as f64),
                window.coefficients.into(),
                window.coefficient_pixels.into(),
                window.late.into(),
                window.filtered.into(),
                window.dropped.into(),
                window.thinned.into(),
                frames_lost.into(),
            ],
            coefficients: None,
        }
    }

    /// Returns the rows of [`COEFFICIENTS`] of a window that was completed by the frame `seq`.
    pub fn coefficients(seq: u64, stamp: Time, window: &'w DecodedWindow) -> Self {
        let header = &window.header;
        Self {
            stamp,
            shared: vec![
                seq.into(),
                header.t0_us.into(),
                header.duration_us.into(),
                Cell::Text(header.transform.name()),
            ],
            coefficients: Some(window),
        }
    }

    /// Passes the own cells of every row to `each`.
    ///
    /// # Errors
    /// `each` returns an error.
    pub fn each(&self, each: Each<'_>) -> Result<()> {
        let Some(window) = self.coefficients else {
            return each(&[]);
        };
        let is_complex = window.header.transform.is_complex();
        for pixel in &window.pixels {
            for (k, re, im) in &pixel.coefficients {
                let im = is_complex.then_some(*im);
                each(&[
                    Cell::Whole(pixel.x.into()),
                    Cell::Whole(pixel.y.into()),
                    Cell::Whole((*k).into()),
                    Cell::Float(*re),
                    im.into(),
                ])?;
            }
        }
        Ok(())
    }
}

impl Cell {
    /// Returns the quotient, or a missing cell if the divisor is not positive.
    fn ratio(of: f64, by: f64) -> Self {
        if by > 0.0 {
            Self::Float(of / by)
        } else {
            Self::Missing
        }
    }
}

impl From<u64> for Cell {
    /// A number beyond 63 bits, which no table can hold, becomes a missing cell.
    fn from(number: u64) -> Self {
        i64::try_from(number).map_or(Self::Missing, Self::Whole)
    }
}

impl From<u32> for Cell {
    fn from(number: u32) -> Self {
        Self::Whole(number.into())
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Float(number)
    }
}

impl From<&'static str> for Cell {
    fn from(text: &'static str) -> Self {
        Self::Text(text)
    }
}

impl<T: Into<Self>> From<Option<T>> for Cell {
    fn from(told: Option<T>) -> Self {
        told.map_or(Self::Missing, Into::into)
    }
}

impl Serialize for Cell {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Missing => to.serialize_none(),
            Self::Whole(number) => to.serialize_i64(*number),
            Self::Float(number) => to.serialize_f64(*number),
            Self::Text(text) => to.serialize_str(text),
        }
    }
}
