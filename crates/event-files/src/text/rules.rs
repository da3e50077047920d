//! The event of a line's fields, and why a line is none.

use event_types::{Event, Polarity, Sensor};

use crate::Assumption;
use crate::input::OUTSIDE;
use crate::reading::TimeUnit;
use crate::text::decimal::Decimal;
use crate::text::layout::{Layout, polarity};
use crate::text::lines::{FIELDS_MAX, is_separator, unquoted};
use crate::text::plain::{Fields, Sign};

/// What makes an event of a line's fields.
pub struct Rules {
    pub layout: Layout,
    pub unit: TimeUnit,
    /// Whether the unit was inferred from times without fractions.
    pub has_whole_times: bool,
    pub offset_us: i64,
    pub polarities: Polarities,
    /// Whether a time has been rounded and an assumption says so.
    pub is_rounded: bool,
    pub assumptions: Vec<Assumption>,
    pub sensor: Sensor,
}

impl Rules {
    /// Returns the event of a line of any kind.
    pub fn parse(&mut self, line: &[u8]) -> Result<Event, Bad> {
        let mut fields = [&line[..0]; FIELDS_MAX];
        let mut count = 0;
        let parts = line.split(|byte| is_separator(*byte));
        for field in parts.filter(|field| !field.is_empty()) {
            match fields.get_mut(count) {
                Some(slot) => *slot = field,
                None => break,
            }
            count += 1;
        }
        let Layout {
            columns,
            t,
            x,
            y,
            p,
            ..
        } = self.layout;
        if count != columns {
            return Err(Bad::Fields(count));
        }
        let field = |column: usize| unquoted(fields.get(column).copied().unwrap_or_default());
        let time = Decimal::parse(field(t)).ok_or(Bad::NoTime)?;
        let t_us = self.time(time)?;
        let side = |field: &[u8]| Decimal::parse(field).and_then(Decimal::whole);
        let (Some(x), Some(y)) = (side(field(x)), side(field(y))) else {
            return Err(Bad::NoPixel);
        };
        let p = field(p);
        let on = polarity(p).ok_or(Bad::NoPolarity)?;
        self.finish(t_us, (x, y), on, Sign::of(p))
    }

    /// Returns what a message says of a line that is no event.
    pub fn told(&self, bad: &Bad) -> String {
        match bad {
            Bad::Fields(count) => format!("{count} fields instead of {}", self.layout.columns),
            Bad::NoTime => "the time is not a number".to_owned(),
            Bad::Fraction => "a time with a fraction after whole microseconds: give --time-unit, or name the column \
                              t_s or t_us"
                .to_owned(),
            Bad::TimeRange => {
                "the time is negative or above 2^63 us: see --time-offset-us".to_owned()
            }
            Bad::NoPixel => "x and y must be whole numbers that are not negative".to_owned(),
            Bad::NoPolarity => "the polarity is not one of 0, 1, -1, true, false".to_owned(),
            Bad::ThirdPolarity => {
                "the polarities include both 0 and -1: more than two; --leave-out-bad-events \
                 leaves the third out"
                    .to_owned()
            }
            Bad::Outside(x, y) => {
                let Sensor { width, height } = self.sensor;
                format!("x = {x}, y = {y} is outside the sensor ({width}x{height})")
            }
        }
    }

    /// Returns whether a time in whole numbers is in microseconds, and a polarity of 0 is taken.
    pub fn is_as_written(&self) -> bool {
        let Polarities { minus, third, .. } = self.polarities;
        self.unit == TimeUnit::Us && self.offset_us == 0 && !minus && !third
    }

    /// Returns the event of a plain line.
    #[inline]
    pub fn event(&mut self, fields: Fields) -> Result<Event, Bad> {
        let t_us = match (fields.time.integer(), self.unit) {
            (Some(t_us), TimeUnit::Us) if self.offset_us == 0 => t_us,
            _ => self.time(fields.time)?,
        };
        let on = fields.polarity == Sign::One;
        self.finish(t_us, (fields.x, fields.y), on, Some(fields.polarity))
    }

    /// Returns a time in microseconds.
    #[inline]
    fn time(&mut self, time: Decimal) -> Result<u64, Bad> {
        if self.has_whole_times && !time.is_whole() {
            return Err(Bad::Fraction);
        }
        let shift = self.unit.shift();
        let t_us = time
            .signed(shift)
            .ok()
            .and_then(|t_us| t_us.checked_add(self.offset_us))
            .and_then(|t_us| u64::try_from(t_us).ok())
            .ok_or(Bad::TimeRange)?;
        if !self.is_rounded && !time.is_whole_at(shift) {
            self.is_rounded = true;
            self.assumptions
                .push(Assumption::times_rounded("to the nearest"));
        }
        Ok(t_us)
    }

    /// Returns the event of a time, a pixel and a polarity.
    #[inline]
    fn finish(
        &mut self,
        t_us: u64,
        (x, y): (u64, u64),
        on: bool,
        sign: Option<Sign>,
    ) -> Result<Event, Bad> {
        if !self.polarities.takes(sign) {
            return Err(Bad::ThirdPolarity);
        }
        match (u16::try_from(x), u16::try_from(y)) {
            (Ok(x), Ok(y)) if self.sensor.contains(x, y) => Ok(Event {
                t_us,
                x,
                y,
                polarity: Polarity::from_bool(on),
            }),
            _ => Err(Bad::Outside(x, y)),
        }
    }
}

/// The values of OFF that have occurred in a file.
#[derive(Debug, Clone, Copy, Default)]
pub struct Polarities {
    pub zero: bool,
    pub minus: bool,
    /// Whether the first lines have both 0 and -1; in `CeleX` files 0 means no change.
    pub third: bool,
}

impl Polarities {
    /// Returns those of a file that begins with these lines.
    pub fn of(lines: &[Vec<&[u8]>], column: usize) -> Self {
        let has = |value: &[u8]| {
            let mut fields = lines.iter().filter_map(|line| line.get(column));
            fields.any(|field| *field == value)
        };
        Self {
            third: has(b"0") && has(b"-1"),
            ..Self::default()
        }
    }

    /// Adds the polarity of an event, if it is written as such a number; returns whether it is still one of two.
    #[inline]
    fn takes(&mut self, sign: Option<Sign>) -> bool {
        match sign {
            Some(Sign::Zero) if self.third => return false,
            Some(Sign::Zero) => self.zero = true,
            Some(Sign::MinusOne) => self.minus = true,
            _ => {}
        }
        !(self.zero && self.minus)
    }
}

/// The reason why a line is not an event.
pub enum Bad {
    Fields(usize),
    NoTime,
    Fraction,
    TimeRange,
    NoPixel,
    NoPolarity,
    ThirdPolarity,
    Outside(u64, u64),
}

impl Bad {
    /// Returns the name under which such lines are counted.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Fields(_) => "lines of another number of fields",
            Self::NoTime | Self::NoPixel => "events with a value that is no number",
            Self::Fraction => "events with a time of another unit",
            Self::TimeRange => "events before time 0",
            Self::NoPolarity => "events of no polarity",
            Self::ThirdPolarity => "events of a third polarity",
            Self::Outside(..) => OUTSIDE,
        }
    }
}
