//! How far a video's content moves from frame to frame, estimated by comparing blocks.
//!
//! Blocks of 16 x 16 pixels are taken whose light changes most, 32 at most. A block has moved beyond a pixel where it is
//! found again within 7 pixels, or, in the picture averaged over 4 x 4 pixels, within 32: with less than half of its
//! difference in place, and two thirds of that at up to a pixel. The difference is the sum of absolute differences of
//! ln E.

use event_types::Sensor;

/// Side of a block in pixels of the level that is searched.
const SIDE: usize = 16;

/// Largest displacement that is searched, in pixels of the level.
const REACH: isize = 7;

/// Side of the squares that are averaged for longer ways.
const COARSE: usize = 4;

/// Most blocks of a pair of frames that are searched for.
const BLOCKS_MAX: usize = 32;

/// Least mean change of a block that is searched for, in natural log units: less gives no events.
const CHANGE_MIN: f32 = 0.05;

/// Differences up to so many times the least are alike.
const ALIKE: f32 = 1.1;

/// Motion between the frames of a video so far.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Pairs of neighbouring frames.
    pub pairs: u64,
    /// Those in which a quarter of the changing blocks or more moved by two pixels or more.
    pub pairs_beyond: u64,
    /// Number of the first such pair's earlier frame, from 0.
    pub first_frame: Option<u64>,
    /// Longest way of a block in such a pair, in pixels.
    pub most_px: f32,
}

impl Motion {
    /// Adds what is between two frames of ln lux.
    pub(crate) fn add(&mut self, sensor: Sensor, before: &[f32], after: &[f32]) {
        let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
        let fine = Level::new(width, height, before, after);
        if let Some(px) = farthest(&fine) {
            self.first_frame.get_or_insert(self.pairs);
            self.pairs_beyond += 1;
            self.most_px = self.most_px.max(px);
        }
        self.pairs += 1;
    }
}

/// Two frames of one resolution.
struct Level<'f> {
    width: usize,
    height: usize,
    before: &'f [f32],
    after: &'f [f32],
}

impl<'f> Level<'f> {
    fn new(width: usize, height: usize, before: &'f [f32], after: &'f [f32]) -> Self {
        Self {
            width,
            height,
            before,
            after,
        }
    }

    /// Returns the difference between the block at `(x, y)` of the earlier frame and that displaced by `(dx, dy)` of the
    /// later one; infinite where that is beyond the picture, or where it is above `most`.
    fn difference(&self, (x, y): (usize, usize), (dx, dy): (isize, isize), most: f32) -> f32 {
        let moved = |at: usize, by: isize, most: usize| {
            let to = at.checked_add_signed(by)?;
            (to + SIDE <= most).then_some(to)
        };
        let (Some(u), Some(v)) = (moved(x, dx, self.width), moved(y, dy, self.height)) else {
            return f32::INFINITY;
        };
        // A sum for each column: several columns at once.
        let mut sums = [0.0_f32; SIDE];
        for row in 0..SIDE {
            let (from, to) = ((y + row) * self.width + x, (v + row) * self.width + u);
            let before = self.before.get(from..from + SIDE).unwrap_or_default();
            let after = self.after.get(to..to + SIDE).unwrap_or_default();
            for ((sum, b), a) in sums.iter_mut().zip(before).zip(after) {
                *sum += (a - b).abs();
            }
            // Sums only grow: what is too much already is known early.
            if row % 4 == 3 && sums.iter().sum::<f32>() > most {
                return f32::INFINITY;
            }
        }
        sums.iter().sum()
    }

    /// Returns where a block has gone, if it has moved by two pixels or more.
    fn way(&self, block: (usize, usize), reach: isize) -> Option<(isize, isize)> {
        let in_place = self.difference(block, (0, 0), f32::INFINITY);
        let is_near = |dx: isize, dy: isize| dx.abs().max(dy.abs()) <= 1;
        let ways = |reach: isize| {
            (-reach..=reach).flat_map(move |dy| (-reach..=reach).map(move |dx| (dx, dy)))
        };
        let near = ways(1).fold(in_place, |near, way| {
            near.min(self.difference(block, way, near))
        });
        let limit = (0.5 * in_place).min(near / 1.5);
        let most = ALIKE * limit;
        let found: Vec<(f32, (isize, isize))> = ways(reach)
            .filter(|(dx, dy)| !is_near(*dx, *dy))
            .map(|way| (self.difference(block, way, most), way))
            .collect();
        let best = found
            .iter()
            .fold(f32::INFINITY, |best, (d, _)| best.min(*d));
        if best >= limit {
            return None;
        }
        // Along an edge, many places are alike: the nearest of them.
        let alike = found.into_iter().filter(|(d, _)| *d <= ALIKE * best);
        let ways = alike.map(|(_, way)| way);
        ways.min_by_key(|(dx, dy)| dx * dx + dy * dy)
    }
}

/// Returns the longest way in pixels of the blocks that change most, if a quarter of them moved by two pixels or more.
fn farthest(fine: &Level<'_>) -> Option<f32> {
    let mut blocks = Vec::new();
    for y in (0..fine.height.saturating_sub(SIDE - 1)).step_by(SIDE) {
        for x in (0..fine.width.saturating_sub(SIDE - 1)).step_by(SIDE) {
            let change = fine.difference((x, y), (0, 0), f32::INFINITY) / (SIDE * SIDE) as f32;
            if change >= CHANGE_MIN {
                blocks.push((change, (x, y)));
            }
        }
    }
    blocks.sort_by(|a, b| b.0.total_cmp(&a.0));
    blocks.truncate(BLOCKS_MAX);
    let mut coarse = None;
    let mut beyond = 0;
    let mut most = 0.0_f32;
    for (_, block) in &blocks {
        let way = fine.way(*block, REACH).map(length).or_else(|| {
            let coarse = coarse.get_or_insert_with(|| Coarse::of(fine));
            coarse.way(*block)
        });
        if let Some(way) = way {
            beyond += 1;
            most = most.max(way);
        }
    }
    (beyond > 0 && 4 * beyond >= blocks.len()).then_some(most)
}

fn length((dx, dy): (isize, isize)) -> f32 {
    ((dx * dx + dy * dy) as f32).sqrt()
}

/// Two frames averaged over squares.
struct Coarse {
    width: usize,
    height: usize,
    before: Vec<f32>,
    after: Vec<f32>,
}

impl Coarse {
    fn of(fine: &Level<'_>) -> Self {
        let (width, height) = (fine.width / COARSE, fine.height / COARSE);
        let average = |frame: &[f32]| {
            let mut means = vec![0.0; width * height];
            for (y, row) in frame.chunks(fine.width).enumerate() {
                let start = y / COARSE * width;
                let Some(means) = means.get_mut(start..start + width) else {
                    break;
                };
                for (mean, values) in means.iter_mut().zip(row.chunks(COARSE)) {
                    *mean += values.iter().sum::<f32>() / (COARSE * COARSE) as f32;
                }
            }
            means
        };
        Self {
            width,
            height,
            before: average(fine.before),
            after: average(fine.after),
        }
    }

    /// Returns the way in pixels of the surroundings of a block of the fine level.
    fn way(&self, (x, y): (usize, usize)) -> Option<f32> {
        let level = Level::new(self.width, self.height, &self.before, &self.after);
        let corner = |at: usize, most: usize| {
            let middle = (at + SIDE / 2) / COARSE;
            Some(middle.saturating_sub(SIDE / 2).min(most.checked_sub(SIDE)?))
        };
        let block = (corner(x, self.width)?, corner(y, self.height)?);
        let way = level.way(block, REACH + 1)?;
        Some(length(way) * COARSE as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    const SENSOR: Sensor = Sensor {
        width: 160,
        height: 120,
    };

    /// A texture that is smooth over some pixels, seen from a place.
    fn frame(at: (f32, f32)) -> Vec<f32> {
        let mut random = Random::new(5, 5);
        let waves: Vec<[f32; 4]> = (0..40)
            .map(|_| {
                let mut within = |most: f32| random.within(-most, most);
                [within(0.5), within(0.5), within(3.0), within(0.3)]
            })
            .collect();
        let mut values = Vec::new();
        for y in 0..SENSOR.height {
            for x in 0..SENSOR.width {
                let (x, y) = (f32::from(x) + at.0, f32::from(y) + at.1);
                let wave = |[u, v, phase, size]: &[f32; 4]| size * (u * x + v * y + phase).sin();
                values.push(waves.iter().map(wave).sum());
            }
        }
        values
    }

    fn between(before: &[f32], after: &[f32]) -> Motion {
        let mut motion = Motion::default();
        motion.add(SENSOR, before, after);
        motion
    }

    #[test]
    fn ways_beyond_a_pixel_are_found_and_shorter_ones_are_not() {
        let still = frame((0.0, 0.0));
        for (at, px) in [((3.0, 0.0), 3.0), ((-2.0, 5.0), 5.4), ((16.0, -12.0), 20.0)] {
            let found = between(&still, &frame(at));
            assert_eq!(
                (found.pairs_beyond, found.first_frame),
                (1, Some(0)),
                "{at:?}"
            );
            assert!((found.most_px / px - 1.0).abs() < 0.3, "{at:?}: {found:?}");
        }
        for at in [(0.0, 0.0), (0.3, 0.4), (1.0, 0.0), (-0.7, 0.9)] {
            let found = between(&still, &frame(at));
            assert_eq!(
                (found.pairs, found.pairs_beyond),
                (1, 0),
                "{at:?}: {found:?}"
            );
        }
    }

    #[test]
    fn flicker_noise_and_fades_are_no_motion() {
        let still = frame((0.0, 0.0));
        let brighter: Vec<f32> = still.iter().map(|value| value + 0.4).collect();
        assert_eq!(between(&still, &brighter).pairs_beyond, 0);
        let mut random = Random::new(6, 6);
        let noisy: Vec<f32> = still.iter().map(|v| v + 0.3 * random.normal()).collect();
        assert_eq!(between(&still, &noisy).pairs_beyond, 0);
        let flat = vec![0.0; still.len()];
        let noise: Vec<f32> = flat.iter().map(|v| v + 0.3 * random.normal()).collect();
        assert_eq!(between(&flat, &noise).pairs_beyond, 0);
        assert_eq!(between(&still, &flat).pairs_beyond, 0);
    }

    #[test]
    fn an_object_in_front_of_a_still_background_counts() {
        let (still, moved) = (frame((0.0, 0.0)), frame((4.0, 0.0)));
        let mut after = still.clone();
        for y in 32..72 {
            for x in 32..72 {
                after[y * 160 + x] = moved[y * 160 + x];
            }
        }
        assert_eq!(between(&still, &after).pairs_beyond, 1);
    }

    #[test]
    fn small_pictures_have_no_blocks() {
        let sensor = Sensor {
            width: 9,
            height: 17,
        };
        let mut motion = Motion::default();
        motion.add(sensor, &[0.0; 153], &[1.0; 153]);
        assert_eq!((motion.pairs, motion.pairs_beyond), (1, 0));
    }
}
