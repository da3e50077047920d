//! What holds for the frames of every source: later and later, finite, not negative.

use event_types::stream::{Error, Response, Result, VideoReader};
use event_types::{Sensor, error};

use super::clock::Clock;
use crate::Assumption;

/// The largest number of a frame, where white is 1.
const VALUE_MAX: f32 = 1e4;

/// A frame that was read.
pub(crate) struct Taken {
    /// Its own time in us, if it has one.
    pub(crate) t_us: Option<u64>,
}

/// A source of frames as they are stored.
pub(crate) trait Frames: Send {
    /// Implements [`VideoReader::format`].
    fn format(&self) -> &'static str;

    /// Implements [`VideoReader::sensor`].
    fn sensor(&self) -> Sensor;

    /// Implements [`VideoReader::response`].
    fn response(&self) -> Response;

    /// Implements [`VideoReader::assumptions`].
    fn assumptions(&self) -> &[Assumption] {
        &[]
    }

    /// Replaces `values` by the next frame's, row by row; `None` at the end.
    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>>;

    /// Returns the file and the place of the latest frame, with which messages begin.
    fn place(&self) -> String;

    /// Returns whether numbers above 1 may be a mistake about which number is white.
    fn doubts_white(&self) -> bool {
        false
    }
}

/// A reader that checks frames.
pub(crate) struct Checked {
    frames: Box<dyn Frames>,
    clock: Option<Clock>,
    /// Number of the next frame, and time of the latest.
    number: u64,
    last_us: Option<u64>,
}

impl Checked {
    pub(crate) fn new(frames: Box<dyn Frames>, clock: Option<Clock>) -> Self {
        Self {
            frames,
            clock,
            number: 0,
            last_us: None,
        }
    }

    fn error(&self, what: impl std::fmt::Display) -> Error {
        error!(
            Damaged,
            "{}: frame {}: {what}",
            self.frames.place(),
            self.number
        )
    }

    /// Returns an error if a number cannot be light.
    fn check(&self, values: &[f32]) -> Result<()> {
        let most = if self.frames.doubts_white() {
            1.0
        } else {
            VALUE_MAX
        };
        let is_light = |value: f32| value >= 0.0 && value <= most;
        // Without a branch per pixel, several are compared at once.
        if values
            .iter()
            .fold(true, |all, value| all & is_light(*value))
        {
            return Ok(());
        }
        let (index, value) = values
            .iter()
            .enumerate()
            .find(|(_, value)| !is_light(**value))
            .unwrap_or((0, &0.0));
        let width = usize::from(self.frames.sensor().width);
        let at = format!(
            "the pixel at x = {}, y = {} is {value}",
            index % width,
            index / width
        );
        Err(self.error(if *value > VALUE_MAX && value.is_finite() {
            format!("{at} times white: give --white with the number that is white")
        } else if *value > 1.0 && value.is_finite() {
            format!(
                "{at}, brighter than white, which is 1 for floats: give --white with the number that is white (--white 1 \
                 where light brighter than white is meant)"
            )
        } else {
            format!("{at}, which is no light: give finite numbers of 0 or more")
        }))
    }
}

impl VideoReader for Checked {
    fn format(&self) -> &'static str {
        self.frames.format()
    }

    fn sensor(&self) -> Sensor {
        self.frames.sensor()
    }

    fn response(&self) -> Response {
        self.frames.response()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.frames.assumptions()
    }

    fn read(&mut self, values: &mut Vec<f32>) -> Result<Option<u64>> {
        let Some(taken) = self.frames.next(values)? else {
            if let Some(clock) = &mut self.clock {
                clock.check_end(self.number)?;
            }
            return Ok(None);
        };
        let own = match &mut self.clock {
            Some(clock) => Some(clock.time_us(self.number)?),
            None => taken.t_us,
        };
        let t_us = own.ok_or_else(|| self.error("has no time: give --fps"))?;
        if let Some(last_us) = self.last_us.filter(|last_us| *last_us >= t_us) {
            let what = match &self.clock {
                Some(clock) => format!(
                    "its time, {t_us} us, is not later than that of the frame before, {last_us} us: correct {}",
                    clock.name()
                ),
                None => format!(
                    "its time, {t_us} us, is not later than that of the frame before, {last_us} us: give --fps, or \
                     --times FILE"
                ),
            };
            return Err(self.error(what));
        }
        let pixels = self.frames.sensor().pixels() as usize;
        if values.len() != pixels {
            return Err(self.error(format!("has {} pixels in place of {pixels}", values.len())));
        }
        self.check(values)?;
        self.last_us = Some(t_us);
        self.number += 1;
        Ok(Some(t_us))
    }
}
