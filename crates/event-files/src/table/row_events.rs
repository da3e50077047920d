//! Turns rows of numbers into events, by what the file and the caller state: the unit and offset of the times,
//! 32-bit clocks that wrap, the values of polarities, and invalid events.
//!
//! * The unit is the caller's, otherwise the file's, otherwise that of the rule in [`crate::table::time_unit`].
//! * A time of an unsigned 32-bit type that falls back by more than 2^31 has wrapped: the clock goes on from there.
//! * p: 1 or true is ON; 0, false or -1 is OFF. 0 and -1 cannot both be OFF: a recording that has both is an error.
//!   If it also has 1, 0 may mean no event (`CeleX`), which is left out if the caller leaves out invalid events.
//! * A row that cannot be an event ends the recording with an error, or is left out and counted by its cause.

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor, error};

use crate::input::Batch;
use crate::numpy::npy_header::{Dtype, Number};
use crate::reading::{BadEvents, Reading, TimeUnit};
use crate::table::event_numbers::{P, Row, T, X, Y, coordinate};
use crate::table::time_unit;
use crate::{Assumption, Skipped};

/// Rows of columns that are taken at once.
const COLUMN_ROWS: usize = 1 << 12;

/// Rows of columns that are taken by the rules for single rows at once, behind one that asks for them.
const ROWS_BY_RULES: usize = 1 << 10;

/// Half the range of a 32-bit clock.
const HALF_CLOCK: i64 = 1 << 31;

/// Largest distance from the ends of a 32-bit clock, in its units, at which a step back over a wrap is recognised.
const NEAR_WRAP: i64 = 1 << 24;

// Causes by which events that are left out are counted.
const OUTSIDE: &str = "events outside of the sensor";
const MISSING: &str = "events with a missing value";
const NO_POLARITY: &str = "events of no polarity";
const NO_TIME: &str = "events with an impossible time";
const NO_PIXEL: &str = "events between pixels";

/// Converts times to microseconds: a number times `times`, divided by `by`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale {
    times: i64,
    by: i64,
}

impl Scale {
    /// The scale of times in microseconds.
    pub const US: Self = Self { times: 1, by: 1 };

    /// Creates a scale of `times / by` microseconds for each unit; neither may be below 1.
    pub const fn new(times: i64, by: i64) -> Self {
        Self { times, by }
    }

    /// Creates a scale of 10 to the power of `shift` microseconds for each unit.
    pub fn shift(shift: i32) -> Self {
        let power = 10_i64.saturating_pow(shift.unsigned_abs());
        if shift >= 0 {
            Self::new(power, 1)
        } else {
            Self::new(1, power)
        }
    }

    /// Converts a time to us, rounded to the nearest; `None` if it is not a number or beyond 2^63.
    pub fn us(self, time: Number) -> Option<i64> {
        match time {
            Number::Whole(time) if self.by == 1 => time.checked_mul(self.times),
            Number::Whole(time) => {
                let (by, scaled) = (
                    i128::from(self.by),
                    i128::from(time) * i128::from(self.times),
                );
                let rounded = scaled.div_euclid(by) + i128::from(scaled.rem_euclid(by) * 2 >= by);
                i64::try_from(rounded).ok()
            }
            Number::Float(time) => {
                // No division if `by` is 1, so that seconds are scaled as by other programs, to the last bit.
                let scaled = if self.by == 1 {
                    time * self.times as f64
                } else {
                    time * self.times as f64 / self.by as f64
                };
                let rounded = scaled.round();
                (-9.2e18..9.2e18)
                    .contains(&rounded)
                    .then_some(rounded as i64)
            }
        }
    }
}

/// Distance of a float time from a whole microsecond, in us, up to which it counts as a float's own error.
const FLOAT_NOISE_US: f64 = 1e-3;

impl Scale {
    /// Returns whether [`Scale::us`] rounds the time by more than the error that floats have anyway.
    fn rounds(self, time: Number) -> bool {
        match time {
            Number::Whole(time) => {
                self.by > 1 && i128::from(time) * i128::from(self.times) % i128::from(self.by) != 0
            }
            Number::Float(time) => {
                let us = time * (self.times as f64 / self.by as f64);
                // A value that fits a 32-bit float has that type's error.
                let epsilon = if f64::from(time as f32) == time {
                    f64::from(f32::EPSILON)
                } else {
                    4.0 * f64::EPSILON
                };
                (us - us.round()).abs() > FLOAT_NOISE_US + us.abs() * epsilon
            }
        }
    }
}

impl From<TimeUnit> for Scale {
    fn from(unit: TimeUnit) -> Self {
        Self::shift(unit.shift())
    }
}

/// What a file states about its times.
#[derive(Debug, Clone, Copy, Default)]
pub struct Times {
    /// The unit, if the file or its layout states one.
    pub scale: Option<Scale>,
    /// Whether the times are of an unsigned 32-bit type.
    pub is_u32: bool,
    /// Whether the times are of a float type.
    pub is_float: bool,
    /// Offset added to every time, in us.
    pub offset_us: i64,
}

impl Times {
    /// Returns what the type of the times states.
    pub fn of(dtype: Option<Dtype>) -> Self {
        Self {
            scale: dtype.and_then(Dtype::scale),
            is_u32: dtype.is_some_and(Dtype::is_u32),
            is_float: dtype.is_some_and(Dtype::is_float),
            offset_us: 0,
        }
    }
}

/// The numbers from which columns, rows and polarities are counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Base {
    pub pixel: i64,
    pub polarity: i64,
}

/// The polarities that have occurred.
#[derive(Debug, Clone, Copy, Default)]
struct Met {
    zero: bool,
    minus: bool,
    one: bool,
}

impl Met {
    fn of(rows: &[Row]) -> Self {
        let mut met = Self::default();
        for row in rows {
            match row[P].and_then(Number::whole) {
                Some(0) => met.zero = true,
                Some(-1) => met.minus = true,
                Some(1) => met.one = true,
                _ => {}
            }
        }
        met
    }
}

/// Turns rows into events.
pub struct RowEvents {
    /// The sensor that the events must lie on.
    pub sensor: Sensor,
    /// The numbers from which pixels and polarities are counted.
    base: Base,
    /// What was left out, by its cause.
    pub skipped: Skipped,
    /// What was assumed.
    pub assumptions: Vec<Assumption>,
    scale: Scale,
    offset_us: i64,
    leave_out: bool,
    /// Whether a polarity of 0 means no event.
    zero_is_none: bool,
    met: Met,
    /// For times of 32 bits: the last time, and the sum that earlier wraps add.
    clock: Option<(i64, i64)>,
    /// Whether a time has been rounded and an assumption says so.
    is_rounded: bool,
    /// Whether whole numbers are times in microseconds, columns, rows and polarities.
    is_as_written: bool,
}

impl RowEvents {
    /// Prepares for rows that begin with `sample`, at most [`time_unit::SAMPLE_TIMES`] of them.
    ///
    /// # Errors
    /// The unit of the times is unclear, or the sample has more than two polarities.
    pub fn new(
        reading: &Reading,
        times: Times,
        base: Base,
        sample: &[Row],
    ) -> Result<Self, String> {
        let mut assumptions = Vec::new();
        let scale = match (reading.time_unit, times.scale) {
            (Some(unit), _) => unit.into(),
            (None, Some(scale)) => scale,
            (None, None) => {
                let first = sample.iter().filter_map(|row| row[T]).map(Number::float);
                let first: Vec<f64> = first.filter(|time| time.is_finite()).collect();
                let taken = time_unit::unstated(&first, !times.is_float)?;
                // Without an event there is no time to judge.
                if !first.is_empty() {
                    assumptions.push(Assumption {
                        what: "time unit",
                        taken: taken.unit.name().to_owned(),
                        why: taken.why,
                    });
                }
                taken.unit.into()
            }
        };
        if base.pixel != 0 {
            assumptions.push(Assumption {
                what: "first pixel",
                taken: "1".to_owned(),
                why: "MATLAB counts from 1, and no column or row is 0".to_owned(),
            });
        }
        if base.polarity != 0 {
            assumptions.push(Assumption {
                what: "polarity",
                taken: "2 for on, 1 for off".to_owned(),
                why: "all are 1 or 2".to_owned(),
            });
        }
        let leave_out = reading.bad_events == BadEvents::LeaveOut;
        let met = Met::of(sample);
        let is_mixed = base.polarity == 0 && met.zero && met.minus;
        let zero_is_none = is_mixed && met.one && leave_out;
        if is_mixed && !zero_is_none {
            return Err(mixed(met.one));
        }
        if zero_is_none {
            assumptions.push(Assumption {
                what: "polarity",
                taken: "1 for on, -1 for off, 0 for no event".to_owned(),
                why: "the recording has three polarities".to_owned(),
            });
        }
        let offset_us = times.offset_us.saturating_add(reading.time_offset_us);
        let is_as_written =
            scale == Scale::US && offset_us == 0 && !times.is_u32 && base == Base::default();
        Ok(Self {
            is_as_written,
            sensor: Sensor {
                width: 1,
                height: 1,
            },
            base,
            skipped: Skipped::default(),
            assumptions,
            scale,
            offset_us,
            leave_out,
            zero_is_none,
            met: Met::default(),
            clock: times.is_u32.then_some((0, 0)),
            is_rounded: false,
        })
    }

    /// Returns whether times may wrap, so that a single one does not determine the time in us.
    pub const fn may_wrap(&self) -> bool {
        self.clock.is_some()
    }

    /// Converts a time of a clock that does not wrap to us; `None` if it is not a valid time.
    pub fn t_us(&self, time: Option<Number>) -> Option<u64> {
        let t_us = self.scale.us(time?)?.checked_add(self.offset_us)?;
        u64::try_from(t_us).ok()
    }

    /// Prepares for rows from another place, such as the first.
    pub fn rewind(&mut self) {
        self.clock = self.clock.map(|_| (0, 0));
    }

    /// Converts a row to its event; `None` if the row was left out. The error is which of t, x, y and p is wrong,
    /// and how.
    #[inline]
    fn event(&mut self, row: &Row) -> Result<Option<Event>, (usize, String)> {
        match self.whole(row) {
            Ok(event) => Ok(Some(event)),
            Err(bad) => self.bad(row, &bad),
        }
    }

    /// Appends the events of rows, for which the batch must have room, and adds the number of rows to `count`, those that
    /// are left out included. The error is which of t, x, y and p of the next row is wrong, and how.
    pub fn append(
        &mut self,
        rows: &[Row],
        count: &mut u64,
        batch: &mut Batch<'_>,
    ) -> Result<(), (usize, String)> {
        let mut rest = rows;
        loop {
            let plain = self.plain(rest, batch);
            *count += plain as u64;
            let Some((row, more)) = rest.get(plain..).and_then(<[Row]>::split_first) else {
                return Ok(());
            };
            if let Some(event) = self.event(row)? {
                batch.push(event);
            }
            *count += 1;
            rest = more;
        }
    }

    /// As [`RowEvents::append`], of four columns of whole numbers, t, x, y and p, of one length.
    pub fn append_columns(
        &mut self,
        columns: [&[i64]; 4],
        count: &mut u64,
        batch: &mut Batch<'_>,
    ) -> Result<(), (usize, String)> {
        let rows = columns[T].len();
        let mut at = 0;
        while at < rows {
            let ends = rows.min(at + COLUMN_ROWS);
            let plain = self.plain_columns(columns.map(|column| &column[at..ends]), batch);
            *count += plain as u64;
            at += plain;
            // Where one row does not stand as it is, others do not: by the rules, some at a time.
            let by_rules = (at..ends).take(ROWS_BY_RULES);
            let row = |at: usize| columns.map(|column| Some(Number::Whole(column[at])));
            let by_rules: Vec<Row> = by_rules.map(row).collect();
            self.append(&by_rules, count, batch)?;
            at += by_rules.len();
        }
        Ok(())
    }

    /// As [`RowEvents::plain`], of columns, in which -1 may be off too.
    fn plain_columns(&mut self, [t, x, y, p]: [&[i64]; 4], batch: &mut Batch<'_>) -> usize {
        let off = match (self.met.zero, self.met.minus) {
            _ if self.zero_is_none => return 0,
            (_, false) => 0,
            (false, true) => -1,
            (true, true) => return 0,
        };
        if !self.is_as_written {
            return 0;
        }
        let [right, bottom] =
            [self.sensor.width, self.sensor.height].map(|side| i64::from(side) - 1);
        // Negative for a row that does not stand as it is: by signs alone, several rows are looked at at once.
        let bad = |(((t, x), y), p): (((&i64, &i64), &i64), &i64)| {
            let outside = x | right.wrapping_sub(*x) | y | bottom.wrapping_sub(*y);
            let polarity = (1_i64.wrapping_sub(*p)) | p.wrapping_sub(off);
            // Of -1, 0 and 1, the 0.
            let between = if off == 0 { 0 } else { (p & 1) - 1 };
            t | outside | polarity | between
        };
        let rows = || t.iter().zip(x).zip(y).zip(p);
        let taken = if rows().fold(0, |any, row| any | bad(row)) >= 0 {
            t.len()
        } else {
            rows().take_while(|row| bad(*row) >= 0).count()
        };
        // ON counts 1, OFF `off`.
        let sum: i64 = p[..taken].iter().sum();
        let on = (sum - off * taken as i64) / (1 - off);
        self.met.one |= on > 0;
        self.met.zero |= off == 0 && on < taken as i64;
        let events = t[..taken].iter().zip(x).zip(y).zip(p);
        batch.extend(events.map(|(((t, x), y), p)| Event {
            t_us: *t as u64,
            x: *x as u16,
            y: *y as u16,
            polarity: Polarity::from_bool(*p == 1),
        }));
        taken
    }

    /// Appends the events of the first rows that stand as they are, and returns their number: rows of whole
    /// microseconds, a pixel of the sensor, and a polarity of 1, or of 0 where that is off. [`RowEvents::event`] makes the
    /// same of them.
    fn plain(&mut self, rows: &[Row], batch: &mut Batch<'_>) -> usize {
        if !self.is_as_written {
            return 0;
        }
        let sensor = self.sensor;
        let zero_is_off = !self.met.minus && !self.zero_is_none;
        let mut met = self.met;
        let event = |row: &Row| {
            let [
                Some(Number::Whole(t)),
                Some(Number::Whole(x)),
                Some(Number::Whole(y)),
                Some(Number::Whole(p)),
            ] = *row
            else {
                return None;
            };
            let is_on = p == 1;
            let is_inside =
                (0..sensor.width.into()).contains(&x) && (0..sensor.height.into()).contains(&y);
            if t < 0 || !is_inside || !(is_on || p == 0 && zero_is_off) {
                return None;
            }
            met.one |= is_on;
            met.zero |= !is_on;
            Some(Event {
                t_us: t as u64,
                x: x as u16,
                y: y as u16,
                polarity: Polarity::from_bool(is_on),
            })
        };
        let mut taken = 0;
        for event in rows.iter().map_while(event) {
            batch.push(event);
            taken += 1;
        }
        self.met = met;
        taken
    }

    #[cold]
    fn bad(&mut self, row: &Row, bad: &Bad) -> Result<Option<Event>, (usize, String)> {
        let (which, cause, what) = bad.told(row, self.sensor);
        match cause {
            Some(cause) if self.leave_out => {
                self.skipped.add(cause, 1);
                Ok(None)
            }
            Some(_) => Err((
                which,
                format!("{what}; --leave-out-bad-events leaves such events out"),
            )),
            None => Err((which, what)),
        }
    }

    fn whole(&mut self, row: &Row) -> Result<Event, Bad> {
        let t_us = self.time(row[T].ok_or(Bad::TooLarge(T))?)?;
        let side = |which: usize| {
            let number = row[which].ok_or(Bad::TooLarge(which))?;
            match number.whole() {
                Some(value) => Ok(value - self.base.pixel),
                None if number.float().is_nan() => Err(Bad::Missing(which)),
                None => Err(Bad::Between(which)),
            }
        };
        let (x, y) = (side(X)?, side(Y)?);
        let polarity = self.polarity(row[P].ok_or(Bad::TooLarge(P))?)?;
        match (u16::try_from(x), u16::try_from(y)) {
            (Ok(x), Ok(y)) if self.sensor.contains(x, y) => Ok(Event {
                t_us,
                x,
                y,
                polarity,
            }),
            _ => Err(Bad::Outside(x, y)),
        }
    }

    fn time(&mut self, time: Number) -> Result<u64, Bad> {
        let time = match (&mut self.clock, time) {
            (Some((last, wraps)), Number::Whole(now)) => {
                if *last - now > HALF_CLOCK {
                    *wraps += 2 * HALF_CLOCK;
                    if *wraps == 2 * HALF_CLOCK {
                        self.assumptions.push(Assumption {
                            what: "clock",
                            taken: "of 32 bits, continued across wraps".to_owned(),
                            why: "times of type uint32 jump back by more than 2^31".to_owned(),
                        });
                    }
                } else if *last < NEAR_WRAP && now > 2 * HALF_CLOCK - NEAR_WRAP && *wraps > 0 {
                    // A step back over the wrap, as happens if packets are out of order.
                    *wraps -= 2 * HALF_CLOCK;
                }
                *last = now;
                Number::Whole(now + *wraps)
            }
            (_, time) => time,
        };
        if time.float().is_nan() {
            return Err(Bad::Missing(T));
        }
        let t_us = self
            .scale
            .us(time)
            .and_then(|t_us| t_us.checked_add(self.offset_us));
        let t_us = t_us.ok_or(Bad::NoTime)?;
        if !self.is_rounded && self.scale.rounds(time) {
            self.is_rounded = true;
            self.assumptions
                .push(Assumption::times_rounded("to the nearest"));
        }
        u64::try_from(t_us).map_err(|_| Bad::Negative(t_us))
    }

    fn polarity(&mut self, number: Number) -> Result<Polarity, Bad> {
        match number.whole().map(|value| value - self.base.polarity) {
            Some(1) => {
                self.met.one = true;
                Ok(Polarity::On)
            }
            Some(0) if self.zero_is_none => Err(Bad::NoPolarity),
            Some(0) => {
                self.met.zero = true;
                if self.met.minus {
                    Err(Bad::Mixed)
                } else {
                    Ok(Polarity::Off)
                }
            }
            Some(-1) if self.base.polarity == 0 => {
                self.met.minus = true;
                if self.met.zero {
                    Err(Bad::Mixed)
                } else {
                    Ok(Polarity::Off)
                }
            }
            _ if number.float().is_nan() => Err(Bad::Missing(P)),
            _ => Err(Bad::NoPolarity),
        }
    }
}

/// The reason why a row is not an event.
enum Bad {
    TooLarge(usize),
    Missing(usize),
    Between(usize),
    Outside(i64, i64),
    NoTime,
    Negative(i64),
    NoPolarity,
    Mixed,
}

impl Bad {
    /// Returns which of t, x, y and p is wrong, the cause by which such an event is counted if it may be left out,
    /// and the text of a message.
    fn told(&self, row: &Row, sensor: Sensor) -> (usize, Option<&'static str>, String) {
        let value = |which: usize| match row.get(which).copied().flatten() {
            Some(Number::Whole(value)) => value.to_string(),
            Some(Number::Float(value)) => value.to_string(),
            None => "a number above 2^63".to_owned(),
        };
        match self {
            Self::TooLarge(which) => {
                let cause = match *which {
                    T => NO_TIME,
                    P => NO_POLARITY,
                    _ => OUTSIDE,
                };
                (*which, Some(cause), value(*which))
            }
            Self::Missing(which) => (
                *which,
                Some(MISSING),
                "a value is missing (NaN or null)".to_owned(),
            ),
            Self::Between(which) => (
                *which,
                Some(NO_PIXEL),
                format!("{} is not a whole number", value(*which)),
            ),
            Self::Outside(x, y) => {
                let Sensor { width, height } = sensor;
                let what = format!("x = {x}, y = {y} is outside the sensor ({width}x{height})");
                (X, Some(OUTSIDE), what)
            }
            Self::NoTime => (
                T,
                Some(NO_TIME),
                "the time is not a number or is above 2^63 us".to_owned(),
            ),
            Self::Negative(t_us) => {
                let what = format!(
                    "the time is negative, {t_us} us: --time-offset-us N adds to every time"
                );
                (T, Some(NO_TIME), what)
            }
            Self::NoPolarity => {
                let what = format!("the polarity {} is not one of 0, 1, -1", value(P));
                (P, Some(NO_POLARITY), what)
            }
            Self::Mixed => (P, None, mixed(true)),
        }
    }
}

/// Returns the message for a recording that has both 0 and -1.
fn mixed(has_one: bool) -> String {
    if has_one {
        "more than two polarities: -1, 0 and 1. If 0 means no event, as in CeleX recordings, \
         --leave-out-bad-events leaves those out where one is among the first events; if files of 0 and 1 and of -1 and 1 were merged, \
         write p as 0 and 1 again"
            .to_owned()
    } else {
        "the polarities are 0 and -1, which would both be off: if they are signed bits, write p as \
         -p"
        .to_owned()
    }
}

/// Finds the smallest sensor that holds every event.
pub struct Extent {
    width: u16,
    height: u16,
    leave_out: bool,
    /// Whether an invalid event has ended the search.
    is_ended: bool,
}

impl Extent {
    /// Starts without events. Coordinates beyond the largest sensor end the search unless `reading` leaves out
    /// invalid events.
    pub fn new(reading: &Reading) -> Self {
        Self {
            width: 0,
            height: 0,
            leave_out: reading.bad_events == BadEvents::LeaveOut,
            is_ended: false,
        }
    }

    /// Adds an event; returns `false` if it is invalid and thus ends the search.
    pub fn add(&mut self, x: Option<Number>, y: Option<Number>) -> bool {
        let (Some(x), Some(y)) = (coordinate(x), coordinate(y)) else {
            self.is_ended = !self.leave_out;
            return self.leave_out;
        };
        self.width = self.width.max(x + 1);
        self.height = self.height.max(y + 1);
        true
    }

    /// Returns whether no event has been added.
    pub const fn is_empty(&self) -> bool {
        self.width == 0
    }

    /// Returns the size.
    ///
    /// # Errors
    /// There was no event; the message names the file `name`.
    pub fn sensor(&self, name: &str) -> Result<Sensor> {
        let what = if self.is_ended {
            "the first event is outside of every sensor (x and y are 0 to 2047), so no sensor size"
        } else {
            "no event, so no sensor size"
        };
        Sensor::new(self.width, self.height).ok_or_else(|| {
            error!(
                Undecided,
                "{name}: byte 0: {what}: give --width W --height H"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn row(t: i64, p: i64) -> Row {
        [t, 1, 2, p].map(|value| Some(Number::Whole(value)))
    }

    fn all(reading: &Reading, times: Times, rows: &[Row]) -> Result<(Vec<u64>, RowEvents), String> {
        let first = rows.get(..rows.len().min(4)).unwrap_or_default();
        let mut events = RowEvents::new(reading, times, Base::default(), first)?;
        events.sensor = Sensor {
            width: 8,
            height: 8,
        };
        let mut times = Vec::new();
        for row in rows {
            if let Some(event) = events.event(row).map_err(|(_, what)| what)? {
                times.push(event.t_us);
            }
        }
        Ok((times, events))
    }

    proptest! {
        /// Rows that stand as they are are what the rules make of them.
        #[test]
        fn plain_rows_are_rows(
            rows in proptest::collection::vec(
                (
                    prop_oneof![30 => 0..1_i64 << 40, 1 => -5..5_i64],
                    prop_oneof![30 => 0..8_i64, 1 => -1..70_000_i64],
                    prop_oneof![30 => 0..8_i64, 1 => -1..70_000_i64],
                    prop_oneof![60 => 0..2_i64, 1 => -1..3_i64],
                    prop_oneof![60 => Just(9_usize), 1 => 0..8_usize],
                ),
                0..60,
            ),
            leaves_out: bool, unit in prop_oneof![4 => Just(TimeUnit::Us), 1 => Just(TimeUnit::Ms)],
            time_offset_us in prop_oneof![4 => Just(0), 1 => -5..5_i64], is_u32 in prop::bool::weighted(0.2),
        ) {
            let rows: Vec<Row> = rows
                .into_iter()
                .map(|(t, x, y, p, odd)| {
                    let mut row = [t, x, y, p].map(|value| Some(Number::Whole(value)));
                    if let Some(value) = row.get_mut(odd) {
                        *value = Some(Number::Float(1.0));
                    } else if let Some(value) = odd.checked_sub(4).and_then(|odd| row.get_mut(odd)) {
                        *value = None;
                    }
                    row
                })
                .collect();
            let reading = Reading {
                bad_events: if leaves_out { BadEvents::LeaveOut } else { BadEvents::Refuse },
                time_unit: Some(unit),
                time_offset_us,
                ..Reading::default()
            };
            let times = Times { is_u32, ..Times::default() };
            let sensor = Sensor { width: 8, height: 7 };
            let new = || RowEvents::new(&reading, times, Base::default(), &[]).map(|rows| RowEvents { sensor, ..rows });
            let mut plain = new().unwrap();
            let mut by_rules = RowEvents { is_as_written: false, ..new().unwrap() };
            let (mut got, mut want, mut counts) = (Vec::new(), Vec::new(), [0, 0]);
            let ended = plain.append(&rows, &mut counts[0], &mut Batch::new(&mut got));
            let end = by_rules.append(&rows, &mut counts[1], &mut Batch::new(&mut want));
            prop_assert_eq!((got, ended, counts[0]), (want, end, counts[1]));
            prop_assert_eq!(plain.skipped, by_rules.skipped);
            prop_assert_eq!(format!("{:?}", plain.met), format!("{:?}", by_rules.met));
        }
    }

    proptest! {
        /// Columns of whole numbers are what the rules make of their rows.
        #[test]
        fn columns_are_rows(
            seed in any::<u64>(),
            length in 0..12_000_usize,
            odd in proptest::collection::vec((any::<prop::sample::Index>(), 0..4_usize, -2..9_i64), 0..8),
            off in -1..=0_i64,
            leaves_out: bool,
        ) {
            let mut state = seed;
            let mut random = |below: i64| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) as i64 % below
            };
            let mut columns = [const { Vec::new() }; 4];
            for _ in 0..length {
                columns[T].push(random(1 << 30));
                columns[X].push(random(8));
                columns[Y].push(random(7));
                columns[P].push(if random(2) == 1 { 1 } else { off });
            }
            for (at, which, value) in odd {
                if length > 0 {
                    columns[which][at.index(length)] = value;
                }
            }
            let reading = Reading {
                bad_events: if leaves_out { BadEvents::LeaveOut } else { BadEvents::Refuse },
                time_unit: Some(TimeUnit::Us),
                ..Reading::default()
            };
            let sensor = Sensor { width: 8, height: 7 };
            let new = || RowEvents::new(&reading, Times::default(), Base::default(), &[])
                .map(|rows| RowEvents { sensor, ..rows });
            let mut by_columns = new().unwrap();
            let mut by_rules = RowEvents { is_as_written: false, ..new().unwrap() };
            let rows: Vec<Row> = (0..length)
                .map(|at| columns.each_ref().map(|column| Some(Number::Whole(column[at]))))
                .collect();
            let (mut got, mut want, mut counts) = (Vec::new(), Vec::new(), [0, 0]);
            let slices = columns.each_ref().map(Vec::as_slice);
            let ended = by_columns.append_columns(slices, &mut counts[0], &mut Batch::new(&mut got));
            let end = by_rules.append(&rows, &mut counts[1], &mut Batch::new(&mut want));
            prop_assert_eq!((got, ended, counts[0]), (want, end, counts[1]));
            prop_assert_eq!(by_columns.skipped, by_rules.skipped);
            prop_assert_eq!(format!("{:?}", by_columns.met), format!("{:?}", by_rules.met));
        }
    }

    #[test]
    fn clocks_of_32_bits_go_on() {
        let times = Times {
            is_u32: true,
            ..Times::default()
        };
        let most = (1 << 32) - 1;
        let rows = [most - 1, most, 3, most, 5, 9, 1 << 31, most, 0].map(|t| row(t, 1));
        let (got, events) = all(&Reading::default(), times, &rows).unwrap();
        let all = 1_u64 << 32;
        let last = all - 1;
        assert_eq!(
            got,
            [
                last - 1,
                last,
                all + 3,
                last,
                all + 5,
                all + 9,
                all + (1 << 31),
                all + last,
                2 * all
            ]
        );
        assert!(events.assumptions.iter().any(|taken| taken.what == "clock"));
        // A clock that starts anew has not wrapped.
        let rows = [1 << 30, 7].map(|t| row(t, 1));
        let (got, _) = all_of(times, &rows);
        assert_eq!(got, [1 << 30, 7]);
    }

    fn all_of(times: Times, rows: &[Row]) -> (Vec<u64>, RowEvents) {
        all(&Reading::default(), times, rows).unwrap()
    }

    #[test]
    fn more_than_two_polarities_are_no_pair() {
        let of = |reading: &Reading, values: &[i64]| {
            let rows: Vec<Row> = values.iter().map(|p| row(5, *p)).collect();
            all(reading, Times::default(), &rows).map(|(events, _)| events.len())
        };
        let leave = Reading {
            bad_events: BadEvents::LeaveOut,
            ..Reading::default()
        };
        for good in [&[0, 1, 0][..], &[-1, 1], &[1, 1], &[-1, -1], &[0, 0]] {
            assert_eq!(of(&Reading::default(), good), Ok(good.len()));
        }
        // Within the sample, and after it.
        for bad in [
            &[-1, 0, 1][..],
            &[0, -1],
            &[1, 1, 1, 1, 0, 1, -1],
            &[1, 1, 1, 1, -1, 0],
        ] {
            let error = of(&Reading::default(), bad).unwrap_err();
            assert!(error.contains("polarities"), "{error}");
        }
        assert_eq!(of(&leave, &[-1, 0, 1, 0, 1]), Ok(3));
        assert!(of(&leave, &[-1, 0]).is_err());
        assert!(of(&leave, &[1, 1, 1, 1, 0, -1]).is_err());
    }

    #[test]
    fn bad_events_are_counted_by_cause() {
        let missing = [Some(Number::Float(f64::NAN)); 4];
        let with = |which: usize, value: Number| {
            let mut row = row(5, 1);
            row[which] = Some(value);
            row
        };
        let rows = [
            row(5, 1),
            missing,
            with(X, Number::Float(f64::NAN)),
            with(X, Number::Float(1.5)),
            with(Y, Number::Whole(8)),
            with(P, Number::Whole(7)),
            with(T, Number::Whole(-9)),
            row(6, 0),
        ];
        let leave = Reading {
            bad_events: BadEvents::LeaveOut,
            ..Reading::default()
        };
        let us = Times {
            scale: Some(Scale::US),
            ..Times::default()
        };
        let (got, events) = all(&leave, us, &rows).unwrap();
        assert_eq!(got, [5, 6]);
        let skipped: Vec<(&str, u64)> = events.skipped.iter().collect();
        let want = [
            (NO_PIXEL, 1),
            (NO_POLARITY, 1),
            (OUTSIDE, 1),
            (MISSING, 2),
            (NO_TIME, 1),
        ];
        assert_eq!(skipped.len(), want.len());
        assert!(
            want.iter().all(|cause| skipped.contains(cause)),
            "{skipped:?}"
        );
        // Without the option, each of them is an error.
        for row in &rows[1..7] {
            let error = all(&Reading::default(), us, &[*row]).err().unwrap();
            assert!(error.contains("--leave-out-bad-events"), "{error}");
        }
        let later = Reading {
            time_offset_us: 10,
            ..Reading::default()
        };
        assert_eq!(all(&later, us, &[row(-9, 1)]).unwrap().0, [1]);
    }

    #[test]
    fn times_are_scaled() {
        let whole = |scale: Scale, time| scale.us(Number::Whole(time));
        assert_eq!(whole(Scale::shift(-3), 1_500), Some(2));
        assert_eq!(whole(Scale::shift(-3), 1_499), Some(1));
        assert_eq!(whole(Scale::shift(6), 2), Some(2_000_000));
        assert_eq!(whole(Scale::shift(6), i64::MAX), None);
        assert_eq!(whole(Scale::new(25, 10), 3), Some(8));
        assert_eq!(Scale::shift(6).us(Number::Float(0.25)), Some(250_000));
        assert_eq!(Scale::shift(-3).us(Number::Float(2_600.0)), Some(3));
        assert_eq!(Scale::US.us(Number::Float(f64::INFINITY)), None);
    }
}
