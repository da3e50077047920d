//! Times of frames: by a rate, or from a file.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::str::FromStr;

use event_types::stream::{Context, Result};
use event_types::{bail, ensure, error};

use super::VideoReading;
use crate::text::decimal::Decimal;

/// Longest line of a file of times, in bytes.
const LINE_MAX: u64 = 1 << 10;

/// A rate of frames per second: a ratio of whole numbers, at most 1,000,000 as times are whole microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fps {
    frames: u64,
    seconds: u64,
}

impl Fps {
    /// Creates the rate of `frames` in `seconds`; `None` unless it is above 0 and at most 1,000,000 per second.
    #[must_use]
    pub const fn new(frames: u64, seconds: u64) -> Option<Self> {
        let is_rate = frames > 0 && seconds > 0 && frames / 1_000_000 <= seconds;
        if is_rate && frames as u128 <= seconds as u128 * 1_000_000 {
            Some(Self { frames, seconds })
        } else {
            None
        }
    }

    /// Returns the time in us of a frame by its number, to the nearest; `None` above 2^64 us.
    #[must_use]
    pub fn time_us(self, number: u64) -> Option<u64> {
        let seconds = u128::from(number).checked_mul(u128::from(self.seconds))?;
        let us = seconds.checked_mul(1_000_000)? + u128::from(self.frames / 2);
        u64::try_from(us / u128::from(self.frames)).ok()
    }

    /// Returns the frames per second.
    #[must_use]
    pub fn per_second(self) -> f64 {
        self.frames as f64 / self.seconds as f64
    }
}

impl FromStr for Fps {
    type Err = String;

    /// Parses `30`, `29.97` or `30000/1001`.
    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = match text.split_once(['/', ':']) {
            Some((frames, seconds)) => frames.parse().ok().zip(seconds.parse().ok()),
            None => Decimal::parse(text.as_bytes()).and_then(|decimal| {
                // To a millionth.
                decimal.scaled(6).ok().map(|frames| (frames, 1_000_000))
            }),
        };
        let rate = parsed.and_then(|(frames, seconds)| Self::new(frames, seconds));
        rate.ok_or_else(|| {
            "give frames per second as 30, 29.97 or 30000/1001, above 0 and at most 1000000"
                .to_owned()
        })
    }
}

/// The times of frames as the caller states them.
pub(crate) enum Clock {
    Rate(Fps),
    Times(Times),
}

/// A file with a time on each line.
pub(crate) struct Times {
    lines: BufReader<File>,
    name: String,
    /// Power of ten from the file's unit to microseconds.
    shift: i32,
    line: u64,
}

impl Clock {
    /// Returns the clock that `reading` states, if any.
    pub(crate) fn of(reading: &VideoReading) -> Result<Option<Self>> {
        let Some(path) = &reading.times else {
            return Ok(reading.fps.map(Self::Rate));
        };
        let name = path.display().to_string();
        ensure!(
            reading.fps.is_none(),
            Refused,
            "{name}: times and a frame rate are given: give one of them"
        );
        let Some(unit) = reading.time_unit else {
            bail!(
                Undecided,
                "{name}: the unit of the times is not stated: give --time-unit s, ms, us or ns"
            );
        };
        let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
        ensure!(
            !file.metadata().is_ok_and(|metadata| metadata.is_dir()),
            Refused,
            "{name}: is a folder, not a file of times"
        );
        Ok(Some(Self::Times(Times {
            lines: BufReader::new(file),
            name,
            shift: unit.shift(),
            line: 0,
        })))
    }

    /// Returns what states the times, for messages.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Rate(_) => "--fps",
            Self::Times(times) => &times.name,
        }
    }

    /// Returns the time in us of frame `number`; frames are asked for one after the other.
    pub(crate) fn time_us(&mut self, number: u64) -> Result<u64> {
        match self {
            Self::Rate(fps) => fps
                .time_us(number)
                .ok_or_else(|| error!(Damaged, "frame {number}: its time is beyond 2^64 us")),
            Self::Times(times) => match times.next()? {
                Some(t_us) => Ok(t_us),
                None => Err(error!(
                    Damaged,
                    "{}: line {}: the times end here, but frame {number} follows: give a time for each frame",
                    times.name,
                    times.line + 1
                )),
            },
        }
    }

    /// Checks that no time is left after `frames` frames.
    pub(crate) fn check_end(&mut self, frames: u64) -> Result<()> {
        let Self::Times(times) = self else {
            return Ok(());
        };
        let more = times.next()?;
        ensure!(
            more.is_none(),
            Damaged,
            "{}: line {}: a time, but there are {frames} frames only: give one time for each frame",
            times.name,
            times.line
        );
        Ok(())
    }
}

impl Times {
    /// Returns the time of the next line that is neither empty nor begins with `#`, in us.
    fn next(&mut self) -> Result<Option<u64>> {
        let mut line = Vec::new();
        loop {
            line.clear();
            let read = self
                .lines
                .by_ref()
                .take(LINE_MAX)
                .read_until(b'\n', &mut line);
            let read = read.with_context(|| format!("{}: cannot be read", self.name))?;
            if read == 0 {
                return Ok(None);
            }
            self.line += 1;
            let text = line.trim_ascii();
            if text.is_empty() || text.starts_with(b"#") && text.len() < LINE_MAX as usize {
                continue;
            }
            let time = Decimal::parse(text).and_then(|time| time.scaled(self.shift).ok());
            return match time {
                Some(t_us) => Ok(Some(t_us)),
                None => bail!(
                    Damaged,
                    "{}: line {}: is no time: give one number of 0 or more per line",
                    self.name,
                    self.line
                ),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_ratios_and_times_are_rounded_to_the_nearest() {
        let fps = |text: &str| text.parse::<Fps>();
        assert_eq!(fps("30"), Ok(Fps::new(30_000_000, 1_000_000).unwrap()));
        let ntsc = fps("30000/1001").unwrap();
        assert_eq!(ntsc.time_us(1), Some(33_367));
        assert_eq!(ntsc.time_us(30_000), Some(1_001_000_000));
        assert_eq!(fps("0.5").unwrap().time_us(3), Some(6_000_000));
        assert_eq!(fps("1000000").unwrap().time_us(7), Some(7));
        assert_eq!(
            fps("1/18446744073709551615").unwrap().time_us(u64::MAX),
            None
        );
        for bad in [
            "", "0", "-1", "nan", "1/0", "0/1", "1000001", "inf", "1e400", "3/2/1",
        ] {
            assert!(fps(bad).is_err(), "{bad}");
        }
    }
}
