//! Values of the ages of the latest events: time surfaces and TORE volumes.

use event_types::stream::{Context, EventReader, Result};
use event_types::{Event, Polarity, Sensor, ensure};

use super::{check_place, each_block, planes};

/// Ages up to this one, in microseconds, are not distinguished by TORE volumes.
pub const TORE_AGE_MIN_US: f64 = 150.0;
/// Ages are limited to this one, in microseconds, by TORE volumes.
pub const TORE_AGE_MAX_US: f64 = 5e6;

/// The times of the latest `depth` events of every polarity and pixel, plus one; 0 for none.
struct Recent {
    times: Vec<u64>,
    depth: usize,
}

impl Recent {
    /// Reads all events, none of which may be after `end_us`.
    fn of(reader: &mut dyn EventReader, end_us: u64, depth: usize) -> Result<Self> {
        let sensor = reader.sensor();
        let cells = 2 * sensor.pixels() as usize;
        let mut times = Vec::new();
        let refused = "the system refuses the memory of the latest events";
        times
            .try_reserve_exact(cells * depth)
            .ok()
            .context(refused)?;
        times.resize(cells * depth, 0);
        let (width, pixels) = (usize::from(sensor.width), sensor.pixels() as usize);
        each_block(
            reader,
            |events, index| check(sensor, end_us, events, index),
            |events| {
                for event in events {
                    let pixel = usize::from(event.y) * width + usize::from(event.x);
                    let first = if event.polarity == Polarity::On {
                        0
                    } else {
                        pixels
                    };
                    let from = (first + pixel) * depth;
                    let Some(queue) = times.get_mut(from..from + depth) else {
                        continue;
                    };
                    // The latest first, whatever the order of the events.
                    let mut time = event.t_us + 1;
                    for slot in queue {
                        if time > *slot {
                            std::mem::swap(slot, &mut time);
                        }
                    }
                }
            },
        )?;
        Ok(Self { times, depth })
    }

    /// Writes the value of the ages to planes: ON from the latest to the oldest, then OFF.
    fn write(&self, end_us: u64, cells: &mut [f32], value: impl Fn(Option<u64>) -> f32) {
        let pixels = self.times.len() / self.depth / 2;
        for (cell, queue) in self.times.chunks_exact(self.depth).enumerate() {
            let (of, pixel) = (cell / pixels, cell % pixels);
            for (at, time) in queue.iter().enumerate() {
                let age = time.checked_sub(1).map(|t_us| end_us - t_us);
                if let Some(slot) = cells.get_mut((of * self.depth + at) * pixels + pixel) {
                    *slot = value(age);
                }
            }
        }
    }
}

fn check(sensor: Sensor, end_us: u64, events: &[Event], index: u64) -> Result<()> {
    for (index, event) in (index..).zip(events) {
        check_place(sensor, event, index)?;
        ensure!(
            event.t_us <= end_us,
            Refused,
            "event {index} at {} us is after the time of the surface, {end_us} us",
            event.t_us
        );
    }
    Ok(())
}

/// A time surface: the age of the latest event of every pixel and polarity, decaying exponentially.
///
/// ```text
/// S[p, y, x] = exp(-(end - t) / tau), t the time of the latest event of polarity p; 0 without one
/// ```
///
/// As in Lagorce et al., *HOTS* (2017). ON is channel 0.
#[derive(Debug, Clone, Copy)]
pub struct TimeSurface {
    /// Time at which the surface is looked at, in microseconds.
    pub end_us: u64,
    /// Time constant in microseconds, above 0.
    pub tau_us: f64,
}

impl TimeSurface {
    /// Number of channels.
    pub const CHANNELS: usize = 2;

    /// Writes the surface of all events of `reader` to `cells`, 2 x H x W.
    ///
    /// # Errors
    /// Those of the reader; an event outside of the sensor or after `end_us`; `cells` of another length; a time constant
    /// that is not above 0.
    pub fn fill(&self, reader: &mut dyn EventReader, cells: &mut [f32]) -> Result<()> {
        ensure!(
            self.tau_us > 0.0,
            Refused,
            "the time constant is {} us: it must be above 0",
            self.tau_us
        );
        planes(reader.sensor(), Self::CHANNELS, cells.len())?;
        let recent = Recent::of(reader, self.end_us, 1)?;
        recent.write(self.end_us, cells, |age| {
            age.map_or(0.0, |age| (-(age as f64) / self.tau_us).exp() as f32)
        });
        Ok(())
    }
}

/// A TORE volume: logarithms of the ages of the latest k events of every pixel and polarity.
///
/// ```text
/// age = end - t, at most 5 s; 5 s without an event
/// V[p k + i, y, x] = max(0, ln(age + 1) - ln(150 + 1)), age in us of the i-th latest event of polarity p
/// ```
///
/// Baldwin et al., *Time-Ordered Recent Event (TORE) Volumes for Event Cameras* (2021), with their k = 3 or any other. ON
/// is first.
#[derive(Debug, Clone, Copy)]
pub struct Tore {
    /// Time at which the volume is looked at, in microseconds.
    pub end_us: u64,
    /// Number k of events of each polarity; 0 is taken as 1.
    pub depth: u16,
}

impl Tore {
    /// Returns the number of channels, 2 k.
    #[must_use]
    pub fn channels(&self) -> usize {
        2 * usize::from(self.depth.max(1))
    }

    /// Writes the volume of all events of `reader` to `cells`, 2 k x H x W.
    ///
    /// # Errors
    /// Those of the reader; an event outside of the sensor or after `end_us`; `cells` of another length.
    pub fn fill(&self, reader: &mut dyn EventReader, cells: &mut [f32]) -> Result<()> {
        planes(reader.sensor(), self.channels(), cells.len())?;
        let recent = Recent::of(reader, self.end_us, usize::from(self.depth.max(1)))?;
        let least = (TORE_AGE_MIN_US + 1.0).ln();
        recent.write(self.end_us, cells, |age| {
            let age = age.map_or(TORE_AGE_MAX_US, |age| (age as f64).min(TORE_AGE_MAX_US));
            ((age + 1.0).ln() - least).max(0.0) as f32
        });
        Ok(())
    }
}
