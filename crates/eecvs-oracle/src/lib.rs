//! The f64 oracle: an independent implementation of the paper's formulas.
//!
//! There is one file per stage, named after the core's stage, so that each stage can be compared with its fixed-point
//! counterpart. Clarity comes before speed. No code is shared with the core except the plain event types.
//!
//! events -> [`window`] -> [`density`] -> [`regime`] -> coefficients ([`dct`], [`dtft`], [`dwt`] through
//! [`transform`]) -> [`prune`] -> [`quantise`] -> [`reconstruct`].
//! [`percentile`] calibrates the thresholds of [`regime`].

pub mod dct;
pub mod density;
pub mod dtft;
pub mod dwt;
pub mod percentile;
pub mod prune;
pub mod quantise;
pub mod reconstruct;
pub mod regime;
#[cfg(test)]
mod test_events;
pub mod transform;
pub mod window;

use std::collections::BTreeMap;

use num_complex::Complex64;

use transform::{Impulse, Transform};
use window::Window;

/// Returns the impulses of each active pixel of a window, keyed by (y, x), in order of arrival.
#[must_use]
pub fn impulses(window: &Window) -> BTreeMap<(u16, u16), Vec<Impulse>> {
    let mut pixels: BTreeMap<(u16, u16), Vec<Impulse>> = BTreeMap::new();
    for event in &window.events {
        let impulse = Impulse {
            offset_us: window.offset_us(event),
            p: f64::from(event.polarity.sign()),
        };
        pixels.entry((event.y, event.x)).or_default().push(impulse);
    }
    pixels
}

/// Returns the coefficients `c_k` of each active pixel of a window, eq. (6), keyed by (y, x) in row-major order.
///
/// Shape: `Window -> {(y, x): [Complex64; grid]}`; the imaginary part is 0 for the DCT and the DWT. Pixels without
/// events are absent: their coefficients are 0.
#[must_use]
pub fn coefficients(
    window: &Window,
    transform: Transform,
    grid: usize,
) -> BTreeMap<(u16, u16), Vec<Complex64>> {
    impulses(window)
        .into_iter()
        .map(|(pixel, impulses)| {
            (
                pixel,
                transform.coefficients(&impulses, window.duration_us, grid),
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use event_types::{Event, Polarity};

    use super::*;

    #[test]
    fn pixels_are_independent_and_in_row_major_order() {
        let t0_us = 1_700_000_000_000_000;
        let event = |dt, x, y, polarity| Event {
            t_us: t0_us + dt,
            x,
            y,
            polarity,
        };
        let window = Window {
            t0_us,
            duration_us: 100,
            events: vec![
                event(0, 5, 1, Polarity::On),
                event(50, 2, 1, Polarity::Off),
                event(75, 5, 1, Polarity::Off),
                event(10, 9, 0, Polarity::On),
            ],
            begins_run: false,
        };
        let c = coefficients(&window, Transform::Dwt, 4);
        let real = |c: &[Complex64]| -> Vec<f64> { c.iter().map(|c| c.re).collect() };
        let s = 2.0_f64.sqrt();
        let got: Vec<_> = c.iter().map(|(pixel, c)| (*pixel, real(c))).collect();
        assert_eq!(
            got,
            [
                ((0, 9), vec![1.0, 1.0, s, 0.0]),
                ((1, 2), vec![-1.0, 1.0, 0.0, -s]),
                ((1, 5), vec![0.0, 2.0, s, s]),
            ]
        );
    }
}
