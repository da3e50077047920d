//! The textured background: a periodic tile of log intensity with hard-edged patches.

use crate::random::Random;
use crate::wide::wide;

/// Side of the tile in pixels; a power of two, so that wrapping is a mask.
pub(super) const SIDE: usize = 512;

/// Parameters of a background; all contrasts are natural logarithms.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Look {
    /// Log intensity of the scene's mid-level; 0 is a well-lit room, -4 a street at night.
    pub(crate) light: f32,
    /// Log intensity of bright areas (a window in a dark room) relative to dark areas.
    pub(crate) hdr: f32,
    /// Patches per tile of 512 x 512 pixels.
    pub(crate) patches: u32,
    /// Largest step at a patch's edge.
    pub(crate) contrast: f32,
    /// Standard deviation of the fine grain.
    pub(crate) grain: f32,
}

/// A tile of log intensity.
#[derive(Debug, Clone)]
pub(crate) struct Texture {
    /// Rows of `SIDE + 1`: the last column repeats the first.
    log: Vec<f32>,
}

impl Texture {
    /// Paints a tile.
    pub(crate) fn new(look: &Look, random: &mut Random) -> Self {
        let mut tile = vec![0.0_f32; SIDE * SIDE];
        // Large bright areas come first, so that patches lie in light and in shade alike.
        for _ in 0..3 {
            let size = (random.within(40.0, 90.0), random.within(40.0, 110.0));
            paint(&mut tile, size, 0.0, random, |log| *log = look.hdr);
        }
        for _ in 0..look.patches {
            let size = (random.within(4.0, 40.0), random.within(3.0, 24.0));
            // Most edges in a built environment are vertical or horizontal.
            let turn = if random.unit() < 0.6 {
                0.0
            } else {
                random.within(0.0, core::f32::consts::PI)
            };
            let step = random.within(-look.contrast, look.contrast);
            // Halving the old value keeps stacked patches in range.
            paint(&mut tile, size, turn, random, |log| {
                let base = if *log > 0.5 * look.hdr { look.hdr } else { 0.0 };
                *log = base + 0.5 * (*log - base) + step;
            });
        }
        for log in &mut tile {
            *log += look.grain * random.normal() + look.light - 0.25 * look.hdr;
        }
        Self { log: soften(&tile) }
    }

    /// Adds to the log intensity.
    pub(crate) fn brighten(&mut self, log: f32) {
        for value in &mut self.log {
            *value += log;
        }
    }

    /// Writes the log intensity at (u + i, v) to `out[i]`, interpolated bilinearly between lattice points.
    ///
    /// All pixels of a call have the same offset from the lattice points, so the weights are constant and the loop
    /// vectorises.
    pub(crate) fn sample(&self, u: f64, v: f64, out: &mut [f32]) {
        let (mut column, right) = split(u);
        let (row, below) = split(v);
        let upper = self.row(row);
        let lower = self.row((row + 1) & (SIDE - 1));
        let weights = [
            (1.0 - right) * (1.0 - below),
            right * (1.0 - below),
            (1.0 - right) * below,
            right * below,
        ];
        let mut rest = out;
        while !rest.is_empty() {
            let run = rest.len().min(SIDE - column);
            let (now, later) = rest.split_at_mut(run);
            let a = &upper[column..=column + run];
            let b = &lower[column..=column + run];
            interpolate_wide(a, b, weights, now);
            rest = later;
            column = 0;
        }
    }

    pub(super) fn row(&self, row: usize) -> &[f32] {
        let start = row * (SIDE + 1);
        &self.log[start..=start + SIDE]
    }
}

fn interpolate_wide(a: &[f32], b: &[f32], weights: [f32; 4], out: &mut [f32]) {
    wide!(interpolate, a: &[f32], b: &[f32], weights: [f32; 4], out: &mut [f32]);
}

/// Interpolates between neighbours in two rows.
#[inline(always)]
fn interpolate(a: &[f32], b: &[f32], weights: [f32; 4], out: &mut [f32]) {
    for (((out, a), b), (a1, b1)) in out.iter_mut().zip(a).zip(b).zip(a[1..].iter().zip(&b[1..])) {
        *out = weights[0] * a + weights[1] * a1 + weights[2] * b + weights[3] * b1;
    }
}

/// Returns the lattice point at or before a coordinate, wrapped into the tile, and the fractional part.
fn split(coordinate: f64) -> (usize, f32) {
    let whole = libm::floor(coordinate);
    let side = SIDE as f64;
    let wrapped = whole - libm::floor(whole / side) * side;
    (wrapped as usize & (SIDE - 1), (coordinate - whole) as f32)
}

/// Applies `change` to the pixels of a box with half-sizes `size`, turned by `turn` radians, at a random position.
fn paint(
    tile: &mut [f32],
    size: (f32, f32),
    turn: f32,
    random: &mut Random,
    mut change: impl FnMut(&mut f32),
) {
    let (sin, cos) = (libm::sinf(turn), libm::cosf(turn));
    let (x0, y0) = (random.below(SIDE as u32), random.below(SIDE as u32));
    // Less than half the side of the tile, so that no pixel is visited twice.
    let reach = ((size.0 + size.1) as i32).min(SIDE as i32 / 2 - 1);
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let along = dx as f32 * cos + dy as f32 * sin;
            let across = dy as f32 * cos - dx as f32 * sin;
            if along.abs() <= size.0 && across.abs() <= size.1 {
                let x = (x0 as i32 + dx).rem_euclid(SIDE as i32) as usize;
                let y = (y0 as i32 + dy).rem_euclid(SIDE as i32) as usize;
                if let Some(log) = tile.get_mut(y * SIDE + x) {
                    change(log);
                }
            }
        }
    }
}

/// Models the optics: smooths every point with (1 2 1) / 4 in both directions, so that an edge takes about two
/// pixels, and appends the column that repeats the first.
fn soften(tile: &[f32]) -> Vec<f32> {
    let at = |x: usize, y: usize| tile[(y & (SIDE - 1)) * SIDE + (x & (SIDE - 1))];
    let across =
        |x: usize, y: usize| 0.25 * at(x.wrapping_sub(1), y) + 0.5 * at(x, y) + 0.25 * at(x + 1, y);
    let mut log = Vec::with_capacity(SIDE * (SIDE + 1));
    for y in 0..SIDE {
        log.extend((0..=SIDE).map(|x| {
            0.25 * across(x, y.wrapping_sub(1)) + 0.5 * across(x, y) + 0.25 * across(x, y + 1)
        }));
    }
    log
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOK: Look = Look {
        light: -1.0,
        hdr: 2.0,
        patches: 100,
        contrast: 1.0,
        grain: 0.02,
    };

    #[test]
    fn tile_wraps_and_samples_move_with_the_camera() {
        let texture = Texture::new(&LOOK, &mut Random::new(1, 0));
        let mut here = [0.0; 600];
        let mut moved = [0.0; 600];
        texture.sample(500.0, 511.0, &mut here);
        texture.sample(503.0 - 512.0, 511.0 + 1024.0, &mut moved);
        assert_eq!(here[3..], moved[..597]);
        let mut between = [0.0; 1];
        texture.sample(500.5, 511.0, &mut between);
        assert!((between[0] - 0.5 * (here[0] + here[1])).abs() < 1e-6);
        texture.sample(1e18, -1e300, &mut between);
        assert!(between[0].is_finite());
    }

    #[test]
    fn tile_has_the_asked_dynamic_range() {
        let texture = Texture::new(&LOOK, &mut Random::new(1, 0));
        let least = texture.log.iter().copied().fold(f32::MAX, f32::min);
        let most = texture.log.iter().copied().fold(f32::MIN, f32::max);
        assert!(most - least > LOOK.hdr, "{least} to {most}");
        assert!(
            most - least < LOOK.hdr + 5.0 * LOOK.contrast,
            "{least} to {most}"
        );
    }
}
