//! How far one line may stand for those of several frames.
//!
//! A line from the light v at a time to frame k is within e of a frame i on its way if its slope is within (v_i - v +- e) / t_i,
//! t_i the time until then. Each frame narrows the slopes that are left; the line ends before the first frame whose own slope
//! is not among them, for a pixel of the tile.

use super::{Tile, VideoLight};
use crate::light::Light;
use crate::wide::wide;

/// Pixels of the largest tile whose frames may be left out.
const PIXELS_MAX: usize = 512;

impl VideoLight {
    /// Returns the time of the last frame to which one line stands for the light of a tile, from a time on; `next` is the
    /// number of the first frame after it. `None` if the tile is too large.
    pub(super) fn chord_end(&self, tile: Tile, after_ns: u64, next: usize) -> Option<u64> {
        let count = tile.pixels();
        let mut arrays = [[0.0; PIXELS_MAX]; 3];
        let [start, lowest, highest] = &mut arrays;
        let start = start.get_mut(..count)?;
        let (lowest, highest) = (lowest.get_mut(..count)?, highest.get_mut(..count)?);
        self.sample(tile, after_ns, start);
        lowest.fill(f32::NEG_INFINITY);
        highest.fill(f32::INFINITY);
        let width = usize::from(tile.width);
        let mut end_ns = None;
        for frame in self.frames.range(next..) {
            let per_s = (1e9 / (frame.at_ns - after_ns) as f64) as f32;
            let rows = start.chunks(width).zip(tile.y..);
            let slopes = lowest.chunks_mut(width).zip(highest.chunks_mut(width));
            for ((start, y), slopes) in rows.zip(slopes) {
                let values = self.part(frame, tile, y);
                if !narrow(start, values, per_s, self.skipped, slopes) {
                    return end_ns;
                }
            }
            end_ns = Some(frame.at_ns);
        }
        end_ns
    }
}

/// Narrows the slopes that are left, and returns whether those to `values` had been among them.
fn narrow(
    start: &[f32],
    values: &[f32],
    per_s: f32,
    error: f32,
    slopes: (&mut [f32], &mut [f32]),
) -> bool {
    wide!(narrow_each, start: &[f32], values: &[f32], per_s: f32, error: f32, slopes: (&mut [f32], &mut [f32]); bool)
}

#[inline(always)]
fn narrow_each(
    start: &[f32],
    values: &[f32],
    per_s: f32,
    error: f32,
    (lowest, highest): (&mut [f32], &mut [f32]),
) -> bool {
    let margin = error * per_s;
    let mut outside = 0_u32;
    let slopes = lowest.iter_mut().zip(highest);
    for ((from, to), (lowest, highest)) in start.iter().zip(values).zip(slopes) {
        let slope = (to - from) * per_s;
        outside |= u32::from(slope < *lowest) | u32::from(slope > *highest);
        let (low, high) = (slope - margin, slope + margin);
        *lowest = if low > *lowest { low } else { *lowest };
        *highest = if high < *highest { high } else { *highest };
    }
    outside == 0
}

#[cfg(test)]
mod tests {
    use event_types::Sensor;

    use super::*;

    /// Pixels whose light swings at their own pace: every frame that is left out is within the error of the line.
    #[test]
    fn frames_that_are_left_out_are_within_the_error() {
        let sensor = Sensor {
            width: 64,
            height: 8,
        };
        let tile = Tile {
            x: 0,
            y: 0,
            width: 64,
            height: 8,
        };
        let at = |frame: u64| -> Vec<f32> {
            let swing = |pixel: u64| (frame as f32 * (0.02 + 0.0001 * pixel as f32)).sin();
            (0..512).map(swing).collect()
        };
        let mut light = VideoLight::new(sensor, at(0), 0.02);
        for frame in 1..100 {
            light.push(&mut at(frame), frame * 1_000_000);
        }
        let (mut from, mut lines) = (0, 0);
        while from < 99 {
            let to = light.next_bend_ns(tile, from * 1_000_000) / 1_000_000;
            assert!(to > from && to <= 99);
            let (before, after) = (at(from), at(to));
            for frame in from..to {
                let share = (frame - from) as f32 / (to - from) as f32;
                for ((v, b), a) in at(frame).iter().zip(&before).zip(&after) {
                    assert!((b + (a - b) * share - v).abs() < 0.0201);
                }
            }
            (from, lines) = (to, lines + 1);
        }
        assert!((10..=50).contains(&lines), "{lines}");
        // A tile that is too large takes each frame.
        let large = Tile { height: 9, ..tile };
        assert_eq!(light.chord_end(large, 0, 1), None);
    }
}
