//! Structural similarity of two sparse frames (Wang 2004).
//!
//! Gaussian window of 11x11 pixels with sigma 1.5, K1 = 0.01, K2 = 0.03 and data range 2, as in
//! `skimage.metrics.structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
//! data_range=2)`: the mean over the positions whose window lies inside the frame. A side shorter than 11 pixels has
//! no such position, and scikit-image refuses it; here, every pixel along that side is a position, and pixels outside
//! the frame count as 0.
//!
//! The similarity is exactly 1 wherever both frames are equal under the whole window, so only tiles within reach of a
//! pixel that differs are computed.

use event_types::Sensor;
use rayon::prelude::*;

use super::frame::PixelPair;

/// Pixels from the centre of the window to its border, centre excluded.
const REACH: usize = 5;
const SIDE: usize = 2 * REACH + 1;
const SIGMA: f64 = 1.5;
const DATA_RANGE: f64 = 2.0;
const C1: f64 = (0.01 * DATA_RANGE) * (0.01 * DATA_RANGE);
const C2: f64 = (0.03 * DATA_RANGE) * (0.03 * DATA_RANGE);

/// Size of the tile of positions processed at a time: its sums, 5 x 16 x 32 f64, stay in the L1 cache.
const TILE_WIDTH: usize = 32;
const TILE_HEIGHT: usize = 16;

/// Weighted means of a, b, a^2, b^2 and ab.
const MOMENTS: usize = 5;
type Row = [[f64; TILE_WIDTH]; MOMENTS];

/// Computes the SSIM of frames of one sensor at one scale.
#[derive(Debug, Clone)]
pub struct Ssim {
    weights: [f64; SIDE],
    columns: (usize, usize),
    rows: (usize, usize),
    scale: f64,
}

impl Ssim {
    /// Creates the metric for frames of `sensor` whose sums are divided by `peak` (0 counts as 1).
    #[must_use]
    pub fn new(sensor: Sensor, peak: u64) -> Self {
        Self {
            weights: gaussian(),
            columns: positions(sensor.width),
            rows: positions(sensor.height),
            scale: 1.0 / peak.max(1) as f64,
        }
    }

    /// Returns 1 - SSIM of one window, 0 to 2; `pixels` must be ordered by row and column, as returned by
    /// [`super::frame::frame_pair`].
    ///
    /// The complement keeps its precision where the frames are nearly equal.
    #[must_use]
    pub fn dissimilarity(&self, pixels: &[PixelPair]) -> f64 {
        // Collected before they are summed, so that the sum does not depend on the order of the threads.
        let losses: Vec<f64> = self
            .bands_in_reach(pixels)
            .into_par_iter()
            .map(|first| self.band_loss(pixels, first))
            .collect();
        let positions =
            (self.columns.1 - self.columns.0) as f64 * (self.rows.1 - self.rows.0) as f64;
        losses.iter().sum::<f64>() / positions
    }

    /// Returns the first rows of the bands within reach of a pixel that differs.
    fn bands_in_reach(&self, pixels: &[PixelPair]) -> Vec<usize> {
        let mut bands = Vec::new();
        let mut next = self.rows.0;
        for pixel in pixels.iter().filter(|p| p.a != p.b) {
            let y = usize::from(pixel.y);
            // Rows ascend: a band that this pixel does not reach is not reached by a later pixel either.
            if next + TILE_HEIGHT + REACH <= y {
                let above = y - REACH - self.rows.0;
                next = self.rows.0 + above / TILE_HEIGHT * TILE_HEIGHT;
            }
            while next < self.rows.1 && next <= y + REACH {
                bands.push(next);
                next += TILE_HEIGHT;
            }
        }
        bands
    }

    /// Returns the sum of 1 - SSIM over the positions of the rows from `first`, at most [`TILE_HEIGHT`] rows.
    fn band_loss(&self, pixels: &[PixelPair], first: usize) -> f64 {
        let last = self.rows.1.min(first + TILE_HEIGHT);
        let begin = pixels.partition_point(|p| usize::from(p.y) + REACH < first);
        let end = pixels.partition_point(|p| usize::from(p.y) < last + REACH);
        let band = pixels.get(begin..end).unwrap_or_default();
        let mut rows: Vec<_> = band.chunk_by(|p, q| p.y == q.y).collect();
        let mut tile = Tile::new();
        let mut loss = 0.0;
        for left in (self.columns.0..self.columns.1).step_by(TILE_WIDTH) {
            let right = self.columns.1.min(left + TILE_WIDTH);
            let mut differs = false;
            for row in &mut rows {
                let passed = row
                    .iter()
                    .take_while(|p| usize::from(p.x) + REACH < left)
                    .count();
                *row = row.get(passed..).unwrap_or_default();
                differs |= within(row, right).any(|p| p.a != p.b);
            }
            if !differs {
                continue;
            }
            tile.clear();
            for row in &rows {
                tile.add_row(self, within(row, right), (left, right), (first, last));
            }
            loss += tile.loss(right - left, last - first);
        }
        loss
    }
}

/// Returns the pixels of a row that are within reach of positions left of `right`.
fn within(row: &[PixelPair], right: usize) -> impl Iterator<Item = &PixelPair> {
    row.iter()
        .take_while(move |p| usize::from(p.x) < right + REACH)
}

/// Returns the first position and one past the last, along a side of `length` pixels.
fn positions(length: u16) -> (usize, usize) {
    let length = usize::from(length);
    if length >= SIDE {
        (REACH, length - REACH)
    } else {
        (0, length)
    }
}

/// Returns samples of exp(-i^2 / (2 sigma^2)) for i = -5..=5, normalised to a sum of 1.
fn gaussian() -> [f64; SIDE] {
    let sample = |i: usize| {
        let distance = i as f64 - REACH as f64;
        (-0.5 * (distance / SIGMA).powi(2)).exp()
    };
    let samples: [f64; SIDE] = std::array::from_fn(sample);
    let sum: f64 = samples.iter().sum();
    samples.map(|s| s / sum)
}

/// Weighted means at the positions of a tile.
struct Tile {
    rows: Box<[Row; TILE_HEIGHT]>,
    across: Row,
}

impl Tile {
    fn new() -> Self {
        Self {
            rows: Box::new([[[0.0; TILE_WIDTH]; MOMENTS]; TILE_HEIGHT]),
            across: [[0.0; TILE_WIDTH]; MOMENTS],
        }
    }

    fn clear(&mut self) {
        self.rows.fill([[0.0; TILE_WIDTH]; MOMENTS]);
    }

    /// Adds the pixels of one row of the frame to the positions within reach: first along the row, then down the
    /// columns, because the weights are separable.
    fn add_row<'a>(
        &mut self,
        ssim: &Ssim,
        pixels: impl Iterator<Item = &'a PixelPair>,
        (left, right): (usize, usize),
        (first, last): (usize, usize),
    ) {
        let (mut touched_from, mut touched_to) = (TILE_WIDTH, 0);
        let mut y = 0;
        for pixel in pixels {
            let (a, b) = (pixel.a as f64 * ssim.scale, pixel.b as f64 * ssim.scale);
            let values = [a, b, a * a, b * b, a * b];
            let x = usize::from(pixel.x);
            y = usize::from(pixel.y);
            let from = left.max(x.saturating_sub(REACH));
            let to = right.min(x + REACH + 1);
            touched_from = touched_from.min(from - left);
            touched_to = touched_to.max(to.saturating_sub(left));
            for (sums, value) in self.across.iter_mut().zip(values) {
                let seen = sums.iter_mut().skip(from - left).take(to - from);
                // Position x + i weights the pixel with offset -i; the weights are symmetric.
                let weights = ssim.weights.iter().skip(from + REACH - x);
                for (sum, weight) in seen.zip(weights) {
                    *sum += weight * value;
                }
            }
        }
        if touched_from >= touched_to {
            return;
        }
        let from = first.max(y.saturating_sub(REACH));
        let to = last.min(y + REACH + 1);
        let seen = self.rows.iter_mut().skip(from - first).take(to - from);
        let weights = ssim.weights.iter().skip(from + REACH - y);
        for (row, weight) in seen.zip(weights) {
            for (sums, across) in row.iter_mut().zip(&self.across) {
                let sums = sums.get_mut(touched_from..touched_to).unwrap_or_default();
                let across = across.get(touched_from..touched_to).unwrap_or_default();
                for (sum, value) in sums.iter_mut().zip(across) {
                    *sum += weight * value;
                }
            }
        }
        for sums in &mut self.across {
            if let Some(sums) = sums.get_mut(touched_from..touched_to) {
                sums.fill(0.0);
            }
        }
    }

    /// Returns the sum of 1 - SSIM over the first `width` x `height` positions.
    fn loss(&self, width: usize, height: usize) -> f64 {
        let mut loss = [0.0; TILE_WIDTH];
        for [mean_a, mean_b, aa, bb, ab] in self.rows.iter().take(height) {
            // Positions past `width` hold zeros, whose loss is 0.
            for i in 0..TILE_WIDTH {
                let (u, v) = (mean_a[i], mean_b[i]);
                let variance_a = aa[i] - u * u;
                let variance_b = bb[i] - v * v;
                let covariance = ab[i] - u * v;
                let similar = (2.0 * u * v + C1) * (2.0 * covariance + C2);
                let whole = (u * u + v * v + C1) * (variance_a + variance_b + C2);
                loss[i] += 1.0 - similar / whole;
            }
        }
        loss.iter().take(width).sum()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// SSIM by its definition, position by position over the whole frame.
    fn direct(sensor: Sensor, pixels: &[PixelPair], peak: u64) -> f64 {
        let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
        let mut frames = vec![(0.0, 0.0); width * height];
        for p in pixels {
            frames[usize::from(p.y) * width + usize::from(p.x)] =
                (p.a as f64 / peak as f64, p.b as f64 / peak as f64);
        }
        let weights = gaussian();
        let (mut sum, mut count) = (0.0, 0.0);
        let (columns, rows) = (positions(sensor.width), positions(sensor.height));
        for y in rows.0..rows.1 {
            for x in columns.0..columns.1 {
                let mut means = [0.0; 5];
                for (j, down) in weights.iter().enumerate() {
                    for (i, across) in weights.iter().enumerate() {
                        let (px, py) = ((x + i).wrapping_sub(5), (y + j).wrapping_sub(5));
                        if px < width && py < height {
                            let (a, b) = frames[py * width + px];
                            let values = [a, b, a * a, b * b, a * b];
                            for (mean, value) in means.iter_mut().zip(values) {
                                *mean += across * down * value;
                            }
                        }
                    }
                }
                let [u, v, aa, bb, ab] = means;
                sum += (2.0 * u * v + C1) * (2.0 * (ab - u * v) + C2)
                    / ((u * u + v * v + C1) * (aa - u * u + bb - v * v + C2));
                count += 1.0;
            }
        }
        sum / count
    }

    fn pixels(width: u16, height: u16) -> impl Strategy<Value = Vec<PixelPair>> {
        let pixel = (0..width, 0..height, -4_i64..=4, -4_i64..=4, any::<bool>());
        proptest::collection::vec(pixel, 0..150).prop_map(|list| {
            let mut pixels: Vec<_> = list
                .into_iter()
                .map(|(x, y, a, b, same)| PixelPair {
                    x,
                    y,
                    a,
                    b: if same { a } else { b },
                })
                .collect();
            pixels.sort_by_key(|p| (p.y, p.x));
            pixels.dedup_by_key(|p| (p.y, p.x));
            pixels
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn equals_the_definition(
            (sensor, pixels) in (1_u16..=90, 1_u16..=45).prop_flat_map(|(width, height)| {
                (Just(Sensor { width, height }), pixels(width, height))
            }),
            peak in 4_u64..9,
        ) {
            let expected = direct(sensor, &pixels, peak);
            let ssim = 1.0 - Ssim::new(sensor, peak).dissimilarity(&pixels);
            prop_assert!((ssim - expected).abs() < 1e-12, "{ssim} {expected}");
        }
    }

    #[test]
    fn equal_frames_lose_nothing() {
        let sensor = Sensor {
            width: 40,
            height: 30,
        };
        let pixel = |x, y, a| PixelPair { x, y, a, b: a };
        let pixels = [pixel(0, 0, 1), pixel(20, 3, -2), pixel(20, 15, 3)];
        assert_eq!(Ssim::new(sensor, 3).dissimilarity(&pixels), 0.0);
    }

    #[test]
    fn a_difference_out_of_every_windows_centre_still_counts() {
        // Only one position reaches the corner pixel, which lies in the corner of that position's window.
        let sensor = Sensor {
            width: 11,
            height: 11,
        };
        let corner = [PixelPair {
            x: 0,
            y: 0,
            a: 1,
            b: 0,
        }];
        let weight = gaussian()[0].powi(2);
        let similar = C1 * C2;
        let whole = (weight * weight + C1) * (weight - weight * weight + C2);
        let loss = Ssim::new(sensor, 1).dissimilarity(&corner);
        assert!((loss - (1.0 - similar / whole)).abs() < 1e-15);
    }
}
