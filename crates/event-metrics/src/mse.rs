//! Mean squared error between two frames.

use super::frame::PixelPair;

/// Returns the sum over the pixels of (a - b)^2, in squared counts; exact.
///
/// `mse` is this value summed over the windows, divided by (peak^2 * pixels * windows), where peak is the largest
/// |sum| of both recordings.
#[must_use]
pub fn squared_error(pixels: &[PixelPair]) -> u128 {
    pixels
        .iter()
        .map(|p| u128::from(p.a.abs_diff(p.b)))
        .map(|difference| difference * difference)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_the_differences() {
        let pixel = |a, b| PixelPair { x: 0, y: 0, a, b };
        assert_eq!(squared_error(&[]), 0);
        assert_eq!(squared_error(&[pixel(3, 3), pixel(-1, 1), pixel(0, 3)]), 13);
    }
}
