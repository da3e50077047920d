//! The pixel model: low-passed log intensity compared with two thresholds, as in ESIM and v2e.
//!
//! Each pixel stores its log intensity after the photoreceptor's low-pass filter, and the difference from the level
//! at its last event. An event is emitted when this difference crosses a threshold; its time is interpolated
//! linearly within the step.

use event_types::{Polarity, Sensor};

use super::photoreceptor::{PixelModel, Tables};
use crate::random::Random;
use crate::readout::Queue;

/// Number of neighbouring pixels of a row that are computed, or left asleep, together.
pub(super) const BLOCK: usize = 64;

/// A difference between light and low-passed light too small to matter: below it, the block may sleep.
const SETTLED: f32 = 1e-3;

/// Sleep state of a block.
#[derive(Debug, Clone, Copy, Default)]
struct Sleep {
    /// Last step in which the block was computed, counted from 1.
    computed: u64,
    /// First step in which leakage may cause an event.
    wake: u64,
}

/// State of all pixels, 24 bytes each.
#[derive(Debug, Clone)]
pub(super) struct Pixels {
    model: PixelModel,
    sensor: Sensor,
    step_us: u32,
    tables: Box<Tables>,
    /// Low-passed log intensity.
    level: Vec<f32>,
    /// `level` minus the level of the last event.
    change: Vec<f32>,
    threshold_on: Vec<f32>,
    threshold_off: Vec<f32>,
    /// End of the refractory period, in us since the scene began.
    ready_us: Vec<u64>,
    sleep: Vec<Sleep>,
    /// Increase of `change` per step caused by leakage.
    leak: f32,
    step: u64,
    random: Random,
}

impl Pixels {
    /// Creates pixels with a level of 0; [`Pixels::settle`] sets their initial light.
    pub(super) fn new(sensor: Sensor, step_us: u32, model: PixelModel, mut random: Random) -> Self {
        let count = sensor.pixels() as usize;
        let mut threshold = |mean: f32| -> Vec<f32> {
            (0..count)
                .map(|_| mean * (1.0 + model.mismatch * random.normal()).max(0.3))
                .collect()
        };
        let threshold_on = threshold(model.threshold_on);
        let threshold_off = threshold(model.threshold_off);
        // Spread between the thresholds, so that leakage does not make all pixels fire together.
        let change = if model.leak_hz > 0.0 {
            threshold_on
                .iter()
                .zip(&threshold_off)
                .map(|(on, off)| random.within(-0.9 * off, 0.9 * on))
                .collect()
        } else {
            vec![0.0; count]
        };
        let blocks = usize::from(sensor.height) * usize::from(sensor.width).div_ceil(BLOCK);
        Self {
            model,
            sensor,
            step_us,
            tables: Box::new(Tables::new(&model, step_us)),
            level: vec![0.0; count],
            change,
            threshold_on,
            threshold_off,
            ready_us: vec![0; count],
            sleep: vec![Sleep::default(); blocks],
            leak: model.leak_hz * model.threshold_on * step_us as f32 * 1e-6,
            step: 0,
            random,
        }
    }

    /// Returns the number of blocks per row.
    pub(super) fn blocks_per_row(&self) -> usize {
        usize::from(self.sensor.width).div_ceil(BLOCK)
    }

    /// Sets the level of a block to the light, as if the light had always been there.
    pub(super) fn settle(&mut self, y: u16, x: u16, light: &[f32]) {
        let first = usize::from(y) * usize::from(self.sensor.width) + usize::from(x);
        if let Some(level) = self.level.get_mut(first..first + light.len()) {
            level.copy_from_slice(light);
        }
    }

    /// Begins the next step.
    pub(super) fn begin_step(&mut self) {
        self.step = self.step.saturating_add(1);
    }

    /// Returns whether a block must be computed in this step even if its light is unchanged.
    pub(super) fn awake(&self, block: usize) -> bool {
        self.sleep.get(block).is_none_or(|s| s.wake <= self.step)
    }

    /// Computes a block of a row up to the end of the step, where its light is `light`, and queues its events.
    /// `may_sleep` permits the block to sleep if its light has settled.
    pub(super) fn compute(
        &mut self,
        (y, x): (u16, u16),
        light: &[f32],
        start_us: u64,
        may_sleep: bool,
        queue: &mut Queue,
    ) {
        let first = usize::from(y) * usize::from(self.sensor.width) + usize::from(x);
        let block = usize::from(y) * self.blocks_per_row() + usize::from(x) / BLOCK;
        let count = light.len().min(BLOCK);
        let range = first..first + count;
        let (Some(level), Some(change), Some(on), Some(off), Some(sleep)) = (
            self.level.get_mut(range.clone()),
            self.change.get_mut(range.clone()),
            self.threshold_on.get(range.clone()),
            self.threshold_off.get(range),
            self.sleep.get_mut(block),
        ) else {
            return;
        };
        // Adds the leakage of the steps slept through; this step's own follows below.
        let slept = self.step.saturating_sub(sleep.computed).saturating_sub(1);
        if slept > 0 {
            let leaked = slept as f32 * self.leak;
            for change in &mut *change {
                *change += leaked;
            }
        }
        sleep.computed = self.step;
        sleep.wake = self.step + 1;

        // Each loop does one kind of work, so that it vectorises.
        let mut alpha = [0_usize; BLOCK];
        for (alpha, light) in alpha.iter_mut().zip(light) {
            *alpha = Tables::index(*light);
        }
        let mut moved = [0.0_f32; BLOCK];
        for (moved, alpha) in moved.iter_mut().zip(&alpha).take(count) {
            *moved = self.tables.alpha_at(*alpha);
        }
        let mut any = false;
        for (((((moved, light), level), change), on), off) in moved
            .iter_mut()
            .zip(light)
            .zip(&mut *level)
            .zip(&mut *change)
            .zip(on)
            .zip(off)
        {
            let way = *moved * (light - *level);
            *level += way;
            *moved = way + self.leak;
            *change += *moved;
            any |= (*change >= *on) | (*change <= -*off);
        }
        let mut fired = 0_u64;
        if any {
            for (i, ((change, on), off)) in change.iter().zip(on).zip(off).enumerate() {
                fired |= u64::from((*change >= *on) | (*change <= -*off)) << i;
            }
        }
        if may_sleep && fired == 0 {
            let unsettled = light
                .iter()
                .zip(&*level)
                .any(|(light, level)| (light - level).abs() > SETTLED);
            if !unsettled {
                let margin = on
                    .iter()
                    .zip(&*change)
                    .fold(f32::MAX, |least, (on, change)| least.min(on - change));
                // The cast saturates: without leakage, the block sleeps until its light changes.
                let steps = (margin / self.leak) as u64;
                sleep.wake = self.step.saturating_add(steps).max(self.step + 1);
            }
        }
        while fired != 0 {
            let i = fired.trailing_zeros() as usize;
            fired &= fired - 1;
            self.cross(first + i, moved[i], (x + i as u16, y), start_us, queue);
        }
    }

    /// Emits an event for every threshold crossing of a pixel in this step.
    fn cross(
        &mut self,
        pixel: usize,
        moved: f32,
        place: (u16, u16),
        start_us: u64,
        queue: &mut Queue,
    ) {
        let Some((change, level)) = self.change.get(pixel).zip(self.level.get(pixel)) else {
            return;
        };
        let (mut change, dark) = (*change, self.tables.dark(*level));
        let step = self.step_us as f32;
        // The difference at the start of the step, relative to the level of the last crossing.
        let mut begin = change - moved;
        loop {
            let (polarity, crossed) = if change >= self.threshold_on[pixel] {
                (Polarity::On, self.threshold_on[pixel])
            } else if change <= -self.threshold_off[pixel] {
                (Polarity::Off, -self.threshold_off[pixel])
            } else {
                break;
            };
            let part = ((crossed - begin) / moved).clamp(0.0, 1.0);
            let after_us = ((part * step) as u32).min(self.step_us - 1);
            change -= crossed;
            begin -= crossed;
            let delay = if self.model.jitter_us > 0 {
                let spread = self.model.jitter_us as f32 * (1.0 + 3.0 * dark);
                (spread * self.random.unit()) as u32
            } else {
                0
            };
            self.emit(pixel, place, start_us, after_us + delay, polarity, queue);
        }
        self.change[pixel] = change;
    }

    /// Emits a noise event of a pixel, `after_us` into the step; the pixel's level becomes its new reference.
    pub(super) fn disturb(
        &mut self,
        pixel: u32,
        start_us: u64,
        after_us: u32,
        polarity: Polarity,
        queue: &mut Queue,
    ) {
        let width = u32::from(self.sensor.width);
        let (x, y) = ((pixel % width) as u16, (pixel / width) as u16);
        let block = usize::from(y) * self.blocks_per_row() + usize::from(x) / BLOCK;
        let pixel = pixel as usize;
        let slept = self
            .sleep
            .get(block)
            .map_or(0, |s| self.step.saturating_sub(s.computed));
        let Some(change) = self.change.get_mut(pixel) else {
            return;
        };
        // When a sleeping block wakes it adds the leakage of its sleep; the sum must be 0 at this point.
        *change = -(slept as f32 * self.leak);
        self.emit(pixel, (x, y), start_us, after_us, polarity, queue);
    }

    /// Returns a pixel's rate of noise events in its light, as a share (0 to 1) of the higher of the two rates.
    pub(super) fn noise_share(&self, pixel: u32) -> f32 {
        let (lit, dark) = self.model.noise_hz;
        let level = self.level.get(pixel as usize).copied().unwrap_or(0.0);
        let rate = lit + (dark - lit) * self.tables.dark(level);
        rate / lit.max(dark).max(f32::MIN_POSITIVE)
    }

    fn emit(
        &mut self,
        pixel: usize,
        (x, y): (u16, u16),
        start_us: u64,
        after_us: u32,
        polarity: Polarity,
        queue: &mut Queue,
    ) {
        let Some(ready_us) = self.ready_us.get_mut(pixel) else {
            return;
        };
        let t_us = start_us.saturating_add(u64::from(after_us));
        if t_us >= *ready_us {
            *ready_us = t_us.saturating_add(u64::from(self.model.refractory_us));
            queue.push(after_us, x, y, polarity);
        }
    }
}

#[cfg(test)]
mod tests {
    use event_types::Event;

    use super::*;

    /// A pixel that follows its light at once, without noise or delay.
    const IDEAL: PixelModel = PixelModel {
        threshold_on: 0.25,
        threshold_off: 0.25,
        mismatch: 0.0,
        refractory_us: 0,
        jitter_us: 0,
        leak_hz: 0.0,
        noise_hz: (0.0, 0.0),
        bandwidth_hz: 1e9,
    };

    const STEP_US: u32 = 1_000;

    /// Returns the events of one pixel whose log intensity at time t (in us) is `light(t)`, and how many steps were
    /// computed. With `sleep`, steps of a pixel at rest are skipped.
    fn run(
        model: PixelModel,
        steps: u64,
        sleep: bool,
        light: impl Fn(f64) -> f32,
    ) -> (Vec<Event>, u64) {
        let sensor = Sensor {
            width: 1,
            height: 1,
        };
        let mut pixels = Pixels::new(sensor, STEP_US, model, Random::new(1, 1));
        let mut queue = Queue::default();
        let mut events = Vec::new();
        let mut computed = 0;
        pixels.settle(0, 0, &[light(0.0)]);
        for step in 0..steps {
            let start_us = step * u64::from(STEP_US);
            let end_us = start_us + u64::from(STEP_US);
            queue.begin(start_us);
            pixels.begin_step();
            let (before, now) = (light(start_us as f64), light(end_us as f64));
            if !sleep || before != now || pixels.awake(0) {
                computed += 1;
                pixels.compute((0, 0), &[now], start_us, sleep, &mut queue);
            }
            queue.end(end_us);
            queue.take(usize::MAX, 0, &mut events);
        }
        (events, computed)
    }

    fn ramp(per_s: f64, from: f64) -> impl Fn(f64) -> f32 {
        move |t_us| (from + per_s * t_us * 1e-6) as f32
    }

    #[test]
    fn ramp_crosses_thresholds_at_the_right_times() {
        // Slopes in natural log units per second: one event per 2.5 ms, or four per step.
        for (per_s, every_us) in [(100.0, 2_500), (-100.0, 2_500), (1_000.0, 250)] {
            let polarity = Polarity::from_bool(per_s > 0.0);
            let us = 7_990_000.0 / f64::abs(per_s);
            let steps = (us / 1e3) as u64;
            let from = if per_s > 0.0 { -4.0 } else { 4.0 };
            let (events, _) = run(IDEAL, steps, false, ramp(per_s, from));
            let expected = steps * 1_000 / every_us;
            // The last crossing may coincide with the end.
            let count = events.len() as u64;
            assert!(
                count == expected || count + 1 == expected,
                "{per_s}: {count}"
            );
            for (i, event) in events.iter().enumerate() {
                let t_us = (i as u64 + 1) * every_us;
                assert!(event.t_us.abs_diff(t_us) <= 1, "{per_s}: {event:?} {t_us}");
                assert_eq!(event.polarity, polarity);
            }
        }
    }

    #[test]
    fn a_change_below_the_threshold_is_no_event() {
        let wave = |amplitude: f64| move |t: f64| (amplitude * libm::sin(t * 1e-3)) as f32;
        assert!(run(IDEAL, 100, false, wave(0.24)).0.is_empty());
        assert!(!run(IDEAL, 100, false, wave(0.26)).0.is_empty());
    }

    #[test]
    fn refractory_period_keeps_events_apart() {
        let model = PixelModel {
            refractory_us: 600,
            ..IDEAL
        };
        // Crossings come every 250 us: crossings 250 and 500 us after an event are too early.
        let (events, _) = run(model, 6, false, ramp(1_000.0, -4.0));
        let times: Vec<u64> = events.iter().map(|e| e.t_us).collect();
        assert!(times.len() >= 7, "{times:?}");
        assert!(times[0].abs_diff(250) <= 1, "{times:?}");
        for pair in times.windows(2) {
            assert!((pair[1] - pair[0]).abs_diff(750) <= 2, "{times:?}");
        }
    }

    #[test]
    fn darkness_slows_a_pixel() {
        let model = PixelModel {
            bandwidth_hz: 200.0,
            ..IDEAL
        };
        let time_of_fourth = |dark: f32| {
            let step = |t: f64| if t > 0.0 { dark } else { dark + 2.0 };
            let (events, _) = run(model, 500, false, step);
            events[3].t_us
        };
        let (lit, dim) = (time_of_fourth(1.0), time_of_fourth(-3.0));
        // The bandwidths differ by a factor of e^4, part of which the 1 ms step hides. In the dark, the middle of the
        // jump is reached after ln 2 / (2 pi 10 Hz).
        assert!(lit < 1_000 && dim.abs_diff(11_000) < 1_500, "{lit} {dim}");
    }

    #[test]
    fn leakage_gives_on_events_at_its_rate_asleep_or_not() {
        let model = PixelModel {
            leak_hz: 10.0,
            ..IDEAL
        };
        let (waking, every_step) = run(model, 1_000, false, |_| -1.0);
        let (sleeping, computed) = run(model, 1_000, true, |_| -1.0);
        assert_eq!(every_step, 1_000);
        assert!(computed < 100, "{computed}");
        assert_eq!(waking.len(), sleeping.len());
        assert!((9..=11).contains(&waking.len()));
        for (a, b) in waking.iter().zip(&sleeping) {
            assert_eq!((a.polarity, b.polarity), (Polarity::On, Polarity::On));
            // Adding up leakage at once rounds differently from adding it step by step.
            assert!(a.t_us.abs_diff(b.t_us) < 100, "{a:?} {b:?}");
        }
        for pair in sleeping.windows(2) {
            assert!((pair[1].t_us - pair[0].t_us).abs_diff(100_000) < 100);
        }
    }

    #[test]
    fn latency_only_delays() {
        let model = PixelModel {
            jitter_us: 200,
            ..IDEAL
        };
        let (ideal, _) = run(IDEAL, 70, false, ramp(100.0, -4.0));
        let (late, _) = run(model, 70, false, ramp(100.0, -4.0));
        let delays: Vec<u64> = ideal
            .iter()
            .zip(&late)
            .map(|(ideal, late)| late.t_us - ideal.t_us)
            .collect();
        assert!(delays.iter().all(|us| *us <= 800), "{delays:?}");
        assert!(delays.iter().any(|us| *us > 100), "{delays:?}");
    }

    #[test]
    fn mismatch_spreads_the_thresholds() {
        let sensor = Sensor {
            width: 64,
            height: 64,
        };
        let model = PixelModel {
            mismatch: 0.1,
            ..IDEAL
        };
        let pixels = Pixels::new(sensor, STEP_US, model, Random::new(5, 5));
        let mean = pixels.threshold_on.iter().sum::<f32>() / 4_096.0;
        let variance = pixels
            .threshold_on
            .iter()
            .map(|t| (t - mean).powi(2))
            .sum::<f32>();
        assert!((mean - 0.25).abs() < 0.003, "{mean}");
        assert!(((variance / 4_096.0).sqrt() - 0.025).abs() < 0.003);
    }

    #[test]
    fn noise_grows_in_the_dark() {
        let sensor = Sensor {
            width: 3,
            height: 1,
        };
        let model = PixelModel {
            noise_hz: (0.1, 2.0),
            ..IDEAL
        };
        let mut pixels = Pixels::new(sensor, STEP_US, model, Random::new(5, 5));
        pixels.settle(0, 0, &[-6.0, -2.0, 4.0]);
        let share = [0, 1, 2].map(|pixel| pixels.noise_share(pixel));
        assert!(share[0] > 0.95 && share[0] <= 1.0, "{share:?}");
        assert!((share[1] - 0.525).abs() < 0.05, "{share:?}");
        assert!(share[2] < 0.06 && share[2] >= 0.05, "{share:?}");
    }
}
