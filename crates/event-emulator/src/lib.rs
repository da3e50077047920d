//! A seeded event-camera emulator: scenes with known parameters, read like a recording.
//!
//! ```text
//! light/  ->  photoreceptor/  ->  comparator/  ->  readout/  ->  events
//! scenes      log, low-pass       thresholds       order
//!                       noise/ ------/
//! ```
//!
//! Two models of the pixel are there. [`Model::Steps`], the first, computes the light once per step of 1 ms.
//! [`Model::Physical`], the second, samples the light of each tile as finely as it changes, finds crossings in a closed
//! form, and has a parameter for each effect of the pixel ([`PixelParameters`]); it takes any [`Light`]
//! ([`PixelArray`]). The repository's `docs/emulator.md` has the formulas, and what was measured.
//!
//! What is really there is known, too: the cause of each event ([`Emulator::read_with_causes`]), and the object, the
//! motion and the depth at each pixel of a scene ([`SceneTruth`], in `truth/`).
//!
//! Event times have a resolution of 1 us. The same configuration gives the same events on every machine and with any
//! number of threads: all arithmetic is IEEE `f32` and `f64` in a fixed order, and transcendental functions come from
//! `libm` or from sums of the crate's own.

mod array;
mod comparator;
mod light;
mod math;
mod model_1;
mod noise;
mod parameters;
mod photoreceptor;
mod random;
mod readout;
#[cfg(test)]
mod tests;
mod truth;
mod video;
mod wide;

use event_types::stream::{BATCH_EVENTS, EventReader, Result, Skipped};
use event_types::{Event, Sensor, ensure};

pub use array::PixelArray;
pub use light::scene::SceneLight;
pub use light::scene::preset::{PRESETS, Preset};
pub use light::video::exposure::Exposure;
pub use light::video::motion::Motion;
pub use light::{Light, Tile};
pub use noise::Cause;
pub use parameters::{Effect, PARAMETERS, Parameter, PixelParameters};
pub use readout::parameters::{CAMERAS, Camera, READOUT_PARAMETERS, ReadoutParameters};
pub use readout::{Losses, Readout};
pub use truth::{ObjectKind, SceneTruth};
pub use video::{VideoConfig, VideoEmulator, emulate_video};

/// How a pixel is emulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Model {
    /// Model 1: light in steps of 1 ms, a low-pass of one pole, noise at two rates. Its events do not change from
    /// version to version.
    Steps,
    /// Model 2: light sampled as finely as it changes, and each effect of the pixel with its parameter.
    #[default]
    Physical,
}

impl Model {
    /// All models, by their numbers.
    pub const ALL: [Self; 2] = [Self::Steps, Self::Physical];

    /// Returns the number on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Steps => "1",
            Self::Physical => "2",
        }
    }

    /// Returns a one-line description of the model.
    #[must_use]
    pub const fn about(self) -> &'static str {
        match self {
            Self::Steps => "Light in steps of 1 ms; the events of earlier versions",
            Self::Physical => {
                "Light sampled as finely as it changes; a parameter for each effect of the pixel"
            }
        }
    }
}

/// Configuration of a scene to emulate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneConfig {
    /// Scene type.
    pub preset: Preset,
    /// Sensor size, 1 x 1 to 2048 x 2048.
    pub sensor: Sensor,
    /// Duration in us: events lie in [`start_us`, `start_us + duration_us`); 0 gives no events.
    pub duration_us: u64,
    /// Offset in us added to every event time; the scene itself does not depend on it.
    pub start_us: u64,
    /// Seed of the texture, the pixel mismatch and the noise.
    pub seed: u64,
    /// Model of the pixel.
    pub model: Model,
}

impl SceneConfig {
    /// Returns the configuration of a preset with its default sensor and duration, starting at 0, in model 2.
    #[must_use]
    pub const fn new(preset: Preset, seed: u64) -> Self {
        Self {
            preset,
            sensor: preset.sensor(),
            duration_us: preset.duration_us(),
            start_us: 0,
            seed,
            model: Model::Physical,
        }
    }

    /// Returns the same in model 1, whose events never change: for tests and counts that are compared over versions.
    #[must_use]
    pub const fn model_1(preset: Preset, seed: u64) -> Self {
        Self {
            model: Model::Steps,
            ..Self::new(preset, seed)
        }
    }

    /// Checks that the sensor and the times can exist.
    fn check(&self) -> Result<()> {
        let Sensor { width, height } = self.sensor;
        ensure!(
            Sensor::new(width, height).is_some(),
            Refused,
            "scene {}: a sensor of {width} x {height} pixels; give sides of 1 to {}",
            self.preset.name(),
            Sensor::SIDE_MAX
        );
        ensure!(
            self.start_us.checked_add(self.duration_us).is_some(),
            Refused,
            "scene {}: start {} us plus duration {} us is beyond 2^64; give an earlier start",
            self.preset.name(),
            self.start_us,
            self.duration_us
        );
        Ok(())
    }
}

/// A running emulation of a scene; its events are read through [`EventReader`].
///
/// Events are ordered by time, then y, then x, then OFF before ON.
#[derive(Debug, Clone)]
pub struct Emulator {
    config: SceneConfig,
    pixels: Pixels,
    skipped: Skipped,
}

#[derive(Debug, Clone)]
enum Pixels {
    Steps(Box<model_1::Emulation>),
    Physical(Box<PixelArray<SceneLight>>),
}

/// Starts the emulation of a scene, in model 2 with [`PixelParameters::default`].
///
/// # Errors
/// A sensor side of 0 or above [`Sensor::SIDE_MAX`]; a start plus duration beyond 2^64 us.
pub fn emulate(config: SceneConfig) -> Result<Emulator> {
    emulate_with(config, &PixelParameters::default())
}

/// Starts the emulation of a scene with the given pixel, which model 1 does not look at.
///
/// # Errors
/// As [`emulate`]; also parameters that [`PixelParameters::check`] refuses.
pub fn emulate_with(config: SceneConfig, parameters: &PixelParameters) -> Result<Emulator> {
    config.check()?;
    let pixels = match config.model {
        Model::Steps => Pixels::Steps(Box::new(model_1::Emulation::new(config))),
        Model::Physical => {
            let light = SceneLight::new(config.preset, config.sensor, config.seed);
            Pixels::Physical(Box::new(PixelArray::new(light, parameters, config.seed)?))
        }
    };
    Ok(Emulator {
        config,
        pixels,
        skipped: Skipped::default(),
    })
}

impl Emulator {
    /// Returns the configuration of the scene.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// Lets the threads of rayon's current pool share the work of model 2; the events are the same.
    #[must_use]
    pub fn parallel(mut self, is_parallel: bool) -> Self {
        self.pixels = match self.pixels {
            Pixels::Physical(array) => Pixels::Physical(Box::new(array.parallel(is_parallel))),
            steps @ Pixels::Steps(_) => steps,
        };
        self
    }

    /// Returns how much of the duration has been emulated, in us.
    #[must_use]
    pub fn elapsed_us(&self) -> u64 {
        match &self.pixels {
            Pixels::Steps(emulation) => emulation.elapsed_us(),
            Pixels::Physical(array) => array.elapsed_us(),
        }
    }

    /// Returns the samples of light taken so far, over all pixels; `None` in model 1.
    #[must_use]
    pub fn samples(&self) -> Option<u64> {
        match &self.pixels {
            Pixels::Steps(_) => None,
            Pixels::Physical(array) => Some(array.samples()),
        }
    }

    /// Reads as [`EventReader::read`] does, and appends the cause of each event.
    ///
    /// # Errors
    /// Model 1 does not know its events' causes.
    pub fn read_with_causes(
        &mut self,
        events: &mut Vec<Event>,
        causes: &mut Vec<Cause>,
    ) -> Result<usize> {
        ensure!(
            self.config.model == Model::Physical,
            Refused,
            "model 1 does not know the causes of its events; take model 2"
        );
        Ok(self.read_some(BATCH_EVENTS, events, Some(causes)))
    }

    /// Appends at most `most` events and returns their number; 0 only at the end (or if `most` is 0).
    fn read_some(
        &mut self,
        most: usize,
        events: &mut Vec<Event>,
        causes: Option<&mut Vec<Cause>>,
    ) -> usize {
        let span_us = (self.config.start_us, self.config.duration_us);
        match &mut self.pixels {
            Pixels::Steps(emulation) => emulation.read_some(most, events),
            Pixels::Physical(array) => array.read(most, span_us, events, causes),
        }
    }
}

impl EventReader for Emulator {
    fn format(&self) -> &'static str {
        "scene"
    }

    fn sensor(&self) -> Sensor {
        self.config.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        Ok(self.read_some(BATCH_EVENTS, events, None))
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
