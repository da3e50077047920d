//! Finds the events in a MAT-file and determines what their numbers mean.

use event_types::stream::{Context, ErrorKind, Result};
use event_types::{Sensor, ensure};

use super::file::{Array, Content, MatFile, Numbers, Variable};
use crate::numpy::npy_header::Number;
use crate::reading::{BadEvents, Columns, Reading, TimeUnit};
use crate::table::event_numbers::{
    Row, SAMPLE_ROWS, SHORT, T, column_order, coordinate, find_names, given_names, names_taken,
    order_taken,
};
use crate::table::row_events::{Base, Scale, Times};
use crate::table::time_unit::SAMPLE_TIMES;
use crate::{Assumption, BATCH_EVENTS};

/// Name of the times in the structures of `AedatTools`.
const AEDAT_TOOLS: &str = "timeStamp";

/// The place and the meaning of the events' numbers.
pub struct Plan {
    /// The arrays of t, x, y and p.
    pub arrays: [Array; 4],
    /// Number of events.
    pub events: u64,
    /// Unit and type of the times.
    pub times: Times,
    /// The first rows, at most those before the first damage.
    pub sample: Vec<Row>,
    /// How the columns were found, if that may be wrong.
    pub assumption: Option<Assumption>,
    /// The numbers from which pixels and polarities are counted.
    pub base: Base,
    /// The sensor's size.
    pub sensor: Sensor,
    /// Whether the size was taken from the largest x and y.
    pub is_size_taken: bool,
    /// Number of variables used.
    pub used: usize,
}

/// Four arrays that hold the events, and what belongs to them.
struct Found {
    arrays: [Array; 4],
    /// Width and height, if stated.
    sides: Option<[Array; 2]>,
    used: usize,
    unit: Option<TimeUnit>,
    assumption: Option<Assumption>,
    /// Whether pixels are counted from 0 whatever their values.
    from_zero: bool,
}

impl Plan {
    /// Finds the events, in the variable `place` if the user named one.
    pub fn find(file: &MatFile, place: Option<&str>, reading: &Reading) -> Result<Self> {
        let found = match place {
            Some(place) => named(file, place, reading)?,
            None => any(file, reading)?,
        };
        let counts = found.arrays.map(|array| array.count());
        let [events, ..] = counts;
        for (which, array) in found.arrays.iter().enumerate() {
            let (count, name) = (counts[which], SHORT[which]);
            let what = format!("{count} values of {name}, but {events} times");
            ensure!(count == events, Damaged, "{}", file.error_in(array, what));
            let what = format!("{name} is a matrix, not a row or a column");
            let is_vector = array.rows == 1 || array.columns == 1 || count == 0;
            ensure!(is_vector, Damaged, "{}", file.error_in(array, what));
        }
        let stated = found.sides.map(|sides| stated(file, sides)).transpose()?;
        let mut plan = Self {
            arrays: found.arrays,
            events,
            times: Times {
                scale: found.unit.map(Scale::from),
                is_u32: found.arrays[T].dtype.is_u32() && !found.arrays[T].is_float,
                is_float: found.arrays[T].is_float,
                offset_us: 0,
            },
            sample: Vec::new(),
            assumption: found.assumption,
            base: Base::default(),
            sensor: Sensor::new(1, 1).context("the least sensor")?,
            is_size_taken: false,
            used: found.used,
        };
        plan.sample = plan.sample(file)?;
        let range = plan.range(file, reading)?;
        plan.base = range.base(stated, found.from_zero);
        plan.is_size_taken = stated.or(reading.size).is_none();
        let sensor = stated.or(reading.size).or_else(|| range.sensor(plan.base));
        plan.sensor = sensor.with_context(|| {
            let name = file.name();
            format!("{name}: byte 0: no event, so no sensor size: give --width W --height H")
        })?;
        Ok(plan)
    }

    /// Opens t, x, y and p for reading from event `first` on.
    pub fn columns(&self, file: &MatFile, first: u64) -> Result<[Numbers; 4]> {
        let [t, x, y, p] = &self.arrays;
        let open = |array: &Array| {
            let numbers = file.read(array, first);
            numbers.map_err(|what| file.error_in(array, what))
        };
        Ok([open(t)?, open(x)?, open(y)?, open(p)?])
    }

    /// Returns the first rows, at most those before the first damage.
    fn sample(&self, file: &MatFile) -> Result<Vec<Row>> {
        let mut columns = self.columns(file, 0)?;
        let (rows, _) = fill(&mut columns, limited(self.events, SAMPLE_TIMES));
        let row = |row: usize| [0, 1, 2, 3].map(|which: usize| columns.get(which)?.get(row));
        Ok((0..rows).map(row).collect())
    }

    /// Returns the range of x, y and p up to the first damaged or invalid row.
    fn range(&self, file: &MatFile, reading: &Reading) -> Result<Range> {
        let mut range = Range::default();
        let [_, x, y, p] = self.columns(file, 0)?;
        let mut columns = [x, y, p];
        let mut left = self.events;
        while left > 0 {
            let (rows, ended) = fill(&mut columns, limited(left, BATCH_EVENTS));
            for row in 0..rows {
                let [x, y, p] = [0, 1, 2].map(|column| columns[column].get(row));
                if !range.take(&[None, x, y, p], reading) {
                    return Ok(range);
                }
            }
            if ended.is_some() {
                break;
            }
            left -= rows as u64;
        }
        Ok(range)
    }
}

/// Returns the number as a coordinate counted from 0 or 1, which may equal the longest side of a sensor.
fn coordinate_or_side(number: Option<Number>) -> Option<u16> {
    let whole = number?.whole()?;
    if whole == i64::from(Sensor::SIDE_MAX) {
        return Some(Sensor::SIDE_MAX);
    }
    coordinate(number)
}

/// The range of a recording's values, which shows from which number pixels and polarities are counted.
pub struct Range {
    least: u16,
    x_most: u16,
    y_most: u16,
    /// Whether some polarity is 2, and whether all are 1 or 2.
    has_two: bool,
    from_one: bool,
    is_empty: bool,
}

impl Default for Range {
    fn default() -> Self {
        Self {
            least: u16::MAX,
            x_most: 0,
            y_most: 0,
            has_two: false,
            from_one: true,
            is_empty: true,
        }
    }
}

impl Range {
    fn add(&mut self, x: u16, y: u16, p: Option<i64>) {
        self.least = self.least.min(x).min(y);
        (self.x_most, self.y_most) = (self.x_most.max(x), self.y_most.max(y));
        self.has_two |= p == Some(2);
        self.from_one &= matches!(p, Some(1 | 2));
        self.is_empty = false;
    }

    /// Adds a row; returns `false` if its x or y is invalid, unless invalid events are left out.
    pub fn take(&mut self, row: &Row, reading: &Reading) -> bool {
        let [_, x, y, p] = *row;
        let (Some(x), Some(y)) = (coordinate_or_side(x), coordinate_or_side(y)) else {
            return reading.bad_events == BadEvents::LeaveOut;
        };
        self.add(x, y, p.and_then(Number::whole));
        true
    }

    /// Returns the numbers from which pixels and polarities are counted; `stated` is the size that the file states,
    /// and `from_zero` means that pixels are counted from 0 in any case.
    pub fn base(&self, stated: Option<Sensor>, from_zero: bool) -> Base {
        let no_zero = self.least > 0 && !self.is_empty;
        let pixel = match stated {
            _ if from_zero => false,
            Some(sensor) => {
                no_zero && (self.x_most == sensor.width || self.y_most == sensor.height)
            }
            None => no_zero,
        };
        Base {
            pixel: i64::from(pixel),
            polarity: i64::from(self.has_two && self.from_one),
        }
    }

    fn sensor(&self, base: Base) -> Option<Sensor> {
        let side = |most: u16| {
            if base.pixel == 0 {
                most.saturating_add(1)
            } else {
                most
            }
        };
        let sensor = Sensor::new(side(self.x_most), side(self.y_most));
        sensor.filter(|_| !self.is_empty)
    }
}

/// Returns the events of the variable that the user named.
fn named(file: &MatFile, place: &str, reading: &Reading) -> Result<Found> {
    let variable = file.variables().iter().find(|found| found.name == place);
    let found = match variable.map(|variable| &variable.content) {
        Some(Content::Structure(fields)) => structure(file, fields, reading),
        Some(Content::Numbers(array)) => matrix(file, array, reading)?,
        _ => None,
    };
    found.ok_or_else(|| missing(file, &format!("no events at {place}")))
}

/// Returns the events of a file in which only one variable can hold them.
fn any(file: &MatFile, reading: &Reading) -> Result<Found> {
    let numbers = |variable: &Variable| match variable.content {
        Content::Numbers(array) => Some((variable.name.clone(), array)),
        _ => None,
    };
    let plain: Vec<(String, Array)> = file.variables().iter().filter_map(numbers).collect();
    if let Some(mut found) = columns(&plain, reading) {
        found.sides = sides(&plain);
        found.used = 4 + 2 * usize::from(found.sides.is_some());
        return Ok(found);
    }
    let structures = file
        .variables()
        .iter()
        .filter_map(|variable| match &variable.content {
            Content::Structure(fields) => Some((variable, structure(file, fields, reading)?)),
            _ => None,
        });
    let mut structures: Vec<(&Variable, Found)> = structures.collect();
    if let (Some((_, found)), true) = (structures.pop(), structures.is_empty()) {
        return Ok(found);
    }
    if !structures.is_empty() {
        return Err(missing(file, "several structures with events"));
    }
    let wide = match &reading.columns {
        Some(Columns::Places { columns, .. }) => *columns as u64,
        _ => 4,
    };
    let mut matrices = plain.iter().filter(|(_, array)| array.columns == wide);
    let only = matrices.next().filter(|_| matrices.next().is_none());
    let named = plain
        .iter()
        .find(|(name, _)| name.eq_ignore_ascii_case("events"));
    let found = match named.or(only) {
        Some((_, array)) => matrix(file, array, reading)?,
        None => None,
    };
    found.ok_or_else(|| missing(file, "no events"))
}

/// Returns an error that lists the file's variables.
fn missing(file: &MatFile, what: &str) -> event_types::stream::Error {
    if let Some(damage) = file.damage() {
        return damage;
    }
    let list = file
        .variables()
        .iter()
        .take(24)
        .map(|variable| match &variable.content {
            Content::Numbers(array) => {
                format!("{} ({} x {})", variable.name, array.rows, array.columns)
            }
            Content::Structure(fields) => {
                let fields: Vec<&str> = fields
                    .iter()
                    .map(|(name, _)| name.as_str())
                    .take(24)
                    .collect();
                format!("{} ({})", variable.name, fields.join(", "))
            }
            Content::Other => variable.name.clone(),
        });
    let list: Vec<String> = list.collect();
    let name = file.name();
    file.error(
        0,
        format!(
            "{what}; variables t, x, y, p, one structure of these or one matrix of 4 columns is \
             expected, but the file has {}: name a structure or matrix after the file's name, as \
             in {name}/TD, or see --columns",
            list.join(", ").escape_debug()
        ),
    )
    .of_kind(ErrorKind::Undecided)
}

fn find(arrays: &[(String, Array)], names: &[&str]) -> Option<Array> {
    let known = |name: &str| names.iter().any(|known| name.eq_ignore_ascii_case(known));
    let found = arrays.iter().find(|(name, _)| known(name));
    found.map(|(_, array)| *array)
}

/// Finds t, x, y and p by their names.
fn columns(arrays: &[(String, Array)], reading: &Reading) -> Option<Found> {
    if matches!(reading.columns, Some(Columns::Places { .. })) {
        return None;
    }
    let names = arrays.iter().map(|(name, _)| name.as_str());
    let found = find_names(names, given_names(reading))?;
    let [t, x, y, p] = found.places.map(|place| arrays.get(place));
    let (t, x, y, p) = (t?, x?, y?, p?);
    Some(Found {
        arrays: [t.1, x.1, y.1, p.1],
        sides: None,
        used: 4,
        unit: found.unit,
        assumption: names_taken(&found),
        from_zero: t.0 == AEDAT_TOOLS,
    })
}

/// Finds width and height by their names.
fn sides(arrays: &[(String, Array)]) -> Option<[Array; 2]> {
    Some([find(arrays, &["width"])?, find(arrays, &["height"])?])
}

/// Finds the events in the fields of a structure.
fn structure(file: &MatFile, fields: &[(String, Array)], reading: &Reading) -> Option<Found> {
    let mut found = columns(fields, reading)?;
    let numbers = |variable: &Variable| match variable.content {
        Content::Numbers(array) => Some((variable.name.clone(), array)),
        _ => None,
    };
    let plain: Vec<(String, Array)> = file.variables().iter().filter_map(numbers).collect();
    let (inside, beside) = (sides(fields), sides(&plain));
    found.used = 1 + 2 * usize::from(inside.is_none() && beside.is_some());
    found.sides = inside.or(beside);
    Some(found)
}

/// Finds the events in a matrix; `None` if it has another number of columns than wanted.
fn matrix(file: &MatFile, array: &Array, reading: &Reading) -> Result<Option<Found>> {
    let found = |arrays, assumption| Found {
        arrays,
        sides: None,
        used: 1,
        unit: None,
        assumption,
        from_zero: false,
    };
    match &reading.columns {
        Some(Columns::Places { places, columns }) if *columns as u64 == array.columns => {
            let arrays = places.map(|place| array.column(place as u64));
            return Ok(Some(found(arrays, None)));
        }
        Some(_) => return Ok(None),
        None if array.columns != 4 => return Ok(None),
        None => {}
    }
    let all = [0, 1, 2, 3].map(|column| array.column(column));
    let mut streams = Vec::new();
    for column in &all {
        let numbers = file.read(column, 0);
        streams.push(numbers.map_err(|what| file.error_in(column, what))?);
    }
    let (rows, _) = fill(&mut streams, limited(array.rows, SAMPLE_ROWS));
    let row = |row: usize| [0, 1, 2, 3].map(|column: usize| streams.get(column)?.get(row));
    let sample: Vec<_> = (0..rows).map(row).collect();
    let order = column_order(&sample, reading.size).ok_or_else(|| {
        let what = "the order of the four columns is unclear: give --columns txyp, in their order";
        file.error_in(array, what).of_kind(ErrorKind::Undecided)
    })?;
    let arrays = order.map(|column| all.get(column).copied().unwrap_or(*array));
    Ok(Some(found(arrays, Some(order_taken(order)))))
}

/// Reads the sensor's size from two scalars.
fn stated(file: &MatFile, sides: [Array; 2]) -> Result<Sensor> {
    let [width, height] = sides;
    let side = |array: &Array| {
        let value = match file.read(array, 0) {
            Ok(mut numbers) if array.count() == 1 => match numbers.fill(1) {
                (1, None) => numbers.get(0).and_then(Number::whole),
                _ => None,
            },
            _ => None,
        };
        let side = value.and_then(|side| u16::try_from(side).ok());
        side.ok_or_else(|| file.error_in(array, "the sensor's side must be one whole number"))
    };
    let (width_px, height_px) = (side(&width)?, side(&height)?);
    Sensor::new(width_px, height_px).ok_or_else(|| {
        let what = format!("sensor size {width_px}x{height_px} is out of range");
        file.error_in(&width, what)
    })
}

/// Returns `left`, at most `limit`.
fn limited(left: u64, limit: usize) -> usize {
    usize::try_from(left).unwrap_or(limit).min(limit)
}

/// Fills every column with `count` numbers. Returns how many numbers all of them have, and, if it is fewer, which
/// column broke off and why.
pub fn fill(columns: &mut [Numbers], count: usize) -> (usize, Option<(usize, String)>) {
    let (mut whole, mut ended) = (count, None);
    for (which, column) in columns.iter_mut().enumerate() {
        let (numbers, what) = column.fill(count);
        whole = whole.min(numbers);
        ended = ended.or(what.map(|what| (which, what)));
    }
    (whole, ended)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_polarities_may_count_from_1() {
        let of = |rows: &[(u16, u16, i64)]| {
            let mut range = Range::default();
            for (x, y, p) in rows {
                range.add(*x, *y, Some(*p));
            }
            let base = range.base(None, false);
            (base.pixel, base.polarity, range.sensor(base))
        };
        let sensor = Sensor::new;
        assert_eq!(of(&[(1, 3, 1), (4, 1, 2)]), (1, 1, sensor(4, 3)));
        assert_eq!(of(&[(0, 3, 1), (4, 1, 2)]), (0, 1, sensor(5, 4)));
        assert_eq!(of(&[(1, 3, 1), (4, 1, 1)]), (1, 0, sensor(4, 3)));
        assert_eq!(of(&[(1, 3, 1), (4, 1, 0)]), (1, 0, sensor(4, 3)));
        assert_eq!(of(&[(1, 0, 1), (4, 1, 0)]), (0, 0, sensor(5, 2)));
        assert_eq!(of(&[(1, 3, 2), (4, 1, -1)]), (1, 0, sensor(4, 3)));
        let mut range = Range::default();
        range.add(1, 3, Some(1));
        // An event at the edge of the stated sensor, one inside it, and a program that counts from 0.
        assert_eq!(range.base(sensor(8, 3), false).pixel, 1);
        assert_eq!(range.base(sensor(8, 8), false).pixel, 0);
        assert_eq!(range.base(None, true).pixel, 0);
        assert_eq!(of(&[]), (0, 0, None));
    }
}
