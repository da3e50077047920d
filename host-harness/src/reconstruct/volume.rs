//! The coefficient volume of a window: C x H x W in basis order.

use super::DecodedWindow;

/// Channel `channel` of a window as an H x W plane: coefficient k of a real transform; re of
/// c_(channel / 2) or, for odd channels, its im, of a complex one. Pruned entries are 0.
pub fn plane(window: &DecodedWindow, channel: usize, plane: &mut [f32]) {
    plane.fill(0.0);
    let width = usize::from(window.header.sensor.width);
    let complex = window.header.transform.is_complex();
    let (k, imaginary) = if complex {
        (channel / 2, channel % 2 == 1)
    } else {
        (channel, false)
    };
    for pixel in &window.pixels {
        let found = pixel
            .coefficients
            .binary_search_by_key(&k, |entry| usize::from(entry.0));
        if let Ok(index) = found {
            let (_, re, im) = pixel.coefficients[index];
            let value = if imaginary { im } else { re };
            plane[usize::from(pixel.y) * width + usize::from(pixel.x)] = value as f32;
        }
    }
}
