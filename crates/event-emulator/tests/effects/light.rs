//! Light that is a function of time alone.

use event_emulator::{Light, Tile};
use event_types::Sensor;

/// The same light for all pixels: ln E as a function of the time in seconds.
pub struct Even<F> {
    pub sensor: Sensor,
    pub ln_lux: F,
    /// Bound of its rate of change, in 1/s.
    pub bound: f64,
    /// Time at which it jumps, in ns; `u64::MAX` if it never does.
    pub switch_ns: u64,
}

impl<F: Fn(f64) -> f64 + Sync> Light for Even<F> {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn sample(&self, _: Tile, t_ns: u64, ln_lux: &mut [f32]) {
        ln_lux.fill((self.ln_lux)(t_ns as f64 * 1e-9) as f32);
    }

    fn rate_bound(&self, _: Tile, _: u64, _: u64) -> f64 {
        self.bound
    }

    fn next_switch_ns(&self, _: Tile, after_ns: u64) -> u64 {
        if after_ns < self.switch_ns {
            self.switch_ns
        } else {
            u64::MAX
        }
    }
}
