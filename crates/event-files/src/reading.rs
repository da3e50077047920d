//! How a recording is read where it does not say so itself, and what a reader took to be so.

use event_types::Sensor;

/// What the caller knows of a recording; what the file itself states counts more, but for [`Reading::time_unit`] and
/// [`Reading::columns`], which are how somebody who knows better corrects it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Reading {
    /// The sensor's size.
    pub size: Option<Sensor>,
    /// The unit of the times, of formats that do not fix it.
    pub time_unit: Option<TimeUnit>,
    /// What is added to every time, in microseconds; so times before 0 can be read.
    pub time_offset_us: i64,
    /// Which columns of a table are t, x, y and p.
    pub columns: Option<Columns>,
    /// What is done with an event that cannot be one.
    pub bad_events: BadEvents,
}

impl From<Option<Sensor>> for Reading {
    fn from(size: Option<Sensor>) -> Self {
        Self {
            size,
            ..Self::default()
        }
    }
}

impl From<&Self> for Reading {
    fn from(reading: &Self) -> Self {
        reading.clone()
    }
}

/// A unit of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// A time in this unit times 10 to this is in microseconds.
    #[must_use]
    pub const fn shift(self) -> i32 {
        match self {
            Self::S => 6,
            Self::Ms => 3,
            Self::Us => 0,
            Self::Ns => -3,
        }
    }

    /// Its name, as the command line has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::S => "s",
            Self::Ms => "ms",
            Self::Us => "us",
            Self::Ns => "ns",
        }
    }
}

/// Which columns of a table are t, x, y and p, in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Columns {
    /// Their places, counted from 0, of a table with so many columns.
    Places {
        /// Places of t, x, y and p.
        places: [usize; 4],
        /// Columns in all, those that are left out included.
        columns: usize,
    },
    /// Their names, as the file has them.
    Names([String; 4]),
}

impl Columns {
    /// Parses `xytp`, a letter for each column and `-` for one that is left out, or `t=time,x=col,y=row,p=on`.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        const USAGE: &str = "one letter for each column, t, x, y, p once each and - for one to leave out (as -xytp), \
                             or names (as t=time,x=col,y=row,p=on)";
        let wrong = || USAGE.to_owned();
        if text.contains('=') {
            let mut names: [Option<String>; 4] = Default::default();
            for part in text.split(',') {
                let (field, name) = part.split_once('=').ok_or_else(wrong)?;
                let field = ["t", "x", "y", "p"]
                    .iter()
                    .position(|known| *known == field.trim());
                let slot = field.and_then(|field| names.get_mut(field));
                if slot
                    .ok_or_else(wrong)?
                    .replace(name.trim().to_owned())
                    .is_some()
                {
                    return Err(wrong());
                }
            }
            return match names {
                [Some(t), Some(x), Some(y), Some(p)] => Ok(Self::Names([t, x, y, p])),
                _ => Err(wrong()),
            };
        }
        let letters: Vec<char> = text.chars().collect();
        let mut places = [0; 4];
        for (place, letter) in places.iter_mut().zip(['t', 'x', 'y', 'p']) {
            let mut found = (0..letters.len()).filter(|at| letters.get(*at) == Some(&letter));
            *place = found.next().ok_or_else(wrong)?;
            if found.next().is_some() {
                return Err(wrong());
            }
        }
        if letters.iter().any(|letter| !"txyp-".contains(*letter)) {
            return Err(wrong());
        }
        Ok(Self::Places {
            places,
            columns: letters.len(),
        })
    }
}

/// What is done with an event that cannot be one: outside of the sensor, with a value missing, of no polarity.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum BadEvents {
    /// It ends the recording with an error.
    #[default]
    Refuse,
    /// It is left out and counted by its cause in [`crate::EventReader::skipped`].
    LeaveOut,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_parsed() {
        let places = |places, columns| Ok(Columns::Places { places, columns });
        assert_eq!(Columns::parse("txyp"), places([0, 1, 2, 3], 4));
        assert_eq!(Columns::parse("-xytp"), places([3, 1, 2, 4], 5));
        assert_eq!(Columns::parse("yx-pt"), places([4, 1, 0, 3], 5));
        let names = ["time", "col", "row", "on"].map(str::to_owned);
        assert_eq!(
            Columns::parse("x=col, y=row, p=on, t=time"),
            Ok(Columns::Names(names))
        );
        for wrong in [
            "",
            "txy",
            "txypt",
            "txypz",
            "t=a,x=b,y=c",
            "t=a,t=b,x=c,y=d,p=e",
            "t=a,q",
        ] {
            assert!(Columns::parse(wrong).is_err(), "{wrong}");
        }
    }
}
