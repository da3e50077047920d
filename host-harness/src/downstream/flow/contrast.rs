//! The image of warped events of a tile, and its contrast.
//!
//! An event (x, y, t, p) that moves with velocity v was at (x, y) - v t at t = 0, the middle of the window. Votes p
//! of +1 and -1 at these positions, distributed bilinearly to the four nearest pixels, form an image; its contrast
//! is the sum of the squared pixels. If v is the velocity of the scene, the events of an edge coincide and the
//! contrast is greatest. The image has room for every event at every velocity, so that its sum does not depend on
//! v, and the greatest sum of squares is also the greatest variance.

use super::{SPEED_MAX_PX, TILE_PX};

/// An event of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    /// Pixels from the tile's left border.
    pub(super) x: f32,
    /// Pixels from the tile's top border.
    pub(super) y: f32,
    /// Time from the window's middle, in windows: -1/2 to 1/2.
    pub(super) t: f32,
    /// Polarity, -1 or 1.
    pub(super) p: f32,
}

/// Velocity in pixels per window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Velocity {
    pub(super) x: f32,
    pub(super) y: f32,
}

/// An image of warped events.
#[derive(Debug, Clone)]
pub(super) struct Image {
    /// Side of an image pixel, in sensor pixels.
    cell: f32,
    side: usize,
    is_blurred: bool,
    pixels: Vec<f32>,
    blurred_rows: Vec<f32>,
}

/// Number of partial sums, so that the loops can be vectorised.
const LANES: usize = 8;

impl Image {
    /// Makes an image with pixels twice as wide, for a first search among many velocities.
    pub(super) fn coarse() -> Self {
        Self::new(2, false)
    }

    /// Makes an image with the sensor's pixels, blurred by (1 2 1)/4 along rows and columns, so that the contrast
    /// is smooth in v.
    pub(super) fn fine() -> Self {
        Self::new(1, true)
    }

    fn new(cell: u16, is_blurred: bool) -> Self {
        // Margin on each side: half the greatest speed, and two pixels for votes and blur.
        let room = usize::from(TILE_PX + SPEED_MAX_PX) / usize::from(cell);
        let side = (room + 4).next_multiple_of(LANES);
        Self {
            cell: f32::from(cell),
            side,
            is_blurred,
            pixels: vec![0.0; side * side],
            blurred_rows: vec![0.0; side * side],
        }
    }

    /// Returns the contrast at velocity `v`, each component of which is at most [`SPEED_MAX_PX`].
    pub(super) fn contrast<'p>(
        &mut self,
        points: impl IntoIterator<Item = &'p Point>,
        v: Velocity,
    ) -> f32 {
        self.pixels.fill(0.0);
        let scale = 1.0 / self.cell;
        let origin = f32::from(SPEED_MAX_PX) / 2.0 * scale + 2.0;
        for point in points {
            let x = (point.x - v.x * point.t) * scale + origin;
            let y = (point.y - v.y * point.t) * scale + origin;
            // The casts round down, since x and y are positive.
            let (column, row) = (x as usize, y as usize);
            let (right, down) = (x - column as f32, y - row as f32);
            let first = row * self.side + column;
            self.vote(first, right, point.p * (1.0 - down));
            self.vote(first + self.side, right, point.p * down);
        }
        if self.is_blurred {
            self.blurred_squares()
        } else {
            squares(&self.pixels)
        }
    }

    /// Adds `weight` to two adjacent pixels: the share `right` to the one after `first`, the rest to `first`.
    fn vote(&mut self, first: usize, right: f32, weight: f32) {
        if let Some([left, next]) = self.pixels.get_mut(first..first + 2) {
            *left += weight * (1.0 - right);
            *next += weight * right;
        }
    }

    /// Returns the sum of squares of the blurred image.
    fn blurred_squares(&mut self) -> f32 {
        let side = self.side;
        let rows = self.pixels.chunks_exact(side);
        for (row, blurred) in rows.zip(self.blurred_rows.chunks_exact_mut(side)) {
            let after = row.get(1..).unwrap_or_default();
            let next = row.get(2..).unwrap_or_default();
            let middle = blurred.get_mut(1..).unwrap_or_default();
            for (((to, a), b), c) in middle.iter_mut().zip(row).zip(after).zip(next) {
                *to = 0.25 * (a + 2.0 * b + c);
            }
        }
        let below = self.blurred_rows.get(side..).unwrap_or_default();
        let last = self.blurred_rows.get(2 * side..).unwrap_or_default();
        for (((to, a), b), c) in self
            .pixels
            .iter_mut()
            .zip(&self.blurred_rows)
            .zip(below)
            .zip(last)
        {
            *to = 0.25 * (a + 2.0 * b + c);
        }
        // The last two rows are not blurred, but they have no votes.
        squares(&self.pixels)
    }
}

fn squares(values: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for values in values.chunks_exact(LANES) {
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += value * value;
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f32, y: f32, t: f32, p: f32) -> Point {
        Point { x, y, t, p }
    }

    const REST: Velocity = Velocity { x: 0.0, y: 0.0 };

    #[test]
    fn events_that_meet_add_up() {
        let v = Velocity { x: 8.0, y: -4.0 };
        let points: Vec<Point> = [-0.5, -0.25, 0.0, 0.25, 0.5]
            .map(|t| point(16.0 + 8.0 * t, 10.0 - 4.0 * t, t, 1.0))
            .into();
        // On the grid of 2 x 2 px cells, (16, 10) is exactly a cell.
        assert_eq!(Image::coarse().contrast(&points, v), 25.0);
        let fine = |v| Image::fine().contrast(&points, v);
        // The sum of squares of (1 2 1)/4 is 3/8 along each axis.
        assert_eq!(fine(v), 25.0 * 9.0 / 64.0);
        assert!(fine(REST) < 0.3 * fine(v));
        for off in [-1.0, 1.0] {
            assert!(fine(Velocity { x: v.x + off, ..v }) < fine(v));
            assert!(fine(Velocity { y: v.y + off, ..v }) < fine(v));
        }
    }

    #[test]
    fn votes_are_bilinear_and_signed() {
        let between = [point(2.5, 3.0, 0.0, 1.0)];
        assert_eq!(Image::coarse().contrast(&between, REST), {
            // At 1.25 and 1.5 cells: shares of 3/4 and 1/4, and of 1/2 each.
            (0.75 * 0.75 + 0.25 * 0.25) * 0.5
        });
        let opposite = [point(4.0, 4.0, 0.1, 1.0), point(4.0, 4.0, -0.1, -1.0)];
        assert_eq!(Image::fine().contrast(&opposite, REST), 0.0);
    }

    #[test]
    fn every_event_is_in_the_image_at_every_velocity() {
        let (end, speed) = (f32::from(TILE_PX - 1), f32::from(SPEED_MAX_PX));
        for (x, y) in [(0.0, 0.0), (end, 0.0), (0.0, end), (end, end)] {
            for t in [-0.5, 0.5] {
                for v in [(-speed, -speed), (speed, -speed), (speed, speed)] {
                    let v = Velocity { x: v.0, y: v.1 };
                    let lone = [point(x, y, t, 1.0)];
                    // The positions are whole pixels, and whole or half cells.
                    assert!(Image::coarse().contrast(&lone, v) >= 0.25);
                    assert_eq!(Image::fine().contrast(&lone, v), 9.0 / 64.0);
                }
            }
        }
    }
}
