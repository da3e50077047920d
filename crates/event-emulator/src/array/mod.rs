//! Model 2: an array of pixels that see a light.
//!
//! The array is divided into tiles. A tile takes a sample of its light when, by the bound of its rate of change, it may
//! have changed by a part of a threshold, or when a lamp of it switches; between two samples the pixels' outputs have
//! a closed form, and crossings are found in it. Tiles do not depend on each other.

mod block;
mod fire;
mod past;
mod tile;

use event_types::stream::Result;
use event_types::{Event, Sensor, ensure};
use rayon::prelude::*;

use crate::light::{Light, Tile};
use crate::noise::{Cause, ShotNoise};
use crate::parameters::PixelParameters;
use crate::photoreceptor::Photoreceptor;
use crate::readout::Queue;
use tile::TilePixels;

/// Columns and rows of a tile.
const TILE: (u16, u16) = (64, 8);

/// Time after which the tiles' events are put in order, in us. It has no influence on the events.
const STEP_US: u64 = 2_000;

/// What the pixels of an array have in common.
#[derive(Debug, Clone)]
struct Physics {
    parameters: PixelParameters,
    seed: u64,
    /// Columns of the sensor.
    width: u16,
    photoreceptor: Photoreceptor,
    noise: ShotNoise,
    /// Leakage by light, in natural log units per second and lux.
    leak_per_lux: f32,
    /// Largest change of light between two samples, in natural log units.
    sample_change: f64,
}

impl Physics {
    fn new(parameters: &PixelParameters, seed: u64, width: u16) -> Self {
        let smaller = parameters.threshold_on.min(parameters.threshold_off);
        let per_lux = parameters.parasitic_hz_per_klux * 1e-3 * parameters.threshold_on;
        Self {
            parameters: *parameters,
            seed,
            width,
            photoreceptor: Photoreceptor::new(parameters),
            noise: ShotNoise::new(parameters),
            leak_per_lux: per_lux as f32,
            sample_change: parameters.sample_change * smaller,
        }
    }
}

/// An array of pixels of model 2 that sees a [`Light`].
///
/// The same light, parameters and seed give the same events on every machine and with any number of threads. Memory
/// use is 80 bytes per pixel plus the events of some milliseconds.
///
/// ```
/// use event_emulator::{Light, PixelArray, PixelParameters, Tile};
/// use event_types::Sensor;
///
/// /// A lamp that is switched on after 2 ms.
/// struct Lamp;
///
/// impl Light for Lamp {
///     fn sensor(&self) -> Sensor {
///         Sensor { width: 32, height: 24 }
///     }
///
///     fn sample(&self, _: Tile, t_ns: u64, ln_lux: &mut [f32]) {
///         ln_lux.fill(if t_ns < 2_000_000 { 4.0 } else { 5.0 });
///     }
///
///     fn rate_bound(&self, _: Tile, _: u64, _: u64) -> f64 {
///         0.0
///     }
///
///     fn next_switch_ns(&self, _: Tile, after_ns: u64) -> u64 {
///         if after_ns < 2_000_000 { 2_000_000 } else { u64::MAX }
///     }
/// }
///
/// # fn main() -> Result<(), event_types::stream::Error> {
/// let mut pixels = PixelArray::new(Lamp, &PixelParameters::default(), 1)?;
/// let mut events = Vec::new();
/// while pixels.read(1_000, (0, 10_000), &mut events, None) > 0 {}
/// // All pixels see the lamp; a few fire before by noise.
/// let after = events.iter().filter(|event| event.t_us >= 2_000);
/// assert!(after.count() > 32 * 24);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct PixelArray<L> {
    light: L,
    physics: Physics,
    tiles: Vec<TilePixels>,
    queue: Queue,
    is_parallel: bool,
    /// End of the last step, in us since the beginning.
    elapsed_us: u64,
}

impl<L: Light> PixelArray<L> {
    /// Creates pixels that have seen before what [`Light::rate_before`] says.
    ///
    /// # Errors
    /// A sensor side of 0 or above [`Sensor::SIDE_MAX`]; parameters that [`PixelParameters::check`] refuses.
    pub fn new(light: L, parameters: &PixelParameters, seed: u64) -> Result<Self> {
        let Sensor { width, height } = light.sensor();
        ensure!(
            Sensor::new(width, height).is_some(),
            Refused,
            "a sensor of {width} x {height} pixels; give sides of 1 to {}",
            Sensor::SIDE_MAX
        );
        parameters.check()?;
        let physics = Physics::new(parameters, seed, width);
        let mut tiles = Vec::new();
        for y in (0..height).step_by(usize::from(TILE.1)) {
            for x in (0..width).step_by(usize::from(TILE.0)) {
                let tile = Tile {
                    x,
                    y,
                    width: TILE.0.min(width - x),
                    height: TILE.1.min(height - y),
                };
                tiles.push(TilePixels::new(tile, &light, &physics));
            }
        }
        Ok(Self {
            light,
            physics,
            tiles,
            queue: Queue::default(),
            is_parallel: false,
            elapsed_us: 0,
        })
    }

    /// Lets the threads of rayon's current pool share the work; otherwise the caller's thread does it.
    #[must_use]
    pub fn parallel(mut self, is_parallel: bool) -> Self {
        self.is_parallel = is_parallel;
        self
    }

    /// Returns the light.
    #[must_use]
    pub fn light(&self) -> &L {
        &self.light
    }

    /// Returns until when the pixels have been emulated, in us.
    #[must_use]
    pub fn elapsed_us(&self) -> u64 {
        self.elapsed_us
    }

    /// Returns the light, to which later times may be added.
    pub(crate) fn light_mut(&mut self) -> &mut L {
        &mut self.light
    }

    /// Returns how many samples of a tile's light have been taken so far, times the tiles' pixels: over the pixels and
    /// the time, the mean rate at which a pixel is sampled.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.tiles.iter().map(TilePixels::samples).sum()
    }

    /// Appends at most `most` of the events before `until_us`, their times later by `start_us`, and their causes;
    /// returns their number, 0 only if there are no more (or `most` is 0). Events are ordered by time, then y, then x,
    /// then OFF before ON.
    pub fn read(
        &mut self,
        most: usize,
        (start_us, until_us): (u64, u64),
        events: &mut Vec<Event>,
        causes: Option<&mut Vec<Cause>>,
    ) -> usize {
        while self.queue.is_taken() && most > 0 && self.elapsed_us < until_us {
            self.step(until_us);
        }
        self.queue.take_with(most, start_us, events, causes)
    }

    /// Emulates one step and puts its events into the queue.
    fn step(&mut self, until_us: u64) {
        let start_us = self.elapsed_us;
        let end_us = start_us.saturating_add(STEP_US).min(until_us);
        let end_ns = end_us.saturating_mul(1_000);
        self.queue.begin(start_us);
        let (light, physics) = (&self.light, &self.physics);
        let advance = |tile: &mut TilePixels| tile.advance_to(end_ns, light, physics);
        if self.is_parallel {
            self.tiles.par_iter_mut().for_each(advance);
        } else {
            self.tiles.iter_mut().for_each(advance);
        }
        for tile in &mut self.tiles {
            for event in tile.take_events() {
                // A tile is ahead by a sample at most: the cast has room.
                let after_us = (event.t_us - start_us) as u32;
                self.queue
                    .push_with(after_us, event.x, event.y, event.polarity, event.cause);
            }
        }
        self.queue.end(end_us);
        self.elapsed_us = end_us;
    }
}
