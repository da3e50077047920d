//! The light of a video: lines of ln E from frame to frame.

mod chord;
pub(crate) mod exposure;
pub(crate) mod motion;

use std::collections::VecDeque;

use event_types::Sensor;

use super::{Light, Tile};
use crate::wide::wide;

/// Columns and rows of a patch, a part of the picture whose greatest change is known.
const PATCH: (usize, usize) = (64, 8);

/// Least change of a pixel over the first frames, in natural log units, that is taken for motion: noise of a picture is less.
const MOVED: f32 = 0.1;

/// The light of the latest frames of a video; frames are added as time goes on.
#[derive(Debug, Clone)]
pub struct VideoLight {
    sensor: Sensor,
    /// At least one, the earliest first.
    frames: VecDeque<Frame>,
    /// Memory of frames that are no longer needed.
    spare: Vec<Frame>,
    /// Largest distance in natural log units of a frame that is left out from the line that stands for it.
    skipped: f32,
}

/// A frame of a video.
#[derive(Debug, Clone, Default)]
struct Frame {
    at_ns: u64,
    /// Light in ln lux.
    values: Vec<f32>,
    /// The greatest change of each patch since the frame before.
    changes: Vec<f32>,
}

impl VideoLight {
    /// Begins with a frame at time 0, of one value in ln lux for each pixel. A further frame has to be added before the
    /// light is used. Where a line through several frames is within `skipped` of all pixels of a tile, those between are
    /// left out.
    pub(crate) fn new(sensor: Sensor, first: Vec<f32>, skipped: f32) -> Self {
        let first = Frame {
            values: first,
            ..Frame::default()
        };
        Self {
            sensor,
            frames: VecDeque::from([first]),
            spare: Vec::new(),
            skipped,
        }
    }

    /// Adds a further frame, which is later; `values` gets the memory of one that is no longer needed.
    pub(crate) fn push(&mut self, values: &mut Vec<f32>, at_ns: u64) {
        let mut frame = self.spare.pop().unwrap_or_default();
        frame.at_ns = at_ns;
        core::mem::swap(&mut frame.values, values);
        frame.changes.clear();
        if let Some(before) = self.frames.back() {
            let width = usize::from(self.sensor.width);
            changes(&before.values, &frame.values, width, &mut frame.changes);
        }
        self.frames.push_back(frame);
    }

    /// Forgets all frames but the latest: the time before it is no longer asked for.
    pub(crate) fn forget(&mut self) {
        let old = self.frames.len().saturating_sub(1);
        self.spare.extend(self.frames.drain(..old));
    }

    /// Returns how many frames are known.
    pub(crate) fn known(&self) -> usize {
        self.frames.len()
    }

    /// Returns the two latest frames.
    pub(crate) fn latest(&self) -> (&[f32], &[f32]) {
        let from_last = |n: usize| {
            let at = self.frames.len().checked_sub(n)?;
            Some(self.frames.get(at)?.values.as_slice())
        };
        let after = from_last(1).unwrap_or_default();
        (from_last(2).unwrap_or(after), after)
    }

    /// Returns the number of the first frame after a time.
    fn first_after(&self, t_ns: u64) -> usize {
        self.frames.partition_point(|frame| frame.at_ns <= t_ns)
    }

    /// Returns the greatest change of a tile from the frame before to this one.
    fn change(&self, frame: &Frame, tile: Tile) -> f32 {
        let columns = usize::from(self.sensor.width).div_ceil(PATCH.0);
        let (x, y) = (usize::from(tile.x), usize::from(tile.y));
        let first = x / PATCH.0;
        let last = (x + usize::from(tile.width) - 1) / PATCH.0;
        let rows = y / PATCH.1..=(y + usize::from(tile.height) - 1) / PATCH.1;
        let patches = rows.flat_map(|row| {
            let row = row * columns;
            frame.changes.get(row + first..=row + last)
        });
        patches
            .flatten()
            .fold(0.0, |most, change| most.max(*change))
    }

    /// Returns the part of a row of a frame that belongs to a tile.
    fn part<'f>(&self, frame: &'f Frame, tile: Tile, y: u16) -> &'f [f32] {
        let start = usize::from(y) * usize::from(self.sensor.width) + usize::from(tile.x);
        let values = frame.values.get(start..start + usize::from(tile.width));
        values.unwrap_or_default()
    }
}

/// Appends the greatest difference of each patch between two pictures.
fn changes(before: &[f32], after: &[f32], width: usize, changes: &mut Vec<f32>) {
    wide!(changes_of_patches, before: &[f32], after: &[f32], width: usize, changes: &mut Vec<f32>);
}

#[inline(always)]
fn changes_of_patches(before: &[f32], after: &[f32], width: usize, changes: &mut Vec<f32>) {
    let rows = PATCH.1 * width;
    for (before, after) in before.chunks(rows).zip(after.chunks(rows)) {
        let first = changes.len();
        changes.resize(first + width.div_ceil(PATCH.0), 0.0);
        for (before, after) in before.chunks(width).zip(after.chunks(width)) {
            let patches = before.chunks(PATCH.0).zip(after.chunks(PATCH.0));
            for (change, (before, after)) in changes[first..].iter_mut().zip(patches) {
                // Bits of positive numbers have the numbers' order.
                let bits = before
                    .iter()
                    .zip(after)
                    .fold(change.to_bits(), |most, (b, a)| {
                        most.max((a - b).to_bits() & 0x7fff_ffff)
                    });
                *change = f32::from_bits(bits);
            }
        }
    }
}

impl Light for VideoLight {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn sample(&self, tile: Tile, t_ns: u64, ln_lux: &mut [f32]) {
        let width = usize::from(tile.width);
        let rows = (tile.y..tile.y + tile.height).zip(ln_lux.chunks_mut(width));
        let next = self.first_after(t_ns);
        let Some(before) = self.frames.get(next.saturating_sub(1)) else {
            return;
        };
        let after = match self.frames.get(next) {
            Some(after) if before.at_ns < t_ns => after,
            _ => {
                for (y, row) in rows {
                    row.copy_from_slice(self.part(before, tile, y));
                }
                return;
            }
        };
        let since = (t_ns - before.at_ns) as f64;
        let share = (since / (after.at_ns - before.at_ns) as f64) as f32;
        for (y, row) in rows {
            let (before, after) = (self.part(before, tile, y), self.part(after, tile, y));
            for ((value, b), a) in row.iter_mut().zip(before).zip(after) {
                *value = b + (a - b) * share;
            }
        }
    }

    fn rate_bound(&self, tile: Tile, from_ns: u64, to_ns: u64) -> f64 {
        let mut most = 0.0_f64;
        for next in self.first_after(from_ns)..self.frames.len() {
            let (Some(before), Some(after)) = (self.frames.get(next - 1), self.frames.get(next))
            else {
                break;
            };
            let seconds = (after.at_ns - before.at_ns) as f64 * 1e-9;
            most = most.max(f64::from(self.change(after, tile)) / seconds);
            if after.at_ns >= to_ns {
                break;
            }
        }
        most
    }

    fn next_switch_ns(&self, _: Tile, _: u64) -> u64 {
        u64::MAX
    }

    fn next_bend_ns(&self, tile: Tile, after_ns: u64) -> u64 {
        let next = self.first_after(after_ns);
        let Some(first) = self.frames.get(next) else {
            return u64::MAX;
        };
        if next + 1 == self.frames.len() {
            return first.at_ns;
        }
        self.chord_end(tile, after_ns, next).unwrap_or(first.at_ns)
    }

    fn rate_before(&self, tile: Tile) -> Option<f64> {
        let (first, last) = (self.frames.front()?, self.frames.back()?);
        let seconds = (last.at_ns - first.at_ns) as f64 * 1e-9;
        let rows = tile.y..tile.y + tile.height;
        let changes = rows.flat_map(|y| {
            let values = self.part(first, tile, y).iter();
            values.zip(self.part(last, tile, y)).map(|(a, b)| b - a)
        });
        let moved = changes
            .map(f32::abs)
            .filter(|change| *change >= MOVED)
            .map(f64::from);
        let rate = moved.sum::<f64>() / (tile.pixels() as f64 * seconds);
        Some(if rate.is_finite() { rate } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 130,
        height: 3,
    };

    const TILE: Tile = Tile {
        x: 60,
        y: 1,
        width: 70,
        height: 2,
    };

    fn frame(of: fn(usize) -> f32) -> Vec<f32> {
        (0..390).map(of).collect()
    }

    #[test]
    fn light_is_a_line_from_frame_to_frame_and_its_bound_is_the_steepest() {
        let mut light = VideoLight::new(SENSOR, frame(|i| i as f32), 0.0);
        let mut next = frame(|i| i as f32 + if i == 389 { 3.0 } else { 0.5 });
        light.push(&mut next, 2_000_000);
        assert_eq!(light.next_bend_ns(TILE, 0), 2_000_000);
        assert_eq!(light.next_bend_ns(TILE, 2_000_000), u64::MAX);
        let mut values = vec![0.0; 140];
        for (t_ns, share) in [(0, 0.0), (500_000, 0.25), (2_000_000, 1.0)] {
            light.sample(TILE, t_ns, &mut values);
            assert_eq!(values[0], 190.0 + 0.5 * share);
            assert_eq!(values[69], 259.0 + 0.5 * share);
            assert_eq!(values[139], 389.0 + 3.0 * share);
        }
        assert_eq!(light.rate_bound(TILE, 0, 1), 1_500.0);
        let left = Tile { width: 68, ..TILE };
        assert_eq!(light.rate_bound(left, 0, 1), 250.0);
        // The next frame is the same: nothing changes.
        light.forget();
        let mut same = light.latest().1.to_vec();
        light.push(&mut same, 5_000_000);
        assert_eq!(light.rate_bound(TILE, 2_000_000, 2_000_001), 0.0);
        light.sample(TILE, 3_000_000, &mut values);
        assert_eq!(values[139], 392.0);
    }

    #[test]
    fn frames_are_left_out_where_a_line_is_near_to_them() {
        let mut light = VideoLight::new(SENSOR, frame(|_| 1.0), 0.5);
        // The last pixel goes up and down by 0.2 from frame to frame, then by 1.1; the others do not change.
        for (ms, change) in [(1, 0.2), (2, 0.0), (3, 0.2), (4, 1.3), (5, 1.3), (6, 1.3)] {
            let mut values = frame(|_| 1.0);
            values[389] += change;
            light.push(&mut values, ms * 1_000_000);
        }
        assert_eq!(light.known(), 7);
        let bends = |tile: Tile| {
            let mut bends = vec![light.next_bend_ns(tile, 0)];
            while let Some(last) = bends.last().filter(|last| **last < u64::MAX) {
                bends.push(light.next_bend_ns(tile, *last));
            }
            bends
        };
        // The line from 0 to 4 ms would be 0.65 above the frame at 2 ms, that from 3 to 5 ms 0.55 below the one at 4 ms.
        assert_eq!(bends(TILE), [3_000_000, 4_000_000, 6_000_000, u64::MAX]);
        assert_eq!(bends(Tile { width: 60, ..TILE }), [6_000_000, u64::MAX]);
        assert_eq!(light.next_bend_ns(TILE, 500_000), 3_000_000);
        let bound = light.rate_bound(TILE, 0, 2_000_000);
        assert!((bound - 200.0).abs() < 1e-3, "{bound}");
        let bound = light.rate_bound(TILE, 2_500_000, 3_500_000);
        assert!((bound - 1_100.0).abs() < 1e-3, "{bound}");
        let mut values = vec![0.0; 140];
        light.sample(TILE, 3_500_000, &mut values);
        assert!((values[139] - 1.75).abs() < 1e-6, "{}", values[139]);
        // One of 140 pixels has changed by 1.3 in 6 ms.
        let rate = light.rate_before(TILE).unwrap();
        assert!((rate - 1.3 / 140.0 / 6e-3).abs() < 1e-5, "{rate}");
        assert_eq!(light.rate_before(Tile { width: 60, ..TILE }), Some(0.0));
    }
}
