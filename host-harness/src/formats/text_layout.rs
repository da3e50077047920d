//! Which column of a text file is what: from its header line, or from its first lines.

use eecvs_nostd::Sensor;

use super::decimal::Decimal;
use super::time_unit::TimeSample;

/// Fewest lines whose times must rise before that speaks for an order of columns.
const RISING_LINES: usize = 16;

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

/// Unit of the time column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// The column's name or its fractions tell: the value times 10^n is in microseconds.
    Shift(i32),
    /// Whole numbers so far: microseconds.
    Whole,
}

/// Columns of a file, counted from 0, and the time's unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// Fields of a line; further ones are an error.
    pub columns: usize,
    /// Column of the time.
    pub t: usize,
    /// Column of x.
    pub x: usize,
    /// Column of y.
    pub y: usize,
    /// Column of the polarity.
    pub p: usize,
    /// Unit of the time.
    pub unit: Unit,
}

/// A header line's column names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    layout: Layout,
    /// From names like `x@320`.
    pub sensor: Option<(u64, u64)>,
}

impl Header {
    /// Parses column names; `None` where t, x, y and p are not all among them exactly once.
    pub fn parse(fields: &[&[u8]]) -> Option<Self> {
        let (mut t, mut x, mut y, mut p) = (None, None, None, None);
        let (mut width, mut height) = (None, None);
        let mut unit = Unit::Whole;
        for (column, field) in fields.iter().enumerate() {
            let text = std::str::from_utf8(field).ok()?.trim_matches(['"', '\'']);
            let name = text.to_ascii_lowercase();
            let (name, side) = match name.split_once('@') {
                Some((name, side)) => (name, side.parse::<u64>().ok()),
                None => (name.as_str(), None),
            };
            let slot = match name {
                "x" | "xs" | "col" | "column" | "x_px" => {
                    width = side;
                    &mut x
                }
                "y" | "ys" | "row" | "y_px" => {
                    height = side;
                    &mut y
                }
                "p" | "ps" | "pol" | "polarity" | "polarities" | "on" => &mut p,
                _ => {
                    let (stem, shift) = time_name(name);
                    if !matches!(
                        stem,
                        "t" | "ts" | "time" | "times" | "timestamp" | "timestamps"
                    ) {
                        continue;
                    }
                    unit = shift.map_or(Unit::Whole, Unit::Shift);
                    &mut t
                }
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

    /// Where the columns are.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }
}

/// Stem of a time column's name and, where it names a unit, its shift to microseconds.
fn time_name(name: &str) -> (&str, Option<i32>) {
    let units = [
        ("_us", 0),
        ("_ms", 3),
        ("_ns", -3),
        ("_s", 6),
        ("[us]", 0),
        ("[s]", 6),
    ];
    for (ending, shift) in units {
        if let Some(stem) = name.strip_suffix(ending) {
            return (stem.trim_end(), Some(shift));
        }
    }
    (name, None)
}

/// Polarity of a field, or `None`.
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

impl Layout {
    /// Finds the layout from the header line, if there is one, and the first event lines.
    ///
    /// Without a header an order fits where every line has four numbers, p is a polarity, x and y
    /// are whole numbers below the sensor's sides, and t is a number of which at least one has a
    /// fraction if any number of the file has. The first order that fits counts, but one whose
    /// times never fall beats it, where at least 16 lines with different times tell.
    pub fn detect(
        header: Option<&Header>,
        lines: &[Vec<&[u8]>],
        sensor: Option<Sensor>,
    ) -> Result<Self, &'static str> {
        let mut layout = match header {
            Some(header) => header.layout.clone(),
            None => Self::from_numbers(lines, sensor)?,
        };
        if layout.unit == Unit::Whole {
            layout.unit = unit_of(lines, layout.t);
        }
        Ok(layout)
    }

    fn from_numbers(lines: &[Vec<&[u8]>], sensor: Option<Sensor>) -> Result<Self, &'static str> {
        const UNCLEAR: &str = "the order of the columns is unclear: add a first line such as \
                               t,x,y,p that names them";
        // Damage further on must not decide: only lines that some order fits count. The reader
        // will meet the damaged line.
        let mut orders: Vec<&[Field; 4]> = ORDERS.iter().collect();
        let mut whole = lines;
        for (index, line) in lines.iter().enumerate() {
            let fitting: Vec<_> = orders
                .iter()
                .filter(|order| fits(order, line, sensor))
                .copied()
                .collect();
            if fitting.is_empty() {
                if index == 0 {
                    return Err(UNCLEAR);
                }
                whole = lines.get(..index).unwrap_or_default();
                break;
            }
            orders = fitting;
        }
        let lines = whole;
        let fraction = |column: usize| {
            lines.iter().any(|line| {
                let number = line.get(column).and_then(|field| Decimal::parse(field));
                number.is_some_and(|number| number.fractional && !number.is_whole())
            })
        };
        let fractions: Vec<usize> = (0..4).filter(|column| fraction(*column)).collect();
        let candidates: Vec<Self> = orders
            .into_iter()
            .map(Self::of_order)
            .filter(|layout| fractions.iter().all(|column| *column == layout.t))
            .collect();
        let rising = candidates.iter().find(|layout| rises(lines, layout.t));
        rising.or(candidates.first()).cloned().ok_or(UNCLEAR)
    }

    fn of_order(order: &[Field; 4]) -> Self {
        let column = |field| order.iter().position(|entry| *entry == field).unwrap_or(0);
        let (t, x, y, p) = (
            column(Field::T),
            column(Field::X),
            column(Field::Y),
            column(Field::P),
        );
        Self {
            columns: 4,
            t,
            x,
            y,
            p,
            unit: Unit::Whole,
        }
    }
}

fn fits(order: &[Field; 4], line: &[&[u8]], sensor: Option<Sensor>) -> bool {
    line.len() == order.len()
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

/// Whether the times in `column` never fall and differ, over enough lines to tell.
fn rises(lines: &[Vec<&[u8]>], column: usize) -> bool {
    // The unit does not matter here, only the order of the numbers.
    let times: Option<Vec<u64>> = lines
        .iter()
        .map(|line| Decimal::parse(line.get(column)?)?.scaled(6).ok())
        .collect();
    times.is_some_and(|times| {
        times.len() >= RISING_LINES && times.is_sorted() && times.first() != times.last()
    })
}

fn unit_of(lines: &[Vec<&[u8]>], column: usize) -> Unit {
    let mut sample = TimeSample::default();
    let mut fractional = 0;
    for field in lines.iter().filter_map(|line| line.get(column)) {
        let Some(number) = Decimal::parse(field) else {
            continue;
        };
        let value = std::str::from_utf8(field)
            .ok()
            .and_then(|text| text.parse().ok());
        sample.add(number.is_whole(), value.unwrap_or(0.0));
        fractional += usize::from(number.fractional);
    }
    // Most of them: Python prints some seconds as 0, and damage must not decide.
    match (2 * fractional > lines.len(), sample.seconds()) {
        (true, true) => Unit::Shift(6),
        (true, false) => Unit::Shift(0),
        (false, _) => Unit::Whole,
    }
}
