//! The light that falls on the pixels.

pub(crate) mod scene;
pub(crate) mod video;

use event_types::Sensor;

/// A rectangle of neighbouring pixels; it lies within the sensor and is not empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tile {
    /// First column.
    pub x: u16,
    /// First row.
    pub y: u16,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
}

impl Tile {
    /// Returns the number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        usize::from(self.width) * usize::from(self.height)
    }

    /// Returns whether the tile and the columns `x.0..x.1` and rows `y.0..y.1` have a pixel in common.
    #[must_use]
    pub fn touches(&self, x: (u16, u16), y: (u16, u16)) -> bool {
        x.0 < self.x + self.width && self.x < x.1 && y.0 < self.y + self.height && self.y < y.1
    }
}

/// The light of every pixel as a function of time: a scene, or the frames of a video.
///
/// Light is the natural logarithm of the illuminance in lux that a white surface in place of the picture's point would
/// have; a lit room is about 300 lx. Times are nanoseconds since the beginning. Between its switches the light of a
/// pixel is continuous.
pub trait Light: Sync {
    /// Returns the sensor's size.
    fn sensor(&self) -> Sensor;

    /// Writes the light of a tile's pixels at `t_ns` to `ln_lux`, row by row; all values are finite. At the time of a
    /// switch it is the light after the switch, 1 ns before it is the light before the switch.
    fn sample(&self, tile: Tile, t_ns: u64, ln_lux: &mut [f32]);

    /// Returns an upper bound of |d ln E / dt| in 1/s for all pixels of a tile at all times from `from_ns` to `to_ns`,
    /// switches left out; 0 says that the light does not change.
    fn rate_bound(&self, tile: Tile, from_ns: u64, to_ns: u64) -> f64;

    /// Returns the first time after `after_ns` at which the light of a pixel of the tile jumps; [`u64::MAX`] if it
    /// never does.
    fn next_switch_ns(&self, tile: Tile, after_ns: u64) -> u64;

    /// Returns the first time after `after_ns` at which a sample has to be taken, [`u64::MAX`] if there is none: where
    /// the light's slope jumps, or where what is known of it ends. No bound and no sample beyond it is asked for.
    fn next_bend_ns(&self, tile: Tile, after_ns: u64) -> u64 {
        let _ = (tile, after_ns);
        u64::MAX
    }

    /// Returns the mean |d ln E / dt| in 1/s that the pixels of a tile have seen before the beginning, in light that rose
    /// and fell; `None` says that they have long seen the light of time 0.
    fn rate_before(&self, tile: Tile) -> Option<f64> {
        let _ = tile;
        None
    }
}
