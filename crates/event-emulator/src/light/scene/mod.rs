//! The light of a scene: a textured background seen by a moving camera, with objects and lamps in front of it.

pub(crate) mod camera;
pub(crate) mod pattern;
pub(crate) mod preset;
mod slopes;
pub(crate) mod texture;

use event_types::Sensor;

use super::{Light, Tile};
use crate::random::Random;
use preset::{Preset, Script};
use slopes::Slopes;
use texture::Texture;

/// Logarithm of the illuminance in lux of a well-lit room, the mid-level of scenes: 300 lx.
const ROOM_LN_LUX: f32 = 5.703_782_6;

/// The light of a [`Preset`].
#[derive(Debug, Clone)]
pub struct SceneLight {
    sensor: Sensor,
    script: Script,
    texture: Texture,
    slopes: Slopes,
}

impl SceneLight {
    /// Paints a scene; the seed decides on the texture.
    #[must_use]
    pub fn new(preset: Preset, sensor: Sensor, seed: u64) -> Self {
        let script = preset.script();
        let mut texture = Texture::new(&script.look, &mut Random::new(seed, 1));
        texture.brighten(ROOM_LN_LUX);
        let slopes = Slopes::new(&texture);
        Self {
            sensor,
            script,
            texture,
            slopes,
        }
    }

    /// Returns a bound of the rate of change that the camera's movement causes.
    fn camera_bound(&self, tile: Tile, from: f64, to: f64) -> f64 {
        let camera = &self.script.camera;
        if !camera.moves() {
            return 0.0;
        }
        let (u, v) = camera.offset(from);
        let (speed_u, speed_v) = camera.speed_bound(from, to);
        let way_v = speed_v * (to - from);
        let mut bound = 0.0_f64;
        let end = tile.y + tile.height;
        let mut y = tile.y;
        while y < end {
            // Rows of one layer of depth move alike.
            let pace = camera.row_speed(y, self.sensor.height);
            let first = y;
            while y < end && camera.row_speed(y, self.sensor.height) == pace {
                y += 1;
            }
            let speed_u = speed_u * libm::fabs(pace);
            let way_u = speed_u * (to - from);
            let left = u * pace + f64::from(tile.x);
            let top = v + f64::from(first);
            let (slope_u, slope_v) = self.slopes.greatest(
                (left - way_u, left + f64::from(tile.width) + way_u),
                (top - way_v, top + f64::from(y - first) + way_v),
            );
            bound = bound.max(speed_u * f64::from(slope_u) + speed_v * f64::from(slope_v));
        }
        bound
    }
}

impl Light for SceneLight {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn sample(&self, tile: Tile, t_ns: u64, ln_lux: &mut [f32]) {
        let camera = &self.script.camera;
        let (u, v) = camera.offset(t_ns as f64 * 1e-9);
        let rows = ln_lux.chunks_mut(usize::from(tile.width));
        for (y, row) in (tile.y..tile.y + tile.height).zip(rows) {
            let row_u = u * camera.row_speed(y, self.sensor.height);
            let (u, v) = (row_u + f64::from(tile.x), v + f64::from(y));
            self.texture.sample(u, v, row);
        }
        for pattern in &self.script.patterns {
            let Some(placed) = pattern.place_at(t_ns, self.sensor) else {
                continue;
            };
            let rows = ln_lux.chunks_mut(usize::from(tile.width));
            for (y, row) in (tile.y..tile.y + tile.height).zip(rows) {
                placed.add(y, tile.x, row);
            }
        }
    }

    fn rate_bound(&self, tile: Tile, from_ns: u64, to_ns: u64) -> f64 {
        let (from, to) = (from_ns as f64 * 1e-9, to_ns as f64 * 1e-9);
        let patterns = self.script.patterns.iter();
        let patterns = patterns.map(|p| p.rate_bound(tile, (from_ns, to_ns), self.sensor));
        self.camera_bound(tile, from, to) + patterns.sum::<f64>()
    }

    fn next_switch_ns(&self, tile: Tile, after_ns: u64) -> u64 {
        let patterns = self.script.patterns.iter();
        patterns
            .map(|pattern| pattern.next_switch_ns(tile, after_ns, self.sensor))
            .min()
            .unwrap_or(u64::MAX)
    }
}
