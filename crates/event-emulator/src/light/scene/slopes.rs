//! How steep a texture is at most, region by region.

use super::texture::{SIDE, Texture};

/// Side of a region in pixels; a power of two.
const REGION: usize = 16;

/// Regions in a row of the texture.
const REGIONS: usize = SIDE / REGION;

/// The largest differences between horizontal and between vertical neighbours of each region.
#[derive(Debug, Clone)]
pub(super) struct Slopes(Vec<(f32, f32)>);

impl Slopes {
    /// Measures a texture.
    pub(super) fn new(texture: &Texture) -> Self {
        let mut slopes = vec![(0.0_f32, 0.0_f32); REGIONS * REGIONS];
        for y in 0..SIDE {
            let (row, below) = (texture.row(y), texture.row((y + 1) & (SIDE - 1)));
            for x in 0..SIDE {
                let slope = &mut slopes[y / REGION * REGIONS + x / REGION];
                slope.0 = slope.0.max((row[x + 1] - row[x]).abs());
                slope.1 = slope.1.max((below[x] - row[x]).abs());
            }
        }
        Self(slopes)
    }

    /// Returns the largest horizontal and vertical slopes, in log intensity per pixel, of the interpolated texture
    /// with u and v in the given intervals. The texture is periodic.
    pub(super) fn greatest(&self, u: (f64, f64), v: (f64, f64)) -> (f32, f32) {
        let mut greatest = (0.0_f32, 0.0_f32);
        for row in regions(v) {
            for column in regions(u) {
                let slope = self.0[row * REGIONS + column];
                greatest = (greatest.0.max(slope.0), greatest.1.max(slope.1));
            }
        }
        greatest
    }
}

/// Returns the regions that an interval touches, one lattice point after its end included: a slope between lattice
/// points depends on the neighbours at either side.
fn regions((from, to): (f64, f64)) -> impl Iterator<Item = usize> {
    let region = REGION as f64;
    let first = libm::floor(from / region);
    let count = libm::floor((to + 1.0) / region) - first + 1.0;
    // The casts saturate; a region is visited once at most.
    let count = (count as usize).min(REGIONS);
    let wrapped = first - libm::floor(first / REGIONS as f64) * REGIONS as f64;
    let first = wrapped as usize;
    (first..first + count).map(|region| region & (REGIONS - 1))
}
