//! A sensor's latest window as a PNG.

use std::sync::Arc;

use eecvs::decode::Windows;
use eecvs::reconstruct::DecodedWindow;
use eecvs_nostd::{Event, Frame, Polarity, Sensor};
use event_pictures::frame_picture::{FrameStyle, FrameSums, event_frame};

/// Approximate length of the picture's longer side, in pixels.
const SIDE: usize = 240;

/// Limit on a pixel's sum of polarities; its colour saturates far below that.
const SUM_MAX: u32 = 64;

/// Returns how many sensor pixels form the side of a picture's pixel, and the style that turns sums into pixels.
#[must_use]
pub fn style(sensor: Sensor) -> (u16, FrameStyle) {
    let longer = usize::from(sensor.width.max(sensor.height)).max(1);
    let nearest = |of: usize, to: usize| ((of + to / 2) / to).max(1);
    // At most 2048 / 240, which fits.
    let shrink = nearest(longer, SIDE) as u16;
    let upscale = nearest(SIDE, longer);
    (shrink, FrameStyle { clip: 4, upscale })
}

/// Returns the picture of a window's sums as a PNG.
#[must_use]
pub fn png(sums: &FrameSums) -> Option<Vec<u8>> {
    let (shrink, style) = style(sums.sensor());
    event_frame(&sums.shrunk(shrink), style).png().ok()
}

/// Returns the sums of the last whole window in `frames`, which begin with one that decodes on its own.
#[must_use]
pub fn latest(frames: &[Arc<[u8]>]) -> Option<FrameSums> {
    let mut windows = Windows::default();
    let mut latest = None;
    for frame in frames {
        let Ok(frame) = Frame::parse(frame) else {
            continue;
        };
        let mut ready = None;
        // A frame that is refused is left out, as everywhere.
        let _ = windows.take(&frame, |window| ready = Some(window));
        if let Some(before) = ready.and_then(|window| latest.replace(window)) {
            windows.reuse(before);
        }
    }
    latest.map(|window| sums(&window))
}

fn sums(window: &DecodedWindow) -> FrameSums {
    let sensor = window.header.sensor;
    let mut sums = FrameSums::new(sensor, &window.events);
    // For windows sent as coefficients, use each pixel's event counts; the times are not needed here.
    for pixel in &window.pixels {
        for (polarity, count) in [(Polarity::On, pixel.on), (Polarity::Off, pixel.off)] {
            let other = match polarity {
                Polarity::On => pixel.off,
                Polarity::Off => pixel.on,
            };
            let event = Event {
                t_us: window.header.t0_us,
                x: pixel.x,
                y: pixel.y,
                polarity,
            };
            for _ in 0..count.saturating_sub(other).min(SUM_MAX) {
                sums.add(&event);
            }
        }
    }
    sums
}
