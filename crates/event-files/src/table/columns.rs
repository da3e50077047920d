//! Finds t, x, y and p among the columns of an Arrow or Parquet table, and what their numbers mean.

use event_types::Sensor;

use crate::numpy::npy_header::Dtype;
use crate::reading::Reading;
use crate::table::event_numbers::{Name, find_names, given_names, names_taken};
use crate::table::row_events::{Scale, Times};
use crate::table::stated_size::StatedSize;
use crate::table::{stated_size, time_unit};
use crate::{Assumption, reading};

/// Metadata keys that state the unit of the times.
const UNIT_KEYS: [&str; 4] = ["time_unit", "t_unit", "units", "unit"];

/// The way in which a column's values are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// Little-endian numbers.
    Number(Dtype),
    /// Bits, the lowest of a byte first.
    Bool,
}

/// A column of a table's schema.
pub struct Named<'a> {
    /// The column's name.
    pub name: &'a str,
    /// How its values are stored; `None` if the type is not supported.
    pub stored: Option<Stored>,
    /// For times with a unit, its power of ten: a value times 10 to this is in microseconds.
    pub shift: Option<i32>,
}

/// The place and the meaning of the events' numbers.
#[derive(Debug, Clone)]
pub struct Columns {
    /// Positions of t, x, y and p in the schema.
    pub places: [usize; 4],
    /// How t, x, y and p are stored.
    pub stored: [Stored; 4],
    /// What the file states about its times.
    pub times: Times,
    /// The size that names such as `x@320` state.
    pub sensor: Option<Sensor>,
    /// How the columns were found, if that may be wrong.
    pub assumption: Option<Assumption>,
}

impl Columns {
    /// Finds t, x, y and p as the caller stated, otherwise by their names.
    ///
    /// # Errors
    /// A column is missing or of a type that is not supported.
    pub fn find(schema: &[Named], reading: &Reading) -> Result<Self, String> {
        let names = || schema.iter().map(|column| column.name);
        let named = find_names(names(), given_names(reading));
        let places = match &reading.columns {
            Some(reading::Columns::Places { places, columns }) if *columns == schema.len() => {
                *places
            }
            Some(reading::Columns::Places { columns, .. }) => {
                let count = schema.len();
                return Err(format!(
                    "--columns has {columns} columns, but the file has {count}"
                ));
            }
            _ => named.as_ref().map(|named| named.places).ok_or_else(|| {
                let names: Vec<&str> = names().take(24).collect();
                format!(
                    "no columns t, x, y, p, only {}: see --columns",
                    names.join(", ")
                )
            })?,
        };
        let mut stored = [Stored::Bool; 4];
        for (slot, place) in stored.iter_mut().zip(places) {
            let column = schema.get(place).ok_or("no such column")?;
            *slot = column.stored.ok_or_else(|| {
                let name = column.name;
                format!("column {name} is of an unsupported type: cast it to int64")
            })?;
        }
        let [t, ..] = places;
        let time = schema.get(t);
        let named_unit = time.and_then(|time| Name::parse(time.name)?.unit);
        let [stored_time, ..] = stored;
        let mut times = Times::of(match stored_time {
            Stored::Number(dtype) => Some(dtype),
            Stored::Bool => None,
        });
        let shift = time.and_then(|time| time.shift).map(Scale::shift);
        times.scale = shift.or(named_unit.map(Scale::from));
        Ok(Self {
            places,
            stored,
            times,
            sensor: named.as_ref().and_then(|named| named.sensor),
            assumption: named.as_ref().and_then(names_taken),
        })
    }
}

/// Returns the sensor's size and the unit of the times that a table's metadata states.
pub fn stated<'a>(
    pairs: impl Iterator<Item = (&'a str, &'a str)>,
) -> (Option<Sensor>, Option<Scale>) {
    let mut size = StatedSize::default();
    let mut scale = None;
    for (key, value) in pairs {
        if stated_size::is_known(key) {
            size.text(key, value);
        }
        if UNIT_KEYS.contains(&key) {
            scale = time_unit::named(value).map(Scale::from);
        }
    }
    (size.sensor(), scale)
}

/// Returns whether [`stated`] uses this metadata key.
pub fn is_known_key(key: &str) -> bool {
    stated_size::is_known(key) || UNIT_KEYS.contains(&key)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(names: &[&str], shift: Option<i32>, how: Option<&str>) -> Result<Columns, String> {
        let schema: Vec<Named> = names
            .iter()
            .enumerate()
            .map(|(index, name)| Named {
                name,
                stored: Dtype::new(b'i', false, 8).map(Stored::Number),
                shift: shift.filter(|_| index == 0),
            })
            .collect();
        let columns = how.map(|how| reading::Columns::parse(how).unwrap());
        let reading = Reading {
            columns,
            ..Reading::default()
        };
        Columns::find(&schema, &reading)
    }

    #[test]
    fn units_of_times() {
        for (name, shift, want) in [
            ("t", None, None),
            ("timestamp_ns", None, Some(Scale::shift(-3))),
            ("t_s", None, Some(Scale::shift(6))),
            ("time", Some(-3), Some(Scale::shift(-3))),
            ("t_s", Some(3), Some(Scale::shift(3))),
        ] {
            let found = columns(&[name, "x", "y", "polarity"], shift, None).unwrap();
            assert_eq!(found.times.scale, want, "{name}");
        }
    }

    #[test]
    fn columns_are_named_or_placed() {
        let names = ["time", "col", "row", "sign", "t"];
        let error = columns(&names, None, None).unwrap_err();
        assert!(
            error.contains("sign") && error.contains("--columns"),
            "{error}"
        );
        let found = columns(&names, None, Some("t=time,x=col,y=row,p=sign")).unwrap();
        assert_eq!(found.places, [0, 1, 2, 3]);
        let found = columns(&names, None, Some("-xypt")).unwrap();
        assert_eq!(found.places, [4, 1, 2, 3]);
        assert!(columns(&names, None, Some("txyp")).is_err());
        // Two columns could be t: the likelier one is taken, and an assumption says so.
        let found = columns(&["time", "x", "y", "p", "t"], None, None).unwrap();
        assert_eq!(found.places, [4, 1, 2, 3]);
        assert!(found.assumption.unwrap().why.contains("time"));
    }
}
