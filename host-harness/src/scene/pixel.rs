//! The pixel: low-passed log intensity against two thresholds, as in ESIM and v2e.
//!
//! Each pixel holds the logarithm of its light after the photoreceptor's low-pass and the
//! difference of that to the level of its last event. An event is a crossing of a threshold by
//! the difference; its time is interpolated linearly within the step.

use eecvs_nostd::{Polarity, Sensor};

use super::noise::Random;
use super::queue::Queue;

/// Pixels of a row that are looked at, or left asleep, together.
pub(super) const BLOCK: usize = 64;

/// Log intensities of the tables: -8 to 8 in steps of 1/64.
const TABLE: usize = 1024;

/// A difference between light and low-passed light too small to show: the block may sleep.
const SETTLED: f32 = 1e-3;

/// Parameters of the pixels of a sensor. Log intensity 0 is a well-lit room.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelModel {
    /// Mean threshold of ON events, in natural log intensity, above 0.
    pub(super) threshold_on: f32,
    /// Mean threshold of OFF events, above 0.
    pub(super) threshold_off: f32,
    /// Standard deviation of the thresholds from pixel to pixel, relative.
    pub(super) mismatch: f32,
    /// Least time between two events of a pixel.
    pub(super) refractory_us: u32,
    /// Largest random delay of an event in good light; up to four times that in the dark.
    pub(super) jitter_us: u32,
    /// ON events per second of a pixel without any change: its reference level leaks away.
    pub(super) leak_hz: f32,
    /// Noise events per second of a pixel, in good light and in the dark.
    pub(super) noise_hz: (f32, f32),
    /// Bandwidth of the photoreceptor at log intensity 0; it follows the intensity.
    pub(super) bandwidth_hz: f32,
}

/// Least and largest bandwidth: bias currents bound it on both sides.
const BANDWIDTH_HZ: (f32, f32) = (4.0, 2_000.0);

/// What follows from the log intensity alone.
#[derive(Debug, Clone)]
struct Tables {
    /// Share of the way to the light that the low-pass goes in a step.
    alpha: [f32; TABLE],
    /// 0 in good light to 1 in the dark.
    dark: [f32; TABLE],
}

impl Tables {
    fn new(model: &PixelModel, step_us: u32) -> Self {
        let mut alpha = [0.0; TABLE];
        let mut dark = [0.0; TABLE];
        for (i, (alpha, dark)) in alpha.iter_mut().zip(&mut dark).enumerate() {
            let log = (i as f32 + 0.5) / 64.0 - 8.0;
            let bandwidth = (model.bandwidth_hz * libm::expf(log)).clamp(
                BANDWIDTH_HZ.0.min(model.bandwidth_hz),
                BANDWIDTH_HZ.1.max(model.bandwidth_hz),
            );
            let turns = bandwidth * step_us as f32 * 1e-6;
            *alpha = 1.0 - libm::expf(-6.283_185_5 * turns);
            // Half way at a seventh of the light of a room.
            *dark = 1.0 / (1.0 + libm::expf(1.5 * (log + 2.0)));
        }
        Self { alpha, dark }
    }

    fn index(log: f32) -> usize {
        // The cast saturates, a value that is not a number becomes 0.
        ((log + 8.0) * 64.0).clamp(0.0, (TABLE - 1) as f32) as usize & (TABLE - 1)
    }
}

/// Sleep of a block whose light rests.
#[derive(Debug, Clone, Copy, Default)]
struct Sleep {
    /// Last step in which the block was computed, counted from 1.
    computed: u64,
    /// First step in which leakage may cause an event.
    wake: u64,
}

/// State of all pixels: 24 bytes for each.
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
    /// Rise of `change` per step.
    leak: f32,
    step: u64,
    random: Random,
}

impl Pixels {
    /// Pixels that have long seen no light; [`Pixels::settle`] sets their first light.
    pub(super) fn new(sensor: Sensor, step_us: u32, model: PixelModel, mut random: Random) -> Self {
        let count = sensor.pixels() as usize;
        let mut threshold = |mean: f32| -> Vec<f32> {
            (0..count)
                .map(|_| mean * (1.0 + model.mismatch * random.normal()).max(0.3))
                .collect()
        };
        let threshold_on = threshold(model.threshold_on);
        let threshold_off = threshold(model.threshold_off);
        // Anywhere between the thresholds: leakage must not make all pixels fire together.
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

    /// Blocks per row.
    pub(super) fn blocks_per_row(&self) -> usize {
        usize::from(self.sensor.width).div_ceil(BLOCK)
    }

    /// Sets the level of a block to the light, as if it had always been there.
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

    /// Whether a block without new light must be computed in this step all the same.
    pub(super) fn awake(&self, block: usize) -> bool {
        self.sleep.get(block).is_none_or(|s| s.wake <= self.step)
    }

    /// Computes a block of a row to the end of the step, where its light is `light`, and queues
    /// its events. `may_sleep` says that the light may rest after this step.
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
        // What leaked while the block slept, all but this step's.
        let slept = self.step.saturating_sub(sleep.computed).saturating_sub(1);
        if slept > 0 {
            let leaked = slept as f32 * self.leak;
            for change in &mut *change {
                *change += leaked;
            }
        }
        sleep.computed = self.step;
        sleep.wake = self.step + 1;

        let mut moved = [0.0_f32; BLOCK];
        for ((moved, light), level) in moved.iter_mut().zip(light).zip(&mut *level) {
            let way = self.tables.alpha[Tables::index(*light)] * (light - *level);
            *level += way;
            *moved = way + self.leak;
        }
        let mut fired = 0_u64;
        for (i, (((moved, change), on), off)) in
            moved.iter().zip(&mut *change).zip(on).zip(off).enumerate()
        {
            *change += moved;
            fired |= u64::from((*change >= *on) | (*change <= -*off)) << i;
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
                // The cast saturates: without leakage the block sleeps until its light changes.
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

    /// Emits an event for every threshold that a pixel crossed in this step.
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
        let (mut change, dark) = (*change, self.tables.dark[Tables::index(*level)]);
        let step = self.step_us as f32;
        // Where the step began, measured from the level of the last crossing.
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

    /// A noise event of a pixel, `after_us` into the step; its level becomes the reference.
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
        // A sleeping block adds what leaked when it wakes; that must end at 0 here.
        *change = -(slept as f32 * self.leak);
        self.emit(pixel, (x, y), start_us, after_us, polarity, queue);
    }

    /// Share of the dark rate of noise events that a pixel has in its light, 0 to 1.
    pub(super) fn noise_share(&self, pixel: u32) -> f32 {
        let (lit, dark) = self.model.noise_hz;
        let level = self.level.get(pixel as usize).copied().unwrap_or(0.0);
        let rate = lit + (dark - lit) * self.tables.dark[Tables::index(level)];
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
