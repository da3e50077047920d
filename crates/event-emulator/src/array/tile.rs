//! The pixels of a tile, and when the tile's light is sampled.

use event_types::Polarity;

use super::Physics;
use super::block::{BLOCK, Before, Lanes, Span};
use super::past::Past;
use crate::light::{Light, Tile};
use crate::noise::defects::{Defect, defect};
use crate::noise::{Cause, Draws};

/// Numbers of the random sequences of pixels and of tiles.
const PIXEL_KIND: u64 = 1;
const TILE_KIND: u64 = 2;

/// Longest and shortest time between two samples, in ns.
const LONGEST_NS: f64 = 20e6;
const SHORTEST_NS: f64 = 10e3;

/// Threshold of a pixel that can never fire. A pixel in reset has an infinite one.
const NEVER: f32 = f32::MAX;

/// An event of a pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fired {
    pub(super) t_us: u64,
    pub(super) x: u16,
    pub(super) y: u16,
    pub(super) polarity: Polarity,
    pub(super) cause: Cause,
}

/// A pixel that fires regularly.
#[derive(Debug, Clone, Copy)]
struct Stuck {
    index: usize,
    polarity: Polarity,
    /// Its first event, as a share of the period, and the number of the next.
    phase: f64,
    next: u64,
}

/// What a pixel needs to fire, together: the rest is computed for many pixels at once, array by array.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(super) struct Own {
    /// End of the last reset.
    pub(super) since_ns: u64,
    pub(super) draws: Draws,
    /// Thresholds without noise.
    mean_on: f32,
    mean_off: f32,
}

/// The state of a tile's pixels, row by row: 80 bytes each.
#[derive(Debug, Clone)]
pub(super) struct TilePixels {
    pub(super) tile: Tile,
    /// Time of the last sample.
    pub(super) now_ns: u64,
    /// Time before the last sample.
    step_ns: f64,
    samples: u64,
    /// Input of the photoreceptor, ln I, at the last sample.
    x: Vec<f32>,
    /// I in lux at the last sample.
    current: Vec<f32>,
    /// Outputs of its poles.
    v1: Vec<f32>,
    v2: Vec<f32>,
    /// Output at the last reset, lower by what has leaked since.
    pub(super) reference: Vec<f32>,
    /// Thresholds, with the noise of the next crossing; infinite in reset.
    pub(super) on: Vec<f32>,
    pub(super) off: Vec<f32>,
    /// Expected noise events until the next one.
    pub(super) hazard: Vec<f32>,
    /// Leakage in natural log units per second, without that by light.
    leak: Vec<f32>,
    /// Noise events of the mean pixel per noise event of this one; never 0.
    pub(super) patience: Vec<f32>,
    /// What is looked at only where a pixel fires.
    pub(super) own: Vec<Own>,
    /// Hot pixels and their rates in Hz, by rising index.
    pub(super) hot: Vec<(usize, f32)>,
    stuck: Vec<Stuck>,
    /// Spreads the times of samples.
    schedule: Draws,
    pub(super) events: Vec<Fired>,
    /// Input and current at the next sample.
    next: Vec<f32>,
    next_current: Vec<f32>,
}

impl TilePixels {
    /// Creates the pixels of a tile in the light of time 0.
    pub(super) fn new(tile: Tile, light: &impl Light, physics: &Physics) -> Self {
        let parameters = &physics.parameters;
        let count = tile.pixels();
        let (mut x, mut current) = (vec![0.0; count], vec![0.0; count]);
        light.sample(tile, 0, &mut x);
        physics.photoreceptor.receive(&mut x, &mut current);
        let none = || vec![0.0_f32; count];
        let mut pixels = Self {
            tile,
            now_ns: 0,
            step_ns: LONGEST_NS,
            samples: 0,
            v1: x.clone(),
            v2: x.clone(),
            x,
            next_current: current.clone(),
            current,
            reference: none(),
            on: none(),
            off: none(),
            hazard: none(),
            leak: none(),
            patience: none(),
            own: Vec::with_capacity(count),
            hot: Vec::new(),
            stuck: Vec::new(),
            schedule: Draws::new(
                physics.seed,
                TILE_KIND,
                u64::from(tile.y) << 16 | u64::from(tile.x),
            ),
            events: Vec::new(),
            next: none(),
        };
        let leak = parameters.leak_hz * parameters.warmth() * parameters.threshold_on;
        let rate_before = light.rate_before(tile);
        for index in 0..count {
            let (x, y) = pixels.place(index);
            let number = u64::from(y) * u64::from(physics.width) + u64::from(x);
            let mut draws = Draws::new(physics.seed, PIXEL_KIND, number);
            let mut spread = |spread: f64| 1.0 + spread * draws.normal();
            let thresholds = parameters.threshold_spread;
            // Spreads are at most 0.3 and normal values within +-3.5: a threshold may not be 0 or below.
            let on = parameters.threshold_on * spread(thresholds).max(0.1);
            let off = parameters.threshold_off * spread(thresholds).max(0.1);
            pixels.leak[index] = (leak * spread(parameters.leak_spread).max(0.0)) as f32;
            let (mean_on, mean_off) = (on as f32, off as f32);
            let factor = physics.noise.factor(mean_on, mean_off);
            pixels.patience[index] = (1.0 / factor) as f32;
            let share = draws.unit();
            let cause = rate_before.map_or(1.0, |_| draws.unit());
            pixels.own.push(Own {
                since_ns: 0,
                draws,
                mean_on,
                mean_off,
            });
            let pole = physics.photoreceptor.first_pole(pixels.current[index]);
            pixels.arm(index, pole, physics);
            let (on, off) = (pixels.on[index], pixels.off[index]);
            let leaks = pixels.leak[index] + physics.leak_per_lux * pixels.current[index];
            let noise = physics.noise.rate(pole) / pixels.patience[index];
            // At rest, noise is left out: scenes keep the events that their seeds have had.
            let past = Past {
                signal_hz: rate_before
                    .map_or(0.0, |rate| rate / f64::from(0.5 * (mean_on + mean_off))),
                noise_hz: rate_before.map_or(0.0, |_| f64::from(noise)),
                leak_hz: f64::from(leaks / mean_on),
            };
            let change = past.distance((on, off), cause, share);
            pixels.reference[index] = pixels.v2[index] - change;
            pixels.hazard[index] = if parameters.shot_noise > 0.0 || parameters.hot_share > 0.0 {
                pixels.draw_hazard(index) as f32
            } else {
                f32::INFINITY
            };
            match defect(parameters, physics.seed, number) {
                None => {}
                Some(Defect::Hot(rate)) => pixels.hot.push((index, rate)),
                Some(Defect::Dead) => pixels.silence(index),
                Some(Defect::Stuck(polarity, phase)) => {
                    pixels.silence(index);
                    pixels.stuck.push(Stuck {
                        index,
                        polarity,
                        phase,
                        next: 0,
                    });
                }
            }
        }
        pixels
    }

    /// Lets a pixel never fire.
    fn silence(&mut self, index: usize) {
        self.on[index] = NEVER;
        self.off[index] = NEVER;
        self.hazard[index] = f32::INFINITY;
    }

    /// Draws the thresholds of a pixel's next crossing.
    pub(super) fn arm(&mut self, index: usize, pole: f32, physics: &Physics) {
        let rms = physics.noise.rms(pole);
        let own = &mut self.own[index];
        let mut threshold = |mean: f32| {
            let mean = f64::from(mean);
            (mean + rms * own.draws.normal()).max(0.1 * mean) as f32
        };
        self.on[index] = threshold(own.mean_on);
        self.off[index] = threshold(own.mean_off);
    }

    /// Draws how many noise events of the mean pixel pass until a pixel's next one.
    pub(super) fn draw_hazard(&mut self, index: usize) -> f64 {
        self.own[index].draws.exponential() * f64::from(self.patience[index])
    }

    /// Returns the column and row of a pixel on the sensor.
    pub(super) fn place(&self, index: usize) -> (u16, u16) {
        let width = usize::from(self.tile.width);
        let (x, y) = ((index % width) as u16, (index / width) as u16);
        (self.tile.x + x, self.tile.y + y)
    }

    /// Returns the samples taken, times the pixels.
    pub(super) fn samples(&self) -> u64 {
        self.samples * self.tile.pixels() as u64
    }

    /// Returns the events since the last call.
    pub(super) fn take_events(&mut self) -> impl Iterator<Item = Fired> + '_ {
        self.events.drain(..)
    }

    /// Emulates the tile until `end_ns` or a little later.
    pub(super) fn advance_to(&mut self, end_ns: u64, light: &impl Light, physics: &Physics) {
        while self.now_ns < end_ns {
            self.advance(light, physics);
        }
    }

    /// Emulates the tile until the next sample.
    fn advance(&mut self, light: &impl Light, physics: &Physics) {
        let from_ns = self.now_ns;
        let (to_ns, changes) = self.next_sample(light, physics);
        let switch_ns = light.next_switch_ns(self.tile, from_ns);
        let to_ns = to_ns.min(switch_ns);
        let is_switch = to_ns == switch_ns;
        if changes {
            // Before the switch: the light until then.
            let at_ns = to_ns - u64::from(is_switch);
            self.sample(at_ns, light, physics);
        } else {
            self.next.copy_from_slice(&self.x);
            self.next_current.copy_from_slice(&self.current);
        }
        self.run(Span::new(from_ns, to_ns, &physics.photoreceptor), physics);
        self.fire_stuck(to_ns, physics);
        self.now_ns = to_ns;
        if is_switch {
            self.sample(to_ns, light, physics);
            self.x.copy_from_slice(&self.next);
            self.current.copy_from_slice(&self.next_current);
        }
    }

    /// Returns when the light is to be sampled next, switches left out, and whether it changes until then.
    fn next_sample(&mut self, light: &impl Light, physics: &Physics) -> (u64, bool) {
        let from_ns = self.now_ns;
        // Times between samples vary at random: equal ones would be seen in the events' spectrum.
        let share = 0.7 + 0.3 * self.schedule.unit();
        let change = physics.sample_change * share;
        // The bound of a shorter time is lower: the best of several times is taken.
        let mut within_ns = (8.0 * self.step_ns).min(LONGEST_NS) * share;
        let bend_ns = light.next_bend_ns(self.tile, from_ns);
        within_ns = within_ns.min((bend_ns - from_ns) as f64);
        let mut step_ns = 0.0_f64;
        let mut changes = true;
        while step_ns < within_ns && within_ns >= SHORTEST_NS {
            let to_ns = from_ns.saturating_add(within_ns as u64);
            let bound = light.rate_bound(self.tile, from_ns, to_ns);
            if bound <= 0.0 {
                // Nothing changes for longer than the best time so far.
                (step_ns, changes) = (within_ns, false);
                break;
            }
            step_ns = step_ns.max(within_ns.min(change / bound * 1e9));
            within_ns *= 0.25;
        }
        let step_ns = step_ns.max(SHORTEST_NS);
        self.step_ns = step_ns;
        let to_ns = from_ns.saturating_add(step_ns as u64);
        (to_ns.min(bend_ns), changes)
    }

    /// Samples the light, as input of the photoreceptors.
    fn sample(&mut self, at_ns: u64, light: &impl Light, physics: &Physics) {
        self.samples += 1;
        light.sample(self.tile, at_ns, &mut self.next);
        let (next, current) = (&mut self.next, &mut self.next_current);
        physics.photoreceptor.receive(next, current);
    }

    /// Emulates the time from one sample to the next.
    fn run(&mut self, span: Span, physics: &Physics) {
        let count = self.x.len();
        let mut hot = 0;
        // A block's events are found after the next block is computed: what its pixels need comes from memory meanwhile.
        let (mut now, mut last) = (&mut Before::default(), &mut Before::default());
        let mut pending = (0, 0);
        for first in (0..count).step_by(BLOCK) {
            let due = self.advance_block(first, &span, &mut hot, now, physics);
            self.prefetch(first, due);
            self.fire_block(pending, &span, last, physics);
            pending = (first, due);
            core::mem::swap(&mut now, &mut last);
        }
        self.fire_block(pending, &span, last, physics);
    }

    /// Takes a block to the end of the span, and returns which of its pixels may have to fire. `hot` is the number of
    /// the next hot pixel.
    fn advance_block(
        &mut self,
        first: usize,
        span: &Span,
        hot: &mut usize,
        before: &mut Before,
        physics: &Physics,
    ) -> u64 {
        let range = first..(first + BLOCK).min(self.x.len());
        let lanes = Lanes {
            next: &self.next[range.clone()],
            next_current: &self.next_current[range.clone()],
            current: &mut self.current[range.clone()],
            x: &mut self.x[range.clone()],
            v1: &mut self.v1[range.clone()],
            v2: &mut self.v2[range.clone()],
            reference: &mut self.reference[range.clone()],
            on: &self.on[range.clone()],
            off: &self.off[range.clone()],
            hazard: &mut self.hazard[range.clone()],
            leak: &self.leak[range.clone()],
        };
        let mut due = lanes.advance(span, physics, before);
        while let Some((index, rate)) = self.hot.get(*hot).filter(|(i, _)| range.contains(i)) {
            before.keep_hazards(&self.hazard[range.clone()]);
            self.hazard[*index] -= rate * span.seconds * self.patience[*index];
            if self.hazard[*index] <= 0.0 {
                due |= 1 << (index - first);
            }
            *hot += 1;
        }
        due
    }

    /// Has memory send what pixels need to fire.
    fn prefetch(&self, first: usize, due: u64) {
        #[cfg(target_arch = "x86_64")]
        for own in lanes_of(due).filter_map(|lane| self.own.get(first + lane)) {
            use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            // SAFETY: Every x86-64 core has the instruction, which changes nothing but the cache, at any address.
            #[expect(unsafe_code, reason = "a prefetch")]
            unsafe {
                _mm_prefetch::<_MM_HINT_T0>(core::ptr::from_ref(own).cast());
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = (first, due);
    }

    /// Finds the events of those pixels of a block that may have to fire.
    fn fire_block(
        &mut self,
        (first, due): (usize, u64),
        span: &Span,
        before: &Before,
        physics: &Physics,
    ) {
        for lane in lanes_of(due) {
            let index = first + lane;
            let start = before.lane(lane, self.x[index], self.hazard[index]);
            self.fire(index, span, start, physics);
        }
    }

    /// Adds the events of stuck pixels before `to_ns`.
    fn fire_stuck(&mut self, to_ns: u64, physics: &Physics) {
        let period_ns = 1e9 / physics.parameters.stuck_hz;
        for number in 0..self.stuck.len() {
            let Stuck {
                index,
                polarity,
                phase,
                mut next,
            } = self.stuck[number];
            loop {
                let at_ns = (phase + next as f64) * period_ns;
                if at_ns >= to_ns as f64 {
                    break;
                }
                self.emit(index, at_ns, polarity, Cause::Stuck, physics);
                next += 1;
            }
            self.stuck[number].next = next;
        }
    }

    /// Adds a pixel's event at a time in ns, later by the comparator's latency.
    pub(super) fn emit(
        &mut self,
        index: usize,
        at_ns: f64,
        polarity: Polarity,
        cause: Cause,
        physics: &Physics,
    ) {
        let parameters = &physics.parameters;
        let mut delay_us = parameters.latency_us;
        if parameters.jitter_us > 0.0 {
            let spread = 2.0 * 3.0_f64.sqrt() * parameters.jitter_us;
            delay_us += spread * (self.own[index].draws.unit() - 0.5);
        }
        let (x, y) = self.place(index);
        self.events.push(Fired {
            t_us: (at_ns * 1e-3 + delay_us.max(0.0)) as u64,
            x,
            y,
            polarity,
            cause,
        });
    }
}

/// Returns the numbers of the bits that are set.
fn lanes_of(mut due: u64) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let lane = due.trailing_zeros();
        (due != 0).then(|| {
            due &= due - 1;
            lane as usize
        })
    })
}
