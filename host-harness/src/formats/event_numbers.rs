//! Events out of the numbers of an array file: npz, HDF5.

use eecvs_nostd::{Event, Polarity, Sensor};

use super::npy_header::Number;
use super::text_layout::Layout;

// Places of t, x, y and p in [`NAMES`] and in every row.
pub const T: usize = 0;
pub const X: usize = 1;
pub const Y: usize = 2;
pub const P: usize = 3;

/// Names of t, x, y, p.
pub const NAMES: [&[&str]; 4] = [
    &["t", "ts", "time", "times", "timestamp", "timestamps"],
    &["x", "xs"],
    &["y", "ys"],
    &["p", "ps", "pol", "polarity", "polarities"],
];

/// Times that the unit of floats is found from.
pub const SAMPLE_TIMES: usize = 4096;

/// Rows that the columns of an (N, 4) array are found from.
pub const SAMPLE_ROWS: usize = 1000;

/// t, x, y, p of an event; `None` is an unsigned number above 2^63 - 1.
pub type Row = [Option<Number>; 4];

/// What the numbers of the times are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TimeUnit {
    /// Whether floats are seconds; else they are microseconds, as whole numbers are.
    pub seconds: bool,
    /// What is added to every time, in us.
    pub offset_us: u64,
}

impl TimeUnit {
    /// The time in us; `None` where it is negative, no number or above 2^63 - 1.
    pub fn us(self, time: Number) -> Option<u64> {
        let t = match time {
            Number::Whole(t) => t,
            Number::Float(t) => {
                let t = if self.seconds { t * 1e6 } else { t }.round();
                if !(-9.2e18..9.2e18).contains(&t) {
                    return None;
                }
                t as i64
            }
        };
        let offset = i64::try_from(self.offset_us).ok()?;
        t.checked_add(offset)
            .and_then(|t_us| u64::try_from(t_us).ok())
    }
}

/// The event of a row; else which of t, x, y and p is wrong, and how.
pub fn event(row: &Row, unit: TimeUnit, sensor: Sensor) -> Result<Event, (usize, String)> {
    let number = |which: usize| {
        let number = row.get(which).copied().flatten();
        number.ok_or_else(|| (which, "a number above 2^63".to_owned()))
    };
    let t_us = unit.us(number(T)?).ok_or_else(|| {
        let what = "the time is negative, no number or above 2^63 us";
        (T, what.to_owned())
    })?;
    let side = |which: usize| {
        let value = number(which)?;
        value
            .whole()
            .ok_or_else(|| (which, format!("{} is not whole", value.float())))
    };
    let (x, y) = (side(X)?, side(Y)?);
    let polarity = match number(P)?.whole() {
        Some(1) => Polarity::On,
        Some(0 | -1) => Polarity::Off,
        _ => return Err((P, "the polarity is not one of 0, 1, -1".to_owned())),
    };
    match (u16::try_from(x), u16::try_from(y)) {
        (Ok(x), Ok(y)) if sensor.contains(x, y) => Ok(Event {
            t_us,
            x,
            y,
            polarity,
        }),
        _ => {
            let Sensor { width, height } = sensor;
            let what = format!("x = {x}, y = {y} is outside of the sensor ({width}x{height})");
            Err((X, what))
        }
    }
}

/// A coordinate of which a sensor can be large enough.
pub fn coordinate(number: Option<Number>) -> Option<u16> {
    let value = u16::try_from(number?.whole()?).ok()?;
    (value < Sensor::SIDE_MAX).then_some(value)
}

/// Which column of an (N, 4) array is t, x, y and p, told by its first rows as those of a text
/// file without header; `None` where they do not tell.
pub fn column_order(rows: &[[Option<Number>; 4]], sensor: Option<Sensor>) -> Option<[usize; 4]> {
    let texts: Vec<Vec<String>> = rows
        .iter()
        .map(|row| row.iter().flatten().map(text).collect())
        .collect();
    let lines: Vec<Vec<&[u8]>> = texts
        .iter()
        .map(|row| row.iter().map(String::as_bytes).collect())
        .collect();
    let layout = Layout::detect(None, &lines, sensor).ok()?;
    Some([layout.t, layout.x, layout.y, layout.p])
}

fn text(number: &Number) -> String {
    match number {
        Number::Whole(value) => value.to_string(),
        Number::Float(value) => value.to_string(),
    }
}
