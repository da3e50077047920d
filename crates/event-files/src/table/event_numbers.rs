//! Recognises t, x, y and p in arrays and tables by their names, or by the values of unnamed columns.

use event_types::Sensor;

use crate::Assumption;
use crate::numpy::npy_header::Number;
use crate::reading::{Columns, Reading, TimeUnit};
use crate::table::time_unit;
use crate::text::layout::Layout;

// Positions of t, x, y and p in [`NAMES`] and in every row.
pub const T: usize = 0;
pub const X: usize = 1;
pub const Y: usize = 2;
pub const P: usize = 3;

/// Names of t, x, y and p, the likeliest first. Those of t may end in a unit.
const NAMES: [&[&str]; 4] = [
    &["t", "ts", "time", "times", "timestamp", "timestamps"],
    &["x", "xs", "x_px", "col", "column", "xaddr", "x_addr"],
    &["y", "ys", "y_px", "row", "yaddr", "y_addr"],
    &["p", "ps", "pol", "polarity", "polarities", "on"],
];

/// Names of t, x, y and p in messages.
pub const SHORT: [&str; 4] = ["t", "x", "y", "p"];

/// Text before and after the unit at the end of a time's name.
const UNIT_ENDINGS: [(&str, &str); 12] = [
    ("_s", ""),
    ("_sec", ""),
    ("_seconds", ""),
    ("_ms", ""),
    ("_us", ""),
    ("_usec", ""),
    ("_ns", ""),
    ("_nsec", ""),
    ("_nanoseconds", ""),
    ("_microseconds", ""),
    ("[", "]"),
    ("(", ")"),
];

/// Number of rows from which the columns of an (N, 4) array are recognised.
pub const SAMPLE_ROWS: usize = 1000;

/// t, x, y and p of an event. `None` is an unsigned number above 2^63 - 1; NaN is a missing value.
pub type Row = [Option<Number>; 4];

/// The meaning of the name of a column, field or array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Name {
    /// Which of t, x, y and p the name stands for.
    pub which: usize,
    /// Position of the name among the known ones; 0 is the likeliest.
    rank: usize,
    /// The unit of the times, if the name states it.
    pub unit: Option<TimeUnit>,
    /// The sensor's side, from a name such as `x@320`.
    pub side: Option<u16>,
}

impl Name {
    /// Parses a name; `None` if it stands for none of t, x, y and p.
    pub fn parse(text: &str) -> Option<Self> {
        let name = text.trim().trim_matches(['"', '\'']).to_ascii_lowercase();
        let (name, side) = match name.split_once('@') {
            Some((name, side)) => (name.to_owned(), side.parse().ok()),
            None => (name, None),
        };
        let find = |name: &str| {
            NAMES.iter().enumerate().find_map(|(which, names)| {
                let rank = names.iter().position(|known| *known == name)?;
                Some((which, rank))
            })
        };
        if let Some((which, rank)) = find(&name) {
            return Some(Self {
                which,
                rank,
                unit: None,
                side,
            });
        }
        UNIT_ENDINGS.iter().find_map(|(before, behind)| {
            let (stem, unit) = if behind.is_empty() {
                (name.strip_suffix(before)?, before.trim_start_matches('_'))
            } else {
                name.strip_suffix(behind)?.split_once(before)?
            };
            let unit = time_unit::named(unit)?;
            let (which, rank) = find(stem.trim_end())?;
            (which == T).then_some(Self {
                which,
                rank,
                unit: Some(unit),
                side: None,
            })
        })
    }
}

/// The names that were recognised as t, x, y and p.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Named {
    /// Positions of t, x, y and p among all names.
    pub places: [usize; 4],
    /// The unit that the name of t states.
    pub unit: Option<TimeUnit>,
    /// The size that names such as `x@320` state.
    pub sensor: Option<Sensor>,
    /// Other names that could also stand for one of them.
    pub passed_by: Vec<String>,
}

/// Finds t, x, y and p by the names that the caller gave, otherwise by the likeliest of their usual names; `None`
/// if one is missing.
pub fn find_names<'a>(
    names: impl Iterator<Item = &'a str>,
    given: Option<&[String; 4]>,
) -> Option<Named> {
    let names: Vec<&str> = names.collect();
    let mut places = [None; 4];
    let mut passed_by = Vec::new();
    for (which, slot) in places.iter_mut().enumerate() {
        *slot = match given {
            Some(given) => names
                .iter()
                .position(|name| given.get(which).is_some_and(|given| given == name)),
            None => {
                let known = names.iter().enumerate().filter_map(|(place, name)| {
                    let known = Name::parse(name).filter(|known| known.which == which)?;
                    // Of two equally likely names, the one that states its unit is preferred.
                    Some((known.rank, known.unit.is_none(), place))
                });
                let known: Vec<(usize, bool, usize)> = known.collect();
                let least = known.iter().min().map(|(.., place)| *place);
                let others = known.iter().filter(|(.., place)| Some(*place) != least);
                passed_by.extend(
                    others.filter_map(|(.., place)| Some((*names.get(*place)?).to_owned())),
                );
                least
            }
        };
    }
    let [Some(t), Some(x), Some(y), Some(p)] = places else {
        return None;
    };
    let parsed = |place: usize| Name::parse(names.get(place)?);
    let side = |place| parsed(place).and_then(|name| name.side);
    Some(Named {
        places: [t, x, y, p],
        unit: parsed(t).and_then(|name| name.unit),
        sensor: side(x)
            .zip(side(y))
            .and_then(|(width, height)| Sensor::new(width, height)),
        passed_by,
    })
}

/// Returns the names that the caller gave for t, x, y and p.
pub fn given_names(reading: &Reading) -> Option<&[String; 4]> {
    match &reading.columns {
        Some(Columns::Names(names)) => Some(names),
        _ => None,
    }
}

/// Returns the assumption that the likeliest names were meant, if there are others.
pub fn names_taken(named: &Named) -> Option<Assumption> {
    (!named.passed_by.is_empty()).then(|| Assumption {
        what: "columns",
        taken: "those with the likeliest names".to_owned(),
        why: format!(
            "{} could be meant too; --columns t=NAME,x=NAME,y=NAME,p=NAME overrides this",
            named.passed_by.join(", ")
        ),
    })
}

/// Returns the assumption about the order of a table's unnamed columns; `columns` are those of t, x, y and p.
pub fn order_taken(columns: [usize; 4]) -> Assumption {
    let mut letters = ["t", "x", "y", "p"]
        .into_iter()
        .zip(columns)
        .collect::<Vec<_>>();
    letters.sort_by_key(|(_, column)| *column);
    Assumption {
        what: "columns",
        taken: letters.into_iter().map(|(letter, _)| letter).collect(),
        why: format!("recognised from the first {SAMPLE_ROWS} rows; --columns overrides this"),
    }
}

/// Returns the number as a coordinate; `None` unless it lies within the largest sensor.
pub fn coordinate(number: Option<Number>) -> Option<u16> {
    let value = u16::try_from(number?.whole()?).ok()?;
    (value < Sensor::SIDE_MAX).then_some(value)
}

/// Returns which columns of an (N, 4) array are t, x, y and p, judged by its first rows like the columns of a text
/// file without a header; `None` if this cannot be decided.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_what_they_are() {
        let of = |text| Name::parse(text).map(|name| (name.which, name.unit, name.side));
        for (text, want) in [
            ("t", Some((T, None, None))),
            ("timeStamp", Some((T, None, None))),
            ("timestamps_ns", Some((T, Some(TimeUnit::Ns), None))),
            ("Time [us]", Some((T, Some(TimeUnit::Us), None))),
            ("timestamp (s)", Some((T, Some(TimeUnit::S), None))),
            ("t_ms", Some((T, Some(TimeUnit::Ms), None))),
            ("x@320", Some((X, None, Some(320)))),
            ("on", Some((P, None, None))),
            ("x_ns", None),
            ("events", None),
            ("(", None),
            ("_s", None),
        ] {
            assert_eq!(of(text), want, "{text}");
        }
    }

    #[test]
    fn the_likeliest_names_count() {
        let names = ["timestamps", "p", "y", "x", "t_us", "t"];
        let found = find_names(names.into_iter(), None).unwrap();
        assert_eq!(found.places, [4, 3, 2, 1]);
        assert_eq!(found.passed_by, ["timestamps", "t"]);
        let given = ["t_us", "x", "y", "p"].map(str::to_owned);
        let found = find_names(names.into_iter(), Some(&given)).unwrap();
        assert_eq!(
            (found.places, found.unit),
            ([4, 3, 2, 1], Some(TimeUnit::Us))
        );
        assert_eq!(find_names(["t", "x", "y"].into_iter(), None), None);
    }
}
