//! Model 1: the light of all pixels is computed once per step (1 ms) and assumed to change linearly in between.
//!
//! ```text
//! texture + camera + patterns -> log intensity -> pixels (low-pass, thresholds) -> events
//!                                     noise, hot pixels ------------------------/
//! ```
//!
//! Memory use is 24 bytes per pixel plus the events of one step. A block of pixels whose light has settled costs
//! nothing until leakage makes one of its pixels fire.

mod noise;
mod photoreceptor;
mod pixel;
mod preset;

use event_types::{Event, Polarity, Sensor};

use crate::SceneConfig;
use crate::light::scene::pattern::Placed;
use crate::light::scene::preset::Script;
use crate::light::scene::texture::Texture;
use crate::random::Random;
use crate::readout::Queue;
use noise::{Arrivals, HotPixel};
use pixel::{BLOCK, Pixels};
use preset::Tuning;

/// A running emulation of a scene by model 1.
#[derive(Debug, Clone)]
pub(crate) struct Emulation {
    config: SceneConfig,
    script: Script,
    tuning: Tuning,
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
}

impl Emulation {
    /// Starts the emulation of a scene whose configuration has been checked.
    pub(crate) fn new(config: SceneConfig) -> Self {
        let script = config.preset.script();
        let tuning = preset::tuning(config.preset);
        let texture = Texture::new(&script.look, &mut Random::new(config.seed, 1));
        let pixels = Pixels::new(
            config.sensor,
            tuning.step_us,
            tuning.pixel,
            Random::new(config.seed, 2),
        );
        let mut random = Random::new(config.seed, 3);
        let count = config.sensor.pixels();
        let (lit_hz, dark_hz) = tuning.pixel.noise_hz;
        // Candidates arrive at the highest rate of any light; each is then kept with a probability set by its pixel's
        // light.
        let arrivals = Arrivals::new(
            f64::from(count) * f64::from(lit_hz.max(dark_hz)),
            &mut random,
        );
        let hot = noise::hot_pixels(count, tuning.hot.0, tuning.hot.1, &mut random);
        let blocks = usize::from(config.sensor.height) * pixels.blocks_per_row();
        let mut emulation = Self {
            config,
            script,
            tuning,
            texture,
            pixels,
            placed: Vec::new(),
            lit: vec![true; blocks],
            arrivals,
            hot,
            random,
            queue: Queue::default(),
            elapsed_us: 0,
        };
        emulation.place(0.0);
        emulation.for_lit_blocks(0.0, |pixels, _, (y, x), light| pixels.settle(y, x, light));
        emulation
    }

    /// Returns how much of the duration has been emulated, in us.
    pub(crate) fn elapsed_us(&self) -> u64 {
        self.elapsed_us.min(self.config.duration_us)
    }

    /// Appends at most `most` events and returns their number; 0 only at the end (or if `most` is 0).
    pub(crate) fn read_some(&mut self, most: usize, events: &mut Vec<Event>) -> usize {
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
        let end_us = start_us.saturating_add(u64::from(self.tuning.step_us));
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
        let step_us = self.tuning.step_us;
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
