//! A seeded event-camera emulator: scenes with known parameters, read like a recording.
//!
//! ```text
//! texture + camera + patterns -> log intensity -> pixels (low-pass, thresholds) -> events
//!                                     noise, hot pixels ------------------------/
//! ```
//!
//! The light is computed once per step (1 ms) and assumed to change linearly in between; event times have a
//! resolution of 1 us. The same configuration gives the same events on every machine: all arithmetic is IEEE `f32`
//! and `f64` in a fixed order, and transcendental functions come from `libm`. Memory use is 24 bytes per pixel plus
//! the events of one step. A block of pixels whose light has settled costs nothing until leakage makes one of its
//! pixels fire.

mod noise;
mod pattern;
mod photoreceptor;
mod pixel;
mod preset;
mod queue;
#[cfg(test)]
mod tests;
mod texture;

use event_types::stream::{BATCH_EVENTS, EventReader, Result, Skipped};
use event_types::{Event, Polarity, Sensor, ensure};

use noise::{Arrivals, HotPixel, Random};
use pattern::Placed;
use pixel::{BLOCK, Pixels};
use preset::Script;
pub use preset::{PRESETS, Preset};
use queue::Queue;
use texture::Texture;

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
}

impl SceneConfig {
    /// Returns the configuration of a preset with its default sensor and duration, starting at 0.
    #[must_use]
    pub const fn new(preset: Preset, seed: u64) -> Self {
        Self {
            preset,
            sensor: preset.sensor(),
            duration_us: preset.duration_us(),
            start_us: 0,
            seed,
        }
    }
}

/// A running emulation of a scene; its events are read through [`EventReader`].
///
/// Events are ordered by time, then y, then x, then OFF before ON.
#[derive(Debug, Clone)]
pub struct Emulator {
    config: SceneConfig,
    script: Script,
    texture: Texture,
    pixels: Pixels,
    /// Patterns as placed at the end of the last step; `None` for a pattern out of sight.
    placed: Vec<Option<Placed>>,
    /// Blocks whose light may change in this step.
    lit: Vec<bool>,
    arrivals: Arrivals,
    hot: Vec<HotPixel>,
    random: Random,
    queue: Queue,
    /// End of the last step, in us since the start of the scene.
    elapsed_us: u64,
    skipped: Skipped,
}

/// Starts the emulation of a scene.
///
/// # Errors
/// A sensor side of 0 or above [`Sensor::SIDE_MAX`]; a start plus duration beyond 2^64 us.
pub fn emulate(config: SceneConfig) -> Result<Emulator> {
    let Sensor { width, height } = config.sensor;
    ensure!(
        Sensor::new(width, height).is_some(),
        Refused,
        "scene {}: a sensor of {width} x {height} pixels; give sides of 1 to {}",
        config.preset.name(),
        Sensor::SIDE_MAX
    );
    ensure!(
        config.start_us.checked_add(config.duration_us).is_some(),
        Refused,
        "scene {}: start {} us plus duration {} us is beyond 2^64; give an earlier start",
        config.preset.name(),
        config.start_us,
        config.duration_us
    );
    let script = config.preset.script();
    let texture = Texture::new(&script.look, &mut Random::new(config.seed, 1));
    let pixels = Pixels::new(
        config.sensor,
        script.step_us,
        script.pixel,
        Random::new(config.seed, 2),
    );
    let mut random = Random::new(config.seed, 3);
    let count = config.sensor.pixels();
    let (lit_hz, dark_hz) = script.pixel.noise_hz;
    // Candidates arrive at the highest rate of any light; each is then kept with a probability set by its pixel's
    // light.
    let arrivals = Arrivals::new(
        f64::from(count) * f64::from(lit_hz.max(dark_hz)),
        &mut random,
    );
    let hot = noise::hot_pixels(count, script.hot.0, script.hot.1, &mut random);
    let blocks = usize::from(height) * pixels.blocks_per_row();
    let mut emulator = Emulator {
        config,
        script,
        texture,
        pixels,
        placed: Vec::new(),
        lit: vec![true; blocks],
        arrivals,
        hot,
        random,
        queue: Queue::default(),
        elapsed_us: 0,
        skipped: Skipped::default(),
    };
    emulator.place(0.0);
    emulator.for_lit_blocks(0.0, |pixels, _, (y, x), light| pixels.settle(y, x, light));
    Ok(emulator)
}

impl Emulator {
    /// Returns the configuration of the scene.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// Returns how much of the duration has been emulated, in us.
    #[must_use]
    pub fn elapsed_us(&self) -> u64 {
        self.elapsed_us.min(self.config.duration_us)
    }

    /// Appends at most `most` events and returns their number; 0 only at the end (or if `most` is 0).
    fn read_some(&mut self, most: usize, events: &mut Vec<Event>) -> usize {
        loop {
            let taken = self.queue.take(most, self.config.start_us, events);
            if taken > 0 || most == 0 || self.elapsed_us >= self.config.duration_us {
                return taken;
            }
            self.step();
        }
    }

    /// Emulates one step and puts its events into the queue.
    fn step(&mut self) {
        let start_us = self.elapsed_us;
        let end_us = start_us.saturating_add(u64::from(self.script.step_us));
        let t = end_us as f64 * 1e-6;
        self.queue.begin(start_us);
        self.pixels.begin_step();
        // A block's light is recomputed where a pattern was or is; a moving background lights all blocks.
        self.lit.fill(self.script.camera.moves());
        self.mark();
        self.place(t);
        self.mark();
        let may_sleep = !self.script.camera.moves();
        if may_sleep {
            for (block, lit) in self.lit.iter_mut().enumerate() {
                *lit |= self.pixels.awake(block);
            }
        }
        self.for_lit_blocks(t, |pixels, queue, place, light| {
            pixels.compute(place, light, start_us, may_sleep, queue);
        });
        self.disturb(start_us);
        self.queue.end(end_us.min(self.config.duration_us));
        self.elapsed_us = end_us;
    }

    /// Places the patterns where they are at `t` seconds.
    fn place(&mut self, t: f64) {
        let sensor = self.config.sensor;
        self.placed.clear();
        let patterns = self.script.patterns.iter();
        self.placed.extend(patterns.map(|p| p.place(t, sensor)));
    }

    /// Marks the blocks touched by patterns that change.
    fn mark(&mut self) {
        let blocks = self.pixels.blocks_per_row();
        for (pattern, placed) in self.script.patterns.iter().zip(&self.placed) {
            let Some(placed) = placed.filter(|_| pattern.changes()) else {
                continue;
            };
            let (rows, across) = placed.blocks(BLOCK);
            for y in rows {
                let row = y * blocks..(y + 1) * blocks;
                let row = self.lit.get_mut(row).unwrap_or_default();
                if let Some(lit) = row.get_mut(across.clone()) {
                    lit.fill(true);
                }
            }
        }
    }

    /// Calls `compute` with the light of every lit block at `t` seconds.
    fn for_lit_blocks(
        &mut self,
        t: f64,
        mut compute: impl FnMut(&mut Pixels, &mut Queue, (u16, u16), &[f32]),
    ) {
        let Sensor { width, height } = self.config.sensor;
        let camera = &self.script.camera;
        let (u, v) = camera.offset(t);
        let blocks = self.pixels.blocks_per_row();
        for (y, lit) in (0..height).zip(self.lit.chunks(blocks)) {
            let row_u = u * camera.row_speed(y, height);
            for (x, lit) in (0..width).step_by(BLOCK).zip(lit) {
                if !lit {
                    continue;
                }
                let mut light = [0.0; BLOCK];
                let count = usize::from(width - x).min(BLOCK);
                let light = &mut light[..count];
                self.texture
                    .sample(row_u + f64::from(x), v + f64::from(y), light);
                for placed in self.placed.iter().flatten() {
                    placed.add(y, x, light);
                }
                compute(&mut self.pixels, &mut self.queue, (y, x), light);
            }
        }
    }

    /// Adds the noise events and hot-pixel events of a step.
    fn disturb(&mut self, start_us: u64) {
        let step_us = self.script.step_us;
        let count = self.config.sensor.pixels();
        while let Some(at_us) = self.arrivals.next(step_us, &mut self.random) {
            let pixel = self.random.below(count);
            let keep = self.random.unit() < self.pixels.noise_share(pixel);
            let polarity = Polarity::from_bool(self.random.unit() < 0.5);
            if keep {
                self.pixels
                    .disturb(pixel, start_us, at_us, polarity, &mut self.queue);
            }
        }
        for hot in &mut self.hot {
            while let Some(at_us) = hot.arrivals.next(step_us, &mut self.random) {
                // Hot pixels leak: 9 of 10 of their events are ON.
                let polarity = Polarity::from_bool(self.random.unit() < 0.9);
                self.pixels
                    .disturb(hot.pixel, start_us, at_us, polarity, &mut self.queue);
            }
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
        Ok(self.read_some(BATCH_EVENTS, events))
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
