//! Finds which column of a text file is which, from the caller, the header line or the first event lines.

use event_types::Sensor;

use crate::reading::{Columns, TimeUnit};
use crate::table::time_unit;
use crate::text::decimal::Decimal;

/// Column orders tried on files without a header, the likeliest first.
const ORDERS: [[Field; 4]; 6] = {
    use Field::{P, T, X, Y};
    [
        [T, X, Y, P],
        [X, Y, T, P],
        [X, Y, P, T],
        [T, P, X, Y],
        [P, T, X, Y],
        [P, X, Y, T],
    ]
};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Field {
    T,
    X,
    Y,
    P,
}

/// The columns of a file, counted from 0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// Number of fields in a line; any other number is an error.
    pub columns: usize,
    /// Column of the time.
    pub t: usize,
    /// Column of x.
    pub x: usize,
    /// Column of y.
    pub y: usize,
    /// Column of the polarity.
    pub p: usize,
    /// Unit of the time, if the column's name states it.
    pub unit: Option<TimeUnit>,
}

/// The column names in a header line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    layout: Layout,
    /// Width and height, from names such as `x@320`.
    pub sensor: Option<(u64, u64)>,
}

impl Header {
    /// Parses column names; `None` unless each of t, x, y and p is among them exactly once. A name may be in quotes
    /// and state a unit: `t_us`, `timestamp (us)`, `x [px]`.
    pub fn parse(fields: &[&[u8]]) -> Option<Self> {
        let (mut t, mut x, mut y, mut p) = (None, None, None, None);
        let (mut width, mut height) = (None, None);
        let mut unit = None;
        for (column, field) in fields.iter().enumerate() {
            let text = plain_name(field)?;
            let (name, side) = match text.split_once('@') {
                Some((name, side)) => (name, side.parse::<u64>().ok()),
                None => (text.as_str(), None),
            };
            let (stem, named_unit) = stem(name);
            let slot = match stem {
                "x" | "xs" | "col" | "column" | "x_px" => {
                    width = side;
                    &mut x
                }
                "y" | "ys" | "row" | "y_px" => {
                    height = side;
                    &mut y
                }
                "p" | "ps" | "pol" | "polarity" | "polarities" | "on" => &mut p,
                "t" | "ts" | "time" | "times" | "timestamp" | "timestamps" => {
                    unit = named_unit;
                    &mut t
                }
                _ => continue,
            };
            if slot.replace(column).is_some() {
                return None;
            }
        }
        let layout = Layout {
            columns: fields.len(),
            t: t?,
            x: x?,
            y: y?,
            p: p?,
            unit,
        };
        Some(Self {
            layout,
            sensor: width.zip(height),
        })
    }

    /// Finds the columns with the given `names` in a line of column names; `None` if one is missing or occurs twice.
    pub fn of_names(fields: &[&[u8]], names: &[String; 4]) -> Option<Self> {
        let all: Vec<String> = fields
            .iter()
            .map(|field| plain_name(field))
            .collect::<Option<_>>()?;
        let mut places = [0; 4];
        for (place, name) in places.iter_mut().zip(names) {
            let name = name.trim().to_lowercase();
            let mut found = (0..all.len()).filter(|column| all.get(*column) == Some(&name));
            *place = found.next()?;
            if found.next().is_some() {
                return None;
            }
        }
        let [t, x, y, p] = places;
        let unit = all.get(t).and_then(|name| stem(name).1);
        let layout = Layout {
            columns: fields.len(),
            t,
            x,
            y,
            p,
            unit,
        };
        Some(Self {
            layout,
            sensor: None,
        })
    }

    /// Returns the positions of the columns.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }
}

/// Returns a column's name in lower case, without quotes and surrounding spaces.
fn plain_name(field: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(field).ok()?;
    Some(text.trim().trim_matches(['"', '\'']).trim().to_lowercase())
}

/// Returns a column's name without its unit, and the unit of time that it states.
fn stem(name: &str) -> (&str, Option<TimeUnit>) {
    for (open, close) in [('(', ')'), ('[', ']')] {
        if let Some((stem, unit)) = name
            .strip_suffix(close)
            .and_then(|name| name.rsplit_once(open))
        {
            return (stem.trim_end_matches([' ', '_']), time_unit::named(unit));
        }
    }
    if let Some((stem, unit)) = name.rsplit_once(['_', ' '])
        && let Some(unit) = time_unit::named(unit)
    {
        return (stem.trim_end(), Some(unit));
    }
    (name, None)
}

/// Returns whether a field is ON (`true`) or OFF (`false`); `None` if it is not a polarity.
pub fn polarity(field: &[u8]) -> Option<bool> {
    match field {
        b"1" => return Some(true),
        b"0" | b"-1" => return Some(false),
        _ => {}
    }
    let is = |word: &str| field.eq_ignore_ascii_case(word.as_bytes());
    if is("true") || is("on") {
        return Some(true);
    }
    if is("false") || is("off") {
        return Some(false);
    }
    let number = Decimal::parse(field)?;
    match number.whole() {
        Some(1) => Some(true),
        Some(0) => Some(false),
        _ => number.is_minus_one().then_some(false),
    }
}

/// A layout that was found, and the reason for choosing it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// The positions of the columns.
    pub layout: Layout,
    /// The reason; `None` if the file or the caller states the layout.
    pub why: Option<&'static str>,
}

impl Layout {
    /// Returns the layout that the caller states by positions; `None` if the columns are named.
    pub fn of_places(columns: &Columns) -> Option<Self> {
        match columns {
            Columns::Places {
                places: [t, x, y, p],
                columns,
            } => Some(Self {
                columns: *columns,
                t: *t,
                x: *x,
                y: *y,
                p: *p,
                unit: None,
            }),
            Columns::Names(_) => None,
        }
    }

    /// Returns the layout that a header states, otherwise that of [`Layout::from_numbers`].
    ///
    /// # Errors
    /// Those of [`Layout::from_numbers`].
    pub fn detect(
        header: Option<&Header>,
        lines: &[Vec<&[u8]>],
        sensor: Option<Sensor>,
    ) -> Result<Self, &'static str> {
        match header {
            Some(header) => Ok(header.layout.clone()),
            None => Self::from_numbers(lines, sensor).map(|found| found.layout),
        }
    }

    /// Finds the layout from the first event lines of a file without names.
    ///
    /// An order fits if every line has four numbers, p is a polarity, x and y are whole numbers below the sensor's
    /// sides, and only t has fractions. If several fit, the only one whose times never fall and are not all the
    /// same is taken. Lines may have further columns after t x y p, such as v2e's labels, if t has fractions.
    ///
    /// # Errors
    /// No order fits, or several do.
    pub fn from_numbers(
        lines: &[Vec<&[u8]>],
        sensor: Option<Sensor>,
    ) -> Result<Found, &'static str> {
        const UNCLEAR: &str = "the order of the columns is unclear: give it with --columns, such \
                               as --columns txyp, or add a first line such as t,x,y,p";
        const SEVERAL: &str = "more than one order of the columns fits: give it with --columns, \
                               such as --columns txyp or xytp, or add a first line such as t,x,y,p";
        let Some(first) = lines.first() else {
            return Ok(Found {
                layout: Self::of_order(&[Field::T, Field::X, Field::Y, Field::P], 4),
                why: None,
            });
        };
        let columns = first.len();
        // Later damage must not decide: lines that fit none of the remaining orders are ignored here, and the
        // reader reports them.
        let mut orders: Vec<&[Field; 4]> = ORDERS.iter().collect();
        if columns > 4 {
            orders.truncate(1);
        }
        let mut fitting_lines = Vec::new();
        for (index, line) in lines.iter().enumerate() {
            let fitting: Vec<_> = orders
                .iter()
                .filter(|order| line.len() == columns && fits(order, line, sensor))
                .copied()
                .collect();
            if fitting.is_empty() {
                if index == 0 {
                    return Err(UNCLEAR);
                }
                continue;
            }
            orders = fitting;
            fitting_lines.push(line);
        }
        let fraction = |column: usize| {
            fitting_lines.iter().any(|line| {
                let number = line.get(column).and_then(|field| Decimal::parse(field));
                number.is_some_and(|number| number.fractional && !number.is_whole())
            })
        };
        let fractions: Vec<usize> = (0..4).filter(|column| fraction(*column)).collect();
        if columns > 4 && fractions.is_empty() {
            return Err(UNCLEAR);
        }
        let candidates: Vec<Self> = orders
            .into_iter()
            .map(|order| Self::of_order(order, columns))
            .filter(|layout| fractions.iter().all(|column| *column == layout.t))
            .collect();
        if let [layout] = candidates.as_slice() {
            let why = match columns {
                4 => "no column names; no other order fits the first lines",
                _ => "no column names; further columns, such as v2e's labels, are left out",
            };
            return Ok(Found {
                layout: layout.clone(),
                why: Some(why),
            });
        }
        let rising: Vec<&Self> = candidates
            .iter()
            .filter(|layout| rises(&fitting_lines, layout.t))
            .collect();
        match rising.as_slice() {
            [layout] => Ok(Found {
                layout: (*layout).clone(),
                why: Some(
                    "no column names; of the orders that fit, it is the only one whose times never \
                     decrease",
                ),
            }),
            _ if candidates.is_empty() => Err(UNCLEAR),
            _ => Err(SEVERAL),
        }
    }

    fn of_order(order: &[Field; 4], columns: usize) -> Self {
        let column = |field| order.iter().position(|entry| *entry == field).unwrap_or(0);
        Self {
            columns,
            t: column(Field::T),
            x: column(Field::X),
            y: column(Field::Y),
            p: column(Field::P),
            unit: None,
        }
    }

    /// Returns the names of the columns in their order, with `-` for columns that are left out.
    pub fn title(&self) -> String {
        let names: Vec<&str> = (0..self.columns)
            .map(|column| match column {
                _ if column == self.t => "t",
                _ if column == self.x => "x",
                _ if column == self.y => "y",
                _ if column == self.p => "p",
                _ => "-",
            })
            .collect();
        names.join(" ")
    }
}

fn fits(order: &[Field; 4], line: &[&[u8]], sensor: Option<Sensor>) -> bool {
    line.len() >= order.len()
        && line
            .iter()
            .all(|text| Decimal::parse(text).is_some() || polarity(text).is_some())
        && order.iter().zip(line).all(|(field, text)| match field {
            Field::P => polarity(text).is_some(),
            Field::T => Decimal::parse(text).is_some(),
            Field::X | Field::Y => {
                let side = match (sensor, field) {
                    (Some(sensor), Field::X) => sensor.width,
                    (Some(sensor), _) => sensor.height,
                    (None, _) => Sensor::SIDE_MAX,
                };
                let number = Decimal::parse(text).and_then(Decimal::whole);
                number.is_some_and(|number| number < u64::from(side))
            }
        })
}

/// Returns whether the times in `column` never fall and are not all the same.
fn rises(lines: &[&Vec<&[u8]>], column: usize) -> bool {
    // The unit does not matter, since only the order of the numbers is examined.
    let times: Option<Vec<i64>> = lines
        .iter()
        .map(|line| Decimal::parse(line.get(column)?)?.signed(6).ok())
        .collect();
    times.is_some_and(|times| times.is_sorted() && times.first() != times.last())
}

/// Returns the first times as floats, and whether at least half of the lines write them as whole numbers: Python
/// prints some seconds as 0, and a damaged line must not decide.
pub fn times_of(lines: &[Vec<&[u8]>], column: usize) -> (Vec<f64>, bool) {
    let mut fractional = 0;
    let mut times = Vec::new();
    for field in lines.iter().filter_map(|line| line.get(column)) {
        let Some(number) = Decimal::parse(field) else {
            continue;
        };
        let value = std::str::from_utf8(field)
            .ok()
            .and_then(|text| text.parse().ok());
        times.push(value.unwrap_or(0.0));
        fractional += usize::from(number.fractional);
    }
    (times, 2 * fractional <= lines.len())
}
