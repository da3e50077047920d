//! What the caller states about a recording, for everything that the file does not state itself.

use event_types::Sensor;

/// What the caller knows about a recording.
///
/// What the file states takes precedence, except over [`Reading::time_unit`] and [`Reading::columns`], with which
/// a caller who knows better corrects the file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Reading {
    /// The sensor's size.
    pub size: Option<Sensor>,
    /// The unit of the times, for formats that do not fix it.
    pub time_unit: Option<TimeUnit>,
    /// Microseconds added to every time, so that times before 0 can be read.
    pub time_offset_us: i64,
    /// The columns of a table that hold t, x, y and p.
    pub columns: Option<Columns>,
    /// What to do with an invalid event.
    pub bad_events: BadEvents,
    /// Largest number of events of a window of EECVS frames, or `None` for what a sensor can send. Frames of windows
    /// with more are left out and counted.
    pub window_events_max: Option<u32>,
    /// Most work that finding the event times of a window of EECVS frames may cost, in millions of units, or `None`
    /// for the default. Times beyond it are rough, and their pixels are counted.
    pub window_work_max: Option<u32>,
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

/// A unit of a recording's times.
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
    /// Returns the power of ten by which a time in this unit is multiplied to get microseconds.
    #[must_use]
    pub const fn shift(self) -> i32 {
        match self {
            Self::S => 6,
            Self::Ms => 3,
            Self::Us => 0,
            Self::Ns => -3,
        }
    }

    /// Returns the unit's name, as used on the command line.
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

/// The columns of a table that hold t, x, y and p, in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Columns {
    /// Their positions, counted from 0, in a table of exactly this number of columns.
    Places {
        /// Positions of t, x, y and p.
        places: [usize; 4],
        /// Number of columns, including those that are left out.
        columns: usize,
    },
    /// Their names in the file.
    Names([String; 4]),
}

impl Columns {
    /// Parses either `xytp`, with one letter per column and `-` for each column to leave out, or
    /// `t=time,x=col,y=row,p=on`.
    ///
    /// # Errors
    /// A description of the syntax, if `text` does not follow it.
    pub fn parse(text: &str) -> Result<Self, String> {
        const USAGE: &str = "one letter per column, t, x, y, p once each and - for a column to \
                             leave out (as in -xytp), or names (as in t=time,x=col,y=row,p=on)";
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

/// What to do with an invalid event: one outside the sensor, with a missing value, or without a valid polarity.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum BadEvents {
    /// The event ends the recording with an error.
    #[default]
    Refuse,
    /// The event is left out and counted by its cause in [`crate::EventReader::skipped`].
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
