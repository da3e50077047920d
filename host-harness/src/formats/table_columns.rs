//! Which columns of a table, in an Arrow or Parquet file, are t, x, y and p, and what their numbers mean.

use eecvs_nostd::{Event, Sensor};

use super::event_numbers::{self, Row, SAMPLE_TIMES, T, TimeUnit};
use super::npy_header::{Dtype, Number};
use super::reading;
use super::text_layout::Header;
use super::time_unit::TimeSample;

/// How a column's values are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// Numbers, little-endian.
    Number(Dtype),
    /// Bits, the lowest of a byte first.
    Bool,
}

/// A column of the schema.
pub struct Named<'a> {
    /// Its name.
    pub name: &'a str,
    /// How it is stored, if that can be read.
    pub stored: Option<Stored>,
    /// Of a time with a unit: microseconds are its values times 10 to this.
    pub shift: Option<i32>,
}

/// Where the numbers of the events are.
#[derive(Debug, Clone)]
pub struct Columns {
    /// Places of t, x, y and p in the schema.
    pub places: [usize; 4],
    /// How these are stored.
    pub stored: [Stored; 4],
    /// Microseconds are times times 10 to this; `None` where the first times must tell.
    shift: Option<i32>,
    /// From names like `x@320`.
    pub sensor: Option<Sensor>,
}

impl Columns {
    /// Finds t, x, y and p by their names, which are those of a text file's header.
    ///
    /// # Errors
    /// What is missing or of a type that is not read.
    pub fn find(schema: &[Named]) -> Result<Self, String> {
        let names: Vec<&[u8]> = schema.iter().map(|column| column.name.as_bytes()).collect();
        let header = Header::parse(&names).ok_or_else(|| {
            let names: Vec<&str> = schema.iter().map(|column| column.name).take(24).collect();
            format!(
                "no columns t, x, y, p, once each, but {}: rename or drop columns",
                names.join(", ")
            )
        })?;
        let layout = header.layout();
        let places = [layout.t, layout.x, layout.y, layout.p];
        let mut stored = [Stored::Bool; 4];
        for (slot, place) in stored.iter_mut().zip(places) {
            let column = schema.get(place).ok_or("no such column")?;
            *slot = column.stored.ok_or_else(|| {
                let name = column.name;
                format!("column {name} is of a type that is not read: cast it to int64")
            })?;
        }
        let time = schema.get(layout.t);
        let named = layout.unit.map(reading::TimeUnit::shift);
        let is_float = matches!(stored[T], Stored::Number(dtype) if dtype.is_float());
        let shift = time.and_then(|time| time.shift).or(named);
        let sensor = header.sensor.and_then(|(width, height)| {
            Sensor::new(width.try_into().ok()?, height.try_into().ok()?)
        });
        Ok(Self {
            places,
            stored,
            // Whole numbers without a word about it are microseconds.
            shift: shift.or((!is_float).then_some(0)),
            sensor,
        })
    }

    /// How many of the first times [`Columns::learn`] wants to see, if any.
    pub fn sample(&self) -> Option<usize> {
        self.shift.is_none().then_some(SAMPLE_TIMES)
    }

    /// Finds the unit of float times, seconds or microseconds, from the first of them.
    pub fn learn(&mut self, times: impl Iterator<Item = Option<Number>>) {
        let mut sample = TimeSample::default();
        for time in times.flatten() {
            sample.add(time.float().fract() == 0.0, time.float());
        }
        self.shift = Some(if sample.seconds() { 6 } else { 0 });
    }

    /// The time in us.
    pub fn t_us(&self, time: Option<Number>) -> Option<u64> {
        TimeUnit::default().us(self.scaled(time)?)
    }

    /// The time in us, rounded to the nearest; `None` beyond 2^63.
    fn scaled(&self, time: Option<Number>) -> Option<Number> {
        let shift = self.shift.unwrap_or(0);
        let power = 10_i64.checked_pow(shift.unsigned_abs())?;
        Some(match time? {
            Number::Whole(time) if shift >= 0 => Number::Whole(time.checked_mul(power)?),
            Number::Whole(time) => Number::Whole(
                (time.div_euclid(power)) + i64::from(time.rem_euclid(power) * 2 >= power),
            ),
            // Seconds are scaled as other formats do it, so that they agree to the last bit.
            Number::Float(time) if shift >= 0 => Number::Float(time * power as f64),
            Number::Float(time) => Number::Float(time / power as f64),
        })
    }

    /// The event of a row; else which of t, x, y and p is wrong, and how.
    pub fn event(&self, row: &Row, sensor: Sensor) -> Result<Event, (usize, String)> {
        let mut row = *row;
        row[T] = Some(self.scaled(row[T]).ok_or_else(|| {
            let what = "the time is above 2^63 us";
            (T, what.to_owned())
        })?);
        event_numbers::event(&row, TimeUnit::default(), sensor)
    }
}

/// Size of the sensor that the metadata of a table states as `width` and `height`.
pub fn stated_size<'a>(pairs: impl Iterator<Item = (&'a str, &'a str)>) -> Option<Sensor> {
    let (mut width, mut height) = (None, None);
    for (key, value) in pairs {
        match key {
            "width" => width = value.trim().parse().ok(),
            "height" => height = value.trim().parse().ok(),
            _ => {}
        }
    }
    Sensor::new(width?, height?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(names: &[&str], time: u8, shift: Option<i32>) -> Result<Columns, String> {
        let schema: Vec<Named> = names
            .iter()
            .enumerate()
            .map(|(index, name)| Named {
                name,
                stored: Dtype::new(if index == 0 { time } else { b'u' }, false, 8)
                    .map(Stored::Number),
                shift: shift.filter(|_| index == 0),
            })
            .collect();
        Columns::find(&schema)
    }

    #[test]
    fn units_of_times() {
        for (name, shift, time, us) in [
            ("t", None, 1_500, 1_500),
            ("timestamp_ns", None, 1_500, 2),
            ("timestamp_ns", None, 1_499, 1),
            ("t_s", None, 2, 2_000_000),
            ("time", Some(-3), 2_000, 2),
            ("t", Some(3), 7, 7_000),
        ] {
            let found = columns(&[name, "x", "y", "polarity"], b'i', shift).unwrap();
            assert_eq!(found.t_us(Some(Number::Whole(time))), Some(us), "{name}");
        }
        let found = columns(&["ts", "xs", "ys", "ps"], b'i', Some(6)).unwrap();
        assert_eq!(found.t_us(Some(Number::Whole(i64::MAX))), None);
        assert_eq!(found.t_us(Some(Number::Whole(-1))), None);
    }

    #[test]
    fn floats_are_seconds_or_microseconds() {
        let mut found = columns(&["t", "x", "y", "p"], b'f', None).unwrap();
        assert!(found.sample().is_some());
        found.learn([0.0, 0.25].map(|t| Some(Number::Float(t))).into_iter());
        assert_eq!(found.t_us(Some(Number::Float(0.25))), Some(250_000));
        found.learn((0..20).map(|t| Some(Number::Float(f64::from(t)))));
        assert_eq!(found.t_us(Some(Number::Float(7.0))), Some(7));
    }

    #[test]
    fn what_is_missing_is_said() {
        let error = columns(&["t", "x", "y", "colour"], b'i', None).unwrap_err();
        assert!(error.contains("colour"), "{error}");
        assert!(columns(&["t", "x", "y", "p", "time"], b'i', None).is_err());
    }
}
