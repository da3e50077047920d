//! The events of one pixel between two samples of its light.

use event_types::Polarity;

use super::Physics;
use super::block::{Span, Start};
use super::tile::TilePixels;
use crate::comparator::{Levels, first_crossing};
use crate::noise::Cause;
use crate::photoreceptor::Response;

impl TilePixels {
    /// Finds the events of a pixel in a span, and sets its reference, thresholds and hazard at the end.
    pub(super) fn fire(&mut self, index: usize, span: &Span, start: Start, physics: &Physics) {
        let seconds = (span.to_ns - span.from_ns) as f64 * 1e-9;
        let slope = f64::from(start.next - start.state.x) / seconds;
        let poles = (start.pole, physics.photoreceptor.second_pole);
        let leak = f64::from(start.leak);
        let response = Response::new(start.state, slope, poles, leak);
        // The reference at the beginning: the response has the leakage since then.
        let mut reference = f64::from(start.reference);
        let refractory_s = physics.parameters.refractory_us * 1e-6;
        let mut noise = NoiseClock::new(self, index, &start, seconds);

        let is_in_reset = self.on[index] == f32::INFINITY;
        let mut now = 0.0;
        if is_in_reset {
            now = (self.own[index].since_ns as f64 - span.from_ns as f64) * 1e-9;
        }
        let mut must_arm = is_in_reset;
        loop {
            // Noise in reset is lost.
            while noise.next < now.min(seconds) {
                noise.pass(self, index);
            }
            if now >= seconds {
                self.on[index] = f32::INFINITY;
                self.off[index] = f32::INFINITY;
                break;
            }
            if must_arm {
                reference = response.at(now).0;
                self.own[index].since_ns = span.from_ns + (now * 1e9) as u64;
                self.arm(index, start.pole, physics);
            }
            let levels = Levels {
                on: reference + f64::from(self.on[index]),
                off: reference - f64::from(self.off[index]),
            };
            let until = noise.next.min(seconds);
            let (at, polarity, cause) = match first_crossing(&response, levels, now, until) {
                Some((at, polarity)) => {
                    let since = self.own[index].since_ns as f64 - span.from_ns as f64;
                    let leaked = leak * (at - since * 1e-9);
                    let is_leak =
                        polarity == Polarity::On && leaked >= 0.5 * f64::from(self.on[index]);
                    let cause = if is_leak { Cause::Leak } else { Cause::Signal };
                    (at, polarity, cause)
                }
                None if noise.next < seconds => {
                    let at = noise.next;
                    noise.pass(self, index);
                    let (polarity, cause) = self.noise_event(index, &start, physics);
                    (at, polarity, cause)
                }
                None => break,
            };
            let at_ns = span.from_ns as f64 + at * 1e9;
            self.emit(index, at_ns, polarity, cause, physics);
            now = at + refractory_s;
            self.own[index].since_ns = span.from_ns + (now * 1e9) as u64;
            must_arm = true;
        }
        self.reference[index] = (reference - leak * seconds) as f32;
        self.hazard[index] = noise.hazard_at(seconds);
    }

    /// Returns polarity and cause of a noise event.
    fn noise_event(&mut self, index: usize, start: &Start, physics: &Physics) -> (Polarity, Cause) {
        let hot = self.hot.iter().find(|(hot, _)| *hot == index);
        let shot = physics.noise.rate(start.pole) / self.patience[index];
        let draws = &mut self.own[index].draws;
        if let Some((_, rate)) = hot
            && draws.unit() * f64::from(rate + shot) < f64::from(*rate)
        {
            // Hot pixels leak: 9 of 10 of their events are ON.
            return (Polarity::from_bool(draws.unit() < 0.9), Cause::Hot);
        }
        (
            physics.noise.polarity(start.pole, draws.unit()),
            Cause::ShotNoise,
        )
    }
}

/// When a pixel's next noise event comes, in seconds since the beginning of the span.
struct NoiseClock {
    next: f64,
    /// Noise events of the mean pixel per second.
    rate: f64,
    /// The hazard where the rate is 0.
    hazard: f32,
}

impl NoiseClock {
    fn new(pixels: &TilePixels, index: usize, start: &Start, seconds: f64) -> Self {
        let passed = f64::from(start.hazard - pixels.hazard[index]);
        // Not so of an infinite hazard, from which nothing is taken.
        let is_noisy = passed > 0.0;
        let (next, rate) = if is_noisy {
            let rate = passed / seconds;
            (f64::from(start.hazard) / rate, rate)
        } else {
            (f64::INFINITY, 0.0)
        };
        Self {
            next,
            rate,
            hazard: start.hazard,
        }
    }

    /// Goes on to the event after the next.
    fn pass(&mut self, pixels: &mut TilePixels, index: usize) {
        self.next += pixels.draw_hazard(index) / self.rate;
    }

    fn hazard_at(&self, seconds: f64) -> f32 {
        if self.rate > 0.0 {
            ((self.next - seconds) * self.rate).max(0.0) as f32
        } else {
            self.hazard
        }
    }
}
